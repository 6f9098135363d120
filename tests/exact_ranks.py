"""Ranks over the rational numbers: the oracle for everything that decides a rank in floating point."""

from collections.abc import Sequence
from fractions import Fraction


def rank(matrix: Sequence[Sequence[Fraction]]) -> int:
    """The rank by elimination, exactly."""
    rows = [list(row) for row in matrix]
    found = 0
    for column in range(len(rows[0]) if rows else 0):
        pivot = next((k for k in range(found, len(rows)) if rows[k][column]), None)
        if pivot is None:
            continue
        rows[found], rows[pivot] = rows[pivot], rows[found]
        for k in range(found + 1, len(rows)):
            factor = rows[k][column] / rows[found][column]
            rows[k] = [a - factor * b for a, b in zip(rows[k], rows[found], strict=True)]
        found += 1
    return found
