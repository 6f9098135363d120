"""How far along given rows the error of one location can get during a stay: upper bounds in ball arithmetic.

In: F (or M of a step), the drive N of signals between -1 and 1, a set {|d ζ| <= h} of entry errors.  Out: whether

    φ(t) = s(r e^{F t}) + ∫_0^t ‖r e^{F s} N‖₁ ds <= level   for a row r, all t >= start, s the set's support function.

The idea: s(r) <= |λ| h for r = λ D, by multipliers λ of n directions that floating point proposes; what these leave of
r counts over the box of the states.  e^{F t} is enclosed at times between which r e^{F t} ζ leaves its chord by w²/8 of
its second derivative at most.  How that changes, and all that comes later, is bounded by norms ‖r‖_W = (r W rᵀ)^½
of rows, one for the set and one for the drive, with

    F W + W Fᵀ < -2 λ W   and   |r ζ| <= ‖r‖_W for ζ in the set,   or   ‖r N‖₁ <= ‖r‖_W,

which decay by themselves.  Floating point proposes W, exact elimination decides.  In discrete time nothing lies between
two steps.  O(times · rows · n²).

Source: this project; support functions by linear programming duality, the disturbance by the L¹ norm.
"""

from collections.abc import Iterator, Sequence
from fractions import Fraction
from functools import cached_property
from math import frexp, ldexp
from typing import NamedTuple

import numpy as np

from deshybrid.linear.arrays import ComplexArray, FloatArray
from deshybrid.linear.exact import (
    Rational,
    combined,
    diagonal,
    is_positive_semidefinite,
    product,
    rational,
    scaled,
    transposed,
)
from deshybrid.linear.exact_balls import (
    BITS,
    UNIT,
    Ball,
    IntegerArray,
    absolute_sums,
    ball,
    form_roots,
    times,
    upwards,
)
from deshybrid.linear.exact_inequalities import Motion, flow_decreases

TURN = 0.08
"""A cell is so short that the modes that are not gone turn by this (rad) on average."""
FINER = 0.02
"""The same for a second try: modes that nearly agree leave large bounds of curvature."""
GONE = 14.0
"""So many time constants of the slowest mode are looked at; what comes later is bounded by the norm."""
AFRESH = 16
MOST_TIMES = 20_000
PLACES = 120
"""Multipliers are rounded to this many binary places."""
SMALL = Fraction(1, 10**6)
"""A drive need not reach all directions; this share of the box in the square makes its form one with an inside."""
SPARE = 2.0**-30
"""Proposals are made larger, or smaller, by this share: rounding then does no harm."""


class EntrySet(NamedTuple):
    """{|d ζ| <= level}: directions (m, n), levels (m,), numbers of n directions each."""

    directions: Rational
    levels: tuple[Fraction, ...]
    bases: tuple[tuple[int, ...], ...]


class _Norm(NamedTuple):
    """W as a ball, and F³ W F³ᵀ."""

    form: Ball
    third: Ball


