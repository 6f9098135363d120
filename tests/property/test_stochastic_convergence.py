"""Steady-state filters, stays between switches and boundedness, beside iterated and enumerated definitions."""

from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.stochastic.boundedness import boundedness, rows_that_show, unseen_along
from deshybrid.stochastic.record import estimate_known
from deshybrid.stochastic.sojourn import Demand, sojourn_bound
from deshybrid.stochastic.steady_state import steady_state
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from tests.naive_filters import constant_gain_step
from tests.strategies import random_stochastic_system

seeds = st.integers(0, 2**32 - 1)


def iterated(mode: Mode, P, rows: int):
    """The covariance of the prediction after so many rows of the textbook filter."""
    for _ in range(rows):
        S = mode.H @ P @ mode.H.T + mode.R
        P = mode.F @ (P - P @ mode.H.T @ np.linalg.inv(S) @ mode.H @ P) @ mode.F.T + mode.Q
    return P


@given(seed=seeds)
@settings(max_examples=6, deadline=None)
def test_the_steady_state_is_where_the_filter_ends_from_any_prior(seed):
    rng = np.random.default_rng(seed)
    mode = random_stochastic_system(rng).modes[0]
    found = steady_state(mode).filter
    assert found is not None
    for scale in (0.01, 100.0):
        P = iterated(mode, scale * np.eye(len(mode.f)), 2000)
        np.testing.assert_allclose(found.P, P, atol=1e-6 * np.abs(P).max())


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_both_gains_have_the_same_eigenvalues_and_the_predictor_gain_is_f_times_the_filter_gain(seed):
    mode = random_stochastic_system(np.random.default_rng(seed)).modes[0]
    found = steady_state(mode).filter
    np.testing.assert_allclose(found.predictor_gain, mode.F @ found.filter_gain, atol=1e-12)
    spectra = [np.poly(E) for E in (found.predictor_error, found.filter_error)]
    np.testing.assert_allclose(*spectra, atol=1e-8)
    assert found.radius < 1.0


@pytest.mark.parametrize(
    ("F", "H", "Q", "key"),
    [
        ([[2.0]], [[0.0]], [[1.0]], "undetectable"),
        ([[1.0]], [[0.0]], [[1.0]], "undetectable"),
        ([[1.0]], [[1.0]], [[0.0]], "undisturbed"),
        ([[0.0, 1.0], [-1.0, 0.0]], [[1.0, 0.0]], np.zeros((2, 2)), "undisturbed"),
        ([[1.0, 0.0], [0.0, 0.5]], [[1.0, 1.0]], [[0.0, 0.0], [0.0, 1.0]], "undisturbed"),
    ],
)
def test_a_filter_is_refused_with_the_eigenvalue_that_theorem_2_forbids(F, H, Q, key):
    state = steady_state(Mode("m", F=F, H=H, Q=Q, R=[[1.0]]))
    assert state.filter is None
    assert getattr(state, key)
    assert abs(abs(getattr(state, key)[0]) - 1.0) < 1e-9 or key == "undetectable"
    assert state.reason


@pytest.mark.parametrize(("F", "H", "Q"), [([[0.5]], [[0.0]], [[0.0]]), ([[2.0]], [[1.0]], [[0.0]])])
def test_neither_a_hidden_mode_that_decays_nor_a_calm_one_off_the_circle_stands_in_the_way(F, H, Q):
    """Detectable, not observable; and an unstable mode without noise, of which the filter still needs a gain."""
    found = steady_state(Mode("m", F=F, H=H, Q=Q, R=[[1.0]])).filter
    assert found is not None
    assert found.radius == pytest.approx(0.5)


def test_the_solution_need_not_be_positive_definite_as_the_paper_says_it_is():
    calm = Mode("calm", F=np.diag([0.5, 0.9]), H=[[1.0, 1.0]], Q=np.diag([1.0, 0.0]), R=[[1.0]])
    found = steady_state(calm).filter
    assert found is not None
    assert not found.positive_definite


def one_step(own, plant, gain, states, u):
    """The next mean state and estimate; states: those of now; u: the inputs of this row and of the next."""
    if gain == "filter":
        return constant_gain_step(own, plant, states, u)[:2]
    mode, (x, estimate), (now, _) = own.mode, states, u
    residual = plant.H @ x + plant.D @ now + plant.g - mode.H @ estimate - mode.D @ now - mode.g
    ahead = mode.F @ estimate + mode.B @ now + mode.f
    return plant.F @ x + plant.B @ now + plant.f, ahead + own.predictor_gain @ residual


