"""How far is the ultimate bound with a detection delay above what an adversary reaches?  `python -m benchmarks.late`.

The adversary is a linear program: for a given sequence of locations, stays and delays, on a grid of time, it chooses
the plant's start, inputs, disturbances and noise, all within their bounds and held over each cell, such that the state
stays within its bounds and guards hold, and one component of the error is largest at the end.  The plant passes two
stays before the observer starts without an error.  What is reached is a lower bound of every bound.  It shares no code
with the bounds.  Each stay is the shortest and each delay the longest, but for the last ones, of which several lengths
are tried.

Systems: the driveline with 0.72 s, the delay that relays need, and with 0.06 s; random ones of two locations
that differ by half, with bounds of the state 1.3 times what a random drive of the plant reaches.  Compared state by
state.
"""

import sys
from collections.abc import Iterator, Sequence
from dataclasses import replace
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm
from scipy.optimize import linprog
from scipy.sparse import csr_array, lil_array

from deshybrid.continuous.dwell import certify_dwell
from deshybrid.continuous.gains import ObserverGains, design_gains
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.load import load, loads
from deshybrid.model.predicates import Affine, And, Predicate
from deshybrid.model.system import HybridSystem, HybridTransition

Array = NDArray[np.float64]
CELLS = 12
"""Cells of a delay; those of a stay are as long."""
PATIENCE = 10.0
"""What a linear program may take (s); one that does not end counts as nothing reached."""


class Step(NamedTuple):
    """(x, x̂) := matrix (x, x̂) + signals s + constant, |s| <= 1; guard: rows x <= levels hold before."""

    matrix: Array
    signals: Array
    constant: Array
    guard: tuple[Array, Array] | None = None


def dynamics(system: HybridSystem, name: str) -> LinearDynamics:
    """Return the dynamics of a location that has some."""
    found = system.location(name).dynamics
    if found is None:
        raise ValueError(f"`{name}` has no dynamics")
    return found


def flow(system: HybridSystem, gains: ObserverGains, plant: str, observer: str, width: float) -> Step:
    """Return one cell: the plant in one location, the observer in another."""
    i, j, G, bounds = dynamics(system, plant), dynamics(system, observer), gains.gains[observer], system.bounds
    n, m, r, p = len(i.A), i.B.shape[1], i.E.shape[1], len(i.C)
    joint = np.block([[i.A, np.zeros((n, n))], [G @ i.C, j.A - G @ j.C]])
    sizes = [
        np.zeros(k) if b is None else b
        for k, b in ((m, bounds.input), (r, bounds.disturbance), (p, bounds.measurement))
    ]
    top = np.hstack([i.B * sizes[0], i.E * sizes[1], np.zeros((n, p)), i.f[:, None]])
    low = np.hstack(
        [(j.B + G @ (i.D - j.D)) * sizes[0], np.zeros((n, r)), G * sizes[2], (j.f + G @ (i.g - j.g))[:, None]]
    )
    columns = np.vstack([top, low])
    block = np.zeros((2 * n + columns.shape[1],) * 2)
    block[: 2 * n, : 2 * n], block[: 2 * n, 2 * n :] = joint, columns
    whole = expm(block * width)[: 2 * n]
    return Step(whole[:, : 2 * n], whole[:, 2 * n : -1], whole[:, -1])


def half_spaces(guard: Predicate | None) -> tuple[Array, Array] | None:
    """Return rows and levels of a conjunction of comparisons of states; None for no guard."""
    if guard is None:
        return None
    parts = guard.parts if isinstance(guard, And) else (guard,)
    plain = [part for part in parts if isinstance(part, Affine) and not part.input.any() and part.relation != "=="]
    if len(plain) < len(parts):
        raise ValueError("the adversary knows conjunctions of comparisons of states only")
    return np.array([part.state for part in plain]), np.array([-part.constant for part in plain])


def jump(transition: HybridTransition, n: int, who: str) -> Step:
    """Return the jump of the plant, of the observer, or the start of the observer at the plant's state."""
    R, r = (np.eye(n), np.zeros(n)) if transition.reset is None else (transition.reset.matrix, transition.reset.offset)
    matrix, constant = np.eye(2 * n), np.zeros(2 * n)
    if who == "plant":
        matrix[:n, :n], constant[:n] = R, r
    elif who == "observer":
        matrix[n:, n:], constant[n:] = R, r
    else:
        matrix[n:] = np.eye(n, 2 * n)
    return Step(matrix, np.zeros((2 * n, 0)), constant, half_spaces(transition.guard) if who == "plant" else None)


