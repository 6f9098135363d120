"""The batched filters beside naive loops, other formulations of the same estimate, and what must hold of any filter."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.multiple import predict_imm, predict_mmae, update
from deshybrid.stochastic.record import estimate, estimate_known
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.score import Consistency, nees
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from tests.naive_filters import batch_least_squares, multiple_models
from tests.strategies import drawn_record, random_stochastic_system

seeds = st.integers(0, 2**32 - 1)


@pytest.mark.parametrize("method", ["imm", "mmae", "rmimm"])
@given(seed=seeds)
@settings(max_examples=12, deadline=None)
def test_batched_filter_is_the_naive_loop_of_every_trial(method, seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    z, u = drawn_record(rng, system, (2, 2))
    made = estimate(system, z, u, method=method)
    for trial in np.ndindex(2, 2):
        naive = multiple_models(system, z[trial], u[trial], method=method)
        scale = max(1.0, np.abs(naive.P).max(), np.abs(naive.x).max())
        np.testing.assert_allclose(made.mu[trial], naive.mu, atol=1e-9)
        np.testing.assert_allclose(made.x[trial], naive.x, atol=1e-9 * scale)
        np.testing.assert_allclose(made.P[trial], naive.P, atol=1e-9 * scale)
        np.testing.assert_allclose(made.log_likelihood[trial], naive.log_likelihood, rtol=1e-9, atol=1e-9)


@given(seed=seeds)
@settings(max_examples=12, deadline=None)
def test_switching_kalman_filter_solves_the_least_squares_problem_of_the_whole_run(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    z, u = drawn_record(rng, system)
    modes = rng.integers(0, len(system.modes), len(z))
    made = estimate_known(system, z, modes, u)
    x, P = batch_least_squares(system, z, u, modes)
    np.testing.assert_allclose(made.x[-1], x, rtol=1e-7, atol=1e-7 * max(1.0, np.abs(x).max()))
    np.testing.assert_allclose(made.P[-1], P, rtol=1e-7, atol=1e-7 * np.abs(P).max())


@given(seed=seeds)
@settings(max_examples=12, deadline=None)
def test_one_measurement_at_a_time_gives_the_record(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng, plain=True)
    z, _ = drawn_record(rng, system)
    made, belief, total = estimate(system, z), Belief.prior(system), 0.0
    for row in z:
        posterior = update(system, predict_imm(system, belief), row)
        belief, total = posterior.belief, total + posterior.log_likelihood
    np.testing.assert_allclose(made.x[-1], belief.mean, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(made.log_likelihood.sum(), total, rtol=1e-12)


@given(seed=seeds)
@settings(max_examples=12, deadline=None)
def test_identical_modes_leave_mu_at_the_stationary_distribution_and_x_at_the_single_filter(seed):
    rng = np.random.default_rng(seed)
    one = random_stochastic_system(rng, plain=True)
    count, mode = len(one.modes), one.modes[0]
    eigenvalues, vectors = np.linalg.eig(one.chain.probability_to_from)
    stationary = np.real(vectors[:, np.argmin(np.abs(eigenvalues - 1.0))])
    stationary /= stationary.sum()
    copies = [Mode(f"m{i}", F=mode.F, H=mode.H, Q=mode.Q, R=mode.R) for i in range(count)]
    system = StochasticSystem(copies, one.chain, x=one.x, P=one.P, mu=np.abs(stationary))
    z, _ = drawn_record(rng, one, rows=30)
    made, single = estimate(system, z), estimate_known(system, z, np.zeros(30, dtype=int))
    np.testing.assert_allclose(made.mu, np.broadcast_to(stationary, made.mu.shape), atol=1e-13)
    np.testing.assert_allclose(made.x, single.x, atol=1e-13 * max(1.0, np.abs(single.x).max()))


@given(seed=seeds)
@settings(max_examples=12, deadline=None)
def test_a_row_without_measurement_is_the_prediction(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng, plain=True)
    prior = predict_imm(system, Belief.prior(system))
    posterior = update(system, prior, np.full(system.bank.H.shape[1], np.nan))
    np.testing.assert_array_equal(posterior.belief.x, prior.x)
    np.testing.assert_allclose(posterior.belief.P, prior.P, rtol=1e-14)
    np.testing.assert_allclose(posterior.belief.mu, prior.mu, rtol=1e-12)
    assert abs(posterior.log_likelihood) < 1e-12
    assert posterior.nis == 0.0


def tracking(*, turn_noise: float = 1e-4) -> StochasticSystem:
    """A position and its speed; `straight`, and `turn` with an acceleration of 1."""
    F, H, G = np.array([[1.0, 1.0], [0.0, 1.0]]), np.array([[1.0, 0.0]]), np.array([0.5, 1.0])
    modes = [
        Mode("straight", F=F, H=H, Q=1e-4 * np.eye(2), R=[[0.01]]),
        Mode("turn", F=F, H=H, Q=turn_noise * np.eye(2), R=[[0.01]], f=G),
    ]
    chain = ModeTransition.from_rows(("straight", "turn"), [[0.95, 0.05], [0.2, 0.8]])
    return StochasticSystem(modes, chain, x=[0.0, 0.0], P=np.eye(2), mu=[0.5, 0.5])


@pytest.mark.parametrize("method", ["imm", "mmae", "rmimm"])
def test_a_garbage_mode_loses_its_weight(method):
    system = tracking()
    garbage = Mode("garbage", F=-5.0 * np.eye(2), H=[[1.0, 0.0]], Q=np.eye(2), R=[[0.01]], f=[50.0, 0.0])
    names, rows = ("straight", "garbage"), [[0.9, 0.1], [0.9, 0.1]]
    pair = StochasticSystem(
        [system.modes[0], garbage], ModeTransition.from_rows(names, rows), x=system.x, P=system.P, mu=[0.1, 0.9]
    )
    z = sample(system, 50, seed=3, modes=[0] * 50).z
    assert estimate(pair, z, method=method).mu[2:, 1].max() < 1e-6


@pytest.mark.parametrize("method", ["imm", "mmae", "rmimm"])
def test_a_measurement_ten_thousand_deviations_away_gives_no_nan_and_is_forgotten(method):
    system = tracking()
    z = sample(system, 60, seed=4, modes=[0] * 60).z
    hit = z.copy()
    hit[20] += 1e4 * np.sqrt(tracking().modes[0].R[0, 0])
    made, calm = estimate(system, hit, method=method), estimate(system, z, method=method)
    for name in ("x", "P", "mu", "log_likelihood", "nis"):
        assert np.isfinite(getattr(made, name)).all(), name
    assert made.log_likelihood[20] < -1e3
    np.testing.assert_allclose(made.mu.sum(axis=-1), 1.0, atol=1e-12)
    np.testing.assert_allclose(made.x[-1], calm.x[-1], atol=1.0)


def test_the_predicted_mixture_is_weighted_by_the_predicted_probabilities():
    system = tracking()
    belief = Belief([[0.0, 0.0], [9.0, 0.0]] * np.ones((2, 2)), np.stack([np.eye(2)] * 2), np.log([0.7, 0.3]))
    prior = predict_mmae(system, belief)
    predicted = system.chain.probability_to_from @ [0.7, 0.3]
    np.testing.assert_allclose(prior.mu, predicted, rtol=1e-12)
    np.testing.assert_allclose(prior.mean, predicted @ prior.x, rtol=1e-12)


def test_a_mode_that_cannot_be_entered_has_probability_zero_and_no_nan():
    system = tracking()
    chain = ModeTransition(system.names, [[1.0, 1.0], [0.0, 0.0]])
    locked = StochasticSystem(system.modes, chain, x=system.x, P=system.P, mu=[1.0, 0.0])
    made = estimate(locked, sample(system, 20, seed=1).z)
    assert np.isfinite(made.x).all()
    np.testing.assert_array_equal(made.mu[:, 1], 0.0)


def test_nis_and_nees_of_the_matched_switching_filter_lie_in_their_bands():
    """NIS: white along a run, so over all rows of all trials.  NEES: over independent trials, at chosen rows."""
    system, trials = tracking(), 400
    runs = sample(system, 60, seed=11, trials=(trials,))
    made = estimate_known(system, runs.z, runs.modes)
    assert Consistency(float(made.nis.sum()), int(made.channels.sum())).holds
    squares = nees(made.x - runs.x, made.P)
    for row in (0, 20, 59):
        assert Consistency(float(squares[:, row].sum()), 2 * trials).holds, row


def test_nis_of_a_filter_with_half_the_noise_leaves_its_band():
    """The band above can fail."""
    system = tracking()
    runs = sample(system, 60, seed=11, trials=(400,))
    modes = [Mode(m.name, F=m.F, H=m.H, Q=m.Q, R=0.5 * m.R, f=m.f) for m in system.modes]
    wrong = StochasticSystem(modes, system.chain, x=system.x, P=system.P, mu=system.mu)
    made = estimate_known(wrong, runs.z, runs.modes)
    assert not Consistency(float(made.nis.sum()), int(made.channels.sum())).holds


def test_log_likelihood_of_one_mode_is_that_of_the_whole_record_as_one_gaussian():
    """The innovations' densities multiply to the joint density, whose covariance is written down directly."""
    mode = Mode("walk", F=[[0.9]], H=[[1.0]], Q=[[0.3]], R=[[0.5]])
    system = StochasticSystem([mode], ModeTransition(["walk"], [[1.0]]), x=[1.0], P=[[2.0]], mu=[1.0])
    z = np.array([0.3, -1.0, 2.0, 0.1])
    rows = np.arange(1, 5)
    both = np.minimum(rows[:, None], rows)
    state = 2.0 * 0.9 ** (rows[:, None] + rows) + 0.3 * sum(
        np.where(i <= both, 0.9 ** (rows[:, None] + rows - 2 * i), 0.0) for i in range(1, 5)
    )
    from scipy.stats import multivariate_normal

    expected = multivariate_normal.logpdf(z, 0.9**rows, state + 0.5 * np.eye(4))
    assert estimate(system, z[:, None]).log_likelihood.sum() == pytest.approx(expected, rel=1e-12)


