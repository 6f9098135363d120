"""Means of residuals and detection delays, beside constant-gain filters that are run, drawn runs, the definitions."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.stochastic.detection_delay import (
    SETTLED_ROWS,
    drawn_delays,
    mean_run,
    predicted_delay,
    proposition_4_1,
    switched,
)
from deshybrid.stochastic.mean_residual import equalities, mean_recursion, mismatch, steady_residual
from deshybrid.stochastic.printed_delays import printed_delays
from deshybrid.stochastic.record import estimate
from deshybrid.stochastic.steady_state import steady_state
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from tests.naive_filters import constant_gain_step
from tests.strategies import random_stochastic_system

seeds = st.integers(0, 2**32 - 1)


def filters_of(system):
    return tuple(steady_state(mode).filter for mode in system.modes)


def tracked(own, true, start, rows, u, *, noise=None):
    """A constant-gain filter of one mode on a plant of another, run as such: residuals and errors of each row.

    start: the plant's state and the estimate; noise: pairs (w, v) for each row; without it the mean run.
    """
    x, estimates = start
    residuals, errors = [], []
    for k in range(rows):
        row = (u[k], u[k + 1])
        x, estimates, residual = constant_gain_step(own, true, (x, estimates), row, noise[k] if noise else (0.0, 0.0))
        residuals.append(residual)
        errors.append(x - estimates)
    return np.array(residuals), np.array(errors)


@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_the_mean_recursion_is_the_filter_run_on_the_mean_of_the_plant(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    own, true, rows = filters_of(system)[0], system.modes[1], 8
    x, start = rng.standard_normal((2, len(system.x)))
    u = rng.standard_normal((rows + 1, system.bank.B.shape[2]))
    made = mean_recursion(mismatch(own, true), start, x - start, rows, u)
    for found, expected in zip(made, tracked(own, true, (x, start), rows, u), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-9 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_the_mean_recursion_is_the_mean_over_drawn_runs(seed):
    """Within five standard errors, entry by entry, over 1,500 runs."""
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    own, true, rows, trials = filters_of(system)[0], system.modes[1], 5, 1500
    x, start = rng.standard_normal((2, len(system.x)))
    u = rng.standard_normal((rows + 1, system.bank.B.shape[2]))
    roots = np.linalg.cholesky(true.Q), np.linalg.cholesky(true.R)
    drawn = []
    for _ in range(trials):
        noise = [tuple(root @ rng.standard_normal(len(root)) for root in roots) for _ in range(rows)]
        drawn.append(np.hstack(tracked(own, true, (x, start), rows, u, noise=noise)))
    expected = np.hstack(mean_recursion(mismatch(own, true), start, x - start, rows, u))
    error = np.std(drawn, axis=0) / np.sqrt(trials)
    assert (np.abs(np.mean(drawn, axis=0) - expected) <= 5 * error + 1e-12).all()


@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_the_steady_residual_is_where_a_plant_at_rest_leads(seed):
    rng = np.random.default_rng(seed)
    drawn = random_stochastic_system(rng)
    modes = [Mode(m.name, F=0.9 * m.F, H=m.H, Q=m.Q, R=m.R, B=m.B, D=m.D, f=m.f, g=m.g) for m in drawn.modes]
    system = StochasticSystem(modes, drawn.chain, x=drawn.x, P=drawn.P, mu=drawn.mu)
    own, true = filters_of(system)[0], system.modes[1]
    held = rng.standard_normal(system.bank.B.shape[2])
    residuals, _ = tracked(own, true, (system.x, system.x), 400, np.tile(held, (401, 1)))
    found = steady_residual(mismatch(own, true), held)
    np.testing.assert_allclose(found, residuals[-1], atol=1e-8 * max(1.0, np.abs(residuals[-1]).max()))


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_the_filter_of_the_true_mode_has_no_steady_residual_and_all_equalities_hold(seed):
    system = random_stochastic_system(np.random.default_rng(seed))
    pair = mismatch(filters_of(system)[0], system.modes[0])
    np.testing.assert_allclose(steady_residual(pair), 0.0, atol=1e-12)
    assert all(equality.holds for equality in equalities(pair))


def one(name="m", *, F=0.5, H=1.0, R=1.0, B=1.0, D=0.0, f=0.0, g=0.0) -> Mode:
    return Mode(name, F=[[F]], H=[[H]], Q=[[1.0]], R=[[R]], B=[[B]], D=[[D]], f=[f], g=[g])


@pytest.mark.parametrize(
    ("other", "failing"),
    [
        ({"F": 0.9}, {0, 1}),
        ({"H": 2.0}, {0, 1, 2, 3}),
        ({"B": 2.0}, {2, 3}),
        ({"D": 1.0}, {2, 3}),
        ({"f": 1.0}, {4}),
        ({"g": 1.0}, {4}),
        ({"R": 3.0}, set()),
    ],
)
def test_each_difference_of_the_modes_breaks_its_own_equalities(other, failing):
    pair = mismatch(steady_state(one()).filter, one(**other))
    assert {k for k, equality in enumerate(equalities(pair)) if not equality.holds} == failing


def test_a_moving_plant_leaves_no_steady_residual_unless_the_models_of_motion_agree():
    still, moving = one(F=0.5), one(F=1.0)
    assert steady_residual(mismatch(steady_state(still).filter, moving)) is None
    assert steady_residual(mismatch(steady_state(moving).filter, one(F=1.0, f=1.0))) is not None


def test_theta_may_be_missing_where_the_steady_residual_is_there():
    """(I - K H_T) F_T has the eigenvalue 1, so that the paper's Θ does not exist; the filter still comes to rest."""
    own = steady_state(one(F=0.9, H=1.0)).filter
    gain = float(own.filter_gain[0, 0])
    true = one(F=0.9, H=(1.0 - 1.0 / 0.9) / gain, f=1.0)
    pair = mismatch(own, true)
    assert pair.error[0, 0] == pytest.approx(1.0)
    residuals, _ = tracked(own, true, np.zeros((2, 1)), 500, np.zeros((501, 1)))
    np.testing.assert_allclose(steady_residual(pair), residuals[-1], rtol=1e-9)


