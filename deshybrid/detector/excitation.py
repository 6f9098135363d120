"""A proven delay: how soon a signature comes for certain, for how strong a motion of the plant.

In: a detector.  Out: for each instrumented transition p -> q and each of the `motions` of q, and of p where no reset
changes x, the least strength s for which the signature comes within the window, and the delay that is proven at full
strength.

While the plant is in q the residual of another location g is r = s ρ(k) + c(k) + (what its start, disturbance and noise
add), so that in some row

    |r| >= s |ρ(k)| - |c(k)| - |H F^k| ε - Σ_j |S_j E| w̄ - Σ_j |S_j G| v̄ - |J| v̄,

with ε the worst error at the entry that the bounds allow (for the generator of p, where no reset changes x: the worst
that is left after the dwell time) and S_j the response of plant and generator together.  The
relay and its debounce are then run on these least values: whatever the plant does, the generator of g is active at
most when this worst case is.  Its own generator, which a negation does without, is active for certain after its
transient and debounce (`levels`).  The signature comes at the first sample at which the one holds and all others are
inactive, for as long as the decision asks.  More strength never makes it later.

Assumed: the plant was in p for at least its dwell time, and named there for as long as an exclusion takes; samples are
valid; bounds hold; the transition happens at a sample, from which delays count, and there the motion is as strong as
stated; u is the motion's.  Of decisions by tests (`sprt`, `glr`) nothing is proven.
Where s = 1 is not enough, or at rest without offsets, nothing is guaranteed.  That a name is true is another matter:
`decision`.  Signatures of transitions with a discrete output are left out: their event comes first.

Cost: K products of size n + k for each pair, with K the window in samples, and K decisions a bisection.
Source: this project's; Balluchi et al. (2012), section 4.1, assumes such a delay.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deshybrid.des.automaton import Transition
from deshybrid.detector.detector import TransitionDetector
from deshybrid.detector.levels import Part, settling
from deshybrid.detector.motions import Motion, equilibrium, motions
from deshybrid.detector.pairs import alternatives
from deshybrid.detector.residual import ResidualGenerator, sampled_dynamics
from deshybrid.detector.thresholds import absolute_sum, largest_state
from deshybrid.detector.together import driven_together
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, Location

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
    >>> [found.target for found in excitations(made.detector) if found.motion.name == "rest" and found.seconds]
    ['on', 'off']
    """
    taken = [number for signature in detector.plan.signatures for number in signature.transitions]
    arcs = (detector.plan.des.transitions[number] for number in sorted(set(taken)))
    silent = [arc for arc in arcs if arc.outputs == (None,) and arc.source != arc.target]
    pairs = dict.fromkeys((arc.source, arc.target) for arc in silent)
    first = {pair: next(arc for arc in silent if (arc.source, arc.target) == pair) for pair in pairs}
    ordered = sorted(first.values(), key=lambda arc: detector.plan.des.locations.index(arc.target))
    return tuple(found for arc in ordered for found in _of_transition(detector, arc)) if detector.generators else ()


class Rival(NamedTuple):
    """Least weighted residuals of one generator, by sample and row (K, q): strength times `gain` less `loss`."""

    gain: FloatArray
    loss: FloatArray
    on_ticks: int


class Pair(NamedTuple):
    """A transition of a detector, its own part (None where its signature needs none) and those of its rivals.

    `first`: the sample from which its own generator is active for certain; `reason`: why nothing is proven.
    """

    source: Location
    target: Location
    rivals: tuple[Part, ...]
    first: int
    reason: str = ""


