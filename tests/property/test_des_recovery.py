"""The cheapest signatures against all subsets of transitions, all sets of generators, residual or negation for each."""

import random
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, combinations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate
from deshybrid.des.observability import check_observability
from deshybrid.des.replay import witness_faults
from deshybrid.des.signatures import SignaturePlan, recover_observability
from tests import naive_des as naive
from tests.strategies import candidates_everywhere, random_candidates, random_des, systems


def subsets(items: Iterable[object]) -> Iterator[tuple[object, ...]]:
    items = list(items)
    return chain.from_iterable(combinations(items, size) for size in range(len(items) + 1))


def observable_by_definition(des: DES) -> bool:
    return not naive.c1_failures(des) and not naive.c2_failures(des)


def observable_by_pairs(des: DES) -> bool:
    return check_observability(des, method="pairs").current_location_observable


def complementary(des: DES, candidates: tuple[Candidate, ...], chosen: Iterable[object]) -> DES:
    return des.with_signatures({t: c.name for c in candidates for t in c.transitions if t in set(chosen)})


def least_cost(des: DES, candidates: tuple[Candidate, ...], chosen: tuple[object, ...]) -> float | None:
    """The cheapest generators that can emit the signatures on the chosen transitions, None where none can."""
    price: dict[str, float] = {}
    for c in candidates:
        if c.residual:
            price[c.location] = min(c.cost, price.get(c.location, c.cost))
    used = [(c, [t for t in c.transitions if t in chosen]) for c in candidates if set(c.transitions) & set(chosen)]
    costs = [
        sum(price[str(location)] for location in generators)
        for generators in subsets(price)
        for ways in product(("residual", "negation"), repeat=len(used))
        if all(emits(des, c, arcs, way, set(generators)) for (c, arcs), way in zip(used, ways, strict=True))
    ]
    return min(costs, default=None)


def emits(des: DES, candidate: Candidate, arcs: list[int], way: str, generators: set[object]) -> bool:
    if way == "residual":
        return candidate.residual and candidate.location in generators
    for arc in arcs:
        source = des.transitions[arc].source
        alternatives = {source} | {t.target for t in des.transitions if t.source == source}
        if source == candidate.location or not alternatives - {candidate.location} <= generators:
            return False
    return candidate.negation


def everything_possible(des: DES, candidates: tuple[Candidate, ...]) -> dict[tuple[object, ...], float]:
    """Every set of transitions that can be instrumented, with the least cost of doing so."""
    places = [t for c in candidates for t in c.transitions]
    costs = {chosen: least_cost(des, candidates, chosen) for chosen in subsets(places)}
    return {chosen: cost for chosen, cost in costs.items() if cost is not None}


def best(
    possible: dict[tuple[object, ...], float], accept: Callable[[tuple[object, ...]], bool]
) -> tuple[float, int] | None:
    """The least (cost, number of instrumented transitions) over everything that is possible and that `accept` takes."""
    return min(((cost, len(chosen)) for chosen, cost in possible.items() if accept(chosen)), default=None)


def assert_plan_is_best(
    des: DES, candidates: tuple[Candidate, ...], observable: Callable[[DES], bool]
) -> SignaturePlan:
    plan = recover_observability(des, candidates)
    possible = everything_possible(des, candidates)
    expected = best(possible, lambda chosen: observable(complementary(des, candidates, chosen)))
    assert plan.recoverable == (expected is not None)
    assert plan.already_observable == observable(des)
    if expected is None:
        assert plan.cost is None
        assert plan.confused is not None
        assert witness_faults(plan.report.des, plan.confused) == ()
        return plan
    used = tuple(t for signature in plan.signatures for t in signature.transitions)
    assert (pytest.approx(plan.cost), len(used)) == expected
    assert plan.optimal
    assert plan.lower_bound == pytest.approx(plan.cost)
    assert plan.report.current_location_observable
    assert_signatures_can_be_emitted(des, candidates, plan)
    if not plan.already_observable:
        proven = best(possible, lambda chosen: all(set(chosen) & set(some) for some in plan.constraints))
        assert proven == expected
    return plan


def assert_signatures_can_be_emitted(des: DES, candidates: tuple[Candidate, ...], plan: SignaturePlan) -> None:
    by_name = {candidate.name: candidate for candidate in candidates}
    assert len({signature.name for signature in plan.signatures}) == len(plan.signatures)
    for signature in plan.signatures:
        candidate = by_name[signature.name]
        assert set(signature.transitions) <= set(candidate.transitions)
        assert emits(des, candidate, list(signature.transitions), signature.by, set(plan.generators))


@pytest.mark.parametrize("first", range(0, 240, 60))
def test_recover_equals_brute_force_on_random_systems_with_random_candidates(first: int) -> None:
    for seed in range(first, first + 60):
        rng = random.Random(seed)
        des = random_des(rng, transitions=8)
        assert_plan_is_best(des, random_candidates(rng, des), observable_by_pairs)


def test_recover_equals_brute_force_on_the_definitions() -> None:
    for seed in range(1000, 1030):
        rng = random.Random(seed)
        des = random_des(rng, locations=5, transitions=6)
        assert_plan_is_best(des, random_candidates(rng, des), observable_by_definition)


def test_the_random_systems_show_every_kind_of_plan() -> None:
    """Without this, the comparison above could be one of trivial plans only."""
    kinds = {"nothing to do": 0, "nothing helps": 0, "one": 0, "several": 0, "negation": 0, "fewer generators": 0}
    for seed in range(240):
        rng = random.Random(seed)
        des = random_des(rng, transitions=8)
        plan = recover_observability(des, random_candidates(rng, des))
        kinds["nothing to do"] += plan.already_observable
        kinds["nothing helps"] += not plan.recoverable
        kinds["one"] += len(plan.signatures) == 1
        kinds["several"] += len(plan.signatures) > 1
        kinds["negation"] += any(signature.by == "negation" for signature in plan.signatures)
        kinds["fewer generators"] += len(plan.generators) < len(plan.signatures)
    assert min(kinds.values()) >= 5, kinds


@given(systems(locations=4, transitions=6), st.data())
@settings(max_examples=40, deadline=None)
def test_recover_equals_brute_force_on_systems_that_hypothesis_finds(des: DES, data: st.DataObject) -> None:
    forbidden = data.draw(st.sets(st.integers(0, 5)))
    assert_plan_is_best(des, candidates_everywhere(des, forbid=tuple(forbidden)), observable_by_pairs)


@given(systems(), st.data())
@settings(max_examples=150, deadline=None)
def test_one_more_signature_never_destroys_observability(des: DES, data: st.DataObject) -> None:
    some = data.draw(st.sets(st.integers(0, 7)))
    more = some | data.draw(st.sets(st.integers(0, 7)))
    candidates = candidates_everywhere(des)
    before = check_observability(complementary(des, candidates, some))
    after = check_observability(complementary(des, candidates, more))
    assert after.current_location_observable >= before.current_location_observable
