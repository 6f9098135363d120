"""The observer over a trace: what it is given, and what is written down."""

import csv
import io
from types import SimpleNamespace

import numpy as np
import pytest

from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, Location
from deshybrid.simulate.replay import replay, write_estimates
from deshybrid.simulate.trace import Trace, read_trace


def _location(name: str, measured: tuple[int, ...]) -> Location:
    p = len(measured)
    dynamics = LinearDynamics(*(np.zeros(s) for s in ((1, 1), (1, 1), (p, 1), (p, 1), (1, 1), (1,), (p,))))
    return Location(name, dynamics, input_index=(0,), output_index=measured)


SYSTEM = HybridSystem(
    "pair", (_location("a", (0, 1)), _location("b", (0,))), (), ("a",), ("x",), ("u",), ("y", "z"), ("w",)
)


class Recorder:
    """An observer that remembers what it was shown and estimates the sum of the inputs."""

    def __init__(self):
        self.shown = []

    def start(self):
        return 0.0

    def step(self, state, input, output, event, command=()):
        self.shown.append((input, output, event))
        state = state + input[0]
        known = event is not None
        return state, SimpleNamespace(
            location="b" if known else None,
            entry_estimate=("b",) if known else ("a", "b"),
            identified=known,
            signature="s_b" if known else None,
            status="identified" if known else "searching",
            state=(state,),
        )


def _trace(outputs) -> Trace:
    rows = len(outputs)
    events = (None, "α", None)[:rows]
    return Trace(SYSTEM, 0.1 * np.arange(rows), np.arange(1.0, rows + 1.0)[:, None], outputs, events, ("a", "b", "b"))


def test_observer_sees_inputs_outputs_and_events_row_by_row_and_never_the_truth():
    observer = Recorder()
    replay(observer, _trace([[1, 2], [3, 4], [5, 6]]))
    assert observer.shown == [((1.0,), (1.0, 2.0), None), ((2.0,), (3.0, 4.0), "α"), ((3.0,), (5.0, 6.0), None)]


def test_channel_that_some_location_does_not_measure_holds_its_last_value():
    observer = Recorder()
    replay(observer, _trace([[1, np.nan], [3, 4], [5, np.nan]]))
    assert [output for _, output, _ in observer.shown] == [(1.0, 0.0), (3.0, 4.0), (5.0, 4.0)]


def test_missing_value_of_a_channel_that_all_locations_measure_is_passed_on():
    observer = Recorder()
    replay(observer, _trace([[1, 2], [np.nan, 4], [5, 6]]))
    assert np.isnan(observer.shown[1][1][0])


def test_written_estimates_have_the_columns_of_the_contract():
    text = write_estimates(replay(Recorder(), _trace([[1, 2], [3, 4], [5, 6]])))
    rows = list(csv.DictReader(io.StringIO(text)))
    assert list(rows[0]) == ["time", "location", "entry_estimate", "identified", "signature", "status", "x_hat"]
    assert list(rows[0].values()) == ["0.0", "", "a|b", "0", "", "searching", "1.0"]
    assert list(rows[1].values()) == ["0.1", "b", "b", "1", "s_b", "identified", "3.0"]


def test_estimates_keep_their_trace_and_are_read_only():
    trace = _trace([[1, 2], [3, 4], [5, 6]])
    estimates = replay(Recorder(), trace)
    assert estimates.trace is trace
    assert estimates.state.tolist() == [[1.0], [3.0], [6.0]]
    with pytest.raises(ValueError, match="read-only"):
        estimates.state[0, 0] = 0.0


def test_trace_is_read_from_standard_input(monkeypatch):
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=io.BytesIO(b"time,u,y,z\n0,1,2,3\n")))
    assert read_trace("-", SYSTEM).outputs.tolist() == [[2.0, 3.0]]
