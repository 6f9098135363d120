"""Executions against closed forms, and every reason to stop."""

import math
import os
import subprocess
import sys

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.diagnostics import UsageError, catalogue, render
from deshybrid.model.load import loads
from deshybrid.model.timing import sampling_step
from deshybrid.simulate.execution import row_times, simulate
from deshybrid.simulate.trace import parse_trace, write_trace

THERMOSTAT = """
format: deshybrid/1
name: thermostat
state: [T]
output: [y]
observer: {step: 0.1}
locations:
  heat: {A: [[-1]], f: [3], C: [[1]]}
  cool: {A: [[-1]], f: [0], C: [[1]]}
transitions:
  - {from: heat, to: cool, event: hot, emits: warm, guard: "T >= 2"}
  - {from: cool, to: heat, event: cold, emits: null, guard: "T <= 1"}
simulation: {location: heat, state: [1], duration: 10}
"""
BALL = """
format: deshybrid/1
name: ball
state: [h, v]
output: [y]
observer: {step: 0.01}
locations:
  air: {A: [[0, 1], [0, 0]], f: [0, -10], C: [[1, 0]], invariant: "h >= 0"}
transitions:
  - {from: air, to: air, event: bounce, emits: knock, guard: "h <= 0 & v <= 0", reset: {matrix: [[1, 0], [0, -0.5]]}}
simulation: {state: [5, 0], duration: 20}
"""


def _model(locations: str, transitions: str, extra: str = "", state: str = "[x]", output: str = "[y]"):
    return loads(
        f"format: deshybrid/1\nname: m\nstate: {state}\noutput: {output}\n"
        f"locations:\n{locations}\ntransitions:\n{transitions}\n{extra}\n"
    )


# ---- flows and event times against closed forms -------------------------------------------------------------------


def test_thermostat_switches_at_the_times_of_the_closed_form():
    heating, cooling = math.log(2.0), math.log(2.0)  # 1 → 2 towards 3, and 2 → 1 towards 0
    expected = np.cumsum([heating, cooling] * 8)
    run = simulate(loads(THERMOSTAT), seed=1)
    times = [s.time for s in run.switches]
    np.testing.assert_allclose(times, expected[: len(times)], rtol=0, atol=1e-11)
    assert len(times) == math.floor(10 / math.log(2.0))
    assert [s.event for s in run.switches[:3]] == ["hot", "cold", "hot"]
    assert run.stop is None


@pytest.mark.parametrize("substeps", [1, 3, 50])
def test_event_times_do_not_depend_on_the_substeps_where_nothing_is_held(substeps):
    run = simulate(loads(THERMOSTAT), seed=1, substeps=substeps)
    fine = simulate(loads(THERMOSTAT), seed=1)
    np.testing.assert_allclose([s.time for s in run.switches], [s.time for s in fine.switches], atol=1e-10)
    np.testing.assert_allclose(run.trace.true_state, fine.trace.true_state, atol=1e-10)


def test_flow_equals_the_matrix_exponential_of_the_whole_stay():
    system = _model(
        "  a: {A: [[0, 1], [-4, -0.4]], B: [[0], [2]], f: [0.5, 0], C: [[1, 0]]}",
        "  - {from: a, to: a, event: never, guard: 'p >= 1000'}",
        "input: [u]\nobserver: {step: 0.25}\nsimulation: {state: [1, -1], duration: 10, input: {u: 0.7}}",
        state="[p, q]",
    )
    run = simulate(system, seed=3)
    block = np.zeros((3, 3))
    block[:2, :2], block[:2, 2] = [[0, 1], [-4, -0.4]], [0.5, 1.4]
    for time, state in zip(run.trace.time, run.trace.true_state, strict=True):
        np.testing.assert_allclose(state, (expm(block * time) @ [1, -1, 1])[:2], atol=1e-12)
    np.testing.assert_array_equal(run.trace.inputs, 0.7)
    np.testing.assert_allclose(run.trace.outputs[:, 0], run.trace.true_state[:, 0])


