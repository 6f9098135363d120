"""The nondeterministic discrete-event system D_H: locations, events, and transitions with discrete outputs.

A transition may carry several outputs (any of them may be seen) and the null output ε, written `None`.  A complementary
DES carries, beside the output γ, a signature s on some transitions; what an observer sees is then the pair (γ, s).

Where the commands of a controller are known, a transition lists those under which it is possible.  Whoever sees it then
knows the command c as well, so it shows (γ, s, c) for one of these c.  One that shows neither γ nor s stays unseen:
that the command permits it does not tell whether it is taken.

Source: Balluchi et al. (2012), section 3.1 (D_H) and section 4.1 (complementary DES); known commands: this project.
"""

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, NamedTuple

from deshybrid.diagnostics import ModelError, Span, UsageError, diagnostic
from deshybrid.diagnostics.pictured import Pictured

if TYPE_CHECKING:
    import networkx


class Output(NamedTuple):
    """What the observer sees at a transition: the discrete output γ, a signature s, or both; and the command, if known.

    >>> str(Output("α")), str(Output(None, "s_5")), str(Output("α", "s_5")), str(Output("α", command="3"))
    ('α', 's_5', 'α,s_5', 'α@3')
    """

    gamma: str | None
    signature: str | None = None
    command: str | None = None

    @property
    def is_nothing(self) -> bool:
        """Whether neither γ nor s is there, so that nothing is seen."""
        return self.gamma is None and self.signature is None

    def __str__(self) -> str:
        shown = ",".join(part for part in (self.gamma, self.signature) if part is not None)
        return shown if self.command is None else f"{shown}@{self.command}"


@dataclass(frozen=True, slots=True)
class Transition:
    """One arc `source` —event/outputs→ `target`; `outputs` lists every γ it may show, `None` is ε.

    `commands`: those under which it is possible; empty where none are known.
    """

    source: str
    event: str
    target: str
    outputs: tuple[str | None, ...] = (None,)
    signature: str | None = None
    span: Span | None = field(default=None, compare=False, repr=False)
    output_span: Span | None = field(default=None, compare=False, repr=False)
    commands: tuple[str, ...] = ()

    @property
    def seen(self) -> tuple[Output | None, ...]:
        """What may be seen when the transition is taken, in the order written; `None` = nothing.

        >>> Transition("1", "a", "2", ("α", None)).seen
        (Output(gamma='α', signature=None, command=None), None)
        """
        return tuple(dict.fromkeys(None if shown.is_nothing else shown for shown in self.occurrences))

    @property
    def occurrences(self) -> tuple[Output, ...]:
        """Like `seen`, but with the command of what shows nothing: transitions without a common one never coincide.

        >>> Transition("1", "a", "2", (None,), commands=("3",)).occurrences
        (Output(gamma=None, signature=None, command='3'),)
        """
        commands = self.commands or (None,)
        return tuple(Output(gamma, self.signature, command) for gamma in self.outputs for command in commands)

    @property
    def is_observable(self) -> bool:
        """True where every occurrence shows something (condition C1 asks this of exits of persistent locations)."""
        return self.signature is not None or None not in self.outputs

    def coincides(self, other: "Transition") -> bool:
        """Return whether some command permits both.

        >>> first, second = (Transition("1", "a", "2", commands=(command,)) for command in "34")
        >>> first.coincides(second), first.coincides(Transition("2", "b", "1"))
        (False, True)
        """
        return not (self.commands and other.commands) or not set(self.commands).isdisjoint(other.commands)

    def __str__(self) -> str:
        shown = dict.fromkeys("ε" if o.is_nothing else str(o._replace(command=None)) for o in self.occurrences)
        return f"{self.source} -{self.event}/{'|'.join(shown)}-> {self.target}"


