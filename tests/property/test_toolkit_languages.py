"""Operations, compositions, estimates and languages against their definitions, on random systems."""

import random
from collections import Counter

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.composition import Composition, parallel
from deshybrid.des.estimates import current_estimates, initial_estimates
from deshybrid.des.languages import determinise, equivalent, included, minimise
from deshybrid.des.operations import accessible, coaccessible, hide, project, reverse, trim
from deshybrid.des.runs import shortest_run
from tests import naive_toolkit as naive
from tests.naive_des import all_outputs, reachable
from tests.strategies import random_des

BATCH = 500
batches = pytest.mark.parametrize("first", range(0, 2000, BATCH))  # 2,000 systems a property


def some(rng: random.Random, names: tuple[str, ...]) -> list[str]:
    return rng.sample(names, rng.randint(0, len(names)))


@batches
def test_accessible_and_trimmed_parts_hold_exactly_the_locations_on_runs(first: int) -> None:
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        des = random_des(rng)
        marked = some(rng, des.locations)
        arcs = [(t.source, t.target) for t in des.transitions]
        assert set(accessible(des).locations) == reachable(des.initial, arcs)
        part = trim(des, marked=marked)
        assert set(part.locations) == naive.trimmed(des, marked)
        assert list(part.transitions) == [t for t in des.transitions if {t.source, t.target} <= set(part.locations)]
        assert part.initial == tuple(name for name in des.initial if name in part.locations)
        back = [(target, source) for source, target in arcs]
        assert set(coaccessible(des, marked=marked).locations) == reachable(marked, back)


@batches
def test_reversed_runs_are_runs_of_the_reverse(first: int) -> None:
    for seed in range(first, first + BATCH):
        des = random_des(random.Random(seed))
        turned = reverse(des)
        assert reverse(turned, initial=des.initial) == des
        for word in naive.words(all_outputs(des)[:2], 2):
            ends = naive.after_word(turned, des.locations, word[::-1])
            assert {q for q in des.locations if naive.after_word(des, [q], word)} == ends


@batches
def test_estimates_along_a_word_are_those_of_the_definition(first: int) -> None:
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        des = random_des(rng)
        word = rng.choices(all_outputs(des), k=4) if all_outputs(des) else []
        now, start = current_estimates(des, word), initial_estimates(des, [str(output) for output in word])
        for length in range(len(word) + 1):
            assert set(now[length]) == naive.after_word(des, des.initial, word[:length])
            assert set(start[length]) == {q for q in des.initial if naive.after_word(des, [q], word[:length])}
        run = shortest_run(des, word)
        assert (run is None) == (now[-1] == ())
        ends = set(some(rng, des.locations))
        assert (None if run is None else len(run) - 1) == naive.shortest_run(des, word, des.initial, {*des.locations})
        if run is not None:
            assert naive.shows(des, run, [str(output) for output in word])
        starts = some(rng, des.locations)
        run = shortest_run(des, [str(output) for output in word], start=starts, end=ends)
        assert (None if run is None else len(run) - 1) == naive.shortest_run(des, word, starts, ends)
        if run is not None:
            assert naive.shows(des, run, [str(output) for output in word])
            assert (run[0].location in starts, run[-1].location in ends) == (True, True)


@batches
def test_deterministic_and_minimal_automata_accept_the_same_words_with_the_fewest_states(first: int) -> None:
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        des = random_des(rng, locations=5, transitions=8)
        marked = some(rng, des.locations) if seed % 2 else list(des.locations)
        automaton = determinise(des, marked=marked)
        smallest = minimise(automaton)
        for word in naive.words(all_outputs(des)[:3], 3):
            expected = bool(naive.after_word(des, des.initial, word) & set(marked))
            assert automaton.accepts(word) == smallest.accepts(word) == expected
        assert len(smallest.states) == naive.fewest_states(des, set(marked))
        accepting = [str(number) for number in smallest.accepting]
        if accepting:
            assert equivalent(des, smallest.to_des(), first_marked=marked, second_marked=accepting).holds