@pytest.mark.parametrize("substeps", [10, 16])
def test_grazing_contact_much_shorter_than_a_substep_is_found(substeps):
    """sin(t) exceeds 0.999999 for 2.8 ms around π/2, while a sub-step lasts more than 60 ms."""
    system = _model(
        "  a: {A: [[0, 1], [-1, 0]], C: [[1, 0]]}\n  b: {A: [[0, 0], [0, 0]], C: [[1, 0]]}",
        "  - {from: a, to: b, event: touch, guard: 'p >= 0.999999'}\n"
        "  - {from: b, to: a, event: never, guard: 'p >= 9'}",
        "observer: {step: 1.0}\nsimulation: {location: a, state: [0, 1], duration: 3}",
        state="[p, q]",
    )
    run = simulate(system, substeps=substeps)
    assert [s.time for s in run.switches] == pytest.approx([math.asin(0.999999)], abs=1e-9)


def test_equality_guard_fires_where_the_state_passes_through_the_value():
    system = _model(
        "  a: {A: [[0]], f: [1], C: [[1]]}\n  b: {A: [[0]], f: [-1], C: [[1]]}",
        "  - {from: a, to: b, event: up, guard: 'x == 0.777'}\n  - {from: b, to: a, event: down, guard: 'x == 0'}",
        "observer: {step: 0.1}\nsimulation: {location: a, state: [0], duration: 2}",
    )
    times = [s.time for s in simulate(system).switches]
    assert times == pytest.approx([0.777, 1.554], abs=1e-10)


def test_conjunction_holds_only_once_all_of_it_holds():
    system = _model(
        "  a: {A: [[0, 0], [0, 0]], f: [1, 2], C: [[1, 0]]}\n  b: {A: [[0, 0], [0, 0]], C: [[1, 0]]}",
        "  - {from: a, to: b, event: both, guard: 'p >= 0.52 & q >= 0.93'}\n"
        "  - {from: b, to: a, event: never, guard: '!(p <= 5) | q >= 9'}",
        "observer: {step: 0.1}\nsimulation: {location: a, state: [0, 0], duration: 1}",
        state="[p, q]",
    )
    assert [s.time for s in simulate(system).switches] == pytest.approx([0.52], abs=1e-10)


def test_guard_on_an_input_fires_when_the_input_jumps():
    system = _model(
        "  a: {A: [[0]], B: [[0]], C: [[1]]}\n  b: {A: [[0]], B: [[0]], C: [[1]]}",
        "  - {from: a, to: b, event: on, guard: 'u >= 1'}\n  - {from: b, to: a, event: off, guard: 'u <= 0'}",
        "input: [u]\nobserver: {step: 0.1}\n"
        "simulation: {location: a, duration: 3, input: {u: {points: [[0, 0], [1, 1], [2, 0]]}}}",
    )
    run = simulate(system)
    assert [s.time for s in run.switches] == pytest.approx([1.0, 2.0], abs=1e-12)
    assert run.trace.true_location[9:11] == ("a", "b")


def test_reset_is_applied_and_the_flow_goes_on_from_it():
    run = simulate(loads(BALL), duration=1.5)
    fall = 1.0  # sqrt(2 · 5 / 10)
    assert run.switches[0].time == pytest.approx(fall, abs=1e-10)
    rest = run.trace.time[101:] - fall
    np.testing.assert_allclose(run.trace.true_state[101:, 0], 5.0 * rest - 5.0 * rest**2, atol=1e-9)


def test_row_shows_what_is_true_after_all_events_up_to_its_time():
    system = _model(
        "  a: {A: [[0]], C: [[1]]}\n  b: {A: [[0]], C: [[1]]}",
        "  - {from: a, to: b, event: go, emits: gone, reset: {matrix: [[1]], offset: [5]}}\n"
        "  - {from: b, to: a, event: back, emits: here}",
        "observer: {step: 0.1}\nsimulation: {location: a, duration: 1, requests: [[0.3, go], [0.65, back]]}",
    )
    run = simulate(system)
    assert [i for i, event in enumerate(run.trace.events) if event] == [3, 7]
    assert run.trace.true_location == ("a",) * 3 + ("b",) * 4 + ("a",) * 4
    assert run.trace.true_state[:, 0].tolist() == [0.0] * 3 + [5.0] * 8
    assert [s.time for s in run.switches] == pytest.approx([0.3, 0.65], abs=1e-12)


