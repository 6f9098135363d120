"""Ultimate bound where locations determine the state only together: every stay is bounded on both sides.

In: a contraction by γ with every switch for all stays of a box (`continuous/determinability_contraction.py`), bounds of
disturbance and noise.  Out: one bound per state that the error does not exceed once its initial value has died out.
The idea: ‖ζ‖_P falls by γ with every switch, and a stay and its exit add at most κ to it, so entry errors from zero
stay within κ/(1 - γ); from these ellipsoids reachable sets go down, as in `continuous/reach.py`, but over finite times,
for what a location hides may grow while it is active.  A stay of the observer may be longer or shorter than the plant's
by the detection delay, for which the contraction was certified.  O(rounds · directions · cells · corners).

Source: this project; the contraction is that of (24) of Balluchi et al. (2003).
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deshybrid.continuous.course import Course, course
from deshybrid.continuous.determinability_contraction import ContractionCertificate
from deshybrid.continuous.ellipsoids import along_ellipsoid, size_in_form
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.mismatch import Late, Mismatch, in_time, mismatches, missing_bounds
from deshybrid.continuous.reach import Exit, Levels, Outer, entry_sets, level_after
from deshybrid.continuous.ultimate import UltimateBound, bound_of, drive_of, noise_words
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem

CELLS = 40
"""Times of a stay are looked at in so many groups."""
SAME_TIME = 1e-12
ROUNDING = 1e-6
"""The level of the ellipsoids is raised by this share."""


def ultimate_bound_in_box(
    system: HybridSystem, gains: ObserverGains, contraction: ContractionCertificate
) -> UltimateBound:
    """Return the ultimate bound for stays within the bounds of a contraction that holds, in the time of the system.

    `value` is None where bounds are missing, and `reason` says which; those needed are those of `ultimate_bound`.

    >>> from deshybrid.continuous.determinability_design import determined, gains_alone_or_together
    >>> from deshybrid.model.load import load
    >>> system, names = load("models/balluchi2003/three_locations.yaml"), ("q1", "q2", "q3")
    >>> gains, stays = gains_alone_or_together(system, names, rate=None, dwell=None, method="place")
    >>> together = determined(system, gains, stays, step=0.01)
    >>> bound = ultimate_bound_in_box(system, gains, together.certificates[0])
    >>> bool((bound.by_state > 0).all()), bool((bound.by_state < 1).all())
    (True, True)
    """
    shortest = min(stay[0] for stay in contraction.stays.values())
    terms = (contraction.rate, shortest + contraction.delay, contraction.delay)
    missing = missing_bounds(system, gains.locations, contraction.delay)
    if missing or not contraction.holds:
        return bound_of(terms, None, missing or contraction.reason)
    exits = mismatches(system, gains.gains, contraction.delay, terms[1])
    stays = {
        name: _Stay(course(F, contraction.stays[name][1], contraction.step), drive_of(system, gains, name), stay[0])
        for name, F in contraction.matrices.items()
        for stay in [contraction.stays[name]]
    }
    known = _ellipsoids(contraction, stays, exits)
    states = np.eye(len(system.state_names))
    if not any(levels(states).any() for levels in known.values()):
        return bound_of(terms, np.zeros(len(states)), f"nothing disturbs the error{noise_words(system)}")
    sets = entry_sets(lambda entered: _seen(stays, exits, entered), known, len(states))
    peaks = [stay.highest(sets[name], exits[name]) for name, stay in stays.items()]
    reason = f"the contraction over the box of stays, tightened by reachable sets{noise_words(system)}"
    return bound_of(terms, np.asarray(np.max(peaks, axis=0)), reason)


@dataclass(frozen=True, slots=True, eq=False)
class _Stay:
    """The error of one location over its longest stay, what drives it, and the shortest stay (s)."""

    flow: Course
    drive: FloatArray
    shortest: float

    def exit(self, leaving: tuple[str, str], rows: FloatArray, start: float, late: Late) -> Exit:
        """Return rows (K, n) over all times from `start` on, in groups of cells."""
        moved, times = self.flow.rows(rows), self.flow.times
        upto = self.flow.pushed(moved, self.drive)[1]
        first = int(np.searchsorted(times, start * (1 + SAME_TIME), side="right")) - 1
        groups = np.arange(first, len(times) - 1, max(1, (len(times) - 1 - first) // CELLS))
        # The last time once more: there may be no other.
        ends = np.append(groups, [len(times) - 1] * 2)
        bent = np.concatenate([self._bent(moved, ends[:-1]), np.zeros_like(moved[:, :1])], axis=1)
        never, begins = np.full(len(rows), -np.inf), np.zeros(1, dtype=np.intp)
        most = late.most.max(axis=1, keepdims=True)
        return Exit(*leaving, moved[:, ends], bent, np.zeros_like(rows), upto[:, ends], never, most, begins)

    def _bent(self, moved: FloatArray, ends: NDArray[np.intp]) -> FloatArray:
        """How far rows (K, T, n) leave their chords between the ends of groups: at each time, and in between."""
        if len(ends) < 2:
            return moved[:, :0]
        inside = np.arange(ends[0], ends[-1])
        group = np.searchsorted(ends, inside, side="right") - 1
        share = ((inside - ends[group]) / (ends[group + 1] - ends[group]))[None, :, None]
        chord = (1 - share) * moved[:, ends[group]] + share * moved[:, ends[group + 1]]
        away = np.abs(moved[:, inside] - chord)
        # In a cell a row is between its ends but for its own bend, and these are as far from the chord as they are.
        later = np.concatenate([away[:, 1:], away[:, :1] * 0], axis=1)
        whole = np.maximum(away, later) + self.flow.bends(moved)[:, inside]
        return np.asarray(np.maximum.reduceat(whole, ends[:-1] - ends[0], axis=1))

    def highest(self, entered: Outer, exits: tuple[Mismatch, ...]) -> FloatArray:
        """Return a bound (n,) of each state's error during a stay, and while its end is not detected."""
        states = np.eye(self.flow.matrix.shape[0])
        found = level_after(self.exit(("", ""), states, 0.0, in_time("", states).shown()), entered)
        return np.asarray(np.max([found, *(found + exit.most()[1] for exit in exits)], axis=0))


def _seen(
    stays: Mapping[str, _Stay], exits: Mapping[str, tuple[Mismatch, ...]], sets: Mapping[str, Outer]
) -> list[Exit]:
    return [
        stays[name].exit((name, exit.target), directions @ exit.reset, stays[name].shortest, exit.kick(directions))
        for name, leaving in exits.items()
        for exit in leaving
        for directions in [sets[exit.target].directions]
    ]


def _ellipsoids(
    contraction: ContractionCertificate, stays: Mapping[str, _Stay], exits: Mapping[str, tuple[Mismatch, ...]]
) -> Mapping[str, Levels]:
    """{‖ζ‖_P <= κ/(1 - γ)} along rows, by location."""
    added = [0.0]
    for name, leaving in exits.items():
        flow, drive = stays[name].flow, stays[name].drive
        for exit in leaving:
            pushed = flow.pushed(flow.rows(exit.reset), drive)[1][:, -1]
            added.append(size_in_form(pushed + exit.most()[0], contraction.P[exit.target]))
    level = max(added) / (1 - contraction.gamma) * (1 + ROUNDING)
    return {name: along_ellipsoid(np.asarray(np.linalg.inv(P)), level) for name, P in contraction.P.items()}


__all__ = ["ultimate_bound_in_box"]
