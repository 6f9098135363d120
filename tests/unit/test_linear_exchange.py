"""Dynamics and results, given to other libraries and taken back."""

import control
import numpy as np
import pytest

import deshybrid as dh
from deshybrid.diagnostics import UsageError
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import replay, write_estimates
from deshybrid.simulate.trace import write_trace

TANK = "models/two_tank.yaml"


def test_a_location_becomes_a_state_space_and_comes_back() -> None:
    fill = dh.load(TANK).location("fill").dynamics
    assert fill is not None
    there = fill.to_control()
    assert isinstance(there, control.StateSpace)
    assert there.isctime()
    np.testing.assert_array_equal(there.poles(), np.linalg.eigvals(fill.A))
    back = LinearDynamics.from_control(there)
    for name in ("A", "B", "C", "D"):
        np.testing.assert_array_equal(getattr(back, name), getattr(fill, name))
    assert not back.A.flags.writeable
    np.testing.assert_array_equal(back.E, np.eye(2))


def test_a_sampled_location_keeps_its_step() -> None:
    fill = dh.load(TANK).location("fill").dynamics
    assert fill is not None
    assert fill.to_control(time_step=0.1).dt == 0.1


def test_a_constant_part_is_refused_since_a_state_space_has_none() -> None:
    drain = dh.load(TANK).location("drain").dynamics
    assert drain is not None
    with pytest.raises(UsageError, match="DH0423"):
        drain.to_control()


def test_tables_of_traces_and_estimates_have_the_columns_of_their_files() -> None:
    made = dh.compile(TANK)
    assert made.observer is not None
    trace = simulate(made.observer.system, seed=1, duration=2.0, step=made.observer.step_seconds).trace
    estimates = replay(made.observer, trace)
    for table, text in ((trace.to_table(), write_trace(trace)), (estimates.to_table(), write_estimates(estimates))):
        assert ",".join(table) == text.splitlines()[0]
        assert {len(column) for column in table.values()} == {len(trace)}
    np.testing.assert_array_equal(trace.to_table()["y"], trace.outputs[:, 0])
