"""Noise beyond a fixed covariance: noise that grows with the state, and measurements with heavy tails.

In: the Gaussian x, P of each mode, and the form of its noise, G for noise e G x, and share and factor of its tails.
Out: covariances, and the Gaussian after a measurement.

Noise e G x, e white with variance 1 and independent of x, has mean 0 and covariance G (P + x xᵀ) Gᵀ: put into the
Kalman filter, mean and covariance stay those of the best linear estimate (Rajasekaran et al., 1971).
A position that is late by a random time has such a noise, G taking the velocity out of the state.

Heavy tails are those of a contaminated normal: a share ε of the rows has c R for R.  Given the Gaussian before the row,
the state after it is a mixture of two Gaussians, that of c R with the probability that the row is one of those, and
the likelihood is (1 - ε) N(r; 0, H P Hᵀ + R) + ε N(r; 0, H P Hᵀ + c R): both exact.  One Gaussian of the same mean and
covariance goes on.  Student's t would need an iteration and has no likelihood in closed form, by which modes are
weighed.  With ε = 0 or c = 1 this is the Kalman filter.

Two updates a row instead of one.  Source: Tukey (1960), the contaminated normal; Alspach and Sorenson (1972), Gaussian
sums; Masreliez and Martin (1977), robust Kalman filters.
"""

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import gaussian
from deshybrid.stochastic.gaussian import Correction
from deshybrid.stochastic.lanes import product, symmetric, times
from deshybrid.stochastic.system import Mode


def grown(covariance: FloatArray, by_state: FloatArray | None, x: FloatArray, P: FloatArray) -> FloatArray:
    """Return covariance + G (P + x xᵀ) Gᵀ with G = `by_state` (..., k, n); the covariance (..., k, k) itself for None.

    >>> grown(np.eye(1), np.array([[0.5]]), np.array([2.0]), np.zeros((1, 1))).tolist()
    [[2.0]]
    """
    if by_state is None:
        return covariance
    mean = times(by_state, x)
    spread = product(product(by_state, P), by_state.swapaxes(-1, -2))
    total: FloatArray = covariance + symmetric(spread + mean[..., :, None] * mean[..., None, :])
    return total


def update(
    x: FloatArray, P: FloatArray, residual: FloatArray, H: FloatArray, R: FloatArray, *, tails: FloatArray | None
) -> Correction:
    """Return the Gaussian given a residual (..., p), as `gaussian.update`; share and factor of `tails` (..., 2).

    With tails, x and P are mean and covariance of the mixture after the measurement, `log_likelihood` is that of the
    mixture; S, L, W and `distance` are those of its covariance before, H P Hᵀ + (1 - ε + ε c) R.

    >>> zero, one = np.zeros(1), np.eye(1)
    >>> far = np.array([20.0])
    >>> update(zero, one, far, one, one, tails=np.array([0.01, 1e4])).x.round(3).tolist()
    [0.002]
    >>> update(zero, one, far, one, one, tails=None).x.round(3).tolist()
    [10.0]
    """
    if tails is None:
        return gaussian.update(x, P, residual, H, R)
    share, factor = tails[..., 0], tails[..., 1]
    with np.errstate(divide="ignore"):
        good = gaussian.update(x, P, residual, H, R)
        bad = gaussian.update(x, P, residual, H, factor[..., None, None] * R)
        log_good, log_bad = np.log1p(-share) + good.log_likelihood, np.log(share) + bad.log_likelihood
    total = np.logaddexp(log_good, log_bad)
    weight = np.exp(log_bad - total)  # of the row being a bad one
    apart, column = bad.x - good.x, weight[..., None]
    mean = good.x + column * apart
    spread = (column * (1.0 - column))[..., None] * apart[..., :, None] * apart[..., None, :]
    covariance = (1.0 - column)[..., None] * good.P + column[..., None] * bad.P + spread
    before = gaussian.update(x, P, residual, H, (1.0 - share + share * factor)[..., None, None] * R)
    return replace(before, x=mean, P=covariance, log_likelihood=total)


def at(array: FloatArray | None, mode: np.ndarray[tuple[int, ...], np.dtype[np.intp]]) -> FloatArray | None:
    """Return the entries of these modes, None for None.

    >>> at(np.array([[1.0], [2.0]]), np.array(1)).tolist()
    [2.0]
    """
    return None if array is None else array[mode]


def require_fixed_noise(modes: Iterable[Mode], what: str) -> None:
    """Raise `UsageError` (DH1120) where the noise of a mode is more than white with a fixed covariance.

    >>> require_fixed_noise([], "the steady-state filter")
    """
    for mode in modes:
        mode.noise.require_fixed(what, mode.name)


__all__ = ["at", "grown", "require_fixed_noise", "update"]
