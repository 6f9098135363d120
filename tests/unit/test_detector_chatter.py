"""The hysteresis of relays against Rice's formula, the bivariate normal distribution and seeded noise."""

import numpy as np
import pytest
from scipy.stats import multivariate_normal, norm

from deshybrid import compiler
from deshybrid.detector.chatter import crossing_rate, hysteresis, switching_rate
from deshybrid.detector.detector import TransitionDetector, build_detector
from deshybrid.detector.levels import Part
from deshybrid.diagnostics import UsageError
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.load import loads

MODEL = """\
format: deshybrid/1
name: lever
state: [x, v]
input: [u]
output: [y]
disturbance: [w]
bounds: {state: 5, input: 1, disturbance: 0.2, measurement: 0.02}
noise: {process: [[0, 0], [0, 0.02]], measurement: [[0.0004]]}
defaults: {B: [[0], [1]], E: [[0], [1]], C: [[1, 0]]}
locations: {soft: {A: [[0, 1], [-1, -1]]}, hard: {A: [[0, 1], [-6, -1]]}}
transitions: [{from: soft, to: hard, event: a}, {from: hard, to: soft, event: b}]
observer: {dwell: 3, step: 0.05, detector: {decision: relay, threshold: 0.06, DETECTOR}}
"""
STEP = 0.05


def detector_of(wishes: str) -> TransitionDetector:
    system = loads(MODEL.replace(", DETECTOR", wishes))
    return build_detector(system, compiler.recover(system).plan, rate=1.0, step=STEP)


def parts_of(detector: TransitionDetector) -> list[Part]:
    made = zip(detector.generators, detector.thresholds, detector.on_ticks, strict=True)
    return [Part(*each, np.zeros((0, 0))) for each in made]


@pytest.mark.parametrize("correlation", [-0.6, 0.0, 0.5, 0.9, 0.99])
@pytest.mark.parametrize("level", [0.0, 0.7, 2.0, 3.5])
def test_the_crossing_rate_is_that_of_the_bivariate_normal_distribution(level: float, correlation: float) -> None:
    both = multivariate_normal([0, 0], [[1, correlation], [correlation, 1]]).cdf([level, level])
    assert crossing_rate(level, correlation, 0.1) == pytest.approx((norm.cdf(level) - both) / 0.1, rel=1e-3, abs=1e-7)


def test_for_short_steps_the_crossing_rate_tends_to_rices_formula() -> None:
    """Of a process with ρ(τ) = exp(-τ²/2), -ρ''(0) = 1."""
    step = 1e-4
    rice = np.exp(-(1.5**2) / 2) / (2 * np.pi)
    assert crossing_rate(1.5, np.exp(-(step**2) / 2), step) == pytest.approx(rice, rel=1e-3)


def test_a_rarer_false_alarm_needs_more_hysteresis_and_the_least_release_has_the_rate() -> None:
    often, seldom = (detector_of(f", false_alarm: {rate}") for rate in ("1e-1", "1/3600"))
    assert 1.0 < often.release < seldom.release
    worst = max(switching_rate(seldom.system, part, seldom.release) for part in parts_of(seldom))
    assert worst == pytest.approx(1 / 3600, rel=1e-6)
    assert "at most 0.000277778 times a second" in seldom.decision.reason
    (part, *_) = parts_of(often)
    assert switching_rate(often.system, part, hysteresis(often.system, part, 1e-1)) == pytest.approx(1e-1, rel=1e-6)


def switches(residuals: FloatArray, level: float, release: float) -> int:
    """How often a relay goes off and comes on again."""
    on, count = bool(abs(residuals[0]) <= level), 0
    for size in np.abs(residuals):
        now = bool(size <= (release * level if on else level))
        count += now and not on
        on = now
    return count


def noise_of(detector: TransitionDetector, samples: int) -> FloatArray:
    """The residual of the own location under the noise of the model, (samples,)."""
    from deshybrid.linear.sampling import sample_covariance

    g, rng = detector.generators[0], np.random.default_rng(11)
    pushed = rng.multivariate_normal([0, 0], sample_covariance(g.dynamics.A, np.diag([0, 0.02]), STEP), samples)
    heard, e, found = 0.02 * rng.normal(size=samples), np.zeros(len(g.F)), np.zeros(samples)
    for k in range(samples):
        found[k] = (g.H @ e + g.J @ heard[k : k + 1])[0]
        e = g.F @ e + g.gain @ heard[k : k + 1] - g.T @ pushed[k]
    return found


@pytest.mark.parametrize("rate", [1.0, 0.2, 0.02])
def test_noise_switches_a_relay_no_more_often_than_demanded_wherever_its_mean_is(rate: float) -> None:
    """And, where the mean is between the levels, not far less often: within a factor of four."""
    detector = detector_of(f", false_alarm: {rate}")
    part, samples = parts_of(detector)[0], 100_000
    level = float(part.threshold.level[0])
    release = hysteresis(detector.system, part, rate)
    noise = noise_of(detector, samples)
    middle = level * (1 + release) / 2
    found = [switches(mean + noise, level, release) / (samples * STEP) for mean in (0, level, middle, release * level)]
    spread = 3 * np.sqrt(rate / (samples * STEP))
    assert max(found) <= rate + spread
    assert found[2] >= rate / 4 - spread


def test_a_stated_release_that_lets_noise_switch_too_often_is_refused() -> None:
    needed = detector_of(", false_alarm: 1e-4").release
    assert detector_of(f", false_alarm: 1e-4, release: {needed + 0.01}").release == pytest.approx(needed + 0.01)
    with pytest.raises(UsageError, match=r"DH0604.*more often than `false_alarm`"):
        detector_of(f", false_alarm: 1e-4, release: {needed - 0.01}")


def test_a_rate_of_false_alarms_without_noise_is_refused() -> None:
    text = MODEL.replace(", DETECTOR", ", false_alarm: 1e-4").replace(", measurement: 0.02", "")
    system = loads(text.replace(", measurement: [[0.0004]]", ""))
    with pytest.raises(UsageError, match="DH0614"):
        build_detector(system, compiler.recover(system).plan, rate=1.0, step=STEP)