class Times(NamedTuple):
    """Shortest stay, longest delay; how much of the last delay has passed, and of the stay after it (s)."""

    stay: float
    delay: float
    last: float
    after: float


def steps_of(system: HybridSystem, gains: ObserverGains, path: Sequence[HybridTransition], times: Times) -> list[Step]:
    """Return the steps of a path; its first two transitions are seen at once, and then the observer starts."""
    n, width = len(system.state_names), times.delay / CELLS
    found = [flow(system, gains, path[0].source, path[0].source, width)] * int(np.ceil(times.stay / width))
    for number, transition in enumerate(path):
        ends = number == len(path) - 1
        late = (times.last if ends else times.delay) if number > 1 else 0.0
        found.append(jump(transition, n, "plant"))
        found += _during(system, gains, (transition.target, transition.source), late, width)
        if ends and not times.after:
            break
        found.append(jump(transition, n, "observer" if number > 1 else "start"))
        rest, here = (times.after if ends else times.stay - late), (transition.target, transition.target)
        found += _during(system, gains, here, rest, min(width, rest / 6))
    return found


def _during(
    system: HybridSystem, gains: ObserverGains, places: tuple[str, str], time: float, width: float
) -> list[Step]:
    cells = int(np.ceil(time / width - 1e-9)) if time > 0 else 0
    return [flow(system, gains, *places, time / cells)] * cells if cells else []


def largest_errors(system: HybridSystem, steps: Sequence[Step]) -> Array:
    """Return the largest error of each state at the end (n,), zero where no run is possible."""
    n, box = len(system.state_names), system.bounds.state
    if box is None:
        raise ValueError("the model states no bounds of the state")
    z, signals = 2 * n, [step.signals.shape[1] for step in steps]
    starts = np.concatenate([[0], np.cumsum(signals)]) + z * (len(steps) + 1)
    equal, rights = lil_array((z * len(steps), int(starts[-1]))), np.zeros(z * len(steps))
    rows, levels = [], []
    for k, step in enumerate(steps):
        here = slice(z * k, z * (k + 1))
        equal[here, z * (k + 1) : z * (k + 2)] = np.eye(z)
        equal[here, z * k : z * (k + 1)] = -step.matrix
        if signals[k]:
            equal[here, int(starts[k]) : int(starts[k + 1])] = -step.signals
        rights[here] = step.constant
        for row, level in zip(*step.guard, strict=True) if step.guard else ():
            rows.append((z * k, row))
            levels.append(level)
    unequal = lil_array((len(rows), int(starts[-1])))
    for number, (column, row) in enumerate(rows):
        unequal[number, column : column + n] = row
    state = [*zip(-box, box, strict=True), *[(None, None)] * n] * (len(steps) + 1)
    limits = [*state, *[(-1.0, 1.0)] * int(starts[-1] - starts[0])]
    best, end = np.zeros(n), z * len(steps)
    for k in range(n):
        for sign in (1.0, -1.0):
            cost = np.zeros(int(starts[-1]))
            cost[end + n + k], cost[end + k] = -sign, sign
            found = linprog(
                cost,
                A_ub=csr_array(unequal) if rows else None,
                b_ub=levels or None,
                A_eq=csr_array(equal),
                b_eq=rights,
                bounds=limits,
                options={"time_limit": PATIENCE},
            )
            best[k] = max(best[k], -float(found.fun)) if found.status == 0 else best[k]
    return best


def paths(system: HybridSystem, length: int) -> Iterator[tuple[HybridTransition, ...]]:
    """Yield the paths of so many transitions."""
    found: list[tuple[HybridTransition, ...]] = [(t,) for t in system.transitions]
    for _ in range(length - 1):
        found = [(*path, t) for path in found for t in system.transitions if t.source == path[-1].target]
    yield from found


