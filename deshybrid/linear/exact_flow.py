"""Enclosures of e^{F t} and M^k: a rational matrix and a proved bound of its error in every entry.

In: a rational matrix, a duration or a number of steps.  Out: X and r with |true - X| <= r entrywise.  The idea: fixed
point with 2^-BITS as its unit, Taylor's series for an exponent of row sum at most 1/2, then squaring; every product
rounds each entry by at most one unit, and errors are carried along in row sums.  O(n^3 log ‖F t‖) integer operations.
"""

from fractions import Fraction

from deshybrid.linear.exact import Rational

BITS = 192
TERMS = 48
LARGEST_ROW = 10**9
"""An exponent with a larger row sum is refused."""
LARGEST_RESULT = 256
"""So is a result with more binary places before the point."""


def flow_enclosure(F: Rational, duration: Fraction) -> tuple[Rational, Fraction]:
    """Return X and r with |e^{F t} - X| <= r in every entry; ValueError where the exponent is out of proportion.

    >>> X, r = flow_enclosure(((Fraction(1),),), Fraction(1))
    >>> float(X[0][0]), r < Fraction(1, 10**50)
    (2.718281828459045, True)
    """
    size = max((sum(abs(value) for value in row) for row in F), default=Fraction()) * duration
    if size > LARGEST_ROW:
        raise ValueError("the exponent is too large")
    halvings = int(2 * size).bit_length()
    n, unit = len(F), 1 << BITS
    small = [[_nearest(value * duration * unit / 2**halvings) for value in row] for row in F]
    term, total = _identity(n, unit), _identity(n, unit)
    for k in range(1, TERMS):
        term = [[value // k for value in row] for row in _multiplied(term, small)]
        total = [[a + b for a, b in zip(x, y, strict=True)] for x, y in zip(total, term, strict=True)]
    # In row sums: the exponent is off by n/2 units, which moves the result by less than 2 n units; each of the terms is
    # off by at most 4 n units; what the series leaves out is below 2^-TERMS/TERMS!, a part of a unit.
    error = 2 * n + 4 * n * TERMS + 1
    for _ in range(halvings):
        total, error = _squared(total, error)
    return _result(total, error)


def power_enclosure(M: Rational, count: int) -> tuple[Rational, Fraction]:
    """Return X and r with |M^k - X| <= r in every entry, k >= 0.

    >>> power_enclosure(((Fraction(1, 2),),), 3)[0]
    ((Fraction(1, 8),),)
    """
    n, unit = len(M), 1 << BITS
    base, base_error = [[_nearest(value * unit) for value in row] for row in M], n
    total, error = _identity(n, unit), 0
    for bit in reversed(range(max(count, 0).bit_length())):
        total, error = _squared(total, error)
        if count >> bit & 1:
            wide = _row_sum(total) * base_error + _row_sum(base) * error + error * base_error
            total, error = _multiplied(total, base), -(-wide >> BITS) + 1 + n
    return _result(total, error)


def _squared(total: list[list[int]], error: int) -> tuple[list[list[int]], int]:
    wide = 2 * _row_sum(total) * error + error * error
    squared = _multiplied(total, total)
    if _row_sum(squared) > 1 << (BITS + LARGEST_RESULT):
        raise ValueError("the result is too large")
    return squared, -(-wide >> BITS) + 1 + len(total)


def _result(total: list[list[int]], error: int) -> tuple[Rational, Fraction]:
    unit = 1 << BITS
    return tuple(tuple(Fraction(value, unit) for value in row) for row in total), Fraction(error, unit)


def _identity(n: int, unit: int) -> list[list[int]]:
    return [[unit if i == j else 0 for j in range(n)] for i in range(n)]


def _row_sum(matrix: list[list[int]]) -> int:
    return max((sum(abs(value) for value in row) for row in matrix), default=0)


def _multiplied(first: list[list[int]], second: list[list[int]]) -> list[list[int]]:
    columns = list(zip(*second, strict=True))
    return [[sum(a * b for a, b in zip(row, column, strict=True)) >> BITS for column in columns] for row in first]


def _nearest(value: Fraction) -> int:
    return round(value)


__all__ = ["flow_enclosure", "power_enclosure"]
