"""One tick of the reference step: what the text of `observer.tables` says, sentence by sentence."""

import ast
import copy
import inspect
import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from deshybrid.observer import reference, tables
from deshybrid.observer.tables import STATUS_NAMES, Candidate, StepTables, TrackerState, plain_tables
from tests.lockstep.fixtures import small_tables, small_trace

ANY, IN_A, IN_B, IN_C, A_OR_C, A_OR_B = range(6)
QUIET, NOISY = 0.0, 100.0
Step = tuple[int, int, int, int, tuple[float, ...]]


def direct_tables(tracker: tuple[TrackerState, ...], **changes: Any) -> dict[str, Any]:
    """Two generators that show one output each, without memory: generator g is quiet while |y_g| <= 1."""
    small = small_tables()
    generators = replace(
        small.generators,
        matrix=np.zeros((2, 2, 2)),
        input=np.zeros((2, 2, 1)),
        output=np.zeros((2, 2, 2)),
        offset=np.zeros((2, 2)),
        start=np.zeros((2, 2, 2)),
        start_offset=np.zeros((2, 2)),
        residual_state=np.zeros((2, 2, 2)),
        residual_input=np.zeros((2, 2, 1)),
        residual_output=np.array([-np.eye(2), -np.eye(2)]),
        residual_offset=np.zeros((2, 2)),
        weight=np.eye(2),
        release=np.array([2.0, 2.0]),
        on_ticks=(2, 2),
        off_ticks=(1, 1),
    )
    flow = replace(small.flow, output=np.zeros((3, 2, 2)))
    return plain_tables(replace(small, generators=generators, flow=flow, tracker=tracker, **changes))


def drive(constants: dict[str, Any], samples: list[tuple[tuple[float, ...], int]]) -> list[Step]:
    state, seen = reference.start(constants), []
    for output, event in samples:
        state, estimate = reference.step(constants, state, (0.0,), output, event)
        seen.append(estimate)
    return seen


def states(seen: list[Step]) -> list[int]:
    return [estimate[1] for estimate in seen]


def plain_states(*candidates: tuple[Candidate, ...], timeouts: tuple[int, ...] = ()) -> tuple[TrackerState, ...]:
    """States 0, 1, ... with these candidates, events 1 and 2 leading to states 0 and 1; each knows its location."""
    return tuple(
        TrackerState((n % 3,), n % 3, False, (0, 1), wanted, timeouts[n] if timeouts else -1)
        for n, wanted in enumerate(candidates)
    )


