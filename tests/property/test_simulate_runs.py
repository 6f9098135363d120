"""What holds for every execution of every system."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.model.abstraction import abstract
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.flow import build_flow
from deshybrid.simulate.guards import atoms_of, build_watch, first_time
from deshybrid.simulate.trace import parse_trace, write_trace
from tests.strategies import hybrid_systems

RUNS = settings(max_examples=40, deadline=None, derandomize=True)
SLACK = 1e-6


@RUNS
@given(hybrid_systems(), st.integers(0, 99))
def test_every_execution_is_a_run_of_the_abstraction_that_respects_the_shortest_stays(system, seed):
    run = simulate(system, seed=seed, duration=3.0, substeps=2)
    arcs = abstract(system).transitions
    place, entered = run.trace.true_location[0], 0.0
    if run.switches and run.switches[0].time == 0.0:
        place = run.switches[0].source  # the row at 0 shows what is true after a transition at 0
    assert place in system.initial
    for switch in run.switches:
        assert switch.source == place
        assert any(
            (t.source, t.event, t.target) == (switch.source, switch.event, switch.target) and switch.output in t.outputs
            for t in arcs
        )
        assert switch.time >= entered + (system.location(place).dwell.min or 0.0) - SLACK
        place, entered = switch.target, switch.time


@RUNS
@given(hybrid_systems(), st.integers(0, 99))
def test_trace_shows_the_switches_in_the_first_row_at_or_after_them(system, seed):
    run = simulate(system, seed=seed, duration=3.0, substeps=2)
    for index, (time, event, place) in enumerate(
        zip(run.trace.time, run.trace.events, run.trace.true_location, strict=True)
    ):
        before = [s for s in run.switches if s.time <= time + SLACK]
        recent = [s.output for s in before if index == 0 or s.time > run.trace.time[index - 1] + SLACK]
        assert [output for output in recent if output] == ([event] if event else [])
        if before:
            assert place == before[-1].target


@RUNS
@given(hybrid_systems(), st.integers(0, 99))
def test_every_execution_can_be_written_and_read_back(system, seed):
    trace = simulate(system, seed=seed, duration=1.0, substeps=1).trace
    again = parse_trace(write_trace(trace), system)
    assert again.outputs.tobytes() == trace.outputs.tobytes()
    assert again.true_state.tobytes() == trace.true_state.tobytes()
    assert (again.events, again.true_location) == (trace.events, trace.true_location)


@RUNS
@given(hybrid_systems(), st.integers(0, 2**32 - 1))
def test_first_time_of_a_guard_is_that_of_a_fine_search_along_the_flow(system, seed):
    """The oracle samples the predicate's margin along the flow at 1,000 points."""
    guards = [t.guard for t in system.transitions if t.guard is not None]
    rng = np.random.default_rng(seed)
    location, tick, count = system.locations[0], 0.1, 1000
    flow = build_flow(system, location, tick)
    fine = build_flow(system, location, tick / count)
    n = len(system.state_names)
    z = np.concatenate([rng.uniform(-1, 1, n), rng.uniform(-1, 1, 1), rng.uniform(-0.3, 0.3, n), [1.0]])
    pieces = build_watch(guards, flow, tick).pieces(z, tick)
    margins = np.empty((count + 1, len(guards)))
    point = z.copy()
    for index in range(count + 1):
        margins[index] = [guard.margin(point[:n], point[n : n + 1]) for guard in guards]
        point[:n] = fine.whole @ point
    for column, guard in enumerate(guards):
        if any(not atom.state.any() for atom in atoms_of(guard)):
            continue  # a constant on its edge: both answers are right
        found = first_time(pieces, guard, True)
        certain = np.flatnonzero(margins[:, column] > 1e-9)
        possible = np.flatnonzero(margins[:, column] >= -1e-3)
        if certain.size:
            assert found is not None
            assert found <= certain[0] * tick / count + SLACK
        if found is not None:
            assert possible.size
            assert found >= (possible[0] - 1) * tick / count - SLACK
