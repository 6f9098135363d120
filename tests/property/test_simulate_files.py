"""Traces and scores on whatever Hypothesis finds."""

from itertools import pairwise

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.diagnostics import TraceError, catalogue, render_all
from deshybrid.model.system import HybridSystem, Location, ObserverOptions
from deshybrid.simulate.score import score_locations
from deshybrid.simulate.table import decode
from deshybrid.simulate.trace import Trace, parse_trace, write_trace

RUNS = settings(max_examples=300, deadline=None, derandomize=True)
PLAIN = HybridSystem("two", (Location("a"), Location("b")), (), ("a",))
CHANNELS = HybridSystem(
    "channels", (Location("a"),), (), ("a",), ("x",), ("u",), ("y",), observer=ObserverOptions(step=0.1)
)
GOOD = b"time,u,y,event,true_location,true_x\n0.0,1,2,,a,0\n0.1,1,,on,a,0.5\n0.2,-1e3,2,,,\n"


def _read(data: bytes, system: HybridSystem) -> Trace | None:
    """The trace, or None where it is refused, in which case every message has a code, a place, and can be shown."""
    try:
        return parse_trace(decode("t.csv", data), system)
    except TraceError as error:
        messages = error.diagnostics
    assert all(message.code in catalogue() and message.span is not None for message in messages)
    assert "\x1b" not in render_all(messages)
    return None


@RUNS
@given(st.binary(max_size=200))
def test_any_bytes_are_a_trace_or_a_coded_message_with_a_place(data):
    _read(data, CHANNELS)
    _read(data, PLAIN)


@RUNS
@given(st.integers(0, len(GOOD)), st.integers(0, 6), st.sampled_from([b"", b",", b'"', b"\n", b"-", b"9", b"\xc3\xa9"]))
def test_damaged_trace_is_a_trace_or_a_coded_message_with_a_place(place, cut, inserted):
    trace = _read(GOOD[:place] + inserted + GOOD[place + cut :], CHANNELS)
    if trace is not None:
        assert np.isfinite(trace.inputs).all()
        assert (np.diff(trace.time) > 0).all()


@RUNS
@given(
    st.lists(st.floats(0.0, 1e300), min_size=1, max_size=9, unique=True),
    st.lists(st.text(st.characters(exclude_categories=("C", "Z")), max_size=4), min_size=9, max_size=9),
)
def test_any_event_names_and_times_survive_writing_and_reading(times, names):
    times = sorted(times)
    events = tuple(name or None for name in names[: len(times)])
    empty = np.zeros((len(times), 0))
    again = parse_trace(write_trace(Trace(PLAIN, np.array(times), empty, empty, events)), PLAIN)
    assert (again.time.tolist(), again.events) == (times, events)


NAMES = st.sampled_from(["a", "b", "c", None])


@RUNS
@given(st.lists(st.tuples(NAMES, NAMES), min_size=1, max_size=40), st.sampled_from([0.0, 2.0, 3.0]))
def test_delays_are_those_of_the_definition(rows, minimum_stay):
    """Seconds are samples here, so that every comparison is exact."""
    truth, said = [true for true, _ in rows], [estimate for _, estimate in rows]
    result = score_locations(range(len(rows)), truth, said, minimum_stay=minimum_stay, lead=4.0, limit=2.0)
    changes = [
        i
        for i, (before, after) in enumerate(pairwise(truth), start=1)
        if before != after and None not in (before, after)
    ]
    expected = []
    for enter in changes:
        name = truth[enter]
        leave = next((i for i in range(enter, len(rows)) if truth[i] != name), len(rows))
        if min(leave, len(rows) - 1) - enter < minimum_stay:
            continue
        back = [i for i in range(max(0, enter - 4), enter + 1) if all(s == name for s in said[i : enter + 1])]
        back = [i for i in back if name not in truth[i:enter]]
        after = [i for i in range(enter, leave) if said[i] == name]
        named = back[0] if back else after[0] if after else None
        expected.append((name, enter, None if named is None else named - enter))
    assert [(e.location, e.enter, e.delay) for e in result.engagements] == expected
    assert result.total.late == sum(delay is not None and delay > 2 for _, _, delay in expected)
    assert result.total.missed == sum(delay is None for _, _, delay in expected)
    assert result.total.right == sum(t is not None and t == s for t, s in rows)
    assert result.total.wrong == sum(None not in (t, s) and t != s for t, s in rows)
