"""The location observer at run time: entry estimates that also wait for a signature that is due.

In: the `SignaturePlan` (its complementary DES, its generators).  Out: the tracker states of `StepTables`.

A transition that carries (γ, s) is seen twice: γ at once, s later, but before the next transition.  So the observer
keeps pairs (q, s): the plant has entered q, and the signature s is still due, or none is (-).  Subsets of such pairs
are the tracker states:
- γ leads from (p, -) to (q, s) for every edge p —(γ,s)→ q of D'_H, s may be -;
- a signature s leads from (q, s) to (q, -), and from (p, -) to (q, -) for every edge p —(ε,s)→ q;
- silence for the detection window removes the pairs that still wait, if others remain; if none remains the output is
  inconsistent, provided that the detector guarantees a delay for every signature that was due, else it goes on waiting.
What cannot be told apart any better is not waited for: where all pairs have the same location, or the same signature is
due in all of them, the state forgets what is due, and the late signature is absorbed.  A state with something due is
*provisional*; its entry estimate is the set of its locations.  An event or a signature that no settled pair (q, -)
explains is tried from the waiting ones: then a signature has been missed.

Candidates of a state are the signatures that lead out of it.  One by residual waits until the generators of all
alternatives (locations of the state, targets of the other candidates) are quiet: an ambiguous residual waits rather
than guesses.  One by negation needs a generator for every alternative, and is left out of a state where one is missing.

A purely discrete model has no residuals: there the signatures come as events of the same name, and a pair (γ, s) that
comes at once as the event `γ,s`; nothing times out, and nothing due is forgotten, because its event will come.

Subset construction, up to 2^(|Q| (|S|+1)) states, hence `max_states`.
Source: Balluchi et al. (2012), sections 3.1, 4.1 and 4.2; Figure 9.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import NamedTuple, TypeAlias

from deshybrid.des.automaton import DES, Output
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.signatures import SignaturePlan
from deshybrid.des.worklist import Graph, explore
from deshybrid.observer.tables import Candidate, TrackerState

NONE = -1
INCONSISTENT = -2

Configuration: TypeAlias = tuple[int, int]  # (location, signature that is due or NONE)
Node: TypeAlias = tuple[Configuration, ...]  # ascending, without repetition


class Token(NamedTuple):
    """What moves the tracker: an event or a signature by its number, or silence."""

    kind: str  # "event", "signature", "silence"
    number: int


@dataclass(frozen=True, slots=True)
class Tracker:
    """The tracker part of `StepTables`; `restart` is the state of all locations."""

    event_names: tuple[str, ...]
    signature_names: tuple[str, ...]
    states: tuple[TrackerState, ...]
    initial: int
    restart: int
    restart_on_event: tuple[int, ...]


def build_tracker(
    plan: SignaturePlan,
    *,
    signatures_are_events: bool = False,
    guaranteed: frozenset[str] = frozenset(),
    max_states: int = 100_000,
) -> Tracker:
    """Return the tracker of a plan that recovers observability, or needs no signature.

    `guaranteed`: locations whose signature has a detection delay that holds without condition.
    Raises `LimitReached` (DH0901) beyond `max_states` states.

    >>> from deshybrid.des.signatures import recover_observability
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> tracker = build_tracker(recover_observability(des, ()))
    >>> [state.entry_estimate for state in tracker.states], tracker.states[0].on_event
    ([(0, 1), (1,), (0,)], (1, 2))
    """
    moves = _Moves(plan, signatures_are_events)
    everything = tuple((location, NONE) for location in range(len(moves.des.locations)))
    start = tuple((n, NONE) for n, name in enumerate(moves.des.locations) if name in set(moves.des.initial))
    graph = explore([start, everything], moves.successors, limit=max_states, what="tracker states")
    due = frozenset(n for n, s in enumerate(plan.signatures) if s.location in guaranteed)
    states = tuple(_states(moves, graph, due))
    restart = graph.nodes.index(everything)
    return Tracker(
        event_names=moves.event_names,
        signature_names=() if signatures_are_events else tuple(s.name for s in plan.signatures),
        states=states,
        initial=graph.nodes.index(start),
        restart=restart,
        restart_on_event=tuple(restart if state < 0 else state for state in states[restart].on_event),
    )


def outputs_of(des: DES) -> tuple[str, ...]:
    """Return the discrete outputs γ in order of first appearance.

    >>> outputs_of(DES.from_transitions([("1", "a", "2", "β"), ("2", "b", "1", None), ("1", "a", "2", "α")]))
    ('β', 'α')
    """
    gammas = (gamma for transition in des.transitions for gamma in transition.outputs)
    return tuple(dict.fromkeys(gamma for gamma in gammas if gamma is not None))


class _Moves:
    """The moves of (location, signature due) pairs, indexed by what is seen."""

    def __init__(self, plan: SignaturePlan, signatures_are_events: bool) -> None:
        self.plan = plan
        self.des = plan.complementary or plan.des
        self.signatures_are_events = signatures_are_events
        self.number = {signature.name: number for number, signature in enumerate(plan.signatures)}
        self.tokens: dict[str, Output] = {gamma: Output(gamma) for gamma in outputs_of(self.des)}
        automaton = eliminate_epsilon(self.des)
        if signatures_are_events:
            for output in (*(Output(None, name) for name in self.number), *automaton.outputs):
                self.tokens.setdefault(str(output), output)
        place = {name: number for number, name in enumerate(self.des.locations)}
        self.by_gamma: dict[tuple[str | None, int], list[tuple[int, str | None]]] = {}
        for edge in automaton.edges:
            move = (place[edge.target], edge.output.signature)
            self.by_gamma.setdefault((edge.output.gamma, place[edge.source]), []).append(move)

    @property
    def event_names(self) -> tuple[str, ...]:
        return tuple(self.tokens)

    def successors(self, node: Node) -> Iterator[tuple[Token, Node]]:
        for number, output in enumerate(self.tokens.values()):
            if target := self.on_event(node, output):
                yield Token("event", number), target
        if self.signatures_are_events:
            return
        for name, number in self.number.items():
            if target := self.on_signature(node, name):
                yield Token("signature", number), target
        settled = _settled(node)
        if settled and settled != node:
            yield Token("silence", 0), self._node(set(settled))

    def on_event(self, node: Node, output: Output) -> Node:
        """The node after γ, or after γ and s at once."""
        if output.gamma is None:
            return self.on_signature(node, str(output.signature))
        for sources in _in_turn(node):
            found = {pair for source in sources for pair in self._arrivals(source, output)}
            if found:
                return self._node(found)
        return ()

    def _arrivals(self, source: int, output: Output) -> Iterator[Configuration]:
        for target, signature in self.by_gamma.get((output.gamma, source), ()):
            if output.signature is None:
                yield target, NONE if signature is None else self.number[signature]
            elif output.signature == signature:
                yield target, NONE

    def on_signature(self, node: Node, name: str) -> Node:
        """The node after a signature: it was due, or the plant has moved without any γ."""
        due = {(location, NONE) for location, wait in node if wait == self.number[name]}
        for sources in _in_turn(node):
            moves = [move for source in sources for move in self.by_gamma.get((None, source), ())]
            found = due | {(target, NONE) for target, signature in moves if signature == name}
            if found:
                return self._node(found)
        return ()

    def _node(self, found: set[Configuration]) -> Node:
        """What is due in all pairs, or in pairs of one location, tells nothing and is not waited for."""
        useless = len({pair[0] for pair in found}) == 1 or len({pair[1] for pair in found}) == 1
        if useless and not self.signatures_are_events:
            found = {(location, NONE) for location, _ in found}
        return tuple(sorted(found))


def _in_turn(node: Node) -> tuple[list[int], list[int]]:
    """The settled locations of a node, and those to be tried if these explain nothing: a signature has been missed."""
    return [place for place, due in node if due == NONE], [place for place, due in node if due != NONE]


def _settled(node: Node) -> Node:
    return tuple(pair for pair in node if pair[1] == NONE)


def _states(moves: _Moves, graph: Graph[Node, Token], guaranteed: frozenset[int]) -> Iterator[TrackerState]:
    persistent = {moves.des.locations.index(name) for name in moves.plan.report.persistent}
    by_node: list[dict[Token, int]] = [{} for _ in graph.nodes]
    for source, token, target in graph.arcs:
        by_node[source][token] = target
    for node, targets in zip(graph.nodes, by_node, strict=True):
        locations = tuple(sorted({location for location, _ in node}))
        provisional = any(due != NONE for _, due in node)
        identified = len(locations) == 1 and locations[0] in persistent
        yield TrackerState(
            entry_estimate=locations,
            location=locations[0] if identified else NONE,
            provisional=provisional and not identified,
            on_event=tuple(targets.get(Token("event", n), NONE) for n in range(len(moves.event_names))),
            candidates=tuple(_candidates(moves, graph, node, targets)),
            timeout_target=_timeout(moves, node, targets, guaranteed) if provisional else NONE,
        )


def _timeout(moves: _Moves, node: Node, targets: dict[Token, int], guaranteed: frozenset[int]) -> int:
    if moves.signatures_are_events or _settled(node):
        return targets.get(Token("silence", 0), NONE)
    return INCONSISTENT if {due for _, due in node} <= guaranteed else NONE


def _candidates(moves: _Moves, graph: Graph[Node, Token], node: Node, targets: dict[Token, int]) -> Iterator[Candidate]:
    """The signatures that lead out of a state; a self-loop by negation shows nothing."""
    leaving = {token.number: target for token, target in targets.items() if token.kind == "signature"}
    reached = {number: {location for location, _ in graph.nodes[target]} for number, target in leaving.items()}
    possible = {location for location, _ in node}.union(*reached.values())
    names = moves.plan.generators
    generator = {moves.des.locations.index(name): number for number, name in enumerate(names)}
    for number, target in leaving.items():
        signature = moves.plan.signatures[number]
        others = possible - reached[number]
        quiet = tuple(sorted(generator[location] for location in others if location in generator))
        if signature.by == "residual":
            yield Candidate(number, names.index(signature.location), quiet, target)
        elif quiet and len(quiet) == len(others) and graph.nodes[target] != node:
            yield Candidate(number, NONE, quiet, target)


__all__ = ["Tracker", "build_tracker", "outputs_of"]
