"""The short cuts for large systems against the plain way: what they skip must make no difference."""

import random
import time
from collections import Counter
from typing import Any

import pytest

from benchmarks.families import from_the_end, line, observable_from_the_end, observable_sparse, ring, sparse
from deshybrid.des import moves, pairs, subsets, witness
from deshybrid.des.automaton import DES, Output
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.observability import UndecidedCheck, check_observability
from deshybrid.des.pairs import PairSearch, PersistentPairs, persistent_pairs
from deshybrid.des.replay import witness_faults
from deshybrid.des.worklist import explore
from deshybrid.diagnostics import LimitReached
from deshybrid.diagnostics.limits import resident_memory
from tests import naive_des as naive
from tests.strategies import random_des

SYSTEMS = [*(random_des(random.Random(seed)) for seed in range(300))]
SYSTEMS += [sparse(40, outputs=8, silent=0.2, seed=seed) for seed in range(20)]
SYSTEMS += [observable_sparse(40, outputs=8, silent=0.2, seed=seed) for seed in range(20)]


def result(found: PersistentPairs) -> tuple[list[tuple[int, int]], int | None]:
    """The bound has a meaning only where no two locations are confused for ever."""
    return list(found), found.longest_confusion if found.first_confused() is None else None


def test_starting_from_pairs_with_a_common_history_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = [result(persistent_pairs(eliminate_epsilon(des))) for des in SYSTEMS]
    monkeypatch.setattr(pairs, "_FEW", 0)
    depths = []
    for des, expected in zip(SYSTEMS, plain, strict=True):
        automaton = eliminate_epsilon(des)
        assert result(persistent_pairs(automaton)) == expected
        depths.append(pairs.PairSearch(automaton)._words(pairs._MOST_MEMBERS).depth)
    assert sum(depth > 1 for depth in depths) > 20
    assert sum(bound is not None and depth > 1 for depth, (_, bound) in zip(depths, plain, strict=True)) > 10


def test_the_bound_by_pairs_is_that_of_the_definition_after_a_common_history(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pairs, "_FEW", 0)
    late = 0
    for seed in range(1000):
        des = random_des(random.Random(seed))
        report = check_observability(des, method="pairs")
        if report.current_location_observable:
            assert report.transient_bound == naive.transient_bound(des)
            late += report.transient_bound is not None and report.transient_bound > 2
    assert late > 5


def test_moving_in_small_batches_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    plain = [result(persistent_pairs(eliminate_epsilon(des))) for des in SYSTEMS[:300]]
    monkeypatch.setattr(moves, "_BATCH", 3)
    assert [result(persistent_pairs(eliminate_epsilon(des))) for des in SYSTEMS[:300]] == plain


