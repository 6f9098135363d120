"""Decay of one location: ‖e^{F t}‖ <= κ e^{α t}, with the basis T that proves it.

In: F (n, n), a state scale s (n,), the step of a sampled system.  Out: T, α and κ.  The norm of the error is
‖diag(s)⁻¹ ζ‖₂: every location must be measured in one norm, but any one does, and a good one (s from the bounds of the
state) takes the units out of κ.  κ is a property of T, not of F: the columns of T start at unit length and their
scaling is then optimised (log κ is a convex function of the logarithms of the column lengths).

α and κ are rounded up, so that exact arithmetic on the stored numbers (`deshybrid.verify`) confirms them without
slack. A matrix with κ beyond 10^7 counts as defective (a repeated eigenvalue with one eigenvector): κ is then
infinite.

Source: Balluchi et al. (2012), Lemma 8, (24).
"""

from collections.abc import Callable
from dataclasses import dataclass
from math import inf, isfinite, log

import numpy as np

from deshybrid.linear.arrays import ComplexArray, FloatArray

DEFECTIVE = 1e7
"""A condition number beyond this is taken as infinite: the eigenvalues are then correct to half of all digits only."""
MOST_SEARCHED = 20
"""With more states than this, scales and column lengths are taken as they are; a search would take minutes."""
ROUND_UP = 1e-9
"""Relative amount by which claimed numbers are raised above their computed values."""


@dataclass(frozen=True, slots=True, eq=False)
class ModalBasis:
    """‖e^{F t}‖ <= kappa e^{alpha t} in the norm ‖diag(scale)⁻¹ ·‖₂; for a sampled F, ‖F^k‖ <= kappa e^{alpha k h}.

    eigenvalues (n,) as F has them; basis (n, n): F basis = basis diag(eigenvalues); alpha in 1/s, kappa >= 1.
    """

    eigenvalues: ComplexArray
    basis: ComplexArray
    alpha: float
    kappa: float


def decay_rate(eigenvalues: ComplexArray, step: float | None) -> float:
    """Return α in 1/s: the largest real part, or log of the spectral radius over the step.

    >>> decay_rate(np.array([-1.0 + 2j, -3.0 + 0j]), None)
    -1.0
    """
    if step is None:
        return float(eigenvalues.real.max(initial=-inf))
    radius = float(np.abs(eigenvalues).max(initial=0.0))
    return log(radius) / step if radius > 0 else -inf


def modal_basis(F: FloatArray, scale: FloatArray, *, step: float | None = None, improve: bool = True) -> ModalBasis:
    """Return the eigenvectors of F with columns of unit length, or (`improve`) of the length that makes κ least.

    >>> found = modal_basis(np.diag([-3.0, -4.0]), np.ones(2))
    >>> round(found.alpha, 6), round(found.kappa, 6)
    (-3.0, 1.0)
    """
    scaled = F * scale / scale[:, None]
    values, columns = np.linalg.eig(scaled)
    order = np.lexsort((-values.imag, -values.real))
    eigenvalues = np.asarray(values[order], dtype=np.complex128)
    vectors = np.asarray(columns[:, order], dtype=np.complex128)
    kappa = condition(vectors)
    if improve and isfinite(kappa):
        vectors, kappa = best_columns(vectors, eigenvalues)
    alpha = _proved_rate(scaled, vectors, kappa, step) if isfinite(kappa) else decay_rate(eigenvalues, step)
    return ModalBasis(eigenvalues, scale[:, None] * vectors, alpha, kappa * (1 + ROUND_UP))


def condition(vectors: ComplexArray) -> float:
    """Return the 2-norm condition number; infinite beyond `DEFECTIVE`.

    >>> condition(np.array([[1, 1], [1, 1]], dtype=complex))
    inf
    """
    values = np.linalg.svd(vectors, compute_uv=False)
    smallest, largest = float(values.min(initial=1.0)), float(values.max(initial=1.0))
    return largest / smallest if smallest * DEFECTIVE > largest else inf


def best_columns(vectors: ComplexArray, eigenvalues: ComplexArray) -> tuple[ComplexArray, float]:
    """Return the columns rescaled so that the condition number is (nearly) least, and that number.

    The two columns of a conjugate pair keep one length, by symmetry.  Nelder and Mead's search, from unit columns.
    """
    group = _pairs(eigenvalues)
    start = condition(vectors)
    if group.max(initial=0) == 0 or len(group) > MOST_SEARCHED:
        return vectors, start

    def cost(lengths: FloatArray) -> float:
        return condition(vectors * np.exp(np.append(lengths, 0.0))[group])

    lengths = simplex_search(cost, np.zeros(group.max()), 150 * len(group))
    return vectors * np.exp(np.append(lengths, 0.0))[group], cost(lengths)


def simplex_search(cost: Callable[[FloatArray], float], start: FloatArray, evaluations: int) -> FloatArray:
    """Return where Nelder and Mead's search finds the least cost, never above that of the start; deterministic.

    Variables are logarithms; the first simplex reaches 0.5 from the start in each.

    >>> simplex_search(lambda x: float((x[0] - 1) ** 2), np.zeros(1), 100).round(2)
    array([1.])
    """
    from scipy.optimize import minimize

    simplex = np.vstack([start, start + 0.5 * np.eye(len(start))])
    found = minimize(
        cost,
        start,
        method="Nelder-Mead",
        options={"maxfev": evaluations, "xatol": 1e-4, "fatol": 1e-9, "initial_simplex": simplex},
    )
    return np.asarray(found.x) if found.fun < cost(start) else start


def _pairs(eigenvalues: ComplexArray) -> "np.ndarray[tuple[int, ...], np.dtype[np.intp]]":
    """Number the modes, a conjugate pair as one (its members are neighbours in sorted order)."""
    numbers, current = [], -1
    for position, value in enumerate(eigenvalues):
        second = position > 0 and value.imag < 0 and eigenvalues[position - 1] == value.conjugate()
        current += 0 if second else 1
        numbers.append(current)
    return np.array(numbers, dtype=np.intp)


def _proved_rate(scaled: FloatArray, vectors: ComplexArray, kappa: float, step: float | None) -> float:
    """α from the logarithmic norm in the basis, above the spectral abscissa by rounding only."""
    inside = np.linalg.solve(vectors, scaled @ vectors)
    size = float(np.linalg.norm(scaled, 2))
    margin = 100 * len(scaled) * float(np.finfo(np.float64).eps) * kappa * size
    if step is None:
        value = float(np.linalg.eigvalsh((inside + inside.conj().T) / 2).max())
        return value + margin + ROUND_UP * abs(value)
    radius = float(np.linalg.norm(inside, 2)) * (1 + ROUND_UP) + margin
    return log(max(radius, float(np.finfo(np.float64).tiny))) / step


__all__ = [
    "DEFECTIVE",
    "ROUND_UP",
    "ModalBasis",
    "best_columns",
    "condition",
    "decay_rate",
    "modal_basis",
    "simplex_search",
]
