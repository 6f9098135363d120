"""The choice of a decision: what the model states, what its bounds allow, and what it is then sound for."""

import numpy as np
import pytest

from deshybrid.des.signatures import recover_observability
from deshybrid.detector.candidates import signature_candidates
from deshybrid.detector.detector import TransitionDetector, build_detector
from deshybrid.detector.thresholds import largest_state
from deshybrid.diagnostics import UsageError
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import loads
from deshybrid.observer.hybrid import build_observer

MODEL = """\
format: deshybrid/1
name: three
time: continuous
state: [x]
input: [u]
output: [y]
disturbance: [w]
bounds: {state: 5, input: 1, disturbance: 0.2, measurement: 0.01}
defaults: {B: [[1]], E: [[1]], C: [[1]], A: [[-1]]}
locations: {p: {f: [0]}, q: {f: [3]}, r: {f: [-3]}}
transitions:
  - {from: p, to: q, event: a, emits: null}
  - {from: q, to: r, event: b, emits: null}
  - {from: r, to: p, event: c, emits: null}
"""
STEP = 0.01


def detector_of(options: str = "", text: str = MODEL) -> TransitionDetector:
    system = loads(text + (f"observer: {{detector: {{{options}}}}}\n" if options else ""))
    des = abstract(system)
    plan = recover_observability(des, tuple(c.candidate for c in signature_candidates(system, des)))
    return build_detector(system, plan, rate=1.0, step=STEP)


def test_exclusion_is_the_default_where_the_bounds_allow_it_and_judges_every_location() -> None:
    detector = detector_of()
    names = [part.location.name for part in detector.generators]
    assert detector.decision.kind == "exclusion"
    assert names[: len(detector.plan.generators)] == list(detector.plan.generators)
    assert sorted(names) == ["p", "q", "r"]
    assert detector.release == 1.0


@pytest.mark.parametrize("bound", ["state: 5, ", "input: 1, ", "disturbance: 0.2, ", ", measurement: 0.01"])
def test_without_a_bound_it_is_the_relay_and_the_reason_names_the_bound(bound: str) -> None:
    detector = detector_of(text=MODEL.replace(bound, ""))
    assert detector.decision.kind == "relay"
    assert bound.strip(", ").split(":")[0] in detector.decision.reason
    assert [part.location.name for part in detector.generators] == list(detector.plan.generators)


def test_the_relay_is_kept_where_an_exclusion_would_outlast_a_stay() -> None:
    detector = detector_of(text=MODEL.replace("p: {f: [0]}", "p: {f: [0], dwell: {min: 0.02}}"))
    assert detector.decision.kind == "relay"
    assert "longer than a stay of 0.02 s" in detector.decision.reason


def test_a_stated_exclusion_that_nothing_bounds_is_refused() -> None:
    with pytest.raises(UsageError, match="DH0614"):
        detector_of("decision: exclusion", text=MODEL.replace("state: 5, ", ""))
    with pytest.raises(UsageError, match="DH0614"):
        detector_of("decision: exclusion, threshold: 0.001")


def test_an_exclusion_waits_for_the_longest_transient_from_the_worst_mismatch() -> None:
    """By the definition: |C F^k| times the mismatch is within the margin from then on, for every generator."""
    detector = detector_of()
    for generator, threshold, on in zip(detector.generators, detector.thresholds, detector.on_ticks, strict=True):
        bound = largest_state(detector.system, generator)
        assert bound is not None
        mismatch = bound + np.abs(generator.T) @ np.array([5.0])
        power = np.linalg.matrix_power(generator.F, detector.decision.exclude_ticks - on)
        assert (np.abs(generator.H @ power) @ mismatch <= threshold.level - threshold.steady).all()
    assert detector.window_ticks >= detector.decision.exclude_ticks


def test_a_stated_window_is_no_shorter_than_an_exclusion() -> None:
    detector = detector_of("window: 0.02")
    assert detector.window == detector.decision.exclude_ticks * STEP
    assert "stated by the model" in detector.window_reason


def test_every_location_has_its_generator_in_the_tables_of_the_step() -> None:
    detector = detector_of()
    observer = build_observer(detector.system, detector.plan, detector, None, step=STEP)
    tables = observer.tables
    assert sorted(tables.generators.locations) == [0, 1, 2]
    assert tables.decision.kind == "exclusion"
    assert tables.decision.patience_ticks == tables.window_ticks + 1
    for state in tables.tracker:
        for candidate in state.candidates:
            reached = set(tables.tracker[candidate.target].entry_estimate)
            assert {tables.generators.locations[g] for g in candidate.quiet}.isdisjoint(reached)
            assert len(candidate.quiet) >= 1


@pytest.mark.parametrize("kind", ["sprt", "glr"])
def test_a_test_judges_the_locations_of_the_plan_with_white_residuals(kind: str) -> None:
    detector = detector_of(f"decision: {kind}, false_alarm: 1e-3")
    design = detector.decision
    assert [part.location.name for part in detector.generators] == list(detector.plan.generators)
    assert (design.kind, design.false_alarm) == (kind, 1e-3)
    assert all(matrix.shape == (1, 1) for matrix in design.whitening)
    assert (len(design.test), design.limits is None) == ((2, True) if kind == "sprt" else (0, False))
    assert set(detector.detection_delay.values()) == {None}
    assert detector.window_ticks == design.exclude_ticks


def test_a_rarer_false_alarm_asks_for_higher_limits() -> None:
    often, seldom = (detector_of(f"decision: glr, false_alarm: {rate}").decision.limits for rate in (1e-2, 1e-6))
    assert often is not None
    assert seldom is not None
    assert (often < seldom).all()


@pytest.mark.parametrize("missing", ["state: 5, ", ", measurement: 0.01"])
def test_a_test_that_the_bounds_do_not_allow_is_refused(missing: str) -> None:
    with pytest.raises(UsageError, match="DH0614"):
        detector_of("decision: glr", text=MODEL.replace(missing, ""))


@pytest.mark.parametrize("kind", ["sprt", "glr"])
def test_tables_of_a_test_hold_its_numbers(kind: str) -> None:
    detector = detector_of(f"decision: {kind}")
    decision = build_observer(detector.system, detector.plan, detector, None, step=STEP).tables.decision
    assert decision.kind == kind
    assert decision.whitening.shape == (2, 1, 1)
    for matrix, design in zip(decision.whitening, detector.decision.whitening, strict=True):
        assert np.array_equal(matrix, design)
    assert decision.patience_ticks > decision.exclude_ticks
