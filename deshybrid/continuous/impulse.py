"""Upper bounds of the integral of |e^{F t}|, entry by entry: how far bounded noise can push an error.

In: a stable F (n, n), with its eigenvectors; or a sampled M.  Out: N (n, n) with N_ij >= ∫ |[e^{F t}]_ij| dt over [0,
∞). The idea: e^{F t} is a sum of modes, so its value at the middle of a cell and a bound of its slope there bound it
over the cell; cells grow with time, because fast modes are gone later; what remains after the last cell is bounded
mode by mode.  The number of cells doubles until upper and lower estimates agree to 1 %, and at most 4,096 a segment:
the result stays an upper bound in any case.  A relative margin covers rounding in the eigenvectors.

Source: Balluchi et al. (2012), (27): the L¹ norm of a matrix function; the quadrature is this project's.
"""

from math import exp

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import ComplexArray, FloatArray

AGREE = 0.01
MOST_CELLS = 4_096
ROUNDING = 1e-9
MOST_STEPS = 200_000


def impulse_norm(eigenvalues: ComplexArray, basis: ComplexArray, *, step: float | None = None) -> FloatArray:
    """Return N, entrywise at least the integral of |e^{F t}| over t >= 0 (or the sum of |M^k| over k >= 0).

    F = basis diag(eigenvalues) basis⁻¹, all eigenvalues decaying.

    >>> impulse_norm(np.array([-2.0 + 0j]), np.eye(1, dtype=complex)).round(2)
    array([[0.5]])
    """
    inverse = np.linalg.inv(basis)
    weights = basis[:, None, :] * inverse.T[None, :, :]  # (i, j, mode): [e^{F t}]_ij = sum of weights e^{λ t}
    total = _integrated(eigenvalues, weights) if step is None else _summed(eigenvalues, weights)
    noise = float(np.linalg.cond(basis)) * 1e-14
    sizes = np.abs(weights).sum(axis=2) * (1.0 / -eigenvalues.real.max() if step is None else 1.0)
    return np.asarray(total * (1 + ROUNDING) + noise * sizes)


def short_norm(F: FloatArray, duration: float) -> FloatArray:
    """Return an entrywise upper bound of the integral of |e^{F t}| over [0, duration], for any F: that of e^{|F| t}.

    >>> short_norm(np.array([[0.0]]), 0.5)
    array([[0.5]])
    """
    from deshybrid.linear.sampling import flow_and_integral

    return flow_and_integral(np.abs(F), np.eye(len(F)), duration)[1]


def _integrated(eigenvalues: ComplexArray, weights: NDArray[np.complex128]) -> FloatArray:
    """Segments [0, a], [a, 2a], [2a, 4a], ... until e^{α t} is below 10⁻⁶, then the tail."""
    slow, fast = -eigenvalues.real.max(), np.abs(eigenvalues).max()
    total = np.zeros(weights.shape[:2])
    start, end = 0.0, 1.0 / fast
    while start * slow < 14.0:
        total += _segment(eigenvalues, weights, start, end)
        start, end = end, 2 * end
    tail = np.abs(weights) * np.exp(eigenvalues.real * start) / -eigenvalues.real
    return np.asarray(total + tail.sum(axis=2))


def _segment(eigenvalues: ComplexArray, weights: NDArray[np.complex128], start: float, end: float) -> FloatArray:
    """Midpoint rule plus the slope's share; cells are halved until that share is small."""
    steepest = np.abs(weights * eigenvalues) @ np.exp(eigenvalues.real * start)
    cells = 16
    while True:
        width = (end - start) / cells
        middles = start + width * (np.arange(cells) + 0.5)
        values = np.abs((weights @ np.exp(np.outer(eigenvalues, middles))).real).sum(axis=2) * width
        slack = steepest * width * (end - start) / 4
        if cells >= MOST_CELLS or slack.max() <= AGREE * max(float(values.max()), 1e-300):
            return np.asarray(values + slack)
        cells *= 2


def _summed(eigenvalues: ComplexArray, weights: NDArray[np.complex128]) -> FloatArray:
    """Terms |M^k| until the largest modulus has shrunk to 10⁻⁶, then a geometric tail."""
    moduli = np.abs(eigenvalues)
    radius = float(moduli.max(initial=0.0))
    count = 1 if radius == 0 else min(MOST_STEPS, int(np.ceil(-14.0 / np.log(min(radius, exp(-1e-6))))) + 1)
    total = np.zeros(weights.shape[:2])
    powers = np.ones_like(eigenvalues)
    for _ in range(count):
        total += np.abs((weights @ powers).real)
        powers = powers * eigenvalues
    tail = np.abs(weights) * (moduli**count / (1 - moduli))
    return np.asarray(total + tail.sum(axis=2))


__all__ = ["impulse_norm", "short_norm"]