@pytest.mark.parametrize("gain", ["predictor", "filter"])
@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_the_mismatch_is_the_most_that_a_step_of_the_wrong_filter_adds_to_a_component(gain, seed):
    """Over all corners of the bounds of state and inputs, from an error of zero."""
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    n, m = len(system.x), system.bank.B.shape[2]
    state, inputs = rng.random(n) + 0.5, rng.random(m) + 0.5
    filters = [steady_state(mode).filter for mode in system.modes[:2]]
    bound = sojourn_bound(filters, gain, Demand(0.999, 1, 1e6, state, inputs))
    for terms, own, other in zip(bound.modes, filters, filters[::-1], strict=True):
        most = 0.0
        for signs in product((-1.0, 1.0), repeat=n + 2 * m):
            x = state * signs[:n]
            u = (inputs * signs[n : n + m], inputs * signs[n + m :])
            after, estimate = one_step(own, other.mode, gain, (x, x), u)
            most = max(most, float(np.abs(after - estimate).max()))
        assert terms.mismatch == pytest.approx(most, rel=1e-9)


def error_at_detections(filters, gain, delay, stays, rng):
    """Mean errors of the switching constant-gain filters at the instants at which a switch becomes known.

    Plant and filters are run without noise; the filter keeps its old mode for the delay; inputs lie between -1 and 1.
    Returns, for each detection, the rows since the first and the norm of the error, and the largest mean state met.
    """
    modes = [found.mode for found in filters]
    x, error = rng.standard_normal((2, len(modes[0].f)))
    u = rng.uniform(-1.0, 1.0, (sum(stays) + 1, modes[0].B.shape[1]))
    estimate, true, used, rows = x - error, 0, 0, 0
    seen, largest = [(0, float(np.linalg.norm(error)))], np.abs(x)
    for stay in stays:
        for row in range(stay):
            if row == delay and rows:
                used = true
                seen.append((rows, float(np.linalg.norm(x - estimate))))
            x, estimate = one_step(filters[used], modes[true], gain, (x, estimate), u[rows : rows + 2])
            largest, rows = np.maximum(largest, np.abs(x)), rows + 1
        true = (true + int(rng.integers(1, len(modes)))) % len(modes)
    return seen, largest


def shrunk(system: StochasticSystem, factor: float) -> StochasticSystem:
    """The same with plants that are stable, so that the mean states stay bounded."""
    modes = [Mode(m.name, F=factor * m.F, H=m.H, Q=m.Q, R=m.R, f=m.f, g=m.g, B=m.B, D=m.D) for m in system.modes]
    return StochasticSystem(modes, system.chain, x=system.x, P=system.P, mu=system.mu)


@pytest.mark.parametrize("gain", ["predictor", "filter"])
@pytest.mark.parametrize("delay", [0, 2])
@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_stays_as_long_as_the_bound_let_the_mean_error_shrink_as_asked(gain, delay, seed):
    """At every detection: at most μ^k of the first error, and M0; the shortest stays, or some rows more."""
    rng = np.random.default_rng(seed)
    system = shrunk(random_stochastic_system(rng), 0.9)
    filters = [steady_state(mode).filter for mode in system.modes]
    factor = 0.5 * (1.0 + max(found.radius for found in filters))
    n, inputs = len(system.x), np.ones(system.bank.B.shape[2])
    _, limit = error_at_detections(filters, gain, delay, [40] * 6, np.random.default_rng(seed))
    first = sojourn_bound(filters, gain, Demand(factor, delay, 1.0, 2.0 * limit, inputs))
    added = max(np.sqrt(n) * terms.mismatch * delay * terms.condition for terms in first.modes)
    demand = Demand(factor, delay, 1.2 * added, 2.0 * limit, inputs)
    bound = sojourn_bound(filters, gain, demand)
    assert None not in (bound.by_condition, bound.by_powers)
    for steps in (bound.by_condition, bound.by_powers):
        stays = [max(steps, delay + 1) + int(rng.integers(0, 3)) for _ in range(6)]
        seen, largest = error_at_detections(filters, gain, delay, stays, rng)
        if (largest > 2.0 * limit).any():
            continue
        for rows, size in seen[1:]:
            assert size <= (factor ** (rows - delay) * seen[0][1] + demand.error_bound) * (1 + 1e-9)


def test_stays_as_printed_let_the_error_shrink_too_slowly():
    """ln κ / |ln α| rows leave an error of norm 1 as it is: only the repaired term gives the factor that is asked."""
    E_like = Mode("m", F=[[0.9, 1.0], [0.0, 0.85]], H=[[0.0, 0.0]], Q=np.zeros((2, 2)), R=[[1.0]])
    found = steady_state(E_like).filter
    bound = sojourn_bound([found], "predictor", Demand(0.95))
    printed, sound, powers = bound.as_printed, bound.by_condition, bound.by_powers
    sizes = {
        rows: float(np.linalg.norm(np.linalg.matrix_power(E_like.F, rows), 2)) for rows in (printed, sound, powers)
    }
    assert sizes[printed] > 0.95**printed
    assert sizes[sound] <= 0.95**sound
    assert sizes[powers] <= 0.95**powers
    assert powers <= sound


