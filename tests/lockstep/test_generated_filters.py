"""Generated filters beside their reference step, bit for bit, and the reference step beside the filters of numpy."""

import ctypes
import json
import math
import shutil
import subprocess
import sys
from pathlib import Path

import harness
import numpy as np
import pytest

from deshybrid.bundle import Wishes
from deshybrid.diagnostics import ModelError, UsageError
from deshybrid.emit.filter_vectors import flat_constants, new_filter, record_rows
from deshybrid.emit.filters import FilterModel, emit_filter_c, emit_filter_python
from deshybrid.emit.provenance import Provenance
from deshybrid.filter_bundle import files
from deshybrid.stochastic import stepwise, stepwise_numbers, stepwise_values
from deshybrid.stochastic.record import estimate, estimate_known
from deshybrid.stochastic.system import Mode, StochasticSystem
from tests.strategies import drawn_record, random_stochastic_system

ROOT = Path(__file__).parents[2]
ORIGIN = Provenance("small", "models/small.yaml", "3f9c" * 16, "0.1.0")
KINDS = ["imm", "mmae", "skf"]
needs_compiler = pytest.mark.skipif(shutil.which("gcc") is None, reason="no C compiler")


def random_model(seed: int, kind: str, gate: float | None = None) -> FilterModel:
    """A random system; for `skf` the first mode measures the first output only."""
    system = random_stochastic_system(np.random.default_rng(seed))
    if kind == "skf":
        first = system.modes[0]
        blind = Mode(
            first.name, F=first.F, H=first.H[:1], Q=first.Q, R=first.R[:1, :1], B=first.B, D=first.D[:1], f=first.f,
            g=first.g[:1],
        )  # fmt: skip
        system = StochasticSystem([blind, *system.modes[1:]], system.chain, x=system.x, P=system.P, mu=system.mu)
    n, p, m = len(system.x), system.bank.H.shape[1], system.bank.B.shape[2]
    names = ([f"{kind}{i}" for i in range(size)] for kind, size in (("x", n), ("u", m), ("y", p)))
    return FilterModel(system, kind, *(tuple(group) for group in names), gate)


def write(folder: Path, model: FilterModel, real: str = "double") -> None:
    texts = emit_filter_c(model, prefix="small", real=real, provenance=ORIGIN)
    for name, text in (texts | emit_filter_python(model, prefix="small", provenance=ORIGIN)).items():
        (folder / name).write_text(text)


def run_c(folder: Path, model: FilterModel, real: str, rows) -> list:
    """What the C code, loaded as a library, makes of the rows."""
    command = ["gcc", "-std=c99", "-O2", *harness.STRICT, "-shared", "-fPIC", "-o", "small.so", "small.c"]
    subprocess.run(command, cwd=folder, check=True)
    library = ctypes.CDLL(str(folder / "small.so"))
    number = ctypes.c_double if real == "double" else ctypes.c_float
    n, M = len(model.state_names), len(model.system.names)

    class Input(ctypes.Structure):
        _fields_ = (
            ("u", number * max(len(model.input_names), 1)),
            ("y", number * len(model.output_names)),
            *([("location", ctypes.c_int32)] if model.kind == "skf" else []),
        )

    class Output(ctypes.Structure):
        _fields_ = (
            ("x", number * n), ("P", number * (n * n)), ("mu", number * M), ("told", number * 2),
            ("location", ctypes.c_int32), ("status", ctypes.c_int32),
        )  # fmt: skip

    state, output, found = (ctypes.c_double * 4000)(), Output(), []
    library.small_init(state)
    for row in rows:
        given = Input()
        given.u[: len(row.u)], given.y[:] = row.u, row.z
        if model.kind == "skf":
            given.location = row.mode
        if row.reset:
            library.small_reset(state)
        library.small_step(state, ctypes.byref(given), ctypes.byref(output))
        found.append((output.status, *(tuple(part) for part in (output.x, output.P, output.mu, output.told))))
    return found


@needs_compiler
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gate", [None, 0.9], ids=["no gate", "gate"])
def test_c_and_reference_agree_bit_for_bit_over_600_rows_of_random_systems(seed, kind, gate, tmp_path):
    real = ("double", "float")[seed % 2]
    model = random_model(seed, kind, gate)
    rows = record_rows(model.system, kind, seed=seed, count=600, real=real, reset_every=250, gate=gate)
    write(tmp_path, model, real)
    expected = [(row.status, row.x, row.P, row.mu, row.told) for row in rows]
    assert repr(run_c(tmp_path, model, real, rows)) == repr(expected)


