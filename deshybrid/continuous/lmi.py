"""Dwell-time certificates by matrix inequalities, with the interval in which the truth lies.

In: error dynamics, rate μ, dwell time D, detection delay Δ, shortest stays of locations.  Out: forms P_i, Q_i that
prove the least required dwell time that was found, and the longest dwell time at which some switching cycle does not
contract.
The idea: whether forms exist is monotone in the dwell time, so bisect; quadratic forms first, then forms of degree 4
and 6 while the gap to the worst cycle is above 2 % and the size affordable.  The forms also guide the search for worse
cycles.  What is returned was proved in exact arithmetic (`deshybrid.linear.exact_inequalities`), as `verify` does it
again.

Some ten conic problems of 2 m N unknowns (m locations, N = n (n+1)/2) for each degree.
Source: Balluchi et al. (2012), section 4.2, for the setting; Geromel and Colaneri (2006); Parrilo and Jadbabaie (2008).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from math import exp, inf, isfinite, sqrt
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.checks import require_not_negative, require_positive
from deshybrid.continuous.conic import has_solver, require_solver
from deshybrid.continuous.cycles import GROWS, DwellLowerLimit, cycle_limit, grows, witness
from deshybrid.continuous.dwell import DwellTimeCertificate, long_enough, stay_steps, sum_rounded_up
from deshybrid.continuous.error import ErrorDynamics, error_resets
from deshybrid.continuous.forms import FormProblem, Forms
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.modes import decay_rate
from deshybrid.continuous.worst_cycle import Cycle, CycleSearch
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.exact import rational
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_inequalities import (
    Motion,
    flow_decreases,
    jump_decreases,
    stay_decreases,
)
from deshybrid.linear.lifting import lifted_size
from deshybrid.linear.observability import sorted_spectrum
from deshybrid.model.system import HybridSystem

RESOLUTION = 0.002
"""The bisection stops where two dwell times differ by this share."""
EASED = 1.02
"""A problem of higher degree starts at a dwell time so much longer, where it has some room."""
WIDE = 0.02
"""While the gap is wider than this share of the lower limit, forms of higher degree are tried."""
HIGHEST_DEGREE = 3
AFFORDABLE = 250_000
"""No more than this many nonzero numbers in a conic problem of higher degree: some seconds each."""
LONGEST = 20.0
"""No dwell time beyond so many of the slowest time constants is tried."""
SHORTEST = 1e-6
"""A dwell time below this share of the longest one tried is not told from none."""
SHARES = (0.995, 0.95, 0.85, 0.6)
"""Parts of the certified dwell time at which worse cycles are looked for."""


@dataclass(frozen=True, slots=True, eq=False)
class InequalityCertificate:
    """A claim "every stay of at least `dwell` seconds: the error decays at `rate`", proved by forms.

    rate (1/s), dwell, delay and required_dwell (s; infinite where no forms were found); holds: whether required_dwell
    <= dwell; degree: 2 d of the forms; P and Q by location, in the monomials of degree d of the states; least: the
    shortest stays (s) that the model states for locations; matrices: F_i or, sampled, M_i; step (s) or None; limit: the
    worst switching cycle, for D - Δ; reason: one sentence.
    """

    theorem: str
    rate: float
    dwell: float
    delay: float
    holds: bool
    required_dwell: float
    degree: int
    P: Mapping[str, FloatArray] | None
    Q: Mapping[str, FloatArray] | None
    least: Mapping[str, float]
    matrices: Mapping[str, FloatArray]
    step: float | None
    limit: DwellLowerLimit
    reason: str

    @property
    def gap(self) -> float:
        """(required - limit)/limit without the delay: how far the answer is from the best there can be."""
        stay = self.required_dwell - self.delay
        return stay / self.limit.value - 1 if self.limit.value > 0 else (inf if stay > 0 else 0.0)


class Found(NamedTuple):
    """The least D - Δ that was proved (s), by which forms, and the limit from below."""

    stay: float
    forms: Forms | None
    limit: DwellLowerLimit


def certify_by_inequalities(
    dynamics: ErrorDynamics,
    *,
    rate: float,
    dwell: float | None = None,
    delay: float = 0.0,
    least: Mapping[str, float] | None = None,
    longest: float = inf,
    sampled: bool = False,
) -> InequalityCertificate:
    """Return the certificate with the least required dwell time that was found for these error dynamics.

    Parameters
    ----------
    rate : float, 1/s
        μ > 0.
    dwell : float, s
        D, a lower bound of all stays; default: the required dwell time itself.
    delay : float, s
        Δ, a bound of the time between a transition and its detection.
    least : mapping, s
        Locations that are never left earlier than this.
    longest : float, s
        A D - Δ that is known to be enough, where there is one: the bisection starts there.

    Raises `UsageError` (DH0508, DH0518) for numbers out of range and where the solver is missing.  "No" is a value.

    >>> from deshybrid.continuous.error import ErrorReset
    >>> one, four = np.eye(1), 4 * np.eye(1)
    >>> dynamics = ErrorDynamics(("p",), {"p": -one}, (ErrorReset("p", "p", four, np.zeros(1)),))
    >>> found = certify_by_inequalities(dynamics, rate=0.5)
    >>> bool(2.7725 < found.limit.value <= found.required_dwell < 2.7792)  # log(4)/(1 - 0.5) = 2.77259
    True
    """
    require_solver()
    require_positive("rate", rate)
    require_positive("dwell time", dwell)
    require_not_negative("delay", delay)
    stays = {name: max(0.0, stay - delay) for name, stay in (least or {}).items()}
    found = _search(dynamics, rate, stays, longest)
    required = inf if found.forms is None else sum_rounded_up(delay, found.stay)
    stated = dwell if dwell is not None else max(required, delay + 0.01 / rate)
    holds = isfinite(required) and long_enough(stated - delay, required - delay, dynamics.step)
    forms = found.forms
    return InequalityCertificate(
        theorem="LMI-sampled" if sampled else "LMI",
        rate=rate,
        dwell=stated,
        delay=delay,
        holds=holds,
        required_dwell=required,
        degree=2 * (1 if forms is None else forms.degree),
        P=None if forms is None else forms.P,
        Q=None if forms is None else forms.Q,
        least=MappingProxyType(dict(least or {})),
        matrices=dynamics.matrices,
        step=dynamics.step,
        limit=found.limit,
        reason=_reason(found, required, stated, delay, holds=holds),
    )


def certify_forms(
    system: HybridSystem, gains: ObserverGains, papers: Sequence[DwellTimeCertificate]
) -> tuple[InequalityCertificate, ...]:
    """Return a certificate by matrix inequalities for each claim made by the paper's conditions, in their order.

    None where the solver is not installed.
    Rate, dwell time, delay and error matrices are those of `papers`; the shortest stays are those of the system.
    """
    least = {
        place.name: place.dwell.min
        for place in system.locations
        if place.name in gains.gains and place.dwell.min is not None
    }
    if not has_solver():
        return ()
    resets, made = error_resets(system, gains.locations), []
    for paper in papers:
        dynamics = ErrorDynamics(gains.locations, paper.matrices, resets, paper.step)
        made.append(
            certify_by_inequalities(
                dynamics,
                rate=paper.rate,
                dwell=gains.dwell,
                delay=paper.delay,
                least=least,
                longest=paper.required_dwell - paper.delay,
                sampled=paper.theorem.endswith("-sampled"),
            )
        )
    return tuple(made)


def _search(dynamics: ErrorDynamics, rate: float, least: Mapping[str, float], longest: float) -> Found:
    """Bisection with quadratic forms, then with forms of higher degree while that pays."""
    shifted = shifted_dynamics(dynamics, rate)
    slowest = min((-decay_rate(sorted_spectrum(F), dynamics.step) for F in shifted.matrices.values()), default=inf)
    if not 0 < slowest < inf:
        return Found(inf, None, DwellLowerLimit(0.0, None))
    task = _Task(dynamics, shifted, rate, least)
    top = LONGEST / slowest
    start = longest if 0 < longest < top else top
    limit = cycle_limit(dynamics, rate, longest=start, least=least, oscillations=False)
    problem = FormProblem(shifted)
    found = task.bisect(problem, Found(inf, None, limit), start, top)
    while found.forms is not None and found.forms.degree < HIGHEST_DEGREE and _gap(found) > WIDE:
        degree = found.forms.degree + 1
        if not _is_affordable(dynamics, degree):
            break
        higher = FormProblem(shifted, degree, problem.frames())
        better = task.bisect(higher, found, found.stay * EASED, top)
        if better.stay >= found.stay:
            break
        found = better
    return found


def shifted_dynamics(dynamics: ErrorDynamics, rate: float) -> ErrorDynamics:
    """Return the dynamics of e^{μ t} ζ: F + μ I, or M e^{μ h}."""
    step = dynamics.step
    moved = {
        name: frozen_array(F + rate * np.eye(len(F)) if step is None else F * exp(rate * step), F.shape)
        for name, F in dynamics.matrices.items()
    }
    return replace(dynamics, matrices=MappingProxyType(moved))


class _Task:
    """One search: dynamics, the same times e^{μ t}, and the shortest stays."""

    def __init__(
        self, dynamics: ErrorDynamics, shifted: ErrorDynamics, rate: float, least: Mapping[str, float]
    ) -> None:
        self.dynamics, self.shifted, self.rate, self.least = dynamics, shifted, rate, least
        self.cycles = CycleSearch(shifted)

    def stays(self, common: float) -> dict[str, float]:
        """The shortest stay of each location where every stay lasts at least `common` seconds."""
        bounds = {name: max(common, self.least.get(name, 0.0)) for name in self.dynamics.locations}
        step = self.dynamics.step
        if step is None:
            return bounds
        return {name: max(1, stay_steps(bound, step)) * step for name, bound in bounds.items()}

    def bisect(self, problem: FormProblem, known: Found, start: float, top: float) -> Found:
        """Forms of the problem for the shortest stay at which they are found and proved."""
        passed: list[tuple[float, Forms]] = []
        low, high = known.limit.value, start
        while not self._try(problem, high, passed):
            low, high = high, min(4 * high, top)
            if low >= top:
                return known
        if low == 0.0 and self._try(problem, 0.0, passed):
            high = 0.0
        low = max(low, top * SHORTEST)
        while high > low * (1 + RESOLUTION) and self._differ(low, high):
            middle = sqrt(low * high)
            if self._try(problem, middle, passed):
                high = middle
            else:
                low = middle
        for stay, forms in reversed(passed):
            if is_proved(self.dynamics, forms, self.stays(stay), self.rate):
                limit = self.guided(forms, known.limit, stay) if forms.degree == 1 else known.limit
                return Found(stay, forms, limit)
        return known

    def _differ(self, low: float, high: float) -> bool:
        return self.dynamics.step is None or self.stays(low) != self.stays(high)

    def _try(self, problem: FormProblem, common: float, passed: list[tuple[float, Forms]]) -> bool:
        stays = self.stays(common)
        forms = problem.solve([stays[name] for name in self.dynamics.locations])
        if forms is not None:
            passed.append((common, forms))
        return forms is not None

    def guided(self, forms: Forms, best: DwellLowerLimit, certified: float) -> DwellLowerLimit:
        """A better limit from the cycles that the forms point at, proved."""
        for share in SHARES:
            common = share * certified
            if best.value >= common:
                break
            for cycle in self.cycles.candidates(forms.P, self.stays(common)):
                best = self._climbed(cycle, best, 0.8 * common, certified)
        return best

    def _climbed(self, cycle: Cycle, best: DwellLowerLimit, start: float, end: float) -> DwellLowerLimit:
        """The longest shortest stay at which this cycle grows, where that is above the best limit so far."""
        low = max(start, best.value * (1 + RESOLUTION / 4))
        found = self.cycles.improved(cycle, self.stays(low))
        if found.growth < GROWS:
            return best
        high, grown = end, found
        while high > low * (1 + RESOLUTION / 4) and self._differ(low, high):
            middle = (low + high) / 2
            tried = self.cycles.improved(grown, self.stays(middle))
            low, high, grown = (middle, high, tried) if tried.growth >= GROWS else (low, middle, grown)
        walk = [self.dynamics.resets[k] for k in grown.resets]
        cycle_found = witness(self.dynamics, walk, grown.stays, exp(grown.growth))
        return DwellLowerLimit(low, cycle_found) if grows(self.dynamics, cycle_found, self.rate) else best


def is_proved(dynamics: ErrorDynamics, forms: Forms, stays: Mapping[str, float], rate: float) -> bool:
    """Return whether these forms prove the rate for these shortest stays, in exact arithmetic."""
    step, mu = None if dynamics.step is None else Fraction(dynamics.step), Fraction(rate)
    P, Q = ({name: rational(form.tolist()) for name, form in of.items()} for of in (forms.P, forms.Q))
    for name, matrix in dynamics.matrices.items():
        motion, stay = Motion(rational(matrix.tolist()), step), _exact_stay(stays[name], step)
        if not (is_positive_definite(P[name]) and is_positive_definite(Q[name])):
            return False
        if not flow_decreases(motion, Q[name], forms.degree, mu):
            return False
        if not stay_decreases(motion, stay, P[name], Q[name], degree=forms.degree, rate=mu):
            return False
    return all(
        jump_decreases(rational(reset.matrix.tolist()), P[reset.target], Q[reset.source], forms.degree)
        for reset in dynamics.resets
    )


def _exact_stay(stay: float, step: Fraction | None) -> Fraction:
    return Fraction(stay) if step is None else round(Fraction(stay) / step) * step


def _gap(found: Found) -> float:
    if found.stay == 0.0:
        return 0.0
    return found.stay / found.limit.value - 1 if found.limit.value > 0 else inf


def _is_affordable(dynamics: ErrorDynamics, degree: int) -> bool:
    size = lifted_size(len(next(iter(dynamics.matrices.values()))), degree)
    packed = size * (size + 1) // 2
    return packed**2 * (2 * len(dynamics.locations) + len(dynamics.resets)) <= AFFORDABLE


def _reason(found: Found, required: float, dwell: float, delay: float, *, holds: bool) -> str:
    if found.forms is None:
        return "no forms were found that prove this rate for any dwell time"
    if found.stay == 0.0:
        longer = f" and that is longer than the detection delay {delay:.6g} s" if delay else ""
        return f"any stay that the model allows{longer} is long enough"
    what = f"forms of degree {2 * found.forms.degree} prove {required:.6g} s"
    cycle = found.limit.cycle
    said = f"; the cycle {' -> '.join(cycle.locations)} rules out stays of {found.limit.value:.6g} s" if cycle else ""
    return f"{what}{said}" if holds else f"{what}, more than the dwell time {dwell:.6g} s{said}"


__all__ = [
    "Found",
    "InequalityCertificate",
    "certify_by_inequalities",
    "certify_forms",
    "is_proved",
    "shifted_dynamics",
]
