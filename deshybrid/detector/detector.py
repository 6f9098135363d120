"""The transition detector T_H: residual generators, relays with hysteresis, debounce, and what its delay is.

In: a hybrid system, the `SignaturePlan` that says which locations need a residual generator, a rate and a step.
Out: a `TransitionDetector` whose every number is either the model's or derived here, with the reason kept.

- Poles: the model's, else the default ones (`residual`), made faster until the guaranteed delay is half the dwell time.
- Threshold of a channel: what the model states, else 1.2 times the largest |r| that the bounds allow in the own
  location, plus a floor (`thresholds`): while the plant stays, a relay that is on never goes off, and the transient
  that is left when it goes on may be a fifth of that.
- Release: 1.5 times the threshold.
- Debounce: one time constant of the slowest residual mode, at least two samples.  A residual of another location that
  changes its sign passes through the band between the thresholds; it must not take that long.  Off at once.
- Window Δ: how long an entry estimate stays provisional; the model's, else the largest finite detection delay, else a
  nominal one, which guarantees nothing: a transient from ten times the full scale down to the threshold, at least three
  time constants, and the debounce.
- Detection delay of a signature by residual: the time after which its generator is active for certain, from the worst
  mismatch that the bounds allow.  The signature itself also waits until the residuals of the alternatives are large; at
  x = 0, u = 0 they are not, so that the bound is conditional on excitation, and the condition is kept as text.
  A negation fires when the others' residuals have become large, so it has no bound without excitation.

Source: Balluchi et al. (2012), sections 4.1 and 5.1, Figure 15.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal

import numpy as np

from deshybrid.des.signatures import Signature, SignaturePlan
from deshybrid.detector.candidates import alternatives
from deshybrid.detector.residual import ResidualGenerator, build_generator
from deshybrid.detector.thresholds import floor, full_scale, largest_state, settling_ticks, steady_bound
from deshybrid.diagnostics import Diagnostic, GainError, UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.system import HybridSystem, Location

RELEASE = 1.5
MARGIN = 1.2
FASTEST_SPEED = 64.0
NOMINAL_TRANSIENT = 10.0  # in units of the full scale
LEAST_TIME_CONSTANTS = 3.0
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


@dataclass(frozen=True, slots=True)
class DetectionDelay:
    """Seconds after which a signature's generator is active for certain, or None with the reason.

    It holds while every sample is valid and the model's bounds hold.
    `condition` says what must hold besides, for the signature to appear by then; empty where nothing must.
    """

    seconds: float | None
    reason: str
    condition: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TransitionDetector:
    """T_H; `generators`, `thresholds`, `on_ticks` and `off_ticks` go together, in the order of `plan.generators`.

    `delays` by location of a signature; `window` in seconds, `window_reason` says where it comes from.
    """

    system: HybridSystem
    plan: SignaturePlan
    step: float
    generators: tuple[ResidualGenerator, ...]
    thresholds: tuple[DetectionThreshold, ...]
    release: float
    on_ticks: tuple[int, ...]
    off_ticks: tuple[int, ...]
    delays: Mapping[str, DetectionDelay]
    window: float
    window_reason: str

    @property
    def detection_delay(self) -> Mapping[str, float | None]:
        """Seconds by location of a signature, None where no bound exists; `delays` says why, and on which condition."""
        return MappingProxyType({location: delay.seconds for location, delay in self.delays.items()})

    @property
    def window_ticks(self) -> int:
        """The window in samples, at least one."""
        return max(1, math.ceil(self.window / self.step - 1e-9))

    def __str__(self) -> str:
        names = ", ".join(generator.location.name for generator in self.generators) or "no location"
        return f"transition detector of {self.system.name}: residuals of {names}, window {self.window:.3g} s"


def build_detector(
    system: HybridSystem, plan: SignaturePlan, *, rate: float | None, step: float, dwell: float | None = None
) -> TransitionDetector:
    """Return the transition detector of a plan; rate in 1/s, step and dwell in seconds.

    Without generators in the plan (nothing to detect, or a purely discrete model, whose signatures come as events) the
    detector is empty.

    Raises `UsageError`: DH0601 step, DH0602 poles, DH0604 thresholds, DH0603 for a location that measures nothing; all
    generators are looked at before anything is raised.  DH0610 for a signature of several locations.

    >>> from deshybrid.des.signatures import recover_observability
    >>> from deshybrid.detector.candidates import signature_candidates
    >>> from deshybrid.model.abstraction import abstract
    >>> from deshybrid.model.load import loads
    >>> system = loads('''
    ... {format: deshybrid/1, name: pump, state: [h], output: [y], defaults: {C: [[1]]},
    ...  locations: {on: {A: [[-1]], f: [2]}, off: {A: [[-1]]}},
    ...  transitions: [{from: on, to: off, event: a, emits: null}, {from: off, to: on, event: b, emits: null}]}
    ... ''')
    >>> des = abstract(system)
    >>> plan = recover_observability(des, tuple(entry.candidate for entry in signature_candidates(system, des)))
    >>> print(build_detector(system, plan, rate=1.0, step=0.01))
    transition detector of pump: residuals of on, window 2.5 s
    """
    _require_step(system, step)
    dwell = _shortest_stay(system) if dwell is None else dwell
    names = () if system.is_discrete else plan.generators
    problems: list[Diagnostic] = [] if system.is_discrete else list(_covering(plan))
    generators = []
    for name in () if problems else names:
        try:
            generators.append(_fast_enough(system, system.location(name), rate=rate, dwell=dwell, step=step))
            _require_threshold(system, generators[-1])
        except (UsageError, GainError) as error:
            problems += error.diagnostics
    if problems:
        raise UsageError(*problems)
    return _assembled(system, plan, step, tuple(generators))


def delay_warnings(detector: TransitionDetector) -> tuple[Diagnostic, ...]:
    """Return the warning (DH0609) of what Theorem 7 assumes of the signatures; none where all of it is guaranteed."""
    open_ends: dict[str, list[str]] = {}
    for name, delay in detector.delays.items():
        if delay.seconds is None or delay.seconds > detector.window:
            reason = delay.reason if delay.seconds is None else f"its bound is {delay.seconds:g} s"
            open_ends.setdefault(reason, []).append(f"`{name}`")
    conditional = any(delay.condition for delay in detector.delays.values())
    if not open_ends and not conditional:
        return ()
    notes = [f"{', '.join(names)}: {reason}" for reason, names in open_ends.items()]
    if conditional:
        notes.append(
            "a signature waits until the residuals of the other locations are large, which motion has to bring about"
        )
        notes.append(
            "where the residual of a wrong location becomes small, its signature is false; no proof excludes that"
        )
    message = f"the certificates with a delay assume that every signature comes within {detector.window:g} s"
    helps = (
        "simulate the plant and run the observer on it before you trust it: `deshybrid simulate`, `deshybrid run`",
    )
    return (diagnostic("DH0609", message, notes=tuple(notes), helps=helps, severity="warning"),)


def _covering(plan: SignaturePlan) -> Iterator[Diagnostic]:
    for signature in plan.signatures:
        if signature.covers:
            text = f"signature `{signature.name}` announces several locations, which no residual generator does"
            helps = ("leave the detector out of `signatures`, or model the plant without continuous state",)
            yield diagnostic("DH0610", text, helps=helps)


def _fast_enough(
    system: HybridSystem, location: Location, *, rate: float | None, dwell: float | None, step: float
) -> ResidualGenerator:
    """Double the default poles' speed until the guaranteed delay takes half the dwell time, or nothing is gained."""
    best, shortest, speed = None, math.inf, 1.0
    while True:
        generator = build_generator(system, location, rate=rate, dwell=dwell, step=step, speed=speed)
        if dwell is None or location.name in system.observer.detector.poles:
            return generator
        ticks = _settling(system, generator, _threshold(system, generator))
        lasts = math.inf if ticks is None else (ticks + _on_ticks(system.observer.detector.debounce, generator)) * step
        if best is None or lasts < shortest:
            best, shortest = generator, lasts
        if shortest <= dwell / 2.0 or speed >= FASTEST_SPEED:
            return best
        speed *= 2.0


