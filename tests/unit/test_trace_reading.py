"""Traces from strangers: what is read, what is refused, and where the message points."""

from pathlib import Path

import numpy as np
import pytest

from deshybrid.diagnostics import TraceError, catalogue, render
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, HybridTransition, Location, ObserverOptions
from deshybrid.simulate.table import MAX_LINE
from deshybrid.simulate.trace import Trace, parse_trace, read_trace, write_trace

FOLDER = Path(__file__).parent / "bad_traces"
TABLE = [line.split() for line in (FOLDER / "expected.txt").read_text().splitlines() if not line.startswith("#")]
HEADER = "time,u,y,z,event\n"


def _location(name: str, decay: float, measured: tuple[int, ...]) -> Location:
    rows = np.array([[0.0, 1.0], [1.0, 0.0]])[list(measured)]
    dynamics = LinearDynamics(
        A=np.array([[-decay, 0.0], [2.0, -2.0]]),
        B=np.array([[1.0], [0.0]]),
        C=rows,
        D=np.zeros((len(measured), 1)),
        E=np.eye(2),
        f=np.zeros(2),
        g=np.zeros(len(measured)),
    )
    return Location(name, dynamics, input_index=(0,), output_index=measured)


TANK = HybridSystem(
    "tank",
    (_location("fill", 1.0, (0, 1)), _location("drain", 2.0, (0,))),
    (HybridTransition("fill", "open", "drain", ("alarm",)), HybridTransition("drain", "close", "fill", ("quiet",))),
    ("fill", "drain"),
    state_names=("h", "v"),
    input_names=("u",),
    output_names=("y", "z"),
    observer=ObserverOptions(step=0.1),
)
AUTOMATON = HybridSystem("two", (Location("1"), Location("2")), (HybridTransition("1", "a", "2", ("α",)),), ("1",))


@pytest.mark.parametrize(("name", "code", "line"), TABLE, ids=[row[0] for row in TABLE])
def test_broken_trace_is_refused_with_its_code_and_line(name, code, line):
    with pytest.raises(TraceError) as caught:
        read_trace(FOLDER / f"{name}.csv", TANK)
    first = caught.value.diagnostics[0]
    assert (first.code, first.span.line) == (code, int(line))
    assert code in catalogue()
    text = render(first)
    assert f"{name}.csv:{line}:" in text
    assert "\x1b" not in text


def test_every_broken_trace_of_the_folder_is_in_the_table():
    assert sorted(path.stem for path in FOLDER.glob("*.csv")) == sorted(row[0] for row in TABLE)
    assert len(TABLE) >= 20


def test_all_mistakes_of_a_file_are_reported_together_in_order_of_place():
    with pytest.raises(TraceError) as caught:
        parse_trace(HEADER + "0.0,x,0,0,\n0.1,1,y,inf,\n0.2,1\n", TANK)
    places = [(d.code, d.span.line, d.span.column) for d in caught.value.diagnostics]
    assert places == [("DH0318", 2, 5), ("DH0318", 3, 7), ("DH0319", 3, 9), ("DH0317", 4, 6)]


def test_a_file_full_of_mistakes_gives_twenty_messages_and_says_so():
    with pytest.raises(TraceError) as caught:
        parse_trace(HEADER + "a,b,c,d,e\n" * 1000, TANK)
    assert len(caught.value.diagnostics) == 20
    assert caught.value.diagnostics[-1].notes == ("further mistakes are not shown",)


def test_column_of_a_mistake_counts_quoted_fields_and_blanks():
    with pytest.raises(TraceError) as caught:
        parse_trace('event,time,u,y,z\n"a,b", 0.0,  oops ,0,0\n', TANK)
    assert (caught.value.diagnostics[0].span.column, caught.value.diagnostics[0].span.length) == (14, 4)


def test_misspelt_column_comes_with_a_suggestion():
    with pytest.raises(TraceError) as caught:
        read_trace(FOLDER / "unknown_column.csv", TANK)
    assert "did you mean `event`?" in caught.value.diagnostics[0].helps


def test_missing_file_is_named():
    with pytest.raises(TraceError) as caught:
        read_trace(FOLDER / "nowhere.csv", TANK)
    assert caught.value.diagnostics[0].code == "DH0310"
    assert "nowhere.csv" in caught.value.diagnostics[0].message


def test_folder_and_impossible_path_are_refused():
    for path in (FOLDER, "a\0b"):
        with pytest.raises(TraceError) as caught:
            read_trace(path, TANK)
        assert caught.value.diagnostics[0].code == "DH0310"


