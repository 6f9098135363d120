"""Kalman coordinates of a location as Balluchi et al. (2003) choose them, and their condition (16) in exact numbers.

In: A (n, n), C (p, n), perhaps a transformation T that the model states.  Out: a `KalmanSplit` whose `inverse` is T =
[T^O; T^N] and whose `transform` is T⁻¹ = [T'^O T'^N]: T'^N spans the unobservable subspace, T'^O its orthogonal
complement, and A^N is diagonal where that can be had.  A stated T is used as it stands, since R_N and ν_A depend on
the lengths of its columns; the default has columns of unit length.  The product T'^N T^N does not: it is the
projection onto the unobservable subspace, the same for every such T, and so (16) is a question of that subspace alone.

A model is written in decimals and fractions, of which a double is a rounding: each double is read as the simplest
fraction that rounds to it, so that a rank that is there on paper is there in the computation.  O(n^4).

Source: Balluchi et al. (2003), (8) to (12), (16).
"""

from collections.abc import Sequence
from fractions import Fraction

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.exact import Rational, product
from deshybrid.linear.observability import KalmanSplit, kalman_split, sorted_spectrum

SIMPLE = 1_000_000
"""A double that a fraction with a denominator up to this rounds to is read as that fraction."""
APART = 1e-6
"""Eigenvalues closer than this share of the largest count as equal: their eigenvectors are not used."""
SPLITS = 1e-9
"""A stated T splits a location if what has to vanish is below this share of the sizes of its factors."""


def kalman_coordinates(A: FloatArray, C: FloatArray, stated: FloatArray | None = None) -> KalmanSplit:
    """Return the location in coordinates T x = (x^O, x^N); `stated` (n, n) is T itself.

    Raises `UsageError` (DH0520) where the stated T does not split the location.

    >>> split = kalman_coordinates(np.diag([-1.0, 0.5]), np.array([[2.0, 0.0]]))
    >>> split.observable_dimension, split.A_u.tolist()
    (1, [[0.5]])
    """
    numeric = kalman_split(A, C)
    k = numeric.observable_dimension
    if stated is None:
        return _split(A, C, _default_columns(A, numeric), k)
    if np.linalg.matrix_rank(stated) < len(A):
        raise UsageError(diagnostic("DH0520", "the stated coordinates are no basis: T is singular"))
    split = _split(A, C, np.asarray(np.linalg.inv(stated)), k)
    seen, hidden = split.transform[:, :k], split.transform[:, k:]
    if _meets(split.inverse[:k] @ A, hidden) or _meets(C, hidden):
        message = f"the last {len(A) - k} columns of the inverse of the stated T do not span the unobservable subspace"
        raise UsageError(diagnostic("DH0520", message))
    if _meets(seen.T, hidden):
        message = (
            f"the first {k} columns of the inverse of the stated T are not orthogonal to the unobservable subspace"
        )
        raise UsageError(diagnostic("DH0520", message))
    return split


def _meets(rows: FloatArray, columns: FloatArray) -> bool:
    """Whether a product that has to vanish does not, beyond rounding."""
    sizes = np.outer(np.linalg.norm(rows, axis=1), np.linalg.norm(columns, axis=0))
    return bool((np.abs(rows @ columns) > SPLITS * sizes).any())


def _default_columns(A: FloatArray, numeric: KalmanSplit) -> FloatArray:
    """T'^O orthonormal; T'^N eigenvectors of unit length, or orthonormal where they are complex or not distinct."""
    k = numeric.observable_dimension
    basis = np.linalg.qr(numeric.transform[:, k:], mode="complete")[0]
    hidden, seen = basis[:, : len(A) - k], basis[:, len(A) - k :]
    inside = hidden.T @ A @ hidden
    values = sorted_spectrum(inside)
    apart = -np.diff(values.real) > APART * np.abs(values).max(initial=0.0)
    if (values.imag == 0).all() and apart.all():
        found, vectors = np.linalg.eig(inside)
        hidden = hidden @ vectors[:, np.argsort(-found.real, kind="stable")].real
    signs = np.where(np.take_along_axis(hidden, np.abs(hidden).argmax(axis=0)[None], 0) < 0, -1.0, 1.0)
    return np.hstack([seen, hidden * signs])


def _split(A: FloatArray, C: FloatArray, columns: FloatArray, k: int) -> KalmanSplit:
    n, p = len(A), len(C)
    rows = np.linalg.inv(columns)
    inside = rows @ A @ columns
    return KalmanSplit(
        frozen_array(columns, (n, n)),
        frozen_array(rows, (n, n)),
        frozen_array(inside[:k, :k], (k, k)),
        frozen_array((C @ columns)[:, :k], (p, k)),
        frozen_array(inside[k:, k:], (n - k, n - k)),
        frozen_array(inside[k:, :k], (n - k, k)),
    )


