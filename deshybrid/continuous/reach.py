"""Where the error can be when a location is entered: polytopes, found by going down from a coarse bound.

In: per location how the error flows (`Flow`) and what its exits cost, and a first set that holds every entry error
that started from zero.  Out: bounds of the entry errors along directions d: d ζ <= level.  The idea: an entry error of
i is R (e^{F t} ζ + what the disturbance adds) and what the detection delay s adds, for an entry error ζ of some j and
a time t >= β + s; so its extent along d is at most

    max over exits j -> i, delays s, times t of  h_j(d R e^{F t}) + ∫_0^t ‖d R e^{F r} N‖₁ dr + late(d, s),

where h_j(d) = max of d ζ over the set of j, and late(d, s) is of `continuous/mismatch.py`.  One such step takes sets
that hold all entry errors into smaller sets that do; the steps are repeated until they no longer pay, and every one of
them is a bound.  h_j is convex, so between two stays it is at most the larger of both plus what the row bends; sets are
kept as polytopes, all of them symmetric.

Up to four states the directions cover the sphere and h is the maximum over the polytope's corners; with more states
the polytope is the intersection of a few parallelotopes, and h the least over these.  O(rounds · directions · times ·
corners).

Source: this project; support functions as in Girard and Le Guernic's reachability analysis of linear systems.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.continuous.mismatch import Late, Mismatch, in_time
from deshybrid.continuous.responses import Flow, bends, pushed, pushed_after, rest, rows_at, times_from
from deshybrid.linear.arrays import FloatArray

if TYPE_CHECKING:
    from scipy.spatial import ConvexHull

CORNERS_UP_TO = 4
DIRECTIONS = {1: 1, 2: 16, 3: 60, 4: 120}
FRAMES = 40
LAYOUTS = 4
MOST_ROUNDS = 60
PAYS = 1e-3
"""A round that lowers no level by this share is the last."""
FLOOR = 1e-9
"""Levels are kept above this share of those of the first set: a polytope needs an inside."""

Levels: TypeAlias = Callable[[FloatArray], FloatArray]
"""Bounds of d ζ for rows d (..., n): what is known of a set."""


@dataclass(frozen=True, slots=True, eq=False)
class Outer:
    """A symmetric set {ζ: |d ζ| <= level for each direction d}; corners (V, n), or inverses of frames (f, n, n)."""

    directions: FloatArray
    levels: FloatArray
    corners: FloatArray | None
    inverses: FloatArray | None

    def support(self, rows: FloatArray) -> FloatArray:
        """Return a bound of d ζ over the set for rows d (..., n): exact by corners, else the least of |d M⁻¹| m."""
        if self.corners is not None:
            return np.asarray(np.abs(rows @ self.corners.T).max(axis=-1))
        inverses = np.zeros((0, 1, 1)) if self.inverses is None else self.inverses
        parts = zip(inverses, self.levels.reshape(len(inverses), -1), strict=True)
        return np.asarray(np.min([np.abs(rows @ inverse) @ level for inverse, level in parts], axis=0))

    def shape(self) -> FloatArray:
        """Return units (n, n) in which the set is about as long in all directions."""
        if self.corners is None:
            return np.diag(self.support(np.eye(self.directions.shape[1])))
        return np.asarray(np.linalg.cholesky(self.corners.T @ self.corners / len(self.corners)))

    def lowered(self, levels: FloatArray) -> "Outer":
        """Return the part of the set in which the levels are these, or as they were where that is less."""
        return self.at(np.minimum(levels, self.levels))

    def at(self, levels: FloatArray) -> "Outer":
        """Return the set with the same directions and these levels."""
        corners = None if self.corners is None else _corners(self.directions, levels)
        return Outer(self.directions, levels, corners, self.inverses)


class Exit(NamedTuple):
    """One exit seen along the directions of its target; everything in it is free of the sets.

    rows (K, T, n) = d R e^{F t} at the times of the stay; bends (K, T - 1, n) between them; rest (K, n) for all later
    stays; pushed (K, T) = what the disturbance adds up to each time, and (K,) for ever; late (K, c) = what delays
    within each of c cells add, which leave no time before that of number begins (c,).
    """

    source: str
    target: str
    rows: FloatArray
    bends: FloatArray
    rest: FloatArray
    pushed: FloatArray
    for_ever: FloatArray
    late: FloatArray
    begins: NDArray[np.intp]


def outer_set(shape: FloatArray, known: Levels) -> Outer:
    """Return a polytope around a set of which `known` is known; its directions are even in the units `shape` (n, n).

    >>> box = outer_set(np.eye(2), lambda rows: np.abs(rows).sum(axis=-1))
    >>> box.support(np.array([[1.0, 0.0], [1.0, 1.0]])).round(6).tolist()
    [1.0, 2.0]
    """
    n, inverse = len(shape), np.linalg.inv(shape)
    if n <= CORNERS_UP_TO:
        rows = np.vstack([np.eye(n), _sphere(n) @ inverse])
        return Outer(rows, known(rows), _corners(rows, known(rows)), None)
    frames = np.stack([np.eye(n), *(frame @ inverse for frame in _rotations(n))])
    rows = frames.reshape(-1, n)
    return Outer(rows, known(rows), None, np.linalg.inv(frames))


def _solid(known: Mapping[str, Levels], n: int) -> Mapping[str, Levels]:
    """Return what is known, with a sliver where a set is flat along an axis: a polytope has an interior."""
    lengths = {name: levels(np.eye(n)) for name, levels in known.items()}
    longest = np.max(list(lengths.values()), axis=0)
    sliver = FLOOR * np.where(longest > 0, longest, longest.max())

    def thicker(levels: Levels) -> Levels:
        return lambda rows: levels(rows) + np.abs(rows) @ sliver

    return {name: levels if lengths[name].all() else thicker(levels) for name, levels in known.items()}


def entry_sets(
    look: Callable[[Mapping[str, Outer]], list[Exit]], known: Mapping[str, Levels], n: int
) -> Mapping[str, Outer]:
    """Return polytopes that hold every entry error (n,) that started from zero.

    `look` sees all exits along the directions of sets, by `seen_exits` for instance.  `known` holds the errors already.
    Directions that are even in units that do not fit leave the polytopes loose, so these
    are laid out anew in the units of what was found, and all starts again from there.
    """
    solid = _solid(known, n)
    sets = {name: outer_set(np.diag(levels(np.eye(n))), levels) for name, levels in solid.items()}
    for _ in range(LAYOUTS):
        sets = _went_down(look(sets), sets)
        sets = {name: outer_set(outer.shape(), outer.support) for name, outer in sets.items()}
    return sets


def seen_exits(
    flows: Mapping[str, Flow],
    exits: Mapping[str, tuple[Mismatch, ...]],
    sets: Mapping[str, Outer],
    beta: Mapping[str, float],
) -> list[Exit]:
    """Return every exit along the directions of the set it leads to, for stays of at least beta (s)."""
    times = {name: times_from(flow, beta[name]) for name, flow in flows.items()}
    return [
        _along((name, exit.target), flows[name], times[name], directions @ exit.reset, exit.kick(directions))
        for name, leaving in exits.items()
        for exit in leaving
        for directions in [sets[exit.target].directions]
    ]


def one_switch(seen: list[Exit], sets: Mapping[str, Outer], least: Mapping[str, FloatArray]) -> dict[str, FloatArray]:
    """Return the levels of all entry errors after a stay and an exit from `sets`; nowhere below `least`."""
    levels = dict(least)
    for exit in seen:
        levels[exit.target] = np.maximum(levels[exit.target], level_after(exit, sets[exit.source]))
    return levels


def _went_down(seen: list[Exit], first: Mapping[str, Outer]) -> dict[str, Outer]:
    sets = dict(first)
    for _ in range(MOST_ROUNDS):
        levels = one_switch(seen, sets, {name: FLOOR * outer.levels for name, outer in first.items()})
        lower = {name: outer.lowered(levels[name]) for name, outer in sets.items()}
        pays = any((lower[name].levels < (1 - PAYS) * sets[name].levels).any() for name in sets)
        sets = lower
        if not pays:
            break
    return sets


def highest(flow: Flow, exits: tuple[Mismatch, ...], entered: Outer, beta: float) -> FloatArray:
    """Return a bound (n,) of each state's error during a stay that is entered with an error in `entered`.

    The end of a stay counts, after at least beta (s), when the plant has jumped and the observer does not know yet.
    """
    states = np.eye(len(flow.modes.basis))
    found = [_along(("", ""), flow, times_from(flow, 0.0), states, in_time("", states).shown())]
    late = [exit for exit in exits if exit.delayed is not None]
    found += [_along(("", ""), flow, times_from(flow, beta), states, exit.shown()) for exit in late]
    return np.asarray(np.max([level_after(exit, entered) for exit in found], axis=0))


def _along(leaving: tuple[str, str], flow: Flow, times: FloatArray, rows: FloatArray, late: Late) -> Exit:
    upto, last = pushed(flow, rows, times), float(times[-1])
    return Exit(
        source=leaving[0],
        target=leaving[1],
        rows=rows_at(flow, rows, times),
        bends=bends(flow, rows, times),
        rest=rest(flow, rows, last),
        pushed=upto,
        for_ever=upto[:, -1] + pushed_after(flow, rows, last),
        late=late.most,
        begins=np.searchsorted(times, times[0] + late.starts, side="right") - 1,
    )


def level_after(exit: Exit, entered: Outer) -> FloatArray:
    """The step of the module's text, over the intervals between the times, and over all later ones."""
    box = entered.support(np.eye(exit.rows.shape[2]))
    at = entered.support(exit.rows)
    between = np.maximum(at[:, :-1], at[:, 1:]) + exit.bends @ box + exit.pushed[:, 1:]
    later = exit.rest @ box + exit.for_ever
    # The most from each time on: a delay leaves only times that are as much later.
    after = np.maximum.accumulate(np.hstack([between, later[:, None]])[:, ::-1], axis=1)[:, ::-1]
    return np.asarray((after[:, exit.begins] + exit.late).max(axis=1))


