"""Verdicts on compositions from their parts, beside those on the built product, which nothing here assumes small."""

import random
from collections import Counter

import pytest

from benchmarks.families import line_of_stations
from deshybrid.des.automaton import DES
from deshybrid.des.composed import check_composition
from deshybrid.des.composition import Composition
from deshybrid.des.observability import check_observability
from deshybrid.des.replay import witness_faults
from deshybrid.diagnostics import LimitReached
from tests import naive_des as naive
from tests.strategies import random_composition


def test_the_verdict_from_parts_is_that_on_the_built_product_and_every_no_can_be_replayed_there() -> None:
    seen: Counter[object] = Counter()
    for seed in range(2_000):
        plant = random_composition(random.Random(seed))
        built = plant.build()
        report = check_composition(plant)
        expected = check_observability(built, method="pairs")
        assert report.current_location_observable == expected.current_location_observable, seed
        if report.witness is None:
            seen["yes", max(map(len, report.parts)) < len(plant.components), bool(expected.persistent)] += 1
        else:
            assert witness_faults(built, report.witness) == (), seed
            seen[report.witness.condition] += 1
    assert min(seen[kind] for kind in (("yes", True, True), ("yes", False, True), "C1", "C2")) > 20, seen


def test_the_verdict_from_parts_is_that_of_the_definition() -> None:
    answers: Counter[bool] = Counter()
    for seed in range(300):
        plant = random_composition(random.Random(seed))
        built = plant.build()
        if len(built.locations) <= 9:
            answer = check_composition(plant).current_location_observable
            assert answer == naive.observable_by_runs(built), seed
            answers[answer] += 1
    assert min(answers[True], answers[False]) > 20


def test_a_component_in_doubt_at_the_start_may_rest_there_while_another_moves() -> None:
    knows_late = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    moves = DES.from_transitions([("1", "c", "1", "γ")])
    assert check_observability(knows_late).current_location_observable
    assert check_composition(Composition((knows_late,))).current_location_observable
    report = check_composition(Composition((knows_late, moves)))
    assert report.witness is not None
    assert [step.event for step in report.witness.runs[0][1:]] == ["c"] * (len(report.witness.runs[0]) - 1)


def test_twelve_stations_with_two_billion_states_are_known_each_by_itself() -> None:
    report = check_composition(line_of_stations(12))
    assert report.current_location_observable
    assert report.parts == tuple((number,) for number in range(12))


def test_two_stations_that_show_the_same_are_confused_among_two_billion_states() -> None:
    plant = line_of_stations(12, alike=(4, 9))
    report = check_composition(plant)
    assert report.witness is not None
    assert report.witness.condition == "C2"
    arcs = {step.event for run in report.witness.runs for step in run[1:]}
    assert arcs <= set(plant.events)


def test_what_no_small_part_decides_ends_at_a_limit_that_says_what_is_known() -> None:
    with pytest.raises(LimitReached, match="DH0901") as stop:
        check_composition(line_of_stations(12, alike=(4, 9)), max_pairs=1_0)
    assert "components known in the end: " in stop.value.diagnostics[0].notes[-1]
    with pytest.raises(LimitReached, match="DH0903"):
        check_composition(line_of_stations(12), timeout=0.0)


def test_at_a_limit_the_components_that_are_known_so_far_are_named() -> None:
    still = DES.from_transitions([("1", "a", "1", "α")])
    wide = DES.from_transitions([("1", "b", "2", "β"), ("2", "c", "1", "γ")])
    for components, known in (((still, wide), "0; not decided: 1"), ((wide, still), "none; not decided: 0")):
        with pytest.raises(LimitReached, match="DH0901") as stop:
            check_composition(Composition(components), max_pairs=1)
        assert stop.value.diagnostics[0].notes[-1] == f"components known in the end: {known}"
