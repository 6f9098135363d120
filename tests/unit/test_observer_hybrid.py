"""The hybrid observer on small plants simulated without the product's simulator."""

import math
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest

from deshybrid.continuous.gains import design_gains
from deshybrid.des.signatures import recover_observability
from deshybrid.detector.candidates import signature_candidates
from deshybrid.detector.detector import build_detector
from deshybrid.diagnostics import GainError, ModelError, UsageError
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import loads
from deshybrid.observer.hybrid import Estimate, HybridObserver, build_observer
from tests.plants import Sampled, drive

STEP = 0.01
SWITCH = """\
format: deshybrid/1
name: switch
time: continuous
state: [x1, x2]
input: [u]
output: [y]
defaults: {B: [[0], [1]], C: [[1, 0]]}
locations:
  p: {A: [[0, 1], [-4, -1]], f: [0, 0.5]}
  q: {A: [[0, 1], [-25, -2]], g: [0.1], D: [[0.05]]}
transitions:
  - {from: p, to: q, event: a, emits: null, reset: {matrix: [[1, 0], [0, 0.5]], offset: [0.2, 0]}}
  - {from: q, to: p, event: b, emits: null}
signatures: {candidates: {p: {by: residual}, q: {by: residual}}}
observer: {rate: 2, poles: {p: [-6, -7], q: [-6, -7]}, initial_state: [0.3, 0]}
"""
FORK = """\
format: deshybrid/1
name: fork
time: continuous
state: [x]
input: [u]
output: [y1, y2]
defaults: {B: [[1]]}
locations:
  hub:  {A: [[-1]], C: [[1], [1]]}
  slow: {A: [[-0.5]], C: [[1]], output: [y1]}
  fast: {A: [[-8]], C: [[1], [2]]}
transitions:
  - {from: hub, to: slow, event: a, emits: go}
  - {from: hub, to: fast, event: b, emits: go}
  - {from: slow, to: hub, event: c, emits: back}
  - {from: fast, to: hub, event: c, emits: back}
signatures: {candidates: {fast: {by: residual}}}
observer: {rate: 2, poles: {hub: [-5], slow: [-5], fast: [-12]}, detector: {poles: {fast: [-40]}}}
"""


@cache
def compiled(text: str, *, step: float = STEP) -> HybridObserver:
    system = loads(text)
    des = abstract(system)
    plan = recover_observability(des, tuple(entry.candidate for entry in signature_candidates(system, des)))
    detector = build_detector(system, plan, rate=system.observer.rate, step=step) if plan.signatures else None
    return build_observer(system, plan, detector, design_gains(system, plan.report.persistent), step=step)


def follow(observer: HybridObserver, samples: list[Sampled]) -> list[Estimate]:
    state, estimates = observer.start(), []
    for sample in samples:
        state, estimate = observer.step(state, sample.input.tolist(), sample.output.tolist(), sample.event)
        estimates.append(estimate)
    return estimates


def wobble(time: float) -> list[float]:
    return [math.sin(3 * time) + 0.5 * math.sin(7.1 * time)]


@cache
def switching_run() -> list[Sampled]:
    visits = [("p", 0.0, None), ("q", 4.003, None), ("p", 8.007, None), ("q", 12.0, None), ("p", 16.005, None)]
    start = np.array([1.0, -1.0])
    return drive(compiled(SWITCH).system, visits, state=start, step=STEP, after=4.0, input=wobble)


def test_every_silent_switch_is_identified_from_the_residuals() -> None:
    observer = compiled(SWITCH)
    samples = switching_run()
    estimates = follow(observer, samples)
    entries = [k for k, (one, two) in enumerate(pairwise(samples), 1) if one.location != two.location]
    assert len(entries) == 4
    for k in [0, *entries]:
        named = next(j for j in range(k, len(samples)) if estimates[j].location == samples[k].location)
        assert (named - k) * STEP < 1.5
    right = sum(e.location == s.location for e, s in zip(estimates, samples, strict=True))
    assert right > 0.7 * len(samples)
    assert {estimate.signature for estimate in estimates} == {None, "s_p", "s_q"}


def test_error_obeys_the_sampled_closed_loop_exactly_while_the_named_location_is_true() -> None:
    """Without disturbance e := (A_d - G_d C) e, inputs, offsets, feedthrough and resets included: no steady error."""
    observer = compiled(SWITCH)
    samples = switching_run()
    estimates = follow(observer, samples)
    checked = 0
    for k in range(1, len(samples)):
        stays = samples[k - 1].location == samples[k].location == estimates[k].location == estimates[k - 1].location
        if stays and estimates[k].signature is None:
            number = [location.name for location in observer.system.locations].index(samples[k].location)
            before = np.array(estimates[k - 1].state) - samples[k - 1].state
            after = np.array(estimates[k].state) - samples[k].state
            assert after == pytest.approx(observer.tables.flow.matrix[number] @ before, abs=1e-12)
            checked += 1
    assert checked > 1000
    assert np.abs(np.array(estimates[-1].state) - samples[-1].state).max() < 1e-2


