"""Dwell-time certificates by matrix inequalities, with the interval in which the truth lies.

In: error dynamics, rate μ, dwell time D, detection delay Δ, shortest stays of locations.  Out: forms P_i, Q_i that
prove the least required dwell time that was found, and the longest dwell time at which some switching cycle does not
contract.
The idea: whether forms exist is monotone in the dwell time, so bisect; plain quadratic forms first, then, while the
gap to the worst cycle is above 2 % and the size affordable, forms that depend on how long the stay lasts, on the
transitions before it, or of degree 4 and 6 (`deshybrid.continuous.form_graph`).  The forms also guide the search for
worse cycles.  What is returned was proved in exact arithmetic (`deshybrid.continuous.form_proof`), as `verify` does it
again.

A location with a longest stay need not decay by itself: its forms cover the stays up to there only.

Some ten conic problems for each shape, of 2 m N unknowns for the plain one (m locations, N = n (n+1)/2).
Source: Balluchi et al. (2012), section 4.2, for the setting; Geromel and Colaneri (2006); Parrilo and Jadbabaie (2008).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from math import exp, inf, isfinite, sqrt
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.checks import require_not_negative, require_positive
from deshybrid.continuous.conic import has_solver, require_solver
from deshybrid.continuous.cycles import GROWS, DwellLowerLimit, cycle_limit, grows, limit_by, witness
from deshybrid.continuous.dwell import DwellTimeCertificate, long_enough, most_steps, stay_steps, sum_rounded_up
from deshybrid.continuous.error import ErrorDynamics, error_resets
from deshybrid.continuous.form_graph import Forms, Shape
from deshybrid.continuous.form_proof import is_proved
from deshybrid.continuous.forms import FormProblem
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.modes import decay_rate
from deshybrid.continuous.worst_cycle import Cycle, CycleSearch
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.observability import sorted_spectrum
from deshybrid.model.system import HybridSystem

RESOLUTION = 0.002
"""The bisection stops where two dwell times differ by this share."""
EASED = 1.02
"""A problem of higher degree starts at a dwell time so much longer, where it has some room."""
WIDE = 0.02
"""While the gap is wider than this share of the lower limit, forms of higher degree are tried."""
SHAPES = (
    Shape(cuts=4),
    Shape(cuts=1),
    Shape(degree=2, cuts=2),
    Shape(degree=2),
    Shape(cuts=4, memory=1),
    Shape(cuts=1, memory=1),
    Shape(degree=3),
    Shape(cuts=4, memory=2),
)
"""What forms may depend on where plain ones leave a gap, in the order in which it is tried."""
AFFORDABLE = 150_000
"""No more than this many nonzero numbers in a conic problem that is not plain: a second or two each."""
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
    <= dwell; forms: what proves it, in the monomials of degree d of the states; plain: quadratic forms, one P and Q for
    each location, where they prove the stated dwell time as well; least, most: the shortest and longest stays (s) that
    the model states for locations; matrices: F_i or, sampled, M_i; step (s) or None; limit: the worst switching cycle,
    for D - Δ; reason: one sentence.
    """

    theorem: str
    rate: float
    dwell: float
    delay: float
    holds: bool
    required_dwell: float
    forms: Forms | None
    plain: Forms | None
    least: Mapping[str, float]
    most: Mapping[str, float]
    matrices: Mapping[str, FloatArray]
    step: float | None
    limit: DwellLowerLimit
    reason: str

    @property
    def degree(self) -> int:
        """2 d, the degree of the forms in the states; 2 where there are none."""
        return 2 * (1 if self.forms is None else self.forms.degree)

    @property
    def gap(self) -> float:
        """(required - limit)/limit without the delay: how far the answer is from the best there can be."""
        stay = self.required_dwell - self.delay
        return stay / self.limit.value - 1 if self.limit.value > 0 else (inf if stay > 0 else 0.0)


class Found(NamedTuple):
    """The least D - Δ that was proved (s), by which forms, the limit from below, and what plain forms prove."""

    stay: float
    forms: Forms | None
    limit: DwellLowerLimit
    plain: "tuple[float, Forms] | None" = None


