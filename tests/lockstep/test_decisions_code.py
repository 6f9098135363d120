"""Generated C and Python with every decision: equal to the reference bit for bit, within their stated bytes."""

import subprocess
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import harness
import pytest
from fixtures import small_tables
from random_tables import random_tables, tables_of_plan, with_decision

from deshybrid.emit.ctables import Real
from deshybrid.emit.vectors import record_vectors
from deshybrid.model.system import Decision
from deshybrid.observer.tables import STATUS_NAMES, StepTables

DECISIONS: tuple[Decision, ...] = ("exclusion", "sprt", "glr", "imm")
needs_compiler = pytest.mark.skipif(bool(harness.missing_compiler()), reason=harness.missing_compiler() or "present")


def late() -> StepTables:
    """An on-line tracker with negations and signatures that are waited for."""
    return tables_of_plan(20, as_events=False, max_states=0, locations=40)


KINDS: dict[str, Callable[[], StepTables]] = {"table": small_tables, "on line": late}


@needs_compiler
@pytest.mark.parametrize("tracker", KINDS)
@pytest.mark.parametrize("kind", DECISIONS)
def test_c_python_and_reference_agree_bit_for_bit(kind: Decision, tracker: str, tmp_path: Path) -> None:
    harness.assert_lockstep(tmp_path, with_decision(KINDS[tracker](), kind, 1), count=2000)


@needs_compiler
@pytest.mark.parametrize("kind", DECISIONS)
@pytest.mark.parametrize("seed", range(3))
def test_c_python_and_reference_agree_on_random_tables(kind: Decision, seed: int, tmp_path: Path) -> None:
    harness.assert_lockstep(tmp_path, with_decision(random_tables(seed), kind, seed), count=1000)


@pytest.mark.parametrize("kind", DECISIONS)
def test_recorded_samples_reach_every_state_and_the_way_back(kind: Decision) -> None:
    tables = with_decision(small_tables(), kind, 1)
    vectors = record_vectors(tables, seed=2012, count=6000)
    assert {vector.tracker for vector in vectors} == set(range(6))
    back = [
        after
        for before, after in pairwise(vectors)
        if tables.tracker[before.tracker].location >= 0
        and after.event == 0
        and STATUS_NAMES[after.status] == "inconsistent"
    ]
    assert back
    assert all(vector.tracker == tables.restart for vector in back)


@needs_compiler
@pytest.mark.parametrize("tracker", KINDS)
@pytest.mark.parametrize("kind", DECISIONS)
@pytest.mark.parametrize("standard", ["c99", "c++17"])
def test_self_test_passes_under_sanitizers(standard: str, kind: Decision, tracker: str, tmp_path: Path) -> None:
    harness.write_c(tmp_path, with_decision(KINDS[tracker](), kind, 1), real="float")
    program = harness.build(tmp_path, "self", ["small.c", "small_selftest.c"], standard, harness.SANITIZERS)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("small: ok, 400 samples")


@needs_compiler
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("kind", DECISIONS)
def test_header_states_the_bytes_that_the_compiler_uses(kind: Decision, real: Real, tmp_path: Path) -> None:
    tables = with_decision(small_tables(), kind, 1)
    assert "Decisions: " in harness.assert_stated_bytes(tmp_path, tables, real=real)


@needs_compiler
def test_c_with_a_test_needs_no_library_at_all(tmp_path: Path) -> None:
    harness.write_c(tmp_path, with_decision(small_tables(), "glr", 1))
    harness.build(tmp_path, "small.o", ["small.c"], flags=["-c", "-O0"])
    done = subprocess.run(["nm", "-u", "small.o"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == ""
