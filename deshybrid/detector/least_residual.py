"""The least that a residual shows after an entry, and how long the own one may be large: over all that bounds allow.

In: a generator, the location p left, the location q entered, the motions of q.  Out: for each sample after the entry
and each row what the residual is at least, as strength times `gain` less `loss`; and the sample from which the own
residual is below its level for ever.

At sample k after the entry, with x(0) = s m + rest the motion at strength s and u that of the motion,

    r(k) = s ρ(k) + c(k) + H F^k z(0) + (what disturbance and noise add since),

where H F^k z(0) lies in the interval of `carried_over` and what is added is at most Σ_j |S_j E| w̄ + Σ_j |S_j G| v̄ +
|J| v̄, with S_j the response of plant and generator together.  So |r| >= s |ρ| - |c + interval| - added.  Where the
transition leaves x alone, x(0) is also the state at the end of the stay: then e = z - T x is carried over as well, z(0)
= T (s m + rest) + e, which gives a second pair of gain and loss for each row; the larger of both counts.

Cost: K products of size n + k, K the window in samples, and the cost of `carried_over` for K q rows.
Source: this project's.
"""

from collections.abc import Sequence
from itertools import combinations
from typing import NamedTuple

import numpy as np

from deshybrid.detector.carried_over import Interval, carried_over, pushed_in_a_step
from deshybrid.detector.levels import Part, settling
from deshybrid.detector.motions import Motion, equilibrium
from deshybrid.detector.residual import ResidualGenerator
from deshybrid.detector.thresholds import largest_state, measurement_bound
from deshybrid.detector.together import driven_together
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location

DIRECTIONS = 200
"""In each plane, beside those of the residuals themselves."""


class Entry(NamedTuple):
    """A transition as residuals see it; `keeps`: it leaves the state alone."""

    source: Location
    target: Location
    keeps: bool


class Course(NamedTuple):
    """What moves the residual of one generator after an entry, for K' samples from the first that it knows of.

    In units of the level, by sample and row: `over_x` (K', q, n), `over_z` (K', q, k), and `known` (K', q) what the
    offsets add; `heard` (K', q, p) what a measurement error of the sample before adds, `direct` (q, p) one of the same
    sample, `held` (K', q, r) what a disturbance held over the sample before adds and `smeared` (K', q) one that varies
    within it, all at their bounds.  `carried` bounds over_z z(0), `tracked` over_z (z(0) - T x(0)), None where x is
    reset; `sides` (d, k) are further directions, of which `carried_sides` and `tracked_sides` are the intervals.
    """

    generator: ResidualGenerator
    over_x: FloatArray
    over_z: FloatArray
    over_u: FloatArray
    known: FloatArray
    heard: FloatArray
    direct: FloatArray
    held: FloatArray
    smeared: FloatArray
    rest: FloatArray
    carried: Interval
    tracked: Interval | None
    sides: FloatArray
    carried_sides: Interval
    tracked_sides: Interval | None


class Rival(NamedTuple):
    """Least weighted residuals of one generator, by sample and row (K, rows): strength times `gain` less `loss`.

    `course`: what they are of; None where the generator sees nothing.
    """

    motion: Motion
    gain: FloatArray
    loss: FloatArray
    on_ticks: int
    course: Course | None


def least_residuals(
    system: HybridSystem, entry: Entry, part: Part, wanted: Sequence[Motion], samples: int
) -> list[Rival]:
    """Return what the generator of `part` shows at least while the plant moves in the target, by motion."""
    course = _course(system, entry, part, samples - part.generator.lag)
    if course is None:
        nothing = np.zeros((samples, 1))
        return [Rival(motion, nothing, nothing, part.on_ticks, None) for motion in wanted]
    return [_rival(course, motion, part.on_ticks) for motion in wanted]


def _course(system: HybridSystem, entry: Entry, part: Part, samples: int) -> Course | None:
    generator, dynamics = part.generator, entry.target.dynamics
    joint = driven_together(system, generator, entry.target)
    if joint is None or dynamics is None or samples <= 0:
        return None
    n, k, m = generator.T.shape[1], len(generator.F), len(system.input_names)
    responses = _responses(joint[0] / part.threshold.level[:, None], joint[1], samples)
    over_x, over_z, over_u = responses[:, :, :n], responses[:, :, n : n + k], responses[:, :, n + k : n + k + m]
    sides = _sides(system, generator)
    carried, around = (_at_entry(system, entry, generator, rows, tracked=False) for rows in (over_z, sides))
    if carried is None or around is None:
        return None
    held, smeared = pushed_in_a_step(system, entry.target, generator.step)
    noise, rest = measurement_bound(system, generator, entry.target), equilibrium(system, dynamics)
    return Course(
        generator,
        over_x,
        over_z,
        over_u,
        responses[:, :, -1] + over_x @ rest,
        over_z @ (generator.gain * noise),
        generator.J * noise / part.threshold.level[:, None],
        over_x @ held,
        np.abs(over_x) @ smeared,
        rest,
        carried,
        _at_entry(system, entry, generator, over_z, tracked=True) if entry.keeps else None,
        sides,
        around,
        _at_entry(system, entry, generator, sides, tracked=True) if entry.keeps else None,
    )


