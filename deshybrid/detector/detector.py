"""The transition detector T_H: residual generators, relays with hysteresis, debounce, and what its delay is.

In: a hybrid system, the `SignaturePlan` that says which locations need a residual generator, a rate and a step.
Out: a `TransitionDetector` whose every number is either the model's or derived here, with the reason kept.

- Poles for relays and exclusion: the model's, else the default ones (`residual`), made faster until the guaranteed
  delay is half the dwell time.  Tests need white residuals (`innovation`).
- Levels and debounce of a generator: `levels`.  Release: what a demanded rate of false alarms needs (`chatter`), else
  1.5 times the threshold; 1 for exclusion, whose threshold is above what the bounds allow already.
- How residuals become decisions: `decision`.  How long that takes: `delays`.

Source: Balluchi et al. (2012), sections 4.1 and 5.1, Figure 15.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType

from deshybrid.des.signatures import SignaturePlan
from deshybrid.detector.bank import bank_parts, build_bank, shortest_stay
from deshybrid.detector.chatter import hysteresis
from deshybrid.detector.decision import TESTS, DecisionDesign, design_decision, judged_locations, wanted_decision
from deshybrid.detector.delays import DetectionDelay, delay_warnings, detection_delays, waiting_window
from deshybrid.detector.designs import design_generator, white_design
from deshybrid.detector.levels import DetectionThreshold, Part, build_part, settling, white_part
from deshybrid.detector.residual import ResidualGenerator
from deshybrid.diagnostics import Diagnostic, GainError, UsageError, diagnostic, raise_all
from deshybrid.model.system import Decision, HybridSystem, Location

RELEASE = 1.5
FASTEST_SPEED = 64.0


@dataclass(frozen=True, slots=True, eq=False)
class TransitionDetector:
    """T_H; `generators`, `thresholds`, `on_ticks` and `off_ticks` go together.

    Those of `plan.generators` come first, then others that the decision needs.  `delays` by location of a signature;
    `window` in seconds, `window_reason` says where it comes from.
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
    decision: DecisionDesign

    @property
    def detection_delay(self) -> Mapping[str, float | None]:
        """Seconds by location of a signature, None where no bound exists; `delays` says why, and on which condition."""
        return MappingProxyType({location: delay.seconds for location, delay in self.delays.items()})

    @property
    def window_ticks(self) -> int:
        """The window in samples, at least one."""
        return max(1, math.ceil(self.window / self.step - 1e-9))

    @property
    def warnings(self) -> tuple[Diagnostic, ...]:
        """The warning (DH0609) of what Theorem 7 assumes of the signatures; none where all of it is guaranteed."""
        return delay_warnings(self.delays, self.window, self.decision)

    def __str__(self) -> str:
        names = ", ".join(generator.location.name for generator in self.generators) or "no location"
        how = f"window {self.window:.3g} s, decision by {self.decision.kind}"
        return f"transition detector of {self.system.name}: residuals of {names}, {how}"


def build_detector(
    system: HybridSystem, plan: SignaturePlan, *, rate: float | None, step: float, dwell: float | None = None
) -> TransitionDetector:
    """Return the transition detector of a plan; rate in 1/s, step and dwell in seconds.

    Without generators in the plan (nothing to detect, or a purely discrete model, whose signatures come as events) the
    detector is empty.

    Raises `UsageError`: DH0601 step, DH0602 poles, DH0604 thresholds, DH0603 for a location that measures nothing; all
    generators are looked at before anything is raised.  DH0610 for a signature of several locations, DH0614 for a
    stated decision that cannot be had.

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
    transition detector of pump: residuals of on, window 2.5 s, decision by relay
    """
    _require_step(system, step)
    dwell = shortest_stay(system) if dwell is None else dwell
    wish = wanted_decision(system)
    bank = build_bank(system, step=step) if wish.kind == "imm" and not system.is_discrete and plan.signatures else None
    parts = (
        _parts(system, plan, wish.kind, rate=rate, step=step, dwell=dwell) if bank is None else bank_parts(system, bank)
    )
    decision = design_decision(system, wish, parts, dwell=dwell, bank=bank)
    kept = (
        parts
        if decision.kind == wish.kind
        else tuple(part for part in parts if part.generator.location.name in plan.generators)
    )
    return _assembled(system, plan, step, kept, decision)


