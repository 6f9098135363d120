"""Where the plant can be when it switches: what guards, invariants, bounds and the stay before leave of its states.

In: a system with bounds, the shortest stay D of the plant, rows of interest.  Out: for every transition j -> i a set
that holds the state x⁻ just before it, as sup of d x over it for any row d.  The idea: the set is an intersection of
bands low <= h x <= high.  Bands come from

- the bounds of the state, before the jump and after it;
- the guard and the invariants of both locations, inputs anywhere within their bounds;
- the flow of j: x(t) = e^{A_j τ} x(t - τ) + what signals add within τ.  At the end of a stay that lasts at least D this
  holds from anywhere within the bounds for τ <= D; and for τ > D either the stay lasted τ, or it began less than τ ago
  where j can be entered.

The least over all parallelotopes of n bands is the sup, by duality, where the cap on their number allows.  Entries come
from transitions between the given locations: a plant that begins elsewhere may leave the sets once, before its first
transition.  O(parallelotopes · rows · times · n²).

Source: this project; guards as in Girard and Le Guernic's reachability of hybrid systems, by support functions.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from itertools import combinations, product
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.course import Course, affordable, course
from deshybrid.continuous.error import dynamics_of
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.predicates import Affine, And, Not, Or, Predicate
from deshybrid.model.system import HybridSystem, HybridTransition

MOST_FRAMES = 150
MOST_CASES = 8
"""A guard with more alternatives than this tells nothing."""
FLAT = 1e-9
"""Bands whose rows make a parallelotope flatter than this are not combined."""
PARALLEL = 1e-13
ROUNDING = 1e-9
TURN = 0.05
"""Finer than elsewhere: what is left of a stay is least at a certain time before its end."""
LONGEST = 10
"""So many shortest stays are followed from where a location is entered."""
ROUNDS = 2


class Band(NamedTuple):
    """low <= row x <= high; row (n,)."""

    row: FloatArray
    low: float
    high: float


class HalfSpace(NamedTuple):
    """row x <= high."""

    row: FloatArray
    high: float


@dataclass(frozen=True, slots=True, eq=False)
class Whereabouts:
    """A union of intersections of parallelotopes {x: |M x - c| <= l}: by case, inverses of M, centres c, lengths l."""

    cases: tuple[tuple[FloatArray, FloatArray, FloatArray], ...]

    def highest(self, rows: FloatArray) -> FloatArray:
        """Return bounds of d x over the set for rows d (..., n): the least over the parallelotopes of each case."""
        return np.asarray(np.max([_highest(rows, *case) for case in self.cases], axis=0))

    def farthest(self, rows: FloatArray, offsets: FloatArray) -> FloatArray:
        """Return bounds of |d x + offset| over the set, offsets (...)."""
        return np.maximum(self.highest(rows) + offsets, self.highest(-rows) - offsets)


def _highest(rows: FloatArray, inverses: FloatArray, centres: FloatArray, lengths: FloatArray) -> FloatArray:
    best = np.full(rows.shape[:-1], np.inf)
    for inverse, centre, length in zip(inverses, centres, lengths, strict=True):
        turned = rows @ inverse
        best = np.minimum(best, turned @ centre + np.abs(turned) @ length)
    return np.asarray(best)


def plant_sets(
    system: HybridSystem, transitions: tuple[HybridTransition, ...], rows: tuple[FloatArray, ...], stay: float
) -> tuple[Whereabouts, ...]:
    """Return where the plant is just before each transition, for stays of at least `stay` (s) in every location.

    rows: for each transition rows (k, n) of interest, along which the flow before it is looked at too.

    >>> from deshybrid.model.load import load
    >>> driveline = load("models/balluchi2012/driveline.yaml")
    >>> first = tuple(t for t in driveline.transitions if t.target == "q1")
    >>> found = plant_sets(driveline, first, (np.eye(3),), 0.9)[0]
    >>> found.highest(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, -3.74 * 3.58]])).round(6).tolist()  # unwound and in step
    [0.0, 6.0]
    """
    alone = [_written(system, transition) for transition in transitions]
    sets: tuple[Whereabouts, ...] | None = None
    plants = {t.source: _Plant.of(system, t.source, stay) for t in transitions}
    for _ in range(ROUNDS):
        found = []
        for transition, cases, looked in zip(transitions, alone, rows, strict=True):
            entered = None if sets is None else _entries(system, transitions, sets, transition.source)
            along = np.vstack([np.eye(len(system.state_names)), looked])
            bands = plants[transition.source].bands(along, entered)
            found.append(_whereabouts([(*bands, *case) for case in cases], plants[transition.source].box))
        sets = tuple(found)
    return sets or ()


class _Entry(NamedTuple):
    """x⁺ = matrix x + offset for x in the set."""

    where: Whereabouts
    matrix: FloatArray
    offset: FloatArray


def _entries(
    system: HybridSystem, transitions: tuple[HybridTransition, ...], sets: tuple[Whereabouts, ...], name: str
) -> tuple[_Entry, ...]:
    pairs = [(t, where) for t, where in zip(transitions, sets, strict=True) if t.target == name]
    return tuple(_Entry(where, *jump_of(system, t)) for t, where in pairs)


def jump_of(system: HybridSystem, transition: HybridTransition) -> tuple[FloatArray, FloatArray]:
    """Return the reset of a transition, x := matrix x + offset; the identity where none is written."""
    n = len(system.state_names)
    reset = transition.reset
    return (np.eye(n), np.zeros(n)) if reset is None else (reset.matrix, reset.offset)


@dataclass(frozen=True, slots=True, eq=False)
class _Plant:
    """The flow of one location from anywhere within its bounds: (x, 1)' = [[A, f], [0, 0]] (x, 1) + drive."""

    box: FloatArray
    drive: FloatArray
    course: Course
    stay: float

    @staticmethod
    def of(system: HybridSystem, name: str, stay: float) -> "_Plant":
        dynamics, step = dynamics_of(system, name), system.time_step
        n = len(dynamics.A)
        matrix = np.zeros((n + 1, n + 1))
        matrix[:n, :n], matrix[:n, n], matrix[n, n] = dynamics.A, dynamics.f, 0.0 if step is None else 1.0
        drive = np.vstack([signals(system, name), np.zeros((1, signals(system, name).shape[1]))])
        end = min(LONGEST * stay, affordable(matrix, step, turn=TURN))
        return _Plant(state_box(system), drive, course(matrix, end, step, turn=TURN), stay)

    def bands(self, rows: FloatArray, entered: tuple[_Entry, ...] | None) -> tuple[Band, ...]:
        """Return what the flow leaves of rows (k, n) at the end of a stay."""
        both = self._highest(np.vstack([rows, -rows]), entered)
        high, low = both[: len(rows)], -both[len(rows) :]
        return tuple(Band(*parts) for parts in zip(rows, low.tolist(), high.tolist(), strict=True))

    def _highest(self, rows: FloatArray, entered: tuple[_Entry, ...] | None) -> FloatArray:
        times, n = self.course.times, len(self.box)
        moved = self.course.rows(np.hstack([rows, np.zeros((len(rows), 1))]))
        pushed = self.course.pushed(moved, self.drive)[1]
        anywhere = np.abs(moved[:, :, :n]) @ self.box + moved[:, :, n] + pushed
        early = times <= self.stay * (1 + ROUNDING)
        best = np.asarray(anywhere[:, early].min(axis=1))
        if not entered or early.all():
            return best
        first = int(np.flatnonzero(times >= self.stay * (1 - ROUNDING))[0])
        worst = np.maximum.accumulate(self._from_entry(moved, pushed, entered)[:, first:], axis=1)
        return np.asarray(np.minimum(best, np.maximum(worst, anywhere[:, first:]).min(axis=1)))

    def _from_entry(self, moved: FloatArray, pushed: FloatArray, entered: tuple[_Entry, ...]) -> FloatArray:
        """The most (k, T) that rows reach at each time after the entry, and since the time before."""
        n = len(self.box)
        at = np.max([e.where.highest(moved[:, :, :n] @ e.matrix) + moved[:, :, :n] @ e.offset for e in entered], axis=0)
        at = at + moved[:, :, n]
        sizes = np.max([e.where.farthest(e.matrix, e.offset) for e in entered], axis=0)
        bent = self.course.bends(moved) @ np.append(sizes, 1.0)
        before = at[:, :-1] if self.course.step is None else at[:, 1:]
        since = np.maximum(before, at[:, 1:]) + bent
        return np.hstack([at[:, :1], since]) + pushed


