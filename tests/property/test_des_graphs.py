"""Searches, cycles and lassos in 2,000 random graphs, against what their documentation says, by brute force."""

import random
from collections.abc import Iterable

import pytest

from deshybrid.des.cycles import (
    cycle_before,
    longest_path_to,
    nodes_on_cycles,
    persistent_nodes,
    shortest_walk,
    strong_components,
    transient_order,
)
from deshybrid.des.lassos import find_lasso
from deshybrid.des.search import explore_until, find_first, labels_to
from deshybrid.des.worklist import Graph, explore
from deshybrid.diagnostics import LimitReached
from tests.naive_des import reachable, reachable_from_cycles

BATCH = 500
batches = pytest.mark.parametrize("first", range(0, 2000, BATCH))


def random_table(rng: random.Random) -> dict[int, list[tuple[str, int]]]:
    """What follows each node: up to seven nodes, up to twelve arcs, self-loops and parallel arcs among them."""
    size = rng.randint(1, 7)
    table: dict[int, list[tuple[str, int]]] = {node: [] for node in range(size)}
    for _ in range(rng.randint(0, 12)):
        table[rng.randrange(size)].append((rng.choice("ab"), rng.randrange(size)))
    return table


def random_graph(rng: random.Random) -> Graph[int, str]:
    table = random_table(rng)
    return explore(rng.sample(sorted(table), rng.randint(1, len(table))), table.__getitem__)


def arcs_of(graph: Graph[int, str], numbers: Iterable[int] | None = None) -> list[tuple[int, int]]:
    numbers = range(len(graph.arcs)) if numbers is None else numbers
    return [(graph.arcs[number][0], graph.arcs[number][2]) for number in numbers]


def distances(starts: Iterable[int], arcs: list[tuple[int, int]]) -> dict[int, int]:
    """The fewest steps to each node that can be reached."""
    layer, found, steps = set(starts), dict.fromkeys(starts, 0), 0
    while layer:
        steps += 1
        layer = {target for source, target in arcs if source in layer} - set(found)
        found |= dict.fromkeys(layer, steps)
    return found


def is_walk(graph: Graph[int, str], walk: Iterable[int], start: int, end: int) -> bool:
    here = start
    for source, target in arcs_of(graph, walk):
        if source != here:
            return False
        here = target
    return here == end


@batches
def test_exploring_finds_what_can_be_reached_once_each_by_shortest_paths(first: int) -> None:
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        table = random_table(rng)
        roots = rng.choices(sorted(table), k=rng.randint(1, 3))
        graph = explore(roots, table.__getitem__)
        steps = distances(roots, [(node, target) for node in table for _, target in table[node]])
        assert set(graph.nodes) == set(steps)
        assert len(set(graph.nodes)) == len(graph.nodes)
        assert [(graph.nodes[s], label, graph.nodes[t]) for s, label, t in graph.arcs] == [
            (node, label, target) for node in graph.nodes for label, target in table[node]
        ]
        for number, node in enumerate(graph.nodes):
            path = graph.path_to(number)
            root = graph.arcs[path[0]][0] if path else number
            assert graph.nodes[root] in roots
            assert is_walk(graph, path, root, number)
            assert len(path) == steps[node]
            assert labels_to(graph, number) == tuple(graph.arcs[arc][1] for arc in path)
        assert [[graph.arcs[arc][0] for arc in arcs] for arcs in graph.outgoing()] == [
            [number] * len(table[node]) for number, node in enumerate(graph.nodes)
        ]
        assert sorted(arc for arcs in graph.incoming() for arc in arcs) == list(range(len(graph.arcs)))
        assert all(graph.arcs[arc][2] == node for node, arcs in enumerate(graph.incoming()) for arc in arcs)


