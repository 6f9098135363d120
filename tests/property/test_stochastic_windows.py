"""Outputs of a window, their distances and the rows they need, beside the definitions and beside drawn runs."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad
from scipy.stats import norm

from deshybrid.diagnostics import UsageError
from deshybrid.linear.observability import observability_index, observability_matrix
from deshybrid.stochastic.distance import output_distance, unexplained
from deshybrid.stochastic.observability import literal_verdict
from deshybrid.stochastic.outputs import OutputGaussian, output_gaussian, staying, switching_once
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from deshybrid.stochastic.telling_apart import Window, compare_modes, compare_switches
from tests.naive_windows import bhattacharyya, covariance_as_printed, kullback_leibler, stacked_outputs
from tests.strategies import random_stochastic_system

seeds = st.integers(0, 2**32 - 1)


@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_outputs_of_any_sequence_of_modes_are_the_sum_of_what_every_noise_adds(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    rows = int(rng.integers(1, 7))
    measuring = [system.modes[i] for i in rng.integers(0, len(system.modes), rows)]
    moving = [system.modes[i] for i in rng.integers(0, len(system.modes), rows - 1)]
    u = rng.standard_normal((rows, system.bank.B.shape[2]))
    made = output_gaussian(measuring, moving, x=system.x, P=system.P, u=u)
    mean, covariance = stacked_outputs(measuring, moving, system.x, system.P, u)
    np.testing.assert_allclose(made.mean, mean, atol=1e-9 * max(1.0, np.abs(mean).max()))
    np.testing.assert_allclose(made.covariance, covariance, atol=1e-9 * np.abs(covariance).max())


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_covariance_of_one_mode_is_the_formula_of_the_paper(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    mode, rows = system.modes[0], int(rng.integers(1, 7))
    expected = covariance_as_printed(mode, system.P, rows)
    made = staying(mode, rows, x=system.x, P=system.P).covariance
    np.testing.assert_allclose(made, expected, atol=1e-9 * np.abs(expected).max())


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_distances_of_every_window_are_those_of_its_own_block(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    one, two = (staying(mode, 5, x=system.x, P=system.P) for mode in system.modes[:2])
    made, p = output_distance(one, two), len(system.modes[0].g)
    for rows in range(1, 6):
        end = rows * p
        block = (one.mean[:end], one.covariance[:end, :end], two.mean[:end], two.covariance[:end, :end])
        back = (*block[2:], *block[:2])
        assert made.forward[rows - 1] == pytest.approx(kullback_leibler(*block), rel=1e-7, abs=1e-9)
        assert made.backward[rows - 1] == pytest.approx(kullback_leibler(*back), rel=1e-7, abs=1e-9)
        assert made.bhattacharyya[rows - 1] == pytest.approx(bhattacharyya(*block), rel=1e-7, abs=1e-9)
    assert (made.chernoff >= made.bhattacharyya).all()
    assert (np.diff(made.bhattacharyya) >= -1e-9).all()


def gaussian(mean: float, variance: float) -> OutputGaussian:
    return OutputGaussian(1, np.array([mean]), np.array([[variance]]))


def test_chernoff_distance_of_two_numbers_is_the_integral_of_its_definition():
    """The largest over the exponents of -ln ∫ p^s q^(1-s), with p = N(0, 1) and q = N(1, 9)."""
    p, q = norm(0.0, 1.0).pdf, norm(1.0, 3.0).pdf
    values = [-np.log(quad(lambda x, s=s: p(x) ** s * q(x) ** (1 - s), -60, 60)[0]) for s in np.arange(1, 10) / 10]
    assert output_distance(gaussian(0.0, 1.0), gaussian(1.0, 9.0)).chernoff[0] == pytest.approx(max(values), rel=1e-8)


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_no_pair_of_states_is_nearer_than_the_worst(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    one, two, rows = system.modes[0], system.modes[1], 4
    n, nothing = len(one.f), np.zeros_like(system.P)
    worst = compare_modes(system, Window(rows=rows))[0].worst_states
    for _ in range(5):
        x, y = rng.standard_normal((2, n)) * 3.0
        known = output_distance(staying(one, rows, x=x, P=nothing), staying(two, rows, x=y, P=nothing))
        assert (known.bhattacharyya >= worst - 1e-9).all()


@given(seed=seeds)
@settings(max_examples=15, deadline=None)
def test_some_pair_of_states_is_as_near_as_the_worst(seed):
    """The pair is found by weighted least squares over both states, without the factor that the code uses."""
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    one, two, rows, n = system.modes[0], system.modes[1], 4, len(system.x)
    zero, nothing = np.zeros(n), np.zeros_like(system.P)
    outputs = [staying(mode, rows, x=zero, P=nothing) for mode in (one, two)]
    seen = [np.vstack([mode.H @ np.linalg.matrix_power(mode.F, k) for k in range(rows)]) for mode in (one, two)]
    free, weight = np.hstack([seen[0], -seen[1]]), np.linalg.inv((outputs[0].covariance + outputs[1].covariance) / 2)
    gap = outputs[0].mean - outputs[1].mean
    states = -np.linalg.pinv(free.T @ weight @ free, rcond=1e-10) @ free.T @ weight @ gap
    known = [staying(m, rows, x=s, P=nothing) for m, s in ((one, states[:n]), (two, states[n:]))]
    assert unexplained(*outputs, free)[-1] == pytest.approx(
        output_distance(*known).bhattacharyya[-1], rel=1e-5, abs=1e-8
    )


def error_of_the_likelihood_ratio(one: OutputGaussian, two: OutputGaussian, rows: int, seed: int) -> float:
    """Share of wrong names over 40,000 drawn windows, half from each, named by the larger density."""
    rng, end = np.random.default_rng(seed), rows * (len(one.mean) // one.rows)
    wrong = 0.0
    for true in (one, two):
        drawn = rng.multivariate_normal(true.mean[:end], true.covariance[:end, :end], size=20_000)
        density = []
        for part in (one, two):
            S = part.covariance[:end, :end]
            gap = drawn - part.mean[:end]
            density.append(-0.5 * ((gap @ np.linalg.inv(S)) * gap).sum(axis=1) - 0.5 * np.linalg.slogdet(S)[1])
        wrong += 0.5 * float(((density[0] < density[1]) if true is one else (density[1] <= density[0])).mean())
    return wrong


@pytest.mark.parametrize("seed", [1, 2, 3, 5])
def test_drawn_windows_are_named_as_well_as_the_rows_say(seed):
    """The stated error is met by the rows that suffice, and one row less than needed never meets it."""
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    one, two = (staying(mode, 60, x=system.x, P=system.P) for mode in system.modes[:2])
    distance, error = output_distance(one, two), 0.02
    enough, needed = distance.rows_that_suffice(error), distance.rows_needed(error)
    assert enough is not None
    assert needed is not None
    margin = 4 * np.sqrt(error / 40_000)
    assert error_of_the_likelihood_ratio(one, two, enough, seed) <= error + margin
    if needed > 1:
        assert error_of_the_likelihood_ratio(one, two, needed - 1, seed) >= error - margin


def test_a_switch_is_compared_over_the_rows_of_the_new_mode():
    system = random_stochastic_system(np.random.default_rng(8))
    window = Window(rows=5, before=3)
    for found in compare_switches(system, window):
        source, target = (system.modes[system.names.index(name)] for name in (found.source, found.target))
        outputs = [switching_once(source, target, at, 8, x=system.x, P=system.P) for at in (3, 8)]
        for rows in range(1, 6):
            end = (3 + rows) * len(source.g)
            blocks = [part for o in outputs for part in (o.mean[:end], o.covariance[:end, :end])]
            assert found.distance.bhattacharyya[rows - 1] == pytest.approx(bhattacharyya(*blocks), rel=1e-7)


def test_drawn_switches_are_timed_as_well_as_the_comparison_says():
    """A switch, and one `time_known_to` rows later, are told apart by the whole window with the stated error."""
    system, window = random_stochastic_system(np.random.default_rng(8)), Window(rows=12, before=3, error=0.05)
    found = next(f for f in compare_switches(system, window) if f.time_known_to is not None)
    source, target = (system.modes[system.names.index(name)] for name in (found.source, found.target))
    one, two = (switching_once(source, target, at, 15, x=system.x, P=system.P) for at in (3, 3 + found.time_known_to))
    assert error_of_the_likelihood_ratio(one, two, 15, seed=4) <= 0.05 + 4 * np.sqrt(0.05 / 40_000)


def test_before_the_switch_no_distance_has_grown():
    system = random_stochastic_system(np.random.default_rng(9))
    one, two = (switching_once(*system.modes[:2], at, 8, x=system.x, P=system.P) for at in (3, 8))
    np.testing.assert_allclose(output_distance(one, two).bhattacharyya[:3], 0.0, atol=1e-9)


@given(seed=seeds, alike=st.sampled_from(["nothing", "sensors", "all but the process noise", "everything"]))
@settings(max_examples=40, deadline=None)
def test_the_literal_verdict_compares_the_covariances_that_the_paper_prints(seed, alike):
    """Lemma 2 by O Π₀ Oᵀ + T Q̄ Tᵀ + R̄ of τ̄ rows; Lemma 3 by (9) and (10), with F = [A^(κ-1) ... I] written out."""
    rng = np.random.default_rng(seed)
    drawn = random_stochastic_system(rng, plain=True)
    one, two = drawn.modes[:2]
    kept = {"nothing": "", "sensors": "HR", "all but the process noise": "FHR", "everything": "FHRQ"}[alike]
    other = Mode("other", **{key: getattr(one if key in kept else two, key) for key in "FHRQ"})
    chain = ModeTransition((one.name, "other"), np.full((2, 2), 0.5))
    system = StochasticSystem((one, other), chain, x=drawn.x, P=drawn.P, mu=[0.5, 0.5])
    found, tau = literal_verdict(system), max(observability_index(m.F, m.H) for m in (one, other))
    assert found.index == tau
    equal = np.allclose(covariance_as_printed(one, drawn.P, tau), covariance_as_printed(other, drawn.P, tau))
    assert bool(found.equal_modes) is equal
    for before, after in ((one, other), (other, one)):
        power = [np.linalg.matrix_power(before.F, k) for k in range(tau + 1)]
        M = power[tau] @ drawn.P @ power[tau].T + sum(power[k] @ before.Q @ power[k].T for k in range(tau))
        sides = [m.H @ M @ m.H.T + m.R for m in (after, before)]
        assert ((before.name, after.name) in found.equal_switches) is bool(np.allclose(*sides))


def test_lemma_3_is_asked_as_many_steps_after_the_first_row_as_the_joint_index_says():
    """One step makes Π₀ = 1 a variance of 2, and 1·2 + 10 = 4·2 + 4: this switch does not change the variance."""
    modes = [Mode(name, F=[[1.0]], H=[[H]], Q=[[1.0]], R=[[R]]) for name, H, R in (("a", 1.0, 10.0), ("b", 2.0, 4.0))]
    for P, hidden in ((1.0, True), (0.5, False)):
        system = StochasticSystem(modes, ModeTransition("ab", np.full((2, 2), 0.5)), x=[0.0], P=[[P]], mu=[0.5, 0.5])
        assert bool(literal_verdict(system).equal_switches) is hidden


def test_identical_modes_are_never_told_apart():
    system = random_stochastic_system(np.random.default_rng(10))
    mode = system.modes[0]
    twin = [staying(mode, 30, x=system.x, P=system.P)] * 2
    distance = output_distance(*twin)
    np.testing.assert_allclose(distance.chernoff, 0.0, atol=1e-9)
    assert distance.rows_needed(0.4) is None
    assert distance.rows_that_suffice(0.4) is None


def test_outputs_without_noise_have_no_density_and_the_message_says_from_which_row_on():
    silent = OutputGaussian(3, np.zeros(3), np.ones((3, 3)))
    with pytest.raises(UsageError) as caught:
        output_distance(silent, silent)
    assert caught.value.diagnostics[0].code == "DH1201"
    assert "up to row 2" in caught.value.diagnostics[0].message


@given(seed=seeds)
@settings(max_examples=25, deadline=None)
def test_observability_index_is_where_the_rank_becomes_full(seed):
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    A, C = rng.integers(-1, 2, (n, n)).astype(float), rng.integers(-1, 2, (1, n)).astype(float)
    whole = observability_matrix(A, C)
    ranks = [int(np.linalg.matrix_rank(whole[:rows])) for rows in range(1, n + 1)]
    assert observability_index(A, C) == (ranks.index(n) + 1 if n in ranks else None)
