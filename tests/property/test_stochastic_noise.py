"""Noise beyond a fixed covariance, held against naive filters, numerical integration and drawn runs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import norm

from deshybrid.diagnostics import UsageError
from deshybrid.model.system import NoiseForm
from deshybrid.stochastic import gaussian, noise
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.filters import LinearFilter
from deshybrid.stochastic.multiple import predict_imm, update
from deshybrid.stochastic.observability import literal_verdict
from deshybrid.stochastic.record import estimate, estimate_known
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.smoothing import smooth
from deshybrid.stochastic.steady_state import steady_state
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from tests.naive_filters import combined
from tests.naive_noise import interacting, known

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=15, deadline=None)


def tailed(share: float, factor: float) -> NoiseForm:
    return NoiseForm(share=share, factor=factor)


def system_of(seed: int, *forms: str) -> StochasticSystem:
    """Three modes of two states and two outputs, with noise of these forms, each other numbers."""
    rng = np.random.default_rng(seed)
    modes = []
    for name in "abc":
        A, B = rng.normal(size=(2, 2)), rng.normal(size=(2, 2))
        form = NoiseForm(
            rng.normal(size=(2, 2)) * 0.3 if "process_by_state" in forms else None,
            rng.normal(size=(2, 2)) * 0.3 if "measurement_by_state" in forms else None,
            *(rng.uniform(0.01, 0.3), rng.uniform(2.0, 200.0)) if "tails" in forms else (0.0, 1.0),
        )
        F, H = 0.5 * rng.normal(size=(2, 2)), rng.normal(size=(2, 2))
        Q, R = A @ A.T + 0.1 * np.eye(2), B @ B.T + 0.1 * np.eye(2)
        modes.append(Mode(name, F=F, H=H, Q=Q, R=R, f=rng.normal(size=2), g=rng.normal(size=2), noise=form))
    chain = ModeTransition.from_rows("abc", rng.dirichlet(np.ones(3), size=3))
    return StochasticSystem(modes, chain, x=rng.normal(size=2), P=np.eye(2), mu=rng.dirichlet(np.ones(3)))


def walk(*, share: float = 0.0, factor: float = 1.0, by_state: float | None = None) -> StochasticSystem:
    """A scalar walk of variance 0.1 a step, measured with variance 1."""
    grows = None if by_state is None else np.array([[by_state]])
    form = NoiseForm(grows, None, share, factor)
    mode = Mode("walk", F=[[1.0]], H=[[1.0]], Q=[[0.1]], R=[[1.0]], noise=form)
    return StochasticSystem((mode,), ModeTransition(("walk",), [[1.0]]), x=[0.0], P=[[1.0]], mu=[1.0])


FORMS = [
    ("tails",),
    ("process_by_state",),
    ("measurement_by_state",),
    ("process_by_state", "measurement_by_state", "tails"),
]


@pytest.mark.parametrize("forms", FORMS)
@FEW
@given(seed=SEEDS)
def test_the_interacting_filter_is_that_of_the_definition(forms, seed):
    system = system_of(seed, *forms)
    z = sample(system, 6, seed=seed).z.copy()
    z[2, 0] = z[4] = np.nan
    made = estimate(system, z)
    for k, (mu, x, P, log_likelihood) in enumerate(interacting(system, z)):
        np.testing.assert_allclose(made.mu[k], mu, atol=1e-9)
        np.testing.assert_allclose(made.x[k], x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(made.P[k], P, rtol=1e-7, atol=1e-8)
        assert made.log_likelihood[k] == pytest.approx(log_likelihood, abs=1e-8)


@pytest.mark.parametrize("forms", FORMS)
@FEW
@given(seed=SEEDS)
def test_the_filter_of_a_known_mode_is_that_of_the_definition(forms, seed):
    system = system_of(seed, *forms)
    runs = sample(system, 6, seed=seed)
    z = runs.z.copy()
    z[3, 1] = np.nan
    made = estimate_known(system, z, runs.modes)
    for k, (x, P, log_likelihood) in enumerate(known(system, z, runs.modes)):
        np.testing.assert_allclose(made.x[k], x, rtol=1e-8, atol=1e-8)
        np.testing.assert_allclose(made.P[k], P, rtol=1e-7, atol=1e-8)
        assert made.log_likelihood[k] == pytest.approx(log_likelihood, abs=1e-8)


@FEW
@given(
    spread=st.floats(0.05, 20.0),
    share=st.floats(0.001, 0.9),
    factor=st.floats(1.0, 1e4),
    residual=st.floats(-25.0, 25.0),
)
def test_mean_variance_and_likelihood_of_a_scalar_row_are_those_of_numerical_integration(
    spread, share, factor, residual
):
    def density(v):
        return (1.0 - share) * norm.pdf(v) + share * norm.pdf(v, scale=np.sqrt(factor))

    one = np.eye(1)
    made = noise.update(np.zeros(1), spread * one, np.array([residual]), one, one, tails=np.array([share, factor]))
    end = 14.0 * np.sqrt(spread) + abs(residual)
    x = np.linspace(-end, end, 20_001)  # equal steps: the error falls faster than any power of them
    weight = norm.pdf(x, scale=np.sqrt(spread)) * density(residual - x)
    total = weight.sum() * (x[1] - x[0])
    mean = (x * weight).sum() / weight.sum()
    assert float(made.log_likelihood) == pytest.approx(np.log(total), abs=1e-9)
    assert float(made.x[0]) == pytest.approx(mean, rel=1e-9, abs=1e-9)
    assert float(made.P[0, 0]) == pytest.approx(((x - mean) ** 2 * weight).sum() / weight.sum(), rel=1e-9)


@pytest.mark.parametrize("tails", [(0.0, 100.0), (0.3, 1.0), (1.0, 7.0)])
@FEW
@given(seed=SEEDS)
def test_without_bad_rows_or_with_bad_ones_only_it_is_the_kalman_filter(tails, seed):
    rng = np.random.default_rng(seed)
    x, P, H = rng.normal(size=3), np.eye(3), rng.normal(size=(2, 3))
    residual = rng.normal(size=2) * 10.0
    made = noise.update(x, P, residual, H, np.eye(2), tails=np.array(tails))
    factor = tails[1] if tails[0] == 1.0 else 1.0
    plain = gaussian.update(x, P, residual, H, factor * np.eye(2))
    for name in ("x", "P", "log_likelihood", "residual", "S", "distance"):
        np.testing.assert_allclose(getattr(made, name), getattr(plain, name), rtol=1e-12, atol=1e-12)


@FEW
@given(seed=SEEDS)
def test_many_trials_at_once_are_the_trials_alone_and_the_rows_one_by_one(seed):
    system = system_of(seed, *FORMS[-1])
    z = sample(system, 5, seed=seed, trials=(3,)).z
    together = estimate(system, z)
    for trial in range(3):
        np.testing.assert_allclose(estimate(system, z[trial]).x, together.x[trial], rtol=1e-9, atol=1e-9)
        belief = Belief.prior(system)
        for row in z[trial]:
            belief = update(system, predict_imm(system, belief), row).belief
        np.testing.assert_allclose(belief.mean, together.x[trial, -1], rtol=1e-9, atol=1e-9)


@FEW
@given(seed=SEEDS)
def test_the_filter_of_one_mode_behind_the_protocol_is_the_same(seed):
    system = system_of(seed, *FORMS[-1])
    mode = system.modes[1]
    z = np.random.default_rng(seed).normal(size=(1, 2))
    one = LinearFilter(mode)
    done = one.correct(*one.move(system.x, system.P, None), z[0], None)
    made = estimate_known(system, z, [1])
    np.testing.assert_allclose(done.x, made.x[0], rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(done.P, made.P[0], rtol=1e-10, atol=1e-12)


def test_noise_that_grows_with_the_state_has_the_moments_of_drawn_runs():
    """200,000 draws of 2 x + 0.5 e x + w and of z = x + 0.3 e' x + v: moments within four standard errors."""
    form = NoiseForm(np.array([[0.5]]), np.array([[0.3]]))
    mode = Mode("grows", F=[[2.0]], H=[[1.0]], Q=[[0.1]], R=[[0.2]], noise=form)
    system = StochasticSystem((mode,), ModeTransition(("grows",), [[1.0]]), x=[3.0], P=[[0.4]], mu=[1.0])
    runs = sample(system, 1, seed=11, trials=(200_000,))
    belief = predict_imm(system, Belief.prior(system))
    S = update(system, belief, np.array([6.0])).S[0, 0, 0]
    for drawn, variance in ((runs.x[:, 0, 0], belief.covariance[0, 0]), (runs.z[:, 0, 0], S)):
        squares = (drawn - 6.0) ** 2
        assert abs(drawn.mean() - 6.0) < 4.0 * np.sqrt(variance / len(drawn))
        assert abs(squares.mean() - variance) < 4.0 * squares.std() / np.sqrt(len(drawn))