@pytest.mark.parametrize("method", ["observer", "pairs"])
def test_a_witness_from_a_part_of_the_pairs_is_valid(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(witness, "_ENOUGH", 1)
    shown = 0
    for des in SYSTEMS:
        report = check_observability(des, method=method)
        if report.witness is not None:
            assert witness_faults(des, report.witness) == ()
            shown += report.witness.condition == "C2"
    assert shown > 50


def test_bit_masks_and_tuples_give_the_same_observer() -> None:
    for des in SYSTEMS:
        assert observer_arcs(subsets._Masks, des) == observer_arcs(subsets._Tuples, des)


def observer_arcs(kind: type[subsets.SubsetMoves], des: DES) -> list[tuple[list[int], Output, list[int]]]:
    steps = kind(des, eliminate_epsilon(des).outputs)
    graph = explore([steps.subset(range(len(des.locations)))], steps.successors)
    sets = [list(steps.members(node)) for node in graph.nodes]
    return [(sets[source], output, sets[target]) for source, output, target in graph.arcs]


def test_a_pair_that_is_not_persistent_is_not_held() -> None:
    found = persistent_pairs(eliminate_epsilon(ring(5, outputs=5)))
    assert list(found) == [(q, q) for q in range(5)]
    assert found.holds(4, 4)
    assert not found.holds(3, 4)


def test_too_many_pairs_are_a_limit_that_says_how_many_there_are() -> None:
    with pytest.raises(LimitReached, match="DH0901: there are more than 10 pairs of locations") as stop:
        persistent_pairs(eliminate_epsilon(ring(200)), limit=10)
    assert stop.value.diagnostics[0].notes == ("20100 pairs of locations would have to be looked at",)
    with pytest.raises(LimitReached, match="DH0901: there are more than 10 pairs of locations"):
        persistent_pairs(eliminate_epsilon(from_the_end(20)), limit=10)


@pytest.mark.parametrize("most", [1, 3, 10, 1000])
def test_a_part_of_the_pairs_holds_no_pair_that_is_not_persistent(most: int) -> None:
    found = confused = 0
    for des in SYSTEMS:
        search = PairSearch(eliminate_epsilon(des))
        part, whole = search.some(most), search.all()
        assert set(part) <= set(whole)
        found += len(part.codes)
        confused += part.first_confused() is not None
    assert confused > 20
    assert found > confused


def test_enough_of_the_pairs_hold_a_confusion_wherever_there_is_one() -> None:
    for des in SYSTEMS:
        search = PairSearch(eliminate_epsilon(des))
        assert (search.some().first_confused() is None) == (search.all().first_confused() is None)


@pytest.mark.parametrize("limit", [{"timeout": 0.0}, {"max_memory": 1}, {"method": "observer", "max_states": 1}])
def test_what_is_said_after_a_limit_is_never_wrong(limit: dict[str, Any]) -> None:
    answers: Counter[bool | None] = Counter()
    for des in SYSTEMS:
        truth = check_observability(des)
        try:
            report = check_observability(des, **limit)
        except UndecidedCheck as stop:
            report = stop.report
            assert report.current_location_observable is None
            assert (report.witness, report.transient_bound, report.c2_failures) == (None, None, ())
        assert report.current_location_observable in (None, truth.current_location_observable)
        assert (report.c1_failures, report.persistent, report.blocked) == (
            truth.c1_failures,
            truth.persistent,
            truth.blocked,
        )
        assert {f.location for f in report.c2_failures} <= {f.location for f in truth.c2_failures}
        assert report.witness is None or witness_faults(des, report.witness) == ()
        answers[report.current_location_observable] += report.undecided is not None
    assert answers[None] > 20
    assert answers[False] > 20
    assert answers[True] == 0


def test_a_limit_that_comes_after_c1_has_failed_leaves_the_answer_no_with_its_run() -> None:
    report = check_observability(sparse(400, outputs=8, silent=0.2), timeout=0.0)
    assert report.current_location_observable is False
    assert report.undecided is not None
    assert report.undecided.reason == "the time limit was reached"
    assert report.witness is not None
    assert witness_faults(report.des, report.witness) == ()
    assert "C1 fails" in str(report)


def test_pairs_that_would_not_fit_are_not_begun() -> None:
    held = resident_memory()
    assert held is not None
    with pytest.raises(UndecidedCheck, match="DH0904: the memory limit was reached") as stop:
        check_observability(line(4_000), method="pairs", max_memory=held + 2**26)
    assert "8002000 pairs" not in str(stop.value.report.undecided)
    assert (resident_memory() or 0) < held + 2**27


def test_an_observer_of_two_to_the_200_states_is_not_needed() -> None:
    confused = check_observability(from_the_end(200))
    assert confused.method == "pairs"
    assert confused.method_reason == "the location observer has more than 2000 states"
    assert len(confused.c2_failures) == 201
    clear = check_observability(observable_from_the_end(60))
    assert clear.method == "pairs"
    assert clear.current_location_observable
    assert clear.transient_bound == 61


def test_the_automatic_choice_builds_fewer_states_the_more_locations_there_are() -> None:
    for locations, states, most in ((1, 2_000, 100_000), (3_000, 2_000, 100_000), (6_000, 1_001, 100_000), (1, 5, 5)):
        alone = DES(tuple(str(number) for number in range(locations)), ())
        report = check_observability(alone, max_states=most)
        assert report.method_reason == f"the automatic choice up to {states}"


def test_a_no_about_thousands_of_locations_that_look_alike_comes_at_once() -> None:
    """The pair automaton would have four and a half million pairs."""
    before = time.process_time()
    report = check_observability(ring(3_000))
    assert time.process_time() - before < 5
    assert report.method_reason == "the automatic choice up to 2000"
    assert len(report.c2_failures) == 3_000
    assert report.witness is not None
    assert witness_faults(report.des, report.witness) == ()


def test_observers_need_no_silent_path_of_their_own_for_every_location() -> None:
    """Closing every location first would make millions of edges here, in minutes."""
    before = time.process_time()
    des = sparse(2_000, branching=3, silent=0.8)
    automaton = eliminate_epsilon(des)
    assert "edges" not in vars(automaton)
    report = check_observability(des, method="observer")
    assert report.observer is not None
    assert "edges" not in vars(report.automaton)
    assert time.process_time() - before < 20