def state_box(system: HybridSystem) -> FloatArray:
    """Return the bounds of the states (n,), which have to be stated."""
    bound = system.bounds.state
    return np.full(len(system.state_names), np.inf) if bound is None else bound


def signals(system: HybridSystem, name: str) -> FloatArray:
    """Return [B ū, E w̄] of a location, a column for each signal between -1 and 1; not stated counts as zero."""
    dynamics, bounds = dynamics_of(system, name), system.bounds
    parts = [np.zeros((len(system.state_names), 0))]
    if bounds.input is not None:
        parts.append(dynamics.B * bounds.input[list(system.location(name).input_index)])
    if bounds.disturbance is not None:
        parts.append(dynamics.E * bounds.disturbance)
    return np.hstack(parts)


def _written(system: HybridSystem, transition: HybridTransition) -> list[tuple[Band | HalfSpace, ...]]:
    """What the model says of x⁻, case by case: guard, invariants, and bounds after the jump."""
    matrix, offset = jump_of(system, transition)
    before = [transition.guard, system.location(transition.source).invariant]
    found = [_cases(p, system, np.eye(len(matrix)), np.zeros(len(matrix))) for p in before]
    found.append(_cases(system.location(transition.target).invariant, system, matrix, offset))
    box = state_box(system)
    after = tuple(Band(*parts) for parts in zip(matrix, -box - offset, box - offset, strict=True))
    return [(*case, *after) for case in _joined(found)]