@cache
def _sphere(n: int) -> FloatArray:
    """Directions that cover half of the sphere: all round for two states, else seeded and pushed apart."""
    count = DIRECTIONS[n]
    if n == 1:
        return np.ones((1, 1))
    if n == 2:
        angles = np.pi * np.arange(count) / count
        return np.column_stack([np.cos(angles), np.sin(angles)])
    points = np.random.default_rng(n).normal(size=(count, n))
    for _ in range(60):
        points /= np.linalg.norm(points, axis=1, keepdims=True)
        both = np.vstack([points, -points])
        apart = points[:, None] - both[None]
        distance = np.linalg.norm(apart, axis=2, keepdims=True)
        points = points + (apart / np.where(distance > 0, distance, np.inf) ** 3).sum(axis=1) * 0.1 / count
    return np.asarray(points / np.linalg.norm(points, axis=1, keepdims=True))


def _rotations(n: int) -> FloatArray:
    """Seeded rotations of the coordinates (f, n, n)."""
    return np.linalg.qr(np.random.default_rng(n).normal(size=(FRAMES, n, n)))[0]


def _corners(directions: FloatArray, levels: FloatArray) -> FloatArray:
    """The corners of {|d ζ| <= level}; in one dimension an interval's end."""
    if directions.shape[1] == 1:
        return np.asarray([[float((levels / np.abs(directions[:, 0])).min())]])
    hull, size = polar(directions, levels)
    corners = -hull.equations[:, :-1] / hull.equations[:, -1:] / size
    return np.asarray(corners)


def polar(directions: FloatArray, levels: FloatArray) -> "tuple[ConvexHull, FloatArray]":
    """Return the hull of ± d/level in units (n,) of its size, and these: each of its facets is a corner of the set."""
    from scipy.spatial import ConvexHull

    points = directions / levels[:, None]
    size = np.abs(points).max(axis=0)
    return ConvexHull(np.vstack([points, -points]) / size), np.asarray(size)


__all__ = [
    "Exit",
    "Levels",
    "Outer",
    "entry_sets",
    "highest",
    "level_after",
    "one_switch",
    "outer_set",
    "polar",
    "seen_exits",
]
