"""The confusions that a choice of signatures leaves, each with a minimal set of options of which one is needed.

In: a `Separation` and a choice of options.  Out: `Demand`s.  Idea: the moves that still look alike are a graph; its
strong components hold the joint cycles; a cheapest way round (counting the options that separate a move) is taken, and
then everything that separates it but one is forgiven, to see whether a part of the set still leaves a confusion.
Cost: each search is linear in the moves, up to a logarithm; one more for each option of a constraint.
Source: Balluchi et al. (2012), Theorem 4; Davies and Bacchus (2011) for making constraints minimal.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.des.automaton import Output
from deshybrid.des.cycles import cycle_before
from deshybrid.des.persistence import location_graph, persistent_locations
from deshybrid.des.separation import STAYS, Demand, Mask, Moves, Numbers, Separation, Shown

_MOST_AT_ONCE = 20
_BASE = 0.125  # what a move costs beside the options that separate it: shorter runs among equals
_Move: TypeAlias = tuple[int, int]
Distances: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class _Graph:
    """Moves with numbered nodes, at most one for each pair of nodes: the one with the fewest separating options."""

    nodes: Numbers
    moves: Moves
    start: Numbers
    end: Numbers

    @classmethod
    def of(cls, moves: Moves) -> "_Graph":
        nodes, place = np.unique(np.concatenate((moves.source, moves.target)), return_inverse=True)
        start, end = place[: len(moves.source)], place[len(moves.source) :]
        order = np.lexsort((moves.weight, end, start))
        code = start[order] * len(nodes) + end[order]
        kept = order[np.concatenate(([True], code[1:] != code[:-1]))] if len(order) else order
        return cls(nodes, moves.where(kept), start[kept], end[kept])

    def ways_from(self, sources: Numbers) -> tuple[Distances, Numbers]:
        """Return the cost of the cheapest way from any of the source nodes to each node, and the node before it."""
        from scipy.sparse import coo_array
        from scipy.sparse.csgraph import dijkstra

        size = len(self.nodes)
        graph = coo_array((self.moves.weight + _BASE, (self.start, self.end)), shape=(size, size)).tocsr()
        distance, before, _ = dijkstra(graph, indices=sources, min_only=True, return_predecessors=True)
        return distance, before.astype(np.int64)

    def way(self, before: Numbers, node: int) -> list[_Move]:
        """Return the moves to `node` along `before`."""
        found: list[_Move] = []
        code = self.start * len(self.nodes) + self.end
        while before[node] >= 0:
            move = int(np.searchsorted(code, before[node] * len(self.nodes) + node))
            found.append((int(self.moves.first[move]), int(self.moves.second[move])))
            node = int(before[node])
        return found[::-1]


def departures(separation: Separation) -> list[Demand]:
    """Return the constraints that hold from the start: silent exits of persistent locations (C1), and splits there.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.candidates import Candidate, options
    >>> from deshybrid.des.separation import separation
    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> choices = options(des, (Candidate("s_5", "5", (0,)), Candidate("s_2", "2", (1,))))
    >>> [(c.condition, sorted(c.options)) for c in departures(separation(des, choices))]
    [('C1', [0])]
    """
    des = separation.des
    leaving: dict[str, list[int]] = {name: [] for name in persistent_locations(des)}
    for number, transition in enumerate(des.transitions):
        if transition.source in leaving:
            leaving[transition.source].append(number)
    exits = {name: numbers for name, numbers in leaving.items() if numbers}
    found = [c for name, numbers in exits.items() for c in _silent_exits(separation, name, numbers)]
    found.sort(key=lambda demand: demand.runs[0][-1].transition)
    known = [demand.options for demand in found]
    for name, numbers in exits.items():
        splits = _splits(separation, name, numbers)
        found += [c for c in splits if not any(separating <= c.options for separating in known)]
    return found


def _silent_exits(separation: Separation, location: str, numbers: list[int]) -> Iterator[Demand]:
    silent = [number for number in numbers if None in separation.des.transitions[number].seen]
    if silent:
        way, cycle = _way_round(separation, location)
        for number in silent:
            separating = separation.separating(number, STAYS)
            yield Demand("C1", separating, ((*way, Shown(number, None)),), (cycle,))


def _splits(separation: Separation, location: str, numbers: list[int]) -> Iterator[Demand]:
    """Where something persistent goes two ways with the same output; equal demands are made once."""
    arcs, known = separation.des.transitions, set[frozenset[int]]()
    for place, first in enumerate(numbers):
        for second in numbers[place + 1 :]:
            common = set(arcs[first].occurrences) & set(arcs[second].occurrences)
            separating = separation.separating(first, second)
            if arcs[first].target == arcs[second].target or not common or separating in known:
                continue
            known.add(separating)
            way, cycle = _way_round(separation, location)
            runs = ((*way, step) for step in _shown(separation, (first, second)) if step is not None)
            yield Demand("C2", separating, tuple(runs), (cycle, cycle))


def _way_round(separation: Separation, location: str) -> tuple[tuple[Shown, ...], tuple[int, int]]:
    """A run to a persistent location through a cycle, and the place of the cycle in it."""
    des = separation.des
    graph = location_graph(des)
    around, after = cycle_before(graph, graph.nodes.index(location))
    before = graph.path_to(graph.arcs[around[0]][0])
    taken = [graph.arcs[arc][1] for arc in (*before, *around, *after)]
    run = tuple(Shown(number, des.transitions[number].occurrences[0]) for number in taken)
    return run, (len(before), len(before) + len(around))


def joint_cycles(separation: Separation, chosen: Mask, *, most: int = _MOST_AT_ONCE) -> list[Demand]:
    """Return a joint cycle from each of up to `most` strong components that the chosen options leave; [] for none.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.candidates import Candidate, options
    >>> from deshybrid.des.separation import separation
    >>> des = DES.from_transitions([("1", "a", "1", "α"), ("2", "b", "2", "α")])
    >>> found = separation(des, options(des, (Candidate("s_1", "1", (0,)), Candidate("s_2", "2", (1,)))))
    >>> [sorted(c.options) for c in joint_cycles(found, found.mask([]), most=1)], joint_cycles(found, found.mask([1]))
    ([[0, 1]], [])
    """
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    moves = separation.around.where(separation.open(separation.around, chosen))
    ways = _Ways.of(separation, chosen)
    moves = moves if ways is None else moves.where(ways.reach(moves.source))
    if not len(moves.source):
        return []
    graph = _Graph.of(moves)
    size = len(graph.nodes)
    links = coo_array((np.ones(len(graph.start)), (graph.start, graph.end)), shape=(size, size)).tocsr()
    component = connected_components(links, directed=True, connection="strong")[1]
    inner = np.flatnonzero(component[graph.start] == component[graph.end])
    inner = inner[np.argsort(graph.moves.weight[inner], kind="stable")]
    lightest = inner[np.sort(np.unique(component[graph.start[inner]], return_index=True)[1])][:most]
    return [_demand(separation, graph, int(move), ways) for move in lightest]


def _demand(separation: Separation, graph: _Graph, closing: int, ways: "_Ways | None") -> Demand:
    """The cheapest cycle through the move `closing`, entered where that is cheapest."""
    start, end = int(graph.start[closing]), int(graph.end[closing])
    back = [] if start == end else graph.way(graph.ways_from(np.array([end]))[1], start)
    around = [(int(graph.moves.first[closing]), int(graph.moves.second[closing])), *back]
    before: list[_Move] = []
    if ways is not None:
        place, before = ways.cheapest(_pairs_along(separation, int(graph.nodes[start]), around))
        around = around[place:] + around[:place]
    moves = [*before, *around]
    separating = frozenset[int]().union(*(separation.separating(*move) for move in moves))
    shown = [_shown(separation, move) for move in moves]
    runs = tuple(tuple(step[side] for step in shown if step[side] is not None) for side in (0, 1))
    lengths = [sum(move[side] != STAYS for move in before) for side in (0, 1)]
    cycles = tuple((length, length + len(around)) for length in lengths)
    return Demand("C2", separating, runs, cycles)  # type: ignore[arg-type]


def _pairs_along(separation: Separation, start: int, around: list[_Move]) -> list[int]:
    place = {name: number for number, name in enumerate(separation.des.locations)}
    arcs, pairs = separation.des.transitions, [start]
    for first, second in around[:-1]:
        pairs.append(place[arcs[first].target] * len(place) + place[arcs[second].target])
    return pairs


def _shown(separation: Separation, move: _Move) -> tuple[Shown | None, Shown | None]:
    """What both runs show in a move: the first output that they may have in common."""
    first, second = move
    arcs = separation.des.transitions
    if first == STAYS:
        return None, Shown(second, None)
    if second == STAYS:
        return Shown(first, None), None
    output: Output = next(shown for shown in arcs[first].occurrences if shown in arcs[second].occurrences)
    return Shown(first, output), Shown(second, output)


@dataclass(frozen=True, slots=True, eq=False)
class _Ways:
    """The cheapest ways from the initial pairs, where not every pair is initial."""

    graph: _Graph
    distance: Distances
    before: Numbers

    @classmethod
    def of(cls, separation: Separation, chosen: Mask) -> "_Ways | None":
        if separation.toward is None:
            return None
        moves = separation.toward.where(separation.open(separation.toward, chosen))
        none = np.full(len(separation.initial), STAYS, dtype=np.int64)
        loops = Moves(separation.initial, separation.initial, none, none, np.zeros_like(none))
        columns = [(getattr(moves, name), getattr(loops, name)) for name in Moves.__slots__]
        graph = _Graph.of(Moves(*(np.concatenate(column) for column in columns)))
        distance, before = graph.ways_from(np.searchsorted(graph.nodes, separation.initial))
        return cls(graph, distance, before)

    def reach(self, pairs: Numbers) -> Mask:
        """Return which pairs can be reached."""
        place = np.minimum(np.searchsorted(self.graph.nodes, pairs), len(self.graph.nodes) - 1)
        found: Mask = (self.graph.nodes[place] == pairs) & np.isfinite(self.distance[place])
        return found

    def cheapest(self, pairs: list[int]) -> tuple[int, list[_Move]]:
        """Return which of the pairs is reached most cheaply, and how."""
        places = np.searchsorted(self.graph.nodes, np.array(pairs, dtype=np.int64))
        best = int(np.argmin(self.distance[places]))
        return best, self.graph.way(self.before, int(places[best]))


def minimal(separation: Separation, demand: Demand) -> Demand:
    """Return a joint cycle that no smaller set of options separates: all options outside of the set are taken.

    What it is made from must be a joint cycle that a choice with every departure met has left.
    """
    kept = demand
    for option in sorted(demand.options):
        if option in kept.options:
            allowed = ~separation.mask(kept.options - {option})
            kept = next(iter(joint_cycles(separation, allowed, most=1)), kept)
    return kept


__all__ = ["departures", "joint_cycles", "minimal"]
