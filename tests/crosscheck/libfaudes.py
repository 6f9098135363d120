"""Between this toolkit and libFAUDES: systems whose events are seen by their names go there, generators come back.

In and out: a `DES` with marked locations as a `faudes.Generator`, a deterministic generator as its moves.
Names are left out of every comparison: two deterministic automata are the same where a walk from the initial state,
event by event in the order of their names, meets the same moves and the same marks.
"""

from collections.abc import Iterable
from typing import Any

import faudes

from deshybrid.des.automaton import DES

Moves = dict[Any, dict[str, Any]]
Walk = tuple[tuple[tuple[int, str, int], ...], tuple[int, ...]]


def generator(des: DES, marked: Iterable[str], *, events: Iterable[str] = (), kind: type = faudes.Generator) -> Any:
    """The system there, with the alphabet of its transitions and `events`."""
    made = kind()
    for event in sorted({t.event for t in des.transitions} | set(events)):
        made.InsEvent(event)
    for location in des.locations:
        made.InsState(location)
    for location in des.initial:
        made.SetInitState(location)
    for location in marked:
        made.SetMarkedState(location)
    for t in des.transitions:
        made.SetTransition(t.source, t.event, t.target)
    return made


def event_set(events: Iterable[str]) -> Any:
    made = faudes.EventSet()
    for event in events:
        made.Insert(event)
    return made


def walk_of(made: Any) -> Walk:
    """The walk through a deterministic generator."""
    table: Moves = {}
    for arc in made.TransRel():
        table.setdefault(arc.X1, {})[made.EventName(arc.Ev)] = arc.X2
    return walk(table, list(made.InitStates()), set(made.MarkedStates()))


def walk(table: Moves, initial: list[Any], accepting: set[Any]) -> Walk:
    """Number the states as the walk meets them; return the moves between numbers and the accepting numbers."""
    (root,) = initial
    number, moves = {root: 0}, []
    for state in (order := [root]):
        for event, target in sorted(table.get(state, {}).items()):
            if target not in number:
                number[target] = len(number)
                order.append(target)
            moves.append((number[state], event, number[target]))
    return tuple(moves), tuple(number[state] for state in order if state in accepting)
