"""Many rows at once in ball arithmetic: integers in units of 2^-192, and one proved bound of the error of all entries.

In: rational matrices, enclosures of e^{F t}.  Out: products, quadratic forms and sums of absolute values whose true
value is never missed.  The idea: an array of Python integers carries the middles, an integer the radius; a product
floors each entry, which costs one unit, and errors go by the largest entries.  O(rows · n²) operations on integers of
a few hundred bits, some 0.1 µs each.

Source: fixed-point ball arithmetic is classical; this is as much as checks of bounds need.
"""

from fractions import Fraction
from math import isqrt
from typing import NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.exact import Rational

BITS = 192
UNIT = 1 << BITS

IntegerArray: TypeAlias = NDArray[np.object_]
"""Python integers in units of 2^-192."""


class Ball(NamedTuple):
    """Every entry of the true matrix is within `radius` units of that of `middle` (rows, columns)."""

    middle: IntegerArray
    radius: int

    def floats(self) -> FloatArray:
        """Return the middles as doubles, for proposals only."""
        return np.asarray(self.middle / UNIT, dtype=np.float64)


def ball(matrix: Rational, radius: Fraction = Fraction()) -> Ball:
    """Return the ball around a rational matrix whose entries are off by at most `radius`.

    >>> ball(((Fraction(1, 2),),)).floats().tolist()
    [[0.5]]
    """
    rows = np.array([[round(value * UNIT) for value in row] for row in matrix], dtype=object)
    return Ball(rows.reshape(len(matrix), -1), upwards(radius) + 1)


def upwards(value: Fraction) -> int:
    """Return the least number of units that is not below a rational number."""
    return -(-value.numerator * UNIT // value.denominator)


def times(first: Ball, second: Ball) -> Ball:
    """Return the matrix product of two balls.

    >>> half = ball(((Fraction(1, 2),),))
    >>> times(half, half).floats().tolist(), times(half, half).radius < 10
    ([[0.25]], True)
    """
    inner = first.middle.shape[1]
    spread = largest(first) * second.radius + largest(second) * first.radius + first.radius * second.radius
    return Ball(first.middle.dot(second.middle) >> BITS, (inner * spread >> BITS) + 2)


def largest(found: Ball) -> int:
    """Return the largest middle, in units."""
    return int(np.abs(found.middle).max(initial=0))


def absolute_sums(found: Ball, weights: IntegerArray) -> IntegerArray:
    """Return upper bounds (rows,) of |row| weights, for weights (columns,) >= 0 in units.

    >>> [int(value) >> BITS for value in absolute_sums(ball(((Fraction(-2), Fraction(3)),)), np.array([UNIT, UNIT]))]
    [5]
    """
    return np.asarray(((np.abs(found.middle) + found.radius).dot(weights) >> BITS) + 1)


def form_roots(rows: Ball, form: Ball) -> IntegerArray:
    """Return upper bounds (rows,) of sqrt(r W rᵀ) for the rows r, W positive semidefinite.

    >>> one = ((Fraction(4),),)
    >>> [round(int(value) / UNIT, 6) for value in form_roots(ball(((Fraction(3),),)), ball(one))]
    [6.0]
    """
    image, n = times(rows, form), rows.middle.shape[1]
    spread = largest(rows) * image.radius + largest(image) * rows.radius + rows.radius * image.radius
    squares = ((image.middle * rows.middle).sum(axis=1) >> BITS) + (n * spread >> BITS) + 2
    return np.array([isqrt(max(int(value), 0) << BITS) + 1 for value in squares], dtype=object)


__all__ = ["BITS", "UNIT", "Ball", "IntegerArray", "absolute_sums", "ball", "form_roots", "largest", "times", "upwards"]