def _pair(detector: TransitionDetector, arc: Transition) -> Pair:
    system, names = detector.system, alternatives(detector.plan.des, arc)
    source, target = system.location(arc.source), system.location(arc.target)
    if detector.decision.is_test:
        return Pair(
            source, target, (), 0, f"how long a test takes is a matter of chance (decision `{detector.decision.kind}`)"
        )
    parts = {part.generator.location.name: part for part in _levels(detector)}
    by = {signature.location: signature.by for signature in detector.plan.signatures}
    rivals = tuple(parts[name] for name in names if name in parts)
    own = parts.get(arc.target) if by.get(arc.target) == "residual" or not _alone(detector, rivals) else None
    missing = [name for name in names if name not in parts]
    if own is None and missing:
        return Pair(source, target, rivals, 0, f"`{missing[0]}` has no residual generator")
    settled = 0 if own is None else settling(system, own)
    if settled is None or any(largest_state(system, part.generator) is None for part in rivals):
        return Pair(source, target, rivals, 0, "nothing bounds how long the transient of a residual lasts")
    return Pair(source, target, rivals, settled + (0 if own is None else own.on_ticks))


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
    before = motions(system, pair.source, entered=False) if _keeps(system, pair) else ()
    wanted = (*motions(system, pair.target), *before)
    if pair.reason:
        yield from (Excitation(arc.source, arc.target, motion, None, None, pair.reason) for motion in wanted)
        return
    for motion, rivals in zip(wanted, _rivals(detector, pair, wanted), strict=True):
        yield _proven(detector, pair, motion, rivals)


def _proven(detector: TransitionDetector, pair: Pair, motion: Motion, rivals: list[Rival]) -> Excitation:
    ends = pair.source.name, pair.target.name

    def tick(strength: float) -> int | None:
        return _detected(detector, rivals, pair.first, strength)

    full = tick(1.0)
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
    (rivals,) = _rivals(detector, pair, (excitation.motion,))
    tick = _detected(detector, rivals, pair.first, strength)
    return None if tick is None else tick * detector.step


def _keeps(system: HybridSystem, pair: Pair) -> bool:
    """Whether no transition from the source to the target changes the state."""
    arcs = (arc for arc in system.transitions if (arc.source, arc.target) == (pair.source.name, pair.target.name))
    return all(
        arc.reset is None
        or (not arc.reset.offset.any() and np.array_equal(arc.reset.matrix, np.eye(len(arc.reset.offset))))
        for arc in arcs
    )


def _detected(detector: TransitionDetector, rivals: Sequence[Rival], first: int, strength: float) -> int | None:
    """The first sample at which the own generator is active and all others have been inactive for long enough."""
    least = [(strength * rival.gain - rival.loss).max(axis=1, initial=0.0) for rival in rivals]
    inactive = [_inactive(row, rival.on_ticks, detector.release) for row, rival in zip(least, rivals, strict=True)]
    alone = len(rivals) == 1  # the location just left, whose transient is over
    needed, silent = 1 if alone else max(1, detector.decision.exclude_ticks), 0
    for k in range(detector.window_ticks + 1):
        silent = silent + 1 if all(row[k] for row in inactive) else 0
        if silent >= needed and k >= first:
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


def _rivals(detector: TransitionDetector, pair: Pair, wanted: Sequence[Motion]) -> list[list[Rival]]:
    """By motion, by rival."""
    seen = [_seen(detector, pair, part, wanted) for part in pair.rivals]
    return [[rivals[number] for rivals in seen] for number in range(len(wanted))]


def _seen(detector: TransitionDetector, pair: Pair, part: Part, wanted: Sequence[Motion]) -> list[Rival]:
    """What the generator of `part` shows at least while the plant of the target moves, by motion, by sample."""
    system, generator, dynamics = detector.system, part.generator, pair.target.dynamics
    samples, q = detector.window_ticks + 1, len(generator.channels)
    shown, loss = np.zeros((samples, q, len(wanted) + 1)), np.zeros((samples, q))
    joint = driven_together(system, generator, pair.target)
    if joint is not None and dynamics is not None:
        row, moved = joint
        n, k = len(dynamics.A), len(generator.F)
        starts = _starts(system, generator, dynamics, wanted)
        error, (held, smeared), noise = (
            _error(system, pair, part),
            _pushed(system, dynamics, generator),
            _noise(part, system),
        )
        added = np.abs(generator.J) @ noise
        for tick in range(generator.lag, samples):
            shown[tick] = np.abs(row @ starts)
            loss[tick] = np.abs(row[:, n : n + k]) @ error + added
            added = added + np.abs(row[:, :n] @ held).sum(axis=1) + np.abs(row[:, :n]) @ smeared
            added = added + np.abs(row[:, n : n + k] @ generator.gain) @ noise
            row = row @ moved
    level = part.threshold.level
    found = []
    for number, motion in enumerate(wanted):
        known = shown[:, :, -1] * (-1.0 if motion.kind == "rest" else 1.0)
        found.append(Rival(shown[:, :, number] / level, (loss + known) / level, part.on_ticks))
    return found


