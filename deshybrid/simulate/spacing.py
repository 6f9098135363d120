"""Where the rows of a trace stand in time: one step apart, give or take a logger's jitter, or with rows missing.

In: the times of the rows (N,) in s, which increase, and the step.  Out: the place of each row, counted in steps, or the
first row that has none.

Measured logs jitter and their clocks drift.  A row counts as equally spaced when it follows the row before by 0.2 to
1.8 steps (each of the two within 40 % of a step of its place), and when the rows come, on average, within 1 % of the
step.  Where rows may be missing, a longer gap stands for whole rows, if every gap is within 40 % of a step of a whole
number of steps, told by the clock of the gaps of one step, which are at least half of all, and if no more rows are
missing than 10,000, or than ten for each that is there.

One pass.  Source: the trace format of the commands `run`, `simulate` and `estimate`.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import FloatArray

JITTER = 0.4  # of a step, by which one row may be away from its place
DRIFT = 0.01  # by which the average step may differ from the one expected
MOST_MISSING = 10_000
"""So many rows may be missing, or ten for each that is there: beyond them a trace is two, and a gap costs its steps."""


@dataclass(frozen=True, slots=True)
class Misplaced:
    """The number of a row, from 0, and what is wrong with its time."""

    row: int
    text: str


def misplaced(time: FloatArray, step: float, *, missing_rows: bool = False) -> Misplaced | None:
    """Return the first row out of place; those behind it would be out of place for the same reason.

    With `missing_rows` a gap may stand for whole rows.

    >>> misplaced(np.array([0.0, 1.0, 2.0, 5.0]), 1.0).row
    3
    >>> misplaced(np.array([0.0, 1.0, 2.0, 5.0]), 1.0, missing_rows=True) is None
    True
    """
    gaps = np.diff(time)
    if not gaps.size:
        return None
    counts = _counts(gaps, step) if missing_rows else None
    if counts is None:
        counts = np.ones(len(gaps))
        uneven = np.flatnonzero(np.abs(gaps / step - 1.0) > 2.0 * JITTER)
        if uneven.size:
            row = int(uneven[0]) + 1
            gap = f"{gaps[row - 1]:.6g} s after the row before, expected {step:g} s"
            return Misplaced(row, f"the rows are not equally spaced: {gap}")
    steps = float(counts.sum())
    mean = float(time[-1] - time[0]) / steps
    if abs(mean / step - 1.0) > DRIFT + 2.0 * JITTER / steps:
        return Misplaced(len(time) - 1, f"the rows come every {mean:.6g} s on average, expected {step:g} s")
    return None


def places(time: FloatArray, step: float) -> NDArray[np.intp]:
    """Return the place of each row (N,), in steps after the first, of times that are not `misplaced`.

    >>> places(np.array([0.0, 1.1, 1.9, 5.0]), 1.0).tolist()
    [0, 1, 2, 5]
    """
    gaps = np.diff(time)
    counts = _counts(gaps, step)
    steps = np.cumsum(np.ones(len(gaps)) if counts is None else counts)
    return np.concatenate([[0.0], steps])[: len(time)].astype(np.intp)


def mean_step(time: FloatArray) -> float:
    """Return the step (s) of two rows or more: their mean distance, gaps counted as the steps that they take.

    Where the rows fit no step, that of most of them, so that a message may point at the others.

    >>> mean_step(np.array([0.0, 0.5, 1.0, 4.0]))
    0.5
    """
    gaps, whole = np.diff(time), float(time[-1] - time[0])
    usual = float(np.sort(gaps)[(len(gaps) - 1) // 2])  # one step, where half of the gaps are of one
    counts = _counts(gaps, usual)
    if counts is not None:
        return whole / float(counts.sum())
    mean = whole / len(gaps)
    return mean if misplaced(time, mean) is None else usual


def _counts(gaps: FloatArray, step: float) -> FloatArray | None:
    """How many steps each gap takes; None where they are no whole steps, or most of them not one."""
    if not gaps.size or not step > 0.0:
        return None
    single = gaps[np.rint(gaps / step) == 1.0]
    if 2 * len(single) < len(gaps):
        return None
    clock = gaps / single.mean()
    counts: FloatArray = np.rint(clock)
    fits = bool(((np.abs(clock - counts) <= JITTER) & (counts >= 1.0)).all())
    return counts if fits and counts.sum() - len(counts) <= max(MOST_MISSING, 10 * len(counts)) else None


__all__ = ["DRIFT", "JITTER", "MOST_MISSING", "Misplaced", "mean_step", "misplaced", "places"]