def simplest_rational(value: float) -> Fraction:
    """Return the fraction that the double stands for: a simple one that rounds to it, else the double itself.

    >>> simplest_rational(0.1), simplest_rational(-2258 / 3125)
    (Fraction(1, 10), Fraction(-2258, 3125))
    """
    simple = Fraction(value).limit_denominator(SIMPLE)
    return simple if float(simple) == value else Fraction(value)


def written(matrix: FloatArray) -> Rational:
    """Return the matrix of the fractions that its doubles stand for."""
    return tuple(tuple(simplest_rational(float(value)) for value in row) for row in matrix)


def hidden_projection(A: FloatArray, C: FloatArray) -> Rational:
    """Return T'^N T^N exactly: the orthogonal projection (n, n) onto the unobservable subspace of what is written.

    >>> hidden_projection(np.diag([-1.0, -2.0]), np.array([[0.1, 0.1]]))  # observable: nothing is hidden
    ((Fraction(0, 1), Fraction(0, 1)), (Fraction(0, 1), Fraction(0, 1)))
    """
    exact, rows = written(A), list(written(C))
    newest: Sequence[tuple[Fraction, ...]] = rows
    for _ in range(len(A) - 1):
        newest = product(tuple(newest), exact) if newest else ()
        rows += newest
    kernel = _kernel(rows, len(A))
    total = [[Fraction() for _ in A] for _ in A]
    for vector in _orthogonal(kernel):
        length = sum((value * value for value in vector), Fraction())
        for i, left in enumerate(vector):
            for j, right in enumerate(vector):
                total[i][j] += left * right / length
    return tuple(tuple(row) for row in total)


def _kernel(rows: Sequence[Sequence[Fraction]], width: int) -> list[list[Fraction]]:
    """A basis of the vectors that every row sends to zero, by Gauss and Jordan's elimination."""
    reduced: list[list[Fraction]] = []
    pivots: list[int] = []
    for row in rows:
        rest = list(row)
        for line, pivot in zip(reduced, pivots, strict=True):
            rest = [a - rest[pivot] * b for a, b in zip(rest, line, strict=True)]
        lead = next((j for j, value in enumerate(rest) if value), None)
        if lead is None:
            continue
        rest = [value / rest[lead] for value in rest]
        reduced = [[a - line[lead] * b for a, b in zip(line, rest, strict=True)] for line in reduced] + [rest]
        pivots.append(lead)
    basis = []
    for free in (j for j in range(width) if j not in pivots):
        vector = [Fraction(int(j == free)) for j in range(width)]
        for line, pivot in zip(reduced, pivots, strict=True):
            vector[pivot] = -line[free]
        basis.append(vector)
    return basis


def _orthogonal(vectors: Sequence[Sequence[Fraction]]) -> list[list[Fraction]]:
    """Gram and Schmidt's process without roots."""
    found: list[list[Fraction]] = []
    for vector in vectors:
        rest = list(vector)
        for other in found:
            share = sum((a * b for a, b in zip(rest, other, strict=True)), Fraction()) / sum(b * b for b in other)
            rest = [a - share * b for a, b in zip(rest, other, strict=True)]
        found.append(rest)
    return found


def hidden_dimensions(projections: Sequence[Rational], resets: Sequence[Rational]) -> tuple[int, ...]:
    """Return how much stays hidden on the way round: the ranks of P_1, P_2 R_1 P_1, ..., R_S P_S ... R_1 P_1.

    projections: P_i onto what each location hides; resets: R_i, which follows location i.  Decided exactly.  The last
    rank is 0 where (16) of Balluchi et al. (2003) holds.

    >>> first, second = hidden_projection(np.eye(1), np.zeros((1, 1))), hidden_projection(np.eye(1), np.eye(1))
    >>> one = ((Fraction(1),),)
    >>> hidden_dimensions([first, second], [one, one]), hidden_dimensions([first, first], [one, one])
    ((1, 0, 0), (1, 1, 1))
    """
    whole = projections[0]
    found = [whole]
    for reset, after in zip(resets[:-1], projections[1:], strict=True):
        whole = product(product(after, reset), whole)
        found.append(whole)
    found.append(product(resets[-1], whole))
    return tuple(len(matrix) - len(_kernel(matrix, len(matrix))) for matrix in found)


__all__ = ["hidden_dimensions", "hidden_projection", "kalman_coordinates", "simplest_rational", "written"]
