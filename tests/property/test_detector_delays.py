"""No detection is later than its proven bound: random plants and motions against the running observer.

Runs are random, or those that an adversary finds by linear programs (`tests.detection_adversary`), so that the latest
detection seen says how near the bounds are.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from functools import cache
from itertools import islice, product
from typing import NamedTuple, TypeAlias

import numpy as np
import pytest

from deshybrid.detector.detector import TransitionDetector, build_detector
from deshybrid.detector.excitation import Excitation, excitations, proven_seconds
from deshybrid.detector.pairs import detection_window
from deshybrid.detector.residual import ResidualGenerator
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.abstraction import abstract
from deshybrid.model.system import (
    AffineReset,
    Bounds,
    Decision,
    DetectorOptions,
    GeneratorDesign,
    HybridSystem,
    HybridTransition,
    Location,
    ObserverOptions,
    SignatureCandidate,
    SignatureOptions,
)
from deshybrid.observer.hybrid import HybridObserver, build_observer
from tests.detection_adversary import Scene, Signals, beyond_before, course, latest_beyond, longest_on
from tests.plants import Sampled, drive
from tests.property.test_observer_detection import jumping, plan_of

STEP, STAY = 0.05, 6.0
BOUNDS = Bounds(
    state=frozen_array([20.0, 20.0], (2,)),
    input=frozen_array([5.0], (1,)),
    disturbance=frozen_array([0.05], (1,)),
    measurement=frozen_array([0.01, 0.01], (2,)),
)
SYSTEMS = 20


def random_location(rng: np.random.Generator, name: str) -> Location:
    """A stable location with two real modes, or one pair that turns; one or two outputs, known offsets at times."""
    turning = rng.normal(size=(2, 2))
    A = turning @ np.diag(-rng.uniform(0.3, 2.0, 2)) @ np.linalg.inv(turning)
    if rng.random() < 0.2:
        A = np.array([[-0.3, rng.uniform(0.5, 3)], [-rng.uniform(0.5, 3), -0.3]])
    p = int(rng.integers(1, 3))
    dynamics = LinearDynamics(
        A=frozen_array(A, (2, 2)),
        B=frozen_array(rng.normal(size=(2, 1)), (2, 1)),
        C=frozen_array(np.eye(2)[:p], (p, 2)),
        D=frozen_array(np.zeros((p, 1)), (p, 1)),
        E=frozen_array(rng.normal(size=(2, 1)), (2, 1)),
        f=frozen_array(rng.normal(size=2) * (rng.random() < 0.5), (2,)),
        g=frozen_array(np.zeros(p), (p,)),
    )
    return Location(name, dynamics, input_index=(0,), output_index=tuple(range(p)))


@cache
def case(seed: int) -> tuple[TransitionDetector, HybridObserver, tuple[Excitation, ...]]:
    """A hub and one or two locations around it, by relays or exclusion, by every design."""
    rng = np.random.default_rng(seed)
    names = ("hub", "one", "two")[: 2 + seed % 2]
    arcs = tuple(
        HybridTransition(source, f"{source}-{target}", target, reset=AffineReset(np.zeros((2, 2)), np.zeros(2)))
        for pair in (("hub", name) for name in names[1:])
        for source, target in (pair, pair[::-1])
    )
    decision: Decision = "relay" if seed % 4 < 2 else "exclusion"
    designs: tuple[GeneratorDesign, ...] = ("luenberger", "h2", "unknown_input", "auto")
    delay = frozen_array([STEP, 0.0], (2,)) if seed % 3 == 0 else None
    wishes = DetectorOptions(window=STAY, decision=decision, design=designs[seed % 4], delay=delay)
    system = HybridSystem(
        name=f"hub {seed}",
        locations=tuple(random_location(rng, name) for name in names),
        transitions=arcs,
        initial=names,
        state_names=("x1", "x2"),
        input_names=("u",),
        output_names=("y1", "y2"),
        disturbance_names=("w",),
        bounds=BOUNDS,
        signatures=SignatureOptions(tuple(SignatureCandidate(name) for name in names)),
        observer=ObserverOptions(dwell=STAY, step=STEP, detector=wishes),
    )
    assert detection_window(system) == STAY
    plan = plan_of(system, abstract(system))
    detector = build_detector(system, plan, rate=1.0, step=STEP)
    return detector, build_observer(system, plan, detector, None, step=STEP), excitations(detector)


class Seen(NamedTuple):
    """One run of an excitation (number): how late the location was named, and what is proven of its strength (s)."""

    number: int
    strength: float
    late: float
    proven: float


Signal: TypeAlias = Callable[[float], list[float]]


class Play(NamedTuple):
    """A stay in the source from a state on, the time of the transition, and all signals."""

    state: FloatArray
    entry: float
    input: Signal
    disturbance: Signal
    noise: Signal


@cache
def bound_of(seed: int, number: int, strength: float) -> float:
    """What is proven (s) of a strength; kept, since runs take few different strengths."""
    detector, _, proven = case(seed)
    found = proven_seconds(detector, proven[number], strength)
    assert found is not None
    return found


def entered_with(system: HybridSystem, excitation: Excitation, strength: float) -> HybridSystem:
    """The same system, whose transition puts the state where the motion begins, around rest as the offsets leave it."""
    dynamics = system.location(excitation.target).dynamics
    assert dynamics is not None
    begin = -np.linalg.solve(dynamics.A, dynamics.f) + strength * excitation.motion.state
    arcs = tuple(
        replace(arc, reset=AffineReset(np.zeros((2, 2)), begin))
        if (arc.source, arc.target) == (excitation.source, excitation.target)
        else arc
        for arc in system.transitions
    )
    return replace(system, transitions=arcs)


def run(seed: int, number: int, strength: float, played: Play) -> Seen | None:
    """A stay in the source, then the motion from the first sample on.

    None where the source was not named for as long as an exclusion takes, or a state left its bounds before.
    """
    detector, observer, proven = case(seed)
    excitation, entry = proven[number], played.entry
    samples = drive(
        entered_with(detector.system, excitation, strength),
        [(excitation.source, 0.0, None), (excitation.target, entry, None)],
        state=played.state,
        step=STEP,
        after=STAY,
        input=lambda t: list(strength * excitation.motion.input) if t >= entry else played.input(t),
        disturbance=played.disturbance,
        noise=played.noise,
    )
    if any((np.abs(sample.state) > 20.0).any() for sample in samples):
        return None
    late = _named_after(observer, _delayed(detector, samples_of(samples)), excitation, entry)
    bound = bound_of(seed, number, abs(strength))
    return None if late is None else Seen(number, abs(strength), late, bound)


def strengths(excitation: Excitation) -> list[float]:
    """From a little above the least one, which is only known to a millionth, up to the full one."""
    least = excitation.least
    assert least is not None
    return [least + (1.0 - least) * share for share in (0.02, 0.3, 0.65, 1.0)]


def random_run(seed: int, number: int, rng: np.random.Generator) -> Seen | None:
    excitation = case(seed)[2][number]
    strength = float(rng.choice(strengths(excitation))) * float(rng.choice([-1.0, 1.0]))
    entry = STEP * (round(STAY / STEP) + int(rng.integers(1, 5))) - 1e-9
    wild, swing = float(rng.uniform(0.0, 3.0)), float(rng.uniform(-5.0, 5.0))
    state, disturbance, noise = rng.uniform(-20, 20, 2), jumping(rng, [0.05]), jumping(rng, [0.01, 0.01])
    played = Play(state, entry, lambda t: [0.0 if t < entry - wild else swing], disturbance, noise)
    return run(seed, number, strength, played)


RESTING, FREE = 60, 60
SMALL, LARGE = ((3.0, -2.0),), ((19.0, 19.0), (-19.0, -19.0), (19.0, -19.0), (-19.0, 19.0))


def adversarial_runs(seed: int, number: int, strength: float) -> list[Seen]:
    """What linear programs find against each rival and against the own generator, after three seconds without them.

    From near rest, under the first input under which there is a run in which the source is named; and, where the motion
    is weak, from the corners of the bounds.
    """
    excitation, found = case(seed)[2][number], []
    weak = abs(strength) <= strengths(excitation)[0]
    for states in (SMALL, LARGE) if weak else (SMALL,):
        for state, swing in product(states, (0.0, 5.0, -5.0)):
            seen = _attacked(seed, number, strength, np.array(state), swing)
            found += seen
            if seen and states is SMALL:
                break
    return found


def _attacked(seed: int, number: int, strength: float, state: FloatArray, swing: float) -> list[Seen]:
    detector, _, proven = case(seed)
    begun = started(detector.system, proven[number].source, state, swing)
    if begun is None:
        return []
    tried = attacks(detector, proven[number], scene_of(seed, proven[number], strength, begun))
    played = [run(seed, number, strength, play_of(state, swing, signals)) for signals in tried]
    return [one for one in played if one is not None]


def started(system: HybridSystem, source: str, start: FloatArray, swing: float) -> list[Sampled] | None:
    """Three seconds in the source, the input held for the second half; None where a state leaves its bounds."""
    samples = drive(
        system,
        [(source, 0.0, None)],
        state=start,
        step=STEP,
        after=(RESTING + 1) * STEP,
        input=lambda t: [resting(t, swing)],
    )
    return None if any((np.abs(sample.state) > 20.0).any() for sample in samples) else samples


def resting(t: float, swing: float) -> float:
    return swing if t > STEP * RESTING / 2 else 0.0


def scene_of(seed: int, excitation: Excitation, strength: float, begun: list[Sampled]) -> Scene:
    detector, _, _ = case(seed)
    system, dynamics = detector.system, detector.system.location(excitation.target).dynamics
    assert dynamics is not None
    held = strength * excitation.motion.input
    begin = -np.linalg.solve(dynamics.A, dynamics.f) + strength * excitation.motion.state
    memory = tuple(_remembered(generator, begun[:RESTING]) for generator in detector.generators)
    proven = bound_of(seed, case(seed)[2].index(excitation), abs(strength))
    ahead = min(round(proven / STEP) + 3, round(STAY / STEP) - 2)
    places = system.location(excitation.source), system.location(excitation.target)
    return Scene(system, STEP, *places, begin, held, begun[RESTING].state, memory, FREE, ahead)


def _remembered(generator: ResidualGenerator, begun: list[Sampled]) -> FloatArray:
    """The generator's state after these samples."""
    own = list(generator.location.output_index)
    z = generator.start @ begun[0].output[own] + generator.start_offset
    for sample in begun:
        z = generator.F @ z + generator.input @ sample.input + generator.gain @ sample.output[own] + generator.offset
    return np.asarray(z)


