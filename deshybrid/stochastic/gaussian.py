"""Kalman prediction and update for any number of Gaussians at once.

In: means (..., n) and covariances (..., n, n), and matrices whose leading axes broadcast against theirs.  Out: new
arrays.  Covariances are updated in Joseph form and kept symmetric; likelihoods are logarithms, so that a measurement
far out is a large negative number and nothing more.  A channel that is NaN is left out: its row of H and its residual
are zero and its variance is 1, which changes neither the gain nor the likelihood of the others.

O(n³ + p³) for each Gaussian.  Source: Bar-Shalom, Li and Kirubarajan (2001), chapter 5; Hwang et al. (2006), section 3.
"""

import math
from dataclasses import dataclass

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray

_LOG_2PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """An updated Gaussian, with the residual (..., p), its covariance S, the gain K (..., n, p) and log N(z; Hx, S)."""

    x: FloatArray
    P: FloatArray
    residual: FloatArray
    S: FloatArray
    K: FloatArray
    log_likelihood: FloatArray


def times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return matrix (..., k, n) times vector (..., n).

    >>> times(np.eye(2), np.array([1.0, 2.0])).tolist()
    [1.0, 2.0]
    """
    product: FloatArray = (matrix @ vector[..., None])[..., 0]
    return product


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of (..., n, n).

    >>> symmetric(np.array([[1.0, 2.0], [0.0, 1.0]])).tolist()
    [[1.0, 1.0], [1.0, 1.0]]
    """
    part: FloatArray = 0.5 * (matrix + matrix.swapaxes(-1, -2))
    return part


def predict(
    x: FloatArray, P: FloatArray, F: FloatArray, Q: FloatArray, push: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return F x + push and F P Fᵀ + Q; push (..., n) is what inputs and offsets add.

    >>> x, P = predict(np.array([1.0]), np.eye(1), 2 * np.eye(1), np.eye(1), np.array([0.5]))
    >>> x.tolist(), P.tolist()
    ([2.5], [[5.0]])
    """
    return times(F, x) + push, symmetric(F @ P @ F.swapaxes(-1, -2) + Q)


def squared_norm(residual: FloatArray, S: FloatArray) -> FloatArray:
    """Return rᵀ S⁻¹ r of residuals (..., p).

    >>> float(squared_norm(np.array([2.0]), np.array([[4.0]])))
    1.0
    """
    squares: FloatArray = (residual * np.linalg.solve(S, residual[..., None])[..., 0]).sum(axis=-1)
    return squares


def overflow() -> UsageError:
    """The error of a filter whose numbers left the range of doubles (DH1108).

    >>> overflow().diagnostics[0].code
    'DH1108'
    """
    helps = ("look for a number of absurd size among the measurements, or an unstable mode without measurements",)
    return UsageError(diagnostic("DH1108", "the estimates grow beyond all numbers", helps=helps))


def update(x: FloatArray, P: FloatArray, residual: FloatArray, H: FloatArray, R: FloatArray) -> Correction:
    """Return the Gaussian given a measurement; residual (..., p) = z - H x - ..., NaN where nothing was measured.

    Raises `UsageError`: DH1105 where the covariance of a residual is singular, DH1108 where it is not finite.

    >>> update(np.array([0.0]), np.eye(1), np.array([2.0]), np.eye(1), np.eye(1)).x.round(12).tolist()
    [1.0]
    """
    H, R, residual, count = _without_missing(residual, H, R)
    transposed = H.swapaxes(-1, -2)
    S = symmetric(H @ P @ transposed + R)
    try:
        whitening = np.linalg.inv(np.linalg.cholesky(S))
    except np.linalg.LinAlgError:
        if not np.isfinite(S).all():
            raise overflow() from None
        text = "the covariance of a residual is not positive definite, so that no measurement has a likelihood"
        helps = ("give every output a measurement noise above zero",)
        raise UsageError(diagnostic("DH1105", text, helps=helps)) from None
    white = times(whitening, residual)
    K = P @ transposed @ whitening.swapaxes(-1, -2) @ whitening
    keep = np.eye(x.shape[-1]) - K @ H
    joseph = keep @ P @ keep.swapaxes(-1, -2) + K @ R @ K.swapaxes(-1, -2)
    log_size = np.log(np.diagonal(whitening, axis1=-2, axis2=-1)).sum(axis=-1)
    log_likelihood = log_size - 0.5 * ((white**2).sum(axis=-1) + count * _LOG_2PI)
    return Correction(x + times(K, residual), symmetric(joseph), residual, S, K, log_likelihood)


def _without_missing(
    residual: FloatArray, H: FloatArray, R: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    seen = ~np.isnan(residual)
    count = seen.sum(axis=-1).astype(np.float64)
    if seen.all():
        return H, R, residual, count
    both = seen[..., :, None] & seen[..., None, :]
    R = np.where(both, R, np.eye(residual.shape[-1]))
    return np.where(seen[..., None], H, 0.0), R, np.where(seen, residual, 0.0), count


__all__ = ["Correction", "overflow", "predict", "squared_norm", "symmetric", "times", "update"]