def test_discrete_time_is_the_plain_recursion_with_one_transition_a_step():
    system = _model(
        "  a: {A: [[1.1]], B: [[1]], C: [[2]]}\n  b: {A: [[0.5]], B: [[0]], C: [[2]]}",
        "  - {from: a, to: b, event: up, emits: α, guard: 'x >= 4'}\n"
        "  - {from: b, to: a, event: down, emits: β, guard: 'x <= 1'}",
        "time: {step: 0.2}\ninput: [u]\nsimulation: {location: a, state: [1], duration: 8, input: {u: 0.25}}",
    )
    run = simulate(system)
    x, place, states, places = 1.0, "a", [], []
    for _ in range(41):
        if place == "a" and x >= 4:
            place = "b"
        elif place == "b" and x <= 1:
            place = "a"
        states.append(x)
        places.append(place)
        x = 1.1 * x + 0.25 if place == "a" else 0.5 * x
    np.testing.assert_allclose(run.trace.true_state[:, 0], states, rtol=1e-12)
    assert run.trace.true_location == tuple(places)
    assert {e for e in run.trace.events if e} == {"α", "β"}


# ---- requests, stays, forced exits -------------------------------------------------------------------------------

TWO = "  a: {A: [[0]], f: [1], C: [[1]]%s}\n  b: {A: [[0]], f: [1], C: [[1]]}"
THERE_AND_BACK = "  - {from: a, to: b, event: go, emits: α%s}\n  - {from: b, to: a, event: back, emits: β}"
START = "observer: {step: 0.1}\nsimulation: {location: a, state: [0], duration: 6%s}"


def test_request_waits_until_its_guard_holds():
    guard, requests = ", guard: 'x >= 2.345'", ", requests: [[1, go], [3, back]]"
    run = simulate(_model(TWO % "", THERE_AND_BACK % guard, START % requests))
    assert [s.time for s in run.switches] == pytest.approx([2.345, 3.0], abs=1e-10)
    assert run.pending == ()


def test_requested_event_is_not_urgent_before_its_request():
    guard, requests = ", guard: 'x >= 1'", ", requests: [[2.5, go]]"
    run = simulate(_model(TWO % "", THERE_AND_BACK % guard, START % requests))
    assert [s.time for s in run.switches] == pytest.approx([2.5], abs=1e-12)


def test_requests_are_met_in_order_and_the_rest_is_reported():
    requests = ", requests: [[1, back], [2, go]]"
    run = simulate(_model(TWO % "", THERE_AND_BACK % "", START % requests))
    assert run.switches == ()
    assert run.pending == ((1.0, "back"), (2.0, "go"))


def test_request_and_guard_wait_for_the_shortest_stay():
    guard = ", guard: 'x >= 1'"
    run = simulate(_model(TWO % ", dwell: {min: 1.75}", THERE_AND_BACK % guard, START % ""))
    assert run.switches[0].time == pytest.approx(1.75, abs=1e-12)
    asked = simulate(_model(TWO % ", dwell: {min: 1.75}", THERE_AND_BACK % "", START % ", requests: [[1, go]]"))
    assert asked.switches[0].time == pytest.approx(1.75, abs=1e-12)


def test_stays_without_request_lie_between_the_dwell_times():
    extra = START % "" + "\n"
    system = _model(
        TWO % ", dwell: {min: 0.2, max: 0.5}", THERE_AND_BACK % "", extra.replace("duration: 6", "duration: 200")
    )
    switches = simulate(system, seed=5).switches
    stays = np.diff([0.0, *(s.time for s in switches)])
    in_a, in_b = stays[::2], stays[1::2]
    assert ((in_a >= 0.2) & (in_a <= 0.5)).all()
    assert np.ptp(in_a) > 0.25
    assert ((in_b >= 1.0) & (in_b <= 3.0)).all()  # nothing is stated for b: 1 s to 3 s


def test_longest_stay_forces_a_transition_that_was_not_requested():
    requests = ", requests: [[5, go]]"
    run = simulate(_model(TWO % ", dwell: {max: 2}", THERE_AND_BACK % "", START % requests))
    assert [(s.time, s.event) for s in run.switches] == [(pytest.approx(2.0), "go")]


