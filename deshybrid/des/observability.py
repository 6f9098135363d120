"""Current-location observability of a DES: conditions C1 and C2, the bound K, and a run that proves a "no".

C1: every exit transition of every persistent location shows something, whichever of its outputs occurs.
C2: every persistent location q is in a persistent state of D_O, and all of these are {q}.
The system is current-location observable exactly where both hold: from some transition on the location is known
whatever happens.  Both are statements about runs that go on; where a run can end (`alive` is false) they are judged all
the same, on the runs that do go on, and the report says so separately.

Two methods decide C2 and agree on every location, whether C1 holds or not:
- "observer" reads it from D_O, exponential in the worst case, and keeps D_O;
- "pairs": a persistent state of D_O contains p and q together exactly where the pair (p, q) is reachable from a cycle
  of the pair automaton, and contains q at all exactly where (q, q) is.
- "auto" takes the observer up to a modest number of states, the fewer the more locations there are, else the pairs.

A limit of time or memory is no answer: then some pairs of locations are looked at, as many as a moment allows, since
cycles among them prove a "no" as well as all would.

Source: Balluchi et al. (2012), section 3.1, Definition 3 and Theorem 4.
"""

from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, get_args

from deshybrid.des.automaton import DES
from deshybrid.des.cycles import longest_path_to
from deshybrid.des.epsilon import OutputAutomaton, eliminate_epsilon
from deshybrid.des.observer import LocationObserver, build_location_observer
from deshybrid.des.pairs import PairSearch, PersistentPairs
from deshybrid.des.persistence import blocked_locations, persistent_locations
from deshybrid.des.report import C2Failure, ObservabilityReport, Undecided, UndecidedCheck
from deshybrid.des.verdicts import verdict_diagnostics
from deshybrid.des.witness import Step, Witness, c1_witness, c2_witness, find_confusion
from deshybrid.des.worklist import Graph
from deshybrid.diagnostics import LimitReached, OutOfResources, UsageError, check_limits, diagnostic, within
from deshybrid.diagnostics.limits import last_moments, out_of_memory

Method: TypeAlias = Literal["auto", "observer", "pairs"]
_MODEST = 2_000  # states of D_O that "auto" is ready to build
_MODEST_MEMBERS = 6_000_000  # locations in all of these states together: so large systems get fewer
_PATIENCE = 10_000  # pairs between two looks at the clock and at the memory
_LAST_LOOK = 2.0  # seconds, to see what is known when a limit was reached


@dataclass(frozen=True, slots=True)
class _Findings:
    """What one method found: C2 failures, the most outputs after which two locations are possible, why this method."""

    c2_failures: tuple[C2Failure, ...]
    longest_confusion: int | None
    reason: str
    observer: LocationObserver | None = None
    pairs: PersistentPairs | None = None
    limit: LimitReached | None = None


def check_observability(
    des: DES,
    *,
    method: Method = "auto",
    max_states: int = 100_000,
    timeout: float | None = None,
    max_memory: int | None = None,
) -> ObservabilityReport:
    """Return whether `des` is current-location observable, and why not (Balluchi et al., 2012, Theorem 4).

    `max_states` limits D_O, `timeout` the seconds, `max_memory` the bytes of the whole process (None: what it holds,
    and half of what is available).  A limit that is reached after the answer "no" is told in the report; one that comes
    before the answer raises `UndecidedCheck`, a `LimitReached` with what is known so far: DH0901 where the method
    "observer" finds more states, DH0903 for time, DH0904 for memory.  Raises `UsageError` (DH0407) for another method.

    K counts outputs, that is transitions of D'_H and of D_O; where no transition is silent these are the transitions of
    Definition 3.  It is one more than the longest path of the pair automaton to a pair of different locations.

    >>> fig2 = DES.from_transitions([("1", "c", "3", None), ("3", "a", "0", "α"), ("0", "a", "2", "α"),
    ...     ("2", "d", "5", None), ("5", "a", "2", "α"), ("2", "b", "0", "β"), ("0", "d", "5", "δ")], name="fig2")
    >>> print(check_observability(fig2))
    fig2: not current-location observable
      persistent locations: 0, 2, 5
      C1 fails: 2 -d/ε-> 5
      checked by the location observer, 5 states: the automatic choice up to 2000
    """
    if method not in get_args(Method):
        raise UsageError(diagnostic("DH0407", f"unknown method `{method}`", helps=("write auto, observer or pairs",)))
    automaton = eliminate_epsilon(des)
    persistent, blocked = persistent_locations(des), blocked_locations(des)
    alive_in = set(persistent)
    c1_failures = [i for i, t in enumerate(des.transitions) if t.source in alive_in and not t.is_observable]
    search = PairSearch(automaton)
    with within(timeout=timeout, memory=max_memory):
        findings = _find_what_limits_allow(search, persistent, method, max_states)
        findings, witness = _with_witness(automaton, c1_failures, findings)
    observable = not c1_failures and not findings.c2_failures
    report = ObservabilityReport(
        des=des,
        automaton=automaton,
        observer=findings.observer,
        alive=not blocked,
        blocked=blocked,
        persistent=persistent,
        c1_failures=tuple(des.transitions[number] for number in c1_failures),
        c2_failures=findings.c2_failures,
        transient_bound=_bound(findings.longest_confusion) if observable and findings.limit is None else None,
        witness=witness,
        method="pairs" if findings.observer is None else "observer",
        method_reason=findings.reason,
        undecided=None if findings.limit is None else _undecided(findings.limit, search),
    )
    if findings.limit is not None and report.current_location_observable is None:
        raise UndecidedCheck(report, findings.limit) from findings.limit
    return report


