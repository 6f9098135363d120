"""Proofs that a symmetric matrix is positive definite, short enough for matrices with long entries.

In: a symmetric rational matrix.  Out: yes where it was proved.  The idea: floating point proposes L with L A Lᵀ close
to the identity; that product is computed exactly, and a symmetric matrix whose diagonal dominates its rows is positive
definite, hence so is A.  Where the proposal is not good enough, exact elimination decides.  O(n^3) products of
integers whose length does not grow, where elimination on fractions grows n times.

Source: Sylvester's law of inertia; Gershgorin's theorem.
"""

from fractions import Fraction
from math import frexp

import numpy as np

from deshybrid.linear.exact import Rational, integers, is_positive_semidefinite

PLACES = 80
"""The proposal L is rounded to this many binary places."""
LARGEST_ELIMINATED = 24
"""A larger matrix that the proposal does not settle counts as not proved."""


def is_positive_definite(matrix: Rational) -> bool:
    """Return whether xᵀ A x > 0 for all x ≠ 0 was proved; `False` for a matrix beyond 24 rows may mean "too close".

    >>> half = Fraction(1, 2)
    >>> is_positive_definite(((half, half), (half, 1 + half))), is_positive_definite(((half, half), (half, half)))
    (True, False)
    """
    if any(matrix[k][k] <= 0 for k in range(len(matrix))):
        return False
    if _dominates(matrix):
        return True
    if len(matrix) > LARGEST_ELIMINATED:
        return False
    return is_positive_semidefinite(matrix) and _has_full_rank(matrix)


def _dominates(matrix: Rational) -> bool:
    """Whether the proposed congruence gives a matrix whose diagonal dominates."""
    units = np.array(integers(matrix)[0], dtype=object)
    powers = [_half_size(units[k, k]) for k in range(len(matrix))]
    balanced = [[_ratio(units[i, j], powers[i] + powers[j]) for j in range(len(powers))] for i in range(len(powers))]
    try:
        root = np.linalg.cholesky(np.array(balanced))
    except np.linalg.LinAlgError:
        return False
    inverse = np.linalg.inv(root)
    shift = max(powers)
    proposal = np.empty(inverse.shape, dtype=object)
    size = frexp(float(np.abs(inverse).max()))[1]
    for (i, j), value in np.ndenumerate(inverse):
        proposal[i, j] = int(Fraction(float(value)) * Fraction(2) ** (PLACES - size)) << (shift - powers[j])
    whole = proposal.dot(units).dot(proposal.T)
    return all(whole[k, k] > sum(abs(value) for value in whole[k]) - abs(whole[k, k]) for k in range(len(powers)))


def _half_size(value: int) -> int:
    return int(value).bit_length() // 2


def _ratio(value: int, power: int) -> float:
    """value / 2^power as a double; 0 where it is too small for one."""
    return float(Fraction(value, 1 << power))


def _has_full_rank(matrix: Rational) -> bool:
    """Whether elimination meets no zero pivot; the matrix is known to be positive semidefinite."""
    rows = [list(row) for row in matrix]
    for k in range(len(rows)):
        if rows[k][k] == 0:
            return False
        for i in range(k + 1, len(rows)):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return True


__all__ = ["is_positive_definite"]