@pytest.mark.parametrize("method", ["imm", "mmae"])
@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_the_mean_run_is_the_filter_on_measurements_without_noise(method, seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    modes = rng.integers(0, len(system.modes), 12)
    x, z = system.x, []
    for number in modes:
        mode = system.modes[number]
        x = mode.F @ x + mode.f
        z.append(mode.H @ x + mode.g)
    u = np.zeros((12, system.bank.B.shape[2]))
    np.testing.assert_allclose(mean_run(system, modes, method).mu, estimate(system, z, u, method=method).mu, atol=1e-12)


@given(seed=seeds)
@settings(max_examples=10, deadline=None)
def test_after_the_settled_rows_the_mean_run_of_mmae_is_the_recursion_of_the_steady_state_filters(seed):
    rng = np.random.default_rng(seed)
    drawn = random_stochastic_system(rng, plain=True)
    modes = [Mode(m.name, F=0.8 * m.F, H=m.H, Q=m.Q, R=m.R, f=rng.standard_normal(len(m.f))) for m in drawn.modes]
    system = StochasticSystem(modes, drawn.chain, x=drawn.x, P=drawn.P, mu=drawn.mu)
    old, new, rows = 0, 1, 6
    run, before = mean_run(system, switched(old, new, rows), "mmae"), SETTLED_ROWS - 1
    for number, own in enumerate(filters_of(system)):
        x = run.x[before, number]
        residuals, errors = mean_recursion(mismatch(own, modes[new]), x, run.true[before] - x, rows)
        scale = max(1.0, float(np.abs(residuals).max()))
        np.testing.assert_allclose(run.residual[SETTLED_ROWS:, number], residuals, atol=1e-6 * scale)
        np.testing.assert_allclose(run.true[SETTLED_ROWS:] - run.x[SETTLED_ROWS:, number], errors, atol=1e-6 * scale)


@pytest.mark.parametrize("method", ["imm", "mmae"])
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_the_second_condition_says_that_the_true_mode_is_the_most_probable_and_the_third_is_sufficient(method, seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    true = int(rng.integers(0, len(system.modes)))
    run = mean_run(system, np.full(12, true), method)
    conditions = proposition_4_1(run, true)
    others = [i for i in range(len(system.modes)) if i != true]
    more = run.mu[:, [true]] > run.mu[:, others]
    decided = np.abs(np.log(run.mu[:, [true]]) - np.log(run.mu[:, others])) > 1e-9
    assert (conditions.second[:, others] == more)[decided].all()
    assert (conditions.third <= conditions.second).all()
    assert (conditions.second <= conditions.first).all()


def test_the_determinants_as_printed_name_another_mode():
    """Two modes with the same mean: by the density the second is the more probable; counted twice, the first is."""
    system = StochasticSystem(
        [one("a", R=1.0), one("b", R=5.0)],
        ModeTransition("ab", [[0.35, 0.35], [0.65, 0.65]]),
        x=[0.0],
        P=[[1.0]],
        mu=[0.5, 0.5],
    )
    run = mean_run(system, np.zeros(20, dtype=int), "imm")
    right, printed = (proposition_4_1(run, 0, determinants=count).second[-1].all() for count in (1, 2))
    assert (right, printed) == (run.mu[-1, 0] > run.mu[-1, 1], True)
    assert not right


def turning(w: float, v: float) -> StochasticSystem:
    """The example of section 4.3 of Hwang et al. (2006) with a step of 1 s."""
    F = np.kron(np.eye(2), [[1.0, 1.0], [0.0, 1.0]])
    H, G = np.array([[1.0, 0, 0, 0], [0, 0, 1.0, 0]]), np.array([0.5, 1.0])
    Q, push = w**2 * np.kron(np.eye(2), np.outer(G, G)), 1.5 * np.kron([1.0, 1.0], G)
    modes = [Mode("CV", F=F, H=H, Q=Q, R=v**2 * np.eye(2)), Mode("CT", F=F, H=H, Q=Q, R=v**2 * np.eye(2), f=push)]
    chain = ModeTransition(("CV", "CT"), [[0.95, 0.05], [0.05, 0.95]])
    return StochasticSystem(modes, chain, x=[0, 100.0, 0, 50.0], P=np.diag([100.0, 25, 100, 25]), mu=[1.0, 0.0])


@pytest.mark.parametrize(("w", "v"), [(0.02, 0.3), (0.05, 1.0), (0.1, 2.0)])
@pytest.mark.parametrize("method", ["imm", "mmae"])
def test_the_predicted_delay_is_the_median_of_drawn_runs_within_a_row(method, w, v):
    system = turning(w, v)
    predicted = predicted_delay(system, "CV", "CT", method)
    drawn = drawn_delays(system, "CV", "CT", method, rows=40, trials=100, seed=3)
    assert predicted.source_named
    assert abs(predicted.rows - np.median(drawn)) <= 1


def test_modes_that_differ_in_noise_alone_are_told_by_drawn_runs_and_not_by_the_mean_run():
    system = StochasticSystem(
        [one("calm", R=1.0), one("noisy", R=25.0)],
        ModeTransition(("calm", "noisy"), [[0.95, 0.05], [0.05, 0.95]]),
        x=[0.0],
        P=[[1.0]],
        mu=[0.5, 0.5],
    )
    assert predicted_delay(system, "calm", "noisy", "imm").rows is None
    assert not predicted_delay(system, "noisy", "calm", "imm").source_named
    assert np.isfinite(drawn_delays(system, "calm", "noisy", "imm", rows=60, trials=50)).all()


def test_the_printed_lower_bound_of_the_wrong_residual_is_no_bound():
    """(18): the smallest singular value of a wide matrix bounds nothing from below."""
    own, true = steady_state(one(F=0.5)).filter, one(F=0.9)
    pair = mismatch(own, true)
    wide = np.hstack([pair.seen, pair.Hx, pair.Hu])
    error = np.array([1.0])
    estimates = -pair.seen @ error / pair.Hx[0]  # in the null space of the wide matrix
    residual, _ = mean_recursion(pair, estimates, error, 1)
    bound = np.linalg.svd(wide, compute_uv=False)[-1] * np.abs(error[0])
    assert np.abs(residual[0, 0]) < 1e-12
    assert bound > 0.8


def test_the_propositions_give_no_finite_delay_for_mmae_in_the_example_of_the_paper():
    """Its modes differ in their inputs alone, which (16) to (20) leave out; the delay is 7 rows all the same."""
    system = turning(0.05, 1.0)
    filters = filters_of(system)
    for source, target in (("CV", "CT"), ("CT", "CV")):
        printed = printed_delays(system, filters, source, target, "mmae")
        assert printed.proposition_4_2 == (None, None)
        assert printed.proposition_4_3 is None
        assert printed.proposition_4_4 is False
        assert predicted_delay(system, source, target, "mmae").rows == 7


def test_the_second_condition_of_4_2_gives_no_bound_where_it_divides_by_a_negative_logarithm():
    divided = 0
    for seed in range(20):
        system = random_stochastic_system(np.random.default_rng(seed))
        filters = filters_of(system)
        pair, own = mismatch(filters[0], system.modes[1]), mismatch(filters[1], system.modes[1])
        least, largest = np.linalg.svd(pair.error)[1][-1], np.linalg.norm(own.error, 2)
        found = printed_delays(system, filters, *system.names[:2], "imm", rows=5).proposition_4_2[1]
        if least < largest:
            divided += 1
            assert found is None
    assert divided > 10


def sigma(matrix, place):
    return np.linalg.svd(matrix, compute_uv=False)[place]


@pytest.mark.parametrize("method", ["imm", "mmae"])
@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_the_propositions_give_the_first_row_at_which_their_inequality_holds(method, seed):
    """4.2, condition 1, and 4.3 for two modes, in the paper's words; the IMM starts a step from mixed estimates."""
    rng = np.random.default_rng(seed)
    drawn = random_stochastic_system(rng, plain=True)
    stay = rng.uniform(0.05, 0.95)
    chain = ModeTransition(drawn.names[:2], [[stay, 1 - stay], [1 - stay, stay]])
    system = StochasticSystem(drawn.modes[:2], chain, x=5.0 * drawn.x, P=drawn.P, mu=[0.5, 0.5])
    i, T, rows = 0, 1, 12
    wrong, right = filters_of(system)
    run = mean_run(system, switched(i, T, rows), method)
    k_l = SETTLED_ROWS - 1
    start = [run.x[k_l, mode] for mode in (i, T)]
    if method == "imm":
        Pi, mu = chain.probability_to_from, run.mu[k_l]
        start = [sum(Pi[j, m] * mu[m] * run.x[k_l, m] for m in (i, T)) / (Pi[j] @ mu) for j in (i, T)]
    e = [float(np.linalg.norm(run.true[k_l] - x)) for x in start]
    if max(e) < 1e-9:
        return
    A, C, K = system.modes[T].F, system.modes[T].H, wrong.filter_gain
    dA, dC = A - wrong.mode.F, C - wrong.mode.H
    one = np.eye(len(A))
    Fi, FT = (one - K @ C) @ A, (one - right.filter_gain @ C) @ A
    Hx, Gx = C @ dA + dC @ A - dC @ dA, (one - K @ C) @ dA - K @ dC @ wrong.mode.F
    largest = np.linalg.eigvalsh(np.linalg.inv(right.S))[-1]
    alpha = np.linalg.eigvalsh(np.linalg.inv(wrong.S))[0] / largest
    sizes = np.log(np.linalg.det(wrong.S) / np.linalg.det(right.S))

    def sides(delta):
        left = sigma(C @ A, 0) ** 2 * sigma(FT, 0) ** (2 * (delta - 1)) * e[1] ** 2
        wide = sigma(np.hstack([Fi, Gx]), -1) ** (2 * (delta - 1))
        return left, alpha * sigma(np.hstack([C @ A, Hx]), -1) ** 2 * wide * (0.0 if e[0] < 1e-9 else e[0] ** 2)

    first = proposition_4_1(run, T, determinants=2).first[SETTLED_ROWS:, i]
    found = {"4.2": None, "4.3": None}
    for delta in range(rows, 0, -1):
        left, grown = sides(delta)
        before = run.predicted_mu[k_l + delta]
        if left < 2 / largest * (sizes + np.log(before[T] / before[i])) + grown and first[delta - 1]:
            found["4.2"] = delta
        if grown + 2 / largest * (sizes - np.log(stay / (1 - stay))) > left:
            found["4.3"] = delta
    made = printed_delays(system, (wrong, right), *system.names, method, rows=rows)
    assert (made.proposition_4_2[0], made.proposition_4_3) == (found["4.2"], found["4.3"])


def test_a_run_switches_after_the_settled_rows():
    modes = switched(1, 0, 3)
    assert modes.tolist() == [1] * SETTLED_ROWS + [0] * 3
