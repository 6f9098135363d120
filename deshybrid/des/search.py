"""A search that stops at the first goal: for questions whose graph is too large to build, or need not be built.

In: roots, a successor function, and what to look for.  Out: the part of the graph that was looked at, and the goal.
Idea: the worklist of `explore`, which is given no more successors once the goal is found.
Cost: linear in the nodes and arcs that are nearer than the goal.
"""

from collections.abc import Callable, Hashable, Iterable, Iterator
from typing import TypeVar

from deshybrid.des.worklist import Graph, explore

Node = TypeVar("Node", bound=Hashable)
Label = TypeVar("Label")


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


def labels_to(graph: Graph[Node, Label], number: int) -> tuple[Label, ...]:
    """Return the labels along a shortest path from a root to node `number`.

    >>> graph, goal = find_first([1], lambda n: [("double", 2 * n)], lambda n: n == 8)
    >>> labels_to(graph, goal)
    ('double', 'double', 'double')
    """
    return tuple(graph.arcs[arc][1] for arc in graph.path_to(number))


__all__ = ["find_first", "labels_to"]