@given(seed=seeds)
@settings(max_examples=20, deadline=None)
def test_all_powers_from_the_bound_on_are_small_enough(seed):
    rng = np.random.default_rng(seed)
    filters = [steady_state(mode).filter for mode in random_stochastic_system(rng).modes]
    factor = 0.5 * (1.0 + max(found.radius for found in filters))
    bound = sojourn_bound(filters, "predictor", Demand(factor))
    for found in filters:
        for rows in range(bound.by_powers, 8 * bound.by_powers):
            power = np.linalg.matrix_power(found.predictor_error, rows)
            assert np.linalg.norm(power, 2) <= factor**rows * (1 + 1e-9)


def test_repeated_eigenvalues_are_bounded_by_powers_where_kappa_is_infinite():
    chain = Mode("chain", F=[[0.5, 1.0], [0.0, 0.5]], H=[[0.0, 0.0]], Q=np.zeros((2, 2)), R=[[1.0]])
    bound = sojourn_bound([steady_state(chain).filter], "predictor", Demand(0.9))
    assert bound.by_condition is None
    sizes = [float(np.linalg.norm(np.linalg.matrix_power(chain.F, rows), 2)) for rows in range(8)]
    assert bound.by_powers == 1 + max(rows for rows, size in enumerate(sizes) if rows and size > 0.9**rows)


def scalars(*pairs) -> list:
    return [steady_state(Mode(f"m{F}{H}", F=[[F]], H=[[H]], Q=[[1.0]], R=[[1.0]])).filter for F, H in pairs]


def test_with_the_filter_gain_the_printed_mismatch_is_too_small():
    """F = 2 in both, H = 1 and 2: a step adds K (H' - H) F x, of which (23) forgets the F."""
    bound = sojourn_bound(scalars((2.0, 1.0), (2.0, 2.0)), "filter", Demand(0.99, 1, 1e3, np.array([1.0])))
    for terms in bound.modes:
        assert terms.mismatch == pytest.approx(2.0 * terms.mismatch_printed)


def test_a_delay_that_adds_more_than_may_be_left_is_infeasible_at_any_stay():
    filters = scalars((0.5, 1.0), (0.9, 1.0))
    for allowed, feasible in ((0.39, False), (0.41, True)):
        bound = sojourn_bound(filters, "predictor", Demand(0.99, 1, allowed, np.array([1.0])))
        assert (bound.by_condition is not None) is feasible
    assert bound.modes[0].mismatch == pytest.approx(0.4)


def test_what_a_delay_adds_is_root_n_times_the_mismatch_times_kappa_a_row():
    """b = √n U Δ κ: an error of less may not be left, at any stay; of more it may."""
    F = np.array([[0.9, 1.0], [0.0, 0.7]])
    modes = [Mode(name, F=F, H=[[1.0, 0.0]], Q=np.eye(2), R=[[1.0]], f=f) for name, f in (("a", [0, 0]), ("b", [1, 2]))]
    filters = [steady_state(mode).filter for mode in modes]
    for gain in ("predictor", "filter"):
        E = [made.predictor_error if gain == "predictor" else made.filter_error for made in filters]
        U = [terms.mismatch for terms in sojourn_bound(filters, gain, Demand(0.99, 3, 1.0)).modes]
        added = max(
            np.sqrt(2) * u * 3 * np.linalg.cond(np.linalg.eig(matrix)[1]) for u, matrix in zip(U, E, strict=True)
        )
        for share, feasible in ((0.999, False), (1.001, True)):
            bound = sojourn_bound(filters, gain, Demand(0.99, 3, share * added))
            assert (bound.by_condition is not None) is feasible


def test_without_delay_no_error_is_left_and_no_bound_of_the_state_is_needed():
    assert sojourn_bound(scalars((0.5, 1.0), (0.9, 1.0)), "predictor", Demand(0.99)).by_condition == 1


def allowed_words(system, dwell, rows):
    """All sequences of modes of so many rows; the first stay may have begun before, the last go on."""
    chain = system.chain.probability_to_from
    for word in product(range(len(system.modes)), repeat=rows):
        if any(chain[b, a] <= 0.0 for a, b in pairwise(word)):
            continue
        cuts = [k for k in range(1, rows) if word[k] != word[k - 1]]
        if all(b - a >= dwell for a, b in pairwise(cuts)):
            yield word


def shows_all(system, word) -> bool:
    """Every state that no output of the word shows is zero at its end: by the whole observability matrix."""
    flow, rows = np.eye(len(system.x)), [system.bank.H[word[0]]]
    for mode in word[1:]:
        flow = system.bank.F[mode] @ flow
        rows.append(system.bank.H[mode] @ flow)
    hidden = np.linalg.svd(np.vstack(rows))[2][np.linalg.matrix_rank(np.vstack(rows)) :].T
    return bool(np.abs(flow @ hidden).max(initial=0.0) < 1e-9)


