"""The cheapest signatures against all subsets of transitions, all sets of generators, residual or negation for each."""

import random
from collections.abc import Callable, Iterable, Iterator
from itertools import chain, combinations, product

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate
from deshybrid.des.minimum import all_minimum_sets
from deshybrid.des.observability import check_observability
from deshybrid.des.replay import witness_faults
from deshybrid.des.signatures import SignaturePlan, recover_observability
from tests import naive_des as naive
from tests.strategies import candidates_everywhere, random_candidates, random_des, random_detectors, systems


def subsets(items: Iterable[object]) -> Iterator[tuple[object, ...]]:
    items = list(items)
    return chain.from_iterable(combinations(items, size) for size in range(len(items) + 1))


def observable_by_definition(des: DES) -> bool:
    return not naive.c1_failures(des) and not naive.c2_failures(des)


def observable_by_pairs(des: DES) -> bool:
    return check_observability(des, method="pairs").current_location_observable


def complementary(des: DES, candidates: tuple[Candidate, ...], chosen: Iterable[object]) -> DES:
    """Chosen are transitions that carry the signature of their single candidate, and names of covering detectors."""
    wanted, names = set(chosen), dict[int, list[str]]()
    for candidate in candidates:
        for t in candidate.transitions:
            if (candidate.name if candidate.covers else t) in wanted:
                names.setdefault(t, []).append(candidate.name)
    return des.with_signatures({t: "+".join(several) for t, several in names.items()})