def random_system(seed: int, n: int) -> tuple[HybridSystem, ObserverGains, Times]:
    """Return two stable locations that differ, gains for rate 0.5, and a delay of a tenth of what contraction needs."""
    rng = np.random.default_rng(seed)
    common, places = rng.normal(size=(n, n)), []
    for name in ("a", "b"):
        A = common + 0.5 * rng.normal(size=(n, n))
        A = A - (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
        B, C, E = rng.normal(size=(n, 1)), rng.normal(size=(1, n)), rng.normal(size=(n, 1))
        parts = {key: M.tolist() for key, M in (("A", A), ("B", B), ("C", C), ("E", E))}
        places.append(f"{name}: {parts}")
    names = [f"x{k}" for k in range(n)]
    bounds = (
        f"{{state: {{{', '.join(f'{name}: 1' for name in names)}}}, input: 1, disturbance: 0.2, measurement: 0.02}}"
    )
    system = loads(
        f"{{format: deshybrid/1, name: random, state: {names}, input: [u], output: [y], disturbance: [w],"
        f" bounds: {bounds}, locations: {{{', '.join(places)}}},"
        " transitions: [{from: a, to: b, event: go, emits: go}, {from: b, to: a, event: back, emits: back}]}"
    )
    gains = design_gains(system, ("a", "b"), rate=0.5)
    needed = certify_dwell(system, gains).required_dwell
    delay = 0.1 * needed + 0.05
    system = replace(system, bounds=replace(system.bounds, state=1.3 * _driven(rng, system, delay)))
    return system, gains, Times(1.2 * needed + 0.1 + delay, delay, delay, 0.0)


def _driven(rng: np.random.Generator, system: HybridSystem, width: float) -> Array:
    """The largest states of a plant under signals that turn at random, and that switches at random."""
    n = len(system.state_names)
    steps = []
    for place in system.locations:
        d = dynamics(system, place.name)
        block = np.zeros((n + 2, n + 2))
        block[:n, :n], block[:n, n:] = d.A, np.hstack([d.B, 0.2 * d.E])
        steps.append(expm(block * width)[:n])
    x, largest, here, signs = np.zeros(n), np.zeros(n), 0, np.ones(2)
    for _ in range(3_000):
        signs = np.where(rng.random(2) < 0.1, -signs, signs)
        here = 1 - here if rng.random() < 0.02 else here
        x = steps[here] @ np.concatenate([x, signs])
        largest = np.maximum(largest, np.abs(x))
    return largest


def compared(
    system: HybridSystem, gains: ObserverGains, times: Times, arcs: Sequence[tuple[HybridTransition, ...]]
) -> Array:
    """Return bound over what is reached, state by state; ends the program where the bound is left."""
    bound = ultimate_bound(system, gains, dwell=times.stay, delay=times.delay).by_state
    if bound is None:
        raise SystemExit("no bound")
    slow = -1 / max(float(np.linalg.eigvals(F).real.max()) for F in gains.closed_loop.values())
    ends = [(times.delay * share, 0.0) for share in (0.3, 0.6, 1.0)] + [
        (times.delay, slow * k) for k in (0.05, 0.2, 1.0)
    ]
    reached = np.zeros(len(bound))
    for path in arcs:
        for last, after in ends:
            steps = steps_of(system, gains, path, times._replace(last=last, after=after))
            reached = np.maximum(reached, largest_errors(system, steps))
    if (reached > bound * (1 + 1e-6)).any():
        raise SystemExit(f"the bound {bound} is left: {reached}")
    return bound / reached


def driveline_paths(system: HybridSystem) -> list[tuple[HybridTransition, ...]]:
    """Return paths through the lowest, a middle and the highest gear, and from the highest to the lowest."""
    arc = {(t.source, t.target): t for t in system.transitions}
    stops = [("q1", "q1"), ("q3", "q3"), ("q5", "q5"), ("q5", "q1")]
    rounds = [("qN", first, "qN", second, "qN")[:count] for first, second in stops for count in (4, 5)]
    rounds += [("qN", "q3", "qN", first, "qN", second) for first, second in stops]
    return [tuple(arc[pair] for pair in pairwise(stop)) for stop in rounds]


def main() -> None:
    """Print the driveline by state, and medians and 90 % quantiles of random systems, as many as the argument says."""
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 4
    driveline = load("models/balluchi2012/driveline.yaml")
    gains = design_gains(driveline, tuple(place.name for place in driveline.locations))
    for delay in (0.72, 0.06):
        found = compared(driveline, gains, Times(0.9, delay, delay, 0.0), driveline_paths(driveline))
        print(f"| driveline, {delay} s | {', '.join(f'{ratio:.3g}' for ratio in found)} |", flush=True)
    for n in (2, 3):
        ratios: list[float] = []
        for seed in range(count):
            system, gains, times = random_system(seed, n)
            ratios += compared(system, gains, times, list(paths(system, 5))).tolist()
        print(f"| {n} states, {count} systems | {np.median(ratios):.3g}, {np.quantile(ratios, 0.9):.3g} |", flush=True)


if __name__ == "__main__":
    main()
