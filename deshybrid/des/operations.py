"""Operations from one system to another: the part that matters, the reverse, other things seen.

In: a `DES`, and names of its locations or events.  Out: a `DES`; order of declaration is kept.
Idea: reachability by the worklist, everything else arc by arc.  Cost: linear in locations plus transitions.
Source: Cassandras and Lafortune (2021): Ac, CoAc, Trim, projection.
"""

from collections.abc import Collection, Iterable
from dataclasses import replace

from deshybrid.des.automaton import DES
from deshybrid.des.persistence import location_graph
from deshybrid.des.runs import known_events, known_locations


def accessible(des: DES) -> DES:
    """Return the part that runs can visit: locations reachable from the initial set, and transitions between them.

    Linear.  Source: Cassandras and Lafortune (2021).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("3", "a", "1", "α")], initial=["1"])
    >>> accessible(des).locations
    ('1', '2')
    """
    return _part(des, set(location_graph(des).nodes))


def coaccessible(des: DES, *, marked: Iterable[str]) -> DES:
    """Return the part from which a `marked` location can be reached; it may be empty.

    Linear.  Where some, but no initial location is left, all that are left count as initial, as in every `DES`.
    Raises `UsageError` (DH0404).  Source: Cassandras and Lafortune (2021).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("1", "a", "3", "α")], initial=["1"])
    >>> coaccessible(des, marked=["3"]).locations
    ('1', '3')
    """
    goals = known_locations(des, marked, "marked")
    return _part(des, set(location_graph(reverse(des, initial=goals)).nodes) if goals else set())


def trim(des: DES, *, marked: Iterable[str]) -> DES:
    """Return the part that lies on runs from an initial to a `marked` location: accessible and coaccessible.

    Linear.  Raises `UsageError` (DH0404).  Source: Cassandras and Lafortune (2021).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("1", "a", "3", "α"), ("4", "b", "3", "β")], initial=["1"])
    >>> trim(des, marked=["3"]).locations
    ('1', '3')
    """
    goals = known_locations(des, marked, "marked")
    reached = accessible(des)
    return coaccessible(reached, marked=[name for name in goals if name in reached.locations])


def reverse(des: DES, *, initial: Iterable[str] = ()) -> DES:
    """Return the system with every transition turned round; it starts in `initial` (all locations where not given).

    Linear.  Transition number i stays number i.  Raises `UsageError` (DH0404).

    >>> str(reverse(DES.from_transitions([("1", "a", "2", "α")])).transitions[0])
    '2 -a/α-> 1'
    """
    starts = known_locations(des, initial, "initial")
    arcs = tuple(replace(t, source=t.target, target=t.source) for t in des.transitions)
    return replace(des, transitions=arcs, initial=starts or des.locations)


def hide(des: DES, events: Iterable[str]) -> DES:
    """Return the system in which transitions with these events show nothing: their outputs become ε.

    Linear.  Raises `UsageError` (DH0420) on an event that no transition has.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> [str(arc) for arc in hide(des, ["a"]).transitions]
    ['1 -a/ε-> 2', '2 -b/β-> 1']
    """
    hidden = set(known_events(des, events, "events"))
    arcs = tuple(replace(t, outputs=(None,), signature=None) if t.event in hidden else t for t in des.transitions)
    return replace(des, transitions=arcs)


def project(des: DES, events: Iterable[str]) -> DES:
    """Return the natural projection onto `events`: each of them is seen by its own name, all others show nothing.

    Linear; `determinise` then removes what is silent.  Raises `UsageError` (DH0420) on an event that no transition has.
    Source: Cassandras and Lafortune (2021).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> [str(arc) for arc in project(des, ["b"]).transitions]
    ['1 -a/ε-> 2', '2 -b/b-> 1']
    """
    seen = set(known_events(des, events, "events"))
    arcs = tuple(replace(t, outputs=(t.event if t.event in seen else None,), signature=None) for t in des.transitions)
    return replace(des, transitions=arcs)


def _part(des: DES, kept: Collection[str]) -> DES:
    arcs = tuple(t for t in des.transitions if t.source in kept and t.target in kept)
    locations, initial = (tuple(name for name in names if name in kept) for names in (des.locations, des.initial))
    return replace(des, locations=locations, transitions=arcs, initial=initial)


__all__ = ["accessible", "coaccessible", "hide", "project", "reverse", "trim"]
