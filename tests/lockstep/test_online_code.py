"""Generated C and Python of the on-line tracker: equal to the reference, within their stated bytes and looks."""

import json
import re
import subprocess
from collections.abc import Callable
from pathlib import Path

import harness
import pytest
from random_tables import tables_of_plan

from benchmarks.families import observable_from_the_end, observable_sparse
from deshybrid import compiler
from deshybrid.emit.ctables import c_tables, cost
from deshybrid.emit.vectors import record_vectors
from deshybrid.model.abstraction import discrete_model
from deshybrid.model.load import loads
from deshybrid.model.system import HybridSystem
from deshybrid.observer.tables import StepTables

MODELS = Path(__file__).parents[2] / "models"
SEED = 20  # of a plan with more than 32 locations that a signature may be due for
needs_compiler = pytest.mark.skipif(bool(harness.missing_compiler()), reason=harness.missing_compiler() or "present")


def late() -> StepTables:
    """More than a word of locations and of pairs that wait, with negations."""
    tables = tables_of_plan(SEED, as_events=False, max_states=0, locations=60)
    assert tables.online is not None
    assert len(tables.online.waiting) > 32
    assert len(tables.location_names) > 32
    return tables


def events() -> StepTables:
    """Signatures as events: nothing is heard, nothing times out, but something may be due."""
    tables = tables_of_plan(SEED, as_events=True, max_states=0, locations=60)
    assert tables.online is not None
    assert tables.online.waiting
    return tables


def commands() -> StepTables:
    """Moves that need commands, and signatures that are heard late."""
    tables = tables_of_plan(SEED, as_events=False, max_states=0, locations=40, commands=True)
    assert tables.online is not None
    assert any(tables.online.conditional)
    return tables


def on_line(system: HybridSystem | Path, *, max_states: int = compiler.MAX_TABLE) -> StepTables:
    made = compiler.compile(system, max_states=max_states)
    assert made.observer is not None
    assert made.observer.tables.online is not None
    return made.observer.tables


def plant(arcs: list[tuple[str, str, str, str | None]], initial: list[str]) -> HybridSystem:
    """A plant with one state that decays at another rate in each location."""
    names = list(dict.fromkeys(name for source, _, target, _ in arcs for name in (source, target)))
    tree = {
        **{"format": "deshybrid/1", "name": "plant", "state": ["x"], "output": ["y"], "defaults": {"C": [[1]]}},
        "locations": {name: {"A": [[-1.0 - 0.2 * number]]} for number, name in enumerate(names)},
        "initial": initial or names,
        "bounds": {"state": 10, "measurement": 0.01},
        "observer": {"rate": 0.5, "dwell": 0.4, "step": 0.01},
        "transitions": [{"from": p, "event": e, "to": q, "emits": shown} for p, e, q, shown in arcs],
    }
    return loads(json.dumps(tree))


def remembering() -> HybridSystem:
    """92 locations whose observer would have more than 2^12 states."""
    des = observable_from_the_end(12)
    return plant([(t.source, t.event, t.target, t.outputs[0]) for t in des.transitions], list(des.initial))


def ring_with_chords() -> HybridSystem:
    """Twelve locations with two outputs: seven signatures, each after its output."""
    ring = [(f"q{i}", "next", f"q{(i + 1) % 12}", "αβ"[i % 2]) for i in range(12)]
    chords = [(f"q{i}", "jump", f"q{(7 * i + 3) % 12}", "αβ"[i % 2]) for i in range(12)]
    return plant([*ring, *chords], [])


VALVE = (
    (MODELS / "two_tank.yaml")
    .read_text()
    .replace("transitions:", "commands: {valve: [shut, ajar, open]}\ntransitions:")
    .replace("event: open,", "event: open, when: {valve: [ajar, open]},")
    .replace("event: close,", "event: close, when: {valve: shut},")
)
LAMP = """
{format: deshybrid/1, name: lamp, commands: {power: [on, off], "colour/hue": [red, blue, red blue]},
 locations: [dark, red, blue], transitions: [
  {from: dark, to: red, event: press, emits: click, when: {power: on, colour/hue: red}},
  {from: dark, to: blue, event: press, emits: click, when: {power: on, colour/hue: [blue, red blue]}},
  {from: red, to: dark, event: release, emits: [click, clack]}, {from: blue, to: dark, event: release, emits: click}]}
"""


CASES: dict[str, Callable[[], StepTables]] = {
    "2^40 observer states": lambda: on_line(discrete_model(observable_from_the_end(40))),
    "1,000 random locations": lambda: on_line(discrete_model(observable_sparse(1000, silent=0.05))),
    "a large hybrid plant": lambda: on_line(remembering()),
    "a hybrid plant with late signatures": lambda: on_line(ring_with_chords(), max_states=20),
    "driveline": lambda: on_line(MODELS / "balluchi2012" / "driveline.yaml", max_states=1),
    "Figure 3": lambda: on_line(MODELS / "balluchi2012" / "fig3.yaml", max_states=1),
    "two tanks": lambda: on_line(MODELS / "two_tank.yaml", max_states=1),
    "two tanks with a known valve": lambda: on_line(loads(VALVE)),
    "a lamp with two commands": lambda: on_line(loads(LAMP)),
    "late signatures": late,
    "signatures as events": events,
}