def _parts(
    system: HybridSystem,
    plan: SignaturePlan,
    kind: Decision,
    *,
    rate: float | None,
    step: float,
    dwell: float | None,
) -> tuple[Part, ...]:
    """The generators that a decision needs, with their levels; all problems are raised together."""
    if system.is_discrete or not plan.signatures:
        return ()
    problems: list[Diagnostic] = list(_covering(plan))
    parts = []
    for name in () if problems else judged_locations(system, plan.generators, kind):
        try:
            location = system.location(name)
            if kind in TESTS:
                parts.append(white_part(system, *white_design(system, location, step)))
            else:
                parts.append(_fast_enough(system, location, rate=rate, dwell=dwell, step=step))
        except (UsageError, GainError) as error:
            problems += error.diagnostics
    raise_all(problems, UsageError)
    return tuple(parts)


def _covering(plan: SignaturePlan) -> Iterator[Diagnostic]:
    for signature in plan.signatures:
        if signature.covers:
            text = f"signature `{signature.name}` announces several locations, which no residual generator does"
            helps = ("leave the detector out of `signatures`, or model the plant without continuous state",)
            yield diagnostic("DH0610", text, helps=helps)


def _fast_enough(
    system: HybridSystem, location: Location, *, rate: float | None, dwell: float | None, step: float
) -> Part:
    """Double the default poles' speed until the guaranteed delay takes half the dwell time, or nothing is gained."""
    best, shortest, speed = None, math.inf, 1.0
    while True:
        part = build_part(system, design_generator(system, location, rate=rate, dwell=dwell, step=step, speed=speed))
        if dwell is None or location.name in system.observer.detector.poles:
            return part
        ticks = settling(system, part)
        lasts = math.inf if ticks is None else (ticks + part.on_ticks) * step
        if best is None or lasts < shortest:
            best, shortest = part, lasts
        if shortest <= dwell / 2.0 or speed >= FASTEST_SPEED:
            return best
        speed *= 2.0


def _assembled(
    system: HybridSystem, plan: SignaturePlan, step: float, parts: tuple[Part, ...], decision: DecisionDesign
) -> TransitionDetector:
    by_name = {part.generator.location.name: part for part in parts}
    delays = detection_delays(system, plan, by_name, decision)
    window, reason = waiting_window(system, delays, by_name, decision)
    return TransitionDetector(
        system=system,
        plan=plan,
        step=step,
        generators=tuple(part.generator for part in parts),
        thresholds=tuple(part.threshold for part in parts),
        release=_release(system, parts, decision),
        on_ticks=tuple(part.on_ticks for part in parts),
        off_ticks=(1,) * len(parts),
        delays=MappingProxyType(delays),
        window=window or step,
        window_reason=reason,
        decision=decision,
    )


def _release(system: HybridSystem, parts: tuple[Part, ...], decision: DecisionDesign) -> float:
    """What the model states, else what its rate of false alarms needs, else what is usual for the decision."""
    stated, is_relay = system.observer.detector.release, decision.kind == "relay"
    if not is_relay or not decision.false_alarm or not parts:
        return (RELEASE if is_relay else 1.0) if stated is None else stated
    needed = max(hysteresis(system, part, decision.false_alarm) for part in parts)
    if stated is not None and stated < needed:
        text = f"the detector's `release` is {stated:g}, and noise would switch relays more often than `false_alarm`"
        helps = (f"leave `release` out, or write {math.ceil(1000 * needed) / 1000:g} at least",)
        raise UsageError(diagnostic("DH0604", text, helps=helps))
    return needed if stated is None else stated


def _require_step(system: HybridSystem, step: float) -> None:
    if not (math.isfinite(step) and step > 0.0):
        raise UsageError(diagnostic("DH0601", f"the step is {step:g} s, expected a positive number"))
    if system.time_step is not None and not math.isclose(step, system.time_step):
        message = f"the step is {step:g} s, but the model is in discrete time with a step of {system.time_step:g} s"
        raise UsageError(diagnostic("DH0601", message))


__all__ = ["TransitionDetector", "build_detector"]