def certify_by_inequalities(
    dynamics: ErrorDynamics,
    *,
    rate: float,
    dwell: float | None = None,
    delay: float = 0.0,
    least: Mapping[str, float] = MappingProxyType({}),
    most: Mapping[str, float] = MappingProxyType({}),
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
    least, most : mapping, s
        Locations that are never left earlier, or always left after this.  Their stays as an observer sees them, which
        learns of a switch up to Δ late, are taken to be up to Δ shorter or longer.
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
    shortest = {name: max(0.0, stay - delay) for name, stay in least.items()}
    ends = {name: sum_rounded_up(delay, stay) for name, stay in most.items()}
    found = _search(dynamics, rate, shortest, ends, longest)
    required = inf if found.forms is None else sum_rounded_up(delay, found.stay)
    stated = dwell if dwell is not None else max(required, delay + 0.01 / rate)
    holds = isfinite(required) and long_enough(stated - delay, required - delay, dynamics.step)
    plain = found.plain
    if plain is not None and not long_enough(stated - delay, plain[0], dynamics.step):
        plain = None
    return InequalityCertificate(
        theorem="LMI-sampled" if sampled else "LMI",
        rate=rate,
        dwell=stated,
        delay=delay,
        holds=holds,
        required_dwell=required,
        forms=found.forms,
        plain=None if plain is None else plain[1],
        least=MappingProxyType(dict(least)),
        most=MappingProxyType(dict(most)),
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
    Rate, dwell time, delay and error matrices are those of `papers`; shortest and longest stays those of the system.
    """
    least, most = stated_stays(system, gains.locations)
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
                most=most,
                longest=paper.required_dwell - paper.delay,
                sampled=paper.theorem.endswith("-sampled"),
            )
        )
    return tuple(made)


def stated_stays(system: HybridSystem, locations: tuple[str, ...]) -> tuple[dict[str, float], dict[str, float]]:
    """Return the shortest and the longest stays (s) of these locations, where the model states them.

    >>> from deshybrid.model.load import load
    >>> stated_stays(load("models/balluchi2003/three_locations.yaml"), ("q1", "q2"))
    ({'q1': 1.5, 'q2': 1.5}, {'q1': 7.0, 'q2': 7.0})
    """
    stays = {name: system.location(name).dwell for name in locations}
    least = {name: dwell.min for name, dwell in stays.items() if dwell.min is not None}
    return least, {name: dwell.max for name, dwell in stays.items() if dwell.max is not None}


def _search(
    dynamics: ErrorDynamics, rate: float, least: Mapping[str, float], most: Mapping[str, float], longest: float
) -> Found:
    """Bisection with plain forms, then with other shapes while that pays."""
    shifted = shifted_dynamics(dynamics, rate)
    top = _longest_tried(shifted, most)
    if not 0 < top < inf:
        return Found(inf, None, DwellLowerLimit(0.0, None))
    task = _Task(dynamics, shifted, rate, least, most)
    start = longest if 0 < longest < top else top
    limit = cycle_limit(dynamics, rate, longest=start, least=least, most=most, oscillations=False)
    problem = FormProblem(shifted, most=most)
    found = task.bisect(problem, Found(inf, None, limit), start, top)
    frames = None
    if found.forms is not None and found.forms.is_plain:
        found, frames = found._replace(plain=(found.stay, found.forms)), problem.frames()
    for shape in SHAPES:
        if _gap(found) <= WIDE:
            break
        finer = FormProblem(shifted, shape, frames=frames, most=most)
        remembers = shape.memory == 0 or len(finer.nodes) > len(problem.nodes)
        if finer.size > AFFORDABLE or not remembers:
            continue
        better = task.bisect(finer, found, min(found.stay * EASED, start), top)
        found = better if better.stay < found.stay else found
    return found


def _longest_tried(shifted: ErrorDynamics, most: Mapping[str, float]) -> float:
    """The longest dwell time (s) worth trying; infinite or zero where no dwell time gives the rate."""
    decay = {name: -decay_rate(sorted_spectrum(F), shifted.step) for name, F in shifted.matrices.items()}
    if any(rate <= 0 for name, rate in decay.items() if name not in most):
        return inf
    slowest = min((rate for rate in decay.values() if rate > 0), default=inf)
    return max(LONGEST / slowest, *(stay for name, stay in most.items() if decay[name] <= 0), 0.0)


def shifted_dynamics(dynamics: ErrorDynamics, rate: float) -> ErrorDynamics:
    """Return the dynamics of e^{μ t} ζ: F + μ I, or M e^{μ h}."""
    step = dynamics.step
    moved = {
        name: frozen_array(F + rate * np.eye(len(F)) if step is None else F * exp(rate * step), F.shape)
        for name, F in dynamics.matrices.items()
    }
    return replace(dynamics, matrices=MappingProxyType(moved))


class _Task:
    """One search: dynamics, the same times e^{μ t}, the shortest and the longest stays."""

    def __init__(
        self,
        dynamics: ErrorDynamics,
        shifted: ErrorDynamics,
        rate: float,
        least: Mapping[str, float],
        most: Mapping[str, float],
    ) -> None:
        self.dynamics, self.shifted, self.rate, self.least, self.most = dynamics, shifted, rate, least, most
        self.cycles = CycleSearch(shifted, most)

    def stays(self, common: float) -> dict[str, float]:
        """The shortest stay of each location where every stay lasts at least `common` seconds, or as long as it can."""
        step, bounds = self.dynamics.step, {}
        for name in self.dynamics.locations:
            bound, most = max(common, self.least.get(name, 0.0)), self.most.get(name, inf)
            bounds[name] = min(bound, most)
            if step is not None:
                ticks = max(1, stay_steps(bound, step))
                bounds[name] = (ticks if most == inf else max(1, min(ticks, most_steps(most, step)))) * step
        return bounds

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
            if is_proved(self.dynamics, forms, self.stays(stay), self.rate, self.most):
                guides = forms.degree == 1 and set(forms.P) == set(self.dynamics.locations)
                limit = self.guided(forms, known.limit, stay) if guides else known.limit
                return known._replace(stay=stay, forms=forms, limit=limit)
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
        return limit_by(low, cycle_found, self.cycles.most) if grows(self.dynamics, cycle_found, self.rate) else best


def _gap(found: Found) -> float:
    if found.stay == 0.0:
        return 0.0
    return found.stay / found.limit.value - 1 if found.limit.value > 0 else inf


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
    "shifted_dynamics",
    "stated_stays",
]
