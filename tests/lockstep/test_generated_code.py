"""Generated C and Python against the reference step: compiled, run, and compared byte for byte."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import harness
import numpy as np
import pytest
from fixtures import small_tables
from random_tables import random_tables

from deshybrid import compiler
from deshybrid.emit.c import emit_c
from deshybrid.emit.python import emit_python
from deshybrid.emit.vectors import record_vectors
from deshybrid.observer.tables import FlowTables, GeneratorTables, StepTables, TrackerState

MODELS = Path(__file__).parents[2] / "models"
needs_compiler = pytest.mark.skipif(bool(harness.missing_compiler()), reason=harness.missing_compiler() or "present")


def discrete_tables() -> StepTables:
    """No state, no channel, no event, no signature, no generator, no reset: every dimension that may be zero is."""
    flow = [np.zeros(shape) for shape in [(1, 0, 0), (1, 0, 0), (1, 0, 0), (1, 0), (0,)]]
    generators = [np.zeros((0,) * axes) for axes in [3, 3, 3, 2, 3, 2, 3, 3, 3, 2, 2, 1]]
    return StepTables(
        *("nothing", 0.1, ("on",), (), (), (), (), ()),
        FlowTables(*flow, (False,)),
        GeneratorTables((), *generators, (), ()),
        (TrackerState((0,), 0, False, (), ()),),
        *(0, 0, (), 1, ((-1,),)),
        np.zeros((0, 0, 0)),
        np.zeros((0, 0)),
    )


def hostile_tables() -> StepTables:
    """The small tables under names that try to leave their string, their comment or their line."""
    return replace(
        small_tables(),
        name='*/ #error "name"',
        location_names=('a" "\\', "*/ #error /*", "??/\n\r\t{{ 7 * 7 }}"),
        state_names=("*/", "??/"),
        input_names=('"""',),
        output_names=("ω\u2028\u202e\ud800",),
        event_names=("a b", "a_b"),
        signature_names=("ünï1", "%s%n", "NONE"),
    )


@needs_compiler
def test_c_python_and_reference_agree_bit_for_bit_over_100000_samples(tmp_path):
    harness.assert_lockstep(tmp_path, small_tables(), count=100_000)


@needs_compiler
@pytest.mark.parametrize("count", [10_000, pytest.param(100_000, marks=pytest.mark.campaign)])
def test_c_python_and_reference_agree_bit_for_bit_on_the_driveline(count, tmp_path):
    compiled = compiler.compile(MODELS / "balluchi2012" / "driveline.yaml")
    assert compiled.observer is not None
    harness.assert_lockstep(tmp_path, compiled.observer.tables, count=count)


@needs_compiler
def test_c_python_and_reference_agree_bit_for_bit_where_locations_rely_on_each_other(tmp_path):
    compiled = compiler.compile(MODELS / "balluchi2003" / "three_locations.yaml")
    assert compiled.observer is not None
    harness.assert_lockstep(tmp_path, compiled.observer.tables, count=10_000)


@needs_compiler
@pytest.mark.parametrize("seed", range(12))
def test_c_python_and_reference_agree_bit_for_bit_on_random_tables_of_every_size(seed, tmp_path):
    harness.assert_lockstep(tmp_path, random_tables(seed), count=2000)


def test_recorded_samples_reach_every_state_status_signature_and_kind_of_event():
    vectors = record_vectors(small_tables(), seed=2012, count=4000)
    assert {v.tracker for v in vectors} == set(range(6))
    assert {v.status for v in vectors} == set(range(5))
    assert {v.signature for v in vectors} == {-1, 0, 1, 2}
    assert {v.event for v in vectors} == {-1, 0, 1, 2, 3, 2**31 - 1}


@needs_compiler
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("standard", harness.STANDARDS)
def test_c_compiles_without_a_warning_and_equals_the_reference_in(standard, real, tmp_path):
    tables = small_tables()
    vectors = record_vectors(tables, seed=7, count=2000, real=real, reset_every=700)
    harness.write_c(tmp_path, tables, real=real)
    program = harness.build(tmp_path, "driver", ["small.c", "driver.c"], standard)
    assert harness.run_c(tmp_path, program, vectors, real=real) == harness.expected_estimates(
        tables, vectors, real=real
    )


