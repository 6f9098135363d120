"""What is proven of delays, on models small enough to reckon with; random plants: tests/property."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from deshybrid import compiler
from deshybrid.detector.detector import TransitionDetector, build_detector
from deshybrid.detector.excitation import Excitation, excitation_lines, excitations, proven_seconds
from deshybrid.detector.motions import motions
from deshybrid.model.load import load, loads
from deshybrid.model.system import Decision, HybridSystem
from deshybrid.observer.hybrid import build_observer

PUMP = """\
format: deshybrid/1
name: pump
state: [h]
input: [u]
output: [y]
disturbance: [w]
defaults: {C: [[1]], E: [[1]], B: [[1]]}
bounds: {state: 4, input: 10, disturbance: 0.01, measurement: 0.01}
locations: {on: {A: [[-1]], f: [2]}, off: {A: [[-1]]}, leak: {A: [[-3]]}}
transitions:
  - {from: on, to: off, event: a}
  - {from: off, to: on, event: b}
  - {from: off, to: leak, event: c}
  - {from: leak, to: off, event: d}
observer: {dwell: 4, step: 0.02, detector: {decision: relay}}
"""


@cache
def found(text: str = PUMP) -> tuple[TransitionDetector, dict[tuple[str, str, str], Excitation]]:
    system = loads(text)
    detector = build_detector(system, compiler.recover(system).plan, rate=1.0, step=0.02)
    return detector, {(e.source, e.target, e.motion.name): e for e in excitations(detector)}


def test_a_known_offset_is_seen_even_at_rest() -> None:
    excitation = found()[1]["off", "on", "rest"]
    assert excitation.least == 0.0
    assert excitation.seconds is not None


def test_two_locations_without_offsets_are_not_told_apart_at_rest() -> None:
    excitation = found()[1]["leak", "off", "rest"]
    assert (excitation.least, excitation.seconds) == (None, None)
    assert "nothing moves" in excitation.reason


def test_the_motions_of_a_location_are_its_modes_its_inputs_and_rest_up_to_the_bounds() -> None:
    system = loads(PUMP)
    mode, held, rest = motions(system, system.location("leak"))
    assert (mode.state.tolist(), held.name, rest.kind) == ([4.0], "u held", "rest")
    assert held.state == pytest.approx([10 / 3])
    assert held.input == pytest.approx([10.0])


def test_more_strength_never_takes_longer_and_the_least_is_the_limit() -> None:
    detector, all_found = found()
    excitation = all_found["off", "leak", "u held"]
    assert excitation.least is not None
    taken = [proven_seconds(detector, excitation, s) for s in (excitation.least, 0.7, 0.85, 1.0)]
    finite = [seconds for seconds in taken if seconds is not None]
    assert len(finite) == 4
    assert finite == sorted(finite, reverse=True)
    assert proven_seconds(detector, excitation, excitation.least * 0.99) is None
    assert finite[0] <= detector.window + 1e-9


def driveline(decision: Decision) -> HybridSystem:
    """Third and fourth gear and the open clutch."""
    whole, kept = load("models/balluchi2012/driveline.yaml"), ("q3", "q4", "qN")
    return replace(
        whole,
        locations=tuple(location for location in whole.locations if location.name in kept),
        transitions=tuple(arc for arc in whole.transitions if {arc.source, arc.target} <= set(kept)),
        initial=kept,
        observer=replace(whole.observer, detector=replace(whole.observer.detector, decision=decision)),
    )


def test_a_clutch_that_opens_in_step_is_not_proven_and_one_that_closes_on_moving_wheels_is() -> None:
    system = driveline("relay")
    detector = build_detector(system, compiler.recover(system).plan, rate=1.0, step=0.012)
    every = excitations(detector)
    opening = [e for e in every if (e.source, e.target) == ("q3", "qN")]
    assert [e.seconds for e in opening if e.motion.name.startswith("as in q3")] == [None, None]
    proven = [e.seconds for e in every if e.target == "q3" and e.seconds is not None]
    assert proven
    assert max(proven) <= detector.window < 0.9


def test_nothing_is_proven_of_a_decision_by_a_test() -> None:
    system = driveline("glr")
    every = excitations(build_detector(system, compiler.recover(system).plan, rate=1.0, step=0.012))
    assert every
    assert all(e.seconds is None and "matter of chance" in e.reason for e in every)
    lines = excitation_lines(every, 0.5, 0.9)
    assert len(lines) == 2
    assert "nothing: how long a test takes" in lines[1]


def test_a_design_tells_what_is_proven_in_text_and_json() -> None:
    made = compiler.design(loads(PUMP))
    records = made.document()["excitation"]
    assert isinstance(records, list)
    assert [record["transition"] for record in records] == [[e.source, e.target] for e in made.excitations]
    assert "off -> on: within" in str(made)


def test_the_lines_say_where_the_window_is_not_below_the_dwell_time() -> None:
    excitation = found()[1]["off", "leak", "u held"]
    assert "below the dwell time of 4 s" in excitation_lines([excitation], 1.0, 4.0)[0]
    assert "NOT below" in excitation_lines([excitation], 5.0, 4.0)[0]
    assert excitation_lines([], 1.0, 4.0) == []


@pytest.mark.parametrize("share", [1.0, 0.8])
def test_no_disturbance_and_noise_make_a_signature_later_than_proven(share: float) -> None:
    """`off` to `leak` without a reset; `off` keeps the level that `leak` will keep with more input."""
    detector, all_found = found()
    excitation = all_found["off", "leak", "u held"]
    assert excitation.least is not None
    strength = excitation.least + share * (1.0 - excitation.least)
    bound = proven_seconds(detector, excitation, strength)
    assert bound is not None
    late = [named_after(detector, strength, np.random.default_rng(seed)) for seed in range(12)]
    assert max(late) <= bound + 1e-9


def named_after(detector: TransitionDetector, strength: float, rng: np.random.Generator) -> float:
    """Seconds from the first sample in `leak` until it is named; in `off` the level is where `leak` will hold it."""
    system, step = detector.system, detector.step
    observer = build_observer(system, detector.plan, detector, None, step=step)
    state, x, level = observer.start(), 10 * strength / 3, 10 * strength / 3
    for k in range(1000):
        inside = k < 400  # off with u = level holds x = level
        u, v = (level if inside else 10 * strength), 0.01 * rng.choice([-1, 1])
        w = 0.0 if inside else 0.01 * rng.choice([-1, 1])
        state, estimate = observer.step(state, [u], [x + v], None)
        if not inside and estimate.location == "leak":
            return (k - 400) * step
        rate = 1.0 if inside else 3.0
        x = x * np.exp(-rate * step) + (u + w) * (1 - np.exp(-rate * step)) / rate
    return np.inf
