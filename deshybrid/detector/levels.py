"""The relay levels of one residual generator, its debounce, and how long its transient lasts.

In: a hybrid system and one of its residual generators.  Out: a `Part` of the detector.
- Threshold of a channel: what the model states, else 1.2 times the largest |r| that the bounds allow in the own
  location, plus a floor (`thresholds`): while the plant stays, a relay that is on never goes off, and the transient
  that is left when it goes on may be a fifth of that.
- Debounce: one time constant of the slowest residual mode, at least two samples.  A residual of another location that
  changes its sign passes through the band between the thresholds; it must not take that long.  Off at once.

Cost: that of `thresholds`.  Source: Balluchi et al. (2012), section 5.1, Figure 15.
"""

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from deshybrid.detector.residual import ResidualGenerator
from deshybrid.detector.thresholds import floor, largest_state, settling_ticks, steady_bound
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.system import HybridSystem

MARGIN = 1.2
LEAST_LEVEL = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class DetectionThreshold:
    """The lower relay level of one generator per row of its residual, (q,), in units of the row's output channel.

    `steady`: the largest |r| that the bounds allow in the own location after the transient, (q,).  `guaranteed`: the
    level is above it, so that the plant's own location is never denied once the transient is over.
    """

    level: FloatArray
    steady: FloatArray
    source: Literal["stated", "derived"]
    guaranteed: bool
    reason: str


class Part(NamedTuple):
    """One generator of a detector with its levels.

    `on_ticks`: samples for which the relay is on before it counts; `covariance` (q, q) of the residual, (0, 0) where it
    is not white.
    """

    generator: ResidualGenerator
    threshold: DetectionThreshold
    on_ticks: int
    covariance: FloatArray


def build_part(system: HybridSystem, generator: ResidualGenerator) -> Part:
    """Return a generator with its levels.  Raises `UsageError` (DH0604) where the stated ones make no sense."""
    _require_threshold(system, generator)
    ticks = _on_ticks(system.observer.detector.debounce, generator)
    return Part(generator, _threshold(system, generator), ticks, np.zeros((0, 0)))


def white_part(system: HybridSystem, generator: ResidualGenerator, covariance: FloatArray) -> Part:
    """Return a generator whose residual is white, to be tested; a test needs no debounce where none is stated."""
    stated = system.observer.detector.debounce
    return Part(
        generator, _threshold(system, generator), 1 if stated is None else _on_ticks(stated, generator), covariance
    )


def settling(system: HybridSystem, part: Part) -> int | None:
    """Return the samples until a residual is below its threshold for ever, from the worst mismatch within the bounds.

    None where the bounds are missing or the threshold is not above what they allow.
    """
    mismatch = worst_mismatch(system, part.generator)
    if mismatch is None:
        return None
    return settling_ticks(part.generator, mismatch, part.threshold.level - part.threshold.steady)


def worst_mismatch(system: HybridSystem, generator: ResidualGenerator) -> FloatArray | None:
    """Return a bound on |z - T x| (k,) at the entry of the location, whenever that is; None without bounds."""
    largest = largest_state(system, generator)
    if largest is None or system.bounds.state is None:
        return None
    return np.asarray(largest + np.abs(generator.T) @ system.bounds.state)


def _require_threshold(system: HybridSystem, generator: ResidualGenerator) -> None:
    options, location = system.observer.detector, generator.location
    level, count = options.threshold.get(location.name), len(location.output_index)
    if level is not None and (level.shape != (count,) or not (level >= LEAST_LEVEL).all()):
        message = f"the detector threshold of location `{location.name}` is not {count} positive numbers"
        raise UsageError(diagnostic("DH0604", message, location.span))
    if options.release is not None and not options.release >= 1.0:
        raise UsageError(diagnostic("DH0604", f"the detector's `release` is {options.release:g}, expected at least 1"))


def _threshold(system: HybridSystem, generator: ResidualGenerator) -> DetectionThreshold:
    count = len(generator.channels)
    steady = frozen_array(steady_bound(system, generator), (count,))
    written = system.observer.detector.threshold.get(generator.location.name)
    stated = None if written is None else written[list(generator.channels)]
    missing = [name for name in ("disturbance", "measurement") if getattr(system.bounds, name) is None]
    ideal = f"; the model states no bound for {' and '.join(missing)}, taken as none" if missing else ""
    wrong = ", ".join(f"{name} {share:g}" for name, share in system.tolerance.items())
    ideal += f"; for every plant within the tolerances ({wrong})" if wrong else ""
    if stated is None:
        level = frozen_array(MARGIN * steady + floor(system, generator), (count,))
        reason = f"{MARGIN:g} times the peak gain times the bounds, plus a floor{ideal}"
        return DetectionThreshold(level, steady, "derived", True, reason)
    guaranteed = bool((stated > steady).all())
    relation = "above" if guaranteed else "not above"
    reason = f"stated by the model, {relation} what the bounds allow in the location itself{ideal}"
    return DetectionThreshold(frozen_array(stated, (count,)), steady, "stated", guaranteed, reason)


def _on_ticks(debounce: float | None, generator: ResidualGenerator) -> int:
    if debounce is not None:
        return max(1, math.ceil(debounce / generator.step - 1e-9))
    return max(2, math.ceil(generator.time_constant / generator.step - 1e-9))


__all__ = ["DetectionThreshold", "Part", "build_part", "settling", "white_part", "worst_mismatch"]