@needs_compiler
@pytest.mark.parametrize("tables", [small_tables, hostile_tables, discrete_tables])
@pytest.mark.parametrize("standard", ["c99", "c++17"])
def test_self_test_passes_under_address_and_undefined_behaviour_sanitizers(standard, tables, tmp_path):
    harness.write_c(tmp_path, tables())
    program = harness.build(tmp_path, "self", ["small.c", "small_selftest.c"], standard, harness.SANITIZERS)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("small: ok, 400 samples")


@needs_compiler
def test_make_test_builds_and_runs_the_self_test(tmp_path):
    harness.write_c(tmp_path, small_tables(), real="float")
    done = subprocess.run(["make", "test"], cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "small: ok, 400 samples equal the reference bit for bit in float" in done.stdout


@needs_compiler
def test_self_test_fails_and_says_where_when_a_constant_was_changed(tmp_path):
    harness.write_c(tmp_path, small_tables())
    source = tmp_path / "small.c"
    source.write_text(source.read_text().replace("0.9, 0.1, 0.01, 0.1,", "0.9000000000000001, 0.1, 0.01, 0.1,"))
    program = harness.build(tmp_path, "self", ["small.c", "small_selftest.c"])
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "FAILED" in done.stdout
    assert "x_hat differs from the reference" in done.stdout


@needs_compiler
def test_c_needs_no_library_at_all(tmp_path):
    harness.write_c(tmp_path, small_tables())
    harness.build(tmp_path, "small.o", ["small.c"], flags=["-c", "-O0"])
    done = subprocess.run(["nm", "-u", "small.o"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == ""


@needs_compiler
@pytest.mark.parametrize("real", ["double", "float"])
@pytest.mark.parametrize("tables", [small_tables, discrete_tables])
def test_header_states_the_bytes_that_the_compiler_uses(tables, real, tmp_path):
    harness.assert_stated_bytes(tmp_path, tables(), real=real)


_TWO_OBSERVERS = """\
#include "left.h"
#include "right.h"
#include <string.h>

int main(void)
{
    left_state_t first, second;
    right_state_t third;
    left_input_t input = {{0.1}, {0.2}, LEFT_EVENT_right};
    left_output_t alone, beside;
    right_input_t other = {{0.3f}, {-7.0f}, RIGHT_EVENT_left};
    right_output_t ignored;
    int i;
    left_init(&first);
    left_init(&second);
    right_init(&third);
    for (i = 0; i < 50; ++i) {
        left_step(&first, &input, &alone);
    }
    for (i = 0; i < 50; ++i) {
        left_step(&second, &input, &beside);
        right_step(&third, &other, &ignored);
    }
    if (strcmp(left_location_name(LEFT_LOCATION_b), "b") != 0 || left_location_name(99)[0] != 0) {
        return 2;
    }
    if (left_event_code("right") != 2 || left_event_code("righ") != -1 || left_event_code("") != -1) {
        return 3;
    }
    return memcmp(alone.x_hat, beside.x_hat, sizeof alone.x_hat) == 0 && alone.status == beside.status ? 0 : 1;
}
"""


@needs_compiler
@pytest.mark.parametrize("standard", ["c99", "c++17"])
def test_two_prefixes_and_two_instances_run_in_one_program(standard, tmp_path):
    harness.write_c(tmp_path, small_tables(), prefix="left")
    harness.write_c(tmp_path, small_tables(), prefix="right", real="float")
    (tmp_path / "two.c").write_text(_TWO_OBSERVERS)
    program = harness.build(tmp_path, "two", ["left.c", "right.c", "two.c"], standard, harness.SANITIZERS)
    assert subprocess.run([program], check=False).returncode == 0


@needs_compiler
def test_trace_hook_tells_events_moves_and_activity(tmp_path):
    tables = small_tables()
    harness.write_c(tmp_path, tables)
    (tmp_path / "hook.h").write_text(
        "#include <stdio.h>\n#define SMALL_TRACE(state, what, value) "
        'printf("%d %d %d\\n", (int)(state)->ticks, (int)(what), (int)(value))\n'
    )
    flags = ["-include", "hook.h"]
    program = harness.build(tmp_path, "driver", ["small.c", "driver.c"], flags=flags)
    vectors = record_vectors(tables, seed=5, count=300)
    (tmp_path / "samples").write_bytes(harness.sample_bytes(vectors, "double"))
    done = subprocess.run([program, "samples", "out"], cwd=tmp_path, capture_output=True, text=True, check=True)
    told = [tuple(map(int, line.split())) for line in done.stdout.splitlines()]
    assert [(tick, value) for tick, what, value in told if what == 0] == [
        (tick, vector.event) for tick, vector in enumerate(vectors) if vector.event != 0
    ]
    last_move = {tick: value for tick, what, value in told if what == 1}
    state = tables.initial
    for tick, vector in enumerate(vectors):
        state = last_move.get(tick, state)
        assert state == vector.tracker


@needs_compiler
def test_names_reach_the_c_program_as_written(tmp_path):
    tables = hostile_tables()
    harness.write_c(tmp_path, tables)
    (tmp_path / "names.c").write_text(
        '#include "small.h"\n#include <stdio.h>\nint main(void)\n{\n    int32_t i;\n'
        "    for (i = 0; i < SMALL_N_LOCATIONS; ++i) {\n        fputs(small_location_name(i), stdout);\n"
        "        putchar(0);\n    }\n    for (i = 0; i < SMALL_N_SIGNATURES; ++i) {\n"
        "        fputs(small_signature_name(i), stdout);\n        putchar(0);\n    }\n    return 0;\n}\n"
    )
    program = harness.build(tmp_path, "names", ["small.c", "names.c"])
    spoken = subprocess.run([program], capture_output=True, check=True).stdout
    assert spoken.decode().split("\0")[:-1] == [*tables.location_names, *tables.signature_names]


@pytest.mark.parametrize("tables", [small_tables, hostile_tables, discrete_tables])
def test_generated_python_runs_its_self_test_without_any_package(tables, tmp_path):
    harness.write_python(tmp_path, tables())
    command = [sys.executable, "-S", "-E", "-W", "error", "small.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "small: ok, 400 samples equal the reference bit for bit\n"


@pytest.mark.parametrize("name", ["small.h", "small.c", "Makefile", "CMakeLists.txt", "README.md"])
def test_generated_c_is_the_text_that_was_read_and_agreed(name, golden):
    golden(f"c/{name}", emit_c(small_tables(), prefix="small", provenance=harness.ORIGIN)[name])


_DIGEST = """\
import hashlib, sys
sys.path[:0] = [{folder!r}]
import harness
from fixtures import small_tables
from deshybrid.emit.c import emit_c
from deshybrid.emit.python import emit_python
files = emit_c(small_tables(), prefix="small", provenance=harness.ORIGIN)
files |= emit_python(small_tables(), prefix="small", provenance=harness.ORIGIN)
print(hashlib.sha256(repr(list(files.items())).encode()).hexdigest())
"""


def test_same_tables_give_the_same_bytes_under_three_hash_seeds():
    code = _DIGEST.format(folder=str(Path(__file__).parent))
    digests = {
        subprocess.run(
            [sys.executable, "-c", code], env={"PYTHONHASHSEED": seed}, capture_output=True, text=True, check=True
        ).stdout
        for seed in ("0", "1", "4711")
    }
    files = emit_c(small_tables(), prefix="small", provenance=harness.ORIGIN)
    assert len(files) == 6
    assert list(emit_python(small_tables(), prefix="small", provenance=harness.ORIGIN)) == ["small.py"]
    assert len(digests) == 1
