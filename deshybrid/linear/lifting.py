"""Lifting: a linear map on states as a linear map on their monomials of degree d.

In: a square matrix of any numbers (doubles or fractions).  Out: the matrix of x^β ↦ (A x)^β in the monomials of degree
d, and the generator of x' = F x in them.  The idea: a form of degree 2d in x is a quadratic form in the monomials, and
lifting respects products and flows, (A B)^[d] = A^[d] B^[d], e^{F t}^[d] = e^{F^[d] t}.  There are C(n+d-1, d)
monomials, in lexicographic order; O(n^d) products for each.

Source: symmetric Kronecker powers, Parrilo and Jadbabaie (2008), "Approximation of the joint spectral radius using
sum of squares".
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from fractions import Fraction
from itertools import combinations_with_replacement
from math import comb, factorial, prod, sqrt
from typing import TypeVar

import numpy as np

from deshybrid.linear.arrays import FloatArray

Number = TypeVar("Number", float, Fraction)
Monomial = tuple[int, ...]
"""The indices of the factors, ascending: (0, 0, 2) is x0² x2."""


def monomials(states: int, degree: int) -> tuple[Monomial, ...]:
    """Return the monomials of one degree in their order.

    >>> monomials(2, 2)
    ((0, 0), (0, 1), (1, 1))
    """
    return tuple(combinations_with_replacement(range(states), degree))


def lifted_size(states: int, degree: int) -> int:
    """Return how many monomials there are."""
    return comb(states + degree - 1, degree)


def lifted(matrix: Sequence[Sequence[Number]], degree: int) -> tuple[tuple[Number, ...], ...]:
    """Return A^[d]: row β holds the coefficients of (A x)^β.

    >>> lifted([[1, 2], [0, 3]], 2)  # (x + 2y)², (x + 2y) 3y, (3y)²
    ((1, 4, 4), (0, 3, 6), (0, 0, 9))
    """
    rows: dict[Monomial, Mapping[Monomial, Number]] = {}
    for size in range(1, degree + 1):
        for monomial in monomials(len(matrix), size):
            last: dict[Monomial, Number] = {(j,): value for j, value in enumerate(matrix[monomial[-1]])}
            rows[monomial] = _times(rows[monomial[:-1]], last) if size > 1 else last
    order = monomials(len(matrix), degree)
    return tuple(tuple(rows[row][column] for column in order) for row in order)


def lifted_generator(matrix: Sequence[Sequence[Number]], degree: int) -> tuple[tuple[Number, ...], ...]:
    """Return F^[d]: row β holds the coefficients of the derivative of x^β along x' = F x.

    >>> lifted_generator([[1, 2], [0, 3]], 2)  # 2 x (x + 2y), (x + 2y) y + x 3y, 2 y 3y
    ((2, 4, 0), (0, 4, 2), (0, 0, 6))
    """
    order = monomials(len(matrix), degree)
    zero = matrix[0][0] * 0
    rows: list[tuple[Number, ...]] = []
    for row in order:
        found: dict[Monomial, Number] = dict.fromkeys(order, zero)
        for place in range(degree):
            rest: Monomial = row[:place] + row[place + 1 :]
            for j, value in enumerate(matrix[row[place]]):
                target = tuple(sorted((*rest, j)))
                found[target] = found[target] + value
        rows.append(tuple(found[column] for column in order))
    return tuple(rows)


def lifting_weights(states: int, degree: int) -> FloatArray:
    """Return the square roots of the multinomial coefficients: in w_β x^β the length of the lifted x is ‖x‖^d.

    >>> lifting_weights(2, 2).round(3).tolist()
    [1.0, 1.414, 1.0]
    """
    return np.array(
        [
            sqrt(factorial(degree) / prod(factorial(count) for count in Counter(monomial).values()))
            for monomial in monomials(states, degree)
        ]
    )


def _times(first: Mapping[Monomial, Number], second: Mapping[Monomial, Number]) -> Mapping[Monomial, Number]:
    found: dict[Monomial, Number] = {}
    for left, a in first.items():
        for right, b in second.items():
            key = tuple(sorted(left + right))
            value = a * b
            found[key] = found[key] + value if key in found else value
    return found


__all__ = ["Monomial", "lifted", "lifted_generator", "lifted_size", "lifting_weights", "monomials"]
