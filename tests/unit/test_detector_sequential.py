"""Sequential tests against their definitions, and their error rates in seeded simulations against the theory."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2, multivariate_normal

from deshybrid.detector.designs import design_generator, white_design
from deshybrid.detector.innovation import white_generator
from deshybrid.detector.residual import follow
from deshybrid.detector.sequential import (
    LONGEST_WINDOW,
    MISS,
    RATIO,
    wald_test,
    whitening_of,
    window_limits,
    window_samples,
)
from deshybrid.diagnostics import UsageError
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.sampling import sample_covariance, sample_dynamics
from deshybrid.model.load import loads
from deshybrid.observer import reference

Rows = list[tuple[float, ...]]


def plain(array: FloatArray) -> tuple[tuple[float, ...], ...]:
    return tuple(tuple(row) for row in array.tolist())


def generator_with(whitening: FloatArray, **constants: object) -> dict[str, object]:
    return {"whitening": plain(whitening), "unbiased": (0.0,) * len(whitening), **constants}


def decisions_of_sprt(residuals: Rows, covariance: FloatArray, test: tuple[float, ...]) -> list[str]:
    """The decisions of the step, in order; it begins again after each."""
    generator = generator_with(whitening_of(covariance), test=test)
    tables, evidence, made = {"evidence": (0.0,)}, (0.0,), []
    for residual in residuals:
        still, after = reference.weigh_sequence(tables, generator, residual, True, evidence)
        now, _ = reference.weigh_sequence(tables, generator, residual, False, evidence)
        made += ["accept"] if now else [] if still else ["deny"]
        evidence = after
    return made


def naive_sprt(residuals: Rows, covariance: FloatArray, alpha: float) -> list[str]:
    """Wald's test from two Gaussian densities."""
    zero = np.zeros(len(covariance))
    here, elsewhere = multivariate_normal(zero, covariance), multivariate_normal(zero, RATIO**2 * covariance)
    upper, lower = math.log((1 - MISS) / alpha), math.log(MISS / (1 - alpha))
    total, made = 0.0, []
    for residual in residuals:
        total += float(elsewhere.logpdf(residual) - here.logpdf(residual))
        if total >= upper or total <= lower:
            made.append("deny" if total >= upper else "accept")
            total = 0.0
    return made


def denials_of_glr(residuals: Rows, covariance: FloatArray, limits: FloatArray) -> list[bool]:
    generator, p = generator_with(whitening_of(covariance)), len(covariance)
    evidence: tuple[float, ...] = (0.0,) * (len(limits) * p)
    denied = []
    for residual in residuals:
        quiet, evidence = reference.weigh_window(tuple(limits.tolist()), generator, residual, evidence)
        denied.append(not quiet)
    return denied


def naive_glr(residuals: Rows, covariance: FloatArray, level: float, samples: int) -> list[bool]:
    """The largest log-likelihood ratio over the time and the size of a shift of the mean."""
    denied = []
    for k in range(len(residuals)):
        ratios = []
        for count in range(1, min(samples, k + 1) + 1):
            recent = np.array(residuals[k + 1 - count : k + 1])
            shift = recent.mean(axis=0)  # the most likely one
            with_shift = multivariate_normal(shift, covariance).logpdf(recent).sum()
            ratios.append(with_shift - multivariate_normal(np.zeros(len(shift)), covariance).logpdf(recent).sum())
        denied.append(max(ratios) > level)
    return denied