def test_byte_order_mark_windows_line_ends_blank_lines_and_blanks_are_accepted():
    text = "\ufefftime, u ,y,z,event\r\n0.0, 1 ,0,0,\r\n\r\n0.1,1,0,, alarm\r\n"
    trace = parse_trace(text, TANK)
    assert trace.inputs.tolist() == [[1.0], [1.0]]
    assert trace.events == (None, "alarm")


def test_columns_may_come_in_any_order():
    trace = parse_trace("z,event,u,time,y\n4,quiet,2,0.0,3\n", TANK)
    assert (trace.time.tolist(), trace.inputs.tolist(), trace.outputs.tolist()) == ([0.0], [[2.0]], [[3.0, 4.0]])
    assert trace.events == ("quiet",)


def test_empty_field_of_an_output_means_not_measured():
    trace = parse_trace(HEADER + "0.0,1,0.5,,\n", TANK)
    assert np.isnan(trace.outputs[0, 1])


def test_event_that_the_model_does_not_know_is_left_to_the_observer():
    assert parse_trace(HEADER + "0.0,1,0,0,thunder\n", TANK).events == ("thunder",)


def test_jitter_and_a_drifting_clock_are_accepted():
    rng = np.random.default_rng(7)
    time = 5.0 + 0.1002 * np.arange(2000) + rng.uniform(-0.03, 0.03, 2000)
    text = HEADER + "".join(f"{t!r},0,0,0,\n" for t in time.tolist())
    assert len(parse_trace(text, TANK)) == 2000


def test_step_of_the_call_is_preferred_to_that_of_the_model():
    text = HEADER + "0,0,0,0,\n0.5,0,0,0,\n1.0,0,0,0,\n"
    assert len(parse_trace(text, TANK, step=0.5)) == 3
    with pytest.raises(TraceError):
        parse_trace(text, TANK)


def test_discrete_trace_needs_only_increasing_times():
    trace = parse_trace("time,event\n0,\n0.3,α\n17,\n", AUTOMATON)
    assert trace.events == (None, "α", None)
    assert trace.inputs.shape == (3, 0)


def test_partial_truth_is_kept_and_the_rest_is_unknown():
    trace = parse_trace("time,u,y,z,true_location,true_v\n0,0,0,0,fill,2\n0.1,0,0,0,,\n", TANK)
    assert trace.true_location == ("fill", None)
    np.testing.assert_array_equal(trace.true_state, [[np.nan, 2.0], [np.nan, np.nan]])


def test_written_trace_reads_back_to_the_same_bits():
    rng = np.random.default_rng(3)
    time = np.arange(50) * 0.1
    outputs = rng.normal(size=(50, 2)) * 10.0 ** rng.integers(-300, 300, (50, 2))
    outputs[::7, 1] = np.nan
    events = tuple(None if i % 5 else "alarm" for i in range(50))
    truth = ("fill",) * 50
    trace = Trace(TANK, time, rng.normal(size=(50, 1)), outputs, events, truth, rng.normal(size=(50, 2)))
    text = write_trace(trace)
    again = parse_trace(text, TANK)
    for name in ("time", "inputs", "outputs", "true_state"):
        assert getattr(trace, name).tobytes() == getattr(again, name).tobytes()
    assert (again.events, again.true_location) == (events, truth)
    assert write_trace(again) == text


def test_event_names_with_commas_and_quotes_survive_the_file():
    trace = Trace(AUTOMATON, [0.0, 1.0], np.zeros((2, 0)), np.zeros((2, 0)), ('a,"b"', None))
    assert parse_trace(write_trace(trace), AUTOMATON).events == ('a,"b"', None)


def test_arrays_of_a_trace_are_copies_and_read_only():
    time = np.array([0.0, 1.0])
    trace = Trace(AUTOMATON, time, np.zeros((2, 0)), np.zeros((2, 0)))
    time[0] = 5.0
    assert trace.time[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        trace.time[0] = 1.0


def test_trace_of_unequal_lengths_is_no_trace():
    with pytest.raises(ValueError, match="inputs"):
        Trace(TANK, [0.0], np.zeros((2, 1)), np.zeros((1, 2)))
    with pytest.raises(ValueError, match="events"):
        Trace(TANK, [0.0], np.zeros((1, 1)), np.zeros((1, 2)), ("alarm", None))


def test_line_at_the_limit_is_read_and_one_character_more_is_not():
    field = "0" * (MAX_LINE - len("0.0,1,0,,"))
    assert len(parse_trace(HEADER + f"0.0,1,0,{field},\n", TANK)) == 1
    with pytest.raises(TraceError) as caught:
        parse_trace(HEADER + f"0.0,1,0,0{field},\n", TANK)
    assert caught.value.diagnostics[0].code == "DH0311"
