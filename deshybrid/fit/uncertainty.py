"""How sure an estimate is whose errors may be correlated, of unequal size, or partly outliers.

In: the Jacobian of the residuals at the minimum of Σ ρ(r), the residuals, and the sample that each belongs to; ρ is
r²/2 up to `limit` and grows like |r| beyond it (Huber).  Out: a `Spread`.

Idea: the sandwich B⁻¹ M B⁻¹.  B = Σ J Jᵀ over the residuals within the limit is the curvature of the minimum; M is the
covariance of the sum of the scores, J ψ(r) added up by sample, ψ = ρ'.  Correlation of neighbouring samples counts with
a weight that falls to zero over `lag` samples (Bartlett's), chosen from the scores by the rule of Andrews for processes
of first order.  Estimating M costs certainty, the more the longer the lag: `factor` is the 97.5 % quantile of an
estimate over its standard error, by the cubic of Kiefer and Vogelsang.  Stretches are taken for one series.

Cost: O(N k² lag).  Sources: Huber and Ronchetti, Robust Statistics, section 7; Newey and West (1987); Andrews (1991),
equations (6.2), (6.4); Kiefer and Vogelsang (2005), Table 1.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import FloatArray

_BLIND = 1e-7  # relative singular value of J below which its direction is not seen in the data
_MOST_CORRELATED = 0.97  # beyond it a process of first order is taken for this one
_QUANTILE = (1.9600, 2.9694, 0.4160, -0.5324)  # 97.5 %, in powers of (lag + 1) / samples


class Spread(NamedTuple):
    """`covariance` (k, k), NaN in rows and columns of what the data do not see; `lag` in samples; `factor`: how many
    standard errors half an interval of 95 % has.
    """

    covariance: FloatArray
    lag: int
    factor: float


def spread_of(J: FloatArray, residuals: FloatArray, samples: NDArray[np.intp], *, limit: float = math.inf) -> Spread:
    """Return how far estimates may be off: J (N, k), residuals (N,), `samples` (N,) whole numbers from 0 in order.

    The standard error of a mean of 400 numbers of deviation one is about 1/20:

    >>> numbers = np.random.default_rng(0).standard_normal(400)
    >>> spread = spread_of(np.ones((400, 1)), numbers, np.arange(400))
    >>> bool(0.04 < spread.covariance[0, 0] ** 0.5 < 0.06)
    True
    """
    norms = np.linalg.norm(J, axis=0)
    blind = norms == 0.0
    unit = J / np.where(blind, 1.0, norms)
    inside = np.abs(residuals) <= limit
    _, singular, V = np.linalg.svd(unit * inside[:, None], full_matrices=False)
    seen = singular > _BLIND * singular[0]
    inverse = np.where(seen, 1.0 / np.where(seen, singular, 1.0), 0.0)
    scores = np.zeros((int(samples[-1]) + 1, J.shape[1]))
    np.add.at(scores, samples, unit * np.clip(residuals, -limit, limit)[:, None])
    influence = scores @ (V.T * inverse**2) @ V
    lag = correlation_lag(influence)
    norms[blind] = 1.0
    covariance = long_run(influence, lag) * len(J) / max(1, len(J) - J.shape[1]) / np.outer(norms, norms)
    hidden = (np.abs(V[~seen]) > 1e-3).any(axis=0) | blind
    covariance[hidden] = np.nan
    covariance[:, hidden] = np.nan
    covariance.flags.writeable = False
    share = (lag + 1) / len(scores)
    return Spread(covariance, lag, sum(c * share**power for power, c in enumerate(_QUANTILE)))


def long_run(series: FloatArray, lag: int) -> FloatArray:
    """Return Σ_|l|≤lag (1 - |l|/(lag + 1)) Σ_t v(t) v(t - l)ᵀ, the covariance of the sum of a series (n, k)."""
    total: FloatArray = series.T @ series
    for late in range(1, lag + 1):
        product = series[late:].T @ series[: len(series) - late]
        total = total + (1.0 - late / (lag + 1.0)) * (product + product.T)
    return total


def correlation_lag(series: FloatArray) -> int:
    """Return over how many samples the correlation of a series (n, k) counts, below n; the scale of no column matters.

    >>> correlation_lag(np.array([[1.0], [2.0], [3.0], [2.0], [1.0], [-1.0], [-2.0], [-1.0]]))
    6
    """
    before, after = series[:-1], series[1:]
    power = np.sum(before**2, axis=0)
    known = power > 0.0
    if not known.any():
        return 0
    rho = np.sum(after * before, axis=0)[known] / power[known]
    rho = np.clip(rho, -_MOST_CORRELATED, _MOST_CORRELATED)
    alpha = np.sum(4.0 * rho**2 / (1.0 - rho) ** 4) / np.sum((1.0 + rho) ** 2 / (1.0 - rho) ** 2)
    return min(math.ceil(1.1447 * math.cbrt(float(alpha) * len(series))), len(series) - 1)


__all__ = ["Spread", "correlation_lag", "long_run", "spread_of"]