def test_drawn_modes_follow_the_chain():
    system = tracking()
    modes = sample(system, 400, seed=5, trials=(200,)).modes
    after_turn = modes[:, 1:][modes[:, :-1] == 1]
    low, high = chi2.ppf([0.0005, 0.9995], 1)
    share, count = after_turn.mean(), after_turn.size
    assert (share - 0.8) ** 2 * count / (0.8 * 0.2) < high
    assert low < high


def test_the_residual_mean_filter_is_surer_than_the_imm():
    """What RMIMM is for, on matched simulation: the largest probability, on average over 50 runs."""
    system = tracking()
    z = sample(system, 100, seed=6, trials=(50,)).z
    sure = {method: float(estimate(system, z, method=method).mu.max(axis=-1).mean()) for method in ("imm", "rmimm")}
    assert sure["rmimm"] > sure["imm"]


def test_the_residual_mean_filter_over_identical_modes_is_the_imm():
    """No mode expects a residual, so that all weights are equal."""
    one = tracking().modes[0]
    modes = [Mode(name, F=one.F, H=one.H, Q=one.Q, R=one.R) for name in ("straight", "turn")]
    system = StochasticSystem(modes, tracking().chain, x=[0.0, 0.0], P=np.eye(2), mu=[0.5, 0.5])
    z = sample(system, 30, seed=6).z
    np.testing.assert_allclose(estimate(system, z, method="rmimm").mu, estimate(system, z).mu, atol=1e-12)