def test_reference_imports_nothing_but_typing() -> None:
    tree = ast.parse(inspect.getsource(reference))
    modules = [node.module for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    assert modules == ["typing"]
    assert not [node for node in ast.walk(tree) if isinstance(node, ast.Import)]


def test_reference_and_tables_agree_on_limits_and_statuses() -> None:
    assert reference.LARGEST == tables.LARGEST
    numbers = (reference.SEARCHING, reference.IDENTIFIED, reference.PROVISIONAL)
    assert [STATUS_NAMES[n] for n in numbers] == ["searching", "identified", "provisional"]
    assert [STATUS_NAMES[n] for n in (reference.INCONSISTENT, reference.INVALID)] == ["inconsistent", "invalid"]


def test_a_step_changes_neither_tables_nor_state() -> None:
    constants = plain_tables(small_tables())
    before = copy.deepcopy(constants)
    state = reference.start(constants)
    for sample in small_trace(300):
        kept = copy.deepcopy(state)
        after, _ = reference.step(constants, state, *sample)
        assert repr(state) == repr(kept)
        state = after
    assert constants == before


def test_the_same_samples_give_the_same_estimates() -> None:
    constants = plain_tables(small_tables())
    runs = []
    for _ in range(2):
        state, run = reference.start(constants), []
        for sample in small_trace(500):
            state, estimate = reference.step(constants, state, *sample)
            run.append(estimate)
        runs.append(run)
    assert repr(runs[0]) == repr(runs[1])


def matrix_step(small: StepTables, z: np.ndarray, u: np.ndarray, y: np.ndarray, g: int) -> np.ndarray:
    gen = small.generators
    return np.asarray(gen.matrix[g] @ z + gen.input[g] @ u + gen.output[g] @ y + gen.offset[g])


def test_generators_advance_with_the_sample_before_and_start_from_the_first_output() -> None:
    small, constants = small_tables(), plain_tables(small_tables())
    u, y = np.array([0.3]), np.array([0.7])
    first, _ = reference.step(constants, reference.start(constants), (0.3,), (0.7,), 0)
    second, _ = reference.step(constants, first, (0.1,), (0.2,), 0)
    for g in range(2):
        start = small.generators.start[g] @ y + small.generators.start_offset[g]
        assert first.z[g] == pytest.approx(start)
        assert second.z[g] == pytest.approx(matrix_step(small, start, u, y, g))


def test_estimate_is_held_before_identification_and_advances_after() -> None:
    small, constants = small_tables(), plain_tables(small_tables())
    state = reference.start(constants)
    for y in (50.0, -50.0, 50.0):
        state, estimate = reference.step(constants, state, (0.3,), (y,), 0)
    assert estimate[4] == tuple(small.flow.start)
    state, estimate = reference.step(constants, state, (0.3,), (50.0,), 1)
    assert estimate[4] == tuple(small.flow.start)
    state, estimate = reference.step(constants, state, (0.3,), (50.0,), 0)
    flow = small.flow
    expected = flow.matrix[0] @ flow.start + flow.input[0] @ [0.3] + flow.output[0] @ [50.0] + flow.offset[0]
    assert estimate[4] == pytest.approx(tuple(expected))


def test_a_move_from_one_identified_location_to_another_applies_their_reset() -> None:
    small = small_tables()
    constants = plain_tables(small)
    state = reference.start(constants)._replace(tracker=IN_A, flow=0, x=(2.0, -1.0))
    after = reference.move(constants, state, IN_B)
    assert after.x == pytest.approx(tuple(small.reset_matrix[0] @ [2.0, -1.0] + small.reset_offset[0]))
    assert after.flow == 1


def test_a_provisional_state_keeps_the_flow_and_any_other_unidentified_state_stops_it() -> None:
    constants = plain_tables(small_tables())
    state = reference.start(constants)._replace(tracker=IN_A, flow=0)
    assert reference.move(constants, state, A_OR_B).flow == 0
    assert reference.move(constants, state, ANY).flow == -1
    assert reference.move(constants, state, IN_C).flow == -1  # c has no continuous observer


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, 1.1e30, -1e300])
def test_a_number_that_is_not_finite_is_invalid_and_leaves_relays_and_held_sample_alone(bad: float) -> None:
    constants = plain_tables(small_tables())
    state = reference.start(constants)
    state, _ = reference.step(constants, state, (0.1,), (0.2,), 0)
    after, estimate = reference.step(constants, state, (0.1,), (bad,), 0)
    assert STATUS_NAMES[estimate[3]] == "invalid"
    assert (after.relay, after.debounce, after.active, after.sample) == (
        state.relay,
        state.debounce,
        state.active,
        state.sample,
    )
    assert after.z != state.z
    assert all(math.isfinite(value) for z in (*after.z, after.x) for value in z)


def test_an_event_counts_even_where_the_numbers_are_invalid() -> None:
    constants = plain_tables(small_tables())
    _, estimate = reference.step(constants, reference.start(constants), (math.nan,), (0.0,), 1)
    assert estimate[:2] == (0, IN_A)
    assert STATUS_NAMES[estimate[3]] == "invalid"


def test_nothing_advances_before_the_first_valid_sample() -> None:
    constants = plain_tables(small_tables())
    state = reference.start(constants)
    for _ in range(3):
        state, estimate = reference.step(constants, state, (0.0,), (math.nan,), 0)
        assert (state.z, state.sample) == ((), None)
        assert estimate[4] == (0.5, -0.25)


