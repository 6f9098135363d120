"""The tracker straight from its text: sets of (location, signature due) by name, moved along the edges of D'_H.

Nothing here knows of bit masks, token numbers or closures; a state is a frozenset, `None` stands for nothing due.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from deshybrid.des.epsilon import Edge, eliminate_epsilon
from deshybrid.des.signatures import Signature, SignaturePlan

State = frozenset[tuple[str, str | None]]


@dataclass(frozen=True)
class Candidate:
    """A signature that leads out of a state: which generator must be active (None: a negation), which must not."""

    signature: str
    active: str | None
    quiet: frozenset[str]
    target: State


class NaiveTracker:
    """`as_events`: signatures come as events, as in a purely discrete model."""

    def __init__(self, plan: SignaturePlan, *, as_events: bool, guaranteed: frozenset[str]) -> None:
        self.plan, self.as_events, self.guaranteed = plan, as_events, guaranteed
        self.allowed: frozenset[str] | None = None  # the commands that may have been on; None: any
        self.des = plan.complementary or plan.des
        self.edges = eliminate_epsilon(self.des).edges

    def initial(self) -> State:
        return frozenset((location, None) for location in self.des.initial)

    def everything(self) -> State:
        return frozenset((location, None) for location in self.des.locations)

    def after_event(self, state: State, name: str) -> State:
        """An event is a γ; where signatures are events, also s, or γ and s at once, written `γ,s`."""
        if any(edge.output.gamma == name for edge in self.edges):
            return self._move(state, frozenset(), lambda edge: edge.output.gamma == name, waits=True)
        if name in {signature.name for signature in self.plan.signatures}:
            return self.after_signature(state, name)
        return self._move(state, frozenset(), lambda edge: without_command(edge) == name, waits=False)

    def after_signature(self, state: State, name: str) -> State:
        due: State = frozenset((location, None) for location, wait in state if wait == name)
        return self._move(state, due, lambda edge: edge.output[:2] == (None, name), waits=False)

    def _move(self, state: State, due: State, shows: Callable[[Edge], bool], *, waits: bool) -> State:
        settled = {location for location, wait in state if wait is None}
        waiting = {location for location, wait in state if wait is not None}
        for sources in (settled, waiting):
            taken = [edge for edge in self.edges if edge.source in sources and shows(edge) and self._permits(edge)]
            found = due | {(edge.target, edge.output.signature if waits else None) for edge in taken}
            if found:
                return self._without_useless(found)
        return frozenset()

    def _permits(self, edge: Edge) -> bool:
        return self.allowed is None or edge.output.command is None or edge.output.command in self.allowed

    def _without_useless(self, found: State) -> State:
        useless = len({location for location, _ in found}) == 1 or len({wait for _, wait in found}) == 1
        if self.as_events or not useless:
            return found
        return frozenset((location, None) for location, _ in found)

    def places(self, state: State) -> frozenset[str]:
        return frozenset(location for location, _ in state)

    def location(self, state: State) -> str | None:
        places = self.places(state) & set(self.plan.report.persistent)
        return next(iter(places)) if len(self.places(state)) == len(places) == 1 else None

    def is_provisional(self, state: State) -> bool:
        return self.location(state) is None and any(wait is not None for _, wait in state)

    def after_silence(self, state: State) -> State | str:
        """The state after a window of silence, "wait" or "inconsistent"."""
        settled = frozenset(pair for pair in state if pair[1] is None)
        if self.as_events or settled == state:
            return "wait"
        if settled:
            return settled
        sure = {signature.name for signature in self.plan.signatures if signature.location in self.guaranteed}
        return "inconsistent" if {wait for _, wait in state} <= sure else "wait"

    def candidates(self, state: State) -> Iterator[Candidate]:
        if self.as_events:
            return
        after = [(signature, self.after_signature(state, signature.name)) for signature in self.plan.signatures]
        reached = [(signature, target) for signature, target in after if target]
        possible = self.places(state).union(*(self.places(target) for _, target in reached))
        for signature, target in reached:
            others = possible - self.places(target)
            quiet = others & set(self.plan.generators)
            if signature.by == "residual":
                yield Candidate(signature.name, signature.location, quiet, target)
            elif quiet and quiet == others and target != state:
                yield Candidate(signature.name, None, quiet, target)


def event_names(tracker: NaiveTracker) -> set[str]:
    """Everything that may come as an event."""
    gammas: Iterable[str] = {edge.output.gamma for edge in tracker.edges if edge.output.gamma is not None}
    if not tracker.as_events:
        return set(gammas)
    signatures: Iterable[Signature] = tracker.plan.signatures
    return {*gammas, *(signature.name for signature in signatures), *map(without_command, tracker.edges)}


def without_command(edge: Edge) -> str:
    """What is seen of an edge beside the command."""
    return str(edge.output._replace(command=None))
