"""Systems that run together: parallel composition and product, explored state by state and never built.

A state of a `Composition` is a tuple with one location of each component.  A component takes part in an event exactly
where one of its transitions has that event.  In the parallel composition an event happens in all the components that
have it, at once, and the others stay; in the product only events that all components have can happen.  What is seen
when several transitions are taken at once: the outputs of those that show something, each once, in the order of the
components, joined by `+`.

In: components.  Out: successors of a state, a shortest run to a state that is looked for, or the whole as a `DES`.
Cost: linear in the states and joint transitions that are looked at; there are up to ∏|Q_i| states.
Source: Cassandras and Lafortune (2021), section 2.3.2.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import product as combinations
from typing import NamedTuple, TypeAlias

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.search import find_first, labels_to
from deshybrid.des.worklist import explore
from deshybrid.diagnostics import UsageError, diagnostic

State: TypeAlias = tuple[str, ...]
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


@dataclass(frozen=True, slots=True)
class Composition:
    """Components that run together; `only_common` makes it the product, in which all take part in every event.

    >>> switch = DES.from_transitions([("off", "turn", "on", "click"), ("on", "turn", "off", "click")], initial=["off"])
    >>> lamp = DES.from_transitions([("dark", "turn", "lit", None), ("lit", "break", "dark", None)], initial=["dark"])
    >>> plant = Composition((switch, lamp))
    >>> [step.event for step, _ in plant.find(lambda state: state == ("on", "dark"))]
    ['turn', 'break']
    """

    components: tuple[DES, ...]
    only_common: bool = False

    @property
    def initial(self) -> Iterator[State]:
        """The initial states, one after the other: all combinations of initial locations."""
        return combinations(*(component.initial for component in self.components))

    def successors(self) -> Callable[[State], Iterator[tuple[JointTransition, State]]]:
        """Return the function from a state to its joint transitions and where they lead; it is made once a search."""
        events = self.events()
        exits = tuple(_exits(component) for component in self.components)
        partners = {event: self._partners(event) for event in events}

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

    def events(self) -> tuple[str, ...]:
        """Return the events that can happen, in the order of first appearance.

        >>> one, two = (DES.from_transitions([("1", event, "1", None), ("1", "both", "1", None)]) for event in "ab")
        >>> Composition((one, two)).events(), Composition((one, two), only_common=True).events()
        (('a', 'both', 'b'), ('both',))
        """
        seen = dict.fromkeys(t.event for component in self.components for t in component.transitions)
        return tuple(event for event in seen if not self.only_common or all(self._partners(event)))

    def find(
        self, accept: Callable[[State], bool], *, max_states: int | None = None
    ) -> tuple[tuple[JointTransition, State], ...] | None:
        """Return a shortest run to a state that `accept` takes, as (joint transition, state after it); None: no run.

        Looks only at states that are nearer than the goal.  A goal among the initial states gives the empty run.
        Raises `LimitReached` (DH0901) beyond `max_states` states.
        """
        graph, goal = find_first(
            self.initial, self.successors(), accept, limit=max_states, what="states of the composition"
        )
        if goal is None:
            return None
        reached = (graph.nodes[graph.arcs[arc][2]] for arc in graph.path_to(goal))
        return tuple(zip(labels_to(graph, goal), reached, strict=True))

    def build(self, *, max_states: int | None = None, name: str = "composition") -> DES:
        """Return the accessible part as a `DES`; locations are named by the locations they consist of, joined by `.`.

        Raises `LimitReached` (DH0901) beyond `max_states` states, `UsageError` (DH0421) where two states would have the
        same name.
        """
        graph = explore(self.initial, self.successors(), limit=max_states, what="states of the composition")
        names = [".".join(state) for state in graph.nodes]
        if len(set(names)) < len(names):
            twice = next(label for number, label in enumerate(names) if label in names[:number])
            raise UsageError(
                diagnostic("DH0421", f"two states of the composition would be named `{twice}`", helps=(_RENAME,))
            )
        arcs = tuple(
            Transition(names[source], joint.event, names[target], joint.outputs, joint.signature)
            for source, joint, target in graph.arcs
        )
        starts = tuple(".".join(state) for state in self.initial)
        return DES(tuple(names), arcs, starts, name)

    def _partners(self, event: str) -> tuple[bool, ...]:
        return tuple(any(t.event == event for t in component.transitions) for component in self.components)


_RENAME = "rename locations so that none has a `.` in its name"


def parallel(first: DES, *others: DES, max_states: int | None = None) -> DES:
    """Return the parallel composition: common events happen together, private ones alone; see `Composition`.

    Up to ∏|Q_i| locations, linear in what is built.  Source: Cassandras and Lafortune (2021), section 2.3.2.
    Raises `LimitReached` (DH0901), `UsageError` (DH0421).

    >>> one = DES.from_transitions([("1", "a", "2", "α"), ("2", "both", "1", "β")], initial=["1"])
    >>> two = DES.from_transitions([("x", "both", "y", "γ")], initial=["x"])
    >>> [str(arc) for arc in parallel(one, two).transitions]
    ['1.x -a/α-> 2.x', '2.x -both/β+γ-> 1.y', '1.y -a/α-> 2.y']
    """
    return Composition((first, *others)).build(max_states=max_states)


def product(first: DES, *others: DES, max_states: int | None = None) -> DES:
    """Return the product: only events that all the systems have can happen, and all take part; see `Composition`.

    Cost, source and errors as for `parallel`.

    >>> one = DES.from_transitions([("1", "a", "2", "α"), ("1", "both", "1", "β")], initial=["1"])
    >>> two = DES.from_transitions([("x", "both", "y", None)], initial=["x"])
    >>> [str(arc) for arc in product(one, two).transitions]
    ['1.x -both/β-> 1.y']
    """
    return Composition((first, *others), only_common=True).build(max_states=max_states)


def _exits(component: DES) -> Exits:
    exits: Exits = {location: {} for location in component.locations}
    for transition in component.transitions:
        exits[transition.source].setdefault(transition.event, []).append(transition)
    return exits


def _joined(parts: tuple[str | None, ...]) -> str | None:
    """What is shown at once; nothing where no part shows anything."""
    return "+".join(dict.fromkeys(part for part in parts if part is not None)) or None


__all__ = ["Composition", "JointTransition", "parallel", "product"]
