"""How far apart two Gaussians of outputs are, on every window from the first row on, and what that means in samples.

In: two `OutputGaussian`s over the same rows.  Out: the Kullback-Leibler divergence both ways, the Bhattacharyya and the
Chernoff distance of the first n rows, for every n, and bounds on the error of the best test between the two:

    (1 - √(1 - e^(-2 B))) / 2  ≤  probability of a wrong name  ≤  e^(-C) / 2        at equal prior probabilities

so that a stated error needs at least so many rows, and is met by so many.  The outputs of a shorter window are leading
blocks, and the Cholesky factor of a leading block is the leading block of the factor: one factorisation serves all
windows.  O((N p)³).  Sources: Kailath (1967), The divergence and Bhattacharyya distance measures in signal selection;
Chernoff (1952).
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.outputs import OutputGaussian

EXPONENTS = tuple(number / 10 for number in range(1, 10))
"""The exponents s of the Chernoff distance that are tried; s = 1/2 is the Bhattacharyya distance."""


@dataclass(frozen=True, slots=True, eq=False)
class OutputDistance:
    """Distances of two Gaussians on windows of 1, ..., N rows, each (N,), in nats.

    `forward` is the Kullback-Leibler divergence of the second from the first, mean of ln(p_1 / p_2) under the first;
    `backward` the other way round; `chernoff` the largest over the exponents tried, each of which gives a bound.
    """

    forward: FloatArray
    backward: FloatArray
    bhattacharyya: FloatArray
    chernoff: FloatArray

    @property
    def symmetric(self) -> FloatArray:
        """Symmetric Kullback-Leibler divergence (Jeffreys), the sum of both ways."""
        total: FloatArray = self.forward + self.backward
        return total

    def per_row(self) -> tuple[float, float, float]:
        """What the last row of the window adds to `forward`, `backward` and `bhattacharyya`.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> from deshybrid.stochastic.outputs import staying
        >>> outputs = [staying(mode, 40, x=[0.0], P=[[1.0]]) for mode in calm_and_wild().modes]
        >>> [round(growth, 3) for growth in output_distance(*outputs).per_row()]
        [0.626, 5.912, 0.252]
        """
        parts = (self.forward, self.backward, self.bhattacharyya)
        forward, backward, middle = (float(part[-1] - (part[-2] if len(part) > 1 else 0.0)) for part in parts)
        return forward, backward, middle

    def rows_that_suffice(self, error: float) -> int | None:
        """The first window on which the likelihood ratio test is wrong with probability at most `error`, else None.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> from deshybrid.stochastic.outputs import staying
        >>> outputs = [staying(mode, 40, x=[0.0], P=[[1.0]]) for mode in calm_and_wild().modes]
        >>> output_distance(*outputs).rows_that_suffice(0.01)
        16
        """
        return _first(0.5 * np.exp(-self.chernoff) <= error)

    def rows_needed(self, error: float) -> int | None:
        """The first window on which some test might be as good as that; None where none within the window is.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> from deshybrid.stochastic.outputs import staying
        >>> outputs = [staying(mode, 40, x=[0.0], P=[[1.0]]) for mode in calm_and_wild().modes]
        >>> output_distance(*outputs).rows_needed(0.01)
        8
        """
        return _first(least_error(self.bhattacharyya) <= error)


def least_error(bhattacharyya: FloatArray) -> FloatArray:
    """Return the lower bound on the error of any test, at equal prior probabilities.

    >>> least_error(np.array([0.0, np.inf])).tolist()
    [0.5, 0.0]
    """
    overlap = np.exp(-2.0 * np.maximum(bhattacharyya, 0.0))
    bound: FloatArray = overlap / (2.0 * (1.0 + np.sqrt(1.0 - overlap)))  # = (1 - √(1 - overlap)) / 2, no cancellation
    return bound


def output_distance(first: OutputGaussian, second: OutputGaussian) -> OutputDistance:
    """Return the distances of two Gaussians over the same rows; O((N p)³).

    Raises `UsageError` (DH1201) where a covariance is not positive definite in double precision.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> from deshybrid.stochastic.outputs import staying
    >>> calm, wild = (staying(mode, 3, x=[0.0], P=[[1.0]]) for mode in calm_and_wild().modes)
    >>> output_distance(calm, wild).bhattacharyya.round(3).tolist()  # one row shows no process noise
    [0.0, 0.195, 0.427]
    """
    p, L1, L2 = _outputs(first), _factor(first), _factor(second)
    return OutputDistance(
        _kullback_leibler(first, second, L1, L2)[p - 1 :: p],
        _kullback_leibler(second, first, L2, L1)[p - 1 :: p],
        _chernoff(first, second, L1, L2, 0.5)[p - 1 :: p],
        chernoff_distance(first, second),
    )


def chernoff_distance(first: OutputGaussian, second: OutputGaussian) -> FloatArray:
    """Return the Chernoff distance (N,) of every window, the largest over `EXPONENTS`; raises as `output_distance`.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> from deshybrid.stochastic.outputs import staying
    >>> calm, wild = (staying(mode, 3, x=[0.0], P=[[1.0]]) for mode in calm_and_wild().modes)
    >>> chernoff_distance(calm, wild).round(3).tolist()
    [0.0, 0.209, 0.47]
    """
    p, L1, L2 = _outputs(first), _factor(first), _factor(second)
    found: FloatArray = np.stack([_chernoff(first, second, L1, L2, s) for s in EXPONENTS]).max(axis=0)[p - 1 :: p]
    return found


def unexplained(first: OutputGaussian, second: OutputGaussian, states: FloatArray) -> FloatArray:
    """Return the Bhattacharyya distance (N,) that is left for the least favourable states.

    `states` (N p, k) is how the difference of the means depends on what is unknown: [O, -O'] where both modes may have
    started anywhere.  Every window takes its own worst states.

    >>> from deshybrid.stochastic.outputs import staying
    >>> from deshybrid.stochastic.system import Mode
    >>> modes = [Mode("m", F=[[1.0]], H=[[gain]], Q=[[0.0]], R=[[1.0]]) for gain in (1, 3)]
    >>> near, far = (staying(mode, 2, x=[1.0], P=[[0.0]]) for mode in modes)
    >>> unexplained(near, far, np.array([[1.0, -3.0], [1.0, -3.0]])).round(9).tolist()  # 1 · 3 = 3 · 1
    [0.0, 0.0]
    """
    p, L = _outputs(first), _between(first, second, 0.5)
    difference, free = _solved(L, first.mean - second.mean), _solved(L, states)
    squares = [_least_square(free[:end], difference[:end]) for end in range(p, len(difference) + 1, p)]
    return np.array(squares) / 8.0 + _determinants(L, _factor(first), _factor(second), 0.5)[p - 1 :: p]


def cholesky(covariance: FloatArray, outputs: int) -> FloatArray:
    """Return the lower Cholesky factor of the covariance of rows of `outputs` numbers; raises DH1201 where it has none.

    >>> cholesky(np.array([[4.0]]), 1).tolist()
    [[2.0]]
    """
    from scipy.linalg import lapack

    factor, info = lapack.dpotrf(covariance, lower=True, clean=True)
    if info > 0 or not np.isfinite(factor).all():
        row = max(info - 1, 0) // outputs
        text = f"the outputs up to row {row + 1} have no density: their covariance is singular in double precision"
        helps = ("give every output a measurement noise above zero; for a fast unstable mode take a shorter window",)
        raise UsageError(diagnostic("DH1201", text, helps=helps))
    return np.asarray(factor)


def _first(holds: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]) -> int | None:
    return int(np.argmax(holds)) + 1 if holds.any() else None


def _solved(L: FloatArray, values: FloatArray) -> FloatArray:
    from scipy.linalg import solve_triangular

    return np.asarray(solve_triangular(L, values, lower=True))


def _outputs(gaussian: OutputGaussian) -> int:
    return len(gaussian.mean) // gaussian.rows


def _factor(gaussian: OutputGaussian) -> FloatArray:
    return cholesky(gaussian.covariance, _outputs(gaussian))


def _half_log_determinant(L: FloatArray) -> FloatArray:
    """½ ln |Σ| of every leading block of Σ = L Lᵀ."""
    return np.cumsum(np.log(np.diagonal(L)))


def _kullback_leibler(first: OutputGaussian, second: OutputGaussian, L1: FloatArray, L2: FloatArray) -> FloatArray:
    """Mean of ln(p_1 / p_2) under the first, for every leading block."""
    trace = np.cumsum((_solved(L2, L1) ** 2).sum(axis=1))
    square = np.cumsum(_solved(L2, first.mean - second.mean) ** 2)
    count = np.arange(1, len(trace) + 1)
    found: FloatArray = 0.5 * (trace - count + square) + _half_log_determinant(L2) - _half_log_determinant(L1)
    return found


def _chernoff(first: OutputGaussian, second: OutputGaussian, L1: FloatArray, L2: FloatArray, s: float) -> FloatArray:
    """-ln ∫ p_1^s p_2^(1-s) of every leading block."""
    L = _between(first, second, s)
    square = np.cumsum(_solved(L, first.mean - second.mean) ** 2)
    found: FloatArray = 0.5 * s * (1 - s) * square + _determinants(L, L1, L2, s)
    return found


def _between(first: OutputGaussian, second: OutputGaussian, s: float) -> FloatArray:
    return cholesky((1 - s) * first.covariance + s * second.covariance, _outputs(first))


def _determinants(L: FloatArray, L1: FloatArray, L2: FloatArray, s: float) -> FloatArray:
    """½ ln |Σ| - (1-s)/2 ln |Σ_1| - s/2 ln |Σ_2| of every leading block, L the factor of Σ = (1-s) Σ_1 + s Σ_2."""
    middle, one, two = map(_half_log_determinant, (L, L1, L2))
    found: FloatArray = middle - (1 - s) * one - s * two
    return found


def _least_square(free: FloatArray, difference: FloatArray) -> float:
    left = difference + free @ np.linalg.lstsq(free, -difference, rcond=None)[0]
    return float(left @ left)


__all__ = [
    "EXPONENTS",
    "OutputDistance",
    "chernoff_distance",
    "cholesky",
    "least_error",
    "output_distance",
    "unexplained",
]
