"""The fast constructions against the definitions, on thousands of random systems and on whatever Hypothesis finds."""

import random
from itertools import pairwise

import pytest
from hypothesis import given, settings

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.observability import check_observability
from deshybrid.des.observer import build_location_observer, entry_estimate_after, entry_estimates
from deshybrid.des.persistence import blocked_locations, persistent_locations
from deshybrid.des.replay import witness_faults
from tests import naive_des as naive
from tests.strategies import random_des, systems, systems_with_run

SEEDS = range(2500)
BATCH = 500


def assert_agrees_with_the_definitions(des: DES) -> None:
    reports = [check_observability(des, method=method) for method in ("observer", "pairs")]
    expected = naive.c2_failures(des)
    for report in reports:
        assert set(report.persistent) == naive.persistent(des)
        assert list(report.c1_failures) == naive.c1_failures(des)
        assert [failure.location for failure in report.c2_failures] == [q for q in des.locations if q in expected]
        assert report.current_location_observable == naive.observable_by_runs(des)
        if report.current_location_observable:
            assert report.witness is None
            assert report.transient_bound == naive.transient_bound(des)
        else:
            assert report.transient_bound is None
            assert report.witness is not None
            assert witness_faults(des, report.witness) == ()
    by_observer, by_pairs = reports
    for failure in by_observer.c2_failures:
        assert {frozenset(state) for state in failure.observer_states} == expected[failure.location]
    for failure in by_pairs.c2_failures:
        together = {name for state in expected[failure.location] for name in state} - {failure.location}
        assert {name for state in failure.observer_states for name in state} - {failure.location} == together


def assert_observer_is_the_subset_construction(des: DES) -> None:
    observer = build_location_observer(eliminate_epsilon(des))
    sets = [frozenset(state) for state in observer.states]
    arcs = {(sets[source], output, sets[target]) for source, output, target in observer.transitions}
    assert arcs == naive.observer_arcs(des)
    assert len(arcs) == len(observer.transitions)
    lasting = naive.reachable_from_cycles([sets[0]], [(source, target) for source, _, target in arcs])
    assert {sets[number] for number in observer.persistent} == lasting


@pytest.mark.parametrize("first", SEEDS[::BATCH])
def test_both_methods_agree_with_the_definitions_on_random_systems(first: int) -> None:
    for seed in range(first, first + BATCH):
        des = random_des(random.Random(seed))
        assert_agrees_with_the_definitions(des)
        assert_observer_is_the_subset_construction(des)


def test_the_random_systems_show_every_kind_of_verdict() -> None:
    """Without this, the comparison above could be one of trivial cases only."""
    kinds = {"yes": 0, "C1 only": 0, "C2 only": 0, "both": 0, "never entered visibly": 0, "not alive": 0, "late": 0}
    for seed in SEEDS[:2000]:
        report = check_observability(random_des(random.Random(seed)))
        c1, c2 = bool(report.c1_failures), bool(report.c2_failures)
        kinds["both" if c1 and c2 else "C1 only" if c1 else "C2 only" if c2 else "yes"] += 1
        kinds["never entered visibly"] += any(not failure.observer_states for failure in report.c2_failures)
        kinds["not alive"] += not report.alive
        kinds["late"] += bool(report.persistent) and (report.transient_bound or 0) > 2
    assert min(kinds.values()) >= 10, kinds


@given(systems())
@settings(max_examples=200, deadline=None)
def test_both_methods_agree_with_the_definitions_on_systems_that_hypothesis_finds(des: DES) -> None:
    assert_agrees_with_the_definitions(des)
    assert_observer_is_the_subset_construction(des)


@given(systems_with_run())
@settings(max_examples=200, deadline=None)
def test_entry_estimate_contains_the_location_entered_at_every_output(
    case: tuple[DES, str, list[tuple[Transition, str | None]]],
) -> None:
    des, _, run = case
    shown = [(Output(gamma), transition.target) for transition, gamma in run if gamma is not None]
    estimates = entry_estimates(eliminate_epsilon(des), [output for output, _ in shown])
    assert all(target in estimate for (_, target), estimate in zip(shown, estimates[1:], strict=True))
    for (output, _), before, after in zip(shown, estimates, estimates[1:], strict=False):
        assert entry_estimate_after(eliminate_epsilon(des), before, output) == after


@given(systems())
@settings(max_examples=150, deadline=None)
def test_every_edge_folds_a_shortest_silent_path_and_one_visible_transition(des: DES) -> None:
    edges = eliminate_epsilon(des).edges
    for edge in edges:
        taken = [des.transitions[number] for number in edge.path]
        assert taken[0].source == edge.source
        assert taken[-1].target == edge.target
        assert edge.output in taken[-1].seen
        assert all(before.target == after.source for before, after in pairwise(taken))
        assert all(None in transition.seen for transition in taken[:-1])
        assert len(edge.path) == shortest_way(des, edge.source, edge.output, edge.target)
    expected = {(p, o, q) for p in des.locations for o in naive.all_outputs(des) for q in naive.entered(des, [p], o)}
    assert {(edge.source, edge.output, edge.target) for edge in edges} == expected
    assert len(edges) == len(expected)


def shortest_way(des: DES, source: str, output: Output, target: str) -> int:
    reached, length = {source}, 1
    while not any(t.source in reached and output in t.seen and t.target == target for t in des.transitions):
        reached |= {t.target for t in des.transitions if t.source in reached and None in t.seen}
        length += 1
    return length


@given(systems())
@settings(max_examples=100, deadline=None)
def test_blocked_locations_are_the_reachable_ones_without_exit(des: DES) -> None:
    reached = naive.reachable(des.initial, [(t.source, t.target) for t in des.transitions])
    exits = {t.source for t in des.transitions}
    assert set(blocked_locations(des)) == reached - exits
    assert not set(blocked_locations(des)) & exits


@given(systems())
@settings(max_examples=100, deadline=None)
def test_renaming_and_reordering_change_no_verdict(des: DES) -> None:
    renamed = DES(
        tuple(f"r{name}" for name in reversed(des.locations)),
        tuple(
            Transition(f"r{t.source}", t.event, f"r{t.target}", tuple(reversed(t.outputs)))
            for t in reversed(des.transitions)
        ),
        tuple(f"r{name}" for name in reversed(des.initial)),
    )
    before, after = check_observability(des), check_observability(renamed)
    assert before.current_location_observable == after.current_location_observable
    assert before.transient_bound == after.transient_bound
    assert {f"r{name}" for name in persistent_locations(des)} == set(persistent_locations(renamed))
