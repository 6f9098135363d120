"""Arithmetic of the filters' reference step: exponential, logarithm, symmetric matrices, elimination, all flat.

In: numbers of type `float` or `numpy.float32`, and flat arrays of them.  Out: numbers, or arrays that were changed in
place.  Every sum runs from left to right, and nothing is used but + - * / and comparisons, so that C does the same
operations in the same order and is equal bit for bit; therefore `exp` and `log` are made here.  This file is part of
generated Python, word for word.

O(p³ + p² n) operations for an elimination.  Source: series of exp and atanh; Golub and Van Loan (2013), section 4.1.
"""

from typing import Any

from deshybrid.stochastic.stepwise_values import Numbers

LOG2_E, LN2_HIGH, LN2_LOW = 1.4426950408889634, 0.693359375, -2.1219444005469057e-4  # k LN2_HIGH is exact
ROOT_2, HALF_LOG_2PI = 1.4142135623730951, 0.9189385332046727
FACTORIALS = (6227020800, 479001600, 39916800, 3628800, 362880, 40320, 5040, 720, 120, 24, 6, 2, 1, 1)
EXP = tuple(1.0 / factorial for factorial in FACTORIALS)
LOG = tuple(1.0 / odd for odd in (21, 19, 17, 15, 13, 11, 9, 7, 5, 3, 1))


def exp(powers: Numbers, least: Any, x: Any) -> Any:
    """Return e^x for x <= 0: a polynomial of the remainder of x / log 2, and as many halvings as its quotient.

    `powers` are 2, 2², 2⁴, ...; 0 for x below `least`.  The relative error is below 1e-15 in double precision.
    """
    if not x > least:
        return 0.0
    halvings = int(0.5 - x * LOG2_E)
    k = 0.0 * x + halvings  # a number of the type of x
    r = (x + k * LN2_HIGH) + k * LN2_LOW
    y = EXP[0]
    for i in range(1, len(EXP)):
        y = y * r + EXP[i]
    for i in range(len(powers)):
        if (halvings >> i) & 1:
            y = y / powers[i]
    return y


def log(powers: Numbers, x: Any) -> Any:
    """Return the logarithm of x > 0: doublings or halvings until x is near 1, then 2 atanh((x - 1) / (x + 1))."""
    doublings = 0
    for i in range(len(powers) - 1, -1, -1):
        if x >= powers[i]:
            x = x / powers[i]
            doublings = doublings + (1 << i)
        elif x * powers[i] <= 1.0:
            x = x * powers[i]
            doublings = doublings - (1 << i)
    if x > ROOT_2:
        x = x / 2.0
        doublings = doublings + 1
    elif x * ROOT_2 < 1.0:
        x = x * 2.0
        doublings = doublings - 1
    s = (x - 1.0) / (x + 1.0)
    t = s * s
    y = LOG[0]
    for i in range(1, len(LOG)):
        y = y * t + LOG[i]
    k = 0.0 * x + doublings
    return k * LN2_HIGH + (k * LN2_LOW + 2.0 * s * y)


def mirror(n: int, P: Numbers, square: int) -> None:
    """Copy the lower half of a matrix to its upper half."""
    for a in range(n):
        for b in range(a):
            P[square + b * n + a] = P[square + a * n + b]


def eliminate(p: int, n: int, L: Numbers, e: Numbers, W: Numbers) -> bool:
    """Turn the lower half of S in `L` into L D Lᵀ, D on the diagonal, `e` (p) into L⁻¹ e, `W` (p, n) into L⁻¹ W.

    Returns whether S is positive definite; where it is not, nothing is of use.
    """
    for i in range(p):
        for j in range(i):
            total = L[i * p + j]
            for k in range(j):
                total = total - L[i * p + k] * L[k * p + k] * L[j * p + k]
            L[i * p + j] = total / L[j * p + j]
        for k in range(i):
            L[i * p + i] = L[i * p + i] - L[i * p + k] * L[k * p + k] * L[i * p + k]
            e[i] = e[i] - L[i * p + k] * e[k]
            for b in range(n):
                W[i * n + b] = W[i * n + b] - L[i * p + k] * W[k * n + b]
        if not L[i * p + i] > 0.0:
            return False
    return True


def is_within(largest: Any, numbers: Numbers, length: int) -> bool:
    """Whether all numbers are finite and not beyond `largest`."""
    return all(-largest <= numbers[i] and numbers[i] <= largest for i in range(length))


__all__ = ["EXP", "HALF_LOG_2PI", "LN2_HIGH", "LN2_LOW", "LOG", "LOG2_E", "ROOT_2"]
__all__ += ["eliminate", "exp", "is_within", "log", "mirror"]