def attacks(detector: TransitionDetector, excitation: Excitation, scene: Scene) -> Iterator[Signals]:
    """Where a name is given by relays, the others are kept silent before, so that the source is named."""
    found, release = course(scene, detector.generators), detector.release
    levels = [threshold.level for threshold in detector.thresholds]
    names = [generator.location.name for generator in detector.generators]
    silent = [(i, 1.02 * release * levels[i]) for i, name in enumerate(names) if name != excitation.source]
    by_relay = detector.decision.kind == "relay"
    for wanted in islice(beyond_before(scene, found, silent if by_relay else []), 2):
        for number, name in enumerate(names):
            residuals, level = found.residuals[number], levels[number]
            if name == excitation.target:
                tried = [latest_beyond(scene, wanted, residuals, level)]
            else:
                tried = [
                    longest_on(scene, wanted, residuals, release * level, None),
                    longest_on(scene, wanted, residuals, level, detector.on_ticks[number]),
                ]
            yield from (signals for signals in tried if signals is not None)


def play_of(state: FloatArray, swing: float, signals: Signals) -> Play:
    """The run that the signals make; after them nothing disturbs."""

    def at(values: FloatArray, t: float) -> list[float]:
        tick = round(t / STEP) - RESTING
        return values[tick].tolist() if 0 <= tick < len(values) else [0.0] * values.shape[1]

    return Play(
        state,
        STEP * (RESTING + FREE) - 1e-9,
        lambda t: [resting(t, swing)] if t < STEP * (RESTING - 0.5) else at(signals.u, t),
        lambda t: at(signals.w, t),
        lambda t: at(signals.v, t),
    )


