"""Normal scores: those of one Gaussian, of a mixture by integration, and what an IMM loses by merging.

`remembering` is the filter that an IMM approximates: it keeps a Gaussian for each sequence of the last modes.
"""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import kstest, multivariate_normal, norm

from deshybrid.model.load import load
from deshybrid.model.system import NoiseForm
from deshybrid.stochastic import gaussian
from deshybrid.stochastic.belief import log_sum, mixture_covariance, squared_residual
from deshybrid.stochastic.calibration import normal_scores
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.record import estimate, estimate_known
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.score import Consistency
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem

TURN = Path(__file__).parents[2] / "models/hwang2006/turn.yaml"


def one_step(seed: int, share: float = 0.0, factor: float = 1.0) -> StochasticSystem:
    """Two modes whose prediction of the first row is an exact mixture of two Gaussians of two outputs."""
    rng = np.random.default_rng(seed)
    modes = []
    for name in "ab":
        A, B = rng.normal(size=(2, 2)), rng.normal(size=(2, 2))
        form = NoiseForm(share=share, factor=factor)
        Q, R = A @ A.T, B @ B.T + 0.1 * np.eye(2)
        modes.append(
            Mode(name, F=rng.normal(size=(2, 2)), H=np.eye(2), Q=Q, R=R, f=3.0 * rng.normal(size=2), noise=form)
        )
    chain = ModeTransition.from_rows("ab", rng.dirichlet(np.ones(2), size=2))
    return StochasticSystem(modes, chain, x=rng.normal(size=2), P=np.eye(2), mu=[0.0, 1.0])


def by_definition(system: StochasticSystem, z):
    """Φ⁻¹ of P(z₁' <= z₁) and of P(z₂' <= z₂ | z₁), for the first row."""
    weights, means, covariances = [], [], []
    for j, mode in enumerate(system.modes):
        for share, factor in ((1.0 - mode.noise.share, 1.0), (mode.noise.share, mode.noise.factor)):
            weights.append(share * (system.chain.probability_to_from @ system.mu)[j])
            means.append(mode.F @ system.x + mode.f)
            covariances.append(mode.F @ system.P @ mode.F.T + mode.Q + factor * mode.R)
    first = sum(w * norm.cdf(z[0], m[0], np.sqrt(S[0, 0])) for w, m, S in zip(weights, means, covariances, strict=True))
    y = np.linspace(z[1] - 60.0, z[1], 6001)

    def density(last):
        points = np.column_stack((np.full_like(last, z[0]), last))
        parts = zip(weights, means, covariances, strict=True)
        return sum(w * multivariate_normal.pdf(points, m, S) for w, m, S in parts)

    part = np.trapezoid(density(y), y)
    whole = part + np.trapezoid(density(y + 60.0), y + 60.0)
    return norm.ppf(first), norm.ppf(part / whole)


