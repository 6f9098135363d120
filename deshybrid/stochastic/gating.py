"""Gating: a row of measurements that no mode can explain is taken for an outlier, and counts as missing.

In: squared distances of a row from what every mode expects, and how many outliers came before it.  Out: whether the row
is left out.  A measurement of a matched mode lies within the limit with the gate's probability, so that a gate of
0.9999 throws away one good row in 10,000.  A gate hides a model that does not fit: the rows it took are counted and
told.

The way back: a filter that has lost its track would call every row an outlier for ever.  After `PATIENCE` outliers in a
row it is the filter that counts as wrong: the gate is open, and every row taken, until as many rows in a row lie within
it.  (One row is not enough: an estimate that swings back crosses the measurements.)  So never more than `PATIENCE` rows
in a row are left out, and a filter returns as one without a gate does.

O(M) a row and trial.  Source: Bar-Shalom, Li and Kirubarajan (2001), section 5.4 (validation regions); the way back is
that of a track that is dropped after some misses, without forgetting it.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray

Flags = NDArray[np.bool_]
Counts = NDArray[np.intp]

PATIENCE = 5
"""After so many outliers in a row the gate opens, and after so many rows within it closes again."""


@dataclass(frozen=True, slots=True, eq=False)
class Gate:
    """The limits of the squared distance by number of measured outputs (p + 1,), and what came before, `count` (...).

    Below `PATIENCE` the count is that of outliers in a row; above, the gate is open and the rest are rows within it.
    """

    limits: FloatArray
    count: Counts

    @classmethod
    def of(cls, outputs: int, probability: float, trials: tuple[int, ...] = ()) -> "Gate":
        """Return the gate before the first row, of `trials` (any leading axes) at once.

        Raises `UsageError` (DH1111) where the probability is not between 0 and 1.

        >>> Gate.of(2, 0.99).limits.round(2).tolist()
        [inf, 6.63, 9.21]
        """
        return cls(gate_limits(outputs, probability), np.zeros(trials, dtype=np.intp))

    def judge(self, distance: FloatArray, log_mu: FloatArray, z: FloatArray) -> "Judgement":
        """Return what becomes of a row z (..., p); distance and predicted log_mu (..., M).

        >>> gate = Gate.of(1, 0.99)
        >>> for _ in range(7):
        ...     found = gate.judge(np.array([9.0, 50.0]), np.log([0.5, 0.5]), np.array([1.0]))
        ...     print(found.gated, found.readmitted, end=" ")
        ...     gate = found.gate
        True False True False True False True False True False False True False True
        """
        measured = (~np.isnan(z)).sum(axis=-1)
        beyond = ((distance > self.limits[measured][..., None]) | np.isneginf(log_mu)).all(axis=-1)
        is_open = self.count >= PATIENCE
        counted = np.where(is_open == beyond, np.where(is_open, PATIENCE, 0), (self.count + 1) % (2 * PATIENCE))
        count = np.where(measured == 0, self.count, counted)
        return Judgement(beyond & ~is_open, beyond & is_open, Gate(self.limits, count))


@dataclass(frozen=True, slots=True, eq=False)
class Judgement:
    """Which rows (...) were left out, which were taken although they lie beyond the gate, and the gate of the next."""

    gated: Flags
    readmitted: Flags
    gate: Gate | None

    @classmethod
    def none(cls, trials: tuple[int, ...]) -> "Judgement":
        """Return that of a filter without a gate.

        >>> Judgement.none(()).gated.tolist()
        False
        """
        nothing = np.zeros(trials, dtype=np.bool_)
        return cls(nothing, nothing, None)


def gate_limits(outputs: int, probability: float) -> FloatArray:
    """Return the limits of the squared distance (p + 1,) for 0 to p measured outputs: quantiles of χ².

    Raises `UsageError` (DH1111) where the probability is not between 0 and 1.

    >>> gate_limits(2, 0.99).round(2).tolist()
    [inf, 6.63, 9.21]
    """
    from scipy.stats import chi2

    if not 0.0 < probability < 1.0:
        helps = ("0.9999 takes one good row in 10,000 for an outlier",)
        raise UsageError(
            diagnostic("DH1111", f"a gate of {probability:g} is no probability between 0 and 1", helps=helps)
        )
    return np.array([np.inf, *(float(chi2.ppf(probability, freedom)) for freedom in range(1, outputs + 1))])


__all__ = ["PATIENCE", "Counts", "Flags", "Gate", "Judgement", "gate_limits"]
