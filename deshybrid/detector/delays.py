"""What the delay of a detector is: a bound per signature, the window in which a signature is waited for, a warning.

- Detection delay of a signature by residual: the time after which its generator is active for certain, from the worst
  mismatch that the bounds allow.  The signature itself also waits until the residuals of the alternatives are large; at
  x = 0, u = 0 they are not, so that the bound is conditional on excitation, and the condition is kept as text.
  A negation fires when the others' residuals have become large, so it has no bound without excitation.
- Window Δ: how long an entry estimate stays provisional; the model's, else the largest finite detection delay, else a
  nominal one, which guarantees nothing: a transient from ten times the full scale down to the threshold, at least three
  time constants, and the debounce.

In: a plan and the parts of the detector by location.  Out: `DetectionDelay`s, seconds, a diagnostic.
Source: Balluchi et al. (2012), sections 4.1 and 5.1.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from deshybrid.des.signatures import Signature, SignaturePlan
from deshybrid.detector.bank import assumed_window
from deshybrid.detector.candidates import alternatives
from deshybrid.detector.decision import DecisionDesign
from deshybrid.detector.levels import Part, settling
from deshybrid.detector.thresholds import full_scale, largest_state
from deshybrid.diagnostics import Diagnostic, diagnostic
from deshybrid.model.system import HybridSystem

NOMINAL_TRANSIENT = 10.0  # in units of the full scale
LEAST_TIME_CONSTANTS = 3.0


@dataclass(frozen=True, slots=True)
class DetectionDelay:
    """Seconds after which a signature's generator is active for certain, or None with the reason.

    It holds while every sample is valid and the model's bounds hold.
    `condition` says what must hold besides, for the signature to appear by then; empty where nothing must.
    """

    seconds: float | None
    reason: str
    condition: str = ""


def detection_delays(
    system: HybridSystem, plan: SignaturePlan, parts: Mapping[str, Part], decision: DecisionDesign
) -> dict[str, DetectionDelay]:
    """Return the delay of each signature by its location; none without parts, whose signatures come as events."""
    return {s.location: _delay(system, plan, s, parts, decision) for s in plan.signatures} if parts else {}


def delay_warnings(
    delays: Mapping[str, DetectionDelay], window: float, decision: DecisionDesign
) -> tuple[Diagnostic, ...]:
    """Return the warning (DH0609) of what Theorem 7 assumes of the signatures; none where all of it is guaranteed."""
    open_ends: dict[str, list[str]] = {}
    for name, delay in delays.items():
        if delay.seconds is None or delay.seconds > window:
            reason = delay.reason if delay.seconds is None else f"its bound is {delay.seconds:g} s"
            open_ends.setdefault(reason, []).append(f"`{name}`")
    conditional = any(delay.condition for delay in delays.values())
    if not open_ends and not conditional:
        return ()
    notes = [f"{', '.join(names)}: {reason}" for reason, names in open_ends.items()]
    if conditional:
        notes.append(
            "a signature waits until the residuals of the other locations are large, which motion has to bring about"
        )
        if decision.kind != "exclusion":
            notes.append(
                "where the residual of a wrong location becomes small, its signature is false; no proof excludes that"
            )
    message = f"the certificates with a delay assume that every signature comes within {window:g} s"
    helps = (
        "simulate the plant and run the observer on it before you trust it: `deshybrid simulate`, `deshybrid run`",
    )
    return (diagnostic("DH0609", message, notes=tuple(notes), helps=helps, severity="warning"),)


def _delay(
    system: HybridSystem,
    plan: SignaturePlan,
    signature: Signature,
    parts: Mapping[str, Part],
    decision: DecisionDesign,
) -> DetectionDelay:
    rivals = _rivals(plan, signature, tuple(parts))
    shown = ", ".join(f"`{name}`" for name in rivals)
    excitation = f"the residuals of {shown} must have left their release level, which needs x or u away from rest"
    if decision.kind == "imm":
        reason = "interacting filters are sure after a random number of samples, which has no bound"
        return DetectionDelay(None, reason, excitation if rivals else "")
    if signature.by == "negation":
        reason = "a negation appears when the other residuals become large; nothing bounds that time at x = 0, u = 0"
        return DetectionDelay(None, reason, excitation if rivals else "")
    if decision.is_test:
        reason = "a test of the residual accepts after a random number of samples, which has no bound"
        return DetectionDelay(None, reason, excitation if rivals else "")
    part = parts[signature.location]
    generator, on_ticks = part.generator, part.on_ticks
    if system.bounds.state is None or largest_state(system, generator) is None:
        return DetectionDelay(None, "the model states no bounds on state and input, so the mismatch has none")
    ticks = settling(system, part)
    if ticks is None:
        return DetectionDelay(None, "the threshold is not above the residual that the bounds allow")
    reason = f"transient from the worst mismatch ({ticks} samples), debounce ({on_ticks} samples)"
    lasts = max(ticks + on_ticks, decision.exclude_ticks)
    if lasts > ticks + on_ticks:
        reason = f"the alternatives are excluded for as long as any transient lasts ({lasts} samples)"
    return DetectionDelay(lasts * generator.step, reason, excitation if rivals else "")


def _rivals(plan: SignaturePlan, signature: Signature, generators: tuple[str, ...]) -> tuple[str, ...]:
    """The alternatives of the instrumented transitions that have a residual: the signature waits for these."""
    arcs = (plan.des.transitions[number] for number in signature.transitions)
    others = {name for arc in arcs for name in alternatives(plan.des, arc)}
    return tuple(name for name in generators if name in others and name != signature.location)


def _nominal_delay(system: HybridSystem, part: Part) -> float:
    generator, threshold, on_ticks, _ = part
    ratio = float(np.max(NOMINAL_TRANSIENT * full_scale(system, generator) / threshold.level))
    time_constants = max(LEAST_TIME_CONSTANTS, math.log(max(ratio, 1.0)))
    return time_constants * generator.time_constant + on_ticks * generator.step


def waiting_window(
    system: HybridSystem, delays: Mapping[str, DetectionDelay], parts: Mapping[str, Part], decision: DecisionDesign
) -> tuple[float, str]:
    """Return the window Δ in seconds and where it comes from; it is no shorter than the time of exclusion."""
    if decision.kind == "imm" and system.observer.detector.window is None:
        return assumed_window(system), "half of the shortest stay, assumed"
    least = max((decision.exclude_ticks * part.generator.step for part in parts.values()), default=0.0)
    if decision.is_test and system.observer.detector.window is None:
        return least, "the time in which the transient of an entry fades"
    window, reason = _stated_or_derived(system, delays, parts)
    if window >= least:
        return window, reason
    return least, f"as long as an exclusion takes, which is longer than what was {reason}"


def _stated_or_derived(
    system: HybridSystem, delays: Mapping[str, DetectionDelay], parts: Mapping[str, Part]
) -> tuple[float, str]:
    stated = system.observer.detector.window
    if stated is not None:
        return stated, "stated by the model"
    finite = [delay.seconds for delay in delays.values() if delay.seconds is not None]
    if finite:
        return max(finite), "the largest detection delay"
    nominal = max((_nominal_delay(system, part) for part in parts.values()), default=0.0)
    return nominal, "nominal: no detection delay has a bound"


__all__ = ["DetectionDelay", "delay_warnings", "detection_delays", "waiting_window"]
