"""Searches that stop early: for questions whose graph is too large to build, or need not be built.

In: roots, a successor function, and what to look for.  Out: the part of the graph that was looked at, with the find.
Idea: the worklist of `explore`, which is given no more successors once the goal is found, or once a share is expanded.
Cost: linear in the nodes and arcs that are nearer than the goal.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import TypeVar

from deshybrid.des.worklist import Graph, explore

Node = TypeVar("Node", bound=Hashable)
Label = TypeVar("Label")
Found = TypeVar("Found")

_FIRST_SHARE, _GROWTH = 1000, 4


def find_first(
    roots: Iterable[Node],
    successors: Callable[[Node], Iterable[tuple[Label, Node]]],
    accept: Callable[[Node], bool],
    *,
    limit: int | None = None,
    what: str = "states",
) -> tuple[Graph[Node, Label], int | None]:
    """Return the graph that was searched and the number of a nearest node that `accept` takes, None: there is none.

    Raises `LimitReached` (DH0901) as soon as more than `limit` nodes are found before the goal.

    >>> graph, goal = find_first([1], lambda n: [("double", 2 * n), ("add", n + 3)], lambda n: n == 11)
    >>> [graph.arcs[arc][1] for arc in graph.path_to(goal)]
    ['add', 'double', 'add']
    >>> find_first([1], lambda n: [("double", 2 * n % 7)], lambda n: n == 3)[1] is None
    True
    """
    starts = list(roots)
    found = [root for root in starts if accept(root)][:1]

    def until_found(node: Node) -> Iterator[tuple[Label, Node]]:
        if found:
            return
        for label, successor in successors(node):
            yield label, successor
            if accept(successor):
                found.append(successor)
                return

    graph = explore(starts, until_found, limit=limit, what=what)
    return graph, graph.nodes.index(found[0]) if found else None


def explore_until(
    roots: Iterable[Node],
    successors: Callable[[Node], Iterable[tuple[Label, Node]]],
    seek: Callable[[Graph[Node, Label]], Found | None],
    *,
    limit: int | None = None,
    what: str = "states",
) -> tuple[Graph[Node, Label], Found] | None:
    """Return the first part of the graph in which `seek` finds something, and that; None where the whole has nothing.

    `seek` is asked about growing parts, four times as many nodes expanded each time, so that all of them together cost
    little more than the last one.  What it finds in a part must be there in the whole too, as a run or a cycle is.
    Raises `LimitReached` (DH0901) as soon as more than `limit` nodes are found and nothing is.

    >>> graph, node = explore_until([1], lambda n: [("add", n + 1)], lambda g: 70 if 71 in g.nodes else None)
    >>> len(graph.nodes), graph.nodes[node]
    (1001, 71)
    """
    starts, share = list(roots), _FIRST_SHARE
    while True:
        graph, complete = _part(starts, successors, share, limit, what)
        found = seek(graph)
        if found is not None:
            return graph, found
        if complete:
            return None
        share *= _GROWTH


def _part(
    starts: list[Node],
    successors: Callable[[Node], Iterable[tuple[Label, Node]]],
    share: int,
    limit: int | None,
    what: str,
) -> tuple[Graph[Node, Label], bool]:
    """The graph in which only the first `share` nodes are expanded, and whether it is the whole."""
    expanded = 0

    def a_share(node: Node) -> Iterable[tuple[Label, Node]]:
        nonlocal expanded
        expanded += 1
        return successors(node) if expanded <= share else ()

    graph = explore(starts, a_share, limit=limit, what=what)
    return graph, expanded <= share


def labels_to(graph: Graph[Node, Label], number: int) -> tuple[Label, ...]:
    """Return the labels along a shortest path from a root to node `number`.

    >>> graph, goal = find_first([1], lambda n: [("double", 2 * n)], lambda n: n == 8)
    >>> labels_to(graph, goal)
    ('double', 'double', 'double')
    """
    return tuple(graph.arcs[arc][1] for arc in graph.path_to(number))


__all__ = ["explore_until", "find_first", "labels_to"]