def test_with_late_positions_the_estimate_is_the_best_linear_one():
    """No other gain on the same residual has a smaller mean square error over 100,000 draws."""
    form = NoiseForm(None, np.array([[0.0, 0.5]]))
    mode = Mode("late", F=np.eye(2), H=[[1.0, 0.0]], Q=np.zeros((2, 2)), R=[[0.01]], noise=form)
    system = StochasticSystem(
        (mode,), ModeTransition(("late",), [[1.0]]), x=[0.0, 10.0], P=np.diag([4.0, 1.0]), mu=[1.0]
    )
    runs = sample(system, 1, seed=12, trials=(100_000,))
    posterior = update(system, predict_imm(system, Belief.prior(system)), np.array([1.0]))
    gain = posterior.belief.x[0] - np.array([0.0, 10.0])  # for a residual of one
    errors = runs.x[:, 0] - np.array([0.0, 10.0])
    best = np.array([errors[:, i] @ runs.z[:, 0, 0] / (runs.z[:, 0, 0] ** 2).sum() for i in range(2)])
    np.testing.assert_allclose(gain, best, atol=0.01)


def test_a_lone_outlier_moves_the_estimate_little_and_a_lasting_jump_is_followed_where_a_mode_jumps():
    (calm,) = walk(share=0.02, factor=1e4).modes
    jumps = Mode("jumps", F=[[1.0]], H=[[1.0]], Q=[[900.0]], R=[[1.0]], noise=calm.noise)
    chain = ModeTransition.from_rows(("walk", "jumps"), [[0.99, 0.01], [0.99, 0.01]])
    system = StochasticSystem((calm, jumps), chain, x=[0.0], P=[[1.0]], mu=[1.0, 0.0])
    z = np.zeros((60, 1))
    z[20] = z[40:] = 60.0
    x, plain = estimate(system, z).x[:, 0], estimate(walk(), z).x[:, 0]
    assert abs(plain[20]) > 10.0
    assert abs(x[21]) < 1.0
    assert x[43:] == pytest.approx(60.0, abs=1.0)