def random_case(seed: int, length: int) -> tuple[Rows, FloatArray]:
    rng = np.random.default_rng(seed)
    factor = rng.normal(size=(2, 2)) + 2.0 * np.eye(2)
    covariance = factor @ factor.T
    scale = np.repeat(rng.uniform(0.3, 4.0, size=-(-length // 10)), 10)[:length, None]
    return [tuple(row) for row in (scale * (rng.normal(size=(length, 2)) @ factor.T)).tolist()], covariance


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_sprt_of_the_step_is_the_one_of_the_densities(seed: int) -> None:
    residuals, covariance = random_case(seed, 60)
    test = wald_test(2, false_alarm=1.0, step=0.01)
    assert decisions_of_sprt(residuals, covariance, test) == naive_sprt(residuals, covariance, 0.01)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000), st.integers(1, 6))
def test_glr_of_the_step_is_the_one_of_the_densities(seed: int, samples: int) -> None:
    residuals, covariance = random_case(seed, 40)
    limits = window_limits(samples, 2, false_alarm=1.0, step=0.01)
    assert denials_of_glr(residuals, covariance, limits) == naive_glr(
        residuals, covariance, float(limits[0]) / 2.0, samples
    )


def decided(scale: float, alpha: float, runs: int, seed: int) -> tuple[float, float, float]:
    """Shares of denials and acceptances over many single tests, and the mean number of samples of a test."""
    slope, offset, lower, upper = wald_test(1, false_alarm=alpha, step=1.0)
    rng, totals, counts = np.random.default_rng(seed), np.zeros(runs), np.zeros(runs)
    running = np.ones(runs, dtype=bool)
    while running.any():
        drawn = scale * rng.normal(size=int(running.sum()))
        totals[running] += slope * drawn**2 - offset
        counts[running] += 1
        running &= (totals < upper) & (totals > lower)
    return float((totals >= upper).mean()), float((totals <= lower).mean()), float(counts.mean())


def test_sprt_keeps_walds_bounds_on_both_errors() -> None:
    alpha, runs = 0.02, 40_000
    false_alarms = decided(1.0, alpha, runs, seed=1)[0]
    misses = decided(RATIO, alpha, runs, seed=2)[1]
    spread = 4.0 * math.sqrt(alpha / runs)  # four deviations of the estimate
    assert false_alarms / (1.0 - misses) <= alpha / (1.0 - MISS) + spread
    assert misses <= MISS / (1.0 - alpha) + 4.0 * math.sqrt(MISS / runs)
    assert false_alarms > alpha / 10.0


def test_sprt_takes_about_as_many_samples_as_wald_says() -> None:
    """E N = E(total at the end) / E(a sample), which the overshoot exceeds."""
    alpha = 0.001
    slope, offset, lower, upper = wald_test(1, false_alarm=alpha, step=1.0)
    here, elsewhere = slope - offset, slope * RATIO**2 - offset
    assert here < 0.0 < elsewhere
    _, _, samples = decided(1.0, alpha, 20_000, seed=3)
    assert ((1 - alpha) * lower + alpha * upper) / here == pytest.approx(samples, rel=0.15)
    _, _, until_denied = decided(RATIO, alpha, 20_000, seed=4)
    wald = ((1 - MISS) * upper + MISS * lower) / elsewhere
    assert wald <= until_denied <= wald + 3.0


def test_glr_gives_no_more_false_alarms_than_demanded_and_not_far_fewer() -> None:
    rate, samples, length = 0.02, 6, 60_000
    limits = window_limits(samples, 2, false_alarm=rate, step=1.0)
    white = np.random.default_rng(5).normal(size=(length, 2))
    sums = np.vstack([np.zeros(2), np.cumsum(white, axis=0)])
    denied = np.zeros(length, dtype=bool)
    for count in range(1, samples + 1):
        denied[count - 1 :] |= ((sums[count:] - sums[:-count]) ** 2).sum(axis=1) > limits[count - 1]
    share = float(denied.mean())
    assert rate / samples <= share <= rate


def test_glr_finds_a_shift_as_soon_as_its_own_sum_passes_the_limit() -> None:
    """Without noise a shift of size s is found at the first N with N² s² > 2 N c, if N is at most W."""
    limits = window_limits(6, 2, false_alarm=1e-4, step=0.01)
    for size in (2.5, 3.0, 6.0):
        denied = denials_of_glr([(0.0, 0.0)] * 8 + [(size, 0.0)] * 8, np.eye(2), limits)
        expected = math.floor(float(limits[0]) / size**2) + 1
        assert denied.index(True) - 8 == expected - 1 if expected <= 6 else True not in denied


def test_a_shorter_time_constant_makes_a_shorter_window_within_its_limits() -> None:
    assert [window_samples(t, 0.01) for t in (0.001, 0.05, 10.0)] == [2, 5, LONGEST_WINDOW]
    assert window_limits(4, 3, false_alarm=0.4, step=0.1).tolist() == pytest.approx(
        [float(chi2.isf(0.01, 3)) * n for n in (1, 2, 3, 4)]
    )


MODEL = """\
format: deshybrid/1
name: one
time: continuous
state: [x1, x2]
input: [u]
output: [y1, y2]
disturbance: [w]
bounds: {state: 5, input: 1, disturbance: 0.9, measurement: 0.03}
locations: {p: {A: [[0, 1], [-4, -1]], B: [[0], [1]], E: [[0], [1]], C: [[1, 0], [1, 1]], g: [0.5, -1]}}
transitions: [{from: p, to: p, event: a, emits: α}]
"""


@pytest.mark.parametrize(
    "noise", ["", "noise: {process: [[0.001, 0], [0, 0.02]], measurement: [[0.01, 0.002], [0.002, 0.04]]}\n"]
)
def test_the_residual_of_the_own_location_is_white_with_the_stated_covariance(noise: str) -> None:
    """Simulated step by step with the noise of the model: a known input, uniform or Gaussian noise."""
    system, step, length = loads(MODEL + noise), 0.05, 20_000
    location = system.location("p")
    generator, S = white_generator(system, follow(system, location, step))
    assert location.dynamics is not None
    plant, rng = sample_dynamics(location.dynamics, step), np.random.default_rng(6)
    if noise:
        assert location.process_noise is not None
        assert location.measurement_noise is not None
        Q = sample_covariance(location.dynamics.A, location.process_noise, step)
        pushed = rng.multivariate_normal(np.zeros(2), Q, length)
        v = rng.multivariate_normal(np.zeros(2), location.measurement_noise, length)
    else:
        pushed = rng.uniform(-0.9, 0.9, (length, 1)) @ plant.E.T
        v = rng.uniform(-0.03, 0.03, (length, 2))
    u = np.sin(0.01 * np.arange(length))[:, None]
    x, z, r = np.zeros(2), np.zeros(len(generator.F)), np.zeros((length, 2))
    for k in range(length):
        y = plant.C @ x + plant.D @ u[k] + plant.g + v[k]
        r[k] = generator.H @ z + generator.through @ u[k] + generator.J @ y + generator.residual_offset
        z = generator.F @ z + generator.input @ u[k] + generator.gain @ y + generator.offset
        x = plant.A @ x + plant.B @ u[k] + plant.f + pushed[k]
    white = r[200:] @ whitening_of(S).T
    assert np.cov(white.T) == pytest.approx(np.eye(2), abs=0.05)
    for lag in (1, 2, 5, 10):
        assert (white[lag:].T @ white[:-lag]) / len(white) == pytest.approx(np.zeros((2, 2)), abs=0.05)


def test_a_test_without_measurement_noise_is_refused() -> None:
    system = loads(MODEL.replace(", measurement: 0.03", ""))
    with pytest.raises(UsageError, match="DH0614"):
        white_generator(system, follow(system, system.location("p"), 0.05))


def test_a_decoupled_test_stays_white_under_a_disturbance_that_keeps_its_sign() -> None:
    """Far beyond its bound too; the plain test takes it for a shift of the mean.  Both have the stated covariance."""
    system, step, length = loads(MODEL + "observer: {detector: {design: unknown_input}}\n"), 0.05, 20_000
    location, rng = system.location("p"), np.random.default_rng(8)
    decoupled, S = white_design(system, location, step)
    plain_one, plain_S = white_design(loads(MODEL), location, step)
    assert location.dynamics is not None
    assert "decoupled from `w`" in decoupled.design
    plant, x = sample_dynamics(location.dynamics, step), np.zeros(2)
    memories, seen = (
        [np.zeros(len(decoupled.F)), np.zeros(len(plain_one.F))],
        [np.zeros((length, 1)), np.zeros((length, 2))],
    )
    for k in range(length):
        y = plant.C @ x + plant.g + rng.uniform(-0.03, 0.03, 2)
        for n, g in enumerate((decoupled, plain_one)):
            seen[n][k] = g.H @ memories[n] + g.J @ y + g.residual_offset
            memories[n] = g.F @ memories[n] + g.gain @ y + g.offset
        x = plant.A @ x + plant.f + plant.E @ [5.0]
    white, shifted = (r[200:] @ whitening_of(c).T for r, c in zip(seen, (S, plain_S), strict=True))
    assert np.mean(white) == pytest.approx(0.0, abs=0.05)
    assert np.std(white) == pytest.approx(1.0, abs=0.05)
    for lag in (1, 2, 5):
        assert np.mean(white[lag:] * white[:-lag]) == pytest.approx(0.0, abs=0.05)
    assert np.abs(shifted.mean(axis=0)).max() > 2.0


@pytest.mark.parametrize("design", ["luenberger", "h2", "auto"])
def test_a_test_of_residuals_that_are_not_white_is_refused(design: str) -> None:
    system = loads(MODEL + f"observer: {{detector: {{design: {design}}}}}\n")
    with pytest.raises(UsageError, match=f"DH0614.*`{design}`"):
        white_design(system, system.location("p"), 0.05)


@pytest.mark.parametrize("asked", ["decouple: [w]", "decouple: [w], design: h2", "decouple: [w], design: luenberger"])
def test_a_disturbance_to_decouple_is_never_ignored(asked: str) -> None:
    """Whatever decides: poles placed, the trade-off and the plain test decouple nothing."""
    system = loads(MODEL + f"observer: {{detector: {{{asked}}}}}\n")
    with pytest.raises(UsageError, match=r"DH0612.*decouples nothing"):
        design_generator(system, system.location("p"), rate=1.0, dwell=None, step=0.05)
    if "design" not in asked:
        with pytest.raises(UsageError, match="DH0612"):
            white_design(system, system.location("p"), 0.05)