def test_invariant_forces_a_transition_without_guard():
    requests = ", requests: [[5, go]]"
    run = simulate(_model(TWO % ", invariant: 'x <= 1.5'", THERE_AND_BACK % "", START % requests))
    assert run.switches[0].time == pytest.approx(1.5, abs=1e-10)


def test_guard_on_the_edge_of_the_invariant_fires_instead_of_stopping_the_run():
    guard = ", guard: 'x >= 1.5'"
    run = simulate(_model(TWO % ", invariant: 'x <= 1.5'", THERE_AND_BACK % guard, START % ""))
    assert run.switches[0].time == pytest.approx(1.5, abs=1e-10)


# ---- reasons to stop ---------------------------------------------------------------------------------------------


def _stopped(system, **options):
    run = simulate(system, **options)
    assert run.stop is not None
    assert run.stop.diagnostic.code in catalogue()
    assert run.stop.message in render(run.stop.diagnostic)
    assert len(run.trace) == math.floor(run.stop.time / run.step + 1e-9) + 1
    return run


def test_bouncing_ball_stops_with_zeno_behaviour_and_its_accumulation_time():
    run = _stopped(loads(BALL))
    assert run.stop.kind == "zeno"
    assert "accumulate at about 3 s" in run.stop.message  # 1 + 1 + 1/2 + 1/4 + ...
    stays = np.diff([s.time for s in run.switches])
    np.testing.assert_allclose(stays[1:] / stays[:-1], 0.5, rtol=1e-6)


def test_zeno_behaviour_of_silent_transitions_is_found_too():
    assert _stopped(loads(BALL.replace("emits: knock", "emits: null"))).stop.kind == "zeno"


def test_two_guards_at_one_instant_stop_the_run():
    transitions = (
        "  - {from: a, to: b, event: one, guard: 'x >= 1.234'}\n"
        "  - {from: a, to: a, event: two, guard: '2 * x >= 2.468'}\n  - {from: b, to: a, event: back}"
    )
    run = _stopped(_model(TWO % "", transitions, START % ""))
    assert (run.stop.kind, run.stop.time) == ("simultaneous", pytest.approx(1.234))
    assert "`one` and `two`" in run.stop.message


def test_run_that_cannot_begin_has_the_row_of_its_beginning():
    transitions = (
        "  - {from: a, to: b, event: one, guard: 'x >= -1'}\n  - {from: a, to: a, event: two, guard: 'x <= 1'}\n"
        "  - {from: b, to: a, event: back}"
    )
    run = _stopped(_model(TWO % "", transitions, START % ""))
    assert (run.stop.kind, run.stop.time, len(run.trace)) == ("simultaneous", 0.0, 1)


def test_guard_that_holds_on_entry_stops_the_run():
    transitions = (
        "  - {from: a, to: b, event: one, guard: 'x >= 1.03'}\n  - {from: b, to: a, event: two, guard: 'x >= 0.5'}"
    )
    run = _stopped(_model(TWO % "", transitions, START % ""))
    assert (run.stop.kind, run.stop.time) == ("simultaneous", pytest.approx(1.03))
    assert len(run.switches) == 1


@pytest.mark.parametrize("edge", [1, 1.03, 1.2345678])
def test_guard_whose_edge_is_left_at_once_does_not_stop_the_run(edge):
    locations = "  a: {A: [[0]], f: [1], C: [[1]]}\n  b: {A: [[0]], f: [2], C: [[1]], dwell: {max: 100}}"
    transitions = (
        f"  - {{from: a, to: b, event: one, guard: 'x >= {edge}'}}\n"
        f"  - {{from: b, to: a, event: two, guard: 'x <= {edge}'}}"
    )
    run = simulate(_model(locations, transitions, START % ""))
    assert run.stop is None
    assert len(run.switches) == 1


