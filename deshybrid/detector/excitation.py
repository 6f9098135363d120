"""A proven delay: how soon a signature comes for certain, for how strong a motion of the plant.

In: a detector.  Out: for each instrumented transition p -> q and each of the `motions` of q, and of p where no reset
changes x, the least strength s for which the signature comes within the window, and the delay that is proven at full
strength.

While the plant is in q the residual of another location shows some least size at each sample (`least_residual`).  The
relay and its debounce are run on these least values: whatever the plant does, the generator of g is active at most when
this worst case is.  The delay found is then shortened by what several samples together exclude (`joint_residual`).  Its
own generator, which a negation does without, is active for certain after its transient and debounce.  The signature
comes at the first sample at which the one holds and all others are inactive, for as long as the decision asks.  More
strength never makes it later.

Assumed: the plant was in p for at least its dwell time, and named there for as long as an exclusion takes; samples are
valid; bounds hold; the transition happens at a sample, from which delays count, and there the motion is as strong as
stated; u is the motion's.  Of decisions by tests (`sprt`, `glr`) nothing is proven.
Where s = 1 is not enough, or at rest without offsets, nothing is guaranteed.  That a name is true is another matter:
`decision`.  Signatures of transitions with a discrete output are left out: their event comes first.

Cost: that of `least_residual` for each pair, K decisions a bisection with K the window in samples, and some ten linear
programs a motion.
Source: this project's; Balluchi et al. (2012), section 4.1, assumes such a delay.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deshybrid.des.automaton import Transition
from deshybrid.detector.detector import TransitionDetector
from deshybrid.detector.joint_residual import gives_up, refuted
from deshybrid.detector.least_residual import Entry, Rival, least_residuals, own_settled
from deshybrid.detector.levels import Part, settling
from deshybrid.detector.motions import Motion, motions
from deshybrid.detector.pairs import alternatives
from deshybrid.detector.thresholds import largest_state
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem

HALVINGS = 20


@dataclass(frozen=True, slots=True, eq=False)
class Excitation:
    """What is proven of one transition under one motion of its target.

    `least`: the least strength (share of full scale) for which the signature comes within the window, None where full
    strength is not enough; 0 at rest.  `seconds`: the delay that is proven at full strength.  `reason` says why there
    is none.
    """

    source: str
    target: str
    motion: Motion
    least: float | None
    seconds: float | None
    reason: str = ""

    def record(self) -> dict[str, object]:
        """Return the entry of `excitation` in the JSON of `design`."""
        return {
            "transition": [self.source, self.target],
            "motion": self.motion.kind,
            "along": self.motion.name,
            "least": self.least,
            "seconds": self.seconds,
            "reason": self.reason,
        }


def excitation_lines(found: Iterable[Excitation], window: float, dwell: float | None) -> list[str]:
    """Return what is proven of the delays, in a line for each transition; none where there is no signature.

    The first line compares the window Δ, which the certificates with a delay take, with the dwell time D (s).
    """
    by_ends: dict[tuple[str, str], list[Excitation]] = {}
    for excitation in found:
        by_ends.setdefault((excitation.source, excitation.target), []).append(excitation)
    if not by_ends:
        return []
    relation = "" if dwell is None else f", {'below' if window < dwell else 'NOT below'} the dwell time of {dwell:g} s"
    lines = [f"  signatures have {window:.3g} s to come{relation}; proven:"]
    reasons = {case.reason if case.seconds is None else "" for cases in by_ends.values() for case in cases}
    if len(reasons) == 1 and "" not in reasons:
        return [*lines, f"    nothing: {reasons.pop()}"]
    for (source, target), cases in by_ends.items():
        sure = [case for case in cases if case.seconds is not None and case.least is not None]
        slowest, least = (max((size or 0.0 for size in sizes), default=0.0) for sizes in _sizes(sure))
        proven = f"within {slowest:.3g} s at full strength, in time from {least:.2g} of it on" if sure else "nothing"
        silent = "; ".join(case.motion.name for case in cases if case.seconds is None)
        lines.append(f"    {source} -> {target}: {proven}" + (f"; not for {silent}" if sure and silent else ""))
    return lines


def _sizes(cases: Iterable[Excitation]) -> tuple[list[float | None], list[float | None]]:
    both = [(case.seconds, case.least) for case in cases]
    return [seconds for seconds, _ in both], [least for _, least in both]


def excitations(detector: TransitionDetector) -> tuple[Excitation, ...]:
    """Return what is proven of every instrumented transition that shows no discrete output, for every motion.

    >>> from deshybrid.compiler import design
    >>> from deshybrid.model.load import loads
    >>> made = design(loads('''
    ... {format: deshybrid/1, name: pump, state: [h], output: [y], disturbance: [w], defaults: {C: [[1]], E: [[1]]},
    ...  bounds: {state: 4, disturbance: 0.01, measurement: 0.01},
    ...  locations: {on: {A: [[-1]], f: [2]}, off: {A: [[-1]]}},
    ...  transitions: [{from: on, to: off, event: a}, {from: off, to: on, event: b}],
    ...  observer: {dwell: 4, step: 0.02}}
    ... '''))
    >>> [found.target for found in excitations(made.detector) if found.motion.name == "rest" and found.least == 0]
    ['on', 'off']
    """
    taken = [number for signature in detector.plan.signatures for number in signature.transitions]
    arcs = (detector.plan.des.transitions[number] for number in sorted(set(taken)))
    silent = [arc for arc in arcs if arc.outputs == (None,) and arc.source != arc.target]
    pairs = dict.fromkeys((arc.source, arc.target) for arc in silent)
    first = {pair: next(arc for arc in silent if (arc.source, arc.target) == pair) for pair in pairs}
    ordered = sorted(first.values(), key=lambda arc: detector.plan.des.locations.index(arc.target))
    return tuple(found for arc in ordered for found in _of_transition(detector, arc)) if detector.generators else ()


class Pair(NamedTuple):
    """A transition of a detector, the parts of its rivals and its own (None where its signature needs none).

    `reason`: why nothing is proven.
    """

    entry: Entry
    rivals: tuple[Part, ...] = ()
    own: Part | None = None
    reason: str = ""


class Case(NamedTuple):
    """What the rivals show at least under one motion, and from which sample on the own generator is active."""

    rivals: tuple[Rival, ...]
    first: int


def _pair(detector: TransitionDetector, arc: Transition) -> Pair:
    system, names, decision = detector.system, alternatives(detector.plan.des, arc), detector.decision
    entry = Entry(system.location(arc.source), system.location(arc.target), _keeps(system, arc))
    if decision.is_test:
        return Pair(entry, reason=f"how long a test takes is a matter of chance (decision `{decision.kind}`)")
    parts = {part.generator.location.name: part for part in _levels(detector)}
    by = {signature.location: signature.by for signature in detector.plan.signatures}
    rivals = tuple(parts[name] for name in names if name in parts)
    own = parts.get(arc.target) if by.get(arc.target) == "residual" or not _alone(detector, rivals) else None
    missing = [name for name in names if name not in parts]
    if own is None and missing:
        return Pair(entry, reason=f"`{missing[0]}` has no residual generator")
    settles = own is None or settling(system, own) is not None
    if not settles or any(largest_state(system, part.generator) is None for part in rivals):
        return Pair(entry, reason="nothing bounds how long the transient of a residual lasts")
    return Pair(entry, rivals, own)


def _levels(detector: TransitionDetector) -> Iterator[Part]:
    """The generators of a detector that compares residuals with levels."""
    unused = np.zeros((0, 0))
    for made in zip(detector.generators, detector.thresholds, detector.on_ticks, strict=True):
        yield Part(*made, unused)


def _alone(detector: TransitionDetector, rivals: tuple[Part, ...]) -> bool:
    """Whether a negation has nothing to wait for but the residual of the location just left, or decides by relays."""
    return len(rivals) == 1 or detector.decision.kind == "relay"


def _of_transition(detector: TransitionDetector, arc: Transition) -> Iterator[Excitation]:
    system, pair = detector.system, _pair(detector, arc)
    before = motions(system, pair.entry.source, entered=False) if pair.entry.keeps else ()
    wanted = (*motions(system, pair.entry.target), *before)
    if pair.reason:
        yield from (Excitation(arc.source, arc.target, motion, None, None, pair.reason) for motion in wanted)
        return
    for motion, case in zip(wanted, _cases(detector, pair, wanted), strict=True):
        yield _proven(detector, pair.entry, motion, case)


def _proven(detector: TransitionDetector, entry: Entry, motion: Motion, case: Case) -> Excitation:
    ends = entry.source.name, entry.target.name

    def tick(strength: float) -> int | None:
        return _detected(detector, case, strength)

    full = _detected(detector, case, 1.0, jointly=True)
    if full is None:
        why = "nothing moves" if motion.kind == "rest" else "the residual of another location may stay small"
        return Excitation(*ends, motion, None, None, f"{why} within {detector.window:g} s")
    if tick(0.0) is not None:
        return Excitation(*ends, motion, 0.0, full * detector.step)
    low, high = 0.0, 1.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (low, middle) if tick(middle) is not None else (middle, high)
    return Excitation(*ends, motion, high, full * detector.step)


def proven_seconds(detector: TransitionDetector, excitation: Excitation, strength: float) -> float | None:
    """Return the delay (s) that is proven of a transition under a motion of this strength at least; None for none."""
    ends = excitation.source, excitation.target
    pair = _pair(detector, next(arc for arc in detector.plan.des.transitions if (arc.source, arc.target) == ends))
    if pair.reason:
        return None
    (case,) = _cases(detector, pair, (excitation.motion,))
    tick = _detected(detector, case, strength, jointly=True)
    return None if tick is None else tick * detector.step


def _keeps(system: HybridSystem, ends: Transition) -> bool:
    """Whether no transition from the source to the target changes the state."""
    arcs = (arc for arc in system.transitions if (arc.source, arc.target) == (ends.source, ends.target))
    return all(arc.reset is None or arc.reset.changes_nothing for arc in arcs)


def _cases(detector: TransitionDetector, pair: Pair, wanted: Sequence[Motion]) -> list[Case]:
    """By motion."""
    system, samples, own = detector.system, detector.window_ticks + 1, pair.own
    seen = [least_residuals(system, pair.entry, part, wanted, samples) for part in pair.rivals]
    first = [0] * len(wanted)
    if own is not None:
        first = [settled + own.on_ticks for settled in own_settled(system, pair.entry, own, wanted)]
    return [Case(tuple(rivals[number] for rivals in seen), first[number]) for number in range(len(wanted))]


def _detected(detector: TransitionDetector, case: Case, strength: float, *, jointly: bool = False) -> int | None:
    """The first sample at which the own generator is active and all others have been inactive for long enough.

    `jointly`: what cannot be at several samples together counts too.
    """
    least = [(strength * rival.gain - rival.loss).max(axis=1, initial=0.0) for rival in case.rivals]
    inactive = [_inactive(row, rival.on_ticks, detector.release) for row, rival in zip(least, case.rivals, strict=True)]
    found = _first_silence(detector, case, inactive)
    if not jointly or found is None or found == case.first:
        return found
    if len(case.rivals) == 1:
        return gives_up(case.rivals[0], strength, detector.release, first=case.first, latest=found)
    both = zip(case.rivals, (row[: found + 1] for row in inactive), strict=True)
    return _first_silence(detector, case, [refuted(rival, row, strength, detector.release) for rival, row in both])


def _first_silence(detector: TransitionDetector, case: Case, inactive: list[list[bool]]) -> int | None:
    alone = len(case.rivals) == 1  # the location just left, whose transient is over
    needed, silent = 1 if alone else max(1, detector.decision.exclude_ticks), 0
    for k in range(min((len(row) for row in inactive), default=detector.window_ticks + 1)):
        silent = silent + 1 if all(row[k] for row in inactive) else 0
        if silent >= needed and k >= case.first:
            return k
    return None


def _inactive(least: FloatArray, on_ticks: int, release: float) -> list[bool]:
    """Relay and debounce on the least residuals: active at the entry, on whenever it may be."""
    relay = active = True
    waited, found = 0, []
    for size in least:
        relay = bool(size <= (release if relay else 1.0))
        if not relay:
            active, waited = False, 0
        elif not active:
            waited += 1
            active = waited >= on_ticks
        found.append(not active)
    return found


__all__ = ["Excitation", "excitation_lines", "excitations", "proven_seconds"]