@dataclass(frozen=True, slots=True, repr=False)
class DES(Pictured):
    """D_H: a nondeterministic discrete-event system; order of locations and transitions is order of declaration.

    `len(des)` counts the transitions, iteration goes through them, `des["2"]` holds those that leave location `2`.
    Raises `ModelError` (DH0404) when a transition or the initial set names an unknown location, or one is given twice.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)])
    >>> des.locations, des.initial
    (('1', '2'), ('1', '2'))
    >>> des, len(des), [transition.event for transition in des], str(des["2"][0])
    (<DES des: 2 locations, 2 transitions, 2 initial>, 2, ['a', 'b'], '2 -b/ε-> 1')
    """

    locations: tuple[str, ...]
    transitions: tuple[Transition, ...]
    initial: tuple[str, ...] = ()
    name: str = "des"
    location_spans: Mapping[str, Span] = field(default_factory=lambda: MappingProxyType({}), compare=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "initial", self.initial or self.locations)
        known = set(self.locations)
        if len(known) < len(self.locations):
            raise ModelError(diagnostic("DH0404", "a location is declared twice"))
        unknown = [(t.span, name) for t in self.transitions for name in (t.source, t.target) if name not in known] + [
            (None, name) for name in self.initial if name not in known
        ]
        if unknown:
            raise ModelError(*(diagnostic("DH0404", f"unknown location `{name}`", span) for span, name in unknown))

    @property
    def events(self) -> tuple[str, ...]:
        """The events of the transitions, in the order of first appearance.

        >>> DES.from_transitions([("1", "b", "2", None), ("2", "a", "1", None), ("1", "b", "1", None)]).events
        ('b', 'a')
        """
        return tuple(dict.fromkeys(transition.event for transition in self.transitions))

    def __len__(self) -> int:
        return len(self.transitions)

    def __bool__(self) -> bool:
        return True  # a system without transitions is a system

    def __iter__(self) -> Iterator[Transition]:
        return iter(self.transitions)

    def __getitem__(self, location: str) -> tuple[Transition, ...]:
        """Return the transitions that leave `location`, by declaration; `UsageError` (DH0404) where there is none such.

        Looks at every transition.

        >>> DES.from_transitions([("1", "a", "2", "α")])["2"]
        ()
        """
        if location not in self.locations:
            raise UsageError(diagnostic("DH0404", f"unknown location `{location}`"))
        return tuple(transition for transition in self.transitions if transition.source == location)

    def __repr__(self) -> str:
        sizes = f"{len(self.locations)} locations, {len(self)} transitions, {len(self.initial)} initial"
        return f"<DES {self.name}: {sizes}>"

    @classmethod
    def from_transitions(
        cls,
        transitions: Iterable[tuple[str, str, str, str | None]],
        *,
        initial: Iterable[str] = (),
        name: str = "des",
    ) -> "DES":
        """Build a system from (source, event, target, output) rows; output `None` is ε.

        Locations appear in the order of first mention; rows with equal source, event and target join their outputs.

        >>> des = DES.from_transitions([("p", "a", "q", "α"), ("p", "a", "q", None)])
        >>> des.transitions[0].outputs
        ('α', None)
        """
        outputs: dict[tuple[str, str, str], dict[str | None, None]] = {}
        locations: dict[str, None] = {}
        for source, event, target, output in transitions:
            locations.setdefault(source)
            locations.setdefault(target)
            outputs.setdefault((source, event, target), {})[output] = None
        arcs = tuple(Transition(*arc, tuple(seen)) for arc, seen in outputs.items())
        return cls(tuple(locations), arcs, tuple(initial), name)

    def with_signatures(self, signatures: Mapping[int, str]) -> "DES":
        """Return the complementary DES, in which transition number i carries the signature `signatures[i]`.

        >>> des = DES.from_transitions([("2", "d", "5", None)])
        >>> str(des.with_signatures({0: "s_5"}).transitions[0])
        '2 -d/s_5-> 5'
        """
        arcs = tuple(replace(t, signature=signatures.get(i, t.signature)) for i, t in enumerate(self.transitions))
        return replace(self, transitions=arcs)

    def to_table(self) -> dict[str, tuple[str | None, ...]]:
        """Return columns of equal length, one row per transition and output, which pandas takes as they are.

        The columns are `source`, `event`, `target`, `output` and `signature`; None is ε, or no signature.  Where
        commands are known there is a column `commands`, joined by semicolons.

        >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)])
        >>> table = des.to_table()
        >>> table["source"], table["output"]
        (('1', '2'), ('α', None))
        """
        rows = [(t.source, t.event, t.target, output, t.signature) for t in self.transitions for output in t.outputs]
        names = ("source", "event", "target", "output", "signature")
        table: dict[str, tuple[str | None, ...]]
        table = {name: tuple(row[place] for row in rows) for place, name in enumerate(names)}
        if any(transition.commands for transition in self.transitions):
            table["commands"] = tuple("; ".join(t.commands) for t in self.transitions for _ in t.outputs)
        return table

    def to_networkx(self) -> "networkx.MultiDiGraph[str]":
        """Return a networkx graph: nodes are locations, edges carry `event`, `outputs`, `signature` and `number`.

        `number` is the place of the transition in the system, since networkx groups edges by source; `name` and
        `initial` are attributes of the graph.  `from_networkx` takes it back.

        >>> des = DES.from_transitions([("1", "a", "2", "α")])
        >>> list(des.to_networkx().edges(data=True))
        [('1', '2', {'event': 'a', 'outputs': ('α',), 'signature': None, 'number': 0})]
        """
        import networkx

        graph: networkx.MultiDiGraph[str] = networkx.MultiDiGraph(name=self.name, initial=self.initial)
        graph.add_nodes_from(self.locations)
        for number, t in enumerate(self.transitions):
            facts = {"event": t.event, "outputs": t.outputs, "signature": t.signature, "number": number}
            facts |= {"commands": t.commands} if t.commands else {}
            graph.add_edges_from([(t.source, t.target, facts)])
        return graph

    @classmethod
    def from_networkx(cls, graph: "networkx.DiGraph[Any]", *, initial: Iterable[str] = ()) -> "DES":
        """Return the system that a directed networkx graph describes; `initial` goes before the graph's own.

        Nodes are named by their text.  Every edge needs an `event` and its `outputs`: a text, None for ε, or a tuple of
        these; `signature`, `commands` and `number` (by which edges are ordered where all have one) may be missing.
        Raises `UsageError` (DH0422) on an edge without them, `ModelError` (DH0404) where nodes have the same text.

        >>> import networkx
        >>> graph = networkx.DiGraph()
        >>> graph.add_edge(1, 2, event="a", outputs=None)
        >>> str(DES.from_networkx(graph).transitions[0])
        '1 -a/ε-> 2'
        """
        edges = list(graph.edges(data=True))
        bare = [(source, target) for source, target, facts in edges if not {"event", "outputs"} <= set(facts)]
        if bare or not graph.is_directed():
            faults = [f"the edge from `{source}` to `{target}` lacks `event` or `outputs`" for source, target in bare]
            faults += [] if graph.is_directed() else ["the graph is not directed"]
            raise UsageError(*(diagnostic("DH0422", fault) for fault in faults))
        if all(isinstance(facts.get("number"), int) for _, _, facts in edges):
            edges.sort(key=lambda edge: edge[2]["number"])
        arcs = tuple(
            Transition(
                str(source),
                str(facts["event"]),
                str(target),
                _outputs(facts["outputs"]),
                facts.get("signature"),
                commands=tuple(facts.get("commands", ())),
            )
            for source, target, facts in edges
        )
        starts = tuple(initial) or tuple(str(name) for name in graph.graph.get("initial", ()))
        return cls(tuple(str(node) for node in graph), arcs, starts, str(graph.graph.get("name") or "des"))


def _outputs(given: object) -> tuple[str | None, ...]:
    several = given if isinstance(given, (tuple, list)) else (given,)
    return tuple(None if output is None else str(output) for output in several)


__all__ = ["DES", "Output", "Transition"]
