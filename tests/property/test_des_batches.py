"""The observer in batches against the one set by set, and both against sets of names: no difference at all."""

import random
from collections.abc import Callable
from itertools import pairwise

import numpy as np
import pytest

from benchmarks.families import dense, from_the_end, line, sparse
from deshybrid.des import batches, observer, subsets
from deshybrid.des.automaton import DES, Output
from deshybrid.des.batches import ArrayGraph
from deshybrid.des.cycles import persistent_among, persistent_nodes
from deshybrid.des.epsilon import OutputAutomaton, eliminate_epsilon
from deshybrid.des.observer import LocationObserver, build_location_observer
from deshybrid.des.subsets import PlainGraph
from deshybrid.des.worklist import explore, explore_while_few
from deshybrid.diagnostics import LimitReached, OutOfResources, within
from tests import naive_des as naive
from tests.strategies import random_des

SYSTEMS = [random_des(random.Random(seed)) for seed in range(150)]
SYSTEMS += [sparse(30, outputs=4, silent=0.3, seed=seed) for seed in range(8)]
SYSTEMS += [sparse(12, branching=3, outputs=2, silent=0.7, seed=seed) for seed in range(8)]
SYSTEMS += [dense(12, branching=3, outputs=3), from_the_end(6), line(40)]
CONVENTIONS = pytest.mark.parametrize("closed", [False, True], ids=["entry", "closed"])

Shape = tuple[object, ...]


def shape(des: DES, closed: bool, **options: object) -> Shape:
    built = build_location_observer(eliminate_epsilon(des), closed=closed, **options)  # type: ignore[arg-type]
    assert len(built) == len(built.states)
    assert built.arc_count == len(built.transitions)
    return built.states, built.transitions, built.persistent


@pytest.fixture
def set_by_set(monkeypatch: pytest.MonkeyPatch) -> Callable[..., Shape]:
    def build(des: DES, closed: bool, **options: object) -> Shape:
        with monkeypatch.context() as patch:
            patch.setattr(observer, "_FEW_WAITING", 10**9)
            patch.setattr(observer, "_LARGE", 10**9)
            return shape(des, closed, **options)

    return build