def _find_what_limits_allow(
    search: PairSearch, persistent: tuple[str, ...], method: Method, max_states: int
) -> _Findings:
    """What the method finds; where a limit ends it, what cycles among a few pairs of locations prove."""
    try:
        return _find(search, persistent, method, max_states)
    except LimitReached as error:
        limit = error.with_traceback(None)  # which would hold all that was built
    except MemoryError:
        limit = out_of_memory("an allocation failed")
    found: tuple[C2Failure, ...] = ()
    pairs = None
    with suppress(LimitReached, MemoryError), last_moments(_LAST_LOOK):
        pairs = search.some()
        found = tuple(f for f in _pair_failures(search.automaton, persistent, pairs) if f.observer_states)
    return _Findings(found, None, "a limit was reached", pairs=pairs, limit=limit)


def _undecided(limit: LimitReached, search: PairSearch) -> Undecided:
    return Undecided(limit.diagnostics[0].message, search.seen)


def _find(search: PairSearch, persistent: tuple[str, ...], method: Method, max_states: int) -> _Findings:
    asked = "the method asked for"
    if method == "pairs":
        return _find_by_pairs(search, persistent, asked)
    if method == "observer":
        return _find_by_observer(search.automaton, persistent, asked, max_states)
    modest = min(max_states, _MODEST, _MODEST_MEMBERS // max(len(search.automaton.des.locations), 1) + 1)
    try:
        return _find_by_observer(search.automaton, persistent, f"the automatic choice up to {modest}", modest)
    except OutOfResources:
        raise
    except LimitReached:
        pass  # what was built is given up before the pairs come
    return _find_by_pairs(search, persistent, f"the location observer has more than {modest} states")


def _find_by_observer(
    automaton: OutputAutomaton, persistent: tuple[str, ...], reason: str, max_states: int
) -> _Findings:
    observer = build_location_observer(automaton, max_states=max_states)
    lasting: dict[str, list[tuple[str, ...]]] = {location: [] for location in automaton.des.locations}
    for state in (observer.states[number] for number in observer.persistent):
        for location in state:
            lasting[location].append(state)
    failures = _failures(persistent, lasting)
    if failures:
        return _Findings(failures, None, reason, observer)
    graph = Graph(observer.states, observer.transitions, ())
    several = [number for number, state in enumerate(observer.states) if len(state) > 1]
    return _Findings(failures, longest_path_to(graph, several), reason, observer)


def _find_by_pairs(search: PairSearch, persistent: tuple[str, ...], reason: str) -> _Findings:
    pairs = search.all()
    failures = _pair_failures(search.automaton, persistent, pairs)
    return _Findings(failures, None if failures else pairs.longest_confusion, reason, None, pairs)


def _pair_failures(
    automaton: OutputAutomaton, persistent: tuple[str, ...], pairs: PersistentPairs
) -> tuple[C2Failure, ...]:
    names = automaton.des.locations
    lasting: dict[str, list[tuple[str, ...]]] = {location: [] for location in names}
    for number, (p, q) in enumerate(pairs):
        if not number % _PATIENCE:
            check_limits()
        state = (names[p],) if p == q else (names[p], names[q])
        for location in state:
            lasting[location].append(state)
    return _failures(persistent, lasting)


def _failures(persistent: tuple[str, ...], lasting: dict[str, list[tuple[str, ...]]]) -> tuple[C2Failure, ...]:
    """C2 from the persistent states (or pairs) that contain each location."""
    return tuple(
        C2Failure(location, tuple(state for state in lasting[location] if len(state) > 1))
        for location in persistent
        if lasting[location] != [(location,)]
    )


def _bound(longest_confusion: int | None) -> int:
    return 0 if longest_confusion is None else longest_confusion + 1


def _with_witness(
    automaton: OutputAutomaton, c1_failures: list[int], findings: _Findings
) -> tuple[_Findings, Witness | None]:
    """The witness of a "no", and the findings; after a limit there are a few moments left to look for one."""
    if findings.limit is None:
        try:
            return findings, _witness(automaton, c1_failures, findings)
        except LimitReached as limit:
            findings = replace(findings, limit=limit)
    with suppress(LimitReached, MemoryError), last_moments(_LAST_LOOK):
        return findings, _witness(automaton, c1_failures, findings)
    return findings, None


def _witness(automaton: OutputAutomaton, c1_failures: list[int], findings: _Findings) -> Witness | None:
    """C1 first: a location that is never entered visibly fails C2 too, but it is C1 that has a run to show."""
    if c1_failures:
        return c1_witness(automaton, c1_failures[0])
    confused, lasts = _confused_pairs(automaton, findings)
    return None if confused is None else c2_witness(automaton, find_confusion(automaton, confused, lasts))


def _confused_pairs(
    automaton: OutputAutomaton, findings: _Findings
) -> tuple[tuple[int, int] | None, Callable[[int, int], bool]]:
    """The first persistent pair of different locations, and which pairs are persistent: D_O knows it as well."""
    if findings.pairs is not None:
        return findings.pairs.first_confused(), findings.pairs.holds
    number = {name: index for index, name in enumerate(automaton.des.locations)}
    observer = findings.observer
    states = [] if observer is None else [observer.states[state] for state in observer.persistent]
    together = [0] * len(number)
    for state in states:
        mask = sum(1 << number[name] for name in state)
        for name in state:
            together[number[name]] |= mask
    confused = min(((number[state[0]], number[state[1]]) for state in states if len(state) > 1), default=None)
    return confused, lambda p, q: bool(together[p] >> q & 1)


__all__ = [
    "C2Failure",
    "Method",
    "ObservabilityReport",
    "Step",
    "Undecided",
    "UndecidedCheck",
    "Witness",
    "check_observability",
    "verdict_diagnostics",
]
