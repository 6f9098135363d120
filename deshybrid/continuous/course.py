"""Rows d e^{Z t} over a finite time, without modes: Z may be unstable, defective or of two systems joined.

In: Z (m, m), or the matrix of one step, an end time.  Out: the rows on a grid of times, how far they bend from their
chords between two of them, and bounds from above and below of what signals between -1 and 1 add along them.  The idea:
the Taylor series of each cell bounds its second derivative, four terms as they are and the remainder by |Z|.  In
sampled time nothing lies between two steps.  O(K m² cells).

Source: this project.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from deshybrid.continuous.dwell import PART_OF_A_STEP
from deshybrid.linear.arrays import FloatArray

TURN = 0.2
"""What the fastest mode may turn in a cell (rad)."""
GROWTH = 1.0
"""What |Z| may grow in a cell, as an exponent: it bounds the remainder only."""
LEAST_CELLS, MOST_CELLS = 48, 4_000
TERMS = 4
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """z' = matrix z (or z := matrix z each `step` seconds): times (T,) from 0 on, powers (T, m, m) at them.

    remainder (m, m): |Z|⁶ e^{|Z| w}, w the width of the cells.
    """

    matrix: FloatArray
    times: FloatArray
    powers: FloatArray
    step: float | None
    remainder: FloatArray

    def rows(self, rows: FloatArray) -> FloatArray:
        """Return d e^{Z t} for every row d and time t: (K, T, m)."""
        return np.asarray(np.einsum("ki,tij->ktj", rows, self.powers))

    def bends(self, moved: FloatArray) -> FloatArray:
        """Return bounds (K, T - 1, m) of how far rows (K, T, m) leave their chords."""
        return np.asarray(self._steepness(moved, np.eye(len(self.matrix))) * self._width**2 / 8)

    def pushed(self, moved: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return bounds (K, T), from below and above, of the integral of ‖d e^{Z s} columns‖₁ over [0, t], or the sum.

        >>> decay = course(-np.eye(1), 1.0, None)
        >>> below, above = decay.pushed(decay.rows(np.eye(1)), np.eye(1))
        >>> below[0, -1].round(2), above[0, -1].round(2)
        (np.float64(0.63), np.float64(0.63))
        """
        values = moved @ columns
        if self.step is not None:
            steps = np.abs(values[:, :-1]).sum(axis=2)
            low = high = steps
        else:
            first, last = values[:, :-1], values[:, 1:]
            sizes = np.abs(first) + np.abs(last)
            # A chord that crosses zero has less area than its ends tell.
            crossed = (first**2 + last**2) / np.where(sizes > 0, sizes, 1.0)
            area = np.where(first * last < 0, crossed, sizes) * self._width / 2
            bent = self._steepness(moved, columns) * self._width**3 / 12
            low = np.maximum(area - bent, 0.0).sum(axis=2)
            high = (sizes * self._width / 2 + bent).sum(axis=2)
        start = np.zeros((len(moved), 1))
        below, above = (np.hstack([start, np.cumsum(part, axis=1)]) for part in (low, high))
        return below * (1 - ROUNDING), above * (1 + ROUNDING)

    @property
    def _width(self) -> float:
        return float(self.times[1] - self.times[0]) if len(self.times) > 1 else 0.0

    def _steepness(self, moved: FloatArray, columns: FloatArray) -> FloatArray:
        """Bounds (K, cells, c) of the second derivative of d e^{Z t} columns."""
        start, Z, width = moved[:, :-1], self.matrix, self._width
        if self.step is not None or not start.size:
            return np.zeros((*start.shape[:2], columns.shape[1]))
        derived, total = Z @ Z @ columns, np.zeros((*start.shape[:2], columns.shape[1]))
        for k in range(TERMS):
            total += np.abs(start @ (derived * (width**k / factorial(k))))
            derived = Z @ derived
        later = self.remainder @ np.abs(columns) * (width**TERMS / factorial(TERMS))
        return np.asarray(total + np.abs(start) @ later)


def course(matrix: FloatArray, end: float, step: float | None, *, turn: float = TURN) -> Course:
    """Return the course of a matrix from 0 to `end` (s), 0 < end; no more than 4,000 cells in continuous time.

    >>> course(np.eye(1), 0.35, 0.1).times.round(3).tolist()
    [0.0, 0.1, 0.2, 0.3]
    """
    from scipy.linalg import expm

    if step is None:
        cells = int(np.clip(np.ceil(end * _cells_a_second(matrix, turn)), LEAST_CELLS, MOST_CELLS))
        times = np.asarray(np.linspace(0.0, end, cells + 1), dtype=np.float64)
        one = expm(matrix * times[1])
    else:
        times, one = np.asarray(step * np.arange(int(end / step + PART_OF_A_STEP) + 1)), matrix
    powers = [np.eye(len(matrix))]
    for _ in times[1:]:
        powers.append(powers[-1] @ one)
    size = np.abs(matrix)
    remainder = size if step is not None else np.linalg.matrix_power(size, 2 + TERMS) @ expm(size * times[1])
    return Course(matrix, times, np.array(powers), step, remainder)


def affordable(matrix: FloatArray, step: float | None, *, turn: float = TURN) -> float:
    """Return how long (s) a course may be without cells that are too long.

    >>> affordable(np.eye(1), 0.1)
    400.0
    """
    return MOST_CELLS * step if step is not None else MOST_CELLS / max(_cells_a_second(matrix, turn), 1e-300)


def _cells_a_second(matrix: FloatArray, turn: float) -> float:
    fastest, grown = (float(np.abs(np.linalg.eigvals(M)).max()) for M in (matrix, np.abs(matrix)))
    return max(fastest / turn, grown / GROWTH)


__all__ = ["Course", "affordable", "course"]
