"""Known commands against their definition: verdicts, plans, tracker, the observer at work, and which values count."""

import random
from dataclasses import replace
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid import compiler
from deshybrid.des.observability import check_observability
from deshybrid.des.replay import witness_faults
from deshybrid.model.abstraction import abstract, discrete_model
from deshybrid.model.system import Command, HybridSystem
from deshybrid.observer import reference
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import replay
from tests import naive_commands as naive
from tests.property.test_des_recovery import assert_plan_is_best, observable_by_definition
from tests.property.test_observer_online import Both
from tests.strategies import candidates_everywhere, commanded, living, random_candidates, random_des, random_detectors

COMMANDS = (Command("lever", ("1", "2", "N")), Command("clutch", ("in", "out")))


def random_system(rng: random.Random) -> HybridSystem:
    """A plant with two commands, on which about half of the transitions depend."""
    system = discrete_model(living(random_des(rng, locations=4, transitions=7)))
    arcs = tuple(
        replace(t, when={c.name: tuple(rng.sample(c.values, 1)) for c in COMMANDS if rng.random() < 0.4})
        for t in system.transitions
    )
    return replace(system, transitions=arcs, commands=COMMANDS)


@pytest.mark.parametrize("first", range(0, 1000, 200))
def test_verdict_with_known_commands_is_that_of_the_definition(first: int) -> None:
    verdicts = []
    for seed in range(first, first + 200):
        system = random_system(random.Random(seed))
        expected = naive.observable(system)
        verdicts.append(expected)
        for method in ("observer", "pairs"):
            report = check_observability(abstract(system), method=method)
            assert report.current_location_observable == expected
            assert report.witness is None or witness_faults(report.des, report.witness) == ()
        without = check_observability(abstract(replace(system, commands=(), transitions=_unconditional(system))))
        assert expected or not without.current_location_observable
    assert 20 < sum(verdicts) < 180


def _unconditional(system: HybridSystem) -> tuple:  # type: ignore[type-arg]
    return tuple(replace(t, when={}) for t in system.transitions)


@pytest.mark.parametrize("first", range(0, 120, 30))
def test_plan_with_known_commands_is_the_cheapest_of_all(first: int) -> None:
    for seed in range(first, first + 30):
        rng = random.Random(seed)
        des = commanded(rng, random_des(rng, locations=3, transitions=5))
        candidates = random_candidates(rng, des) if rng.random() < 0.5 else candidates_everywhere(des)
        detectors = random_detectors(rng, des) if rng.random() < 0.5 else ()
        assert_plan_is_best(des, candidates + detectors, observable_by_definition)


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**9), st.booleans())
def test_tracker_follows_only_what_the_commands_permit(seed: int, as_events: bool) -> None:
    rng = random.Random(seed)
    both = Both(rng, as_events=as_events, commands=True)
    for _ in range(15):
        both.allow(rng)
        both.compare()
        if both.events and rng.random() < 0.6:
            both.event(rng.randrange(len(both.events)))
        else:
            both.other(rng)


@pytest.mark.parametrize("first", range(0, 200, 100))
def test_observer_of_a_discrete_model_says_what_outputs_and_commands_leave_possible(first: int) -> None:
    seen = 0
    for seed in range(first, first + 100):
        system = random_system(random.Random(seed))
        if not naive.observable(system):
            continue
        observer = compiler.compile(system).observer
        assert observer is not None
        trace = simulate(system, seed=seed, duration=30).trace
        possible = set(system.initial)
        for row, estimate in enumerate(replay(observer, trace).entry_estimate):
            values = dict(zip(system.command_names, trace.commands[row], strict=True))
            output = trace.events[row]
            possible = naive.entered(system, possible, output, values) if output is not None else possible
            assert set(estimate) == possible
            assert trace.true_location is not None
            assert output is None or trace.true_location[row] in possible
            seen += 1
    assert seen > 100


class Remembered(NamedTuple):
    """What the observer remembers of commands."""

    command_age: tuple[int, ...]


@settings(max_examples=100, deadline=None)
@given(st.lists(st.tuples(st.integers(0, 4), st.booleans()), max_size=30), st.integers(1, 5), st.integers(0, 1))
def test_a_value_counts_where_it_was_on_lately_and_since_the_last_transition(
    rows: list[tuple[int, bool]], window: int, slack: int
) -> None:
    """The command has three values; codes 0 and 4 tell nothing, so that all three may be on."""
    tables = {"commands": (3,), "window_ticks": window, "command_slack": slack}
    state = Remembered((window + 1,) * 3)
    on: list[set[int]] = []
    since = 0
    for row, (code, moves) in enumerate(rows):
        on.append({code - 1} if 1 <= code <= 3 else {0, 1, 2})
        state = state._replace(command_age=reference.heed(tables, state.command_age, (code,)))
        for ticks in (slack, window):
            expected = set().union(*on[max(since, row - ticks, 0) :])
            assert reference.allowed(state.command_age, ticks) == sum(1 << value for value in expected)
        if moves:
            state, since = reference.settle(tables, state), max(since, row - slack)