@batches
def test_inclusion_and_equivalence_agree_with_subsets_and_give_a_shortest_word(first: int) -> None:
    kinds: Counter[str] = Counter()
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        first, second = (random_des(rng, locations=4, transitions=7) for _ in range(2))
        if seed % 3 == 0:
            second = hide(first, [rng.choice(first.transitions).event]) if first.transitions else first
        if seed % 3 == 1:
            second = minimise(determinise(first)).to_des()
        marks = ([*first.locations], [*second.locations])
        if seed % 2:
            marks = (some(rng, first.locations), some(rng, second.locations))
        known = (set(marks[0]), set(marks[1]))
        report = included(first, second, first_marked=marks[0], second_marked=marks[1])
        length = naive.first_difference(first, second, lambda one, two: one and not two, known)
        assert (None if report.word is None else len(report.word)) == length
        assert report.holds == (length is None)
        same = equivalent(first, second, first_marked=marks[0], second_marked=marks[1])
        length = naive.first_difference(first, second, lambda one, two: one != two, known)
        assert (None if same.word is None else len(same.word)) == length
        if same.word is not None:
            ends = [
                bool({*current_estimates(des, same.word)[-1]} & set(mark))
                for des, mark in ((first, marks[0]), (second, marks[1]))
            ]
            assert ends == [same.missing_from == "second", same.missing_from == "first"]
        one, two = (minimise(determinise(des, marked=mark)) for des, mark in zip((first, second), marks, strict=True))
        alike = (one.transitions, one.accepting) == (two.transitions, two.accepting)
        assert alike == same.holds
        kinds[f"included {report.holds}, equal {same.holds}"] += 1
    assert len(kinds) == 3
    assert min(kinds.values()) >= 30, kinds


def small(rng: random.Random, number: int) -> DES:
    des = random_des(rng, locations=3, transitions=5)
    own = [(t.source, rng.choice(["a", "b", f"own{number}"]), t.target, t.outputs[0]) for t in des.transitions]
    return DES.from_transitions(own, initial=own[0][:1] if own else ()) if own else des


@batches
def test_compositions_reach_the_states_and_arcs_of_the_full_product(first: int) -> None:
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        parts = tuple(small(rng, number) for number in range(rng.randint(1, 3)))
        for only_common in (False, True):
            plant = Composition(parts, only_common)
            arcs = list(naive.joint_arcs(parts, only_common))
            reached = reachable(list(plant.initial), [(source, target) for source, _, target in arcs])
            des = plant.build()
            assert set(des.locations) == {".".join(state) for state in reached}
            expected = Counter((".".join(s), e, ".".join(t)) for s, e, t in arcs if s in reached)
            assert Counter((t.source, t.event, t.target) for t in des.transitions) == expected
            goal = tuple(rng.choice(part.locations) for part in parts)
            run = plant.find(lambda state, goal=goal: state == goal)
            assert (run is None) == (goal not in reached)
            if run is not None:
                states = [run.start, *(state for _, state in run.steps)]
                taken = {
                    (before, joint.event, after) for before, (joint, after) in zip(states, run.steps, strict=False)
                }
                assert taken <= set(arcs)
                assert (run.start in set(plant.initial), run.end) == (True, goal)
                assert len(run.steps) == naive.distance(plant.initial, [(s, t) for s, _, t in arcs], {goal})


@batches
def test_parallel_composition_of_projections_shows_what_both_permit(first: int) -> None:
    """With every event seen by its own name, a word is shown by the whole where its shadows are shown by the parts."""
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        parts = [small(rng, number) for number in range(2)]
        parts = [project(part, {t.event for t in part.transitions}) for part in parts]
        whole = parallel(*parts)
        for word in naive.words(all_outputs(whole)[:3], 3):
            shadows = [[o for o in word if o in all_outputs(part)] for part in parts]
            permitted = all(naive.after_word(p, p.initial, shadow) for p, shadow in zip(parts, shadows, strict=True))
            assert bool(naive.after_word(whole, whole.initial, word)) == permitted