def test_a_measurement_beyond_all_experience_gives_no_nan():
    made = estimate(walk(share=0.02, factor=1e4), [[0.0], [1e8], [0.0]])
    assert np.isfinite(made.x).all()
    assert np.isfinite(made.log_likelihood).all()


def test_on_runs_with_bad_rows_the_error_is_smaller_and_as_large_as_believed():
    system = walk(share=0.1, factor=400.0)
    runs = sample(system, 60, seed=3, trials=(400,))
    robust, plain = estimate(system, runs.z), estimate(walk(), runs.z)
    errors = [float(np.sqrt(((made.x - runs.x) ** 2).mean())) for made in (robust, plain)]
    assert errors[0] < 0.4 * errors[1]
    squares = (robust.x[..., 0] - runs.x[..., 0])[:, -1] ** 2 / robust.P[:, -1, 0, 0]
    assert abs(squares.mean() - 1.0) < 4.0 * squares.std() / np.sqrt(len(squares))


def test_smoothing_takes_the_noise_that_the_step_really_had():
    """Of one mode, one step back: Rauch, Tung and Striebel with the grown covariance."""
    system = walk(by_state=0.5)
    z = np.array([[1.0], [3.0]])
    filtered, smoothed = estimate(system, z), smooth(system, z, lag=1)
    x, P = filtered.x[0, 0], filtered.P[0, 0, 0]
    moved = P + 0.1 + 0.25 * (P + x * x)
    assert smoothed.x[0, 0] == pytest.approx(x + P / moved * (filtered.x[1, 0] - x), rel=1e-12)


@pytest.mark.parametrize(
    ("what", "call"),
    [
        ("`rmimm`", lambda system: estimate(system, [[0.0]], method="rmimm")),
        ("engine `roots`", lambda system: estimate(system, [[0.0]], engine="roots")),
        ("a gate", lambda system: estimate(system, [[0.0]], gate=0.99)),
        ("a gate", lambda system: estimate_known(system, [[0.0]], [0], gate=0.99)),
        ("steady-state", lambda system: steady_state(system.modes[0])),
        ("Gaussian of the outputs", literal_verdict),
    ],
)
def test_what_takes_plain_noise_for_granted_refuses_heavy_tails(what, call):
    with pytest.raises(UsageError, match=what) as caught:
        call(walk(share=0.1, factor=9.0))
    assert caught.value.diagnostics[0].code == "DH1120"


@pytest.mark.parametrize(("share", "factor"), [(-0.1, 2.0), (1.1, 2.0), (0.1, 0.5), (0.1, np.inf)])
def test_tails_that_are_none_are_refused(share, factor):
    with pytest.raises(UsageError) as caught:
        walk(share=share, factor=factor)
    assert caught.value.diagnostics[0].code == "DH1104"


def test_a_mixture_of_two_is_what_the_naive_filters_call_combined():
    mean, spread = combined([0.25, 0.75], [np.zeros(1), np.ones(1)], [np.eye(1), np.eye(1)])
    assert (mean.tolist(), spread.tolist()) == ([0.75], [[1.1875]])
