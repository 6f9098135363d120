"""Co-design: all gains and forms together, so that the certified dwell time is short at a bounded gain.

In: a system with gains, a cap ‖Γ_i‖₂ for every gain that may move (Γ in units: states in their sizes, outputs in the
lengths of their rows of C).  Out: gains, none above its cap, whose dwell time by quadratic forms is shorter or equal.
The idea: from the forms that prove a dwell time, take the step of `continuous/codesign_step.py`, look whether forms
prove the shorter dwell time at the new gains, and go on from there; a step that fails is cut.  The problem is not
convex: the end depends on the start and need not be the best.

At most `STEPS` steps of two or three conic problems each.  Source: this project; every dwell time along the way is
proved by forms that were found, so only the length of the steps rests on the linearisation.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import exp, inf, sqrt

import numpy as np

from deshybrid.continuous.codesign_step import GainPlant, Gains, Point, proposed
from deshybrid.continuous.error import ErrorReset, dynamics_of, error_resets
from deshybrid.continuous.forms import FormProblem
from deshybrid.continuous.modes import decay_rate
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.observability import sorted_spectrum
from deshybrid.model.system import HybridSystem

STEPS = 60
FIRST, LARGEST, SMALLEST = 0.1, 0.5, 1e-3
"""The trust region: the first, largest and smallest step of a gain, as a share of its cap."""
SHARES = (0.9, 0.3)
"""Parts of the expected gain in dwell time that are tried, the boldest first."""
SLOW = 0.002
"""A step that shortens the dwell time by less than this share is a slow one; three in a row end the search."""
RESOLUTION = 0.01
"""The first dwell time is found to this share."""
LONGEST = 20.0
"""No dwell time beyond so many of the slowest time constants is tried."""


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    """Sizes of the states (n,), and by location which outputs are used and the lengths of their rows."""

    scale: FloatArray
    used: Mapping[str, FloatArray]
    lengths: Mapping[str, FloatArray]

    def inside(self, name: str, gain: FloatArray) -> FloatArray:
        """Return Γ of G, without the outputs that show nothing."""
        return np.asarray(gain[:, self.used[name]] * self.lengths[name] / self.scale[:, None])

    def outside(self, name: str, inner: FloatArray) -> FloatArray:
        """Return G of Γ; outputs that show nothing get zero."""
        gain = np.zeros((len(self.scale), len(self.used[name])))
        gain[:, self.used[name]] = inner * self.scale[:, None] / self.lengths[name]
        return gain


def codesigned(
    system: HybridSystem,
    start: Mapping[str, FloatArray],
    caps: Mapping[str, FloatArray],
    *,
    scale: FloatArray,
    rate: float,
    least: Mapping[str, float],
) -> Mapping[str, FloatArray]:
    """Return gains for the locations of `start`; those of `caps` move, with ‖Γ_i‖₂ at most that of the gain there.

    scale (n,): sizes of the states; rate (1/s): μ; least (s): shortest stays by location, without the delay.
    Where no forms are found for the start, it is returned.

    >>> from deshybrid.model.load import load
    >>> tank, start = load("models/two_tank.yaml"), {"fill": np.array([[1.0], [1.0]])}
    >>> codesigned(tank, start, {}, scale=np.ones(2), rate=0.1, least={})["fill"].tolist()
    [[1.0], [1.0]]
    """
    plant, units = gain_plant(system, tuple(start), scale, rate, least)
    inner = {name: units.inside(name, gain) for name, gain in start.items()}
    bounds = {name: float(np.linalg.norm(units.inside(name, gain), 2)) for name, gain in caps.items()}
    bounds = {name: bound for name, bound in bounds.items() if bound > 0}
    point = first_point(plant, inner)
    if point is None or not bounds:
        return start
    found = descended(plant, point, bounds)
    return {name: units.outside(name, gain) if name in bounds else start[name] for name, gain in found.gains.items()}


def gain_plant(
    system: HybridSystem, locations: tuple[str, ...], scale: FloatArray, rate: float, least: Mapping[str, float]
) -> tuple[GainPlant, Units]:
    """Return the plants times e^{μ t} in units, and the units."""
    A, C, used, lengths = {}, {}, {}, {}
    step, n = system.time_step, len(scale)
    for name in locations:
        dynamics = dynamics_of(system, name)
        sizes = np.linalg.norm(dynamics.C * scale, axis=1)
        used[name] = sizes > 0
        lengths[name] = sizes[used[name]]
        inside = dynamics.A * scale / scale[:, None]
        rows = (dynamics.C * scale)[used[name]] / lengths[name][:, None]
        factor = 1.0 if step is None else exp(rate * step)
        A[name] = inside + rate * np.eye(n) if step is None else inside * factor
        C[name] = rows * factor
    resets = tuple(
        ErrorReset(r.source, r.target, frozen_array(r.matrix * scale / scale[:, None], (n, n)), r.offset)
        for r in error_resets(system, locations)
    )
    return GainPlant(A, C, resets, step, dict(least)), Units(scale, used, lengths)


def first_point(plant: GainPlant, gains: Gains) -> Point | None:
    """Return the least dwell time that quadratic forms prove for these gains, to 1 %; None where there is none."""
    loops = plant.loops(gains)
    slowest = min(-decay_rate(sorted_spectrum(F), plant.step) for F in loops.matrices.values())
    if not 0 < slowest < inf:
        return None
    problem, low, high = FormProblem(loops), 0.0, 1.0 / slowest
    while problem.solve(plant.stays(high)) is None:
        low, high = high, 2 * high
        if high > LONGEST / slowest:
            return None
    frames = problem.frames()
    if low == 0.0 and problem.solve(plant.stays(0.0)) is not None:
        return Point(gains, plant.shortest, problem.frames())
    low = max(low, high * 1e-4)
    while high > low * (1 + RESOLUTION):
        middle = sqrt(low * high)
        if problem.solve(plant.stays(middle)) is None:
            low = middle
        else:
            high, frames = middle, problem.frames()
    return Point(gains, plant.whole(high), frames)


def descended(plant: GainPlant, point: Point, caps: Mapping[str, float]) -> Point:
    """Return where the steps end; each proved a shorter dwell time than the one before."""
    radius, slow = FIRST, 0
    for _ in range(STEPS):
        if radius < SMALLEST or slow == 3 or point.dwell <= plant.shortest:
            break
        found, bold = _step(plant, point, caps, radius)
        if found is None:
            radius /= 3
            continue
        slow = slow + 1 if found.dwell > point.dwell * (1 - SLOW) else 0
        radius = min(2 * radius, LARGEST) if bold else radius
        point = found
    return point


def _step(plant: GainPlant, point: Point, caps: Mapping[str, float], radius: float) -> tuple[Point | None, bool]:
    """The next point and whether all that was expected of it came true; None where no part of it did."""
    wish = proposed(plant, point, caps, radius)
    if wish is None:
        return None, False
    gains = {name: _capped(gain, caps.get(name)) for name, gain in wish.gains.items()}
    problem = FormProblem(plant.loops(gains), frames=point.frames)
    dwells = [plant.shorter(point.dwell, share * wish.change) for share in SHARES]
    if plant.step is not None:
        dwells.append(point.dwell)  # several moves together may be worth a whole step
    for dwell in dwells:
        if problem.solve(plant.stays(dwell)) is not None:
            return Point(gains, dwell, problem.frames()), dwell == dwells[0]
    return None, False


def _capped(gain: FloatArray, cap: float | None) -> FloatArray:
    size = float(np.linalg.norm(gain, 2))
    return gain if cap is None or size <= cap else gain * (cap / size)


__all__ = ["Units", "codesigned", "descended", "first_point", "gain_plant"]
