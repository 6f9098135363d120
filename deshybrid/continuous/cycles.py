"""How far a dwell-time certificate is from the truth: the worst switching cycle.

In: error dynamics, rate μ, a longest dwell time to look at.  Out: the largest dwell time T found at which some cycle
of locations, each stay at least T, does *not* contract at rate μ (the spectral radius of the product of R¹_ij e^{(F_i
+ μ) t} is at least 1), with that cycle.  No dwell time up to it can be certified by any method; between it and the
required dwell time of a certificate lies what is undecided.  It is a lower limit, found by search, not the exact
border.

The search: all closed walks of up to 4 locations (at most 600, shorter ones first), all stays equal to T on a grid of
48 values from the longest downwards, then finer; for the 4 worst walks also stays of T plus quarters of the location's
own oscillation period.  What is reported was confirmed by the matrix exponential.

Source: error dynamics of Balluchi et al. (2012), (18)-(19); a periodic switching law that grows refutes every
certificate.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product
from math import exp, inf, isfinite, pi
from types import MappingProxyType

import numpy as np

from deshybrid.continuous.checks import require_positive
from deshybrid.continuous.dwell import PART_OF_A_STEP, most_steps
from deshybrid.continuous.error import ErrorDynamics, ErrorReset, error_dynamics
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.modes import decay_rate
from deshybrid.continuous.search import to_plane_s
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.exact import rational
from deshybrid.linear.exact_inequalities import Leg, Motion, does_not_contract
from deshybrid.linear.observability import sorted_spectrum
from deshybrid.model.system import HybridSystem

LONGEST_WALK = 4
MOST_WALKS = 600
REFINED_WALKS = 4
GRID = 48
REFINEMENTS = 8
GROWS = 1e-6
"""A cycle counts as not contracting where it grows by this share: enough for an exact proof."""


@dataclass(frozen=True, slots=True)
class WitnessCycle:
    """A cycle that does not contract: stay `stays[k]` seconds in `locations[k]`, then jump to the next, and again.

    `growth` is the spectral radius of the error's map over one round, times e^{μ · duration}: at least 1.
    `resets`: the jumps, by their place among the resets of the design.
    """

    locations: tuple[str, ...]
    stays: tuple[float, ...]
    growth: float
    resets: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class DwellLowerLimit:
    """No dwell time up to `value` (s) gives the rate; 0 with no cycle where every cycle looked at contracts."""

    value: float
    cycle: WitnessCycle | None


def dwell_lower_limit(
    system: HybridSystem, gains: ObserverGains, *, rate: float | None = None, longest: float | None = None
) -> DwellLowerLimit:
    """Return the largest dwell time at which a cycle was found that does not contract at `rate` (default `gains.rate`).

    `longest` (s): where the search starts, for example the required dwell time of a certificate; default: twenty times
    the slowest time constant of the closed loops.  In discrete time stays are whole steps.

    >>> from deshybrid.continuous.gains import design_gains
    >>> from deshybrid.model.load import loads
    >>> system = loads('''
    ... {format: deshybrid/1, name: kicked, state: [x], output: [y], disturbance: [w], bounds: {disturbance: 0.1},
    ...  locations: {p: {A: [[-1]], C: [[0]], E: [[1]]}},
    ...  transitions: [{from: p, to: p, event: kick, emits: kick, reset: {matrix: [[4]]}}]}
    ... ''')
    >>> gains = design_gains(system, ("p",), rate=0.5)
    >>> limit = dwell_lower_limit(system, gains, longest=5.0)
    >>> round(limit.value, 4), limit.cycle.locations  # here the certificate asks for no more: log(4)/0.5
    (2.7726, ('p',))
    """
    rate = gains.rate if rate is None else rate
    require_positive("rate", rate)
    return cycle_limit(error_dynamics(system, gains.gains), rate, longest=longest)


def cycle_limit(
    dynamics: ErrorDynamics,
    rate: float,
    *,
    longest: float | None = None,
    least: Mapping[str, float] = MappingProxyType({}),
    most: Mapping[str, float] = MappingProxyType({}),
    oscillations: bool = True,
) -> DwellLowerLimit:
    """Return the limit for given error dynamics; `least`, `most`: stays (s) that a location allows on its own.

    Without `oscillations` all stays are equal: faster, for a first guess.
    """
    shifted = _Shifted(dynamics, rate, least, most)
    top = longest if longest is not None and isfinite(longest) and longest > 0 else shifted.slowest()
    walks = [walk for walk, _ in zip(closed_walks(dynamics), range(MOST_WALKS), strict=False)]
    grid = np.geomspace(top, top * 1e-3, GRID)
    coarse = [_first_growing(shifted, walk, (0.0,) * len(walk), grid) for walk in walks]
    ranked = sorted(range(len(walks)), key=lambda k: coarse[k])
    best = DwellLowerLimit(0.0, None)
    for k in ranked[:REFINED_WALKS]:
        for extra in _extras(shifted, walks[k]) if oscillations else ((0.0,) * len(walks[k]),):
            found = _first_growing(shifted, walks[k], extra, grid)
            if found < GRID and grid[max(found - 1, 0)] > best.value:
                limit = _refined(shifted, walks[k], extra, grid, found)
                if limit.value > best.value and grows(dynamics, limit.cycle, rate):
                    best = limit
    return best


def grows(dynamics: ErrorDynamics, cycle: WitnessCycle | None, rate: float) -> bool:
    """Return whether a cycle provably does not contract at the rate, in exact arithmetic."""
    if cycle is None:
        return False
    step, legs = None if dynamics.step is None else Fraction(dynamics.step), []
    for number, stay in zip(cycle.resets, cycle.stays, strict=True):
        reset = dynamics.resets[number]
        motion = Motion(rational(dynamics.matrices[reset.source].tolist()), step)
        exact = Fraction(stay) if step is None else round(Fraction(stay) / step) * step
        legs.append(Leg(motion, exact, rational(reset.matrix.tolist())))
    return does_not_contract(legs, Fraction(rate))


class _Shifted:
    """The error dynamics times e^{μ t}: growth at least 1 means slower than μ."""

    def __init__(
        self, dynamics: ErrorDynamics, rate: float, least: Mapping[str, float], most: Mapping[str, float]
    ) -> None:
        self.dynamics, self.rate, self.least, self.most = dynamics, rate, least, whole_most(most, dynamics.step)
        self._flows: dict[tuple[str, bytes], FloatArray] = {}

    def stay(self, name: str, durations: FloatArray) -> FloatArray:
        """The stays as location and time allow them: between least and longest, whole steps, at least one."""
        step = self.dynamics.step
        durations = np.minimum(np.maximum(durations, self.least.get(name, 0.0)), self.most.get(name, np.inf))
        return durations if step is None else np.maximum(1, np.ceil(durations / step - PART_OF_A_STEP)) * step

    def flows(self, name: str, durations: FloatArray) -> FloatArray:
        """e^{(F + μ) t} for several stays (k, n, n), remembered: the same stays come up in many walks."""
        from scipy.linalg import expm

        key = name, durations.tobytes()
        if key not in self._flows:
            F, step = self.dynamics.matrices[name], self.dynamics.step
            if step is None:
                found = expm((F + self.rate * np.eye(len(F))) * durations[:, None, None])
            else:
                shifted = F * exp(self.rate * step)  # before the power: e^{μ t} alone may be beyond all numbers
                found = np.array([np.linalg.matrix_power(shifted, round(float(t) / step)) for t in durations])
            self._flows[key] = np.asarray(found)
        return self._flows[key]

    def growth(self, walk: Sequence[ErrorReset], T: FloatArray, extra: Sequence[float]) -> FloatArray:
        """Spectral radius of the product of reset and flow over one round, for stays T + extra; one for each T."""
        whole = np.broadcast_to(np.eye(len(walk[0].matrix)), (len(T), *walk[0].matrix.shape))
        for reset, more in zip(walk, extra, strict=True):
            whole = reset.matrix @ self.flows(reset.source, self.stay(reset.source, T + more)) @ whole
        finite = np.asarray(np.isfinite(whole).all(axis=(1, 2)))  # what has outgrown all numbers grows
        radii = np.abs(np.linalg.eigvals(np.where(finite[:, None, None], whole, 0.0))).max(axis=1)
        return np.asarray(np.where(finite, radii, np.inf))

    def slowest(self) -> float:
        """Twenty times the slowest time constant, 1 s where nothing decays."""
        step = self.dynamics.step
        rates = [-decay_rate(sorted_spectrum(F), step) for F in self.dynamics.matrices.values()]
        least = min((rate for rate in rates if rate > 0), default=20.0)
        return 20 / least if isfinite(least) else 1.0


def whole_most(most: Mapping[str, float], step: float | None) -> dict[str, float]:
    """Return the longest stays (s), in sampled time as whole steps.

    >>> whole_most({"p": 0.35}, 0.25)
    {'p': 0.25}
    """
    return {name: stay if step is None else most_steps(stay, step) * step for name, stay in most.items()}


def limit_by(value: float, cycle: WitnessCycle, most: Mapping[str, float]) -> DwellLowerLimit:
    """Return the limit that a cycle shows: `value` (s), or its shortest stay where rounding to steps left it below.

    Stays as long as a location allows (`most`, s) do not count.
    """
    free = [stay for place, stay in zip(cycle.locations, cycle.stays, strict=True) if stay < most.get(place, inf)]
    return DwellLowerLimit(min([value, *free]), cycle)


def witness(dynamics: ErrorDynamics, walk: Sequence[ErrorReset], stays: Sequence[float], growth: float) -> WitnessCycle:
    """Return the cycle of these jumps."""
    numbers = {id(reset): number for number, reset in enumerate(dynamics.resets)}
    places = tuple(reset.source for reset in walk)
    return WitnessCycle(places, tuple(stays), growth, tuple(numbers[id(reset)] for reset in walk))


def closed_walks(dynamics: ErrorDynamics) -> Iterator[tuple[ErrorReset, ...]]:
    """Closed walks of 1 to 4 transitions, each once up to where it starts, in order of declaration."""
    numbers = {id(reset): number for number, reset in enumerate(dynamics.resets)}
    for length in range(1, LONGEST_WALK + 1):
        for start in dynamics.resets:
            for walk in _extend(dynamics, (start,), length):
                order = [numbers[id(reset)] for reset in walk]
                rotations = [order[k:] + order[:k] for k in range(length)]
                if walk[-1].target == start.source and order == min(rotations) and rotations.count(order) == 1:
                    yield walk


def _extend(dynamics: ErrorDynamics, walk: tuple[ErrorReset, ...], length: int) -> Iterator[tuple[ErrorReset, ...]]:
    if len(walk) == length:
        yield walk
        return
    for reset in dynamics.exits(walk[-1].target):
        yield from _extend(dynamics, (*walk, reset), length)


def _extras(shifted: _Shifted, walk: Sequence[ErrorReset]) -> Iterator[tuple[float, ...]]:
    """No extra stay, and quarters of each location's oscillation period in all combinations; halves in long walks."""
    quarters = range(4) if len(walk) < LONGEST_WALK else range(0, 4, 2)
    choices = []
    for reset in walk:
        modes = to_plane_s(sorted_spectrum(shifted.dynamics.matrices[reset.source]), shifted.dynamics.step)
        fastest = float(np.abs(modes.imag).max()) or float(np.abs(modes.real).min()) or 1.0
        choices.append([quarter * pi / (2 * fastest) for quarter in quarters])
    yield from product(*choices)