def test_estimate_converges_at_the_rate_of_the_placed_poles() -> None:
    """Poles at -6 and -7: over one second of a stay the error shrinks by e^-6 at least, and not much more."""
    observer = compiled(SWITCH)
    samples = switching_run()
    errors = [np.array(e.state) - s.state for e, s in zip(follow(observer, samples), samples, strict=True)]
    early, late = (float(np.linalg.norm(errors[round(time / STEP)])) for time in (10.5, 11.5))
    assert math.exp(-8.0) < late / early < math.exp(-6.0)


def test_a_late_reset_is_applied_when_the_switch_is_seen() -> None:
    observer = compiled(SWITCH)
    samples = switching_run()
    estimates = follow(observer, samples)
    k = next(k for k in range(1, len(samples)) if estimates[k].signature == "s_q")
    before = np.array(estimates[k - 1].state)
    flow = observer.tables.flow
    y, u = samples[k - 1].output, samples[k - 1].input
    advanced = flow.matrix[0] @ before + flow.input[0] @ u + flow.output[0] @ y + flow.offset[0]
    assert estimates[k].state == pytest.approx(advanced * [1.0, 0.5] + [0.2, 0.0], abs=1e-12)


def test_output_first_then_signature_or_silence() -> None:
    """`go` leaves hub for slow or fast; only fast has a signature, so silence for the window means slow."""
    observer = compiled(FORK)
    assert [signature.name for signature in observer.plan.signatures] == ["s_fast"]
    visits = [("hub", 0.0, None), ("fast", 2.0, "go"), ("hub", 4.0, "back"), ("slow", 6.0, "go"), ("hub", 8.0, "back")]
    start = np.array([2.0])
    samples = drive(
        observer.system, visits, state=start, step=STEP, after=1.0, input=lambda time: [2 + math.sin(9 * time)]
    )
    estimates = follow(observer, samples)
    words = [(estimate.location, estimate.status) for estimate in estimates]
    changes = [words[0], *(two for one, two in pairwise(words) if one != two)]
    assert changes == [
        (None, "searching"),
        (None, "provisional"),
        ("fast", "identified"),
        ("hub", "identified"),
        (None, "provisional"),
        ("slow", "identified"),
        ("hub", "identified"),
    ]
    silent = [k for k, estimate in enumerate(estimates) if estimate.status == "provisional" and k > 500]
    assert len(silent) == observer.tables.window_ticks
    for sample, estimate in zip(samples, estimates, strict=True):
        assert sample.location in estimate.entry_estimate


def test_a_location_with_its_own_outputs_uses_only_those() -> None:
    observer = compiled(FORK)
    generators, flow = observer.tables.generators, observer.tables.flow
    assert (generators.weight[0] > 0.0).tolist() == [True, True]
    assert flow.output[:, 0, :].astype(bool).tolist() == [[True, True], [True, False], [True, True]]


def test_a_plant_that_shows_everything_needs_no_detector() -> None:
    text = SWITCH.replace("event: a, emits: null", "event: a, emits: to_q").replace(
        "event: b, emits: null", "event: b, emits: to_p"
    )
    observer = compiled(text)
    assert observer.detector is None
    visits = [("p", 0.0, None), ("q", 2.003, "to_q"), ("p", 4.007, "to_p"), ("q", 6.0, "to_q")]
    samples = drive(observer.system, visits, state=np.array([1.0, -1.0]), step=STEP, after=2.0, input=wobble)
    estimates = follow(observer, samples)
    known = next(k for k, estimate in enumerate(estimates) if estimate.identified)
    assert samples[known].event == "to_q"
    assert all(e.location == s.location for e, s in zip(estimates[known:], samples[known:], strict=True))
    assert np.abs(np.array(estimates[-1].state) - samples[-1].state).max() < 1e-4


def test_estimate_is_held_at_the_stated_initial_state_before_identification() -> None:
    observer = compiled(SWITCH)
    estimates = follow(observer, switching_run())
    held = [estimate.state for estimate in estimates if estimate.status == "searching"]
    assert held
    assert set(held) == {(0.3, 0.0)}