def _joined(parts: list[list[tuple[HalfSpace, ...]]]) -> list[tuple[HalfSpace, ...]]:
    """All of them hold, each given by its alternatives; what would have too many is left out."""
    whole: list[tuple[HalfSpace, ...]] = [()]
    for cases in parts:
        if len(whole) * len(cases) <= MOST_CASES:
            whole = [(*first, *second) for first, second in product(whole, cases)]
    return whole or [()]


def _cases(
    predicate: Predicate | None, system: HybridSystem, matrix: FloatArray, offset: FloatArray
) -> list[tuple[HalfSpace, ...]]:
    """The alternatives of a predicate over matrix x + offset, each half-spaces that all hold; a set around it."""
    match predicate:
        case Affine():
            inputs = np.zeros(len(predicate.input)) if system.bounds.input is None else system.bounds.input
            row, free = predicate.state @ matrix, float(np.abs(predicate.input) @ inputs)
            level = -predicate.constant - float(predicate.state @ offset)
            upper = HalfSpace(row, level + free)
            known = not predicate.input.any() or system.bounds.input is not None
            both = (upper, HalfSpace(-row, -level + free)) if predicate.relation == "==" else (upper,)
            return [both if known else ()]
        case And():
            return _joined([_cases(part, system, matrix, offset) for part in predicate.parts])
        case Or():
            return [case for part in predicate.parts for case in _cases(part, system, matrix, offset)]
        case Not(part=Affine() as part) if part.relation != "==":
            flipped = Affine(-part.state, -part.input, -part.constant, "<=")
            return _cases(flipped, system, matrix, offset)
        case Not(part=And() as part):
            return _cases(Or(tuple(Not(p) for p in part.parts)), system, matrix, offset)
        case Not(part=Or() as part):
            return _cases(And(tuple(Not(p) for p in part.parts)), system, matrix, offset)
        case Not(part=Not() as part):
            return _cases(part.part, system, matrix, offset)
        case _:
            return [()]


def _whereabouts(cases: Iterable[tuple[Band | HalfSpace, ...]], box: FloatArray) -> Whereabouts:
    return Whereabouts(tuple(_frames(_merged(parts, box), box) for parts in cases))


def _merged(parts: tuple[Band | HalfSpace, ...], box: FloatArray) -> list[Band]:
    """One band for each direction, the axes first; a half-space is one that the bounds of the states close."""
    unit = np.where(box > 0, box, 1.0)
    rows = [*np.eye(len(box))]
    limits = [[-float(b), float(b)] for b in box]
    for part in parts:
        size = float(np.linalg.norm(part.row * unit))
        if size == 0:
            continue
        row, high = part.row / size, part.high / size
        low = part.low / size if isinstance(part, Band) else -np.inf
        for k, known in enumerate(rows):
            scale = float(np.linalg.norm(known * unit))
            for sign in (1.0, -1.0):
                if np.abs((row - sign * known / scale) * unit).max() < PARALLEL:
                    ends = (low, high) if sign > 0 else (-high, -low)
                    limits[k] = [max(limits[k][0], ends[0] * scale), min(limits[k][1], ends[1] * scale)]
                    break
            else:
                continue
            break
        else:
            reach = float(np.abs(row) @ box)
            rows.append(row)
            limits.append([max(low, -reach), min(high, reach)])
    return [Band(row, *limit) for row, limit in zip(rows, limits, strict=True)]


def _frames(bands: list[Band], box: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Parallelotopes of n bands, those with most of the axes first: inverses, centres, half lengths."""
    n = len(box)
    unit = np.where(box > 0, box, 1.0)
    kept: list[tuple[FloatArray, list[Band]]] = []
    for count in range(n + 1):
        for extra in combinations(range(n, len(bands)), count):
            for axes in combinations(range(n), n - count):
                chosen = [bands[k] for k in (*axes, *extra)]
                matrix = np.array([band.row for band in chosen])
                if len(kept) < MOST_FRAMES and np.linalg.cond(_even(matrix * unit)) < 1 / FLAT:
                    kept.append((np.linalg.inv(matrix), chosen))
    inverses = np.array([inverse for inverse, _ in kept])
    ends = np.array([[(band.low, band.high) for band in chosen] for _, chosen in kept])
    centres = ends.mean(axis=2)
    slack = ROUNDING * (np.abs(ends).max(axis=2))
    return inverses, centres, np.maximum((ends[:, :, 1] - ends[:, :, 0]) / 2, 0.0) + slack


def _even(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix / np.linalg.norm(matrix, axis=1, keepdims=True))


__all__ = ["Band", "HalfSpace", "Whereabouts", "jump_of", "plant_sets", "signals", "state_box"]
