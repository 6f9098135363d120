"""Opacity, diagnosability and predictability against their definitions; every "no" comes with what proves it."""

import random
from collections import Counter
from itertools import pairwise

import pytest

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.estimates import current_estimates, initial_estimates
from deshybrid.des.faults import diagnosability, predictability
from deshybrid.des.opacity import current_state_opacity, initial_state_opacity
from deshybrid.des.twins import TwinWitness
from deshybrid.des.witness import Step
from tests import naive_toolkit as naive
from tests.strategies import random_des

BATCH = 500
batches = pytest.mark.parametrize("first", range(0, 2000, BATCH))  # 2,000 systems a property


def with_faults(seed: int) -> tuple[DES, set[str]]:
    """A random system in which some transitions are faults, often silent ones."""
    rng = random.Random(seed)
    des = random_des(rng, locations=5)
    arcs = tuple(
        Transition(t.source, "f", t.target, rng.choice([(None,), t.outputs])) if rng.random() < 0.2 else t
        for t in des.transitions
    )
    return DES(des.locations, arcs, des.initial), {t.event for t in arcs} & {"f"}


def has_fault(run: tuple[Step, ...]) -> bool:
    return any(step.event == "f" for step in run)


def assert_fault_stays_unseen(des: DES, witness: TwinWitness) -> None:
    (first, second), (around, _) = witness.runs, witness.cycles
    assert naive.twin_faults(des, witness) == []
    assert has_fault(first[: around[0] + 1])
    assert around[0] < around[1]
    assert not has_fault(second)


def assert_fault_comes_unforeseen(des: DES, witness: TwinWitness) -> None:
    (first, second), (end, (start, stop)) = witness.runs, witness.cycles
    assert end == (len(first) - 1, len(first) - 1)
    assert witness.repeated == (len(witness.outputs), len(witness.outputs))
    assert first[-1].event == "f"
    assert not has_fault(first[:-1])
    assert not has_fault(second)
    assert start < stop == len(second) - 1
    assert second[start].location == second[stop].location
    word = list(witness.outputs)
    assert naive.shows(des, first[:-1], word)
    assert any(naive.shows(des, second[:end], word) for end in range(1, start + 2))
    arcs = {(t.source, t.event, t.target) for t in des.transitions}
    for run in witness.runs:
        assert run[0].location in des.initial
        assert all((a.location, b.event, b.location) in arcs for a, b in pairwise(run))


@batches
def test_diagnosability_agrees_with_the_definition_and_two_runs_prove_a_no(first: int) -> None:
    kinds: Counter[tuple[bool, bool]] = Counter()
    for seed in range(first, first + BATCH):
        des, faults = with_faults(seed)
        report = diagnosability(des, faults=faults)
        assert report.holds == naive.diagnosable(des, faults), seed
        assert report.holds == (report.witness is None)
        if report.witness is not None:
            assert_fault_stays_unseen(des, report.witness)
        kinds[report.holds, bool(faults)] += 1
    assert min(kinds[True, True], kinds[False, True]) >= 30, kinds


@batches
def test_predictability_agrees_with_the_definition_and_two_runs_prove_a_no(first: int) -> None:
    kinds: Counter[tuple[bool, bool]] = Counter()
    for seed in range(first, first + BATCH):
        des, faults = with_faults(seed)
        report = predictability(des, faults=faults)
        assert report.holds == naive.predictable(des, faults), seed
        assert report.holds == (report.witness is None)
        if report.witness is not None:
            assert_fault_comes_unforeseen(des, report.witness)
        kinds[report.holds, bool(faults)] += 1
    assert min(kinds[True, True], kinds[False, True]) >= 30, kinds


@batches
def test_opacity_agrees_with_the_definition_and_a_shortest_word_betrays_the_secret(first: int) -> None:
    kinds: Counter[tuple[bool, bool, bool]] = Counter()
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        des = random_des(rng, locations=5)
        secret = rng.sample(des.locations, rng.randint(0, len(des.locations)))
        for at_start, ask in ((False, current_state_opacity), (True, initial_state_opacity)):
            report = ask(des, secret=secret)
            shortest = naive.shortest_betrayal(des, set(secret), at_start=at_start)
            assert (None if report.outputs is None else len(report.outputs)) == shortest, seed
            assert report.opaque == (shortest is None)
            if report.outputs is not None:
                estimates = (initial_estimates if at_start else current_estimates)(des, report.outputs)
                assert report.estimate == estimates[-1]
                assert set(report.estimate) <= set(secret)
                assert report.run[0 if at_start else -1].location in secret
                assert naive.shows(des, report.run, list(report.outputs))
            kinds[at_start, report.opaque, bool(report.outputs)] += 1
    assert len(kinds) == 6
    assert min(kinds.values()) >= 12, kinds