def _settling(system: HybridSystem, generator: ResidualGenerator, threshold: DetectionThreshold) -> int | None:
    """Samples until the residual is below its threshold for ever, from the worst mismatch that the bounds allow."""
    largest = largest_state(system, generator)
    if largest is None or system.bounds.state is None:
        return None
    mismatch = largest + np.abs(generator.T) @ system.bounds.state
    return settling_ticks(generator, mismatch, threshold.level - threshold.steady)


def _assembled(
    system: HybridSystem, plan: SignaturePlan, step: float, generators: tuple[ResidualGenerator, ...]
) -> TransitionDetector:
    options = system.observer.detector
    thresholds = tuple(_threshold(system, generator) for generator in generators)
    on_ticks = tuple(_on_ticks(options.debounce, generator) for generator in generators)
    parts = {g.location.name: (g, t, ticks) for g, t, ticks in zip(generators, thresholds, on_ticks, strict=True)}
    delays = {s.location: _delay(system, plan, s, parts) for s in plan.signatures} if generators else {}
    nominal = max((_nominal_delay(system, *part) for part in parts.values()), default=0.0)
    window, reason = _window(options.window, delays, nominal)
    return TransitionDetector(
        system=system,
        plan=plan,
        step=step,
        generators=generators,
        thresholds=thresholds,
        release=RELEASE if options.release is None else options.release,
        on_ticks=on_ticks,
        off_ticks=(1,) * len(generators),
        delays=MappingProxyType(delays),
        window=window or step,
        window_reason=reason,
    )


