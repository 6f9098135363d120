"""The ways to gains: placed poles, filters, gains and forms together; the better of the candidates is kept.

In: a hybrid system, its persistent locations, and a method.  Out: gains, never worse than placed poles in this sense:

- `lqe`: the filter is kept unless placed poles meet the stated dwell time by (20) and it does not (any dwell time where
  none is stated), or placed poles need no longer dwell time and leave no more error variance under the same noises;
- `lmi`: the co-design starts from the placed poles, or from the filter where no gain of it is larger; no gain ends
  larger than the placed one of its location; what it finds is kept where it is certified by forms for a shorter dwell
  time than the placed poles are.

Gains and poles that the model states are taken as they are by every method.  A filter or co-design that was asked for
and is not kept leaves a warning.
"""

from dataclasses import dataclass, replace
from math import isfinite
from typing import get_args

import numpy as np

from deshybrid.continuous.codesign import codesigned
from deshybrid.continuous.conic import require_solver
from deshybrid.continuous.dwell import required_dwell
from deshybrid.continuous.error import error_dynamics, state_scale
from deshybrid.continuous.gains import Method, ObserverGains, design_gains, with_gains
from deshybrid.continuous.lmi import certify_by_inequalities, stated_stays
from deshybrid.continuous.lqe import error_variance, location_noise
from deshybrid.diagnostics import GainError, UsageError, diagnostic
from deshybrid.model.system import HybridSystem


def gains_by_method(
    system: HybridSystem,
    locations: tuple[str, ...],
    *,
    rate: float | None = None,
    dwell: float | None = None,
    delay: float = 0.0,
    method: Method = "place",
) -> ObserverGains:
    """Return the gains of `locations` by this method, or placed poles where these are better.

    Parameters and errors are those of `design_gains`; `UsageError` besides: DH0508 for a method that does not exist,
    DH0518 for `lmi` without its solver.

    >>> from deshybrid.model.load import load
    >>> made = gains_by_method(load("models/two_tank.yaml"), ("fill", "drain"), method="lqe")
    >>> made.method, dict(made.sources)
    ('lqe', {'fill': 'model poles', 'drain': 'lqe'})
    """
    if method not in get_args(Method):
        raise UsageError(diagnostic("DH0508", f"unknown method `{method}`", helps=("write place, lqe or lmi",)))
    if method == "lmi":
        require_solver()
    placed = design_gains(system, locations, rate=rate, dwell=dwell, delay=delay)
    if method == "place" or "search" not in placed.sources.values():
        return replace(placed, method=method)
    try:
        filtered = design_gains(system, locations, rate=rate, dwell=dwell, delay=delay, method="lqe")
    except GainError as error:
        if method == "lqe":
            return _kept(placed, "lqe", error.diagnostics[0].message)
        filtered = placed
    if method == "lqe":
        return _filter_or_placed(system, placed, filtered, delay)
    return _together_or_placed(system, placed, filtered, delay)


@dataclass(frozen=True, slots=True)
class _Merit:
    """What counts of a filter or placed poles: the dwell time (s) that (20) asks for, error variance, certified."""

    required: float
    variance: float
    certified: bool


def _merit(system: HybridSystem, gains: ObserverGains, delay: float) -> _Merit:
    required = required_dwell(system, gains, delay=delay)
    scale, variances = state_scale(system, gains.locations), []
    for name in gains.locations:
        noise = location_noise(system, name, scale, gains.requested_rate)
        F = gains.closed_loop[name]
        variances.append(error_variance(F, gains.gains[name], noise, scale, system.time_step))
    enough = isfinite(required) if gains.dwell is None else required <= gains.dwell
    return _Merit(required, max(variances, default=0.0), enough)


def _filter_or_placed(
    system: HybridSystem, placed: ObserverGains, filtered: ObserverGains, delay: float
) -> ObserverGains:
    old, new = _merit(system, placed, delay), _merit(system, filtered, delay)
    if old.certified and not new.certified:
        why = f"by (20) the filters need {_seconds(new.required)}, placed poles {_seconds(old.required)}"
        return _kept(placed, "lqe", why)
    if old.required <= new.required and old.variance <= new.variance and old.certified == new.certified:
        why = f"they need {_seconds(old.required)} by (20), the filters {_seconds(new.required)}, at no more variance"
        return _kept(placed, "lqe", why)
    return filtered


def _together_or_placed(
    system: HybridSystem, placed: ObserverGains, filtered: ObserverGains, delay: float
) -> ObserverGains:
    least = _shortest_stays(system, placed, delay)
    free = {name: placed.gains[name] for name, source in placed.sources.items() if source == "search"}
    starts = [placed]
    if filtered is not placed and _is_smaller(placed, filtered, tuple(free)):
        starts.append(filtered)
    best, required = placed, _required_by_forms(system, placed, delay)
    for start in starts:
        gains = codesigned(system, start.gains, free, scale=placed.scale, rate=placed.rate, least=least)
        made = with_gains(system, placed, gains, dict.fromkeys(free, "lmi"), method="lmi")
        need = _required_by_forms(system, made, delay)
        if need < required:
            best, required = made, need
    if best is not placed:
        return best
    shown = _seconds(required) if required > 0 else "any stay"
    return _kept(placed, "lmi", f"they are certified for {shown}, and nothing shorter was found")


def _is_smaller(placed: ObserverGains, filtered: ObserverGains, names: tuple[str, ...]) -> bool:
    """Whether no gain of the filters is larger than the placed one of its location, every state in its own size."""
    sizes = [
        [float(np.linalg.norm(entry.gains[name] / placed.scale[:, None], 2)) for entry in (filtered, placed)]
        for name in names
    ]
    return all(new <= old for new, old in sizes)


def _shortest_stays(system: HybridSystem, gains: ObserverGains, delay: float) -> dict[str, float]:
    return {name: max(0.0, stay - delay) for name, stay in stated_stays(system, gains.locations)[0].items()}


def _required_by_forms(system: HybridSystem, gains: ObserverGains, delay: float) -> float:
    """The dwell time (s) that forms of any affordable shape prove to be enough."""
    least, most = stated_stays(system, gains.locations)
    dynamics = error_dynamics(system, gains.gains)
    return certify_by_inequalities(dynamics, rate=gains.rate, delay=delay, least=least, most=most).required_dwell


def _kept(placed: ObserverGains, method: Method, why: str) -> ObserverGains:
    warning = diagnostic(
        "DH0519", f"placed poles are kept, as the gains of `{method}` are no better: {why}", severity="warning"
    )
    return replace(placed, method=method, warnings=(*placed.warnings, warning))


def _seconds(value: float) -> str:
    return f"{value:.4g} s" if isfinite(value) else "more than any dwell time gives"


__all__ = ["gains_by_method"]