class _Seen(NamedTuple):
    """At one time, by row: s and ‖r N‖₁; second derivatives of r ζ and r N there, bounds of the third ones later."""

    support: IntegerArray
    force: IntegerArray
    second: tuple[IntegerArray, IntegerArray]
    third: tuple[IntegerArray, IntegerArray]

    def curved(self, which: int, width: Fraction) -> IntegerArray:
        """Return the most that a second derivative is over a cell of this width (s)."""
        return np.asarray(self.second[which] + self.third[which] * upwards(width) // UNIT + 1)


class StayBound:
    """One location.  The set has the states as its first directions, positive levels.  `turn`: TURN or less."""

    def __init__(self, motion: Motion, drive: Rational, entered: EntrySet, turn: float = TURN) -> None:
        self.motion, self.drive, self.entered, self.turn = motion, drive, entered, turn
        n = len(motion.matrix)
        self.box = entered.levels[:n]
        self.levels = np.array([upwards(level) for level in entered.levels], dtype=object)
        self.directions, self._pushes = ball(entered.directions), ball(drive)
        self._square = ball(product(motion.matrix, motion.matrix))
        self.bases = np.array(entered.bases)
        frames = np.array([[float(value) for value in row] for row in entered.directions])[self.bases]
        regular = np.linalg.cond(frames) < 1e14
        self.bases, self.inverses = self.bases[regular], np.linalg.inv(frames[regular])

    def decays(self) -> bool:
        """Return whether both norms were proved."""
        return self.norms is not None

    def finer(self) -> "StayBound":
        """Return the same with finer cells."""
        return StayBound(self.motion, self.drive, self.entered, FINER)

    def work(self, rows: int, start: Fraction) -> int:
        """Return how many products `stays_below` takes for so many rows."""
        n, step = len(self.box), self.motion.step
        if step is not None and start > MOST_TIMES * step:
            return MOST_TIMES**3
        return len(self._times(start)) * rows * n * (3 * n + len(self.drive[0]))

    def stays_below(
        self, rows: Rational, levels: Sequence[Fraction], starts: Sequence[Fraction], turn: Fraction
    ) -> list[bool]:
        """Return for each row whether φ(t) <= level was proved for all t >= start, each start being 0 or `turn`."""
        if self.norms is None:
            return [False] * len(rows)
        step, first = self.motion.step, ball(rows)
        begin = np.array([t if step is None else step * round(t / step) for t in starts], dtype=object)
        worst = pushed = np.array([0] * len(rows), dtype=object)
        moved, before, last = first, self._seen(first), Fraction()
        for time, flow in self._flows(self._times(turn)):
            moved = times(first, flow)
            now = self._seen(moved)
            pushed = pushed + self._pushed(time - last, before, now)
            between = np.maximum(before.support, now.support) + pushed + self._bent(time - last, before)
            worst = np.where(begin <= last, np.maximum(worst, between), worst)
            worst = np.where(begin <= time, np.maximum(worst, now.support + pushed), worst)
            before, last = now, time
        entered, driven = (form_roots(moved, norm.form) for norm in self.norms)
        worst = np.maximum(worst, entered + pushed + driven * upwards(self._length()) // UNIT + 1)
        return [int(value) <= level * UNIT for value, level in zip(worst, levels, strict=True)]

    def _seen(self, rows: Ball) -> _Seen:
        ones = np.array([UNIT] * len(self.drive[0]), dtype=object)
        force = absolute_sums(times(rows, self._pushes), ones)
        if self.motion.step is not None or self.norms is None:
            return _Seen(self._support(rows), force, (force * 0, force * 0), (force * 0, force * 0))
        bent = times(rows, self._square)
        second = absolute_sums(bent, self.levels[: len(self.box)]), absolute_sums(times(bent, self._pushes), ones)
        entered, driven = self.norms
        return _Seen(
            self._support(rows), force, second, (form_roots(rows, entered.third), form_roots(rows, driven.third))
        )

    def _pushed(self, width: Fraction, before: _Seen, now: _Seen) -> IntegerArray:
        """What the drive adds over a cell: the mean of its ends, and w³/12 of the second derivative; or one step's."""
        if self.motion.step is not None:
            return np.asarray(before.force if width else before.force * 0)
        mean = (before.force + now.force) * upwards(width / 2) // UNIT
        return np.asarray(mean + before.curved(1, width) * upwards(width**3 / 12) // UNIT + 2)

    def _bent(self, width: Fraction, before: _Seen) -> IntegerArray:
        if self.motion.step is not None:
            return np.asarray(before.force * 0)
        return np.asarray(before.curved(0, width) * upwards(width**2 / 8) // UNIT + 1)

    def _length(self) -> Fraction:
        """∫ e^{-λ t} dt over t >= 0; in discrete time the sum of e^{-λ h k} is at most 1 + 1/(λ h)."""
        return 1 / self._rate if self.motion.step is None else 1 + 1 / (self._rate * self.motion.step)

    def _support(self, rows: Ball) -> IntegerArray:
        """Upper bounds of s along rows."""
        guess = rows.floats()
        k, n = self.bases.shape
        parts = np.abs(guess @ np.moveaxis(self.inverses, 0, 1).reshape(n, k * n)).reshape(-1, k, n)
        sizes = np.asarray(self.levels[self.bases] / UNIT, dtype=np.float64)
        best = np.argmin((parts * sizes).sum(axis=2), axis=1)
        multipliers = _exactly((guess[:, None, :] @ self.inverses[best])[:, 0, :])
        basis = self.bases[best]
        used = (multipliers[:, :, None] * self.directions.middle[basis]).sum(axis=1) >> BITS
        spread = int(np.abs(multipliers).sum(axis=1).max()) * self.directions.radius >> BITS
        left = Ball(rows.middle - used, rows.radius + spread + 2)
        along = ((np.abs(multipliers) * self.levels[basis]).sum(axis=1) >> BITS) + 1
        return np.asarray(along + absolute_sums(left, self.levels[: len(self.box)]))

    @cached_property
    def norms(self) -> tuple[_Norm, _Norm] | None:
        """Those of the set and of the drive, proved; None where floating point proposes none that is one."""
        if self._slowest <= 0:
            return None
        n, columns = len(self.box), len(self.drive[0])
        box = diagonal([n * level * level for level in self.box])
        pushes = scaled(product(self.drive, transposed(self.drive)), columns) if columns else scaled(box, 0)
        entered, driven = self._norm(box), self._norm(combined(pushes, box, SMALL * self._rate**2))
        return None if entered is None or driven is None else (entered, driven)

    def _norm(self, around: Rational) -> _Norm | None:
        """W above a form that is positive definite."""
        W, turned = self._proposed(around), transposed(self.motion.matrix)
        if W is None or not is_positive_semidefinite(combined(W, around, -1)):
            return None
        if not flow_decreases(Motion(turned, self.motion.step), W, 1, self._rate):
            return None
        third = product(self.motion.matrix, product(self.motion.matrix, self.motion.matrix))
        return _Norm(ball(W), ball(product(product(third, W), transposed(third))))

    def _proposed(self, around: Rational) -> Rational | None:
        """The solution of a Lyapunov equation, as large as it has to be."""
        from scipy.linalg import LinAlgError, eigvalsh, solve_continuous_lyapunov, solve_discrete_lyapunov

        form, F, rate = _floats(around), _floats(self.motion.matrix), float(self._rate) * (1 + SPARE)
        scale = np.sqrt(np.diag(form))
        form, F = form / scale / scale[:, None], F * scale / scale[:, None]
        try:
            if self.motion.step is None:
                W = solve_continuous_lyapunov(F + rate * np.eye(len(F)), -rate * form)
            else:
                W = solve_discrete_lyapunov(F * np.exp(rate * float(self.motion.step)), form)
            W = (W + W.T) / 2 * float(eigvalsh(form, (W + W.T) / 2).max()) * (1 + SPARE)
        except (LinAlgError, ValueError):
            return None
        whole = scale[:, None] * W * scale
        return rational(whole.tolist()) if np.isfinite(whole).all() else None

    @cached_property
    def _slowest(self) -> float:
        """The rate of the slowest mode (1/s), a proposal."""
        return -float(self._exponents().real.max())

    @property
    def _rate(self) -> Fraction:
        """λ (1/s): half of what is lost by the slowest mode; the norms have to show it."""
        return Fraction(self._slowest) / 2

    def _flows(self, moments: Sequence[Fraction]) -> Iterator[tuple[Fraction, Ball]]:
        """e^{F t} at each time; step by step from one that is enclosed anew every so often, as errors grow."""
        steps: dict[Fraction, Ball] = {}
        flow, last = ball(diagonal([1] * len(self.box))), Fraction()
        for number, time in enumerate(moments):
            width = time - last
            if width not in steps:
                steps[width] = ball(*self.motion.over(width))
            flow = times(flow, steps[width]) if number % AFRESH else ball(*self.motion.over(time))
            yield time, flow
            last = time

    def _exponents(self) -> ComplexArray:
        """The modes in 1/s."""
        values = np.asarray(np.linalg.eigvals(_floats(self.motion.matrix)), dtype=np.complex128)
        if self.motion.step is None:
            return values
        # A mode that is gone within a step needs no finer number.
        size = np.maximum(np.abs(values), 1e-3)
        return np.asarray(np.log(size + 0j) / float(self.motion.step), dtype=np.complex128)

    def _times(self, start: Fraction) -> list[Fraction]:
        """From 0 on, `start` among them, until the slowest mode is gone."""
        values, step = self._exponents(), self.motion.step
        end = float(start) + GONE / self._slowest
        if step is not None:
            return [step * k for k in range(max(round(start / step), min(int(end / float(step)), MOST_TIMES)) + 1)]
        found, time = [Fraction()], 0.0
        while time < end and len(found) < MOST_TIMES:
            weights = np.exp((values.real + self._slowest) * time)
            time += _short(self.turn / float(np.sqrt((weights * np.abs(values) ** 2).sum() / weights.sum())))
            found.append(Fraction(time))
        return sorted({*found, start})


def _floats(matrix: Rational) -> FloatArray:
    return np.array([[float(value) for value in row] for row in matrix], dtype=np.float64)


def _short(width: float) -> float:
    """A little less, with three binary digits: few widths occur, and times add up exactly."""
    part, power = frexp(width)
    return ldexp(int(part * 8), power - 3)


def _exactly(values: FloatArray) -> IntegerArray:
    """Doubles in units, rounded; of any that is not finite, zero."""
    finite = np.where(np.isfinite(values), values, 0.0)
    flat = [int(value * 2.0**PLACES) << (BITS - PLACES) for value in finite.ravel().tolist()]
    return np.array(flat, dtype=object).reshape(values.shape)


__all__ = ["EntrySet", "StayBound"]
