"""Lassos: a way to a cycle, the cycle, and a way on from it; what proves that something can happen for ever.

In: a `Graph`, which arcs a cycle may use and which one of them it must use, and where to go from there.
Out: a `Lasso` of arc numbers, or None.  Idea: such a cycle lies within a strong component of the permitted arcs.
Cost: linear in nodes plus arcs.  Source: Tarjan (1972) for the components.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

from deshybrid.des.cycles import shortest_walk, strong_components
from deshybrid.des.search import find_first, labels_to
from deshybrid.des.worklist import Graph


class Lasso(NamedTuple):
    """Arc numbers: from a root to the cycle, once round, and from the cycle's start to the goal."""

    before: tuple[int, ...]
    around: tuple[int, ...]
    after: tuple[int, ...]


def anywhere(_: int) -> bool:
    """Accept every node or arc.

    >>> anywhere(0)
    True
    """
    return True


def find_lasso(
    graph: Graph[Any, Any],
    *,
    within: Callable[[int], bool] = anywhere,
    through: Callable[[int], bool] = anywhere,
    goal: Callable[[int], bool] = anywhere,
) -> Lasso | None:
    """Return a lasso whose cycle visits only nodes `within`, uses an arc `through`, and leads on to a node `goal`.

    The ways to and from the cycle may use every node.  None where there is none.

    >>> from deshybrid.des.worklist import explore
    >>> graph = explore([0], lambda n: {0: [("in", 1)], 1: [("on", 2), ("out", 3)], 2: [("back", 1)], 3: []}[n])
    >>> [[graph.arcs[arc][1] for arc in part] for part in find_lasso(graph, goal=lambda node: graph.nodes[node] == 3)]
    [['in'], ['on', 'back'], ['out']]
    """
    numbers = [number for number, (source, _, target) in enumerate(graph.arcs) if within(source) and within(target)]
    inner = replace(graph, arcs=tuple(graph.arcs[number] for number in numbers))
    component, turns = _turns(inner, [through(number) for number in numbers])
    starts = [node for node in range(len(graph.nodes)) if component[node] in turns]
    outgoing = graph.outgoing()
    ways, end = find_first(starts, lambda node: ((arc, graph.arcs[arc][2]) for arc in outgoing[node]), goal)
    if end is None:
        return None
    after = labels_to(ways, end)
    start = graph.arcs[after[0]][0] if after else ways.nodes[end]
    around = tuple(numbers[arc] for arc in _round(inner, start, turns[component[start]]))
    return Lasso(tuple(graph.path_to(start)), around, after)


def _turns(inner: Graph[Any, Any], usable: list[bool]) -> tuple[list[int], dict[int, int]]:
    """The strong component of each node, and for each component with a usable arc inside it the first such arc."""
    component = [0] * len(inner.nodes)
    for number, nodes in enumerate(strong_components(inner)):
        for node in nodes:
            component[node] = number
    turns: dict[int, int] = {}
    for number, (source, _, target) in enumerate(inner.arcs):
        if usable[number] and component[source] == component[target]:
            turns.setdefault(component[source], number)
    return component, turns


def _round(inner: Graph[Any, Any], start: int, turn: int) -> list[int]:
    """A way from `start` to the arc `turn`, that arc, and a way back; all within one component."""
    source, _, target = inner.arcs[turn]
    there = shortest_walk(inner, start, lambda node: node == source) or []
    back = shortest_walk(inner, target, lambda node: node == start) or []
    return [*there, turn, *back]


__all__ = ["Lasso", "anywhere", "find_lasso"]