def _starts(
    system: HybridSystem, generator: ResidualGenerator, dynamics: LinearDynamics, wanted: Sequence[Motion]
) -> FloatArray:
    """Columns of (x, z, u, 1): the motions, and last where the known offsets leave the state at rest."""
    offset, T, m = equilibrium(system, dynamics), generator.T, len(system.input_names)
    columns = [np.concatenate([motion.state, T @ motion.state, motion.input, [0.0]]) for motion in wanted]
    return np.column_stack([*columns, np.concatenate([offset, T @ offset, np.zeros(m), [1.0]])])


def _noise(part: Part, system: HybridSystem) -> FloatArray:
    channels = list(part.generator.location.output_index)
    return np.zeros(len(channels)) if system.bounds.measurement is None else system.bounds.measurement[channels]


def _error(system: HybridSystem, pair: Pair, part: Part) -> FloatArray:
    """The worst error (k,) of a rival's generator at the first sample in the target."""
    worst = _worst_error(system, part.generator)
    settled = part.generator.location.name == pair.source.name and _keeps(system, pair)
    return _error_left(system, part, worst) if settled else worst


def _worst_error(system: HybridSystem, generator: ResidualGenerator) -> FloatArray:
    largest = largest_state(system, generator)
    if largest is None or system.bounds.state is None:
        return np.full(len(generator.F), np.inf)
    return np.asarray(largest + np.abs(generator.T) @ system.bounds.state)


def _error_left(system: HybridSystem, part: Part, worst: FloatArray) -> FloatArray:
    """The worst error (k,) of a generator whose location the plant has been in for the dwell time."""
    generator, noise = part.generator, _noise(part, system)
    dwell = generator.location.dwell.min or system.observer.dwell
    if dwell is None:
        return worst
    held, smeared = _pushed(system, generator.dynamics, generator)
    pushed = [np.abs(generator.gain) @ noise, np.abs(generator.T @ held).sum(axis=1), np.abs(generator.T) @ smeared]
    steady = absolute_sum(generator.F, np.eye(len(generator.F)), np.eye(len(generator.F))) @ np.sum(pushed, axis=0)
    samples = max(0, int(dwell / generator.step) - generator.lag)
    return np.asarray(np.minimum(worst, steady + np.abs(np.linalg.matrix_power(generator.F, samples)) @ worst))


def _pushed(
    system: HybridSystem, dynamics: LinearDynamics, generator: ResidualGenerator
) -> tuple[FloatArray, FloatArray]:
    """What the disturbance does in a step: columns (n, r) for one that is held, (n,) for one that varies in between."""
    bound = system.bounds.disturbance
    if bound is None:
        return np.zeros((len(dynamics.A), 0)), np.zeros(len(dynamics.A))
    held = sampled_dynamics(system, dynamics, generator.step).E * bound
    if system.time_step is not None:
        return held, np.zeros(len(dynamics.A))
    from scipy.linalg import expm

    rising = expm(np.abs(dynamics.A) * generator.step) - np.eye(len(dynamics.A))
    return held, generator.step * rising @ np.abs(dynamics.E) @ bound


__all__ = ["Excitation", "excitation_lines", "excitations", "proven_seconds"]