def _first_growing(shifted: _Shifted, walk: Sequence[ErrorReset], extra: Sequence[float], grid: FloatArray) -> int:
    """The place in the descending grid of the largest T at which the walk does not contract; its length if none."""
    growing = shifted.growth(walk, grid, extra) >= 1 + GROWS
    return int(np.argmax(growing)) if growing.any() else len(grid)


def _refined(
    shifted: _Shifted, walk: Sequence[ErrorReset], extra: Sequence[float], grid: FloatArray, found: int
) -> DwellLowerLimit:
    """Cut the step between the grid value that grows and the next longer one into 16, eight times over."""
    low, high = float(grid[found]), float(grid[max(found - 1, 0)])
    for _ in range(REFINEMENTS):
        finer = np.linspace(high, low, 17)
        place = _first_growing(shifted, walk, extra, finer)
        low, high = float(finer[min(place, 16)]), float(finer[max(place - 1, 0)])
    stays = [
        float(shifted.stay(reset.source, np.array([low + more]))[0]) for reset, more in zip(walk, extra, strict=True)
    ]
    growth = float(shifted.growth(walk, np.array([low]), extra)[0])
    return limit_by(low, witness(shifted.dynamics, walk, stays, growth), shifted.most)


__all__ = [
    "DwellLowerLimit",
    "WitnessCycle",
    "closed_walks",
    "cycle_limit",
    "dwell_lower_limit",
    "grows",
    "limit_by",
    "whole_most",
    "witness",
]
