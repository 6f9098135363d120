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

Known commands drop the edges that they exclude.  An edge counts while a command that it needs was on at the sample that
shows γ or at the one before (of a purely discrete model: in that row), for a signature within the detection window, in
both cases since the transition before it was seen.  Invisible edges count under any command.

The moves are collected here once, as an `OnlineTracker`, which says what they mean.  `build_tracker` makes a table of
all states that it can reach: up to 2^(|Q| (|S|+1)), hence `max_states`.  Beyond that the observer asks it on line, and
where commands are known: what a state allows then depends on the moment.
Source: Balluchi et al. (2012), sections 3.1, 4.1 and 4.2; Figure 9.
"""

from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.signatures import SignaturePlan
from deshybrid.des.worklist import explore
from deshybrid.diagnostics import LimitReached
from deshybrid.observer import MAX_TABLE
from deshybrid.observer.online import NONE, Conditional, OnlineTracker
from deshybrid.observer.tables import Candidate, TrackerState

Move = TypeVar("Move", int, tuple[int, tuple[int, ...]])


@dataclass(frozen=True, slots=True)
class CommandNeeds:
    """How many values each command has, and the masks that each transition (by number) needs; see `OnlineTracker`."""

    commands: tuple[int, ...] = ()
    masks: tuple[tuple[int, ...], ...] = ()

    def of(self, transition: int) -> tuple[int, ...]:
        """Return the masks of a transition, none where it does not depend on commands."""
        return self.masks[transition] if self.masks else ()


NO_COMMANDS = CommandNeeds()


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
    online: OnlineTracker | None = None


def choose_tracker(
    plan: SignaturePlan,
    *,
    signatures_are_events: bool = False,
    guaranteed: frozenset[str] = frozenset(),
    needs: CommandNeeds = NO_COMMANDS,
    generators: tuple[str, ...] | None = None,
    max_states: int = MAX_TABLE,
) -> Tracker:
    """Return the tracker as a table of up to `max_states` states, else the on-line tracker, whose states are bit masks.

    Both give the same estimates; where commands are known it is always the second.  `guaranteed`: as for
    `build_tracker`; `needs`: of commands; `generators`: the locations that have one, in the order of their numbers;
    those of the plan where not given.

    >>> from deshybrid.des.signatures import recover_observability
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> tracker = choose_tracker(recover_observability(des, ()), max_states=1)
    >>> tracker.states, bin(tracker.initial), bin(tracker.online.after_event(tracker.initial, 0))
    ((), '0b11', '0b10')
    """
    moves = _Moves(plan, signatures_are_events, guaranteed, needs, generators=generators)
    if not needs.commands:
        with suppress(LimitReached):
            return _tabulated(moves, max_states)
    return Tracker(moves.event_names, moves.heard, (), *moves.roots, (), moves.online)


def build_tracker(
    plan: SignaturePlan,
    *,
    signatures_are_events: bool = False,
    guaranteed: frozenset[str] = frozenset(),
    max_states: int = 100_000,
) -> Tracker:
    """Return the table of a plan that recovers observability, or needs no signature.

    `guaranteed`: locations whose signature has a detection delay that holds without condition.
    Raises `LimitReached` (DH0901) beyond `max_states` states.

    >>> from deshybrid.des.signatures import recover_observability
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> tracker = build_tracker(recover_observability(des, ()))
    >>> [state.entry_estimate for state in tracker.states], tracker.states[0].on_event
    ([(0, 1), (1,), (0,)], (1, 2))
    """
    return _tabulated(_Moves(plan, signatures_are_events, guaranteed, NO_COMMANDS), max_states)


def outputs_of(des: DES) -> tuple[str, ...]:
    """Return the discrete outputs γ in order of first appearance.

    >>> outputs_of(DES.from_transitions([("1", "a", "2", "β"), ("2", "b", "1", None), ("1", "a", "2", "α")]))
    ('β', 'α')
    """
    gammas = (gamma for transition in des.transitions for gamma in transition.outputs)
    return tuple(dict.fromkeys(gamma for gamma in gammas if gamma is not None))


class _Moves:
    """The moves of a plan's locations by what is seen, and the names of what is seen."""

    def __init__(
        self,
        plan: SignaturePlan,
        signatures_are_events: bool,
        guaranteed: frozenset[str],
        needs: CommandNeeds,
        *,
        generators: tuple[str, ...] | None = None,
    ) -> None:
        self.plan, self.needs = plan, needs
        self.generators = plan.generators if generators is None else generators
        self.des = plan.complementary or plan.des
        self.place = {name: number for number, name in enumerate(self.des.locations)}
        carried = (t.signature for t in self.des.transitions if t.signature is not None)  # also of several detectors
        names = dict.fromkeys((*(signature.name for signature in plan.signatures), *carried))
        self.number = {name: number for number, name in enumerate(names)}
        self.heard = () if signatures_are_events else tuple(self.number)
        self.events = {gamma: Output(gamma) for gamma in outputs_of(self.des)}
        if signatures_are_events:
            pairs = (Output(gamma, t.signature) for t in self.des.transitions for gamma in t.outputs)
            for output in (*(Output(None, name) for name in self.number), *pairs):
                if not output.is_nothing:
                    self.events.setdefault(str(output), output)
        self.event_names = tuple(self.events)
        self.showing: dict[str | None, list[tuple[int, Transition]]] = {}
        for number, transition in enumerate(self.des.transitions):
            for gamma in dict.fromkeys(transition.outputs):
                self.showing.setdefault(gamma, []).append((number, transition))
        late = sorted(set(self._late()), key=lambda pair: (self.place[pair[0]], self.number[pair[1]]))
        self.pair: dict[tuple[str, str | None], int] = {(name, None): q for name, q in self.place.items()}
        self.pair |= {pair: len(self.place) + i for i, pair in enumerate(late)}
        self.online = self._online(tuple((self.place[q], self.number[s]) for q, s in late), guaranteed)

    @property
    def roots(self) -> tuple[int, int]:
        """The initial set and the set of all locations, nothing due."""
        start = set(self.des.initial)
        return sum(1 << q for name, q in self.place.items() if name in start), (1 << len(self.place)) - 1

    def _late(self) -> Iterator[tuple[str, str]]:
        """What a signature may be due for: the targets of transitions that show a γ first."""
        for transition in self.des.transitions:
            if transition.signature is not None and any(gamma is not None for gamma in transition.outputs):
                yield transition.target, transition.signature

    def _online(self, waiting: tuple[tuple[int, int], ...], guaranteed: frozenset[str]) -> OnlineTracker:
        plan, heard = self.plan, [Output(None, name) for name in self.heard]
        found = [self._token(output) for output in (*self.events.values(), *heard)]
        generator = {name: number for number, name in enumerate(self.generators)}
        own = (generator[s.location] if s.by == "residual" else NONE for s in plan.signatures)
        persistent = set(plan.report.persistent)
        return OnlineTracker(
            locations=len(self.place),
            persistent=tuple(name in persistent for name in self.place),
            waiting=waiting,
            silent=self._silent(),
            events=len(self.events),
            tokens=tuple((answers, moves) for answers, moves, _ in found),
            active=tuple(own) if heard else (),
            generator=tuple(generator.get(name, NONE) for name in self.place),
            guaranteed=tuple(s.location in guaranteed for s in plan.signatures),
            times_out=bool(self.heard),
            commands=self.needs.commands,
            conditional=tuple(moves for _, _, moves in found) if self.needs.commands else (),
        )

    def _silent(self) -> dict[int, tuple[int, ...]]:
        targets: dict[int, list[int]] = {}
        for transition in self.des.transitions:
            if not transition.is_observable:
                targets.setdefault(self.place[transition.source], []).append(self.place[transition.target])

        def unseen(location: int) -> Iterator[tuple[None, int]]:
            return ((None, target) for target in targets.get(location, ()))

        reach = {location: explore([location], unseen).nodes[1:] for location in sorted(targets)}
        return {location: tuple(sorted(found)) for location, found in reach.items() if found}

    def _token(self, output: Output) -> tuple[int, dict[int, tuple[int, ...]], dict[int, Conditional]]:
        """γ alone leaves a signature due, γ and s together do not; s alone also comes where it was due."""
        moves: dict[int, set[int]] = {}
        conditional: dict[int, set[tuple[int, tuple[int, ...]]]] = {}
        for number, transition in self.showing.get(output.gamma, ()):
            if output.signature in (None, transition.signature):
                due = transition.signature if output.signature is None else None
                source, pair, needed = (
                    self.place[transition.source],
                    self.pair[transition.target, due],
                    self.needs.of(number),
                )
                if needed:
                    conditional.setdefault(source, set()).add((pair, needed))
                else:
                    moves.setdefault(source, set()).add(pair)
        answers = self.number[output.signature] if output.gamma is None and output.signature is not None else NONE
        return answers, _in_order(moves), _in_order(conditional)