def small_switching(rng, *, dense: bool) -> StochasticSystem:
    """Two modes, two or three states, one output each, entries of -1, 0 and 1 times 1.1."""
    n = int(rng.integers(2, 4))
    modes = []
    for name in "ab":
        F = 1.1 * rng.integers(-1, 2, (n, n)).astype(float)
        H = rng.integers(-1, 2, (1, n)).astype(float) if dense else np.eye(n)[[int(rng.integers(0, n))]]
        modes.append(Mode(name, F=F, H=H, Q=np.eye(n), R=[[1.0]]))
    return StochasticSystem(
        modes, ModeTransition("ab", [[0.5, 0.5], [0.5, 0.5]]), x=np.zeros(n), P=np.eye(n), mu=[0.5, 0.5]
    )


@pytest.mark.parametrize("dwell", [1, 2])
@given(seed=seeds, dense=st.booleans())
@settings(max_examples=40, deadline=None)
def test_bounded_means_that_every_sequence_of_the_rows_shows_the_whole_state(dwell, seed, dense):
    system = small_switching(np.random.default_rng(seed), dense=dense)
    found = boundedness(system, dwell)
    if found.bounded and found.rows <= 8:
        assert all(shows_all(system, word) for word in allowed_words(system, dwell, found.rows))
        if found.rows > 1:
            assert not all(shows_all(system, word) for word in allowed_words(system, dwell, found.rows - 1))


@pytest.mark.parametrize("dwell", [1, 2])
@given(seed=seeds, dense=st.booleans())
@settings(max_examples=40, deadline=None)
def test_along_a_cycle_that_disproves_boundedness_the_covariance_of_the_filter_grows(dwell, seed, dense):
    system = small_switching(np.random.default_rng(seed), dense=dense)
    found = boundedness(system, dwell)
    if found.bounded is False:
        cycle = [system.names.index(name) for name in found.cycle]
        assert found.growth == pytest.approx(unseen_along(system, cycle))
        cuts = [k for k in range(len(cycle)) if cycle[k] != cycle[k - 1]]
        stays = [(b - a) % len(cycle) for a, b in zip(cuts, cuts[1:] + cuts[:1], strict=True)] if cuts else []
        assert all(stay >= dwell for stay in stays) or len(cuts) < 2
        modes = cycle * (1 + int(np.ceil(np.log(1e3) / np.log(found.growth))))
        made = estimate_known(system, np.zeros((len(modes), 1)), modes)
        assert np.trace(made.P[-1]) > 1e4


@given(seed=seeds, dense=st.booleans())
@settings(max_examples=30, deadline=None)
def test_the_rows_that_show_the_state_from_each_row_of_a_sequence_are_the_fewest(seed, dense):
    rng = np.random.default_rng(seed)
    system = small_switching(rng, dense=dense)
    modes = rng.integers(0, 2, 10).tolist()
    for start, found in enumerate(rows_that_show(system, modes)):
        fewest = [rows for rows in range(1, 11 - start) if shows_all(system, modes[start : start + rows])]
        assert found == (fewest[0] if fewest else None)


def test_two_observable_modes_that_switch_every_row_leave_half_of_the_state_unseen():
    """Both modes swap the states and measure one of them; alternating, they look where the state has just left."""
    swap = [[0.0, 1.2], [1.2, 0.0]]
    modes = [Mode(name, F=swap, H=[H], Q=np.eye(2), R=[[1.0]]) for name, H in (("left", [1, 0]), ("right", [0, 1]))]
    chain = ModeTransition(("left", "right"), [[0.5, 0.5], [0.5, 0.5]])
    system = StochasticSystem(modes, chain, x=[0.0, 0.0], P=np.eye(2), mu=[0.5, 0.5])
    assert boundedness(system).bounded is False
    assert boundedness(system, 2).bounded is True
    fast = estimate_known(system, np.zeros((40, 1)), [0, 1] * 20).P[-1]
    slow = estimate_known(system, np.zeros((40, 1)), [0, 0, 1, 1] * 10).P[-1]
    assert np.trace(fast) > 1e5
    assert np.trace(slow) < 10.0


@pytest.mark.parametrize("factor", [0.5, 0.95, 1.0])
def test_a_hidden_part_that_does_not_grow_leaves_the_question_undecided(factor):
    modes = [Mode(name, F=np.diag([factor, 1.1]), H=[[0, 1]], Q=np.eye(2), R=[[1.0]]) for name in "ab"]
    system = StochasticSystem(modes, ModeTransition("ab", np.full((2, 2), 0.5)), x=[0, 0], P=np.eye(2), mu=[0.5, 0.5])
    assert boundedness(system).bounded is None
