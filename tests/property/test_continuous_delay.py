"""What a detection delay costs: where the plant is when it switches, and what the wrong observer makes of it."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

from deshybrid.continuous.course import course
from deshybrid.continuous.gains import ObserverGains, design_gains
from deshybrid.continuous.mismatch import Delayed, mismatches
from deshybrid.continuous.plant_sets import plant_sets
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.linear.sampling import flow_and_integral, sample_dynamics
from deshybrid.model.load import load, loads
from deshybrid.model.system import HybridSystem, HybridTransition
from tests.late import Grid, largest_errors
from tests.property.test_continuous_bounds import dynamics

CLUTCH = """
format: deshybrid/1
name: clutch
state: [a, b]
input: [u]
output: [y, z]
disturbance: [w]
bounds: {state: {a: 5, b: 8}, input: 1, disturbance: 0.5, measurement: 0.01}
defaults: {C: [[1, 0], [0, 1]], B: [[1], [0]], E: [[0], [1]]}
locations:
  open: {A: [[-0.5, 0], [0, -0.8]], f: [0.1, -0.2]}
  shut: {A: [[-2, 2], [1, -1.5]], invariant: "a <= 4"}
transitions:
  - {from: open, to: shut, event: close, emits: close, guard: "-0.3 <= a - b <= 0.2 | a + b >= u + 6"}
  - {from: shut, to: open, event: release, emits: release, reset: {matrix: [[1, 0], [0.5, 0.5]], offset: [0, 0.3]}}
