"""Upper bounds of |e^{F t}|, entry by entry: its integral (how far noise pushes) and its peak (how far an error goes).

In: a stable F (n, n), with its eigenvectors; or a sampled M.  Out: N >= the integral of |e^{F t}| over t >= 0, and
P >= |e^{F t}| for all t >= t0.  The idea: e^{F t} is a sum of modes, so its value at the middle of a cell and a bound
of its slope there bound it over the cell; cells grow with time, because fast modes are gone later; what remains after
the last cell is bounded mode by mode.  The number of cells doubles until the slope's share is below 1 %, and at most
to 4,096 a segment: the result stays an upper bound in any case.  A relative margin covers rounding in the
eigenvectors.

Source: Balluchi et al. (2012), (27): the L¹ norm of a matrix function; the quadrature is this project's.
"""

from collections.abc import Iterator
from math import exp

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import ComplexArray, FloatArray

AGREE = 0.01
MOST_CELLS = 4_096
ROUNDING = 1e-9
MOST_STEPS = 200_000
DECAYED = 14.0
"""A mode counts as gone after 14 of its time constants (10⁻⁶); what is left of it is still bounded."""


def impulse_norm(eigenvalues: ComplexArray, basis: ComplexArray, *, step: float | None = None) -> FloatArray:
    """Return N, entrywise at least the integral of |e^{F t}| over t >= 0 (or the sum of |M^k| over k >= 0).

    F = basis diag(eigenvalues) basis⁻¹, all eigenvalues decaying.

    >>> impulse_norm(np.array([-2.0 + 0j]), np.eye(1, dtype=complex)).round(1)
    array([[0.5]])
    """
    weights, noise = _weights(basis)
    if step is not None:
        total, slow = _summed(eigenvalues, weights), 1.0
    else:
        slow = float(-eigenvalues.real.max())
        total = _tail(eigenvalues, weights, _end(eigenvalues))
        for start, end in _segments(eigenvalues, 0.0):
            middles, width, slack = _cells(eigenvalues, weights, (start, end))
            total = total + middles.sum(axis=2) * width + slack * (end - start) / 2
    return np.asarray(total * (1 + ROUNDING) + noise / slow)


def peak_norm(
    eigenvalues: ComplexArray, basis: ComplexArray, *, start: float = 0.0, step: float | None = None
) -> FloatArray:
    """Return P, entrywise at least |e^{F t}| for every t >= start (or |M^k| for every k with k step >= start).

    >>> peak_norm(np.array([-2.0 + 0j]), np.eye(1, dtype=complex), start=0.5).round(2)
    array([[0.37]])
    """
    weights, noise = _weights(basis)
    if step is not None:
        return np.asarray(_largest_power(eigenvalues, weights, start / step) * (1 + ROUNDING) + noise)
    peak = np.abs(weights) @ np.exp(eigenvalues.real * max(_end(eigenvalues), start))
    for begin, end in _segments(eigenvalues, start):
        middles, _, slack = _cells(eigenvalues, weights, (begin, end))
        peak = np.maximum(peak, middles.max(axis=2) + slack)
    return np.asarray(peak * (1 + ROUNDING) + noise * np.exp(eigenvalues.real.max() * start))


def _weights(basis: ComplexArray) -> tuple[NDArray[np.complex128], FloatArray]:
    """Weights (i, j, mode) with [e^{F t}]_ij = sum of weights e^{λ t}, and a bound of their rounding (i, j)."""
    inverse = np.linalg.inv(basis)
    weights = basis[:, None, :] * inverse.T[None, :, :]
    return weights, np.asarray(float(np.linalg.cond(basis)) * 1e-14 * np.abs(weights).sum(axis=2))


def _end(eigenvalues: ComplexArray) -> float:
    """Where the cells end: the end of the first doubling segment after 14 time constants of the slowest mode."""
    return max(end for _, end in _segments(eigenvalues, 0.0))


def _segments(eigenvalues: ComplexArray, start: float) -> Iterator[tuple[float, float]]:
    """[0, a], [a, 2a], [2a, 4a], ... from `start` until the slowest mode is gone; a is the fastest time constant."""
    slow, fast = float(-eigenvalues.real.max()), float(np.abs(eigenvalues).max())
    begin, end = 0.0, 1.0 / fast
    while begin * slow < DECAYED:
        if end > start:
            yield max(begin, start), end
        begin, end = end, 2 * end


def _cells(
    eigenvalues: ComplexArray, weights: NDArray[np.complex128], segment: tuple[float, float]
) -> tuple[FloatArray, float, FloatArray]:
    """|e^{F t}| in the middle of each cell (i, j, cell), the cell width, and how much it can rise in half a cell."""
    start, end = segment
    steepest = np.abs(weights * eigenvalues) @ np.exp(eigenvalues.real * start)
    cells = 16
    while True:
        width = (end - start) / cells
        times = start + width * (np.arange(cells) + 0.5)
        middles = np.abs((weights @ np.exp(np.outer(eigenvalues, times))).real)
        slack = steepest * width / 2
        if cells >= MOST_CELLS or slack.max() <= 2 * AGREE * max(float(middles.max()), 1e-300):
            return middles, width, slack
        cells *= 2


def _tail(eigenvalues: ComplexArray, weights: NDArray[np.complex128], start: float) -> FloatArray:
    return np.asarray((np.abs(weights) * np.exp(eigenvalues.real * start) / -eigenvalues.real).sum(axis=2))


def _count(eigenvalues: ComplexArray) -> int:
    radius = float(np.abs(eigenvalues).max(initial=0.0))
    return 1 if radius == 0 else min(MOST_STEPS, int(np.ceil(-DECAYED / np.log(min(radius, exp(-1e-6))))) + 1)


def _summed(eigenvalues: ComplexArray, weights: NDArray[np.complex128]) -> FloatArray:
    """Terms |M^k| until the largest modulus has shrunk to 10⁻⁶, then a geometric tail."""
    moduli, count = np.abs(eigenvalues), _count(eigenvalues)
    total, powers = np.zeros(weights.shape[:2]), np.ones_like(eigenvalues)
    for _ in range(count):
        total += np.abs((weights @ powers).real)
        powers = powers * eigenvalues
    return np.asarray(total + (np.abs(weights) * (moduli**count / (1 - moduli))).sum(axis=2))


def _largest_power(eigenvalues: ComplexArray, weights: NDArray[np.complex128], first: float) -> FloatArray:
    begin, count = int(np.ceil(first - 1e-6)), _count(eigenvalues)
    peak = np.abs(weights) @ np.abs(eigenvalues) ** max(begin, count)
    powers = eigenvalues**begin
    for _ in range(begin, count):
        peak = np.maximum(peak, np.abs((weights @ powers).real))
        powers = powers * eigenvalues
    return np.asarray(peak)


__all__ = ["impulse_norm", "peak_norm"]
