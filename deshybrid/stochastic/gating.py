"""Gating: a row of measurements that no mode can explain is taken for an outlier, and counts as missing.

In: squared distances of a row from what every mode expects.  Out: whether it is an outlier.  A measurement of a matched
mode lies within the limit with the gate's probability, so that a gate of 0.9999 throws away one good row in 10,000.  A
gate hides a model that does not fit: the rows it took are counted and told.

O(M) a row and trial.  Source: Bar-Shalom, Li and Kirubarajan (2001), section 5.4 (validation regions).
"""

import numpy as np
from numpy.typing import NDArray

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray

Flags = NDArray[np.bool_]


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


def outliers(distance: FloatArray, log_mu: FloatArray, z: FloatArray, limits: FloatArray) -> Flags:
    """Return which rows (...) lie beyond the limit of every possible mode; distance and predicted log_mu (..., M).

    >>> outliers(np.array([9.0, 50.0]), np.log([0.5, 0.5]), np.array([1.0]), gate_limits(1, 0.99)).tolist()
    True
    """
    limit = limits[(~np.isnan(z)).sum(axis=-1)]
    beyond: Flags = ((distance > limit[..., None]) | np.isneginf(log_mu)).all(axis=-1)
    return beyond


__all__ = ["Flags", "gate_limits", "outliers"]