observer: {rate: 0.3}
"""


SAMPLED = (
    CLUTCH.replace("name: clutch", "name: clutch\ntime: {step: 0.1}")
    .replace("[[-0.5, 0], [0, -0.8]], f: [0.1, -0.2]", "[[0.95, 0], [0, 0.92]], f: [0.01, -0.02]")
    .replace("[[-2, 2], [1, -1.5]]", "[[0.82, 0.17], [0.09, 0.86]]")
    .replace("B: [[1], [0]], E: [[0], [1]]", "B: [[0.1], [0]], E: [[0], [0.1]]")
)


def clutch(step: float | None = None) -> HybridSystem:
    return loads(CLUTCH if step is None else SAMPLED)


@pytest.mark.parametrize("seed", range(5))
def test_along_bands_the_least_over_parallelotopes_is_the_linear_program(seed: int) -> None:
    """The stay is too short to tell anything, so the guard, the invariant of `shut` and the bounds are the set."""
    found = plant_sets(clutch(), clutch().transitions[:1], (np.zeros((0, 2)),), 1e-9)[0]
    for row in np.random.default_rng(seed).normal(size=(10, 2)):
        exact = -np.inf
        for A, b in (([[1, -1], [-1, 1], [1, 0]], [0.2, 0.3, 4]), ([[-1, -1], [1, 0]], [-5, 4])):
            program = linprog(-row, A_ub=np.array(A), b_ub=b, bounds=[(-5, 5), (-8, 8)])
            exact = max(exact, -float(program.fun or 0.0))
        assert found.highest(row) == pytest.approx(exact, abs=1e-6)


def walk(
    rng: np.random.Generator, system: HybridSystem, stay: int, width: float
) -> list[tuple[HybridTransition, np.ndarray]]:
    """States before the transitions of a random run within the bounds, but for the first; stays in cells."""
    name, x = "shut", np.array([1.0, 1.0])
    found: list[tuple[HybridTransition, np.ndarray]] = []
    for _ in range(30):
        d = dynamics(system, name)
        columns = np.hstack([d.B, d.E * 0.5, d.f[:, None]])
        flow, push = (d.A, columns) if system.time_step else flow_and_integral(d.A, columns, width)
        exit, waited, turning = next(t for t in system.transitions if t.source == name), 0, rng.uniform(0.01, 0.5)
        signs = rng.choice([-1.0, 1.0], size=2)
        while waited < stay or (exit.guard is not None and exit.guard.margin(x, signs[:1]) < 0):
            signs = np.where(rng.random(2) < turning, -signs, signs)
            x, waited = flow @ x + push @ np.append(signs, 1.0), waited + 1
            assert (np.abs(x) <= [5, 8]).all()
            if waited > 2_000:
                return found
        found.append((exit, x))
        assert exit.reset is not None
        x, name = exit.reset.matrix @ x + exit.reset.offset, exit.target
    return found


@pytest.mark.parametrize("step", [None, 0.1])
def test_no_simulated_plant_leaves_the_set_before_its_transition(step: float | None) -> None:
    rng, system = np.random.default_rng(7), clutch(step)
    sets = plant_sets(system, system.transitions, (rng.normal(size=(2, 2)),) * 2, 1.0)
    seen, rows = 0, rng.normal(size=(40, 2))
    bound = {t.event: where.highest(rows) for t, where in zip(system.transitions, sets, strict=True)}
    box = np.abs(rows) @ [5.0, 8.0]
    for _ in range(8):
        for exit, x in walk(rng, system, 10, 0.1)[1:]:
            assert (rows @ x <= bound[exit.event]).all()
            seen += 1
    assert seen > 100
    assert (bound["release"] < 0.9 * box).any()


def test_bounds_of_what_signals_add_hold_from_both_sides_and_are_near() -> None:
    rng = np.random.default_rng(3)
    Z, row, columns = rng.normal(size=(4, 4)), rng.normal(size=(1, 4)), rng.normal(size=(4, 2))
    found = course(Z, 3.0, None)
    below, above = found.pushed(found.rows(row), columns)
    for k in (10, 40, len(found.times) - 1):
        fine = np.linspace(0, found.times[k], 4_001)
        step, moved, total = expm(Z * fine[1]), row @ expm(Z * fine[1] / 2), 0.0
        for _ in fine[1:]:
            total, moved = total + float(np.abs(moved @ columns).sum() * fine[1]), moved @ step
        assert below[0, k] <= total * (1 + 1e-5)
        assert total * (1 - 1e-5) <= above[0, k]
        assert above[0, k] <= 1.02 * below[0, k]


def late_exactly(late: Delayed, F: np.ndarray, row: np.ndarray, jump: tuple[np.ndarray, np.ndarray], s: float) -> float:
    """The most along (x, ζ, 1) at s, by a fine sum and the support of the set; what the stay counts taken off."""
    n = len(F)
    matrix, offset = jump
    fine = np.linspace(0, s, 401)
    step, moved, total = expm(late.joint.matrix * fine[1]), row @ expm(late.joint.matrix * fine[1] / 2), 0.0
    for _ in fine[1:]:
        total += float(np.abs(moved @ late.drive).sum() - np.abs(moved[n : 2 * n] @ late.own).sum()) * fine[1]
        moved = moved @ step
    end = row @ expm(late.joint.matrix * s)
    start = end[:n] @ matrix + end[n : 2 * n] @ (np.eye(n) - matrix)
    constant = end[:n] @ offset - end[n : 2 * n] @ offset + end[2 * n]
    return float(late.where.farthest(start, np.asarray(constant))) + total


def test_what_a_delay_adds_is_what_the_worst_start_and_signals_add() -> None:
    """The bounds of the state are wide, so that they do not count during the delay."""
    system = loads(CLUTCH.replace("a: 5, b: 8", "a: 500, b: 800"))
    gains = design_gains(system, ("open", "shut"))
    for name, (exit,) in mismatches(system, gains.gains, 0.4, 20.0).items():
        late = exit.delayed
        assert late is not None
        directions = np.random.default_rng(1).normal(size=(4, 2))
        kicked = exit.kick(directions)
        for k in (0, len(kicked.starts) // 2, len(kicked.starts) - 1):
            for direction, bound in zip(directions, kicked.most[:, k], strict=True):
                row = np.concatenate([direction @ (exit.reset - np.eye(2)), direction @ exit.reset])
                row = np.append(row, direction @ late.jump[1])
                ends = (late.joint.times[k], late.joint.times[k + 1])
                exact = max(late_exactly(late, gains.closed_loop[name], row, late.jump, s) for s in ends)
                assert exact - 1e-6 <= bound <= 1.05 * exact + 0.05


Flows = dict[tuple[str, str], tuple[np.ndarray, np.ndarray]]


def joint_flows(system: HybridSystem, gains: ObserverGains, width: float) -> Flows:
    """Plant in one location, observer in another: what becomes of both after a cell, and of u, w, v and 1 in it."""
    found, n = {}, len(system.state_names)
    for i, j in ((i, j) for i in gains.locations for j in gains.locations):
        here, seen, G = dynamics(system, i), dynamics(system, j), gains.gains[j]
        joint = np.block([[here.A, np.zeros((n, n))], [G @ here.C, seen.A - G @ seen.C]])
        plant = np.hstack([here.B, here.E, G * 0, here.f[:, None]])
        observer = np.hstack([seen.B, here.E * 0, G, seen.f[:, None]])
        found[i, j] = flow_and_integral(joint, np.vstack([plant, observer]), width)
    return found


def observed(rng: np.random.Generator, system: HybridSystem, flows: Flows, cells: tuple[int, int]) -> np.ndarray:
    """The largest errors of a run; stays have at least the first number of cells, delays at most the second.

    The plant may come from anywhere; so the estimate starts, without an error, where the second stay ends.
    """
    name, followed, both = "shut", "shut", np.array([1.0, 1.0, 0.0, 0.0])
    resets, largest = {t.target: t.reset for t in system.transitions}, np.zeros(2)
    for count in range(10):
        exit = next(t for t in system.transitions if t.source == name)
        late, waited = int(rng.integers(0, cells[1] + 1)) if count > 2 else 0, 0
        signs, turning = rng.choice([-1.0, 1.0], 4), rng.uniform(0.01, 0.3)
        while waited < cells[0] or (exit.guard is not None and exit.guard.margin(both[:2], signs[:1]) < 0):
            if waited == late:
                reset = resets[name]
                assert reset is not None
                after = reset.matrix @ both[2:] + reset.offset if count > 2 else both[:2]
                both, followed = np.concatenate([both[:2], after]), name
            signs = np.where(rng.random(4) < turning, -signs, signs)
            flow, push = flows[name, followed]
            both = flow @ both + push @ np.append(signs * [1, 0.5, 0.01, 0.01], 1.0)
            waited += 1
            largest = np.maximum(largest, np.abs(both[2:] - both[:2])) if count > 1 else largest
        assert exit.reset is not None
        both, name = np.concatenate([exit.reset.matrix @ both[:2] + exit.reset.offset, both[2:]]), exit.target
    return largest


def test_no_late_observer_of_a_guarded_plant_leaves_the_bound() -> None:
    rng, system = np.random.default_rng(5), clutch()
    gains = design_gains(system, ("open", "shut"))
    bound = ultimate_bound(system, gains, dwell=2.0, delay=0.4)
    assert bound.by_state is not None
    flows = joint_flows(system, gains, 0.02)
    largest = np.max([observed(rng, system, flows, (100, 20)) for _ in range(10)], axis=0)
    assert (largest <= bound.by_state).all()
    assert (largest > 0.1 * bound.by_state).all()


EXAMPLES = [
    pytest.param("models/two_tank.yaml", 3.0, Grid(0.05, 60, 2), id="two tanks, 0.1 s"),
    pytest.param("models/balluchi2012/driveline.yaml", 0.9, Grid(0.02, 45, 3), id="driveline, 0.06 s"),
    pytest.param("models/balluchi2012/driveline.yaml", 0.9, Grid(0.02, 45, 36), id="driveline, 0.72 s"),
]


def executed(model: str, dwell: float, grid: Grid, size: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """The largest errors of so many executions of an example, and its bound for the delay of the grid."""
    system = load(model)
    gains = design_gains(system, tuple(place.name for place in system.locations))
    bound = ultimate_bound(system, gains, dwell=dwell, delay=grid.delay * grid.width).by_state
    assert bound is not None
    return largest_errors(system, gains, grid, size), bound


@pytest.mark.parametrize(("model", "dwell", "grid"), EXAMPLES)
def test_no_random_execution_of_an_example_leaves_the_bound_with_a_delay(model: str, dwell: float, grid: Grid) -> None:
    largest, bound = executed(model, dwell, grid, (40, 400))
    assert (largest <= bound).all()
    assert (largest > 0.3 * bound).any()


def test_in_discrete_time_no_random_execution_leaves_the_bound_with_a_delay() -> None:
    tank = load("models/two_tank.yaml")
    places = tuple(
        replace(place, dynamics=sample_dynamics(dynamics(tank, place.name), 0.05)) for place in tank.locations
    )
    system = replace(tank, locations=places, time_step=0.05)
    gains = design_gains(system, tuple(place.name for place in places))
    bound = ultimate_bound(system, gains, dwell=3.0, delay=0.2)
    assert bound.by_state is not None, bound.reason
    largest = largest_errors(system, gains, Grid(0.05, 60, 4), (40, 400))
    assert (largest <= bound.by_state).all()
    assert (largest > 0.3 * bound.by_state).any()


@pytest.mark.campaign
@pytest.mark.parametrize(("model", "dwell", "grid"), EXAMPLES)
def test_none_of_ten_thousand_executions_of_an_example_leaves_the_bound_with_a_delay(
    model: str, dwell: float, grid: Grid
) -> None:
    largest, bound = executed(model, dwell, grid, (10_000, 600))
    assert (largest <= bound).all()