@batches
def test_a_search_stops_at_a_nearest_goal(first: int) -> None:
    found = 0
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        table = random_table(rng)
        roots = rng.choices(sorted(table), k=rng.randint(1, 2))
        goals = set(rng.choices(sorted(table), k=rng.randint(0, 2)))
        graph, goal = find_first(roots, table.__getitem__, goals.__contains__)
        steps = distances(roots, [(node, target) for node in table for _, target in table[node]])
        nearest = min((steps[node] for node in goals if node in steps), default=None)
        assert (goal is None) == (nearest is None)
        if goal is not None:
            assert graph.nodes[goal] in goals
            assert len(graph.path_to(goal)) == nearest
            assert sum(node in goals for node in graph.nodes) == 1 or nearest == 0
            found += nearest is not None and nearest > 1
    assert found > 10


def test_a_search_in_shares_gives_the_first_part_that_has_what_is_sought() -> None:
    """The parts have 1000, 4000, 16000, ... expanded nodes; a node that is not expanded has no arcs."""

    def onwards(node: int) -> list[tuple[str, int]]:
        return [("next", node + 1)] if node < 5000 else []

    for sought, nodes in ((1, 1001), (1000, 1001), (1001, 4001), (4000, 4001), (4001, 5001), (5000, 5001)):
        asked = []

        def seek(graph: Graph[int, str], sought: int = sought, asked: list[int] = asked) -> int | None:
            asked.append(len(graph.nodes))
            return sought if sought in graph.nodes else None

        part = explore_until([0], onwards, seek)
        assert part is not None
        assert (len(part[0].nodes), part[1]) == (nodes, sought)
        assert asked == [size for size in (1001, 4001, 5001) if size <= nodes]
    assert explore_until([0], onwards, lambda graph: None) is None


def test_exploring_stops_just_beyond_its_limit_and_says_how_far_it_came() -> None:
    assert len(explore([0], lambda node: [("next", (node + 1) % 3)], limit=3).nodes) == 3
    with pytest.raises(LimitReached) as stopped:
        explore([0], lambda node: [("left", node + 1), ("right", node + 2)], limit=5)
    (problem,) = stopped.value.diagnostics
    assert problem.message == "there are more than 5 states"
    assert problem.notes == ("6 states were found when the search stopped, 2 of them not yet expanded",)


def test_a_search_in_shares_ends_with_the_share_that_was_the_last() -> None:
    asked: list[int] = []
    answer = explore_until(
        [1], lambda node: [("next", node + 1)] if node < 1000 else [], lambda graph: asked.append(len(graph.nodes))
    )
    assert (answer, asked) == (None, [1000])


@batches
def test_what_a_cycle_leads_to_and_the_longest_ways_to_the_rest(first: int) -> None:
    long = 0
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        graph = random_graph(rng)
        nodes, arcs = range(len(graph.nodes)), arcs_of(graph)
        lasting = reachable_from_cycles(nodes, arcs)
        assert persistent_nodes(graph) == sorted(lasting)  # type: ignore[type-var]
        order = transient_order(graph)
        assert sorted(order) == [node for node in nodes if node not in lasting]
        places = {node: place for place, node in enumerate(order)}
        assert all(places[source] < places[target] for source, target in arcs if target in places)
        for goals in ([], order[-1:], order):
            assert longest_path_to(graph, goals) == longest(graph, goals)
        long += (longest_path_to(graph, order) or 0) > 1
    assert long > 10


def longest(graph: Graph[int, str], goals: list[int]) -> int | None:
    """The most steps after which some path can still end in a goal, among transient nodes only."""
    layer, most = set(range(len(graph.nodes))), None
    for steps in range(len(graph.nodes) + 1):
        if layer & set(goals):
            most = steps
        layer = {target for source, target in arcs_of(graph) if source in layer}
    return most


@batches
def test_strong_components_hold_the_nodes_that_reach_each_other_successors_first(first: int) -> None:
    for seed in range(first, first + BATCH):
        graph = random_graph(random.Random(seed))
        nodes, arcs = range(len(graph.nodes)), arcs_of(graph)
        onwards = {node: reachable([node], arcs) for node in nodes}
        components = strong_components(graph)
        assert sorted(node for component in components for node in component) == list(nodes)
        for place, component in enumerate(components):
            assert component == [
                node for node in nodes if component[0] in onwards[node] and node in onwards[component[0]]
            ]
            assert not any(set(later) & onwards[component[0]] for later in components[place + 1 :])
        after_one_step = {node: reachable([t for s, t in arcs if s == node], arcs) for node in nodes}
        assert nodes_on_cycles(graph) == [node in after_one_step[node] for node in nodes]


