"""The driveline from model to moving car: compile it, drive it, and run the generated observer on the drive.

Run by `make demo`.  What a user would type is printed before it runs; only the last step, the generated Python code at
work, is not a command of deshybrid, because generated code needs nothing of it.
"""

import importlib.util
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

from deshybrid.model.load import load
from deshybrid.simulate.replay import replay
from deshybrid.simulate.score import LocationScore, score
from deshybrid.simulate.trace import read_trace

MODEL = Path("models/balluchi2012/driveline.yaml")
FOLDER = Path("build/driveline")


class GeneratedObserver:
    """The generated module behind the interface that `replay` drives."""

    def __init__(self, module: ModuleType) -> None:
        self.module = module

    def start(self) -> Any:
        return self.module.Observer()

    def step(
        self, state: Any, input: Any, output: Any, event: str | None, command: Sequence[str | None] = ()
    ) -> tuple[Any, Any]:
        estimate = state.step(input, output, event, tuple(command))
        return state, SimpleNamespace(**estimate._asdict(), state=estimate.x)


def command(*arguments: object) -> None:
    """Print a command, run it, and stop where it fails; 1 is an answer, not a failure."""
    words = [str(argument) for argument in arguments]
    print("\n$ " + " ".join(["deshybrid", *words]), flush=True)
    code = subprocess.run([sys.executable, "-m", "deshybrid.cli", *words], check=False).returncode
    if code > 1:
        sys.exit(code)


def generated_observer(path: Path) -> GeneratedObserver:
    specification = importlib.util.spec_from_file_location(path.stem, path)
    if specification is None or specification.loader is None:
        sys.exit(f"cannot load {path}")
    module = importlib.util.module_from_spec(specification)
    specification.loader.exec_module(module)
    return GeneratedObserver(module)


def print_engagements(found: LocationScore) -> None:
    print(
        f"\n{'engaged':>9}  {'gear':<4}  {'stay':>8}  delay of the observer (negative: named before the clutch locked)"
    )
    for stay in found.engagements:
        delay = "never named" if stay.delay is None else f"{1000 * stay.delay:+6.0f} ms"
        print(f"{stay.enter:>7.2f} s  {stay.location:<4}  {stay.leave - stay.enter:>6.2f} s  {delay}")
    print(f"\n{found}")


def main() -> None:
    FOLDER.mkdir(parents=True, exist_ok=True)
    command("compile", MODEL, "-o", FOLDER)
    command("simulate", MODEL, "--seed", 1, "-o", FOLDER / "drive.csv")
    system = load(MODEL)
    trace = read_trace(FOLDER / "drive.csv", system)
    gears = [location.name for location in system.locations if location.name != "qN"]
    code = FOLDER / "python" / "driveline.py"
    print(f"\nthe generated observer {code} runs on the drive")
    result = score(trace, replay(generated_observer(code), trace), only=gears)
    if result.locations is not None:
        print_engagements(result.locations)
    if shutil.which("cc") and shutil.which("make"):
        print("\n$ make -C build/driveline/c test", flush=True)
        subprocess.run(["make", "--no-print-directory", "-s", "-C", str(FOLDER / "c"), "test"], check=True)
    print(f"\nThe report: {FOLDER / 'report.html'}")


if __name__ == "__main__":
    main()
