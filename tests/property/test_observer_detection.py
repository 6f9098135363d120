"""What the detector promises, on random plants under bounded inputs, disturbances and measurement errors."""

from functools import cache

import numpy as np
import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.signatures import SignaturePlan, recover_observability
from deshybrid.detector.candidates import signature_candidates
from deshybrid.detector.detector import build_detector
from deshybrid.linear.arrays import frozen_array
from deshybrid.model.abstraction import abstract
from deshybrid.model.system import (
    AffineReset,
    Bounds,
    HybridSystem,
    HybridTransition,
    SignatureCandidate,
    SignatureOptions,
)
from deshybrid.observer import reference
from deshybrid.observer.hybrid import HybridObserver, build_observer
from tests.plants import drive, jumping, random_location

STEP = 0.02


def random_system(rng: np.random.Generator) -> HybridSystem:
    """Two locations that follow each other in silence; the bound on the state is never reached by the runs below."""
    keep = AffineReset(frozen_array(np.eye(2), (2, 2)), frozen_array(np.zeros(2), (2,)))
    return HybridSystem(
        name="random",
        locations=(random_location(rng, "p"), random_location(rng, "q")),
        transitions=(
            HybridTransition("p", "a", "q", (None,), reset=keep),
            HybridTransition("q", "b", "p", (None,), reset=keep),
        ),
        initial=("p", "q"),
        state_names=("x1", "x2"),
        input_names=("u",),
        output_names=("y1", "y2"),
        disturbance_names=("w",),
        bounds=Bounds(
            state=frozen_array([100.0, 100.0], (2,)),
            input=frozen_array([1.0], (1,)),
            disturbance=frozen_array([0.3], (1,)),
            measurement=frozen_array([0.02, 0.05], (2,)),
        ),
        signatures=SignatureOptions((SignatureCandidate("p", by="residual"), SignatureCandidate("q", by="residual"))),
    )


def plan_of(system: HybridSystem, des: DES) -> SignaturePlan:
    return recover_observability(des, tuple(c.candidate for c in signature_candidates(system, des)))


@cache
def observed(seed: int) -> tuple[HybridObserver, list[tuple[str, reference.State]]]:
    """The observer's state after each sample of a run p, q, p, with the true location."""
    rng = np.random.default_rng(seed)
    system = random_system(rng)
    plan = plan_of(system, abstract(system))
    assert plan.recoverable
    detector = build_detector(system, plan, rate=2.0, step=STEP)
    observer = build_observer(system, plan, detector, None, step=STEP)
    longest = max(seconds for seconds in detector.detection_delay.values() if seconds is not None)
    first, second = float(rng.uniform(0.1, 2.0)), longest + 1.0
    samples = drive(
        system,
        [("p", 0.0, None), ("q", first, None), ("p", first + second, None)],
        state=rng.uniform(-2, 2, 2),
        step=STEP,
        after=second,
        input=jumping(rng, [1.0]),
        disturbance=jumping(rng, [0.3]),
        noise=jumping(rng, [0.02, 0.05]),
    )
    assert all(np.abs(sample.state).max() < 100.0 for sample in samples)
    state, states = observer.start(), []
    for sample in samples:
        state, _ = observer.step(state, sample.input.tolist(), sample.output.tolist(), None)
        states.append((sample.location, state))
    return observer, states


@pytest.mark.parametrize("seed", range(25))
def test_generator_of_the_entered_location_is_active_within_the_promised_delay_and_stays_so(seed: int) -> None:
    observer, states = observed(seed)
    assert observer.detector is not None
    for number, generator in enumerate(observer.detector.generators):
        name = generator.location.name
        promised = observer.detector.detection_delay[name]
        assert promised is not None
        since = 0
        for k, (location, state) in enumerate(states):
            since = since if k == 0 or states[k - 1][0] == location else k
            if location == name and (k - since + 1) * STEP >= promised:
                assert state.relay[number]
                assert state.active[number]


@pytest.mark.parametrize("seed", range(25))
def test_a_named_location_is_the_true_one_once_the_others_residuals_have_settled(seed: int) -> None:
    """A signature waits for the alternatives: after the promised delay none of them is entered any more."""
    observer, states = observed(seed)
    assert observer.detector is not None
    longest = max(seconds for seconds in observer.detector.detection_delay.values() if seconds is not None)
    names = [location.name for location in observer.system.locations]
    since = 0
    for k, (location, state) in enumerate(states[1:], 1):
        since = since if states[k - 1][0] == location else k
        moved = state.tracker != states[k - 1][1].tracker
        if moved and (k - since + 1) * STEP > longest:
            assert names[observer.tables.tracker[state.tracker].location] == location
