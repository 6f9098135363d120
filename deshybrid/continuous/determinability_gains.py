"""Gains on the observable part, where locations rely on each other for what they do not see.

In: a system, its persistent locations, and the shortest and longest stay in each of them.  Out: `ObserverGains` with
G_i = T'^O_i G^O_i, so that x̂^N runs open loop: the observer (20) to (21) of the paper in the coordinates of the plant.
What the model says of a location (`gains`, `poles`) comes first; else its poles lie at -s, -1.15 s, ... with s a
multiple of one over its shortest stay.  The multiple is the least on a ladder whose error map, in the mean square over
the ends of the stays, takes away five sixths with every switch or is within a tenth of the best: faster gains would
amplify noise and determine little more.

Cost: ten placements a location and as many evaluations of the mean-square growth.

Source: Balluchi et al. (2003), (20) to (21); the speed α_F of (18).
"""

from collections.abc import Mapping

import numpy as np

from deshybrid.continuous.checks import gain_problems, is_detectable, require_positive, spread_warning, unplaced_warning
from deshybrid.continuous.determinability_contraction import Box, Stay, mean_square_growth
from deshybrid.continuous.determinability_coordinates import kalman_coordinates
from deshybrid.continuous.error import dynamics_of, error_dynamics, state_scale
from deshybrid.continuous.gains import FoundGain, GainPlan, ObserverGains, analysed, default_rate
from deshybrid.continuous.placement import output_rank, place_detectable, placeable, spread_poles
from deshybrid.continuous.search import from_plane_s, to_plane_s
from deshybrid.diagnostics import Diagnostic, GainError, raise_all
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.observability import KalmanSplit, kalman_split, sorted_spectrum
from deshybrid.model.system import HybridSystem

RUNGS = 12
RATIO = 1.6
APART = 1.15
GOOD = 1.1
ENOUGH = 1 / 6


def relies_on_others(system: HybridSystem, locations: tuple[str, ...]) -> bool:
    """Return whether some location is not detectable: its error grows or stays, whatever its gain."""
    splits = {name: kalman_split(dynamics_of(system, name).A, dynamics_of(system, name).C) for name in locations}
    return not all(is_detectable(system, name, split) for name, split in splits.items())


def sojourn_box(
    system: HybridSystem, locations: tuple[str, ...], dwell: float | None = None
) -> Mapping[str, Stay] | None:
    """Return the shortest and longest stay (s) of each location, None where one of them states no longest.

    The shortest is `dwell` where given, else the location's own, else the observer's, else zero.
    """
    require_positive("dwell time", dwell)
    stays = {}
    for name in locations:
        own = system.location(name).dwell
        low = dwell if dwell is not None else own.min if own.min is not None else system.observer.dwell or 0.0
        if own.max is None:
            return None
        stays[name] = min(low, own.max), own.max
    return stays


def stated_coordinates(system: HybridSystem, name: str) -> KalmanSplit:
    """Return the location in the model's `observer: coordinates`, or in those of its own choice."""
    dynamics = dynamics_of(system, name)
    return kalman_coordinates(dynamics.A, dynamics.C, system.observer.coordinates.get(name))


def determinable_gains(
    system: HybridSystem, locations: tuple[str, ...], stays: Mapping[str, Stay], *, rate: float | None = None
) -> ObserverGains:
    """Return gains on the observable part of every location; stays (s) by location.

    rate (1/s) is what is asked of the error over many rounds; it is not certified here.  Raises `GainError` (DH0505,
    DH0507) for poles or gains of the model that do not fit, `UsageError` (DH0520) for coordinates that do not.

    >>> from deshybrid.model.load import load
    >>> system = load("models/balluchi2003/three_locations.yaml")
    >>> made = determinable_gains(system, ("q1", "q2", "q3"), dict.fromkeys(("q1", "q2", "q3"), (1.5, 7.0)))
    >>> made.fixed_modes["q3"].real.round(6).tolist()
    [0.005, -0.01]
    """
    require_positive("rate", rate)
    splits = {name: _uncoupled(stated_coordinates(system, name)) for name in locations}
    raise_all([p for n in locations for p in gain_problems(system, n, splits[n], alone=False)], GainError)
    low = min((stay[0] for stay in stays.values()), default=0.0)
    asked = default_rate(system, locations, low or None) if rate is None else rate
    plan = GainPlan(system, splits, state_scale(system, locations), asked, asked, low or None, low or 1 / asked)
    ladder = [found for k in range(RUNGS) if (found := _rung(plan, stays, 1.25 * RATIO**k)) is not None]
    sizes = [_growth(plan, found, stays) for found in ladder]
    enough = max(GOOD * min(sizes), ENOUGH)
    chosen = next(found for found, size in zip(ladder, sizes, strict=True) if size <= enough)
    return analysed(plan, chosen, "place")


def _uncoupled(split: KalmanSplit) -> KalmanSplit:
    """The same coordinates without A^P, so that the gain of the unobservable part becomes zero."""
    return KalmanSplit(split.transform, split.inverse, split.A_o, split.C_o, split.A_u, np.zeros_like(split.coupling))


def _rung(plan: GainPlan, stays: Mapping[str, Stay], multiple: float) -> dict[str, FoundGain] | None:
    """All gains with poles this many times faster than the stays are short; None where they cannot be placed."""
    try:
        return {name: _gain(plan, name, multiple / (stays[name][0] or stays[name][1])) for name in plan.splits}
    except GainError:
        return None


def _gain(plan: GainPlan, name: str, speed: float) -> FoundGain:
    system, split, step = plan.system, plan.splits[name], plan.system.time_step
    C, fixed = dynamics_of(system, name).C, sorted_spectrum(split.A_u)
    if name in system.observer.gains:
        return system.observer.gains[name], "model gains", ()
    if name not in system.observer.poles:
        poles = from_plane_s(np.asarray(-speed * APART ** np.arange(split.observable_dimension), complex), step)
        return place_detectable(split, poles, plan.scale), "search", ()
    wanted = np.array(system.observer.poles[name], dtype=np.complex128)
    warnings: tuple[Diagnostic, ...] = ()
    if len(wanted) > split.observable_dimension:
        wanted = placeable(wanted, to_plane_s(fixed, step))
        warnings = (unplaced_warning(system.location(name), wanted, fixed),)
    poles, changed = spread_poles(from_plane_s(wanted, step), output_rank(C, plan.scale))
    if changed:
        warnings = (*warnings, spread_warning(system.location(name), poles))
    return place_detectable(split, poles, plan.scale), "model poles", warnings


def _growth(plan: GainPlan, found: Mapping[str, FoundGain], stays: Mapping[str, Stay]) -> float:
    box = Box(error_dynamics(plan.system, {name: gain for name, (gain, _, _) in found.items()}), stays)
    ends: dict[str, tuple[FloatArray, ...]] = {
        name: tuple(box.flow(name, t) for t in stay) for name, stay in stays.items()
    }
    return mean_square_growth(box.dynamics, ends)


__all__ = ["determinable_gains", "relies_on_others", "sojourn_box", "stated_coordinates"]
