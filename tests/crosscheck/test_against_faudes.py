"""The toolkit beside libFAUDES, an independent C++ library: 500 random systems a question, and no disagreement.

libFAUDES works on the events of an automaton, so all events are seen here by their own names.  What it asks of its
input is kept by the generators: one initial state where it wants a deterministic automaton, and for diagnosability
faults that show nothing, no dead end and no cycle of silent events.
"""

import random
from collections import Counter
from collections.abc import Callable

import pytest

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.composition import parallel, product
from deshybrid.des.faults import diagnosability
from deshybrid.des.languages import DeterministicAutomaton, determinise, equivalent, included, minimise
from deshybrid.des.operations import accessible, project, trim

faudes = pytest.importorskip("faudes", reason="libFAUDES has no package for this system")
from tests.crosscheck.libfaudes import Walk, event_set, generator, walk, walk_of  # noqa: E402

SEEDS = range(500)
EVENTS = "abc"


def random_automaton(rng: random.Random, *, deterministic: bool, events: str = EVENTS) -> tuple[DES, list[str]]:
    """Up to seven states, one to three times as many arcs; with dead ends, self-loops, unreachable parts, any marks."""
    names = tuple(f"q{number}" for number in range(rng.randint(1, 7)))
    arcs: dict[tuple[str, ...], Transition] = {}
    for _ in range(rng.randint(len(names), 3 * len(names))):
        source, event, target = rng.choice(names), rng.choice(events), rng.choice(names)
        arcs[(source, event) if deterministic else (source, event, target)] = Transition(source, event, target)
    starts = rng.sample(names, 1 if deterministic else rng.randint(1, len(names)))
    return seen_by_name(DES(names, tuple(arcs.values()), tuple(starts))), rng.sample(names, rng.randint(1, len(names)))


def seen_by_name(des: DES) -> DES:
    return project(des, des.events)


def walk_of_ours(automaton: DeterministicAutomaton) -> Walk:
    table: dict[int, dict[str, int]] = {}
    for source, output, target in automaton.transitions:
        table.setdefault(source, {})[str(output)] = target
    return walk(table, [0], set(automaton.accepting))


def walk_of_system(des: DES) -> Walk:
    table: dict[str, dict[str, str]] = {}
    for t in des.transitions:
        table.setdefault(t.source, {})[t.event] = t.target
    return walk(table, list(des.initial), set())


def minimal_there(made: object) -> object:
    """Their minimal automaton of the marked language, without what leads to no marked state."""
    smallest = faudes.Generator()
    faudes.Trim(made)
    faudes.StateMin(made, smallest)
    return smallest


def test_determinisation_gives_the_states_and_arcs_of_libfaudes() -> None:
    larger = 0
    for seed in SEEDS:
        des, marked = random_automaton(random.Random(seed), deterministic=False)
        theirs, ours = faudes.Deterministic(generator(des, marked)), determinise(des, marked=marked)
        assert walk_of_ours(ours) == walk_of(theirs), seed
        assert len(ours.states) == theirs.Size()
        larger += len(ours.states) > len(accessible(des).locations)
    assert larger > 25


def test_minimisation_gives_the_minimal_automaton_of_libfaudes() -> None:
    smaller = 0
    for seed in SEEDS:
        des, marked = random_automaton(random.Random(seed), deterministic=False)
        ours = determinise(des, marked=marked)
        if not ours.accepting:
            continue
        theirs = minimal_there(faudes.Deterministic(generator(des, marked)))
        assert walk_of_ours(minimise(ours)) == walk_of(theirs), seed
        smaller += theirs.Size() < len(ours.states)
    assert smaller > 100


def test_projection_gives_the_language_of_libfaudes() -> None:
    hidden = 0
    for seed in SEEDS:
        rng = random.Random(seed)
        des, marked = random_automaton(rng, deterministic=True)
        kept = [event for event in des.events if rng.random() < 0.6]
        projected = project(des, kept)
        ours = determinise(projected, marked=marked)
        theirs = faudes.Project(generator(des, marked), event_set(kept))
        own = generator(ours.to_des(), [str(state) for state in ours.accepting], events=kept)
        assert faudes.LanguageEquality(theirs, own), seed
        for one in (theirs, own):
            faudes.MarkAllStates(one)
        assert faudes.LanguageEquality(theirs, own), seed
        if ours.accepting:
            theirs = minimal_there(faudes.Project(generator(des, marked), event_set(kept)))
            assert walk_of_ours(minimise(ours)) == walk_of(theirs), seed
        hidden += len(kept) < len(des.events) and len(ours.transitions) > 1
    assert hidden > 100


