"""What a check of current-location observability says, as a value: verdict, failures, bound, witness.

Source: Balluchi et al. (2012), section 3.1, Theorem 4.
"""

from dataclasses import dataclass, replace
from typing import Literal

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.observer import LocationObserver
from deshybrid.des.witness import Witness
from deshybrid.diagnostics import LimitReached
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
class Undecided:
    """A limit that ended a check: its message, and the pairs of locations that had been looked at."""

    reason: str
    pairs_seen: int

    def __str__(self) -> str:
        return f"{self.reason}; {_count(self.pairs_seen, 'pair')} of locations seen"


@dataclass(frozen=True, slots=True)
class ObservabilityReport(Explained):
    """The answer of `check_observability`; everything in order of declaration.

    `transient_bound` is K, where the verdict is yes: the fewest outputs after which every entry estimate is a single
    location, for good (0 where the start set is one location and no output ever leaves a doubt); else None.
    `observer` is None where the method was "pairs"; `method_reason` says why the method was taken.  `witness` is None
    where the verdict is yes, or where `undecided` says so.
    `undecided`: the limit that was reached before C2 was decided for all locations, else None.  C1 is decided all the
    same, and each of the `c2_failures` is one, but there may be more of them.
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
    undecided: Undecided | None = None

    @property
    def current_location_observable(self) -> bool | None:
        """True where C1 and C2 hold (Theorem 4); whether the system is alive is another question, see `alive`.

        None where a limit came before the answer: only the report that an `UndecidedCheck` carries says so.
        """
        if self.c1_failures or self.c2_failures:
            return False
        return None if self.undecided else True

    def __str__(self) -> str:
        verdict = {True: "current-location observable", False: "not current-location observable", None: "undecided"}
        lines = [
            f"{self.des.name}: {verdict[self.current_location_observable]}",
            f"  persistent locations: {', '.join(self.persistent) or 'none'}",
        ]
        if self.transient_bound is not None:
            lines.append(f"  the location is known after {_count(self.transient_bound, 'output')}")
        if not self.alive:
            lines.append(f"  not alive, runs end in: {', '.join(self.blocked)}")
        lines += [f"  C1 fails: {transition}" for transition in self.c1_failures]
        if self.undecided and not self.c1_failures:
            lines.append("  C1 holds")
        for failure in self.c2_failures:
            states = " ".join("{" + ",".join(state) + "}" for state in failure.observer_states)
            lines.append(f"  C2 fails: {failure.location} {'in ' + states if states else 'is never entered visibly'}")
        if self.undecided:
            lines.append(f"  {'more may fail' if self.c2_failures else 'C2 is not decided'}: {self.undecided}")
        return "\n".join([*lines, f"  checked {self._way()}: {self.method_reason}"])

    def _way(self) -> str:
        if self.observer is None:
            return "by pairs of locations"
        return f"by the location observer, {_count(len(self.observer.states), 'state')}"

    def __repr__(self) -> str:
        return (
            f"<ObservabilityReport of {self.des.name}: observable={self.current_location_observable}, "
            f"alive={self.alive}, C1 failures={len(self.c1_failures)}, C2 failures={len(self.c2_failures)}, "
            f"K={self.transient_bound}, method={self.method}>"
        )


class UndecidedCheck(LimitReached):
    """A limit came before the verdict; `report` holds what is known so far, the diagnostics say which limit it was."""

    def __init__(self, report: ObservabilityReport, limit: LimitReached) -> None:
        facts = (f"C1 holds, C2 is not decided: {report.undecided}",)
        super().__init__(*(replace(d, notes=d.notes + facts) for d in limit.diagnostics))
        self.report = report


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}" if number == 1 else f"{number} {noun}s"


__all__ = ["C2Failure", "ObservabilityReport", "Undecided", "UndecidedCheck"]