def remembering(system: StochasticSystem, z, *, more: int):
    """Sums of NIS and of squared normal scores of each trial, by the filter that remembers `more` modes than an IMM."""
    (trials, rows, _), bank, count = z.shape, system.bank, len(system.modes)
    kept = count**more
    x, P = np.broadcast_to(system.x, (trials, kept, 4)), np.broadcast_to(system.P, (trials, kept, 4, 4))
    with np.errstate(divide="ignore"):
        chain = np.log(system.chain.probability_to_from)
        start = np.where(
            np.arange(kept) % count ** (more - 1) == 0, np.log(np.repeat(system.mu, kept // count)), -np.inf
        )
    log_weight = np.broadcast_to(start, (trials, kept))
    to, before = np.repeat(np.arange(count), kept), np.tile(np.arange(kept) // count ** (more - 1), count)
    nis, scores = np.zeros(trials), np.zeros(trials)
    for k in range(rows):
        joint = np.tile(log_weight, (1, count)) + chain[to, before]
        moved = gaussian.predict(
            np.tile(x, (1, count, 1)), np.tile(P, (1, count, 1, 1)), bank.F[to], bank.Q[to], bank.f[to]
        )
        done = gaussian.update(
            *moved, z[:, k, None] - np.einsum("jpn,tjn->tjp", bank.H[to], moved[0]), bank.H[to], bank.R[to]
        )
        nis += squared_residual(np.exp(joint), done.residual, done.S)
        scores += (naive_scores(np.exp(joint), done.residual, done.S) ** 2).sum(axis=-1)
        joint = (joint + done.log_likelihood).reshape(trials, kept, count)
        joint -= log_sum(joint.reshape(trials, -1))[:, None, None]
        log_weight = log_sum(joint)
        with np.errstate(invalid="ignore"):
            weight = np.nan_to_num(np.exp(joint - log_weight[..., None]))
        xs = done.x.reshape(trials, kept, count, 4)
        x = (weight[..., None] * xs).sum(axis=-2)
        P = mixture_covariance(weight, xs - x[..., None, :], done.P.reshape(trials, kept, count, 4, 4))
        P = np.where(np.isfinite(log_weight)[..., None, None], P, np.eye(4))
    return nis, scores


def naive_scores(weight, residual, S):
    """Scores (trials, 2) of two outputs, by the conditional densities of each Gaussian."""
    first, second = residual[..., 0], residual[..., 1]
    sizes = np.sqrt(S[..., 0, 0])
    slope = S[..., 0, 1] / S[..., 0, 0]
    left = np.sqrt(S[..., 1, 1] - slope * S[..., 0, 1])
    given = weight * norm.pdf(first, scale=sizes)
    u = (weight * norm.cdf(first / sizes)).sum(-1)
    v = (given * norm.cdf((second - slope * first) / left)).sum(-1) / given.sum(-1)
    return norm.ppf(np.column_stack((u, v)))


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), tails=st.sampled_from([(0.0, 1.0), (0.2, 30.0)]))
def test_the_scores_of_a_mixture_are_those_of_numerical_integration(seed, tails):
    system = one_step(seed, *tails)
    z = sample(system, 1, seed=seed).z[0]
    first, second = by_definition(system, z)
    found = normal_scores(system, z[None])[0]
    assert found[0] == pytest.approx(first, abs=1e-9)
    assert found[1] == pytest.approx(second, abs=2e-3)


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1))
def test_with_one_mode_the_squares_of_a_row_add_up_to_its_nis(seed):
    system = one_step(seed)
    alone = StochasticSystem(system.modes[:1], ModeTransition("a", [[1.0]]), x=system.x, P=system.P, mu=[1.0])
    z = sample(alone, 6, seed=seed).z.copy()
    z[2, 0] = z[4] = np.nan
    squares = np.nansum(normal_scores(alone, z) ** 2, axis=-1)
    np.testing.assert_allclose(squares, estimate_known(alone, z, [0] * 6).nis, rtol=1e-8, atol=1e-9)


def test_missing_outputs_have_no_score():
    z = np.array([[1.0, np.nan], [np.nan, np.nan], [0.0, 2.0]])
    assert np.isnan(normal_scores(one_step(1), z)).tolist() == [[False, True], [True, True], [False, False]]


def test_a_measurement_far_out_on_either_side_has_a_finite_score():
    far = normal_scores(one_step(1), [[[1e4, -1e4]], [[-1e4, 1e4]]])
    assert np.isfinite(far).all()
    assert (np.abs(far) > 100.0).any()


def test_scores_of_the_exact_mixture_are_standard_normal_and_its_residuals_are_not():
    """20,000 first rows, whose prediction is exact; with heavy tails the squared residuals are far from χ²."""
    system = one_step(5, share=0.05, factor=100.0)
    z = sample(system, 1, seed=9, trials=(20_000,)).z
    scores = normal_scores(system, z)[:, 0]
    assert kstest(scores[:, 0], "norm").pvalue > 0.01
    assert kstest(scores[:, 1], "norm").pvalue > 0.01
    assert abs(np.corrcoef(scores.T)[0, 1]) < 0.03
    assert Consistency(float((scores**2).sum()), scores.size).holds
    assert kstest(estimate(system, z).nis[:, 0], "chi2", args=(2,)).pvalue < 1e-6


def test_an_interacting_filter_believes_itself_slightly_less_certain_than_it_is_and_remembering_modes_mends_it():
    """300 matched runs of 100 rows: the figures of docs/stochastic.md; the band is that of χ² with 60,000 degrees."""
    system = stochastic_system(load(TURN))
    runs = sample(system, 100, seed=3, trials=(300,))
    count = runs.z.size
    low, high = (bound / count for bound in Consistency(0.0, count).band)
    assert (round(low, 3), round(high, 3)) == (0.989, 1.011)
    known = estimate_known(system, runs.z, runs.modes).nis.sum() / count
    merged = estimate(system, runs.z).nis.sum() / count
    scores = float((normal_scores(system, runs.z) ** 2).sum() / count)
    assert [round(float(value), 3) for value in (known, merged, scores)] == [0.997, 0.986, 0.980]
    for more, told in ((1, (0.998, 0.995)), (2, (1.0, 0.997)), (3, (1.003, 1.0))):
        found = [float(sums.sum() / count) for sums in remembering(system, runs.z, more=more)]
        assert found == pytest.approx(told, abs=6e-4)
        assert low <= found[1] <= high
