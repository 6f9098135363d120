"""Opacity: whether someone who sees the outputs can ever be sure that the location now, or at the start, is secret.

Current-state opaque: after no output word is the current estimate a set of secret locations only.
Initial-state opaque: after no output word is the initial estimate a set of secret locations only.
A word that the system cannot show betrays nothing.  The observer knows the system and the initial set.

In: a `DES` and its secret locations.  Out: an `OpacityReport`, with a shortest word that betrays the secret.
Idea: the observer of closed estimates, of the reversed system for the start; the search stops at the first such set.
Cost: up to 2^|Q| sets; both problems are PSPACE-complete.
Source: Saboori and Hadjicostis (2007), current-state opacity; Saboori and Hadjicostis (2013), initial-state opacity; Wu
and Lafortune (2013), the reversed observer.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from deshybrid.des.automaton import DES
from deshybrid.des.bitsets import mask_of, names_of
from deshybrid.des.estimates import closed_sets
from deshybrid.des.operations import reverse
from deshybrid.des.runs import known_locations, shortest_run
from deshybrid.des.search import find_first, labels_to
from deshybrid.des.witness import Step


@dataclass(frozen=True, slots=True)
class OpacityReport:
    """Whether a secret is kept; where it is not: a shortest word after which the `estimate` is secret locations only.

    `run` is a run that shows the word; it ends (for initial-state opacity: starts) in a secret location, as all do.
    """

    opaque: bool
    outputs: tuple[str, ...] | None = None
    estimate: tuple[str, ...] = ()
    run: tuple[Step, ...] = ()


def current_state_opacity(des: DES, *, secret: Iterable[str], max_states: int | None = 100_000) -> OpacityReport:
    """Return whether no output word betrays that the system is in a `secret` location now.

    Up to 2^|Q| states, found on the fly.  Raises `LimitReached` (DH0901) beyond `max_states`, `UsageError` (DH0404).
    Source: Saboori and Hadjicostis (2007).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("1", "b", "3", "α"), ("3", "c", "2", "γ")], initial=["1"])
    >>> current_state_opacity(des, secret=["3"]).opaque
    True
    >>> report = current_state_opacity(des, secret=["2"])
    >>> report.outputs, report.estimate, [step.event for step in report.run[1:]]
    (('α', 'γ'), ('2',), ['b', 'c'])
    """
    sets = closed_sets(des)
    public = ~mask_of(des.locations, known_locations(des, secret, "secret"))
    graph, goal = find_first(
        [sets.initial], sets.successors, lambda mask: mask != 0 and not mask & public, limit=max_states, what=_WHAT
    )
    if goal is None:
        return OpacityReport(True)
    outputs = tuple(str(output) for output in labels_to(graph, goal))
    estimate = sets.names(graph.nodes[goal])
    return OpacityReport(False, outputs, estimate, shortest_run(des, outputs, end=estimate) or ())


def initial_state_opacity(des: DES, *, secret: Iterable[str], max_states: int | None = 100_000) -> OpacityReport:
    """Return whether no output word betrays that the system was in a `secret` location at the start.

    Up to 2^|Q| states, found on the fly.  Raises `LimitReached` (DH0901) beyond `max_states`, `UsageError` (DH0404).
    Source: Saboori and Hadjicostis (2013); Wu and Lafortune (2013).

    >>> rows = [("1", "a", "3", "α"), ("2", "a", "3", "α"), ("1", "b", "3", "β")]
    >>> des = DES.from_transitions(rows, initial=["1", "2"])
    >>> initial_state_opacity(des, secret=["2"]).opaque
    True
    >>> report = initial_state_opacity(des, secret=["1"])
    >>> report.outputs, report.estimate
    (('β',), ('1',))
    """
    back = closed_sets(reverse(des))  # the locations from which a word can be shown: from all, against the arcs
    start = mask_of(des.locations, des.initial)
    public = ~mask_of(des.locations, known_locations(des, secret, "secret"))
    graph, goal = find_first(
        [back.initial],
        back.successors,
        lambda mask: mask & start != 0 and not mask & start & public,
        limit=max_states,
        what=_WHAT,
    )
    if goal is None:
        return OpacityReport(True)
    outputs = tuple(str(output) for output in labels_to(graph, goal)[::-1])
    estimate = names_of(des.locations, graph.nodes[goal] & start)
    return OpacityReport(False, outputs, estimate, shortest_run(des, outputs, start=estimate) or ())


_WHAT = "observer states"

__all__ = ["OpacityReport", "current_state_opacity", "initial_state_opacity"]
