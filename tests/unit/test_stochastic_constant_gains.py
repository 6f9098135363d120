"""Switching Kalman filters with constant gains: one that diverges though every part of it is stable, and the remedy."""

from pathlib import Path

import numpy as np
import pytest

from deshybrid.diagnostics import GainError
from deshybrid.model.load import load
from deshybrid.stochastic import switching
from deshybrid.stochastic.constant_gains import ConstantGains, certify_constant_gains, constant_gain
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem

ROOT = Path(__file__).parents[2]
BOTH = ("by_first", "by_second")


def radius(matrix: np.ndarray) -> float:
    return float(np.abs(np.linalg.eigvals(matrix)).max())


@pytest.fixture(scope="module")
def sensors() -> StochasticSystem:
    return stochastic_system(load(ROOT / "models/boker/constant_gains.yaml"))


@pytest.fixture(scope="module")
def found(sensors: StochasticSystem) -> ConstantGains:
    return certify_constant_gains(sensors)


def test_each_mode_and_the_open_loop_decay_and_the_filter_with_constant_gains_diverges(
    sensors: StochasticSystem, found: ConstantGains
) -> None:
    first, second = (found.error[name] for name in BOTH)
    assert all(radius(mode.F) < 0.95 for mode in sensors.modes)
    assert np.array_equal(sensors.modes[0].F, sensors.modes[1].F)  # so that switching changes nothing of the open loop
    assert radius(first) < 1
    assert radius(second) < 1
    assert radius(first @ second) > 3.5
    assert found.diverges
    assert "the cycle by_first -> by_second with shorter ones does not" in str(found)


def test_stays_of_the_required_length_contract_and_those_of_the_witness_do_not(found: ConstantGains) -> None:
    """By products of matrices, independently of the certificate: random stays of at least that many steps."""
    least, rng = found.required_steps, np.random.default_rng(2)
    assert least == 4
    whole, steps = np.eye(2), 0
    for k in range(400):
        stay = least + int(rng.integers(3))
        whole, steps = np.linalg.matrix_power(found.error[BOTH[k % 2]], stay) @ whole, steps + stay
        if k % 50 == 49:
            assert np.linalg.norm(whole) < 1
    cycle = found.certificate.limit.cycle
    assert cycle is not None
    turn = np.eye(2)
    for name, stay in zip(cycle.locations, cycle.stays, strict=True):
        turn = np.linalg.matrix_power(found.error[name], round(stay)) @ turn
    assert radius(turn) >= 1
    assert cycle.stays == (3.0, 3.0)
    assert found.certificate.limit.value == 3.0


def test_the_filter_of_riccatis_recursion_stays_bounded_where_constant_gains_diverge(
    sensors: StochasticSystem, found: ConstantGains
) -> None:
    """The covariance of the error is computed for both ways, switching at every step."""
    P, kept, largest = sensors.P, sensors.P, 0.0
    for k in range(200):
        number = np.array(k % 2)
        mode = sensors.modes[k % 2]
        gain, M = found.predictor[mode.name], found.error[mode.name]
        kept = M @ kept @ M.T + gain @ mode.R @ gain.T + mode.Q
        filtered = switching.update(sensors, sensors.x, P, number, np.zeros(2))[0].P
        P = switching.predict(sensors, sensors.x, filtered, number)[1]
        largest = max(largest, float(np.trace(P)))
    assert largest < 100
    assert np.trace(kept) > 1e50


def test_constant_gains_are_the_limit_of_the_recursion(sensors: StochasticSystem) -> None:
    for number, mode in enumerate(sensors.modes):
        P = np.eye(2)
        for _ in range(300):
            made, _ = switching.update(sensors, sensors.x, P, np.array(number), np.zeros(2))
            P = switching.predict(sensors, sensors.x, made.P, np.array(number))[1]
        predictor, filtering = constant_gain(mode)
        column = list(mode.output_index)
        np.testing.assert_allclose(made.gain[:, column], filtering, rtol=1e-8)
        np.testing.assert_allclose(mode.F @ made.gain[:, column], predictor, rtol=1e-8)


def test_a_mode_that_nobody_measures_and_that_grows_has_no_constant_gain() -> None:
    blind = Mode("blind", F=[[1.1]], H=[[0.0]], Q=[[1.0]], R=[[1.0]])
    system = StochasticSystem((blind,), ModeTransition(("blind",), [[1.0]]), x=[0.0], P=[[1.0]], mu=[1.0])
    with pytest.raises(GainError) as raised:
        certify_constant_gains(system)
    assert raised.value.diagnostics[0].code == "DH0503"
