"""The one search engine of the constructions over automata: roots and a successor function become a numbered graph.

In: any hashable nodes (location numbers, bit masks of an observer, pairs of locations) and what follows each of them.
Out: a `Graph` whose nodes are numbered in the order in which a breadth-first search finds them, so that equal input
gives equal numbers; every node remembers the arc that found it first, so that shortest runs can be read off.

Idea: a worklist.  Cost: one call of `successors` per node, linear in nodes plus arcs.
"""

import sys
from collections.abc import Callable, Hashable, Iterable
from dataclasses import dataclass
from typing import Generic, TypeVar

from deshybrid.diagnostics import Diagnostic, LimitReached, check_limits, check_stated_limits, diagnostic

Node = TypeVar("Node", bound=Hashable)
Label = TypeVar("Label")

_PATIENCE = 128  # nodes between two looks at the clock and at the memory


@dataclass(frozen=True, slots=True)
class Graph(Generic[Node, Label]):
    """A graph found by `explore`.

    `nodes[i]` is node number i; `arcs` are (source number, label, target number), grouped by source;
    `found_by[i]` is the number of the arc that found node i first, -1 for a root.
    """

    nodes: tuple[Node, ...]
    arcs: tuple[tuple[int, Label, int], ...]
    found_by: tuple[int, ...]

    def path_to(self, number: int) -> list[int]:
        """Return the arcs of a shortest path from a root to node `number`.

        >>> graph = explore([0], lambda n: [("next", n + 1)] if n < 3 else [])
        >>> graph.path_to(2)
        [0, 1]
        """
        path = []
        while (arc := self.found_by[number]) >= 0:
            path.append(arc)
            number = self.arcs[arc][0]
        return path[::-1]

    def outgoing(self) -> list[list[int]]:
        """Return, for each node, the numbers of the arcs that leave it."""
        leaving: list[list[int]] = [[] for _ in self.nodes]
        for number, (source, _, _) in enumerate(self.arcs):
            leaving[source].append(number)
        return leaving

    def incoming(self) -> list[list[int]]:
        """Return, for each node, the numbers of the arcs that enter it."""
        entering: list[list[int]] = [[] for _ in self.nodes]
        for number, (_, _, target) in enumerate(self.arcs):
            entering[target].append(number)
        return entering


def explore(
    roots: Iterable[Node],
    successors: Callable[[Node], Iterable[tuple[Label, Node]]],
    *,
    limit: int | None = None,
    what: str = "states",
) -> Graph[Node, Label]:
    """Return the graph of all nodes that can be reached from `roots`.

    Raises `LimitReached` (DH0901) as soon as more than `limit` nodes are found; `what` names them in the message; and
    `OutOfResources` beyond the limits of `within`.

    >>> graph = explore([1], lambda n: [("double", 2 * n % 7)])
    >>> graph.nodes, graph.arcs
    ((1, 2, 4), ((0, 'double', 1), (1, 'double', 2), (2, 'double', 0)))
    """
    return explore_while_few(roots, successors, limit=limit, what=what)[0]


def explore_while_few(
    roots: Iterable[Node],
    successors: Callable[[Node], Iterable[tuple[Label, Node]]],
    *,
    waiting: int | None = None,
    limit: int | None = None,
    what: str = "states",
) -> tuple[Graph[Node, Label], int]:
    """Return the graph that `explore` returns, or its first part: up to where more than `waiting` nodes have no arcs.

    The number with it says how many nodes have their arcs.

    >>> explore_while_few([1], lambda n: [("one", 2 * n), ("two", 2 * n + 1)], waiting=2)[1]
    2
    """
    number: dict[Node, int] = {}
    for root in roots:
        number.setdefault(root, len(number))
    nodes, arcs = list(number), list[tuple[int, Label, int]]()
    found_by = [-1] * len(nodes)
    source, most = -1, sys.maxsize if waiting is None else waiting + 1
    for source, node in enumerate(nodes):  # the list grows while it is read: it is the worklist
        for label, successor in successors(node):
            target = number.setdefault(successor, len(nodes))
            if target == len(nodes):
                nodes.append(successor)
                found_by.append(len(arcs))
            arcs.append((source, label, target))
        if not source % _PATIENCE:
            (check_limits if source else check_stated_limits)()
        if limit is not None and len(nodes) > limit:
            raise LimitReached(too_many(len(nodes), len(nodes) - source - 1, limit, what))
        if len(nodes) - source > most:
            break
    return Graph(tuple(nodes), tuple(arcs), tuple(found_by)), source + 1


def too_many(found: int, waiting: int, limit: int, what: str) -> Diagnostic:
    """Return what is said where more than `limit` nodes are found, `waiting` of them without their arcs.

    >>> too_many(12, 3, 10, "states").message
    'there are more than 10 states'
    """
    facts = f"{found} {what} were found when the search stopped, {waiting} of them not yet expanded"
    return diagnostic("DH0901", f"there are more than {limit} {what}", notes=(facts,), helps=("raise the limit",))


__all__ = ["Graph", "explore", "explore_while_few", "too_many"]
