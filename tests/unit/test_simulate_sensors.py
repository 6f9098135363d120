"""Sensors of any channel, and chance where a model states covariances."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import solve_continuous_lyapunov

from deshybrid.model.load import load, loads
from deshybrid.model.system import HybridSystem, MeasurementModel
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.sensors import read_sensor
from deshybrid.simulate.trace import write_trace
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.record import estimate_known

TICK = 0.01
ROWS = np.arange(0, 1000, 10)
RAMP = np.arange(1000) * TICK


def read(sensor: MeasurementModel, values: np.ndarray) -> np.ndarray:
    return read_sensor(sensor, values, ROWS, TICK, np.random.default_rng(5))


def test_lag_answers_a_step_by_the_exponential_of_its_time_constant() -> None:
    step = np.where(RAMP >= 1.0, 1.0, 0.0)
    expected = np.where(ROWS >= 100, 1.0 - np.exp(-(ROWS - 100) * TICK / 0.3), 0.0)
    assert np.allclose(read(MeasurementModel(lag=0.3), step), expected, atol=1e-12)


def test_lag_of_a_ramp_ends_as_a_delay_of_the_time_constant() -> None:
    error = RAMP[ROWS] - read(MeasurementModel(lag=0.5), RAMP)
    assert error[-1] == pytest.approx(0.5, abs=TICK)


def test_sensor_holds_what_it_took_at_its_own_rate_and_with_its_noise() -> None:
    held = read(MeasurementModel(period=0.3), RAMP)
    assert np.allclose(held, np.floor(ROWS / 30) * 0.3)
    noisy = read(MeasurementModel(period=0.3, noise=1.0), np.zeros(1000))
    assert all(len(set(noisy[start : start + 3])) == 1 for start in range(0, 99, 3))
    assert len(set(noisy)) == 34


def test_bias_is_added_after_the_delay_and_before_rounding() -> None:
    assert read(MeasurementModel(bias=0.3, quantum=0.5), np.zeros(1000)).tolist() == [0.5] * 100
    assert read(MeasurementModel(bias=2.0, delay=0.1), RAMP)[1] == 2.0


TANK = """
format: deshybrid/1
state: [h]
input: [u]
output: [y]
bounds: {disturbance: 0, measurement: 0}
locations: {on: {A: [[-1]], B: [[1]], C: [[1]]}}
transitions: [{from: on, to: on, event: never, guard: "h > 1000"}]
observer: {step: 0.1}
simulation: {duration: 5, state: [0], input: {u: {points: [[0, 0], [1, 4]]}}%s}
"""


def test_sensor_of_an_input_distorts_the_trace_and_leaves_the_plant_alone() -> None:
    plain = simulate(loads(TANK % "")).trace
    told = simulate(loads(TANK % ", measurement: {u: {lag: 0.5, bias: -1}}")).trace
    assert told.true_state is not None
    assert np.array_equal(told.true_state, plain.true_state)
    time = told.time
    expected = np.where(time >= 1.0, 4.0 * (1.0 - np.exp(-(time - 1.0) / 0.5)), 0.0) - 1.0
    assert np.allclose(told.inputs[:, 0], expected, atol=1e-9)


TURN = load("models/hwang2006/turn.yaml")


def test_a_model_with_a_chain_is_simulated_as_its_filter_believes() -> None:
    """The NIS of the filter that knows the location is 1 on average; over 2,000 rows of 2 outputs within 0.07."""
    trace = simulate(TURN, seed=4, duration=2000).trace
    system, names = stochastic_system(TURN), [location.name for location in TURN.locations]
    assert trace.true_location is not None
    modes = [names.index(str(name)) for name in trace.true_location]
    nis = estimate_known(system, trace.outputs, modes).nis
    assert np.mean(nis) / 2 == pytest.approx(1.0, abs=0.07)
    switches = np.mean(np.diff(modes) != 0)
    assert switches == pytest.approx(0.05, abs=0.02)


def test_chance_follows_from_the_seed() -> None:
    first, again, other = (write_trace(simulate(TURN, seed=seed, duration=20).trace) for seed in (1, 1, 2))
    assert first == again
    assert first != other


def decaying(noise: str, more: str = "") -> HybridSystem:
    return loads(f"""
    {{format: deshybrid/1, state: [x1, x2], output: [y1, y2], {more}
     locations: {{on: {{A: [[-1, 0.5], [0, -2]], C: [[1, 0], [0, 1]]}}}}, noise: {noise},
     transitions: [{{from: on, to: on, event: never, guard: "x1 > 1000000"}}],
     observer: {{step: 0.5}}, simulation: {{duration: 2000, state: [0, 0]}}}}""")


def test_intensity_of_continuous_noise_gives_the_covariance_of_lyapunovs_equation() -> None:
    """A P + P Aᵀ + W = 0; 2,000 s are some 1,000 independent states, so variances are right to some 10 %."""
    trace = simulate(decaying("{process: [[1, 0.3], [0.3, 0.5]]}"), seed=1, substeps=1).trace
    A, W = np.array([[-1, 0.5], [0, -2]]), np.array([[1, 0.3], [0.3, 0.5]])
    expected = solve_continuous_lyapunov(A, -W)
    assert trace.true_state is not None
    assert np.allclose(np.cov(trace.true_state[20:].T), expected, rtol=0.12, atol=0.02)


def test_measurement_noise_has_the_covariance_of_the_location() -> None:
    R = [[0.04, 0.01], [0.01, 0.09]]
    trace = simulate(decaying(f"{{measurement: {R}}}", "bounds: {disturbance: 0},"), seed=2, substeps=1).trace
    assert trace.true_state is not None
    assert np.allclose(np.cov((trace.outputs - trace.true_state).T), R, rtol=0.08, atol=1e-3)


def test_what_a_bound_states_is_never_passed_by_noise() -> None:
    system = decaying("{process: [[1, 0], [0, 1]], measurement: [[1, 0], [0, 1]]}")
    tight = replace(system.bounds, disturbance=np.zeros(2), measurement=np.full(2, 0.01))
    trace = simulate(replace(system, bounds=tight), seed=3, duration=20, substeps=1).trace
    assert trace.true_state is not None
    assert np.abs(trace.true_state).max() == 0.0
    assert np.abs(trace.outputs).max() <= 0.01
