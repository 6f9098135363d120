"""Draw the pictures of docs/detection.md anew: its command lines are run, and each timeline is kept beside the page."""

import shlex
import subprocess
import sys
import tempfile
from pathlib import Path

DOCS = Path(__file__).parent


def main() -> None:
    """Run every line after a `$` in a folder that sees the models."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "models").symlink_to(DOCS.parent / "models")
        for line in (DOCS / "detection.md").read_text(encoding="utf-8").splitlines():
            if line.startswith("$ deshybrid "):
                words = shlex.split(line)[2:]
                subprocess.run([sys.executable, "-m", "deshybrid.cli", *words], cwd=folder, check=True)
        for drawn in folder.glob("*/timeline.svg"):
            (DOCS / f"detection-{drawn.parent.name}.svg").write_bytes(drawn.read_bytes())


if __name__ == "__main__":
    main()