def _require_step(system: HybridSystem, step: float) -> None:
    if not (math.isfinite(step) and step > 0.0):
        raise UsageError(diagnostic("DH0601", f"the step is {step:g} s, expected a positive number"))
    if system.time_step is not None and not math.isclose(step, system.time_step):
        message = f"the step is {step:g} s, but the model is in discrete time with a step of {system.time_step:g} s"
        raise UsageError(diagnostic("DH0601", message))


def _shortest_stay(system: HybridSystem) -> float | None:
    """The dwell time that the model states, as a scale of time for the default poles."""
    stays = [location.dwell.min for location in system.locations if location.dwell.min]
    return system.observer.dwell or min(stays, default=None)


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


def _delay(
    system: HybridSystem,
    plan: SignaturePlan,
    signature: Signature,
    parts: Mapping[str, tuple[ResidualGenerator, DetectionThreshold, int]],
) -> DetectionDelay:
    rivals = _rivals(plan, signature, tuple(parts))
    shown = ", ".join(f"`{name}`" for name in rivals)
    excitation = f"the residuals of {shown} must have left their release level, which needs x or u away from rest"
    if signature.by == "negation":
        reason = "a negation appears when the other residuals become large; nothing bounds that time at x = 0, u = 0"
        return DetectionDelay(None, reason, excitation if rivals else "")
    generator, threshold, on_ticks = parts[signature.location]
    if system.bounds.state is None or largest_state(system, generator) is None:
        return DetectionDelay(None, "the model states no bounds on state and input, so the mismatch has none")
    ticks = _settling(system, generator, threshold)
    if ticks is None:
        return DetectionDelay(None, "the threshold is not above the residual that the bounds allow")
    reason = f"transient from the worst mismatch ({ticks} samples), debounce ({on_ticks} samples)"
    return DetectionDelay((ticks + on_ticks) * generator.step, reason, excitation if rivals else "")


def _rivals(plan: SignaturePlan, signature: Signature, generators: tuple[str, ...]) -> tuple[str, ...]:
    """The alternatives of the instrumented transitions that have a residual: the signature waits for these."""
    arcs = (plan.des.transitions[number] for number in signature.transitions)
    others = {name for arc in arcs for name in alternatives(plan.des, arc)}
    return tuple(name for name in generators if name in others and name != signature.location)


def _nominal_delay(
    system: HybridSystem, generator: ResidualGenerator, threshold: DetectionThreshold, on_ticks: int
) -> float:
    ratio = float(np.max(NOMINAL_TRANSIENT * full_scale(system, generator) / threshold.level))
    time_constants = max(LEAST_TIME_CONSTANTS, math.log(max(ratio, 1.0)))
    return time_constants * generator.time_constant + on_ticks * generator.step


def _window(stated: float | None, delays: Mapping[str, DetectionDelay], nominal: float) -> tuple[float, str]:
    if stated is not None:
        return stated, "stated by the model"
    finite = [delay.seconds for delay in delays.values() if delay.seconds is not None]
    if finite:
        return max(finite), "the largest detection delay"
    return nominal, "nominal: no detection delay has a bound"


__all__ = ["DetectionDelay", "DetectionThreshold", "TransitionDetector", "build_detector"]
