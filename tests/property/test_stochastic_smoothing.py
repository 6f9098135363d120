"""The smoother beside pair-by-pair loops, the least-squares problem of a whole run, and all sequences of modes."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.diagnostics import UsageError
from deshybrid.model.load import load
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.examples import calm_and_wild
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.multiple import predict_imm, update
from deshybrid.stochastic.record import estimate
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.smoothing import smooth, step_back
from deshybrid.stochastic.system import ModeTransition, StochasticSystem
from tests.naive_filters import combined, enumerated, smoothed, whole_least_squares
from tests.strategies import random_stochastic_system

seeds = st.integers(0, 2**32 - 1)


def drawn(rng, system, trials=(), *, rows=7):
    z = 3.0 * rng.standard_normal((*trials, rows, system.bank.H.shape[1]))
    z[rng.random(z.shape) < 0.15] = np.nan
    return z, rng.standard_normal((*trials, rows, system.bank.B.shape[2]))


def filtered(system, z, u):
    """mu, x, P of every mode after every row."""
    belief, found = Belief.prior(system), []
    for k, row in enumerate(z):
        belief = update(system, predict_imm(system, belief, u[max(k - 1, 0)]), row, u[k]).belief
        found.append((belief.mu, belief.x, belief.P))
    return found


@given(seed=seeds, lag=st.integers(0, 8))
@settings(max_examples=10, deadline=None)
def test_smoother_is_the_naive_loop_over_pairs_of_every_trial(seed, lag):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    z, u = drawn(rng, system, (2,))
    made = smooth(system, z, u, lag=lag)
    for trial in range(2):
        beliefs = filtered(system, z[trial], u[trial])
        for k in range(len(beliefs)):
            mu, xs, Ps = smoothed(system, beliefs, u[trial], k, lag)
            mean, spread = combined(mu, xs, Ps)
            scale = max(1.0, np.abs(spread).max(), np.abs(mean).max())
            np.testing.assert_allclose(made.mu[trial, k], mu, atol=1e-8)
            np.testing.assert_allclose(made.x[trial, k], mean, atol=1e-8 * scale)
            np.testing.assert_allclose(made.P[trial, k], spread, atol=1e-8 * scale)


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_with_one_mode_the_smoother_solves_the_least_squares_problem_of_the_whole_run(seed):
    rng = np.random.default_rng(seed)
    many = random_stochastic_system(rng)
    system = StochasticSystem(many.modes[:1], ModeTransition(("m0",), [[1.0]]), x=many.x, P=many.P, mu=[1.0])
    z, u = drawn(rng, system)
    made = smooth(system, z, u, lag=len(z))
    states, covariance = whole_least_squares(system, z, u, [0] * len(z))
    n = len(system.x)
    scale = max(1.0, np.abs(covariance).max(), np.abs(states).max())
    for k in range(len(z)):
        at = slice((k + 1) * n, (k + 2) * n)
        np.testing.assert_allclose(made.x[k], states[at], atol=1e-7 * scale)
        np.testing.assert_allclose(made.P[k], covariance[at, at], atol=1e-7 * scale)


def test_smoothed_probabilities_are_near_those_of_all_sequences_of_modes():
    """The IMM is an approximation: hindsight halves its distance to the exact posterior of the record."""
    system = calm_and_wild()
    gaps = {"filter": [], "smoother": []}
    for seed in range(8):
        z = sample(system, 5, seed=seed).z
        mu, x = enumerated(system, z, np.zeros((5, 0)))
        for name, made in (("filter", estimate(system, z)), ("smoother", smooth(system, z, lag=5))):
            gaps[name].append((np.abs(made.mu - mu).mean(), np.abs(made.x - x).mean()))
    before, after = (np.mean(gaps[name], axis=0) for name in ("filter", "smoother"))
    assert (after < 0.5 * before).all(), (before, after)


def test_hindsight_halves_mode_errors_and_errors_of_the_state_on_the_flight_of_the_page():
    system = stochastic_system(load("models/hwang2006/turn.yaml"))
    modes = np.array([int(45 <= k < 56) for k in range(100)])
    runs = sample(system, 100, seed=3, trials=(20,), modes=modes)
    wrong, error = {}, {}
    for lag in (0, 3):
        made = smooth(system, runs.z, lag=lag)
        wrong[lag] = (made.most_probable != modes).mean()
        error[lag] = ((made.x - runs.x) ** 2).mean()
    assert wrong[3] < 0.5 * wrong[0]
    assert error[3] < 0.5 * error[0]


def test_lag_zero_is_the_filter_and_stepping_back_one_by_one_is_the_record():
    system = calm_and_wild()
    z = sample(system, 12, seed=2).z
    np.testing.assert_allclose(smooth(system, z, lag=0).x, estimate(system, z).x, rtol=1e-12)
    belief, beliefs = Belief.prior(system), []
    for row in z:
        belief = update(system, predict_imm(system, belief), row).belief
        beliefs.append(belief)
    later = beliefs[-1]
    for now in reversed(beliefs[-4:-1]):
        later = step_back(system, now, later)
    np.testing.assert_allclose(later.mu, smooth(system, z, lag=3).mu[-4], rtol=1e-9)


def test_a_state_without_noise_is_smoothed_by_the_pseudo_inverse():
    """The accelerations of the mode CV of the six-state example are zero, without any doubt."""
    system = stochastic_system(load("models/hwang2006/maneuver.yaml"))
    made = smooth(system, sample(system, 20, seed=1).z, lag=5)
    for array in (made.x, made.P, made.mu):
        assert np.isfinite(array).all()
    assert np.linalg.eigvalsh(made.P).min() > -1e-6


def test_a_negative_lag_is_refused():
    with pytest.raises(UsageError) as caught:
        smooth(calm_and_wild(), [[1.0]], lag=-1)
    assert caught.value.diagnostics[0].code == "DH1112"
