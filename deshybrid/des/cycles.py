"""Cycles in a graph: what may be visited after arbitrarily many steps, and a run that shows it.

In: a `Graph`.  Out: the nodes reachable from a cycle (persistent ones), a topological order of the others, the longest
path to one of those, and, for a persistent node, a shortest way from a nearby cycle to it.

Idea: a node is reachable from a cycle exactly where repeated removal of nodes without predecessor leaves it over.
All functions are linear in nodes plus arcs.  Source: Balluchi et al. (2012), section 3.1 (persistent states).
"""

from collections import deque
from collections.abc import Callable, Collection
from typing import TYPE_CHECKING, Any

from deshybrid.des.worklist import Graph

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from scipy.sparse import csr_array


def transient_order(graph: Graph[Any, Any]) -> list[int]:
    """Return the nodes that no cycle leads to, every node after its predecessors; a self-loop is a cycle.

    >>> from deshybrid.des.worklist import explore
    >>> transient_order(explore([0], lambda n: [("step", min(n + 1, 2))]))
    [0, 1]
    """
    waiting_for = [0] * len(graph.nodes)
    for _, _, target in graph.arcs:
        waiting_for[target] += 1
    outgoing = graph.outgoing()
    order = [node for node, count in enumerate(waiting_for) if count == 0]
    for node in order:  # grows while it is read
        for arc in outgoing[node]:
            target = graph.arcs[arc][2]
            waiting_for[target] -= 1
            if waiting_for[target] == 0:
                order.append(target)
    return order


def persistent_nodes(graph: Graph[Any, Any]) -> list[int]:
    """Return the numbers, ascending, of the nodes that are reachable from a cycle.

    >>> from deshybrid.des.worklist import explore
    >>> persistent_nodes(explore([0], lambda n: [("step", min(n + 1, 2))]))
    [2]
    """
    transient = set(transient_order(graph))
    return [node for node in range(len(graph.nodes)) if node not in transient]


def persistent_among(nodes: int, source: "NDArray[Any]", target: "NDArray[Any]") -> list[int]:
    """Return what `persistent_nodes` returns, for arcs in arrays: arc i goes from `source[i]` to `target[i]`.

    Source: strong components by scipy (Pearce, 2005).

    >>> import numpy as np
    >>> persistent_among(3, np.array([0, 1, 2]), np.array([1, 2, 2]))
    [2]
    """
    import numpy as np
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import breadth_first_order, connected_components

    def graph(tail: "NDArray[Any]", head: "NDArray[Any]") -> "csr_array[Any]":
        return csr_array((np.ones(len(tail)), (tail, head)), shape=(nodes + 1, nodes + 1))

    component = connected_components(graph(source, target), directed=True, connection="strong")[1]
    cyclic = np.bincount(component)[component] > 1
    cyclic[source[source == target]] = True
    entry = np.flatnonzero(cyclic)  # one more node, number `nodes`, goes to every node on a cycle
    tail, head = np.append(source, np.full(len(entry), nodes)), np.append(target, entry)
    found = breadth_first_order(graph(tail, head), nodes, return_predecessors=False)
    return [int(node) for node in np.sort(found)[:-1]]


def longest_path_to(graph: Graph[Any, Any], goals: Collection[int]) -> int | None:
    """Return the most steps that a path to one of the transient nodes `goals` can have; None where there is no goal.

    >>> from deshybrid.des.worklist import explore
    >>> longest_path_to(explore([0], lambda n: [("step", min(n + 1, 2)), ("jump", 2)]), [1])
    1
    """
    depth = [0] * len(graph.nodes)
    outgoing = graph.outgoing()
    for node in transient_order(graph):
        for arc in outgoing[node]:
            target = graph.arcs[arc][2]
            depth[target] = max(depth[target], depth[node] + 1)
    return max((depth[goal] for goal in goals), default=None)


