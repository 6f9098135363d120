"""Verdicts about compositions that nobody could build, and searches that stop at the first proof."""

import random

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.composition import Composition
from deshybrid.des.detectability import strong_detectability
from deshybrid.des.faults import diagnosability, predictability
from deshybrid.diagnostics import LimitReached, UsageError
from tests import naive_toolkit as naive
from tests.strategies import random_des

Rows = list[tuple[str, str, str, str | None]]


def station(number: int, size: int = 6) -> DES:
    """A line of private steps, forth and back; from its end an event that all stations share leads to its start."""
    rows: Rows = [(str(k), f"step{number}", str(k + 1), f"o{number}") for k in range(size - 1)]
    rows += [(str(k + 1), f"back{number}", str(k), f"o{number}") for k in range(size - 1)]
    return DES.from_transitions([*rows, (str(size - 1), "all", "0", "bell")], initial=["0"])


def leaky(number: int) -> DES:
    """The same with a silent fault after which it goes on as before."""
    rows: Rows = [("0", "leak", "w0", None)]
    for k in range(5):
        rows += [(f"w{k}", f"step{number}", f"w{k + 1}", "o"), (f"w{k + 1}", f"back{number}", f"w{k}", "o")]
    good = [(t.source, t.event, t.target, "bell" if t.event == "all" else "o") for t in station(number)]
    return DES.from_transitions([*good, *rows, ("w5", "all", "w0", "bell")], initial=["0"])


def test_an_unseen_fault_in_a_plant_of_two_billion_states_is_found_with_its_two_runs() -> None:
    plant = Composition((leaky(0), *(station(number) for number in range(1, 12))))
    report = diagnosability(plant, faults=["leak"], max_pairs=50_000)
    assert report.witness is not None
    first, second = report.witness.runs
    assert "leak" in [step.event for step in first]
    assert "leak" not in [step.event for step in second]
    start, stop = report.witness.cycles[0]
    assert start < stop
    assert first[start].location == first[stop].location


def test_verdicts_about_a_composition_are_those_about_its_built_form() -> None:
    answers = set()
    for seed in range(500):
        rng = random.Random(seed)
        parts = tuple(random_des(rng, locations=3, transitions=5) for _ in range(2))
        plant = Composition(parts)
        built = plant.build()
        report = strong_detectability(plant)
        assert report.holds == strong_detectability(built).holds
        assert report.runs is None or naive.twin_faults(built, report.runs) == []
        faults = set(plant.events[:1]) & set(built.events)
        answer = diagnosability(plant, faults=faults)
        assert answer.holds == diagnosability(built, faults=faults).holds
        assert answer.witness is None or naive.twin_faults(built, answer.witness) == []
        answers.add((report.holds, answer.holds))
    assert len(answers) == 4


def test_a_proof_beyond_the_first_share_of_the_search_is_found_too() -> None:
    rows: Rows = [(str(k), "step", str(k + 1), "α") for k in range(3000)]
    rows += [("3000", "f", "x", "β"), ("3000", "g", "y", "β"), ("x", "a", "x", "α"), ("y", "a", "y", "α")]
    long = DES.from_transitions(rows, initial=["0"])
    for ask in (diagnosability, predictability):
        report = ask(long, faults=["f"])
        assert report.witness is not None
        assert len(report.witness.runs[0]) >= 3002
    assert not strong_detectability(long).holds
    assert strong_detectability(DES.from_transitions(rows[:-3], initial=["0"])).holds


def test_a_yes_needs_all_pairs_and_a_limit_ends_the_search() -> None:
    plant = Composition(tuple(station(number) for number in range(12)))
    with pytest.raises(LimitReached, match="DH0901: there are more than 20000 pairs of states"):
        diagnosability(plant, faults=["all"], max_pairs=20_000)


def test_too_many_initial_states_end_the_search_before_they_are_listed() -> None:
    wide = Composition((DES(tuple(str(k) for k in range(1000)), ()),) * 4)
    for ask in (
        lambda: wide.build(max_states=1000),
        lambda: wide.find(lambda state: False, max_states=1000),
        lambda: strong_detectability(wide, max_pairs=1000),
    ):
        with pytest.raises(LimitReached, match="DH0901"):
            ask()


def test_states_that_would_be_named_alike_are_refused_on_the_fly_too() -> None:
    one = DES.from_transitions([("a", "u", "a.b", "α")])
    two = DES.from_transitions([("b.c", "v", "c", "α")])
    with pytest.raises(UsageError, match="DH0421"):
        strong_detectability(Composition((one, two)))
