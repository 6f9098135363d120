"""What exclusion promises, on random plants under bounded inputs, disturbances and measurement errors."""

from functools import cache

import numpy as np
import pytest

from deshybrid.des.signatures import recover_observability
from deshybrid.detector.candidates import signature_candidates
from deshybrid.detector.detector import build_detector
from deshybrid.linear.arrays import frozen_array
from deshybrid.model.abstraction import abstract
from deshybrid.model.system import AffineReset, Bounds, HybridSystem, HybridTransition
from deshybrid.observer.hybrid import Estimate, HybridObserver, build_observer
from tests.plants import drive, jumping, random_location

STEP = 0.02
LEAST_NAMED = 12  # of 25 runs; a name is never promised, but a test without names shows nothing


def random_system(rng: np.random.Generator) -> HybridSystem:
    """Three locations, each followed by any other in silence; the bound on the state is never reached below."""
    keep = AffineReset(frozen_array(np.eye(2), (2, 2)), frozen_array(np.zeros(2), (2,)))
    pairs = [(source, target) for source in "pqr" for target in "pqr" if source != target]
    return HybridSystem(
        name="random",
        locations=tuple(random_location(rng, name) for name in "pqr"),
        transitions=tuple(HybridTransition(p, f"{p}{q}", q, (None,), reset=keep) for p, q in pairs),
        initial=("p", "q", "r"),
        state_names=("x1", "x2"),
        input_names=("u",),
        output_names=("y1", "y2"),
        disturbance_names=("w",),
        bounds=Bounds(
            state=frozen_array([20.0, 20.0], (2,)),
            input=frozen_array([1.0], (1,)),
            disturbance=frozen_array([0.05], (1,)),
            measurement=frozen_array([0.005, 0.005], (2,)),
        ),
    )


@cache
def observed(seed: int) -> tuple[HybridObserver, list[tuple[str, Estimate]]]:
    """True location and estimate of every sample of a run through four locations that stay for H and a little."""
    rng = np.random.default_rng(seed)
    system = random_system(rng)
    des = abstract(system)
    plan = recover_observability(des, tuple(c.candidate for c in signature_candidates(system, des)))
    observer = build_observer(system, plan, build_detector(system, plan, rate=2.0, step=STEP), None, step=STEP)
    stay = (observer.tables.decision.exclude_ticks + 2) * STEP
    visits = [("p", 0.0, None)]
    for _ in range(3):
        name = str(rng.choice([other for other in "pqr" if other != visits[-1][0]]))
        visits.append((name, visits[-1][1] + stay * float(rng.uniform(1.0, 1.5)), None))
    samples = drive(
        system,
        visits,
        state=rng.uniform(-1, 1, 2),
        step=STEP,
        after=1.5 * stay,
        input=jumping(rng, [1.0]),
        disturbance=jumping(rng, [0.05]),
        noise=jumping(rng, [0.005, 0.005]),
    )
    assert all(np.abs(sample.state).max() < 20.0 for sample in samples)
    state, seen = observer.start(), []
    for sample in samples:
        state, estimate = observer.step(state, sample.input.tolist(), sample.output.tolist(), None)
        seen.append((sample.location, estimate))
    return observer, seen


@pytest.mark.parametrize("seed", range(25))
def test_a_location_is_named_only_where_the_plant_is_or_was_within_the_last_exclusion(seed: int) -> None:
    observer, seen = observed(seed)
    assert observer.tables.decision.kind == "exclusion"
    ticks = observer.tables.decision.exclude_ticks
    for k, (_, estimate) in enumerate(seen):
        if estimate.signature is not None and estimate.location is not None:
            recent = {location for location, _ in seen[max(0, k - ticks) : k + 1]}
            assert estimate.location in recent


@pytest.mark.parametrize("seed", range(25))
def test_a_location_that_explains_the_samples_is_never_given_up(seed: int) -> None:
    """Inconsistent is only what follows after the named location has been left."""
    _, seen = observed(seed)
    for k, (location, estimate) in enumerate(seen):
        if estimate.status == "inconsistent":
            named = [(place, told.location) for place, told in seen[:k] if told.location is not None]
            assert named
            assert named[-1][1] != location or named[-1][0] != location


def test_most_of_the_runs_name_locations_at_all() -> None:
    runs = [observed(seed)[1] for seed in range(25)]
    assert sum(any(estimate.location is not None for _, estimate in seen) for seen in runs) >= LEAST_NAMED
