"""What happens in an execution: switches, the reason why it stopped, and the agenda of events to come.

Events without a guard come from outside.  Where the model's `simulation` lists requests, these are the only ones: a
queue in order of time, the first of which is waiting until a transition with its event can be taken.  Where it lists
none, each location is left after a stay drawn uniformly from its shortest to its longest dwell time (by default from
the observer's dwell time or 1 s, to three times that).
"""

from dataclasses import dataclass, field
from typing import Literal, TypeAlias

from deshybrid.diagnostics import Diagnostic, Span, diagnostic
from deshybrid.model.system import HybridSystem, HybridTransition, Location
from deshybrid.simulate.signals import EVENTS, stream

StopKind: TypeAlias = Literal["zeno", "simultaneous", "blocked", "invariant", "unstable", "crowded"]
DEFAULT_STAY = 1.0  # s

_CODES: dict[StopKind, tuple[str, str]] = {
    "zeno": ("DH0710", "give the locations a shortest stay, `dwell: {min: ...}`, or end the run before that time"),
    "simultaneous": ("DH0711", "separate the guards, or give the locations a shortest stay, `dwell: {min: ...}`"),
    "blocked": ("DH0712", "add a transition that is enabled there, or lengthen `dwell: {max: ...}`"),
    "invariant": ("DH0713", "add a transition that is enabled where the invariant ends, or widen the invariant"),
    "unstable": ("DH0714", "shorten the run, or check the signs in `A` and in the resets"),
    "crowded": ("DH0715", "choose a smaller step, or longer dwell times"),
}


@dataclass(frozen=True, slots=True)
class Switch:
    """One transition taken: when (s), which, and what was seen of it (None = nothing)."""

    time: float
    event: str
    source: str
    target: str
    output: str | None


@dataclass(frozen=True, slots=True)
class Stop:
    """Why an execution ended before its time: a value, not an exception.

    >>> Stop("blocked", 2.5, "no transition is enabled in `a`").diagnostic.code
    'DH0712'
    """

    kind: StopKind
    time: float
    message: str
    span: Span | None = field(default=None, compare=False, repr=False)

    @property
    def diagnostic(self) -> Diagnostic:
        """The reason as a coded message, pointing into the model file where there is one."""
        code, help_text = _CODES[self.kind]
        message = f"the execution stops at {self.time:.6g} s: {self.message}"
        return diagnostic(code, message, self.span, helps=(help_text,))


class Agenda:
    """Events from outside, still to come.  Remembers how many requests were met; everything else is fixed."""

    def __init__(self, system: HybridSystem, seed: int) -> None:
        self.requests = tuple(sorted(system.simulation.requests, key=lambda request: request[0]))
        self.requested = frozenset(event for _, event in self.requests)
        self.met = 0
        self._observer_dwell = system.observer.dwell
        self._generator = stream(seed, EVENTS)

    @property
    def head(self) -> tuple[float, str] | None:
        """The request that waits to be met: (time, event)."""
        return self.requests[self.met] if self.met < len(self.requests) else None

    @property
    def pending(self) -> tuple[tuple[float, str], ...]:
        """The requests that were not met."""
        return self.requests[self.met :]

    def meet(self, event: str, now: float) -> None:
        """Cross out the waiting request where a transition with its event was taken at or after its time."""
        if self.head is not None and self.head[1] == event and now >= self.head[0]:
            self.met += 1

    def draw_leave(self, location: Location, entered: float, exits: tuple[HybridTransition, ...]) -> float | None:
        """Return the time at which an unguarded transition will leave, or None where only requests or guards do."""
        if self.requests or all(exit_.guard is not None for exit_ in exits):
            return None
        longest = location.dwell.max
        shortest = location.dwell.min or min(self._observer_dwell or DEFAULT_STAY, longest or float("inf"))
        return entered + float(self._generator.uniform(shortest, longest or 3.0 * shortest))

    def choose(self, count: int) -> int:
        """Return one of `count` equally likely alternatives; nothing is drawn where there is no choice."""
        return 0 if count == 1 else int(self._generator.integers(count))