def test_one_event_with_two_targets_is_a_choice_and_no_conflict():
    transitions = (
        "  - {from: a, to: b, event: go, guard: 'x >= 1'}\n  - {from: a, to: c, event: go, guard: 'x >= 1'}\n"
        "  - {from: b, to: a, event: back}\n  - {from: c, to: a, event: back}"
    )
    system = _model(TWO % "" + "\n  c: {A: [[0]], f: [1], C: [[1]]}", transitions, START % "")
    targets = {simulate(system, seed=seed).switches[0].target for seed in range(12)}
    assert targets == {"b", "c"}


def test_longest_stay_without_an_enabled_transition_stops_the_run():
    run = _stopped(_model(TWO % ", dwell: {max: 2}", THERE_AND_BACK % ", guard: 'x >= 3'", START % ""))
    assert (run.stop.kind, run.stop.time) == ("blocked", pytest.approx(2.0))


def test_invariant_without_an_enabled_transition_stops_the_run():
    run = _stopped(_model(TWO % ", invariant: 'x <= 1.53'", THERE_AND_BACK % ", guard: 'x >= 3'", START % ""))
    assert (run.stop.kind, run.stop.time) == ("invariant", pytest.approx(1.53))


def test_growth_beyond_all_numbers_stops_the_run():
    system = _model("  a: {A: [[40]], C: [[1]]}", "  - {from: a, to: a, event: e, guard: 'x <= -1'}", START % "")
    run = simulate(loads(system.source.text.text.replace("state: [0]", "state: [1]")))
    assert (run.stop.kind, run.stop.time) == ("unstable", pytest.approx(math.log(1e30) / 40, abs=0.02))
    assert np.isfinite(run.trace.true_state).all()


def test_two_outputs_in_one_step_stop_the_run():
    run = _stopped(_model(TWO % "", THERE_AND_BACK % "", START % ", requests: [[1.02, go], [1.07, back]]"))
    assert (run.stop.kind, run.stop.time) == ("crowded", pytest.approx(1.07))


def test_silent_transition_and_output_in_one_step_go_on():
    transitions = "  - {from: a, to: b, event: go, emits: null}\n  - {from: b, to: a, event: back, emits: β}"
    run = simulate(_model(TWO % "", transitions, START % ", requests: [[1.02, go], [1.07, back]]"))
    assert run.stop is None
    assert run.trace.events[11] == "β"


def test_stop_points_at_the_transition_in_the_model_file():
    text = render(simulate(loads(BALL)).stop.diagnostic)
    assert "error[DH0710]" in text
    assert "event: bounce" in text


# ---- signals and sensors -----------------------------------------------------------------------------------------

SENSED = """
format: deshybrid/1
name: sensed
state: [x]
input: [u]
output: [y, z]
observer: {step: 0.1}
locations:
  a: {A: [[0]], B: [[1]], C: [[1], [10]]}
  b: {A: [[0]], B: [[1]], output: [z], C: [[10]]}
transitions:
  - {from: a, to: b, event: go}
  - {from: b, to: a, event: back}
simulation:
  location: a
  state: [0]
  duration: 4
  requests: [[2, go]]
  input: {u: 1}
  measurement: {y: {quantum: 0.25}, z: {delay: 0.35}}
"""


def test_sensor_rounds_to_its_quantum_and_delays_by_its_delay():
    trace = simulate(loads(SENSED)).trace
    np.testing.assert_allclose(trace.outputs[:20, 0], np.round(trace.true_state[:20, 0] * 4) / 4, atol=1e-12)
    np.testing.assert_allclose(trace.outputs[4:, 1], 10 * (trace.time[4:] - 0.35), atol=1e-9)
    np.testing.assert_allclose(trace.outputs[:4, 1], 0.0, atol=1e-12)


def test_channel_that_the_location_does_not_measure_is_empty():
    trace = simulate(loads(SENSED)).trace
    assert np.isfinite(trace.outputs[:20, 0]).all()
    assert np.isnan(trace.outputs[20:, 0]).all()
    assert np.isfinite(trace.outputs[:, 1]).all()