def only_batches(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(observer, "_LARGE", 0)


def early_batches(patch: pytest.MonkeyPatch) -> None:
    patch.setattr(observer, "_FEW_WAITING", 1)


def small_batches(patch: pytest.MonkeyPatch) -> None:
    only_batches(patch)
    patch.setattr(batches, "_BATCH", 3)
    patch.setattr(batches, "_FLAGS", 40)


def silence_in_rounds(patch: pytest.MonkeyPatch) -> None:
    only_batches(patch)
    patch.setattr(batches, "_FEW", 0)
    patch.setattr(batches, "_FLAGS", 40)


def long_numbers(patch: pytest.MonkeyPatch) -> None:
    only_batches(patch)
    patch.setattr(batches, "_SHORT", 0)


def codes_that_collide(patch: pytest.MonkeyPatch) -> None:
    only_batches(patch)
    good = batches._codes
    patch.setattr(batches, "_codes", lambda size, salt: np.ones(size, np.uint64) if salt < 2 else good(size, salt))


WAYS = [only_batches, early_batches, small_batches, silence_in_rounds, long_numbers, codes_that_collide]


@CONVENTIONS
@pytest.mark.parametrize("way", WAYS)
def test_batches_give_the_observer_that_the_worklist_gives(
    way: Callable[[pytest.MonkeyPatch], None],
    closed: bool,
    set_by_set: Callable[..., Shape],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    expected = [set_by_set(des, closed) for des in SYSTEMS]
    way(monkeypatch)
    assert [shape(des, closed) for des in SYSTEMS] == expected


@CONVENTIONS
@pytest.mark.parametrize("in_batches", [False, True])
def test_the_observer_is_the_one_of_sets_of_names(
    closed: bool, in_batches: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    if in_batches:
        only_batches(monkeypatch)
    for des in SYSTEMS[:120]:
        built = build_location_observer(eliminate_epsilon(des), closed=closed)
        assert isinstance(built.graph, ArrayGraph if in_batches else PlainGraph)
        assert named_arcs(built) == (closed_arcs(des) if closed else naive.observer_arcs(des))
        assert len(set(built.states)) == len(built.states)


def named_arcs(built: LocationObserver) -> set[tuple[frozenset[str], Output, frozenset[str]]]:
    names = [frozenset(state) for state in built.states]
    return {(names[source], output, names[target]) for source, output, target in built.transitions}


def closed_arcs(des: DES) -> set[tuple[frozenset[str], Output, frozenset[str]]]:
    """As automata-lib and the textbooks have it: closed at the start, then a move on the output, then closed."""
    start = naive.after_silence(des, des.initial)
    arcs, waiting, known = set(), [start], {start}
    while waiting:
        state = waiting.pop()
        for output in naive.all_outputs(des):
            target = naive.after_silence(
                des, {t.target for t in des.transitions if t.source in state and output in t.seen}
            )
            if target:
                arcs.add((state, output, target))
                waiting += [target] if target not in known else []
                known.add(target)
    return arcs


def test_closing_entry_estimates_gives_the_closed_observer_and_never_more_states() -> None:
    fewer = 0
    for des in SYSTEMS:
        automaton = eliminate_epsilon(des)
        entry, closed = (build_location_observer(automaton, closed=option) for option in (False, True))
        assert {naive.after_silence(des, state) for state in entry.states} == set(map(frozenset, closed.states))
        fewer += len(closed) < len(entry)
    assert fewer > 10


@CONVENTIONS
def test_a_limit_is_reached_at_the_same_set_and_said_in_the_same_words(
    closed: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    reached = 0
    for des in SYSTEMS[::3]:
        automaton = eliminate_epsilon(des)
        for limit in (0, 1, 2, 5, 9, 30):
            plainly = outcome(automaton, limit, closed)
            with monkeypatch.context() as patch:
                only_batches(patch)
                by_batches = outcome(automaton, limit, closed)
            assert by_batches == plainly
            reached += plainly is not None
    assert reached > 60


def outcome(automaton: OutputAutomaton, limit: int, closed: bool) -> object:
    try:
        build_location_observer(automaton, max_states=limit, closed=closed)
    except LimitReached as reached:
        return reached.diagnostics
    return None


def test_a_limit_is_reached_long_before_the_observer_is_built() -> None:
    with pytest.raises(LimitReached) as caught:
        build_location_observer(eliminate_epsilon(from_the_end(60)), max_states=5_000)
    assert caught.value.diagnostics[0].message == "there are more than 5000 observer states"


def test_batches_mind_the_time_and_the_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    only_batches(monkeypatch)
    for limits in ({"timeout": 0.0}, {"memory": 1}):
        with within(**limits), pytest.raises(OutOfResources):
            build_location_observer(eliminate_epsilon(from_the_end(6)))


@pytest.mark.parametrize("way", [only_batches, early_batches])
@CONVENTIONS
def test_more_roots_are_numbered_alike_in_batches(
    way: Callable[[pytest.MonkeyPatch], None],
    closed: bool,
    set_by_set: Callable[..., Shape],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    draw = random.Random(7)
    cases = []
    for des in SYSTEMS[:100]:
        some = [tuple(draw.sample(des.locations, draw.randint(0, len(des.locations)))) for _ in range(3)]
        cases.append((des, (*some, some[0])))
    expected = [set_by_set(des, closed, starts=starts) for des, starts in cases]
    way(monkeypatch)
    assert [shape(des, closed, starts=starts) for des, starts in cases] == expected


def test_persistent_nodes_by_strong_components_are_those_left_by_removal() -> None:
    draw = random.Random(5)
    for _ in range(300):
        size = draw.randint(1, 12)
        follow = {node: draw.choices(range(size), k=draw.choice([0, 0, 1, 1, 2])) for node in range(size)}
        graph = explore(range(size), lambda node, follow=follow: [(None, other) for other in follow[node]])
        source, target = (np.array([arc[end] for arc in graph.arcs], dtype=np.int32) for end in (0, 2))
        assert persistent_among(size, source, target) == persistent_nodes(graph)


def test_the_worklist_stops_as_soon_as_more_nodes_wait_than_it_should_keep() -> None:
    for waiting in range(1, 20):
        graph, expanded = explore_while_few([1], lambda n: [(0, 2 * n), (1, 2 * n + 1)], waiting=waiting, limit=1000)
        assert len(graph.nodes) - expanded == waiting + 1
        assert graph.nodes == tuple(range(1, len(graph.nodes) + 1))
    graph, expanded = explore_while_few([0], lambda n: [(0, min(n + 1, 9))], waiting=1)
    assert expanded == len(graph.nodes) == 10


def test_codes_of_locations_differ_from_each_other_and_from_salt_to_salt() -> None:
    codes = np.concatenate([batches._codes(10_000, salt) for salt in range(3)])
    assert len(np.unique(codes)) == 30_000
    sums = [int(part.sum(dtype=np.uint64)) for part in np.split(codes, 3)]
    assert all(first != second for first, second in pairwise(sums))


def test_bit_masks_and_tuples_follow_silence_after_outputs_alike() -> None:
    for des in SYSTEMS:
        outputs = eliminate_epsilon(des).outputs
        found = []
        for kind in (subsets._Masks, subsets._Tuples):
            moves = kind(des, outputs, closed=True)
            graph = explore([moves.start(range(len(des.locations)))], moves.successors)
            found.append(([list(moves.members(node)) for node in graph.nodes], graph.arcs))
        assert found[0] == found[1]
