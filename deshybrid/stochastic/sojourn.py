"""How long a stay has to be for the error of switching steady-state filters to converge (Theorems 3 and 4.1).

In: the steady-state filters of all modes, the factor μ by which the mean error has to shrink a step, a delay of Δ steps
until a switch is known, the error M0 that may be left, bounds of the mean state and of the input.  Out: for both gains,
the least number of steps between switches, as printed and as it holds.

During a stay ‖Eᵏ‖ <= κ αᵏ; during the delay the wrong filter adds at most U a step, in every component.  So from one
detection to the next, L steps or more apart,

    ‖error‖ := κ α^L ‖error‖ + b,   b = √n U Δ κ,     hence   κ α^L <= μ^L   and   b / (1 - μ^L) <= M0
    L >= ln κ / ln(μ/α)   and   L >= ln(1 - b/M0) / ln μ,     and switches have to be L + Δ steps apart.

What is repaired: the second term printed, ln κ / |ln α|, only makes the error shrink at all; (25) of 2006 has the
first term with the other sign, so that it never counts; an argument of its logarithm below zero, which means that no
stay is long enough, loses its sign; the largest component of D x is bounded by row sums of D, not by column sums;
inputs and offsets that differ count in U; with the filter gain the mismatch is (F' - F) - K_f (H'F' - HF), not
(F' - F) - K_f (H' - H); x̄ is a mean that is not zero, else U is empty.  The bound holds at the instants of detection;
in between κ stands in front of it.

κ belongs to eigenvectors of unit length, and is infinite where eigenvalues repeat without enough of them.  So the stay
is bounded without eigenvectors, too: the least L with ‖Eᵏ‖ <= μᵏ for L <= k < 2 L, which proves it for all k >= L.

O(M² n³), and n³ for each power.  Source: Hwang, Balakrishnan and Tomlin (2003), Theorem 3; (2006), Theorem 4.1.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import ceil, exp, inf, isfinite, log, sqrt
from typing import Literal, TypeAlias

import numpy as np

from deshybrid.continuous.modes import modal_basis
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.steady_state import SteadyFilter
from deshybrid.stochastic.system import Mode

GainKind: TypeAlias = Literal["predictor", "filter"]
MOST_POWERS = 10_000
"""Powers of the error's matrix are looked at up to this one."""
PART_OF_A_STEP = 1e-9


@dataclass(frozen=True, slots=True)
class Demand:
    """What is asked: factor 0 < μ < 1 a step, delay Δ >= 0 steps, error_bound M0 >= 0.

    `state` (n,) bounds the mean of each state, `input` (m,) each input, over all time; None where no bound is known.
    Raises `UsageError` (DH1205) where a number is out of range.
    """

    factor: float = 0.99
    delay: int = 0
    error_bound: float = 0.0
    state: FloatArray | None = None
    input: FloatArray | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.factor < 1.0 or self.delay < 0 or not 0.0 <= self.error_bound < inf:
            text = (
                f"a factor of {self.factor:g}, a delay of {self.delay} and an error of {self.error_bound:g} do not fit"
            )
            helps = ("0 < factor < 1 a step, delay and error not negative",)
            raise UsageError(diagnostic("DH1205", text, helps=helps))
        for name, bound in (("state", self.state), ("input", self.input)):
            if bound is not None and not bool((bound >= 0.0).all()):
                raise UsageError(diagnostic("DH1205", f"a bound of the {name} is negative or no number"))


@dataclass(frozen=True, slots=True)
class ModeTerms:
    """One mode's terms, in steps; infinite where no stay is long enough.

    radius α and condition κ of E; mismatch U, 0 without delay; contraction: ln κ / ln(μ/α); settling:
    ln(1 - b/M0) / ln μ; direct: the least L of the powers of E, with what the delay then asks; `_printed`: U by column
    sums, ln κ / |ln α|, and the first term with that U.
    """

    mode: str
    radius: float
    condition: float
    mismatch: float
    contraction: float
    settling: float
    direct: float
    mismatch_printed: float
    contraction_printed: float
    settling_printed: float


@dataclass(frozen=True, slots=True)
class SojournBound:
    """The least steps between switches for one gain; None where no number of steps is enough."""

    gain: GainKind
    demand: Demand
    modes: tuple[ModeTerms, ...]

    @property
    def as_printed(self) -> int | None:
        """β_min + Δ with the terms of the paper; where it is met the error need not shrink by μ."""
        return self._steps([max(terms.contraction_printed, terms.settling_printed) for terms in self.modes])

    @property
    def by_condition(self) -> int | None:
        """The same with the terms that hold."""
        return self._steps([max(terms.contraction, terms.settling) for terms in self.modes])

    @property
    def by_powers(self) -> int | None:
        """The same without eigenvectors."""
        return self._steps([terms.direct for terms in self.modes])

    def _steps(self, needed: Sequence[float]) -> int | None:
        most = max(needed)
        return max(1, ceil(most - PART_OF_A_STEP) + self.demand.delay) if isfinite(most) else None


def sojourn_bound(filters: Sequence[SteadyFilter], gain: GainKind, demand: Demand | None = None) -> SojournBound:
    """Return what Theorem 3 (predictor gain) or Theorem 4.1 (filter gain) asks of the stays, in steps.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> from deshybrid.stochastic.steady_state import steady_state
    >>> filters = [steady_state(mode).filter for mode in calm_and_wild().modes]
    >>> sojourn_bound(filters, "predictor").by_condition  # one state: κ = 1, every step contracts
    1
    """
    demand = demand or Demand()
    return SojournBound(gain, demand, tuple(_terms(one, filters, gain, demand) for one in filters))