def test_recorded_rows_hold_holes_restarts_of_the_input_and_wrong_locations():
    """What the comparison above goes through."""
    model = random_model(0, "skf")
    rows = record_rows(model.system, "skf", seed=0, count=1000, gate=0.9)
    assert {0, 2, 3, 4} <= {row.status for row in rows}
    assert any(math.isnan(value) for row in rows for value in row.z)
    assert any(math.isinf(value) for row in rows for value in row.z)


@needs_compiler
@pytest.mark.parametrize("standard", harness.STANDARDS)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("gate", [None, 0.99], ids=["no gate", "gate"])
def test_filters_compile_without_a_warning_and_pass_their_self_test_in(standard, kind, gate, tmp_path):
    write(tmp_path, random_model(7, kind, gate))
    flags = harness.SANITIZERS if standard in ("c99", "c++17") else ()
    program = harness.build(tmp_path, "self", ["small.c", "small_selftest.c"], standard, flags)
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.startswith("small: ok, 120 rows equal the reference bit for bit in double")
    stated = next(line for line in (tmp_path / "small.h").read_text().splitlines() if "bytes of state" in line)
    assert stated.split()[2] == done.stdout.split()[-2]


@needs_compiler
def test_filters_need_no_library_at_all(tmp_path):
    write(tmp_path, random_model(1, "imm"))
    harness.build(tmp_path, "small.o", ["small.c"], flags=["-c", "-O0"])
    done = subprocess.run(["nm", "-u", "small.o"], cwd=tmp_path, capture_output=True, text=True, check=True)
    assert done.stdout == ""


