"""Reachable sets of the error: never left by an adversary, and near what it reaches."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

from benchmarks.adversary import Jump, place, worst_errors
from deshybrid.continuous.dwell import certify_dwell
from deshybrid.continuous.error import error_dynamics, error_resets
from deshybrid.continuous.gains import ObserverGains, design_gains
from deshybrid.continuous.modes import modal_basis
from deshybrid.continuous.reach import outer_set
from deshybrid.continuous.responses import Flow, bends, pushed, pushed_after, rest, rows_at, times_from
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.linear.sampling import flow_and_integral
from deshybrid.model.load import load
from deshybrid.model.system import Bounds, HybridSystem
from tests.certificates import certified
from tests.property.test_continuous_bounds import designed, dynamics, random_system


def random_flow(seed: int) -> tuple[np.ndarray, Flow]:
    """Stable, with two nearly equal modes every other time: what cancels there must stay small."""
    rng = np.random.default_rng(seed)
    n = int(rng.integers(2, 5))
    values = -rng.uniform(0.5, 5.0, size=n)
    if seed % 2:
        values[1] = values[0] * (1 + 1e-4)
    T = rng.normal(size=(n, n))
    F = T @ np.diag(values) @ np.linalg.inv(T)
    return F, Flow(modal_basis(F, np.ones(n)), rng.normal(size=(n, 2)), None)


@pytest.mark.parametrize("seed", range(8))
def test_what_signals_add_along_a_row_is_bounded_within_two_percent(seed: int) -> None:
    F, flow = random_flow(seed)
    row, width = np.random.default_rng(seed).normal(size=(1, len(F))), 2e-3
    cells = int(12.0 / width)
    step, middle, total, exact = expm(F * width), row @ expm(F * width / 2), 0.0, [0.0]
    for _ in range(cells):
        total += float(np.abs(middle @ flow.drive).sum()) * width
        exact.append(total)
        middle = middle @ step
    times = np.array([0.0, 0.1, 0.7, 3.0, 12.0])
    found = pushed(flow, row, times)[0]
    wanted = np.array(exact)[np.rint(times / width).astype(int)]
    assert (found >= wanted * (1 - 1e-4)).all()
    assert (found <= wanted * 1.02 + 1e-3 * total).all()
    assert pushed_after(flow, row, 3.0)[0] >= (exact[-1] - wanted[3]) * (1 - 1e-4)


@pytest.mark.parametrize("seed", range(8))
def test_between_two_times_a_row_stays_within_its_bend_of_the_chord(seed: int) -> None:
    F, flow = random_flow(seed)
    rows = np.random.default_rng(seed).normal(size=(3, len(F)))
    times = times_from(flow, 0.3)
    ends, allowed = rows_at(flow, rows, times), bends(flow, rows, times)
    np.testing.assert_allclose(ends[:, 4], rows @ expm(F * times[4]), atol=1e-6)
    for share in (0.25, 0.5, 0.8):
        inside = rows_at(flow, rows, times[:-1] + share * np.diff(times))
        chord = (1 - share) * ends[:, :-1] + share * ends[:, 1:]
        assert (np.abs(inside - chord) <= allowed + 1e-9).all()
    later = rest(flow, rows, 2.0)
    assert all((np.abs(rows @ expm(F * t)) <= later * (1 + 1e-6)).all() for t in (2.0, 2.5, 4.0))


@pytest.mark.parametrize("n", [1, 2, 3, 4, 6])
def test_the_support_of_a_polytope_is_that_of_a_linear_program_and_never_less(n: int) -> None:
    rng = np.random.default_rng(n)
    box = rng.uniform(0.5, 2.0, size=n)
    outer = outer_set(np.diag(box), lambda rows: np.abs(rows) @ box)
    outer = outer.lowered(outer.levels * rng.uniform(0.7, 1.0, size=len(outer.levels)))
    for row in rng.normal(size=(10, n)):
        both = np.vstack([outer.directions, -outer.directions])
        exact = -linprog(-row, A_ub=both, b_ub=np.tile(outer.levels, 2), bounds=(None, None)).fun
        found = float(outer.support(row[None])[0])
        assert found >= exact * (1 - 1e-7)
        assert found <= exact * (1 + 1e-7) or n > 4


def disturbed(seed: int) -> tuple[HybridSystem, ObserverGains]:
    system = random_system(np.random.default_rng(seed))
    noise = np.full(len(system.output_names), 0.05)
    system = replace(system, bounds=Bounds(disturbance=np.array([0.7]), measurement=noise))
    return system, designed(system, 1.0)


def adversary(system: HybridSystem, gains: ObserverGains, stay: float, guess: np.ndarray) -> np.ndarray:
    loops = error_dynamics(system, gains.gains).matrices
    places = {
        name: place(loops[name], np.hstack([dynamics(system, name).E * 0.7, gains.gains[name] * 0.05]), stay)
        for name in gains.locations
    }
    jumps = [Jump(reset.source, reset.target, reset.matrix) for reset in error_resets(system, gains.locations)]
    return worst_errors(places, jumps, stay, guess)


def test_the_bound_is_never_left_and_at_most_twice_what_an_adversary_reaches() -> None:
    ratios = []
    for seed in range(8):
        system, gains = disturbed(seed)
        bound = ultimate_bound(system, gains).by_state
        assert bound is not None
        reached = adversary(system, gains, certify_dwell(system, gains).dwell, bound)
        assert (reached <= bound * (1 + 1e-9)).all()
        ratios += (bound / reached).tolist()
    assert np.median(ratios) <= 2.0


def test_in_sampled_time_the_bound_is_never_left_and_near() -> None:
    """By powers of the sampled error matrices: every stay has at least as many steps as the certificate asks."""
    ratios = []
    for seed in range(4):
        system = replace(random_system(np.random.default_rng(seed)), time_step=0.1)
        scaled = {
            t.name: replace(dynamics(system, t.name), A=expm(0.1 * dynamics(system, t.name).A))
            for t in system.locations
        }
        places = tuple(replace(place, dynamics=scaled[place.name]) for place in system.locations)
        system = replace(system, locations=places, bounds=Bounds(disturbance=np.array([0.7])))
        gains = designed(system, 1.0)
        bound = ultimate_bound(system, gains)
        assert bound.by_state is not None
        reached = sampled_adversary(system, gains, round(bound.dwell / 0.1), bound.by_state)
        assert (reached <= bound.by_state * (1 + 1e-9)).all()
        ratios += (bound.by_state / reached).tolist()
    assert np.median(ratios) <= 2.0


def sampled_adversary(system: HybridSystem, gains: ObserverGains, stay: int, guess: np.ndarray) -> np.ndarray:
    """Backwards by single steps, greedily: for every row the best number of steps from `stay` to five times that."""
    loops, n = error_dynamics(system, gains.gains).matrices, len(guess)
    resets, best = error_resets(system, gains.locations), np.zeros(n)

    def best_stay(name: str, row: np.ndarray, least: int) -> tuple[float, np.ndarray]:
        options, gained, drive = [], 0.0, dynamics(system, name).E * 0.7
        for k in range(5 * stay + 1):
            options += [(gained, row)] if k >= least else []
            gained, row = gained + float(np.abs(row @ drive).sum()), row @ loops[name]
        return max(options, key=lambda option: option[0] + float(np.abs(option[1]) @ guess) * 0.3)

    for state in range(n):
        for end in gains.locations:
            here, (total, row) = end, best_stay(end, np.eye(n)[state], 0)
            for _ in range(30):
                options = [(*best_stay(r.source, row @ r.matrix, stay), r.source) for r in resets if r.target == here]
                gained, row, here = max(options, key=lambda option: option[0] + float(np.abs(option[1]) @ guess) * 0.3)
                total += gained
            best[state] = max(best[state], total)
    return best


def executions(model: str, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The largest errors of `count` random executions at once, from zero error, and the bound; no detection delay.

    Signals are bang-bang and turn round at random times, quickly in some runs and slowly in others; every second stay
    is as short as it may be.
    """
    rng = np.random.default_rng(1)
    system = load(model)
    gains = design_gains(system, tuple(place.name for place in system.locations))
    bound = ultimate_bound(system, gains)
    assert bound.by_state is not None
    names, loops = gains.locations, error_dynamics(system, gains.gains).matrices
    width = bound.dwell / 40
    steps = [flow_and_integral(loops[name], drive(system, gains, name), width) for name in names]
    flow, push = np.array([step[0] for step in steps]), np.array([step[1] for step in steps])
    exits = [[r for r in error_resets(system, names) if r.source == name] for name in names]
    error, place = np.zeros((count, flow.shape[1])), rng.integers(len(names), size=count)
    signs, turning = rng.choice([-1.0, 1.0], size=(count, push.shape[2])), 10 ** rng.uniform(-2.5, -0.3, size=count)
    left, largest = np.full(count, 40), np.zeros(flow.shape[1])
    for _ in range(600):
        signs = np.where(rng.random(signs.shape) < turning[:, None], -signs, signs)
        error = np.einsum("bij,bj->bi", flow[place], error) + np.einsum("bij,bj->bi", push[place], signs)
        largest = np.maximum(largest, np.abs(error).max(axis=0))
        left = left - 1
        for run in np.flatnonzero(left == 0):
            exit = exits[place[run]][rng.integers(len(exits[place[run]]))]
            error[run], place[run] = exit.matrix @ error[run], names.index(exit.target)
            left[run] = 40 + (rng.geometric(0.03) if rng.random() < 0.5 else 0)
    return largest, bound.by_state


