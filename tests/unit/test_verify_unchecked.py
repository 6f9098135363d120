"""What a verifier says that it did not check: every key of a file is either checked or named."""

import copy
import json
import re
from collections.abc import Iterator
from typing import Any

import numpy as np
import pytest

from deshybrid.continuous.document import design_document
from deshybrid.continuous.dwell import certify_dwell, certify_sampled
from deshybrid.continuous.gains import design_gains
from deshybrid.des.signatures import recover_observability
from deshybrid.detector.candidates import discrete_candidates
from deshybrid.diagnostics import UsageError
from deshybrid.emit.records import recover_record
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import load
from deshybrid.verify.design import verify_design
from deshybrid.verify.plan import verify_plan
from deshybrid.verify.watched import Watched

Tree = dict[str, Any]


@pytest.fixture(scope="module")
def tank() -> Tree:
    """Without the ultimate bound, whose numbers have tests of their own."""
    system = load("models/two_tank.yaml")
    gains = design_gains(system, ("fill", "drain"))
    certificates = [certify_dwell(system, gains), certify_sampled(system, gains, step=0.01)]
    tree: Tree = json.loads(json.dumps(design_document(system, gains, certificates)))
    return tree


def numbers(tree: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The paths of all numbers but booleans."""
    children = tree.items() if isinstance(tree, dict) else enumerate(tree) if isinstance(tree, list) else ()
    for key, value in children:
        yield from numbers(value, (*path, key))
    if isinstance(tree, int | float) and not isinstance(tree, bool):
        yield path


def changed(tree: Tree, path: tuple[Any, ...], factor: float) -> Tree:
    found: Any = copy.deepcopy(tree)
    place = found
    for part in path[:-1]:
        place = place[part]
    place[path[-1]] = place[path[-1]] * factor + (factor - 1) * 0.7
    return dict(found)


def refused(tree: Tree) -> bool:
    try:
        return not verify_design(tree).holds
    except UsageError:
        return True


def named(path: tuple[Any, ...], unchecked: tuple[str, ...]) -> bool:
    """Whether a path or what it is a part of stands among the unchecked keys, whatever the numbers in it."""
    text = ".".join("*" if part in ("fill", "drain") else part for part in path if isinstance(part, str))
    keys = [re.sub(r"\[[^]]*\]", "", what.strip("`")) for what in unchecked]
    return any(f"{text}.".startswith(f"{key}.") for key in keys)


def test_a_number_of_a_design_that_no_change_gets_refused_is_named_as_unchecked(tank: Tree) -> None:
    """One number for each key, the first of a matrix; a bound may be loosened, so a change in some direction counts."""
    report = verify_design(tank)
    assert report.holds, str(report)
    seen = set()
    for path in numbers(tank):
        key = tuple(part for part in path if not isinstance(part, int))
        # Longest stays are assumed of the plant, and certificates by forms alone use them.
        assumed = path[:2] == ("system", "longest_stays")
        if key not in seen and not assumed and not named(path, report.unchecked):
            assert any(refused(changed(tank, path, factor)) for factor in (0.5, -2.0, 3.0)), path
        seen.add(key)
    assert len(seen) > 20


def test_an_added_or_unread_key_is_named_with_its_path(tank: Tree) -> None:
    tree = copy.deepcopy(tank)
    tree["system"]["mass"] = 3.0
    tree["certificates"][0]["terms"]["fill"]["extra"] = [1, 2]
    unchecked = verify_design(tree).unchecked
    assert "`system.mass`" in unchecked
    assert "`certificates[0].terms.*.extra`" in unchecked
    assert "`gains`" not in unchecked


def test_reading_is_remembered_below_lists_and_asking_for_a_key_is_no_reading() -> None:
    tree = Watched({"a": [{"b": 1, "c": 2}], "d": {"e": np.pi}, "f": []})
    assert "d" in tree
    entries = tree["a"]
    assert isinstance(entries, list)
    assert entries[0]["b"] == 1
    assert list(tree.unread()) == [("a", 0, "c"), ("d",)]


@pytest.mark.parametrize(("key", "other"), [("location", "elsewhere"), ("transitions", [["2", "c", "4"]])])
def test_what_a_plan_tells_readers_of_a_signature_is_what_was_checked(key: str, other: object) -> None:
    des = abstract(load("models/balluchi2012/fig3.yaml"))
    plan = recover_observability(des, tuple(entry.candidate for entry in discrete_candidates(des)))
    record = recover_record(plan, {signature.name: "unknown" for signature in plan.signatures})
    tree: Tree = json.loads(json.dumps(record))
    assert verify_plan(tree).holds
    assert not any(key in what or "already_observable" in what for what in verify_plan(tree).unchecked)
    tree["signatures"][0][key] = other
    assert [check.inequality for check in verify_plan(tree).refused] == [f"`{key}` is that of what was checked"]
    assert not verify_plan({**tree, "already_observable": True}).holds
