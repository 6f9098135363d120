"""What the page about correctness says is so: the numbers of systems, and what the mutants came to."""

import ast
import importlib
import re
from pathlib import Path
from types import ModuleType

import pytest

from tests.mutation.mutants import mutants, mutated
from tests.mutation.results import Entry, estimate, interval, reasons, results, score, table

PAGE = (Path(__file__).parents[2] / "docs" / "correctness.md").read_text(encoding="utf-8")
ROWS = re.findall(r"^\| .* \| .* \| ([\d,]+) \| `tests/(\w+)/(\w+)\.py::(\w+)` \|$", PAGE, re.MULTILINE)


@pytest.mark.parametrize(("systems", "folder", "module", "test"), ROWS, ids=[row[3] for row in ROWS])
def test_a_comparison_takes_as_many_systems_as_the_page_says(systems: str, folder: str, module: str, test: str) -> None:
    if folder == "crosscheck":
        pytest.importorskip("faudes")
    holder = importlib.import_module(f"tests.{folder}.{module}")
    assert taken(holder, test) == int(systems.replace(",", ""))


def taken(holder: ModuleType, test: str) -> int:
    batches = [mark.args[1] for mark in getattr(getattr(holder, test), "pytestmark", ()) if mark.args[0] == "first"]
    return len(batches[0]) * holder.BATCH if batches else len(holder.SEEDS)


def test_the_page_shows_what_the_mutants_came_to() -> None:
    shown = PAGE.split("<!-- mutation -->\n")[1].split("\n<!-- end -->")[0]
    assert shown == table()


def test_nine_mutants_of_ten_died_and_every_survivor_has_a_reason() -> None:
    killed, asked, _ = score(results().values())
    assert killed >= 0.9 * asked
    assert {key for entry in results().values() for key in entry["survived"]} == set(reasons())
    for entry in results().values():
        assert entry["killed"] + len(entry["survived"]) == entry["asked"] <= entry["mutants"]


def test_the_interval_of_wilson_holds_the_share_and_narrows_with_the_number() -> None:
    low, high = interval(0.95, 100)
    assert (low, high) == pytest.approx((0.8882, 0.9785), abs=1e-4)
    assert interval(0.95, 1000)[0] > low


def test_a_module_that_was_sampled_counts_by_its_size() -> None:
    small: Entry = {"mutants": 10, "asked": 10, "killed": 5, "survived": [str(number) for number in range(5)]}
    large: Entry = {"mutants": 90, "asked": 10, "killed": 10, "survived": []}
    assert estimate([small, large]) == pytest.approx(0.95)


SOURCE = '''"""A module."""
from typing import TypeAlias

Name: TypeAlias = int | None


def choose(numbers: list[int], best: bool = True) -> int | None:
    """Return one of them, or minus one."""
    for number in numbers:
        if not number or (best and number < 10):
            continue
        numbers.append(max(number + 1, 2))
    return -1
'''


def test_a_mutant_changes_one_thing_and_leaves_types_and_texts_alone() -> None:
    found = mutants("choose", SOURCE)
    changes = {(mutant.old, mutant.new) for mutant in found}
    assert changes == {
        ("True", "False"),
        ("not number or (best and number < 10)", "not number and (best and number < 10)"),
        ("if not number or (best and number < 10):", "if not (not number or (best and number < 10)):"),
        ("not number", "number"),
        ("best and number < 10", "best or number < 10"),
        ("number < 10", "number <= 10"),
        ("10", "11"),
        ("continue", "break"),
        ("numbers.append(max(number + 1, 2))", "pass"),
        ("max(number + 1, 2)", "min(number + 1, 2)"),
        ("number + 1", "number - 1"),
        ("1", "2"),
        ("2", "3"),
        ("return -1", "return None"),
        ("-1", "1"),
    }
    assert len({mutant.key for mutant in found}) == len(found)


def test_the_source_of_a_mutant_differs_in_the_line_it_names() -> None:
    whole = ast.unparse(ast.parse(SOURCE))
    for mutant in mutants("choose", SOURCE):
        lines = zip(whole.splitlines(), mutated(SOURCE, mutant).splitlines(), strict=True)
        assert sum(before != after for before, after in lines) == 1, mutant.key