def test_a_model_in_discrete_time_uses_its_matrices_as_they_are() -> None:
    text = """\
format: deshybrid/1
name: sampled
time: {step: 0.1}
state: [x]
input: [u]
output: [y]
defaults: {B: [[1]], C: [[1]]}
locations: {p: {A: [[0.9]], f: [0.5]}, q: {A: [[0.2]]}}
transitions:
  - {from: p, to: q, event: a, emits: α}
  - {from: q, to: p, event: b, emits: β}
observer: {gains: {p: [[0.6]], q: [[0.1]]}}
"""
    flow = compiled(text, step=0.1).tables.flow
    assert flow.matrix.ravel() == pytest.approx([0.3, 0.1])
    assert flow.output.ravel() == pytest.approx([0.6, 0.1])
    assert flow.offset.ravel() == pytest.approx([0.5, 0.0])


def test_two_resets_between_the_same_locations_are_refused_at_the_second_one() -> None:
    twice = (
        "  - {from: q, to: p, event: c, emits: null, reset: {matrix: [[0, 0], [0, 1]], offset: [0, 0]}}\nsignatures:"
    )
    with pytest.raises(ModelError, match="DH0605") as caught:
        compiled(SWITCH.replace("signatures:", twice))
    (found,) = caught.value.diagnostics
    assert found.span is not None
    assert found.span.line == 14


def test_equal_resets_between_the_same_locations_are_fine() -> None:
    twice = "  - {from: q, to: p, event: c, emits: null}\nsignatures:"
    index = compiled(SWITCH.replace("signatures:", twice)).tables.reset_index
    assert index == ((-1, 0), (-1, -1))


def test_a_step_too_long_for_a_gain_is_refused() -> None:
    """Poles at -60 with a plant that swings: at 0.5 s the sampled loop grows."""
    text = SWITCH.replace("p: [-6, -7]", "p: [-60, -70]")
    with pytest.raises(GainError, match="DH0606"):
        compiled(text, step=0.5)


def test_a_plan_that_recovers_nothing_has_no_observer() -> None:
    system = loads(SWITCH)
    plan = recover_observability(abstract(system), ())
    with pytest.raises(UsageError, match="DH0608"):
        build_observer(system, plan, None, None, step=STEP)


def test_a_plan_with_signatures_needs_a_detector() -> None:
    observer = compiled(SWITCH)
    with pytest.raises(UsageError, match="DH0608"):
        build_observer(observer.system, observer.plan, None, observer.gains, step=STEP)


@pytest.mark.parametrize(("inputs", "outputs"), [((), (0.0,)), ((0.0,), (0.0, 0.0))])
def test_a_sample_of_the_wrong_width_is_refused(inputs: tuple[float, ...], outputs: tuple[float, ...]) -> None:
    observer = compiled(SWITCH)
    with pytest.raises(UsageError, match="DH0607"):
        observer.step(observer.start(), inputs, outputs, None)


def test_no_sample_raises_whatever_it_holds() -> None:
    observer, rng = compiled(FORK), np.random.default_rng(11)
    state = observer.start()
    odd = [0.0, -0.0, 1.0, 1e30, -1e31, 1e308, math.nan, math.inf, -math.inf, 5e-324]
    statuses = set()
    for _ in range(3000):
        numbers = [float(rng.choice(odd)) for _ in range(3)]
        event = [None, "go", "back", "", "no such event", "s_fast"][rng.integers(6)]
        state, estimate = observer.step(state, numbers[:1], numbers[1:], event)
        statuses.add(estimate.status)
        assert all(math.isfinite(value) for value in estimate.state)
    assert statuses >= {"identified", "inconsistent", "invalid", "provisional"}


def test_steps_are_pure() -> None:
    observer = compiled(SWITCH)
    sample = switching_run()[0]
    once = observer.step(observer.start(), sample.input.tolist(), sample.output.tolist(), None)
    again = observer.step(observer.start(), sample.input.tolist(), sample.output.tolist(), None)
    assert once == again


def test_without_gains_the_location_is_still_found_and_the_state_is_held() -> None:
    observer = compiled(SWITCH)
    bare = build_observer(observer.system, observer.plan, observer.detector, None, step=STEP)
    samples = switching_run()
    ours, theirs = follow(observer, samples), follow(bare, samples)
    assert [estimate.location for estimate in ours] == [estimate.location for estimate in theirs]
    assert bare.tables.flow.defined == (False, False)
    assert {estimate.state for estimate in theirs} == {(0.3, 0.0)}


def gains_of(observer: HybridObserver) -> FloatArray:
    assert observer.gains is not None
    return observer.gains.gains["p"]


def test_the_observer_keeps_the_values_it_was_made_from() -> None:
    observer = compiled(SWITCH)
    assert observer.detector is not None
    assert observer.detector.plan is observer.plan
    assert observer.plan.des.name == observer.system.name
    assert gains_of(observer).shape == (2, 1)
    assert observer.step_seconds == observer.tables.step == STEP
    assert "2 residual generators" in repr(observer)
    assert replace(observer).tables is observer.tables
