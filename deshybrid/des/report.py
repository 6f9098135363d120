"""What a check of current-location observability says, as a value: verdict, failures, bound, witness.

Source: Balluchi et al. (2012), section 3.1, Theorem 4.
"""

from dataclasses import dataclass
from typing import Literal

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.observer import LocationObserver
from deshybrid.des.witness import Witness
from deshybrid.diagnostics.pictured import Explained


@dataclass(frozen=True, slots=True)
class C2Failure:
    """A persistent location that the observer cannot name for ever.

    `observer_states`: the persistent states of D_O with several locations that contain it; by the pair method, each
    location it is confused with as a set of two.  Empty where no persistent state of D_O contains the location at all:
    after a while it is entered by silent moves only (C1 then fails as well).
    """

    location: str
    observer_states: tuple[tuple[str, ...], ...]


@dataclass(frozen=True, slots=True)
class ObservabilityReport(Explained):
    """The answer of `check_observability`; everything in order of declaration.

    `transient_bound` is K, where the verdict is yes: the fewest outputs after which every entry estimate is a single
    location, for good (0 where the start set is one location and no output ever leaves a doubt); else None.
    `observer` is None where the method was "pairs"; `method_reason` says why the method was taken.  `witness` is None
    exactly where the verdict is yes.
    """

    des: DES
    automaton: OutputAutomaton
    observer: LocationObserver | None
    alive: bool
    blocked: tuple[str, ...]
    persistent: tuple[str, ...]
    c1_failures: tuple[Transition, ...]
    c2_failures: tuple[C2Failure, ...]
    transient_bound: int | None
    witness: Witness | None
    method: Literal["observer", "pairs"]
    method_reason: str

    @property
    def current_location_observable(self) -> bool:
        """True where C1 and C2 hold (Theorem 4); whether the system is alive is another question, see `alive`."""
        return not self.c1_failures and not self.c2_failures

    def __str__(self) -> str:
        verdict = "" if self.current_location_observable else "not "
        lines = [
            f"{self.des.name}: {verdict}current-location observable",
            f"  persistent locations: {', '.join(self.persistent) or 'none'}",
        ]
        if self.transient_bound is not None:
            lines.append(f"  the location is known after {_count(self.transient_bound, 'output')}")
        if not self.alive:
            lines.append(f"  not alive, runs end in: {', '.join(self.blocked)}")
        lines += [f"  C1 fails: {transition}" for transition in self.c1_failures]
        for failure in self.c2_failures:
            states = " ".join("{" + ",".join(state) + "}" for state in failure.observer_states)
            lines.append(f"  C2 fails: {failure.location} {'in ' + states if states else 'is never entered visibly'}")
        if self.observer is None:
            method = "by pairs of locations"
        else:
            method = f"by the location observer, {_count(len(self.observer.states), 'state')}"
        return "\n".join([*lines, f"  checked {method}: {self.method_reason}"])

    def __repr__(self) -> str:
        return (
            f"<ObservabilityReport of {self.des.name}: observable={self.current_location_observable}, "
            f"alive={self.alive}, C1 failures={len(self.c1_failures)}, C2 failures={len(self.c2_failures)}, "
            f"K={self.transient_bound}, method={self.method}>"
        )


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


__all__ = ["C2Failure", "ObservabilityReport"]