def _terms(own: SteadyFilter, filters: Sequence[SteadyFilter], gain: GainKind, demand: Demand) -> ModeTerms:
    E = own.predictor_error if gain == "predictor" else own.filter_error
    n = len(E)
    basis = modal_basis(E, np.ones(n), step=1.0, improve=False)
    alpha, kappa = exp(basis.alpha), basis.kappa
    others = [other.mode for other in filters if other is not own and demand.delay]
    U = max((_mismatch(own, other, gain, demand) for other in others), default=0.0)
    U_printed = max((_printed_mismatch(own, other, gain, demand) for other in others), default=0.0)
    steps, sizes = _powers(E, demand)
    return ModeTerms(
        mode=own.mode.name,
        radius=alpha,
        condition=kappa,
        mismatch=U,
        contraction=log(kappa) / log(demand.factor / alpha) if alpha < demand.factor else inf,
        settling=_settling(U, n, demand.delay * kappa, demand),
        direct=max(steps, _settling(U, n, float(sizes[: demand.delay].sum()), demand)),
        mismatch_printed=U_printed,
        contraction_printed=log(kappa) / -log(alpha) if alpha < demand.factor else inf,
        settling_printed=_settling(U_printed, n, demand.delay * kappa, demand),
    )


def _settling(U: float, n: int, growth: float, demand: Demand) -> float:
    """The steps after which b / (1 - μ^L) <= M0 with b = √n U growth; infinite where b >= M0."""
    if U == 0.0 or growth == 0.0:
        return 0.0
    added = sqrt(n) * U * growth
    left = 1.0 - added / demand.error_bound if demand.error_bound > 0.0 else -inf
    return log(left) / log(demand.factor) if left > 0.0 else inf


def _powers(E: FloatArray, demand: Demand) -> tuple[float, FloatArray]:
    """The least L with ‖Eᵏ‖ <= μᵏ for L <= k < 2 L (infinite beyond `MOST_POWERS`), and the norms ‖Eᵏ‖, k >= 0.

    Powers of E/μ are taken, whose norms have to be at most 1: those of E and of μ would vanish both in the end.
    """
    scaled, power, last_bad, k, sizes = E / demand.factor, np.eye(len(E)), 0, 0, [1.0]
    if float(np.abs(np.linalg.eigvals(scaled)).max(initial=0.0)) >= 1.0:
        return inf, np.array(sizes)
    while k < max(2 * last_bad + 1, demand.delay):
        k += 1
        power = power @ scaled
        size = float(np.linalg.norm(power, 2))
        sizes.append(size * demand.factor**k)
        if size > 1.0:
            last_bad = k
        if last_bad > MOST_POWERS:
            return inf, np.array(sizes)
    return float(last_bad + 1), np.array(sizes)


def _mismatch(own: SteadyFilter, true: Mode, gain: GainKind, demand: Demand) -> float:
    """The largest component that a step of the filter adds to the mean error while `true` is the true mode."""
    mode, K = own.mode, own.predictor_gain if gain == "predictor" else own.filter_gain
    F, B, f = true.F - mode.F, true.B - mode.B, true.f - mode.f
    measured = [true.H, np.zeros_like(true.H @ true.B), np.zeros(len(true.g))]
    expected = [mode.H, np.zeros_like(mode.H @ mode.B), np.zeros(len(mode.g))]
    if gain == "filter":
        measured = [true.H @ true.F, true.H @ true.B, true.H @ true.f]
        expected = [mode.H @ mode.F, mode.H @ mode.B, mode.H @ mode.f]
    state, inputs, offset = (moved - K @ (a - b) for moved, a, b in zip((F, B, f), measured, expected, strict=True))
    direct = K @ (true.D - mode.D)
    if gain == "predictor":  # the input of one step acts through B and D at once
        inputs, direct = inputs - direct, np.zeros_like(direct)
    offset = offset - K @ (true.g - mode.g)
    sums = np.abs(offset) + _worst(state, demand.state) + _worst(inputs, demand.input) + _worst(direct, demand.input)
    return float(sums.max(initial=0.0))


def _worst(matrix: FloatArray, bound: FloatArray | None) -> FloatArray:
    """Row sums of |matrix| against the bounds; infinite where something counts that has no bound."""
    sizes = np.abs(matrix)
    if bound is None:
        return np.asarray(np.where(sizes.any(axis=1), inf, 0.0))
    return np.asarray(sizes @ bound)


def _printed_mismatch(own: SteadyFilter, true: Mode, gain: GainKind, demand: Demand) -> float:
    """(32) and (23): the norm of column sums of (F' - F) - K (H' - H), times the largest bound of a state."""
    K = own.predictor_gain if gain == "predictor" else own.filter_gain
    matrix = true.F - own.mode.F - K @ (true.H - own.mode.H)
    size = float(np.abs(matrix).sum(axis=0).max(initial=0.0))
    if size == 0.0:
        return 0.0
    return inf if demand.state is None else size * float(demand.state.max())


__all__ = ["Demand", "GainKind", "ModeTerms", "SojournBound", "sojourn_bound"]
