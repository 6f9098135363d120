"""Whether a sampled error matrix is that of the gains it was made from, in exact arithmetic.

In: A (n, n), C (p, n), G (n, p) and M (n, n) as rational numbers, the step h.  Out: yes or no.  M is e^{A h} -
(integral of e^{F s} ds over [0, h]) G C with F = A - G C.  The idea: everything is compared in balanced units of the
states, where matrices have their natural size; there both parts are found to 40 digits.  O(n^3) operations on numbers
of a few hundred digits.
"""

from fractions import Fraction

import numpy as np

from deshybrid.linear.exact import Rational, combined, diagonal, matrix_exponential, product, scaled
from deshybrid.linear.subspaces import balanced_scale

SAME = Fraction(1, 10**6)
"""Matrices agree if they differ by no more than this share of the larger part of a row."""
NOTHING = Fraction(1, 10**12)
"""What a step adds below this share of the states' sizes is rounding; it changes no rate that anyone can measure."""


def is_sampled_form(M: Rational, A: Rational, C: Rational, gain: Rational, step: Fraction) -> bool:
    """Return whether M is the sampled form of A - G C at this step, to one part in 10⁶.

    A step that is out of proportion to the dynamics is a "no".

    >>> one, half = ((Fraction(1),),), ((Fraction(1, 2),),)
    >>> is_sampled_form(half, ((Fraction(),),), one, one, Fraction(1, 2))  # 1 - (1 - e^-0.5) is not 0.5
    False
    """
    scale = [Fraction(value) for value in _sizes(A, C)]
    units, inverse = diagonal(scale), diagonal([1 / value for value in scale])
    A, gain = product(product(inverse, A), units), product(inverse, gain)
    C = product(C, units) if C else C
    try:
        parts = _parts(A, C, gain, step)
    except ValueError:
        return False
    return is_difference(product(product(inverse, M), units), *parts)


def is_difference(M: Rational, first: Rational, second: Rational) -> bool:
    """Return whether M = first - second to one part in 10⁶ of the larger of the two in each row.

    >>> one = ((Fraction(1),),)
    >>> is_difference(((Fraction(0),),), one, one), is_difference(one, one, one)
    (True, False)
    """
    rows = zip(M, combined(first, second, -1), first, second, strict=True)
    return all(
        abs(a - b) <= max(SAME * max(abs(value) for value in (*x, *y)), NOTHING)
        for line, made, x, y in rows
        for a, b in zip(line, made, strict=True)
    )


def _sizes(A: Rational, C: Rational) -> list[float]:
    """The balanced sizes of the states (powers of two); exact arithmetic takes over from them."""
    n = len(A)
    dynamics, outputs = (np.array([[float(value) for value in row] for row in rows]) for rows in (A, C))
    found = [float(value) for value in balanced_scale(dynamics, np.zeros((n, 0)), outputs.reshape(len(C), n))]
    return found if all(0 < value < np.inf for value in found) else [1.0] * n


def _parts(A: Rational, C: Rational, gain: Rational, step: Fraction) -> tuple[Rational, Rational]:
    """e^{A h} and (integral of e^{F s} ds over [0, h]) G C; ValueError where the step is out of proportion."""
    flow = matrix_exponential(scaled(A, step))
    if not C:
        return flow, scaled(A, 0)
    n, p = len(A), len(C)
    # The integral is linear in each column of the gain; columns no longer than 1 keep the exponent small.
    sizes = [max(Fraction(1), *(abs(row[k]) for row in gain)) for k in range(p)]
    small = product(gain, diagonal([1 / size for size in sizes]))
    error = combined(A, product(gain, C), -1)
    block = tuple((*row, *push) for row, push in zip(error, small, strict=True))
    block += tuple((Fraction(),) * (n + p) for _ in range(p))
    pushed = matrix_exponential(scaled(block, step))
    return flow, product(product(tuple(row[n:] for row in pushed[:n]), diagonal(sizes)), C)


__all__ = ["NOTHING", "SAME", "is_difference", "is_sampled_form"]