def test_a_runaway_estimate_goes_back_to_its_start() -> None:
    small = small_tables()
    flow = replace(small.flow, matrix=10.0 * np.array([np.eye(2)] * 3))
    constants = plain_tables(replace(small, flow=flow))
    state = reference.start(constants)._replace(tracker=IN_A, flow=0, x=(9e29, 1.0), sample=((0.0,), (0.0,)))
    state = state._replace(z=((0.0, 0.0), (0.0, 0.0)))
    after, _ = reference.step(constants, state, (0.0,), (0.0,), 0)
    assert after.x == (0.5, -0.25)


def test_relay_switches_on_below_one_and_off_above_the_release_level_only() -> None:
    constants = direct_tables(plain_states((Candidate(0, 0, (), 1),), ()))
    state = reference.start(constants)
    relays = []
    for level in (1.5, 1.0, 1.9, 2.0, 2.1, 1.9, 0.9):
        state, _ = reference.step(constants, state, (0.0,), (level, NOISY), 0)
        relays.append(state.relay[0])
    assert relays == [False, True, True, True, False, False, True]


def test_generator_becomes_active_after_on_ticks_and_inactive_after_off_ticks_in_a_row() -> None:
    constants = direct_tables(plain_states(()))
    constants["generators"][0]["on_ticks"] = 3
    constants["generators"][0]["off_ticks"] = 2
    state = reference.start(constants)
    active = []
    for level in (QUIET, QUIET, NOISY, QUIET, QUIET, QUIET, NOISY, QUIET, NOISY, NOISY):
        state, _ = reference.step(constants, state, (0.0,), (level, NOISY), 0)
        active.append(state.active[0])
    assert active == [False] * 5 + [True, True, True, True, False]


def test_a_residual_signature_waits_while_another_alternative_matches_too() -> None:
    constants = direct_tables(plain_states((Candidate(0, 0, (1,), 1),), ()))
    seen = drive(constants, [((QUIET, QUIET), 0)] * 4 + [((QUIET, NOISY), 0)] * 2)
    assert states(seen) == [0, 0, 0, 0, 1, 1]
    assert [estimate[2] for estimate in seen] == [-1, -1, -1, -1, 0, -1]


def test_a_negation_waits_for_the_window_unless_a_generator_was_active_before() -> None:
    """At the start no generator has had time to become active; later, one that goes quiet is evidence at once."""
    constants = direct_tables(plain_states((Candidate(2, -1, (0, 1), 1),), ()), window_ticks=4)
    assert states(drive(constants, [((NOISY, NOISY), 0)] * 6)) == [0, 0, 0, 0, 1, 1]
    evidence = [((QUIET, NOISY), 0)] * 2 + [((NOISY, NOISY), 0)] * 2
    assert states(drive(constants, evidence)) == [0, 0, 1, 1]


def test_a_signature_that_fired_is_silent_until_its_condition_was_false() -> None:
    """Rising edge: in states 0 and 1 the same signature leads to the other one, but it holds all the time."""
    there_and_back = plain_states((Candidate(0, 0, (), 1),), (Candidate(0, 0, (), 0),))
    samples = [((level, NOISY), 0) for level in (QUIET, QUIET, QUIET, QUIET, NOISY, QUIET, QUIET, QUIET)]
    assert states(drive(direct_tables(there_and_back), samples)) == [0, 1, 1, 1, 1, 1, 0, 0]


def test_a_self_loop_shows_only_when_the_residual_has_left_and_come_back() -> None:
    loop = plain_states((Candidate(0, 0, (), 0),))
    levels = (QUIET, QUIET, QUIET, NOISY, QUIET, QUIET, QUIET)
    seen = drive(direct_tables(loop), [((level, NOISY), 0) for level in levels])
    assert [estimate[2] for estimate in seen] == [-1, -1, -1, -1, -1, 0, -1]


