"""The inequalities of a certificate by forms, decided in exact arithmetic.

In: the matrices of one location or one reset and forms as rational matrices.  Out: whether an inequality was proved.
With ζ^[d] the monomials of degree d, a form is V(ζ) = ζ^[d]ᵀ P ζ^[d]; the error contracts at rate μ over every stay of
at least T where, for forms P_i > 0 at the entry and Q_i > 0 at the end of a stay,

    flow   Q_i decreases by e^{-2 d μ t} along the location's own dynamics,
    stay   e^{2 d μ T} Q_i(e^{F_i T} ζ) < P_i(ζ),
    jump   P_j(R¹_ij ζ) < Q_i(ζ) for every reset to j;
    span   where Q depends on how long the stay lasts, linearly in time: it decreases along the flow all the same:

then e^{2 d μ t} V decreases from entry to entry, and between them it stays below a multiple of its last value.
Strict inequalities, so that the doubles of a certificate need no tolerance.  e^{F T} and M^k are enclosed.

Source: multiple Lyapunov functions with dwell time, Geromel and Colaneri (2006); forms of higher degree, Parrilo and
Jadbabaie (2008).
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.exact import (
    Rational,
    combined,
    diagonal,
    exponential_below,
    product,
    rational,
    scaled,
    transposed,
)
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_flow import flow_enclosure, power_enclosure
from deshybrid.linear.lifting import lifted, lifted_generator

ROUNDED = Fraction(1, 2**320)
"""Products along a cycle are rounded to multiples of this."""


class Motion(NamedTuple):
    """How the error moves in one location: `matrix` is F in 1/s, or M for one `step` (s)."""

    matrix: Rational
    step: Fraction | None

    def over(self, stay: Fraction) -> tuple[Rational, Fraction]:
        """Return a rational matrix for this stay (s), and how far its entries may be from the true ones.

        In sampled time a stay is a whole number of steps.  Raises ValueError where it is out of proportion.
        """
        if self.step is None:
            return flow_enclosure(self.matrix, stay)
        return power_enclosure(self.matrix, round(stay / self.step))


class Leg(NamedTuple):
    """A part of a switching cycle: the error moves for `stay` seconds, then jumps by `reset`."""

    motion: Motion
    stay: Fraction
    reset: Rational


def flow_decreases(motion: Motion, Q: Rational, degree: int, rate: Fraction) -> bool:
    """Return whether the flow inequality was proved: FᵀQ + Q F + 2 d μ Q < 0, or MᵀQ M < e^{-2 d μ h} Q.

    >>> one = ((Fraction(1),),)
    >>> slow = Motion(((Fraction(-1),),), None)
    >>> flow_decreases(slow, one, 1, Fraction(1, 2)), flow_decreases(slow, one, 1, Fraction(1))
    (True, False)
    """
    exponent = 2 * degree * rate
    if motion.step is None:
        drift = product(Q, lifted_generator(motion.matrix, degree))
        growth = combined(combined(drift, transposed(drift)), Q, exponent)
        return is_positive_definite(scaled(growth, -1))
    image = _image(lifted(motion.matrix, degree), Q)
    return is_positive_definite(combined(scaled(Q, exponential_below(-exponent * motion.step)), image, -1))


def stay_decreases(motion: Motion, stay: Fraction, P: Rational, Q: Rational, *, degree: int, rate: Fraction) -> bool:
    """Return whether the stay inequality was proved: e^{2 d μ T} E^[d]ᵀ Q E^[d] < P for E = e^{F T} or M^k.

    >>> slow, one = Motion(((Fraction(-1),),), None), ((Fraction(1),),)
    >>> entries = [((Fraction(1, k),),) for k in (7, 8)]  # e^-2 lies between them
    >>> [stay_decreases(slow, Fraction(1), P, one, degree=1, rate=Fraction(0)) for P in entries]
    [True, False]
    """
    shrinking = exponential_below(-2 * degree * rate * stay)
    try:
        flow, radius = motion.over(stay)
    except ValueError:
        return False
    lift = lifted(flow, degree)
    bound = _changed(flow, radius, degree)
    slack = diagonal([_slack(lift, bound, Q)] * len(Q))
    return is_positive_definite(combined(scaled(P, shrinking), combined(_image(lift, Q), slack), -1))


def span_decreases(
    motion: Motion, width: Fraction, first: Rational, last: Rational, *, degree: int, rate: Fraction
) -> bool:
    """Return whether forms linear in time from `first` to `last` over `width` seconds were proved to decrease.

    That is Q' + FᵀQ + Q F + 2 d μ Q < 0, or MᵀQ(k+1) M < e^{-2 d μ h} Q(k) for each of the steps, in the lifted states.
    Both are linear in time, so that the two ends of the span decide.  A span of no width has nothing to prove.

    >>> slow, one, third = Motion(((Fraction(-1),),), None), ((Fraction(1),),), ((Fraction(1, 3),),)
    >>> [span_decreases(slow, Fraction(1), one, third, degree=1, rate=Fraction(r)) for r in (0, 2)]
    [True, False]
    """
    exponent = 2 * degree * rate
    if motion.step is None:
        if width <= 0:
            return width == 0
        slope = scaled(combined(last, first, -1), 1 / width)
        generator = lifted_generator(motion.matrix, degree)
        changes = []
        for form in (first, last):
            drift = combined(product(form, generator), slope, Fraction(1, 2))
            changes.append(combined(combined(drift, transposed(drift)), form, exponent))
        return all(is_positive_definite(scaled(change, -1)) for change in changes)
    steps = round(width / motion.step)
    if steps <= 0:
        return steps == 0
    lift, shrinking = lifted(motion.matrix, degree), exponential_below(-exponent * motion.step)
    change = scaled(combined(last, first, -1), Fraction(1, steps))
    after, before = combined(first, change), combined(last, change, -1)
    pairs = ((first, after), (before, last))
    return all(is_positive_definite(combined(scaled(a, shrinking), _image(lift, b), -1)) for a, b in pairs)


def jump_decreases(reset: Rational, P: Rational, Q: Rational, degree: int) -> bool:
    """Return whether the jump inequality was proved: R^[d]ᵀ P R^[d] < Q.

    >>> one, two = ((Fraction(1),),), ((Fraction(2),),)
    >>> jump_decreases(one, one, two, 1), jump_decreases(one, one, one, 1)
    (True, False)
    """
    return is_positive_definite(combined(Q, _image(lifted(reset, degree), P), -1))


def does_not_contract(cycle: Sequence[Leg], rate: Fraction) -> bool:
    """Return whether W, the product of e^{μ t} R e^{F t} over a cycle, provably has a spectral radius above 1.

    Proved where some S has WᵀS W > S, and xᵀS x > 0 for some x: the S-form of W^k x then grows for ever.
    Floating point proposes S, the solution of WᵀS W - S = I, and x.

    >>> leg = Leg(Motion(((Fraction(-1),),), None), Fraction(1), ((Fraction(3),),))
    >>> does_not_contract([leg], Fraction(0)), does_not_contract([leg], Fraction(-1))  # 3/e, 3/e²
    (True, False)
    """
    try:
        whole, radius = _round_trip(cycle)
    except ValueError:
        return False
    growth = exponential_below(rate * sum((leg.stay for leg in cycle), Fraction()))
    whole = scaled(whole, growth)
    found = _growing_form(np.array([[float(value) for value in row] for row in whole]))
    if found is None:
        return False
    S, x = rational(found[0].tolist()), rational(found[1].tolist())
    slack = diagonal([_slack(whole, radius * growth, S)] * len(S))
    grows = is_positive_definite(combined(combined(_image(whole, S), slack, -1), S, -1))
    return grows and _image(x, S)[0][0] > 0


def _image(matrix: Rational, form: Rational) -> Rational:
    """The form after the map: Mᵀ P M."""
    return product(transposed(matrix), product(form, matrix))


def _changed(matrix: Rational, radius: Fraction, degree: int) -> Fraction:
    """How far an entry of the lifted matrix may move when the entries move by `radius`.

    It is a sum of at most n^d products of d entries, none larger than m: each moves by at most (m + r)^d - m^d.
    """
    if degree == 1:
        return radius
    largest = max(abs(value) for row in matrix for value in row)
    choices: int = len(matrix) ** degree
    return choices * ((largest + radius) ** degree - largest**degree)


def _slack(matrix: Rational, radius: Fraction, form: Rational) -> Fraction:
    """Bound ‖(M + Δ)ᵀ P (M + Δ) - Mᵀ P M‖₂ for all Δ with entries up to `radius`; ‖X‖₂ <= n max |X_ij|."""
    size = len(form)
    largest, weight = (max(abs(value) for row in rows for value in row) for rows in (matrix, form))
    return size**3 * weight * radius * (2 * largest + radius)


def _round_trip(cycle: Sequence[Leg]) -> tuple[Rational, Fraction]:
    """The product of R e^{F t} over the cycle, and how far its entries may be from the true ones."""
    n = len(cycle[0].reset)
    whole, radius = diagonal([1] * n), Fraction()
    for leg in cycle:
        flow, error = leg.motion.over(leg.stay)
        for factor, wide in ((flow, error), (leg.reset, Fraction())):
            left, right = (max(abs(value) for row in rows for value in row) for rows in (factor, whole))
            radius = n * (wide * right + left * radius + wide * radius) + ROUNDED
            whole = _rounded(product(factor, whole))
    return whole, radius


def _rounded(matrix: Rational) -> Rational:
    return tuple(tuple(Fraction(round(value / ROUNDED)) * ROUNDED for value in row) for row in matrix)


def _growing_form(W: FloatArray) -> tuple[FloatArray, FloatArray] | None:
    """Propose S and a column x; None where floating point finds none."""
    from scipy.linalg import LinAlgError, solve_discrete_lyapunov

    if not np.isfinite(W).all():
        return None
    try:
        S = -solve_discrete_lyapunov(W.T, np.eye(len(W)), method="bilinear")
    except (LinAlgError, ValueError):
        return None
    S = (S + S.T) / 2
    if not np.isfinite(S).all():
        return None
    return S, np.linalg.eigh(S)[1][:, -1:]


__all__ = ["Leg", "Motion", "does_not_contract", "flow_decreases", "jump_decreases", "span_decreases", "stay_decreases"]