def least_cost(des: DES, candidates: tuple[Candidate, ...], chosen: tuple[object, ...]) -> float | None:
    """The cheapest generators that can emit the signatures on the chosen transitions, None where none can."""
    price: dict[str, float] = {}
    for c in candidates:
        if c.residual and not c.covers:
            price[c.location] = min(c.cost, price.get(c.location, c.cost))
    singles = [c for c in candidates if not c.covers]
    used = [(c, [t for t in c.transitions if t in chosen]) for c in singles if set(c.transitions) & set(chosen)]
    detectors = sum(c.cost for c in candidates if c.covers and c.name in chosen)
    costs = [
        detectors + sum(price[str(location)] for location in generators)
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
        others = (t for t in des.transitions if t.source == source and t.coincides(des.transitions[arc]))
        alternatives = {source} | {t.target for t in others}
        if source == candidate.location or not alternatives - {candidate.location} <= generators:
            return False
    return candidate.negation


def everything_possible(des: DES, candidates: tuple[Candidate, ...]) -> dict[tuple[object, ...], float]:
    """Every set of transitions that can be instrumented, with the least cost of doing so."""
    places = [place for c in candidates for place in ([c.name] if c.covers else c.transitions)]
    costs = {chosen: least_cost(des, candidates, chosen) for chosen in subsets(places)}
    return {chosen: cost for chosen, cost in costs.items() if cost is not None}


def best(
    candidates: tuple[Candidate, ...],
    possible: dict[tuple[object, ...], float],
    accept: Callable[[tuple[object, ...]], bool],
) -> tuple[float, int] | None:
    """The least (cost, number of instrumented transitions) over everything that is possible and that `accept` takes."""
    scores = ((cost, carried(candidates, chosen)) for chosen, cost in possible.items() if accept(chosen))
    return min(scores, default=None)


def carried(candidates: tuple[Candidate, ...], chosen: tuple[object, ...]) -> int:
    """How many transitions are instrumented: those that are chosen, and all of each detector that is."""
    detectors = sum(len(c.transitions) for c in candidates if c.covers and c.name in chosen)
    return detectors + sum(not isinstance(place, str) for place in chosen)


def assert_plan_is_best(
    des: DES, candidates: tuple[Candidate, ...], observable: Callable[[DES], bool]
) -> SignaturePlan:
    plan = recover_observability(des, candidates)
    possible = everything_possible(des, candidates)
    expected = best(candidates, possible, lambda chosen: observable(complementary(des, candidates, chosen)))
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
        demands = [{*some.transitions, *some.detectors} for some in plan.constraints]
        proven = best(candidates, possible, lambda chosen: all(demand & set(chosen) for demand in demands))
        assert proven == expected
    return plan


def assert_signatures_can_be_emitted(des: DES, candidates: tuple[Candidate, ...], plan: SignaturePlan) -> None:
    by_name = {candidate.name: candidate for candidate in candidates}
    assert len({signature.name for signature in plan.signatures}) == len(plan.signatures)
    for signature in plan.signatures:
        candidate = by_name[signature.name]
        if candidate.covers:
            assert (signature.transitions, signature.covers) == (candidate.transitions, candidate.covers)
            assert candidate.name in plan.generators
            continue
        assert set(signature.transitions) <= set(candidate.transitions)
        assert emits(des, candidate, list(signature.transitions), signature.by, set(plan.generators))


@pytest.mark.parametrize("first", range(0, 240, 60))
def test_recover_equals_brute_force_on_random_systems_with_random_candidates(first: int) -> None:
    for seed in range(first, first + 60):
        rng = random.Random(seed)
        des = random_des(rng, transitions=8)
        assert_plan_is_best(des, random_candidates(rng, des), observable_by_pairs)


@pytest.mark.parametrize("first", range(0, 60, 20))
def test_recover_with_covering_detectors_equals_brute_force(first: int) -> None:
    for seed in range(first, first + 20):
        rng = random.Random(seed)
        des = random_des(rng, locations=rng.randint(3, 6), transitions=6)
        candidates = (*random_candidates(rng, des), *random_detectors(rng, des))
        observable = observable_by_definition if seed % 2 else observable_by_pairs
        assert_plan_is_best(des, candidates, observable)


def test_one_more_detector_never_destroys_observability() -> None:
    for seed in range(60):
        rng = random.Random(seed)
        des = random_des(rng, locations=4, transitions=7)
        detectors = random_detectors(rng, des, most=3)
        names = [candidate.name for candidate in detectors]
        for fewer in subsets(names):
            for more in subsets(names):
                if set(fewer) < set(more) and observable_by_pairs(complementary(des, detectors, fewer)):
                    assert observable_by_pairs(complementary(des, detectors, more))


def minimum_by_brute_force(des: DES, candidates: tuple[Candidate, ...]) -> set[frozenset[object]]:
    """Every set that recovers with the least cost and the fewest transitions."""
    possible = everything_possible(des, candidates)
    scores = {
        chosen: (cost, carried(candidates, chosen))
        for chosen, cost in possible.items()
        if observable_by_pairs(complementary(des, candidates, chosen))
    }
    return {frozenset(chosen) for chosen, score in scores.items() if score == min(scores.values())}


def test_all_minimum_sets_are_those_of_brute_force() -> None:
    several = 0
    for seed in range(40):
        rng = random.Random(seed)
        des = random_des(rng, locations=4, transitions=6)
        singles = random_candidates(rng, des) if seed % 2 else candidates_everywhere(des)
        candidates = (*singles, *random_detectors(rng, des, most=1))
        found = all_minimum_sets(des, candidates)
        got = [
            frozenset(place for s in one.signatures for place in ([s.name] if s.covers else s.transitions))
            for one in found.sets
        ]
        assert found.complete
        assert set(got) == minimum_by_brute_force(des, candidates)
        assert len({(one.signatures, one.generators) for one in found.sets}) == len(found.sets)
        several += len(set(got)) > 1
    assert several >= 3


def test_a_cap_on_minimum_sets_is_a_limit_and_is_said() -> None:
    des = DES.from_transitions([("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")])
    everything, one = (all_minimum_sets(des, candidates_everywhere(des), most=most) for most in (2, 1))
    assert (everything.complete, everything.undecided) == (True, ())
    assert (one.complete, len(one.sets), one.undecided[0].code) == (False, 1, "DH0908")


def test_cheaper_candidates_take_the_place_of_dearer_ones() -> None:
    """Costs decide, also where more signatures are cheaper than one."""
    des = DES.from_transitions([("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")])
    for dear, cheap, expected in ((2.0, 1.5, "s_3"), (1.0, 1.25, "s_2")):
        offered = (
            Candidate("s_2", "2", (0,), dear, negation=False),
            Candidate("s_3", "3", (1,), cheap, negation=False),
        )
        plan = recover_observability(des, offered)
        assert (plan.names, plan.cost) == (f"{{{expected}}}", min(dear, cheap))


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