Row = tuple[str, list[float], FloatArray]


def samples_of(samples: list) -> list[Row]:
    return [(sample.location, sample.input.tolist(), sample.output) for sample in samples]


def _delayed(detector: TransitionDetector, rows: list[Row]) -> list[Row]:
    """The outputs as late as the model says that they are measured."""
    delay = detector.system.observer.detector.delay
    lags = [0, 0] if delay is None else [round(float(d) / STEP) for d in delay]
    late = [np.array([rows[max(0, k - lag)][2][i] for i, lag in enumerate(lags)]) for k in range(len(rows))]
    return [(name, u, y) for (name, u, _), y in zip(rows, late, strict=True)]


def _named_after(observer: HybridObserver, rows: list[Row], excitation: Excitation, entry: float) -> float | None:
    state, first, named = observer.start(), next(k for k, row in enumerate(rows) if k * STEP >= entry - 1e-12), False
    assert observer.detector is not None
    for k, (_, u, y) in enumerate(rows):
        state, estimate = observer.step(state, u, y.tolist(), None)
        if k == first - 1:
            long_ago = state.silence >= observer.detector.decision.exclude_ticks
            named = estimate.location == excitation.source and long_ago
        if k >= first and not named:
            return None
        if k >= first and estimate.location == excitation.target:
            return (k - first) * STEP
    return np.inf


