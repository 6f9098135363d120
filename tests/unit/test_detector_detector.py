"""The detector's parameters: from the model file, or derived; and its delay, against simulated switches."""

import math
from dataclasses import replace

import numpy as np
import pytest

from deshybrid.des.signatures import SignaturePlan, recover_observability
from deshybrid.detector.candidates import signature_candidates
from deshybrid.detector.detector import TransitionDetector, build_detector
from deshybrid.diagnostics import UsageError
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import loads
from deshybrid.model.system import HybridSystem

MODEL = """\
format: deshybrid/1
name: switch
time: continuous
state: [x1, x2]
input: [u]
output: [y]
disturbance: [w]
bounds: {state: 5, input: 1, disturbance: 0.2, measurement: 0.01}
defaults: {B: [[0], [1]], E: [[0], [1]], C: [[1, 0]]}
locations:
  p: {A: [[0, 1], [-4, -1]]}
  q: {A: [[0, 1], [-25, -2]]}
transitions:
  - {from: p, to: q, event: a, emits: null}
  - {from: q, to: p, event: b, emits: null}
signatures: {candidates: {p: {by: residual}, q: {by: residual}}}
"""
STEP = 0.01


def parts(text: str = MODEL) -> tuple[HybridSystem, SignaturePlan]:
    system = loads(text)
    des = abstract(system)
    return system, recover_observability(des, tuple(c.candidate for c in signature_candidates(system, des)))


def detector_of(options: str = "", text: str = MODEL, step: float = STEP) -> TransitionDetector:
    system, plan = parts(text + (f"observer: {{detector: {{{options}}}}}\n" if options else ""))
    return build_detector(system, plan, rate=1.0, step=step)


def test_one_generator_for_each_location_that_the_plan_names() -> None:
    detector = detector_of()
    assert [generator.location.name for generator in detector.generators] == list(detector.plan.generators)
    assert len(detector.thresholds) == len(detector.on_ticks) == len(detector.off_ticks) == 2


def test_what_the_model_states_is_taken() -> None:
    detector = detector_of(
        "decision: relay, threshold: {p: [0.5], q: [0.25]}, release: 3, debounce: 0.035, window: 0.2"
    )
    assert [threshold.level.tolist() for threshold in detector.thresholds] == [[0.5], [0.25]]
    assert {threshold.source for threshold in detector.thresholds} == {"stated"}
    assert (detector.release, detector.on_ticks, detector.off_ticks) == (3.0, (4, 4), (1, 1))
    assert (detector.window, detector.window_ticks, detector.window_reason) == (0.2, 20, "stated by the model")


def test_defaults_lie_above_what_the_bounds_allow_and_wait_for_one_time_constant() -> None:
    detector = detector_of("decision: relay")
    for threshold in detector.thresholds:
        assert (threshold.level > threshold.steady).all()
        assert threshold.guaranteed
    assert detector.release == 1.5
    assert detector.on_ticks == (20, 20)  # poles at -5: 0.2 s


def test_a_stated_threshold_below_the_bound_is_taken_but_guarantees_nothing() -> None:
    detector = detector_of("threshold: {p: [0.001]}")
    threshold = detector.thresholds[0]
    assert not threshold.guaranteed
    assert "not above" in threshold.reason
    assert detector.detection_delay["p"] is None
    assert "not above" in detector.delays["p"].reason


def test_missing_bounds_are_named_in_the_reason() -> None:
    text = MODEL.replace(", disturbance: 0.2, measurement: 0.01", "")
    assert "disturbance and measurement" in detector_of(text=text).thresholds[0].reason


def test_without_bounds_on_the_state_no_delay_is_promised_and_the_window_is_nominal() -> None:
    detector = detector_of(text=MODEL.replace("state: 5, ", ""))
    assert set(detector.detection_delay.values()) == {None}
    assert "nominal" in detector.window_reason
    least = min(float(threshold.level[0]) for threshold in detector.thresholds)
    assert detector.window == pytest.approx(0.2 * math.log(10 / least) + 20 * STEP)


def test_window_is_the_largest_detection_delay() -> None:
    detector = detector_of()
    finite = [seconds for seconds in detector.detection_delay.values() if seconds is not None]
    assert detector.window == max(finite)


def test_a_delay_says_which_residuals_must_have_left_and_that_this_needs_excitation() -> None:
    condition = detector_of().delays["q"].condition
    assert "`p`" in condition
    assert "away from rest" in condition


def test_a_negation_has_no_bound_and_says_why() -> None:
    detector = detector_of("decision: relay", text=MODEL.replace("q: {by: residual}", "q: {by: negation}"))
    assert [generator.location.name for generator in detector.generators] == ["p"]
    assert detector.delays["q"].seconds is None
    assert "x = 0, u = 0" in detector.delays["q"].reason


def test_a_plan_without_signatures_needs_no_generators() -> None:
    text = MODEL.replace("event: a, emits: null", "event: a, emits: α").replace(
        "event: b, emits: null", "emits: β, event: b"
    )
    detector = detector_of(text=text)
    assert (detector.generators, dict(detector.delays), detector.window_ticks) == ((), {}, 1)


@pytest.mark.parametrize("step", [0.0, -1.0, float("nan"), float("inf")])
def test_a_step_that_is_no_positive_number_is_refused(step: float) -> None:
    with pytest.raises(UsageError, match="DH0601"):
        detector_of(step=step)


def test_a_model_in_discrete_time_keeps_its_step() -> None:
    text = MODEL.replace("time: continuous", "time: {step: 0.02}").replace("[-4, -1]", "[-0.4, 0.9]")
    text = text.replace("[-25, -2]", "[-0.7, 0.5]")
    with pytest.raises(UsageError, match="DH0601"):
        detector_of(text=text, step=0.01)
    assert detector_of(text=text, step=0.02).generators[0].step == 0.02


def test_all_mistakes_of_the_detector_are_reported_together() -> None:
    system, plan = parts()
    options = replace(
        system.observer.detector,
        poles={"p": (3.0 + 0j, -4.0 + 0j)},
        threshold={"q": np.array([-1.0])},
    )
    system = replace(system, observer=replace(system.observer, detector=options))
    with pytest.raises(UsageError) as caught:
        build_detector(system, plan, rate=1.0, step=STEP)
    assert [found.code for found in caught.value.diagnostics] == ["DH0602", "DH0604"]


def test_a_pole_that_hardly_decays_within_thousands_of_samples_is_refused() -> None:
    with pytest.raises(UsageError, match="DH0602"):
        detector_of("poles: {p: [-0.001, -2]}", step=1e-3)


def test_default_poles_of_a_very_short_step_still_settle() -> None:
    detector = detector_of(step=1e-5)
    assert all(np.isfinite(threshold.level).all() for threshold in detector.thresholds)
