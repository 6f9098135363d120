"""Persistent locations, and locations where a run ends.

In: a `DES`.  Out: names of locations, in order of declaration.  Both concern what is reachable from the initial set.
Cost: linear in locations plus transitions.  Source: Balluchi et al. (2012), section 3.1.
"""

from collections.abc import Iterator

from deshybrid.des.automaton import DES
from deshybrid.des.cycles import persistent_nodes
from deshybrid.des.worklist import Graph, explore
from deshybrid.diagnostics import ModelError, diagnostic


def location_graph(des: DES) -> Graph[str, int]:
    """Return the locations reachable from the initial set; arcs carry the numbers of the transitions.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "2", None)], initial=["2"])
    >>> location_graph(des).nodes
    ('2',)
    """
    leaving: dict[str, list[tuple[int, str]]] = {location: [] for location in des.locations}
    for number, transition in enumerate(des.transitions):
        leaving[transition.source].append((number, transition.target))

    def successors(location: str) -> Iterator[tuple[int, str]]:
        yield from leaving[location]

    return explore(des.initial, successors)


def persistent_locations(des: DES) -> tuple[str, ...]:
    """Return the locations that can be visited after arbitrarily many events: reachable from a reachable cycle.

    A self-loop is a cycle, and a location between two cycles is persistent although it may be visited only once.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "2", None), ("2", "c", "3", "γ")])
    >>> persistent_locations(des)
    ('2', '3')
    """
    graph = location_graph(des)
    persistent = {graph.nodes[node] for node in persistent_nodes(graph)}
    return tuple(location for location in des.locations if location in persistent)


def blocked_locations(des: DES) -> tuple[str, ...]:
    """Return the reachable locations that no transition leaves; a living system has none.

    >>> blocked_locations(DES.from_transitions([("1", "a", "2", "α")]))
    ('2',)
    """
    left = {transition.source for transition in des.transitions}
    reachable = set(location_graph(des).nodes)
    return tuple(location for location in des.locations if location in reachable and location not in left)


def require_living(des: DES) -> None:
    """Raise `ModelError` (DH0405) where a reachable location has no exit.

    >>> require_living(DES.from_transitions([("1", "a", "1", "α")]))
    """
    blocked = blocked_locations(des)
    if blocked:
        raise ModelError(
            *(
                diagnostic(
                    "DH0405",
                    f"location `{location}` has no exit transition",
                    des.location_spans.get(location),
                    "a run that comes here ends",
                    helps=("add a transition that leaves it, a self-loop for example",),
                )
                for location in blocked
            )
        )


__all__ = ["blocked_locations", "location_graph", "persistent_locations", "require_living"]
