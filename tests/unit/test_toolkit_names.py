"""`import deshybrid.des as des` has the whole toolkit, typed, and loads of it what is used."""

import importlib
import pathlib
import re
import subprocess
import sys

import pytest

from deshybrid import des
from deshybrid.des import _MODULES

SOURCE = pathlib.Path(des.__file__).read_text(encoding="utf-8")


@pytest.mark.parametrize("module", _MODULES)
def test_the_package_has_what_each_module_calls_its_own(module: str) -> None:
    """Type checkers see the names by `import *`, Python by the table: they are the same."""
    found = importlib.import_module(f"deshybrid.des.{module}")
    assert sorted(found.__all__) == sorted(_MODULES[module].split())
    assert f"from deshybrid.des.{module} import *" in SOURCE
    for name in found.__all__:
        assert getattr(des, name) is getattr(found, name)


def test_type_checkers_see_no_module_that_the_table_lacks() -> None:
    assert set(re.findall(r"from deshybrid\.des\.(\w+) import \*", SOURCE)) == set(_MODULES)


def test_no_name_is_that_of_a_module() -> None:
    """A module's name in a package is overwritten when the module is loaded."""
    modules = {path.stem for path in pathlib.Path(des.__file__).parent.glob("*.py")}
    assert modules.isdisjoint(des.__all__)


def test_every_function_of_the_table_of_questions_is_there() -> None:
    page = (pathlib.Path(des.__file__).parents[2] / "docs" / "python" / "des.md").read_text(encoding="utf-8")
    rows = [row.split("|") for row in page.splitlines() if row.startswith("| ")]
    functions = {name for row in rows for name in re.findall(r"`(\w+)`", row[2])}
    assert {"accessible", "diagnosability", "initial_state_opacity"} <= functions <= set(des.__all__)


def test_an_unknown_name_is_refused_and_all_known_ones_are_listed() -> None:
    with pytest.raises(AttributeError, match="no attribute 'nonsense'"):
        des.nonsense  # type: ignore[attr-defined]  # noqa: B018
    assert set(des.__all__) <= set(dir(des))


def test_only_what_is_used_is_loaded() -> None:
    code = "import sys, deshybrid.des as des; des.trim; print('deshybrid.des.languages' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"
