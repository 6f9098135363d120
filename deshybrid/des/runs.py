"""Runs of a system and the questions that name parts of it: what can be shown, where a run leads, which names exist.

In: a `DES`.  Out: its moves by location, runs as steps, and a shortest run that shows given outputs.
Cost: linear in locations plus transitions, times the number of outputs for a run that shows them.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import NamedTuple, Protocol

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.search import find_first, labels_to
from deshybrid.des.witness import Step
from deshybrid.diagnostics import UsageError, diagnostic


class Move(NamedTuple):
    """One way to take a transition: its number in the system, what is seen (None = nothing), where it leads."""

    transition: int
    seen: Output | None
    target: str


class Plant(NamedTuple):
    """A system as a search sees it: `transitions` may grow while `ways` asks for the moves out of more locations."""

    initial: Iterable[str]
    transitions: Sequence[Transition]
    ways: Callable[[str], Sequence[Move]]


class HasEvents(Protocol):
    """What events are named of: a `DES` or a `Composition`."""

    @property
    def events(self) -> tuple[str, ...]:
        """The events, in the order of first appearance."""


class HasTransitions(Protocol):
    """What runs are read off: a `DES` or a `Plant`."""

    @property
    def transitions(self) -> Sequence[Transition]:
        """Transition number i is the one at place i."""


def moves_from(des: DES) -> dict[str, list[Move]]:
    """Return the moves out of each location, by declaration; a transition with several outputs is several moves.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("1", "a", "2", None)])
    >>> [move.seen for move in moves_from(des)["1"]]
    [Output(gamma='α', signature=None, command=None), None]
    """
    moves: dict[str, list[Move]] = {location: [] for location in des.locations}
    for number, transition in enumerate(des.transitions):
        moves[transition.source] += (Move(number, seen, transition.target) for seen in dict.fromkeys(transition.seen))
    return moves


def run_along(des: HasTransitions, start: str, transitions: Iterable[int]) -> tuple[Step, ...]:
    """Return the run from `start` that takes the transitions of these numbers.

    >>> run_along(DES.from_transitions([("1", "a", "2", "α")]), "1", [0])
    (Step(event='', location='1'), Step(event='a', location='2'))
    """
    taken = (des.transitions[number] for number in transitions)
    return (Step("", start), *(Step(transition.event, transition.target) for transition in taken))


def shortest_run(
    des: DES, outputs: Iterable[Output | str], *, start: Iterable[str] | None = None, end: Iterable[str] | None = None
) -> tuple[Step, ...] | None:
    """Return a shortest run from `start` (the initial set) that shows exactly `outputs` and ends in `end` (anywhere).

    None where there is none.  An output may be given as text, as `str(Output)` writes it.  Raises `UsageError`
    (DH0404) on a location that the system does not have.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "3", None)], initial=["1"])
    >>> [step.location for step in shortest_run(des, ["α"], end=["3"])]
    ['1', '2', '3']
    """
    word = [str(output) for output in outputs]
    starts = des.initial if start is None else known_locations(des, start, "start")
    ends = set(des.locations if end is None else known_locations(des, end, "end"))
    moves = moves_from(des)

    def onwards(node: tuple[str, int]) -> Iterator[tuple[int, tuple[str, int]]]:
        location, shown = node
        for number, seen, target in moves[location]:
            if seen is None:
                yield number, (target, shown)
            elif shown < len(word) and str(seen) == word[shown]:
                yield number, (target, shown + 1)

    roots = ((location, 0) for location in starts)
    graph, goal = find_first(roots, onwards, lambda node: node[1] == len(word) and node[0] in ends)
    if goal is None:
        return None
    path = labels_to(graph, goal)
    return run_along(des, des.transitions[path[0]].source if path else graph.nodes[goal][0], path)


def known_locations(des: DES, names: Iterable[str], what: str) -> tuple[str, ...]:
    """Return `names`; raises `UsageError` (DH0404) where the system has no such location; `what` is the argument.

    >>> known_locations(DES.from_transitions([("1", "a", "2", "α")]), ["2"], "marked")
    ('2',)
    """
    return _known(names, des.locations, "DH0404", "location", what)


def known_events(system: HasEvents, names: Iterable[str], what: str) -> tuple[str, ...]:
    """Return `names`; raises `UsageError` (DH0420) where no transition has such an event; `what` is the argument.

    >>> known_events(DES.from_transitions([("1", "a", "2", "α")]), ["a"], "faults")
    ('a',)
    """
    return _known(names, system.events, "DH0420", "event", what)


def _known(names: Iterable[str], existing: Iterable[str], code: str, kind: str, what: str) -> tuple[str, ...]:
    if isinstance(names, str):  # one name in place of several: not its letters
        names = (names,)
    given, known = tuple(names), set(existing)
    unknown = [name for name in given if name not in known]
    if unknown:
        raise UsageError(*(diagnostic(code, f"unknown {kind} `{name}` in `{what}`") for name in unknown))
    return given


__all__ = [
    "HasEvents",
    "HasTransitions",
    "Move",
    "Plant",
    "known_events",
    "known_locations",
    "moves_from",
    "run_along",
    "shortest_run",
]
