"""Exact linear algebra on rational numbers: what a checker of certificates may rely on.

In: doubles, taken as the rational numbers they are.  Out: verdicts without rounding, lower bounds of e^x, and matrix
exponentials to 40 digits.  Matrices are tuples of rows of `fractions.Fraction`.  O(n^3) operations on numbers whose
length grows like n times that of a double: meant for n up to 20 or so.
"""

from collections.abc import Sequence
from fractions import Fraction
from math import lcm
from operator import mul
from typing import TypeAlias

Rational: TypeAlias = tuple[tuple[Fraction, ...], ...]
BITS = 256
"""Enclosures of exponentials are rounded outwards to this many binary places."""
LARGEST_ROW = 10**15
"""A matrix exponential is refused beyond this row sum of its exponent."""
LARGEST_RESULT = 1024
"""It is refused too where an entry has more binary places before the point than a double."""
LARGEST = 700
"""Beyond this exponent a lower bound of the exponential stays where it is."""


def rational(rows: Sequence[Sequence[float]]) -> Rational:
    """Return the matrix whose entries are exactly the given doubles.

    >>> rational([[0.5]])
    ((Fraction(1, 2),),)
    """
    return tuple(tuple(Fraction(value) for value in row) for row in rows)


def product(first: Rational, second: Rational) -> Rational:
    """Return the matrix product, by integers over a common denominator of each matrix."""
    (left, below), (right, under) = integers(first), integers(second)
    columns = list(zip(*right, strict=True))
    return tuple(tuple(Fraction(sum(map(mul, row, column)), below * under) for column in columns) for row in left)


def transposed(matrix: Rational) -> Rational:
    """Return the transpose."""
    return tuple(zip(*matrix, strict=True))


def combined(first: Rational, second: Rational, factor: Fraction | int = 1) -> Rational:
    """Return first + factor · second."""
    return tuple(tuple(a + factor * b for a, b in zip(x, y, strict=True)) for x, y in zip(first, second, strict=True))


def scaled(matrix: Rational, factor: Fraction | int) -> Rational:
    """Return factor · matrix."""
    return tuple(tuple(factor * value for value in row) for row in matrix)


def diagonal(values: Sequence[Fraction | int]) -> Rational:
    """Return the diagonal matrix of these values."""
    size = len(values)
    return tuple(tuple(Fraction(values[i]) if i == j else Fraction() for j in range(size)) for i in range(size))


def is_positive_semidefinite(matrix: Rational) -> bool:
    """Return whether a symmetric matrix has no negative eigenvalue, by exact elimination (LDLᵀ); no rounding.

    >>> is_positive_semidefinite(rational([[1.0, 1.0], [1.0, 1.0]]))
    True
    >>> is_positive_semidefinite(rational([[1.0, 2.0], [2.0, 1.0]]))
    False
    """
    rows = [list(row) for row in matrix]
    size = len(rows)
    for k in range(size):
        pivot = rows[k][k]
        if pivot < 0 or (pivot == 0 and any(rows[i][k] for i in range(k + 1, size))):
            return False
        if pivot == 0:
            continue
        for i in range(k + 1, size):
            factor = rows[i][k] / pivot
            if factor:
                rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    return True


def exponential_below(exponent: Fraction) -> Fraction:
    """Return a rational number below e^exponent, by less than 10⁻⁶⁰ of it for exponents between -100 and 700.

    >>> float(exponential_below(Fraction(1))), float(exponential_below(Fraction(-1)))
    (2.718281828459045, 0.36787944117144233)
    """
    if exponent < -LARGEST:
        return Fraction()
    low, high = _enclosed(min(abs(exponent), Fraction(LARGEST)))
    return low if exponent >= 0 else 1 / high


def _enclosed(exponent: Fraction) -> tuple[Fraction, Fraction]:
    """Taylor's series below 1/2, then squaring, rounded outwards."""
    halvings = int(2 * exponent).bit_length()
    small = exponent / 2**halvings
    term, low = Fraction(1), Fraction(1)
    for k in range(1, 60):
        term = term * small / k
        low += term
    # What the series leaves out is below its last term, as each term is less than half of the one before.
    low, high = _rounded(low, up=False), _rounded(low + term, up=True)
    for _ in range(halvings):
        low, high = _rounded(low * low, up=False), _rounded(high * high, up=True)
    return low, high


def matrix_exponential(matrix: Rational) -> Rational:
    """Return e^matrix to some 40 digits (not an enclosure): Taylor's series in 256-bit fixed point, then squaring.

    Raises ValueError if a row sum of |matrix| exceeds 10¹⁵, or the result the range of doubles.

    >>> float(matrix_exponential(rational([[1.0]]))[0][0])
    2.718281828459045
    """
    size = max((sum(abs(value) for value in row) for row in matrix), default=Fraction())
    if size > LARGEST_ROW:
        raise ValueError("the exponent is too large")
    halvings = int(2 * size).bit_length()
    unit = 1 << (BITS + 2 * halvings)
    small = [[int(value * unit / 2**halvings) for value in row] for row in matrix]
    term = [[unit if i == j else 0 for j in range(len(matrix))] for i in range(len(matrix))]
    total = [row[:] for row in term]
    for k in range(1, 60):
        term = [[value // k for value in row] for row in _fixed_product(term, small, unit)]
        total = [[a + b for a, b in zip(x, y, strict=True)] for x, y in zip(total, term, strict=True)]
    for _ in range(halvings):
        total = _fixed_product(total, total, unit)
        if max(abs(value) for row in total for value in row) > unit << LARGEST_RESULT:
            raise ValueError("the exponential is too large")
    return tuple(tuple(Fraction(value, unit) for value in row) for row in total)


def integers(matrix: Rational) -> tuple[list[list[int]], int]:
    """Return the entries as integers over a common denominator, and that denominator."""
    below = lcm(*(value.denominator for row in matrix for value in row))
    return [[value.numerator * (below // value.denominator) for value in row] for row in matrix], below


def _fixed_product(first: list[list[int]], second: list[list[int]], unit: int) -> list[list[int]]:
    columns = list(zip(*second, strict=True))
    return [[sum(a * b for a, b in zip(row, column, strict=True)) // unit for column in columns] for row in first]


def _rounded(value: Fraction, *, up: bool) -> Fraction:
    grid = value.numerator * 2**BITS
    return Fraction(-(-grid // value.denominator) if up else grid // value.denominator, 2**BITS)


__all__ = [
    "Rational",
    "combined",
    "diagonal",
    "exponential_below",
    "integers",
    "is_positive_semidefinite",
    "matrix_exponential",
    "product",
    "rational",
    "scaled",
    "transposed",
]