@batches
def test_a_shortest_walk_is_one_in_either_direction(first: int) -> None:
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        graph = random_graph(rng)
        arcs = arcs_of(graph)
        start, goals = rng.randrange(len(graph.nodes)), set(rng.choices(range(len(graph.nodes)), k=2))
        for backward in (False, True):
            ways = [(target, source) for source, target in arcs] if backward else arcs
            for at_least_one in (False, True):
                walk = shortest_walk(graph, start, goals.__contains__, backward=backward, at_least_one=at_least_one)
                steps = distances([start], ways)
                if at_least_one:
                    steps = {n: d + 1 for n, d in distances([t for s, t in ways if s == start], ways).items()}
                fewest = min((steps[goal] for goal in goals if goal in steps), default=None)
                assert (None if walk is None else len(walk)) == fewest
                if walk:
                    first_arc, last_arc = graph.arcs[walk[0]], graph.arcs[walk[-1]]
                    end = first_arc[0] if backward else last_arc[2]
                    assert end in goals
                    assert is_walk(graph, walk, *((end, start) if backward else (start, end)))


@batches
def test_a_cycle_before_a_node_is_the_nearest_one_and_as_short_as_can_be(first: int) -> None:
    away = 0
    for seed in range(first, first + BATCH):
        graph = random_graph(random.Random(seed))
        nodes, arcs = range(len(graph.nodes)), arcs_of(graph)
        lasting, cyclic = set(persistent_nodes(graph)), nodes_on_cycles(graph)
        for node in nodes:
            if node not in lasting:
                with pytest.raises(ValueError, match="no cycle leads to node"):
                    cycle_before(graph, node)
                continue
            cycle, tail = cycle_before(graph, node)
            entry = graph.arcs[cycle[0]][0]
            assert is_walk(graph, cycle, entry, entry)
            assert is_walk(graph, tail, entry, node)
            assert len(tail) == distances([n for n in nodes if cyclic[n]], arcs)[node]
            around = distances([target for source, target in arcs if source == entry], arcs)
            assert len(cycle) == around[entry] + 1
            away += len(tail) > 1
    assert away > 10


@batches
def test_a_lasso_is_found_where_there_is_one_and_is_one(first: int) -> None:
    kinds = {True: 0, False: 0}
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        graph = random_graph(rng)
        nodes = range(len(graph.nodes))
        inside = {node for node in nodes if rng.random() < 0.8}
        used = {arc for arc in range(len(graph.arcs)) if rng.random() < 0.5}
        goals = {node for node in nodes if rng.random() < 0.5}
        lasso = find_lasso(graph, within=inside.__contains__, through=used.__contains__, goal=goals.__contains__)
        permitted = [arc for arc in arcs_of(graph) if set(arc) <= inside]
        turns = [arc for arc in arcs_of(graph, used) if set(arc) <= inside and arc[0] in reachable([arc[1]], permitted)]
        assert (lasso is not None) == bool(reachable([s for s, _ in turns], arcs_of(graph)) & goals)
        kinds[lasso is not None] += 1
        if lasso is not None:
            start = graph.arcs[lasso.around[0]][0]
            root = graph.arcs[lasso.before[0]][0] if lasso.before else start
            end = graph.arcs[lasso.after[-1]][2] if lasso.after else start
            assert graph.found_by[root] == -1
            assert is_walk(graph, lasso.before, root, start)
            assert is_walk(graph, lasso.around, start, start)
            assert is_walk(graph, lasso.after, start, end)
            assert end in goals
            assert set(lasso.around) & used
            assert {node for arc in arcs_of(graph, lasso.around) for node in arc} <= inside
    assert min(kinds.values()) > 50, kinds