def _in_order(moves: dict[int, set[Move]]) -> dict[int, tuple[Move, ...]]:
    return {source: tuple(sorted(moves[source])) for source in sorted(moves)}


def _tabulated(moves: _Moves, max_states: int) -> Tracker:
    """Ask the on-line tracker for every state that it can reach."""
    online = moves.online
    graph = explore(moves.roots, lambda state: _successors(online, state), limit=max_states, what="tracker states")
    number = {state: index for index, state in enumerate(graph.nodes)}
    initial, restart = (number[root] for root in moves.roots)
    by_event: list[list[int]] = [[NONE] * online.events for _ in graph.nodes]
    for source, token, target in graph.arcs:
        if token.kind == "event":
            by_event[source][token.number] = target
    states = tuple(_state(online, state, tuple(by_event[index]), number) for state, index in number.items())
    return Tracker(
        event_names=moves.event_names,
        signature_names=moves.heard,
        states=states,
        initial=initial,
        restart=restart,
        restart_on_event=tuple(restart if state < 0 else state for state in by_event[restart]),
    )


def _successors(online: OnlineTracker, state: int) -> Iterator[tuple[Token, int]]:
    sources = online.sources(state)
    for number in range(len(online.tokens)):
        if (target := online.follow(state, sources, number)) >= 0:
            heard = number - online.events
            yield Token("event", number) if heard < 0 else Token("signature", heard), target
    if (target := online.timeout(state)) >= 0:
        yield Token("silence", 0), target


def _state(online: OnlineTracker, state: int, on_event: tuple[int, ...], number: dict[int, int]) -> TrackerState:
    location, provisional = online.known(state)
    timeout = online.timeout(state)
    return TrackerState(
        entry_estimate=online.entry_estimate(state),
        location=location,
        provisional=provisional,
        on_event=on_event,
        candidates=tuple(Candidate(s, own, quiet, number[to]) for s, own, quiet, to in online.candidates(state)),
        timeout_target=number.get(timeout, timeout),
    )


__all__ = ["CommandNeeds", "Tracker", "build_tracker", "choose_tracker", "outputs_of"]
