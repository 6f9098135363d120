"""What all tests share: golden texts, compared byte for byte, rewritten by one flag after the difference was read."""

from collections.abc import Callable
from pathlib import Path

import pytest
from hypothesis import settings

# The same examples on every machine and in every run; a slow machine is no failure.
settings.register_profile("deshybrid", derandomize=True, deadline=None)
settings.load_profile("deshybrid")

GOLDEN = Path(__file__).parent / "golden"


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--rewrite-golden", action="store_true", help="write the golden texts instead of comparing them")


@pytest.fixture
def golden(request: pytest.FixtureRequest) -> Callable[[str, str], None]:
    """Compare a text with the file of that name below `tests/golden`, or write it under `--rewrite-golden`."""

    def compare(name: str, text: str) -> None:
        path = GOLDEN / name
        if request.config.getoption("--rewrite-golden"):
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(text.encode("utf-8"))
        assert path.exists(), f"{path.name} is missing: run pytest with --rewrite-golden and read what it wrote"
        assert text == path.read_bytes().decode("utf-8"), f"{path.name} differs; read the difference, then rewrite it"

    return compare