def _rival(course: Course, motion: Motion, on_ticks: int) -> Rival:
    """Gain and loss; at rest there is nothing that more strength adds, and the known part is what shows."""
    moved, added = course.over_x @ motion.state + course.over_u @ motion.input, _added(course)
    pairs = [_gain_and_loss(motion, moved, course.known, course.carried, added)]
    if course.tracked is not None:
        follow, T = course.over_z, course.generator.T
        known = course.known + follow @ (T @ course.rest)
        pairs.append(_gain_and_loss(motion, moved + follow @ (T @ motion.state), known, course.tracked, added))
    gains, losses = zip(*pairs, strict=True)
    late = np.zeros((course.generator.lag, sum(gain.shape[1] for gain in gains)))
    gain, loss = (np.vstack([late, np.hstack(sizes)]) for sizes in (gains, losses))
    return Rival(motion, gain, loss, on_ticks, course)


def _gain_and_loss(
    motion: Motion, moved: FloatArray, known: FloatArray, carried: Interval, added: FloatArray
) -> tuple[FloatArray, FloatArray]:
    low, high = known + carried.low - added, known + carried.high + added
    if motion.kind == "rest":
        return np.zeros_like(moved), -np.maximum(np.maximum(low, -high), 0.0)
    return np.abs(moved), _largest(Interval(low, high))


def _added(course: Course) -> FloatArray:
    """What disturbance and noise add at most since the entry, (K', q)."""
    each = np.abs(course.held).sum(axis=2) + course.smeared + np.abs(course.heard).sum(axis=2)
    before = np.vstack([np.zeros((1, each.shape[1])), np.cumsum(each, axis=0)[:-1]])
    return np.asarray(before + np.abs(course.direct).sum(axis=1))


def own_settled(system: HybridSystem, entry: Entry, part: Part, wanted: Sequence[Motion]) -> list[int]:
    """Return, by motion, the sample from which the own residual is below its level for ever, at every strength.

    It must have one from the worst mismatch (`settling`).
    """
    generator, longest = part.generator, settling(system, part) or 0
    margin = part.threshold.level - part.threshold.steady
    rows = _responses(generator.H, generator.F, max(longest - generator.lag, 0))
    carried = _at_entry(system, entry, generator, rows, tracked=False)
    tracked = _at_entry(system, entry, generator, rows, tracked=True) if entry.keeps else None
    if carried is None or entry.target.dynamics is None:
        return [longest] * len(wanted)
    rest = rows @ (generator.T @ equilibrium(system, entry.target.dynamics))
    found = []
    for motion in wanted:
        moved = np.abs(rows @ (generator.T @ motion.state))
        largest = _largest(Interval(carried.low - rest, carried.high - rest)) + moved
        largest = largest if tracked is None else np.minimum(largest, _largest(tracked))
        beyond = np.flatnonzero((largest > margin).any(axis=1))
        found.append((int(beyond[-1]) + 1 if len(beyond) else 0) + generator.lag)
    return found


def _at_entry(
    system: HybridSystem, entry: Entry, generator: ResidualGenerator, rows: FloatArray, *, tracked: bool
) -> Interval | None:
    """The interval of rows z, shape (..., k), at the entry; of rows (z - T x) where `tracked`.

    The former is also that of rows T x and rows (z - T x) together, which is smaller where x is at its bounds.
    """
    flat = rows.reshape(-1, rows.shape[-1])
    followed, none = flat @ generator.T, np.zeros((len(flat), generator.T.shape[1]))

    def interval(over_x: FloatArray, over_z: FloatArray) -> Interval | None:
        return carried_over(system, generator, entry.source, np.hstack([over_x, over_z]))

    behind = interval(-followed, flat)
    if behind is None or tracked:
        return None if behind is None else Interval(*(side.reshape(rows.shape[:-1]) for side in behind))
    whole, state = interval(none, flat), interval(followed, np.zeros_like(flat))
    if whole is None or state is None:
        return None
    low, high = np.maximum(whole.low, state.low + behind.low), np.minimum(whole.high, state.high + behind.high)
    return Interval(low.reshape(rows.shape[:-1]), high.reshape(rows.shape[:-1]))


def _sides(system: HybridSystem, generator: ResidualGenerator) -> FloatArray:
    """Directions all around in each plane of two components of z, in units of the largest |z|: (d, k)."""
    box, k = largest_state(system, generator), len(generator.F)
    turns = np.pi * np.arange(DIRECTIONS) / DIRECTIONS
    rows = [np.cos(t) * np.eye(k)[i] + np.sin(t) * np.eye(k)[j] for i, j in combinations(range(k), 2) for t in turns]
    scale = np.ones(k) if box is None else np.where((box > 0.0) & np.isfinite(box), box, 1.0)
    return np.asarray(np.array(rows).reshape(-1, k) / scale, dtype=np.float64)


def _largest(interval: Interval) -> FloatArray:
    return np.maximum(np.abs(interval.low), np.abs(interval.high))


def _responses(shown: FloatArray, moved: FloatArray, samples: int) -> FloatArray:
    """Shown movedᵏ for k = 0, 1, ...: (samples, q, size)."""
    found = np.zeros((samples, *shown.shape))
    for tick in range(samples):
        found[tick], shown = shown, shown @ moved
    return found


__all__ = ["Course", "Entry", "Rival", "least_residuals", "own_settled"]