def test_noise_has_the_stated_deviation_and_unstated_channels_stay_within_their_bound():
    text = SENSED.replace("y: {quantum: 0.25}, z: {delay: 0.35}", "z: {noise: 2}")
    text = text.replace("duration: 4", "duration: 400").replace("requests: [[2, go]]", "requests: [[1000, go]]")
    trace = simulate(loads(text + "bounds: {measurement: 0.5}\n"), seed=2, substeps=1).trace
    noise = trace.outputs - np.outer(trace.true_state[:, 0], [1.0, 10.0])
    assert noise[:, 1].std() == pytest.approx(2.0, rel=0.05)
    assert np.abs(noise[:, 0]).max() <= 0.5 + 1e-9
    assert np.abs(noise[:, 0]).max() > 0.45


def test_unmeasured_part_of_an_input_moves_the_plant_and_is_not_in_the_trace():
    text = SENSED + "  unmeasured: {u: {points: [[0, 0], [1, 2]]}}\n"
    trace = simulate(loads(text)).trace
    np.testing.assert_array_equal(trace.inputs, 1.0)
    assert trace.true_state[-1, 0] == pytest.approx(4.0 + 2.0 * 3.0)


def test_ripple_is_sampled_finely_enough_to_cancel_over_a_period():
    text = SENSED.replace("u: 1}", "u: {amplitude: 5, frequency: 50}}")
    trace = simulate(loads(text)).trace
    assert np.abs(trace.true_state[:, 0]).max() < 5 / (2 * math.pi * 50) * 2.5


def test_unmentioned_inputs_and_disturbances_move_within_their_bounds():
    text = SENSED.replace("  input: {u: 1}\n", "").replace("duration: 4", "duration: 50")
    system = loads(text + "bounds: {input: 3, disturbance: 0.5, state: 2}\n")
    trace = simulate(system, seed=4).trace
    assert np.abs(trace.inputs).max() <= 3.0
    assert len(set(trace.inputs[:, 0].tolist())) == 51
    drift = np.diff(trace.true_state[:, 0]) / 0.1 - trace.inputs[:-1, 0]
    assert np.abs(drift).max() <= 0.5 + 1e-9
    assert np.abs(drift).max() > 0.4


def test_initial_state_is_drawn_within_bounds_and_invariant():
    system = _model(
        "  a: {A: [[0]], C: [[1]], invariant: 'x >= 1.9'}",
        "  - {from: a, to: a, event: e, guard: 'x <= -9'}",
        "bounds: {state: 2}\nobserver: {step: 0.1}",
    )
    starts = [simulate(system, seed=seed, duration=0.1).trace.true_state[0, 0] for seed in range(20)]
    assert all(1.9 <= x <= 2.0 for x in starts)
    assert len(set(starts)) == 20


# ---- seeds, bytes, calls -----------------------------------------------------------------------------------------


def _random_system():
    extra = "input: [u]\nbounds: {input: 1, disturbance: 0.1, measurement: 0.01, state: 3}\nobserver: {step: 0.1}"
    locations = "  a: {A: [[-1]], B: [[1]], C: [[1]]}\n  b: {A: [[-2]], B: [[1]], C: [[1]]}"
    transitions = "  - {from: a, to: b, event: go, emits: [α, β, null]}\n  - {from: b, to: a, event: back, emits: β}"
    return _model(locations, transitions, extra)


def test_same_seed_gives_the_same_bytes_and_another_seed_others():
    texts = [write_trace(simulate(_random_system(), seed=seed, duration=20).trace) for seed in (1, 1, 2)]
    assert texts[0] == texts[1] != texts[2]


