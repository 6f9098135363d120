"""Systems that run together: parallel composition and product, explored state by state and never built.

A state of a `Composition` is a tuple with one location of each component.  A component takes part in an event exactly
where one of its transitions has that event.  In the parallel composition an event happens in all the components that
have it, at once, and the others stay; in the product only events that all components have can happen.  What is seen
when several transitions are taken at once: the outputs of those that show something, each once, in the order of the
components, joined by `+`.

In: components.  Out: successors of a state, a shortest run to a state that is looked for, or the whole as a `DES`.
Cost: linear in the states and joint transitions that are looked at; there are up to ∏|Q_i| states.
Source: Cassandras and Lafortune (2021).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import islice
from itertools import product as combinations
from typing import NamedTuple, TypeAlias, TypeVar

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.runs import Move, Plant, moves_from
from deshybrid.des.search import find_first
from deshybrid.des.worklist import explore
from deshybrid.diagnostics import UsageError, diagnostic

State: TypeAlias = tuple[str, ...]
Start = TypeVar("Start")
Exits: TypeAlias = dict[str, dict[str, list[Transition]]]


class JointTransition(NamedTuple):
    """Transitions of several components that happen at once: `parts[i]` is that of component i, None where it stays."""

    event: str
    parts: tuple[Transition | None, ...]

    @property
    def outputs(self) -> tuple[str | None, ...]:
        """What may be shown together: one output of each part, joined; `None` where no part shows any."""
        choices = combinations(*(part.outputs for part in self.parts if part is not None))
        return tuple(dict.fromkeys(_joined(choice) for choice in choices))

    @property
    def signature(self) -> str | None:
        """The signatures of the parts, joined; None where no part has one."""
        return _joined(tuple(part.signature for part in self.parts if part is not None))

    def after(self, state: State) -> State:
        """Return the state that this leads to from `state`."""
        return tuple(here if part is None else part.target for here, part in zip(state, self.parts, strict=True))


class JointRun(NamedTuple):
    """A run of a composition: the state it starts in, then each joint transition with the state after it."""

    start: State
    steps: tuple[tuple[JointTransition, State], ...]

    @property
    def end(self) -> State:
        """The last state."""
        return self.steps[-1][1] if self.steps else self.start

    def __str__(self) -> str:
        return ".".join(self.start) + "".join(f" -{joint.event}-> {'.'.join(state)}" for joint, state in self.steps)


@dataclass(frozen=True, slots=True)
class Composition:
    """Components that run together; `only_common` makes it the product, in which all take part in every event.

    Raises `UsageError` (DH0424) where a transition depends on a command.

    >>> switch = DES.from_transitions([("off", "turn", "on", "click"), ("on", "turn", "off", "click")], initial=["off"])
    >>> lamp = DES.from_transitions([("dark", "turn", "lit", None), ("lit", "break", "dark", None)], initial=["dark"])
    >>> plant = Composition((switch, lamp))
    >>> print(plant.find(lambda state: state == ("on", "dark")))
    off.dark -turn-> on.lit -break-> on.dark
    """

    components: tuple[DES, ...]
    only_common: bool = False

    def __post_init__(self) -> None:
        commanded = (t for component in self.components for t in component.transitions if t.commands)
        for transition in commanded:
            fault = f"`{transition}` depends on a command, and components have no commands in common"
            raise UsageError(diagnostic("DH0424", fault, transition.span, helps=(_UNCOMMANDED,)))

    @property
    def initial(self) -> Iterator[State]:
        """The initial states, one after the other: all combinations of initial locations."""
        return combinations(*(component.initial for component in self.components))

    def successors(self) -> Callable[[State], Iterator[tuple[JointTransition, State]]]:
        """Return the function from a state to its joint transitions and where they lead; it is made once a search."""
        exits = tuple(_exits(component) for component in self.components)
        partners = {event: self._partners(event) for event in self.events}

        def onwards(state: State) -> Iterator[tuple[JointTransition, State]]:
            here = [table[location] for table, location in zip(exits, state, strict=True)]
            possible = dict.fromkeys(event for table in here for event in table)
            for event in possible:
                if event not in partners:
                    continue
                parts = [
                    here[i].get(event, []) if takes_part else [None] for i, takes_part in enumerate(partners[event])
                ]
                for choice in combinations(*parts):
                    joint = JointTransition(event, choice)
                    yield joint, joint.after(state)

        return onwards

    @property
    def events(self) -> tuple[str, ...]:
        """The events that components have (all of them, in the product), in the order of first appearance.

        >>> one, two = (DES.from_transitions([("1", event, "1", None), ("1", "both", "1", None)]) for event in "ab")
        >>> Composition((one, two)).events, Composition((one, two), only_common=True).events
        (('a', 'both', 'b'), ('both',))
        """
        seen = dict.fromkeys(t.event for component in self.components for t in component.transitions)
        return tuple(event for event in seen if not self.only_common or all(self._partners(event)))

    def find(self, accept: Callable[[State], bool], *, max_states: int | None = 1_000_000) -> JointRun | None:
        """Return a shortest run to a state that `accept` takes, None where there is none.

        Looks only at states that are nearer than the goal.  A goal among the initial states gives a run without steps.
        Raises `LimitReached` (DH0901) beyond `max_states` states.
        """
        graph, goal = find_first(
            _first(self.initial, max_states), self.successors(), accept, limit=max_states, what=_WHAT
        )
        if goal is None:
            return None
        path = [graph.arcs[arc] for arc in graph.path_to(goal)]
        start = graph.nodes[path[0][0] if path else goal]
        return JointRun(start, tuple((joint, graph.nodes[target]) for _, joint, target in path))

    def build(self, *, max_states: int | None = 100_000, name: str = "composition") -> DES:
        """Return the accessible part as a `DES`; locations are named by the locations they consist of, joined by `.`.

        Raises `LimitReached` (DH0901) beyond `max_states` states, `UsageError` (DH0421) where two states would have the
        same name.
        """
        plant = unfold(self)
        graph = explore(
            _first(plant.initial, max_states),
            lambda location: ((move.transition, move.target) for move in plant.ways(location)),
            limit=max_states,
            what=_WHAT,
        )
        return DES(graph.nodes, tuple(plant.transitions), tuple(plant.initial), name)

    def _partners(self, event: str) -> tuple[bool, ...]:
        return tuple(any(t.event == event for t in component.transitions) for component in self.components)


_WHAT = "states of the composition"
_UNCOMMANDED = "compose the systems without commands"
_RENAME = "rename locations so that none has a `.` in its name"


def unfold(system: DES | Composition) -> Plant:
    """Return a system as on-the-fly questions see it; of a composition, transitions are known once they are met.

    Locations of a composition are named by the locations they consist of, joined by `.`.  Raises `UsageError` (DH0421),
    also later, where two states would have the same name.

    >>> one = DES.from_transitions([("1", "a", "2", "α")], initial=["1"])
    >>> plant = unfold(Composition((one, one)))
    >>> plant.ways(next(iter(plant.initial))), str(plant.transitions[0])
    ([Move(transition=0, seen=Output(gamma='α', signature=None, command=None), target='2.2')], '1.1 -a/α-> 2.2')
    """
    if isinstance(system, DES):
        return Plant(system.initial, system.transitions, moves_from(system).__getitem__)
    successors = system.successors()
    states: dict[str, State] = {}
    transitions: list[Transition] = []
    known: dict[str, list[Move]] = {}

    def named(state: State) -> str:
        label = ".".join(state)
        if states.setdefault(label, state) != state:
            fault = f"two states of the composition would be named `{label}`"
            raise UsageError(diagnostic("DH0421", fault, helps=(_RENAME,)))
        return label

    def ways(location: str) -> list[Move]:
        if location not in known:
            known[location] = []
            for joint, target in successors(states[location]):
                arc = Transition(location, joint.event, named(target), joint.outputs, joint.signature)
                known[location] += (Move(len(transitions), seen, arc.target) for seen in dict.fromkeys(arc.seen))
                transitions.append(arc)
        return known[location]

    return Plant(_Starts(lambda: map(named, system.initial)), transitions, ways)


@dataclass(frozen=True, slots=True)
class _Starts:
    """The names of the initial states, as often as they are asked for: there may be too many to keep."""

    names: Callable[[], Iterator[str]]

    def __iter__(self) -> Iterator[str]:
        return self.names()


def parallel(first: DES, *others: DES, max_states: int | None = 100_000) -> DES:
    """Return the parallel composition: common events happen together, private ones alone; see `Composition`.

    Up to ∏|Q_i| locations, linear in what is built.  Source: Cassandras and Lafortune (2021).
    Raises `LimitReached` (DH0901), `UsageError` (DH0421).

    >>> one = DES.from_transitions([("1", "a", "2", "α"), ("2", "both", "1", "β")], initial=["1"])
    >>> two = DES.from_transitions([("x", "both", "y", "γ")], initial=["x"])
    >>> [str(arc) for arc in parallel(one, two).transitions]
    ['1.x -a/α-> 2.x', '2.x -both/β+γ-> 1.y', '1.y -a/α-> 2.y']
    """
    return Composition((first, *others)).build(max_states=max_states)


def product(first: DES, *others: DES, max_states: int | None = 100_000) -> DES:
    """Return the product: only events that all the systems have can happen, and all take part; see `Composition`.

    Cost, source and errors as for `parallel`.

    >>> one = DES.from_transitions([("1", "a", "2", "α"), ("1", "both", "1", "β")], initial=["1"])
    >>> two = DES.from_transitions([("x", "both", "y", None)], initial=["x"])
    >>> [str(arc) for arc in product(one, two).transitions]
    ['1.x -both/β-> 1.y']
    """
    return Composition((first, *others), only_common=True).build(max_states=max_states)


def _first(starts: Iterable[Start], limit: int | None) -> Iterator[Start]:
    """As many as the search needs to see that there are more than `limit`."""
    return islice(starts, None if limit is None else limit + 1)


def _exits(component: DES) -> Exits:
    exits: Exits = {location: {} for location in component.locations}
    for transition in component.transitions:
        exits[transition.source].setdefault(transition.event, []).append(transition)
    return exits


def _joined(parts: tuple[str | None, ...]) -> str | None:
    """What is shown at once; nothing where no part shows anything."""
    return "+".join(dict.fromkeys(part for part in parts if part is not None)) or None


__all__ = ["Composition", "JointRun", "JointTransition", "parallel", "product", "unfold"]