def cycle_before(graph: Graph[Any, Any], target: int) -> tuple[list[int], list[int]]:
    """Return the arcs of a shortest cycle near the persistent node `target`, and of a shortest way from it to `target`.

    >>> from deshybrid.des.worklist import explore
    >>> cycle_before(explore([0], lambda n: [("step", 1 - n), ("out", 2)] if n < 2 else []), 2)
    ([0, 2], [1])
    """
    cyclic = nodes_on_cycles(graph)
    tail = shortest_walk(graph, target, cyclic.__getitem__, backward=True)
    if tail is None:
        raise ValueError(f"no cycle leads to node {target}")
    entry = graph.arcs[tail[0]][0] if tail else target
    cycle = shortest_walk(graph, entry, lambda node: node == entry, at_least_one=True)
    return cycle or [], tail


def shortest_walk(
    graph: Graph[Any, Any],
    start: int,
    accept: Callable[[int], bool],
    *,
    backward: bool = False,
    at_least_one: bool = False,
) -> list[int] | None:
    """Return the arcs, in their own direction, of a shortest walk from `start` to a node that `accept` takes.

    `backward` searches against the arcs (the walk then ends in `start`); `at_least_one` refuses the empty walk.
    None where there is no such walk.
    """
    if not at_least_one and accept(start):
        return []
    beyond = graph.incoming() if backward else graph.outgoing()
    came_by: dict[int, int] = {}
    queue = deque([start])
    while queue:
        for arc in beyond[queue.popleft()]:
            node = graph.arcs[arc][0 if backward else 2]
            if node in came_by:
                continue
            came_by[node] = arc
            if accept(node):
                return _walk_back(graph, came_by, start, node, backward)
            queue.append(node)
    return None


def _walk_back(graph: Graph[Any, Any], came_by: dict[int, int], start: int, node: int, backward: bool) -> list[int]:
    walk = [came_by[node]]
    while (node := graph.arcs[walk[-1]][2 if backward else 0]) != start:
        walk.append(came_by[node])
    return walk if backward else walk[::-1]


def nodes_on_cycles(graph: Graph[Any, Any]) -> list[bool]:
    """Return, for each node, whether it lies on a cycle (Tarjan's strong components, without recursion).

    >>> from deshybrid.des.worklist import explore
    >>> nodes_on_cycles(explore([0], lambda n: [("step", min(n + 1, 2))]))
    [False, False, True]
    """
    cyclic = [False] * len(graph.nodes)
    for source, _, target in graph.arcs:
        cyclic[source] = cyclic[source] or source == target
    for component in strong_components(graph):
        if len(component) > 1:
            for node in component:
                cyclic[node] = True
    return cyclic


def strong_components(graph: Graph[Any, Any]) -> list[list[int]]:
    """Return the strongly connected components, successors first, nodes of one component ascending.

    Source: Tarjan (1972), with an explicit stack.
    """
    outgoing = [[graph.arcs[arc][2] for arc in arcs] for arcs in graph.outgoing()]
    lowest = [-1] * len(outgoing)
    placed = [False] * len(outgoing)
    components: list[list[int]] = []
    stack: list[int] = []
    clock = 0
    for root in range(len(outgoing)):
        calls = [(root, 0, clock)] if lowest[root] < 0 else []
        while calls:
            node, position, entered = calls.pop()
            if position == 0:
                lowest[node], clock = entered, clock + 1
                stack.append(node)
            else:
                lowest[node] = min(lowest[node], lowest[outgoing[node][position - 1]])
            while position < len(outgoing[node]):
                successor = outgoing[node][position]
                position += 1
                if lowest[successor] < 0:
                    calls += [(node, position, entered), (successor, 0, clock)]
                    break
                if not placed[successor]:
                    lowest[node] = min(lowest[node], lowest[successor])
            else:
                if lowest[node] == entered:
                    components.append(_unstack(stack, node, placed))
    return components


def _unstack(stack: list[int], root: int, placed: list[bool]) -> list[int]:
    component = []
    while not placed[root]:
        component.append(stack.pop())
        placed[component[-1]] = True
    return sorted(component)


__all__ = [
    "cycle_before",
    "longest_path_to",
    "nodes_on_cycles",
    "persistent_among",
    "persistent_nodes",
    "shortest_walk",
    "strong_components",
    "transient_order",
]
