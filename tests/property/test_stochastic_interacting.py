"""The IMM over any filters beside the linear one, beside FilterPy's filters, and over states that differ in number."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.diagnostics import UsageError
from deshybrid.model.load import load
from deshybrid.stochastic.filters import ExtendedFilter, LinearFilter, UnscentedFilter
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.gating import Gate
from deshybrid.stochastic.interacting import Interacting, conversion
from deshybrid.stochastic.lanes import times
from deshybrid.stochastic.record import estimate, rows_of
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from tests.strategies import drawn_record, random_stochastic_system

seeds = st.integers(0, 2**32 - 1)


def as_extended(mode):
    def f(x, u):
        return times(mode.F, x) + times(mode.B, u) + mode.f

    def h(x, u):
        return times(mode.H, x) + times(mode.D, u) + mode.g

    return ExtendedFilter(mode.name, f=f, h=h, F=lambda x, u: mode.F, H=lambda x, u: mode.H, Q=mode.Q, R=mode.R)


def as_unscented(mode):
    linear = as_extended(mode)
    return UnscentedFilter(mode.name, f=linear.f, h=linear.h, Q=mode.Q, R=mode.R, scaling=1.0)


def run(imm, prior, rows, gate=None):
    found = []
    belief = prior
    for z, before, now in rows:
        posterior = imm.update(imm.predict(belief, before), z, now, gate=gate)
        belief, told = posterior.belief, posterior.judgement
        gate = told.gate
        fates = (told.gated, told.readmitted)
        found.append((*imm.mixture(belief), belief.mu, posterior.log_likelihood, posterior.nis, *fates))
    return [np.stack(column) for column in zip(*found, strict=True)]


@pytest.mark.parametrize("kind", [LinearFilter, as_extended, as_unscented])
@given(seed=seeds, probability=st.sampled_from([None, 0.5, 0.99]))
@settings(max_examples=8, deadline=None)
def test_over_linear_modes_every_kind_of_filter_gives_the_linear_imm(kind, seed, probability):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    z, u = drawn_record(rng, system, (2,), rows=14)
    z[:, 5:] += 20.0
    imm = Interacting([kind(mode) for mode in system.modes], system.chain)
    count = len(system.modes)
    prior = imm.prior([system.x] * count, [system.P] * count, system.mu, (2,))
    rows = [(z[:, k], u[:, max(k - 1, 0)], u[:, k]) for k in range(14)]
    expected = estimate(system, z, u, gate=probability)
    gate = None if probability is None else Gate.of(z.shape[-1], probability, (2,))
    names = ("x", "P", "mu", "log_likelihood", "nis", "gated", "readmitted")
    for name, column in zip(names, run(imm, prior, rows, gate), strict=True):
        wanted = np.moveaxis(getattr(expected, name), 1, 0)
        np.testing.assert_allclose(column, wanted, rtol=1e-7, atol=1e-8 * max(1.0, np.abs(wanted).max()), err_msg=name)


@given(seed=seeds)
@settings(max_examples=12, deadline=None)
def test_a_mode_with_fewer_states_is_one_that_forgets_the_others_with_every_step(seed):
    """Its estimate of them is f with the variance in Q, which is what the conversion gives the other mode."""
    rng = np.random.default_rng(seed)
    n, p, small = 3, 2, int(rng.integers(1, 3))
    full = random_mode(rng, "full", n, p)
    few = random_mode(rng, "few", small, p)
    mean, variance = rng.standard_normal(n - small), np.diag(rng.uniform(0.1, 2.0, n - small))
    F, H, Q, f = np.zeros((n, n)), np.zeros((p, n)), np.zeros((n, n)), np.zeros(n)
    F[:small, :small], H[:, :small], f[:small], f[small:] = few.F, few.H, few.f, mean
    Q[:small, :small], Q[small:, small:] = few.Q, variance
    padded = Mode("few", F=F, H=H, Q=Q, R=few.R, f=f)
    chain = ModeTransition.from_rows(("few", "full"), rng.dirichlet(np.ones(2), size=2))
    x, P = np.concatenate([rng.standard_normal(small), mean]), np.eye(n)
    P[small:, small:] = variance
    system = StochasticSystem([padded, full], chain, x=x, P=P, mu=[0.4, 0.6])
    z = drawn_record(rng, system)[0]
    keep, zeros = np.eye(n)[:small], np.zeros((small, small))
    unknown = np.block([[zeros, np.zeros((small, n - small))], [np.zeros((n - small, small)), variance]])
    maps = {
        ("few", "full"): conversion(keep),
        ("full", "few"): conversion(keep.T, offset=np.concatenate([np.zeros(small), mean]), covariance=unknown),
    }
    imm = Interacting([LinearFilter(few), LinearFilter(full)], chain, maps)
    belief, made = imm.prior([x[:small], x], [P[:small, :small], P], [0.4, 0.6]), estimate(system, z)
    for k, row in enumerate(z):
        posterior = imm.update(imm.predict(belief), row)
        belief = posterior.belief
        mixed = imm.mixture(belief, to=1)
        for ours, wanted in (*zip(mixed, (made.x[k], made.P[k]), strict=True), (belief.mu, made.mu[k])):
            np.testing.assert_allclose(ours, wanted, rtol=0, atol=1e-8 * max(1.0, np.abs(wanted).max()))
        assert posterior.log_likelihood == pytest.approx(made.log_likelihood[k], abs=1e-8)


def random_mode(rng, name, n, p):
    F, H, root = rng.standard_normal((n, n)), rng.standard_normal((p, n)), rng.standard_normal((n, n))
    F /= max(1.0, np.abs(np.linalg.eigvals(F)).max())
    return Mode(name, F=F, H=H, Q=root @ root.T + 0.01 * np.eye(n), R=np.eye(p), f=rng.standard_normal(n))


def test_a_mode_without_accelerations_interacts_with_one_that_has_them_as_in_the_padded_model():
    """Section 5 of the paper gives the straight mode two accelerations that are always zero; here it has none."""
    model = stochastic_system(load("models/hwang2006/maneuver.yaml"))
    keep = [0, 1, 3, 4]
    rest = np.zeros((6, 6))  # no acceleration before the first row, in either mode
    rest[np.ix_(keep, keep)] = model.P[np.ix_(keep, keep)]
    padded = StochasticSystem(model.modes, model.chain, x=model.x, P=rest, mu=model.mu)
    straight, turning = padded.modes
    small = Mode(
        "CV", F=straight.F[np.ix_(keep, keep)], H=straight.H[:, keep], Q=straight.Q[np.ix_(keep, keep)], R=straight.R
    )
    drop = np.eye(6)[keep]
    imm = Interacting(
        [LinearFilter(small), LinearFilter(turning)],
        padded.chain,
        {("CV", "CT"): conversion(drop), ("CT", "CV"): conversion(drop.T)},
    )
    prior = imm.prior([padded.x[keep], padded.x], [padded.P[np.ix_(keep, keep)], padded.P], padded.mu)
    z = sample(padded, 60, seed=4).z
    expected = estimate(padded, z)
    x, _, mu, log_likelihood, *_ = run(imm, prior, rows_of(padded, z))
    np.testing.assert_allclose(mu, expected.mu, atol=1e-8)
    np.testing.assert_allclose(log_likelihood, expected.log_likelihood, rtol=1e-8)
    np.testing.assert_allclose(x, expected.x[:, keep], rtol=1e-8, atol=1e-5)


def pendulum(x, u):
    """A pendulum of 1 s^-2 over 0.1 s, one Euler step."""
    return np.stack([x[..., 0] + 0.1 * x[..., 1], x[..., 1] - 0.1 * np.sin(x[..., 0])], axis=-1)


def pendulum_slope(x, u):
    slope = np.zeros((*x.shape, 2))
    slope[..., 0, 0], slope[..., 0, 1] = 1.0, 0.1
    slope[..., 1, 0], slope[..., 1, 1] = -0.1 * np.cos(x[..., 0]), 1.0
    return slope


def height(x, u):
    return np.cos(x[..., :1])


def height_slope(x, u):
    return np.stack([-np.sin(x[..., :1]), np.zeros_like(x[..., :1])], axis=-1)


NOISE = {"Q": np.diag([1e-4, 1e-3]), "R": np.array([[0.01]])}


def test_unscented_filters_inside_an_imm_agree_with_filterpy():
    kalman = pytest.importorskip("filterpy.kalman", reason="FilterPy is not installed")
    chain = ModeTransition.from_rows(("calm", "shaken"), [[0.9, 0.1], [0.3, 0.7]])
    noises = (NOISE["Q"], 30.0 * NOISE["Q"])
    ours = Interacting(
        [
            UnscentedFilter(name, f=pendulum, h=height, Q=Q, R=NOISE["R"], spread=0.5, scaling=1.0)
            for name, Q in zip(chain.modes, noises, strict=True)
        ],
        chain,
    )
    start, P, z = np.array([0.8, 0.0]), 0.05 * np.eye(2), 0.7 + 0.1 * np.random.default_rng(3).standard_normal((25, 1))
    theirs = []
    for Q in noises:
        points = kalman.MerweScaledSigmaPoints(2, alpha=0.5, beta=2.0, kappa=1.0)
        one = kalman.UnscentedKalmanFilter(
            2, 1, 0.1, hx=lambda x: height(x, None), fx=lambda x, dt: pendulum(x, None), points=points
        )
        one.x, one.P, one.Q, one.R = start.copy(), P.copy(), Q, NOISE["R"]
        theirs.append(one)
    imm = kalman.IMMEstimator(theirs, np.array([0.6, 0.4]), chain.probability_to_from.T)
    x, spread, mu, *_ = run(ours, ours.prior([start] * 2, [P] * 2, [0.6, 0.4]), [(row, None, None) for row in z])
    for k, row in enumerate(z):
        imm.predict()
        imm.update(row)
        np.testing.assert_allclose(mu[k], imm.mu, atol=1e-9)
        np.testing.assert_allclose(x[k], imm.x, atol=1e-9)
        np.testing.assert_allclose(spread[k], imm.P, atol=1e-9)


def test_the_extended_filter_agrees_with_filterpy():
    kalman = pytest.importorskip("filterpy.kalman", reason="FilterPy is not installed")
    ours = ExtendedFilter("swing", f=pendulum, h=height, F=pendulum_slope, H=height_slope, **NOISE)
    theirs = kalman.ExtendedKalmanFilter(2, 1)
    x, P = np.array([0.8, 0.0]), 0.05 * np.eye(2)
    theirs.x, theirs.P, theirs.Q, theirs.R = x[:, None].copy(), P.copy(), NOISE["Q"], NOISE["R"]
    for row in 0.7 + 0.1 * np.random.default_rng(4).standard_normal((25, 1)):
        x, P = ours.move(x, P, None)
        made = ours.correct(x, P, row, None)
        x, P = made.x, made.P
        before = theirs.x[:, 0].copy()
        theirs.F = pendulum_slope(before, None)
        theirs.x = pendulum(before, None)[:, None]
        theirs.P = theirs.F @ theirs.P @ theirs.F.T + theirs.Q
        theirs.update(row[:, None], lambda x: height_slope(x[:, 0], None), lambda x: height(x[:, 0], None)[:, None])
        np.testing.assert_allclose(x, theirs.x[:, 0], atol=1e-10)
        np.testing.assert_allclose(P, theirs.P, atol=1e-10)


def test_trials_of_nonlinear_filters_are_the_single_ones():
    ours = [
        ExtendedFilter("a", f=pendulum, h=height, F=pendulum_slope, H=height_slope, **NOISE),
        UnscentedFilter("b", f=pendulum, h=height, **NOISE),
    ]
    imm = Interacting(ours, ModeTransition(("a", "b"), [[0.5, 0.5], [0.5, 0.5]]))
    z = 0.7 + 0.1 * np.random.default_rng(5).standard_normal((30, 10, 1))
    start, P = [np.array([0.8, 0.0])] * 2, [0.05 * np.eye(2)] * 2
    together = run(imm, imm.prior(start, P, [0.5, 0.5], (30,)), [(z[:, k], None, None) for k in range(10)])
    single = run(imm, imm.prior(start, P, [0.5, 0.5]), [(z[7, k], None, None) for k in range(10)])
    for many, one in zip(together, single, strict=True):
        np.testing.assert_allclose(many[:, 7], one, rtol=1e-10, atol=1e-12)


def test_states_that_differ_in_number_need_a_conversion_that_fits():
    walk = Mode("walk", F=[[1.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]])
    move = Mode("move", F=np.eye(2), H=[[1.0, 0.0]], Q=np.eye(2), R=[[1.0]])
    chain = ModeTransition(("walk", "move"), [[0.5, 0.5], [0.5, 0.5]])
    filters = [LinearFilter(walk), LinearFilter(move)]
    for conversions in ({}, {("walk", "move"): conversion([[1.0]]), ("move", "walk"): conversion([[1.0], [0.0]])}):
        with pytest.raises(UsageError) as caught:
            Interacting(filters, chain, conversions)
        assert caught.value.diagnostics[0].code == "DH1104"
    with pytest.raises(UsageError):
        Interacting(filters[:1], chain)