@needs_compiler
@pytest.mark.parametrize("case", CASES)
def test_c_python_and_reference_agree_bit_for_bit_on_line(case: str, tmp_path: Path) -> None:
    harness.assert_lockstep(tmp_path, CASES[case](), count=1000)


@needs_compiler
@pytest.mark.parametrize("seed", range(8))
def test_c_python_and_reference_agree_bit_for_bit_on_line_for_random_plans(seed: int, tmp_path: Path) -> None:
    tables = tables_of_plan(seed, as_events=seed % 4 == 3, max_states=0)
    harness.assert_lockstep(tmp_path, tables, count=2000)


@needs_compiler
@pytest.mark.parametrize("seed", range(8))
def test_c_python_and_reference_agree_bit_for_bit_where_commands_are_known(seed: int, tmp_path: Path) -> None:
    tables = tables_of_plan(seed, as_events=seed % 4 == 3, max_states=1000, commands=True)
    harness.assert_lockstep(tmp_path, tables, count=2000)


@needs_compiler
@pytest.mark.parametrize("tables", [late, events, commands])
@pytest.mark.parametrize("standard", harness.STANDARDS)
def test_self_test_passes_in_every_standard_under_sanitizers(
    standard: str, tables: Callable[[], StepTables], tmp_path: Path
) -> None:
    harness.write_c(tmp_path, tables())
    program = harness.build(tmp_path, "self", ["small.c", "small_selftest.c"], standard, harness.SANITIZERS)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("small: ok, 400 samples")


@needs_compiler
@pytest.mark.parametrize("real", ["double", "float"])
def test_c_equals_the_reference_on_line_in_single_precision_too(real: str, tmp_path: Path) -> None:
    tables = late()
    vectors = record_vectors(tables, seed=7, count=1000, real=real, reset_every=300)  # type: ignore[arg-type]
    harness.write_c(tmp_path, tables, real=real)
    program = harness.build(tmp_path, "driver", ["small.c", "driver.c"])
    assert harness.run_c(tmp_path, program, vectors, real=real) == harness.expected_estimates(
        tables, vectors, real=real
    )


@needs_compiler
@pytest.mark.parametrize("tables", [late, events, commands])
def test_header_states_the_bytes_that_the_compiler_uses_on_line(
    tables: Callable[[], StepTables], tmp_path: Path
) -> None:
    price = cost(tables(), c_tables(tables(), "double"), "double")
    header = harness.assert_stated_bytes(tmp_path, tables())
    assert f"{price.memberships} looks into the set of pairs" in header


@needs_compiler
@pytest.mark.parametrize("case", CASES)
def test_no_step_looks_into_the_set_more_often_than_the_header_says(case: str, tmp_path: Path) -> None:
    tables = CASES[case]()
    harness.write_c(tmp_path, tables)
    source, driver = tmp_path / "small.c", tmp_path / "driver.c"
    counted = source.read_text().replace("member)\n{\n    return (int)", "member)\n{\n    ++looks;\n    return (int)")
    source.write_text("long looks;\n" + counted)
    text = driver.read_text().replace("int main", "extern long looks;\n\nint main")
    text = re.sub(r"(\n +)(small_step\(.*\);)", r"\1looks = 0;\1\2\1most = looks > most ? looks : most;", text)
    text = text.replace("    int32_t head[4];", "    int32_t head[4];\n    long most = 0;")
    driver.write_text(text.replace("    fclose(in);", '    printf("%ld", most);\n    fclose(in);'))
    program = harness.build(tmp_path, "driver", ["small.c", "driver.c"])
    (tmp_path / "in").write_bytes(harness.sample_bytes(record_vectors(tables, seed=3, count=1000), "double"))
    done = subprocess.run([program, "in", "out"], cwd=tmp_path, capture_output=True, text=True, check=True)
    stated = cost(tables, c_tables(tables, "double"), "double").memberships
    assert 0 < int(done.stdout) <= stated
    # The bound is for all pairs due at once: where signatures come late, random samples reach 1/9 or 1/11 of it only.
    assert "late signatures" in case or stated <= 8 * int(done.stdout)


def test_a_thousand_locations_take_a_small_part_of_the_bytes_of_a_table() -> None:
    system = discrete_model(observable_sparse(1000, silent=0.05))
    table = compiler.compile(system, max_states=100_000).observer
    assert table is not None
    small, large = (cost(tables, c_tables(tables, "double"), "double") for tables in (on_line(system), table.tables))
    assert small.table_bytes + small.state_bytes < large.table_bytes / 10