def drive(system: HybridSystem, gains: ObserverGains, name: str) -> np.ndarray:
    bounds, place = system.bounds, system.location(name)
    assert bounds.disturbance is not None
    assert bounds.measurement is not None
    noise = gains.gains[name] * bounds.measurement[list(place.output_index)]
    return np.hstack([dynamics(system, name).E * bounds.disturbance, noise])


@pytest.mark.parametrize("model", ["models/two_tank.yaml", "models/balluchi2012/driveline.yaml"])
def test_no_random_execution_of_an_example_leaves_the_bound(model: str) -> None:
    largest, bound = executions(model, 100)
    assert (largest <= bound).all()
    assert (largest > 0.01 * bound).any()


@pytest.mark.campaign
@pytest.mark.parametrize("model", ["models/two_tank.yaml", "models/balluchi2012/driveline.yaml"])
def test_none_of_ten_thousand_random_executions_of_an_example_leaves_the_bound(model: str) -> None:
    largest, bound = executions(model, 10_000)
    assert (largest <= bound).all()


def test_where_only_forms_hold_the_bound_starts_from_ellipsoids_and_is_as_good() -> None:
    """Between the dwell times that forms and (20) ask for, no adversary leaves it; growing sets end in the same."""
    for seed in (0, 1):
        system, gains = disturbed(seed)
        paper = certify_dwell(system, gains)
        dynamics = error_dynamics(system, gains.gains)
        needed = certified(dynamics, rate=paper.rate).required_dwell
        stay = (needed + paper.required_dwell) / 2
        forms = certified(dynamics, rate=paper.rate, dwell=stay)
        bound = ultimate_bound(system, gains, dwell=stay, forms=forms)
        assert not certify_dwell(system, gains, dwell=stay).holds
        assert bound.by_state is not None
        assert "forms" in bound.reason
        reached = adversary(system, gains, stay, bound.by_state)
        assert (reached <= bound.by_state * (1 + 1e-9)).all()
        assert np.median(bound.by_state / reached) <= 2.0
        grown = ultimate_bound(system, gains, dwell=stay, forms=replace(forms, plain=None))
        assert grown.by_state is not None
        assert "no switch leads out of" in grown.reason
        np.testing.assert_allclose(grown.by_state, bound.by_state, rtol=0.02)


def test_bounds_of_zero_are_the_limit_of_small_ones() -> None:
    system = load("models/two_tank.yaml")
    gains = design_gains(system, ("fill", "drain"), rate=0.5)
    found = []
    for size in (0.0, 1e-9):
        zero = np.array([size])
        bounds = Bounds(state=np.array([size, 4.0]), input=zero, disturbance=np.array([size, size]), measurement=zero)
        found.append(ultimate_bound(replace(system, bounds=bounds), gains, dwell=3.0, delay=0.1))
    flat, thin = (bound.by_state for bound in found)
    assert flat is not None
    assert thin is not None
    assert thin.max() > 1e-3
    np.testing.assert_allclose(flat, thin, rtol=1e-3, atol=1e-6)
