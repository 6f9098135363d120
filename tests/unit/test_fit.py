"""`fit`: finds the parameters that made a trace within its own intervals, and says what a trace does not determine."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.diagnostics import UsageError
from deshybrid.fit.fitting import fit_parameters
from deshybrid.fit.predictor import Doubt, build_predictor
from deshybrid.fit.stretches import Stretch, stretches_of
from deshybrid.fit.uncertainty import long_run, spread_of
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import parameter_text
from deshybrid.model.source import SourceModel, parse_source
from deshybrid.simulate.trace import Trace

STEP = 0.05
MODEL = """format: deshybrid/1
name: spinner
parameters:
  j: 2.0      # kg m^2, a wheel
  b: 0.6      # friction
  k: 8        # of its spring
  both: j*1   # not a number
state: [angle, speed]
input: [torque]
output: [angle, speed]
disturbance: [load]
bounds: {state: 20, input: 5, disturbance: 2, measurement: {angle: 0.02, speed: 0.05}}
defaults: {C: [[1, 0], [0, 1]], B: [[0], [1/j]], E: [[0], [-1/j]]}
locations:
  sprung: {A: [[0, 1], [-k/j, -b/j]]}
  free:   {A: [[0, 1], [0, -b/j]]}
transitions: [{from: sprung, to: free, event: off}, {from: free, to: sprung, event: on}]
observer: {step: 0.05}
"""
TRUTH = {"j": 2.0, "b": 0.6, "k": 8.0}
START = parse_source(MODEL.replace("j: 2.0 ", "j: 1.6 ").replace("b: 0.6 ", "b: 1.0 ").replace("k: 8 ", "k: 9.5 "))
CALM = MODEL.replace("disturbance: 2", "disturbance: 0")  # nothing wanders: cheaper, where only that is asked


def made(seed: int, *, samples: int = 500, drift: float = 1.2, memory: float = 0.25) -> Trace:
    """A trace from the definition: exact steps, white noise, and a load that is an Ornstein-Uhlenbeck process."""
    generator = np.random.default_rng(seed)
    j, b, k = TRUTH["j"], TRUTH["b"], TRUTH["k"]
    torque = np.repeat(generator.uniform(-5.0, 5.0, samples // 10 + 1), 10)[:samples]
    truth = ["sprung" if (row // 100) % 2 == 0 else "free" for row in range(samples)]
    x, load, rows = np.array([0.5, 0.0]), 0.0, []
    for row in range(samples):
        rows.append(x + generator.standard_normal(2) * [0.01, 0.03])
        block = np.zeros((3, 3))
        block[0, 1], block[1, :2] = 1.0, (-k / j if truth[row] == "sprung" else 0.0, -b / j)
        block[1, 2] = (torque[row] - load) / j
        x = (expm(block * STEP) @ [*x, 1.0])[:2]
        decay = np.exp(-STEP / memory)
        load = decay * load + drift * np.sqrt(memory / 2.0 * (1.0 - decay**2)) * generator.standard_normal()
    time = STEP * np.arange(samples)
    return Trace(elaborate(START), time, torque[:, None], np.array(rows), (), tuple(truth))


def misses(traces: list[Trace], source: SourceModel) -> int:
    """How many of all intervals do not hold the number that made the trace."""
    count = 0
    for trace in traces:
        for estimate in fit_parameters(source, [trace], ["j", "b", "k"]).estimates:
            count += not estimate.interval[0] <= TRUTH[estimate.name] <= estimate.interval[1]
    return count


def test_the_parameters_that_made_a_trace_are_found_within_their_intervals():
    found = fit_parameters(START, [made(1, samples=150)], ["j", "k"])
    assert found.determined
    for estimate in found.estimates:
        assert estimate.interval[0] <= TRUTH[estimate.name] <= estimate.interval[1]
        assert abs(estimate.value - TRUTH[estimate.name]) < abs(estimate.start - TRUTH[estimate.name])
    assert found.noise["angle"] == pytest.approx(0.01, rel=0.25)
    assert found.noise["speed"] == pytest.approx(0.03, rel=0.25)
    assert found.correlation < 0.2


@pytest.mark.campaign
def test_intervals_of_95_percent_hold_the_truth_in_about_95_percent_of_traces():
    """Of 90 intervals 4.5 should miss; 12 or more do in 1 of 400 campaigns of independent ones."""
    calm = parse_source(START.text.text.replace("disturbance: 2", "disturbance: 0"))
    traces = [made(seed, samples=200, drift=1e-9) for seed in range(100, 130)]
    assert misses(traces, calm) < 12


@pytest.mark.campaign
def test_intervals_count_that_errors_correlate_where_a_load_wanders_that_the_model_leaves_out():
    """Of 90 intervals the curvature of the minimum alone misses the truth in 82."""
    calm = parse_source(START.text.text.replace("disturbance: 2", "disturbance: 0"))
    assert misses([made(seed) for seed in range(100, 130)], calm) <= 30


def level(numbers: np.ndarray) -> tuple[SourceModel, Trace]:
    """A model of which x := m, measured: the fit of m is that of a mean."""
    source = parse_source("""{format: deshybrid/1, parameters: {m: 1.5}, time: {step: 1}, state: [x], output: [y],
        disturbance: [], bounds: {state: 100, measurement: 0.1}, defaults: {C: [[1]]},
        locations: {on: {A: [[0]], f: [m]}}, transitions: [{from: on, to: on, event: a}]}""")
    rows = len(numbers)
    return source, Trace(
        elaborate(source), np.arange(float(rows)), np.zeros((rows, 0)), numbers[:, None], (), ("on",) * rows
    )


def test_the_robust_fit_of_a_level_is_hubers_estimate_written_from_its_definition():
    numbers = 2.0 + 0.1 * np.random.default_rng(5).standard_normal(60)
    numbers[[7, 21, 22, 40]] = [9.0, 8.0, -5.0, 12.0]
    source, trace = level(numbers)
    seen = numbers[1:]  # of the first sample nothing is known before it
    expected = float(seen.mean())
    for _ in range(3):
        limit = 1.345 * 1.4826 * float(np.median(np.abs([*(seen - expected), 0.0])))
        low, high = float(seen.min()), float(seen.max())
        for _ in range(60):
            expected = (low + high) / 2.0
            forces = sum(min(max(number - expected, -limit), limit) for number in seen)
            low, high = (expected, high) if forces > 0.0 else (low, expected)
    robust, squares = (fit_parameters(source, [trace], ["m"], loss=loss) for loss in ("huber", "squares"))
    assert robust.estimates[0].value == pytest.approx(expected, abs=2e-4)
    assert squares.estimates[0].value == pytest.approx(float(seen.mean()), abs=2e-3)
    assert abs(expected - 2.0) < 0.1 * abs(float(seen.mean()) - 2.0)
    assert robust.outliers == pytest.approx(np.mean(np.abs([*(seen - expected), 0.0]) > limit))
    assert robust.noise["y"] == pytest.approx(0.1, rel=0.3)
    assert f"outliers: {100 * robust.outliers:.1f} % of the errors" in str(robust)


def test_outliers_widen_the_intervals_of_a_robust_fit_far_less_than_those_of_squares():
    numbers = 2.0 + 0.1 * np.random.default_rng(6).standard_normal(80)
    numbers[::20] += 5.0
    source, trace = level(numbers)
    robust, squares = (fit_parameters(source, [trace], ["m"], loss=loss).estimates[0] for loss in ("huber", "squares"))
    assert robust.interval[0] <= 2.0 <= robust.interval[1]
    assert 5.0 * robust.error < squares.error


def test_the_covariance_of_a_sum_is_that_of_all_pairs_within_the_lag():
    series = np.random.default_rng(1).standard_normal((30, 2))
    naive = np.zeros((2, 2))
    for i in range(30):
        for j in range(30):
            naive += max(0.0, 1.0 - abs(i - j) / 5.0) * np.outer(series[i], series[j])
    assert long_run(series, 4) == pytest.approx(naive)


def test_intervals_of_a_mean_hold_where_its_numbers_are_correlated():
    """Where each number keeps 0.7 of the one before, intervals for independent ones miss in 4 of 10 cases."""
    generator = np.random.default_rng(2)
    missed = alone = 0
    for _ in range(300):
        noise = generator.standard_normal(300)
        numbers = np.empty(300)
        numbers[0] = noise[0] / np.sqrt(1.0 - 0.49)
        for row in range(1, 300):
            numbers[row] = 0.7 * numbers[row - 1] + noise[row]
        mean = numbers.mean()
        spread = spread_of(np.ones((300, 1)), numbers - mean, np.arange(300))
        missed += bool(abs(mean) > spread.factor * np.sqrt(spread.covariance[0, 0]))
        alone += bool(abs(mean) > 1.96 * numbers.std() / np.sqrt(300))
    assert missed <= 300 // 10
    assert alone >= 300 // 3


def test_parameters_that_only_appear_as_a_quotient_are_not_determined():
    """A spring and a wheel that nothing known pushes: the period shows k/j, and the friction b/j."""
    source = parse_source(CALM.replace("B: [[0], [1/j]]", "B: [[0], [0]]").replace("[-1/j]", "[-1]"))
    found = fit_parameters(source, [made(1, samples=100)], ["j", "b", "k"], only=["sprung"])
    assert not found.determined
    assert all(np.isinf(estimate.error) for estimate in found.estimates)


def test_a_parameter_without_effect_is_told_apart_from_the_others():
    source = parse_source(CALM.replace("both: j*1   # not a number", "idle: 3.0"))
    found = fit_parameters(source, [made(2, samples=100)], ["j", "idle"])
    errors = {estimate.name: estimate.error for estimate in found.estimates}
    assert np.isinf(errors["idle"])
    assert np.isfinite(errors["j"])
    assert [p["standard_error"] is None for p in found.record()["parameters"]] == [False, True]


def test_the_whitened_errors_are_those_of_a_joint_gaussian():
    """Minus twice the log-likelihood of all samples at once, from the full covariance matrix, by naive sums."""
    dynamics = elaborate(START).location("sprung").dynamics
    one = np.ones(1)
    doubt = Doubt(np.array([0.1, 0.2]), 0.5 * one, 2.0 * one, np.array([0.02, 0.03]), 0.01 * one)
    count = 6
    stretch = Stretch("sprung", np.zeros((count, 1)), np.random.default_rng(0).standard_normal((count, 2)))
    predictor = build_predictor(dynamics, doubt, step=STEP, is_sampled=False, samples=count)
    white, log_size = predictor.errors(stretch)
    whole = np.zeros((3, 3))
    whole[:2, :2], whole[:2, 2], whole[2, 2] = dynamics.A, dynamics.E[:, 0], -0.5
    ticks = 4000
    small = expm(whole * STEP / ticks)
    P, Q = np.diag([2.0, 3.0, 1.0]) ** 2, np.zeros((3, 3))
    for _ in range(ticks):
        Q = small @ Q @ small.T + np.diag([0.0, 0.0, 0.25 * STEP / ticks])
    flow, C = expm(whole * STEP), np.eye(2, 3)
    moments = [P]
    for _ in range(count - 1):
        moments.append(flow @ moments[-1] @ flow.T + Q)
    S = np.zeros((2 * count, 2 * count))
    for i in range(count):
        for j in range(count):
            low = min(i, j)
            between = np.linalg.matrix_power(flow, abs(i - j))
            block = C @ (between @ moments[low] if i >= j else moments[low] @ between.T) @ C.T
            S[2 * i : 2 * i + 2, 2 * j : 2 * j + 2] = block + (np.diag([0.01, 0.04]) if i == j else 0.0)
    y = stretch.outputs.ravel()
    assert np.sum(white**2) == pytest.approx(y @ np.linalg.solve(S, y), rel=1e-4)
    assert log_size == pytest.approx(np.linalg.slogdet(S)[1], rel=1e-4)


def test_only_the_number_of_a_parameter_changes_in_the_model_file():
    changed = parameter_text(parse_source(MODEL), {"b": "0.65", "both": "2.5"})
    assert changed == MODEL.replace("b: 0.6 ", "b: 0.65 ").replace("both: j*1 ", "both: 2.5 ")


def test_stretches_are_cut_at_samples_that_were_not_measured_and_at_changes_of_location():
    trace = made(3, samples=200)
    outputs = trace.outputs.copy()
    outputs[30, 1] = np.nan
    gappy = Trace(trace.system, trace.time, trace.inputs, outputs, (), trace.true_location)
    found = stretches_of([gappy], only=["sprung", "free"], by_ratio=False)
    assert [(s.location, len(s.outputs)) for s in found] == [("sprung", 30), ("sprung", 69), ("free", 100)]
    assert [s.location for s in stretches_of([gappy], only=["free"], by_ratio=False)] == ["free"]


@pytest.mark.parametrize(
    ("names", "only", "code"),
    [(["m"], None, "DH0730"), (["j"], ["stuck"], "DH0720"), (["j"], [], "DH0733")],
    ids=["parameter", "location", "stretch"],
)
def test_what_cannot_be_fitted_is_refused(names, only, code):
    with pytest.raises(UsageError, match=code):
        fit_parameters(START, [made(1, samples=60)], names, only=only)


def test_a_trace_without_known_location_is_refused():
    trace = made(1, samples=60)
    with pytest.raises(UsageError, match="DH0732"):
        fit_parameters(START, [Trace(trace.system, trace.time, trace.inputs, trace.outputs)], ["j"])


def test_the_command_writes_the_model_and_tells_the_intervals(tmp_path: Path):
    from deshybrid.simulate.trace import write_trace

    (tmp_path / "model.yaml").write_text(CALM, encoding="utf-8")
    (tmp_path / "trace.csv").write_text(write_trace(made(4, samples=80)), encoding="utf-8")
    call = [sys.executable, "-m", "deshybrid.cli", "fit", "model.yaml", "--trace", "trace.csv", "--vary", "k"]
    done = subprocess.run(
        [*call, "--json", "-o", "new.yaml"], capture_output=True, text=True, cwd=tmp_path, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    record = json.loads(done.stdout)
    (found,) = record["parameters"]
    assert found["interval"][0] < found["estimate"] < found["interval"][1]
    lines = (tmp_path / "new.yaml").read_text(encoding="utf-8").splitlines()
    changed = [line for line, old in zip(lines, CALM.splitlines(), strict=True) if line != old]
    assert len(changed) == 1
    assert changed[0].startswith("  k: ")
    assert changed[0].endswith("# of its spring")
