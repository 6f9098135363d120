"""Kalman prediction and update for any number of Gaussians at once.

In: means (..., n) and covariances (..., n, n), and matrices with the same leading axes or the last of them, shared by
the others.  Out: new arrays.  Covariances are symmetric to the last bit: the prediction is made so (else its
antisymmetric part grows as F Δ Fᵀ without end), the update P - Wᵀ W, W = L⁻¹ H P with S = L Lᵀ, is so by itself.
Likelihoods are logarithms, so that a measurement far out is a large negative number and nothing more.  A channel that
is NaN is left out: its residual and its covariances are zero and its variance is 1, which changes neither the gain nor
the likelihood of the others.

O(n³ + p³) for each Gaussian.  Source: Bar-Shalom, Li and Kirubarajan (2001), chapter 5; Hwang et al. (2006), section 3.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.lanes import cholesky, product, solve_lower, solve_upper, symmetric, times

_LOG_2PI = math.log(2.0 * math.pi)


@dataclass(frozen=True, slots=True, eq=False)
class Correction:
    """An updated Gaussian, with the residual (..., p), its covariance S = L Lᵀ, W = L⁻¹ H P and log N(z; Hx, S).

    `distance` (...) is the residual squared in units of S.
    """

    x: FloatArray
    P: FloatArray
    residual: FloatArray
    S: FloatArray
    L: FloatArray
    W: FloatArray
    distance: FloatArray
    log_likelihood: FloatArray

    @property
    def gain(self) -> FloatArray:
        """The gain K = P Hᵀ S⁻¹ (..., n, p)."""
        return solve_upper(self.L, self.W).swapaxes(-1, -2)


def predict(
    x: FloatArray, P: FloatArray, F: FloatArray, Q: FloatArray, push: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return F x + push and F P Fᵀ + Q; push (..., n) is what inputs and offsets add.

    >>> x, P = predict(np.array([1.0]), np.eye(1), 2 * np.eye(1), np.eye(1), np.array([0.5]))
    >>> x.tolist(), P.tolist()
    ([2.5], [[5.0]])
    """
    return times(F, x) + push, symmetric(product(product(F, P), F.swapaxes(-1, -2)) + Q)


def squared_norm(residual: FloatArray, S: FloatArray) -> FloatArray:
    """Return rᵀ S⁻¹ r of residuals (..., p).

    >>> float(squared_norm(np.array([2.0]), np.array([[4.0]])))
    1.0
    """
    white = solve_lower(cholesky(S), residual[..., None])[..., 0]
    squares: FloatArray = (white * white).sum(axis=-1)
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
    HP = product(H, P)
    return condition(x, P, residual, HP, product(HP, H.swapaxes(-1, -2)) + R)


def condition(x: FloatArray, P: FloatArray, residual: FloatArray, cross: FloatArray, S: FloatArray) -> Correction:
    """Return a Gaussian given a residual (..., p), its covariance with x, `cross` (..., p, n), and its own, S.

    Raises as `update`, which is this with cross = H P.

    >>> one = np.eye(1)
    >>> condition(np.array([0.0]), one, np.array([2.0]), one, 2 * one).x.round(12).tolist()
    [1.0]
    """
    residual, cross, S, count = _without_missing(residual, cross, S)
    L = cholesky(S)
    require_factor(S, L)
    white = solve_lower(L, np.concatenate([cross, residual[..., None]], axis=-1))
    W, e = white[..., :-1], white[..., -1]
    moved = product(W.swapaxes(-1, -2), white)  # of P and of x
    log_size = np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum(axis=-1)
    distance = (e * e).sum(axis=-1)
    log_likelihood = -0.5 * (distance + count * _LOG_2PI) - log_size
    return Correction(x + moved[..., -1], P - moved[..., :-1], residual, S, L, W, distance, log_likelihood)


def require_factor(S: FloatArray, L: FloatArray) -> None:
    """Raise `UsageError` where the factor L of a covariance S is not finite: DH1105, or DH1108 where S is not, either.

    >>> require_factor(np.eye(1), np.eye(1))
    """
    if np.isfinite(L).all():
        return
    if not np.isfinite(S).all():
        raise overflow()
    text = "a covariance is not positive definite, so that no measurement has a likelihood"
    helps = ("give every output a measurement noise above zero",)
    raise UsageError(diagnostic("DH1105", text, helps=helps))


def _without_missing(
    residual: FloatArray, cross: FloatArray, S: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, NDArray[np.intp] | int]:
    seen = ~np.isnan(residual)
    if seen.all():
        return residual, cross, S, residual.shape[-1]
    both = seen[..., :, None] & seen[..., None, :]
    S = np.where(both, S, np.eye(residual.shape[-1]))
    return np.where(seen, residual, 0.0), np.where(seen[..., None], cross, 0.0), S, seen.sum(axis=-1)


__all__ = ["Correction", "condition", "overflow", "predict", "require_factor", "squared_norm", "update"]