def test_languages_are_included_and_equal_where_libfaudes_says_so() -> None:
    kinds: Counter[tuple[bool, bool]] = Counter()
    for seed in SEEDS:
        rng = random.Random(seed)
        first, marks = random_automaton(rng, deterministic=False, events="ab")
        if seed % 2:
            second, others = random_automaton(rng, deterministic=False, events="ab")
        else:  # the same with one arc less, or with none
            gone = rng.choice(range(2 * len(first)))
            arcs = tuple(t for number, t in enumerate(first.transitions) if number != gone)
            second, others = DES(first.locations, arcs, first.initial), marks
        one, two = (
            faudes.Deterministic(generator(des, names, events="ab"))
            for des, names in ((first, marks), (second, others))
        )
        inside = included(first, second, first_marked=marks, second_marked=others).holds
        same = equivalent(first, second, first_marked=marks, second_marked=others).holds
        assert inside == faudes.LanguageInclusion(one, two), seed
        assert same == faudes.LanguageEquality(one, two), seed
        kinds[inside, same] += 1
    assert len(kinds) == 3
    assert min(kinds.values()) > 25, kinds


@pytest.mark.parametrize(
    ("ours", "theirs", "alphabets"),
    [(parallel, faudes.Parallel, ("ab", "bc", "ac")), (product, faudes.Product, ("ab", "ab", "abc"))],
)
def test_compositions_are_those_of_libfaudes(
    ours: Callable[..., DES], theirs: Callable[..., object], alphabets: tuple[str, ...]
) -> None:
    moving = 0
    for seed in SEEDS:
        rng = random.Random(seed)
        parts = [random_automaton(rng, deterministic=True, events=events)[0] for events in alphabets]
        together = generator(parts[0], ())
        for part in parts[1:]:
            together = theirs(together, generator(part, ()))
        whole = ours(*parts)
        assert walk_of_system(whole) == walk_of(together), seed
        moving += len(whole.transitions) > 3
    assert moving > 25


def test_accessible_and_trimmed_parts_are_those_of_libfaudes() -> None:
    for seed in SEEDS:
        des, marked = random_automaton(random.Random(seed), deterministic=True)
        reached, useful = generator(des, marked), generator(des, marked)
        faudes.Accessible(reached)
        faudes.Trim(useful)
        for ours, theirs in ((accessible(des), reached), (trim(des, marked=marked), useful)):
            assert set(ours.locations) == {theirs.StateName(state) for state in theirs.States()}, seed
            arcs = {(theirs.StateName(a.X1), theirs.EventName(a.Ev), theirs.StateName(a.X2)) for a in theirs.TransRel()}
            assert {(t.source, t.event, t.target) for t in ours.transitions} == arcs


def random_plant(rng: random.Random) -> DES:
    """A live deterministic plant whose silent events, fault `f` and `u`, only lead forward: so no cycle is silent."""
    names = [f"q{number}" for number in range(rng.randint(2, 7))]
    arcs: dict[tuple[str, str], Transition] = {}
    for place, source in enumerate(names):
        for event in rng.sample(EVENTS, rng.randint(1, 2)):
            arcs[source, event] = Transition(source, event, rng.choice(names), (event,))
        for event in "fu":
            if place + 1 < len(names) and rng.random() < 0.3:
                arcs[source, event] = Transition(source, event, rng.choice(names[place + 1 :]))
    return DES(tuple(names), tuple(arcs.values()), (names[0],))


def test_plants_are_diagnosable_where_libfaudes_says_so() -> None:
    kinds: Counter[bool] = Counter()
    for seed in SEEDS:
        plant = random_plant(random.Random(seed))
        faults = {t.event for t in plant.transitions} & {"f"}
        system = generator(plant, (), events="fu", kind=faudes.System)
        for event in "fu":
            system.ClrObservable(event)
        types = faudes.FailureTypeMap()
        types.AddFailureTypeMapping("F", event_set(["f"]))
        ours = diagnosability(plant, faults=faults)
        assert ours.holds == faudes.IsEventDiagnosable(system, types), seed
        kinds[ours.holds] += bool(faults)
    assert min(kinds.values()) > 100, kinds