@needs_compiler
def test_the_self_test_of_a_filter_fails_when_a_constant_was_changed(tmp_path):
    write(tmp_path, random_model(1, "imm"))
    source = (tmp_path / "small.c").read_text()
    table = source[source.index("static const real Q[]") :].split("\n")[1]
    (tmp_path / "small.c").write_text(source.replace(table, "    1" + table.strip()))
    program = harness.build(tmp_path, "self", ["small.c", "small_selftest.c"])
    done = subprocess.run([program], capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "differs from the reference" in done.stdout


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("gate", [None, 0.99], ids=["no gate", "gate"])
def test_generated_python_filter_runs_its_self_test_without_any_package(kind, gate, tmp_path):
    write(tmp_path, random_model(3, kind, gate))
    command = [sys.executable, "-S", "-E", "-W", "error", "small.py"]
    done = subprocess.run(command, cwd=tmp_path, capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "small: ok, 120 rows equal the reference bit for bit\n"


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("kind", ["imm", "mmae"])
@pytest.mark.parametrize("gate", [None, 0.9], ids=["no gate", "gate"])
def test_reference_step_of_unknown_modes_is_the_filter_of_numpy(seed, kind, gate):
    rng = np.random.default_rng(seed)
    model = FilterModel(random_stochastic_system(rng), kind, (), (), (), gate)
    system = model.system
    z, u = drawn_record(rng, system, rows=40)
    z[10:12] = np.nan
    z[20:30] += 50.0
    assert_same(model, z, u, estimate(system, z, u, method=kind, gate=gate))


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("gate", [None, 0.9], ids=["no gate", "gate"])
def test_reference_step_of_the_switching_filter_is_the_filter_of_numpy(seed, gate):
    rng = np.random.default_rng(seed)
    model = random_model(seed, "skf", gate)
    z, u = rng.standard_normal((40, len(model.output_names))), rng.standard_normal((40, len(model.input_names)))
    z[10:12] = np.nan
    z[20:30] += 50.0
    modes = rng.integers(0, len(model.system.modes), 40)
    expected = estimate_known(model.system, z, modes, u, gate=gate)
    assert_same(model, z, u, expected, modes)


def assert_same(model, z, u, expected, modes=None):
    """Row by row what numpy makes of the record, and which rows were left out or taken beyond the gate."""
    kind = model.kind
    c = flat_constants(model.system, kind, "double", gate=model.gate)
    state, room, out = new_filter(c, kind)
    step = {"imm": stepwise.imm, "mmae": stepwise.mmae, "skf": stepwise.known}[kind]
    scale = max(1.0, np.abs(expected.P).max(), np.abs(expected.x).max())
    for k in range(len(z)):
        given = () if modes is None else (int(modes[k]),)
        status = step(c, state, room, out, u[k].tolist(), z[k].tolist(), *given)
        wanted = {(True, False): stepwise_values.OUTLIER, (False, True): stepwise_values.READMITTED}
        assert status == wanted.get((bool(expected.gated[k]), bool(expected.readmitted[k])), stepwise_values.OK), k
        np.testing.assert_allclose(out.x, expected.x[k], rtol=0, atol=1e-9 * scale)
        np.testing.assert_allclose(out.P, expected.P[k].ravel(), rtol=0, atol=1e-9 * scale)
        if kind != "skf":
            np.testing.assert_allclose(state.mu, expected.mu[k], rtol=0, atol=1e-9)
        np.testing.assert_allclose(out.told, [expected.log_likelihood[k], expected.nis[k]], rtol=1e-8, atol=1e-8)


@pytest.mark.parametrize(("real", "bound"), [("double", 1e-15), ("float", 5e-7)])
def test_own_exponential_and_logarithm_are_those_of_the_library(real, bound):
    c = flat_constants(random_stochastic_system(np.random.default_rng(0)), "imm", real)
    number = float if real == "double" else np.float32
    for k in range(2000):
        small = number(-(1.0139**k * 1e-9 % (600.0 if real == "double" else 70.0)))
        assert abs(float(stepwise_numbers.exp(c.powers, c.least, small)) / math.exp(float(small)) - 1.0) < bound
        wide = number(10.0 ** ((k - 1000) * (0.3 if real == "double" else 0.036)))
        exact = math.log(float(wide))
        assert abs(float(stepwise_numbers.log(c.powers, wide)) - exact) <= bound * max(1.0, abs(exact))
    assert stepwise_numbers.exp(c.powers, c.least, number(-1e30)) == 0.0


def test_a_filter_whose_numbers_run_away_starts_again_and_says_so():
    mode = Mode("m", F=[[1e20]], H=[[1.0]], Q=[[1.0]], R=[[1.0]])
    chain = random_stochastic_system(np.random.default_rng(0)).chain
    system = StochasticSystem([mode], type(chain)(("m",), [[1.0]]), x=[1.0], P=[[1.0]], mu=[1.0])
    c = flat_constants(system, "imm", "double")
    state, room, out = new_filter(c, "imm")
    assert stepwise.imm(c, state, room, out, [], [math.nan]) == stepwise_values.RESTARTED
    assert (out.x, out.P, out.told) == ([1.0], [1.0], [0.0, 0.0])


def test_the_same_model_gives_the_same_files_and_the_command_writes_them(tmp_path):
    path = ROOT / "models/hwang2006/turn.yaml"
    first, second = (files(str(path), "imm", Wishes()) for _ in range(2))
    assert first == second
    words = ["compile", str(path), "--filter", "imm", "-o", str(tmp_path)]
    done = subprocess.run([sys.executable, "-m", "deshybrid.cli", *words], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert {name: (tmp_path / name).read_bytes() for name in first} == first


def test_a_gate_is_in_the_code_and_in_the_manifest():
    path = str(ROOT / "models/hwang2006/turn.yaml")
    plain, gated = (files(path, "mmae", Wishes(), gate=gate) for gate in (None, 0.9999))
    assert json.loads(gated["MANIFEST.json"])["options"]["gate"] == 0.9999
    assert b"Gate of 0.9999" in gated["c/turn.h"]
    assert b"gate_limits" in gated["c/turn.c"]
    assert b"gate" not in plain["c/turn.c"].lower()


@pytest.mark.parametrize("words", [("--filter", "rmimm"), ("--gate", "0.99")], ids=["rmimm", "no filter"])
def test_a_filter_that_is_not_generated_is_refused_with_its_reason(tmp_path, words):
    command = ["compile", str(ROOT / "models/hwang2006/turn.yaml"), *words, "-o", str(tmp_path / "out")]
    done = subprocess.run(
        [sys.executable, "-m", "deshybrid.cli", *command], capture_output=True, text=True, check=False
    )
    assert (done.returncode, "error[DH1113]" in done.stderr) == (2, True)
    assert not (tmp_path / "out").exists()


def test_a_model_without_probabilities_and_modes_with_different_outputs_have_no_imm():
    with pytest.raises(ModelError) as caught:
        files(str(ROOT / "models/balluchi2012/driveline.yaml"), "imm", Wishes())
    assert {found.code for found in caught.value.diagnostics} == {"DH1101"}
    with pytest.raises(UsageError) as refused:
        flat_constants(random_model(0, "skf").system, "imm", "double")
    assert refused.value.diagnostics[0].code == "DH1103"