def runs(seeds: Iterable[int], each: int) -> list[tuple[int, Seen]]:
    found = []
    for seed in seeds:
        rng, proven = np.random.default_rng(1000 + seed), case(seed)[2]
        able = [n for n, excitation in enumerate(proven) if excitation.seconds is not None]
        for _ in range(each if able else 0):
            seen = random_run(seed, int(rng.choice(able)), rng)
            found += [] if seen is None else [(seed, seen)]
    return found


def hunted(seeds: Iterable[int]) -> list[tuple[int, Seen]]:
    """What the adversary finds, at every strength in both directions."""
    return [
        (seed, seen)
        for seed in seeds
        for number, excitation in enumerate(case(seed)[2])
        if excitation.seconds is not None
        for strength in strengths(excitation)
        for sign in (1.0, -1.0)
        for seen in adversarial_runs(seed, number, sign * strength)
    ]


def test_no_detection_is_later_than_its_proven_bound() -> None:
    seen = runs((0, 18), 8)
    assert len(seen) >= 8
    assert all(one.late <= one.proven + 1e-9 for _, one in seen)


def test_an_adversary_makes_no_detection_later_than_proven_and_comes_near() -> None:
    """By exclusion and by a relay that waits for its own generator; near: within a factor of 1.5, in samples."""
    for seed, number in ((11, 2), (9, 8)):
        seen = adversarial_runs(seed, number, 1.0)
        assert max(one.late + STEP for one in seen) >= (seen[0].proven + STEP) / 1.5
        assert all(one.late <= one.proven + 1e-9 for one in seen)


@pytest.mark.campaign
def test_no_detection_of_ten_thousand_is_late_and_bounds_are_at_most_three_times_the_worst() -> None:
    """Compared in samples that are read until the location is named, of which there is one at least."""
    seen = runs(range(SYSTEMS), 10_000 // SYSTEMS + 250) + hunted(range(SYSTEMS))
    assert len(seen) >= 10_000
    assert all(one.late <= one.proven + 1e-9 for _, one in seen)
    by_signature: dict[tuple[int, str, str], list[Seen]] = {}
    for seed, one in seen:
        excitation = case(seed)[2][one.number]
        by_signature.setdefault((seed, excitation.source, excitation.target), []).append(one)
    assert len(by_signature) >= 30
    for ones in by_signature.values():
        assert max(one.proven for one in ones) + STEP <= 3.0 * (max(one.late for one in ones) + STEP)