def test_silence_moves_after_the_window_and_a_signature_in_the_last_tick_still_counts() -> None:
    def after(*outputs: tuple[float, float]) -> list[int]:
        tracker = plain_states((), (Candidate(0, 0, (), 2),), (), timeouts=(-1, 0, -1))
        return states(
            drive(direct_tables(tracker, window_ticks=3), [(y, 2 if k == 0 else 0) for k, y in enumerate(outputs)])
        )

    noisy, quiet = (NOISY, NOISY), (QUIET, NOISY)
    assert after(noisy, noisy, noisy, noisy, noisy) == [1, 1, 1, 0, 0]
    assert after(noisy, noisy, quiet, quiet, noisy) == [1, 1, 1, 2, 2]


def test_an_inconsistent_silence_restarts() -> None:
    tracker = plain_states((), (), timeouts=(-1, -2))
    seen = drive(direct_tables(tracker, window_ticks=2), [((NOISY, NOISY), 2)] + [((NOISY, NOISY), 0)] * 2)
    assert states(seen) == [1, 1, ANY]
    assert [STATUS_NAMES[estimate[3]] for estimate in seen] == ["identified", "identified", "inconsistent"]


def test_an_event_and_a_signature_in_one_tick_are_two_moves() -> None:
    constants = direct_tables(plain_states((), (Candidate(0, 0, (), 2),), ()))
    seen = drive(constants, [((QUIET, NOISY), 0), ((QUIET, NOISY), 2)])
    assert states(seen) == [0, 2]
    assert seen[-1][2] == 0


@pytest.mark.parametrize("code", [-1, 3, 99])
def test_a_code_that_is_no_event_restarts_from_everything(code: int) -> None:
    constants = plain_tables(small_tables())
    state = reference.start(constants)._replace(tracker=IN_B)
    after, estimate = reference.step(constants, state, (0.0,), (0.0,), code)
    assert (after.tracker, STATUS_NAMES[estimate[3]]) == (ANY, "inconsistent")


def test_an_unexplained_event_restarts_from_what_it_allows() -> None:
    constants = plain_tables(small_tables())
    state = reference.start(constants)._replace(tracker=IN_A)
    after, estimate = reference.step(constants, state, (0.0,), (50.0,), 1)
    assert (after.tracker, STATUS_NAMES[estimate[3]]) == (IN_A, "inconsistent")


def test_sums_run_from_left_to_right_and_start_from_the_first_product() -> None:
    """Cancellation makes the order visible: 1e16 + 1 - 1e16 is 0 from the left."""
    assert reference.affine(((1e16, 1.0, -1e16),), (0.0,), (1.0, 1.0, 1.0)) == (0.0,)
    assert math.copysign(1.0, reference.affine(((-0.0,),), (-0.0,), (1.0,))[0]) == -1.0


def test_plain_tables_keep_every_bit() -> None:
    small = small_tables()
    constants = plain_tables(small)
    rows = np.array(constants["flow_rows"])
    assert np.array_equal(rows, np.concatenate((small.flow.matrix, small.flow.input, small.flow.output), axis=2))
    assert np.array_equal(np.array(constants["generators"][1]["residual_rows"]), [[1.0, 0.0, 0.05, -1.0]])


def test_a_residual_that_is_still_small_when_an_event_comes_is_no_signature() -> None:
    """The residual of the location just left is small for a while; only when it comes back does it say anything."""
    constants = direct_tables(plain_states((), (Candidate(0, 0, (), 2),), ()))
    samples = [(QUIET, NOISY)] * 3 + [(NOISY, NOISY)] * 2 + [(QUIET, NOISY)] * 2
    events = [0, 0, 2, 0, 0, 0, 0]
    assert states(drive(constants, list(zip(samples, events, strict=True)))) == [0, 0, 1, 1, 1, 1, 2]