def test_bytes_do_not_depend_on_the_hash_seed(tmp_path):
    path = tmp_path / "model.yaml"
    path.write_text(_random_system().source.text.text, encoding="utf-8")
    code = (
        "import sys; from deshybrid.model.load import load; from deshybrid.simulate.execution import simulate;"
        "from deshybrid.simulate.trace import write_trace;"
        "sys.stdout.buffer.write(write_trace(simulate(load(sys.argv[1]), seed=3, duration=9).trace).encode())"
    )
    texts = {
        subprocess.run(
            [sys.executable, "-c", code, str(path)],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("0", "7")
    }
    assert len(texts) == 1
    assert texts.pop().startswith(b"time,u,y,event,true_location,true_x\n")


def test_all_of_several_outputs_are_shown_in_the_long_run():
    run = simulate(_random_system(), seed=1, duration=100, substeps=1)
    shown = {s.output for s in run.switches if s.event == "go"}
    assert shown == {"α", "β", None}


def test_simulated_trace_is_read_back_as_it_was():
    system = _random_system()
    trace = simulate(system, seed=1, duration=20).trace
    again = parse_trace(write_trace(trace), system)
    np.testing.assert_array_equal(again.true_state, trace.true_state)
    assert (again.events, again.true_location) == (trace.events, trace.true_location)


def test_row_times_do_not_accumulate_the_step():
    times = row_times(1_000_001, 0.012)
    assert times[-1] == 12000.0
    assert times[7] == 0.084


def test_purely_discrete_model_gives_one_row_for_each_transition():
    system = loads(
        "format: deshybrid/1\nname: d\nlocations: [p, q]\n"
        "transitions: [{from: p, to: q, event: a, emits: α}, {from: q, to: p, event: b, emits: null}]\n"
    )
    run = simulate(system, seed=1, duration=30)
    assert run.step is None
    assert run.trace.time.tolist() == [0.0, *(s.time for s in run.switches)]
    assert run.trace.events == (None, *(s.output for s in run.switches))
    assert run.trace.true_location == (run.switches[0].source, *(s.target for s in run.switches))
    assert write_trace(run.trace).startswith("time,event,true_location\n0.0,,")


@pytest.mark.parametrize(
    ("options", "code"),
    [
        ({"seed": -1}, "DH0701"),
        ({"duration": -1.0}, "DH0702"),
        ({"duration": math.inf}, "DH0702"),
        ({"duration": math.nan}, "DH0702"),
        ({"step": 0.0}, "DH0703"),
        ({"step": math.nan}, "DH0703"),
        ({"duration": 1e9}, "DH0704"),
        ({"step": 1e-300}, "DH0704"),
    ],
)
def test_call_that_makes_no_sense_is_refused_with_its_code(options, code):
    with pytest.raises(UsageError) as caught:
        simulate(loads(THERMOSTAT), **options)
    assert [d.code for d in caught.value.diagnostics] == [code]
    assert code in catalogue()


def test_too_many_sub_steps_of_a_step_of_the_model_are_shown_where_it_is_written():
    with pytest.raises(UsageError) as caught:
        simulate(loads(THERMOSTAT.replace("observer: {step: 0.1}", "observer: {step: 1e-12}")))
    (found,) = caught.value.diagnostics
    assert found.code == "DH0704"
    assert found.span is not None
    assert found.span.line == 1 + THERMOSTAT[: THERMOSTAT.index("observer:")].count("\n")


def test_a_missing_step_is_derived_and_one_between_those_of_the_model_is_refused():
    unstated = loads(THERMOSTAT.replace("observer: {step: 0.1}", ""))
    assert simulate(unstated, duration=4).step == sampling_step(unstated)
    sampled = loads(THERMOSTAT.replace("observer: {step: 0.1}", "time: {step: 0.2}").replace("-1", "0.5"))
    assert len(simulate(sampled, step=0.4, duration=4).trace) == 11
    for step in (0.3, 0.1):
        with pytest.raises(UsageError):
            simulate(sampled, step=step)


DISCRETE = """
format: deshybrid/1
name: d
locations: {p: {dwell: {min: 1, max: 4}}, q: {}}
transitions: [{from: p, to: q, event: a, emits: α}, {from: q, to: p, event: b, emits: null}]
simulation: {location: p, duration: 20, requests: [[0.5, a], [3, b], [9, b]]}
"""


def test_requests_of_a_discrete_model_wait_for_the_shortest_stay_and_the_longest_forces():
    run = simulate(loads(DISCRETE))
    assert [(s.time, s.event) for s in run.switches] == [(1.0, "a"), (3.0, "b"), (7.0, "a"), (9.0, "b"), (13.0, "a")]
    assert (run.pending, run.stop) == ((), None)


def test_two_requests_at_one_instant_stop_a_discrete_run():
    run = simulate(loads(DISCRETE.replace("[0.5, a], [3, b], [9, b]", "[3, a], [3, b]")))
    assert (run.stop.kind, run.stop.time, len(run.switches)) == ("simultaneous", 3.0, 1)
