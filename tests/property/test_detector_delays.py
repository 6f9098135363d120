"""No detection is later than its proven bound: random plants, motions and strengths against the running observer."""

from collections.abc import Iterable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from deshybrid.detector.detector import TransitionDetector, build_detector
from deshybrid.detector.excitation import Excitation, excitations, proven_seconds
from deshybrid.detector.pairs import detection_window
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
from tests.plants import drive
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
    """One run: how late the location was named (s), and what was proven for its strength."""

    number: int
    late: float
    proven: float


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


def run(seed: int, number: int, rng: np.random.Generator) -> Seen | None:
    """A stay in the source, then the motion from the first sample on.

    None where the source was not named for as long as an exclusion takes, or a state left its bounds before.
    """
    detector, observer, proven = case(seed)
    excitation = proven[number]
    if excitation.seconds is None or excitation.least is None:
        return None
    strength = float(rng.uniform(excitation.least, 1.0)) * float(rng.choice([-1.0, 1.0]))
    bound = proven_seconds(detector, excitation, abs(strength))
    entry = STEP * (round(STAY / STEP) + int(rng.integers(1, 5))) - 1e-9
    wild, swing = float(rng.uniform(0.0, 3.0)), float(rng.uniform(-5.0, 5.0))

    def given(t: float) -> list[float]:
        return list(strength * excitation.motion.input) if t >= entry else [0.0 if t < entry - wild else swing]

    system = entered_with(detector.system, excitation, strength)
    samples = drive(
        system,
        [(excitation.source, 0.0, None), (excitation.target, entry, None)],
        state=rng.uniform(-20, 20, 2),
        step=STEP,
        after=STAY,
        input=given,
        disturbance=jumping(rng, [0.05]),
        noise=jumping(rng, [0.01, 0.01]),
    )
    if any((np.abs(sample.state) > 20.0).any() for sample in samples):
        return None
    late = _named_after(observer, _delayed(detector, samples_of(samples)), excitation, entry)
    assert bound is not None
    return None if late is None else Seen(number, late, bound)


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
            seen = run(seed, int(rng.choice(able)), rng)
            found += [] if seen is None else [(seed, seen)]
    return found


def test_no_detection_is_later_than_its_proven_bound() -> None:
    seen = runs((0, 18), 8)
    assert len(seen) >= 8
    assert all(one.late <= one.proven + 1e-9 for _, one in seen)


@pytest.mark.campaign
def test_no_detection_of_ten_thousand_is_late_and_bounds_of_signatures_that_wait_are_near() -> None:
    """A signature waits where a tenth of its runs take more than half a second; many come at once in every run."""
    seen = runs(range(SYSTEMS), 10_000 // SYSTEMS + 400)
    assert len(seen) >= 10_000
    assert all(one.late <= one.proven + 1e-9 for _, one in seen)
    by_signature: dict[tuple[int, str, str], list[Seen]] = {}
    for seed, one in seen:
        excitation = case(seed)[2][one.number]
        by_signature.setdefault((seed, excitation.source, excitation.target), []).append(one)
    waiting = [ones for ones in by_signature.values() if np.quantile([one.late for one in ones], 0.9) > 0.5]
    assert waiting
    for ones in waiting:
        assert max(one.proven for one in ones) <= 3.0 * max(one.late for one in ones)
