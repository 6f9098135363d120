"""Which signatures the dynamics allow: from a hybrid system and its DES to candidates with a verdict per transition.

A signature s_q says that the plant has moved into q.  It is emitted by the residual generator of q (small residual), or
by negation (none of the other residuals is small).  For a transition p -> q the *alternatives* are p itself (nothing
happened yet, and its residual may still be small) and every r with a transition p -> r that may show the same output.
- by residual, q must be told from each alternative, and each alternative from q: the residual of q is then large
  outside q, and the others' are large in q;
- by negation it is enough that the others' residuals are large in q: q must be told from each alternative.
The verdict of a transition is the worst over its alternatives (`always`, `generic`, `never` of `linear.distinguish`).
A transition that may `never` be seen is left out of the candidate, with the reason.  In a self-loop p = q nothing
changes but the state: only a reset that the outputs of q show is seen, and negation never shows it.

A purely discrete model says nothing of the physics: every verdict is `unknown` and no transition is left out.
A detector that covers several locations is a device of its own: all of its verdicts are `unknown`.
Each transition that is left carries how easily it is confused, 1 / (1 + d) for the least typical distance d (`pairs`)
to an alternative: among the cheapest plans `recover` takes the one whose sum is least.

Cost: that of `pairs`, at most once for each pair of locations.
Source: Balluchi et al. (2012), section 4.1; joint observability: Vidal et al. (2003).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np

from deshybrid.des.automaton import DES
from deshybrid.des.signatures import Candidate
from deshybrid.detector.pairs import Feasibility, PairSeparation, alternatives, separations, worst_of
from deshybrid.model.abstraction import abstract
from deshybrid.model.system import CoveringDetector, HybridSystem, HybridTransition, SignatureCandidate

CONFUSION_DIGITS = 4
"""Digits that count after the point: smaller differences between plans are left to the order of declaration."""


@dataclass(frozen=True, slots=True)
class TransitionVerdict:
    """What residuals can say about one transition (its number in the DES); `reason` is one sentence.

    `confusion`: from 0, far from every alternative, to 1, not to be told from one of them.
    """

    transition: int
    residual: Feasibility
    negation: Feasibility
    reason: str
    confusion: float = 0.0


@dataclass(frozen=True, slots=True)
class FeasibleCandidate:
    """The candidate signature of one location or covering detector, with the verdict on all transitions into it.

    `candidate` holds the transitions that are left; with none left it offers a residual generator at most, which the
    negation of others may need.
    """

    candidate: Candidate
    verdicts: tuple[TransitionVerdict, ...]

    @property
    def location(self) -> str:
        """The location whose entry the signature shows."""
        return self.candidate.location

    @property
    def excluded(self) -> tuple[TransitionVerdict, ...]:
        """Verdicts on the transitions that no residual, and no negation, can show."""
        return tuple(verdict for verdict in self.verdicts if verdict.transition not in self.candidate.transitions)

    def feasibility(self, by: Literal["residual", "negation"], transitions: tuple[int, ...]) -> Feasibility:
        """Return the worst verdict over `transitions`, which an actual signature instruments."""
        chosen = (verdict for verdict in self.verdicts if verdict.transition in transitions)
        return worst_of(verdict.residual if by == "residual" else verdict.negation for verdict in chosen)


def discrete_candidates(des: DES) -> tuple[FeasibleCandidate, ...]:
    """Return one candidate per location, on all transitions that enter it, all `unknown`.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> [(entry.candidate.name, entry.candidate.transitions) for entry in discrete_candidates(des)]
    [('s_2', (1,)), ('s_5', (0,))]
    """
    verdict = _unknown("a discrete model says nothing of what the residuals of its locations can tell")
    return tuple(_candidate(des, SignatureCandidate(location), (), verdict) for location in des.locations)


def signature_candidates(
    system: HybridSystem, des: DES, pairs: tuple[PairSeparation, ...] | None = None
) -> tuple[FeasibleCandidate, ...]:
    """Return the candidate signatures of a model: those it names with their costs, or one per location at cost 1.

    `des` is the abstraction of `system`: transition i of the one is transition i of the other.  `pairs` are its
    `separations`, which are found where they are not given.  Transitions that the model forbids are not among the
    verdicts.  Nothing is raised: a location that no residual can show keeps a candidate without transitions, whose
    verdicts say why.

    >>> from deshybrid.model.abstraction import abstract
    >>> from deshybrid.model.load import loads
    >>> system = loads('''
    ... {format: deshybrid/1, name: pump, state: [h], output: [y], defaults: {C: [[1]]},
    ...  locations: {on: {A: [[-1]], f: [2]}, off: {A: [[-1]]}},
    ...  transitions: [{from: on, to: off, event: a, emits: null}, {from: off, to: on, event: b, emits: null}]}
    ... ''')
    >>> [(entry.candidate.name, entry.verdicts[0].residual) for entry in signature_candidates(system, abstract(system))]
    [('s_on', 'always'), ('s_off', 'always')]
    """
    wishes = system.signatures.candidates
    if wishes is None:
        wishes = tuple(SignatureCandidate(location) for location in des.locations)
    if system.is_discrete:
        verdict = _unknown("a discrete model says nothing of what the residuals of its locations can tell")
    else:
        verdict = _Physics(system, des, separations(system, des) if pairs is None else pairs).verdict
    forbid = system.signatures.forbid
    several = tuple(_covering(des, detector, forbid) for detector in system.signatures.detectors)
    return tuple(_candidate(des, wish, forbid, verdict) for wish in wishes) + several


class Offers(NamedTuple):
    """D_H of a model, the signatures that may be added to it, and how its locations are told apart."""

    des: DES
    candidates: tuple[FeasibleCandidate, ...]
    pairs: tuple[PairSeparation, ...]


def offers(model: HybridSystem | DES) -> Offers:
    """Return what a model offers to recovery; a DES says nothing of how its locations are told apart.

    >>> [entry.candidate.name for entry in offers(DES.from_transitions([("1", "a", "2", "α")])).candidates]
    ['s_1', 's_2']
    """
    if isinstance(model, DES):
        return Offers(model, discrete_candidates(model), ())
    des = abstract(model)
    pairs = separations(model, des)
    return Offers(des, signature_candidates(model, des, pairs), pairs)


def signature_name(des: DES, location: str) -> str:
    """Return `s_<location>`, with primes where an output of the model already has that name.

    >>> signature_name(DES.from_transitions([("1", "a", "2", "s_2")]), "2")
    "s_2'"
    """
    outputs = {gamma for transition in des.transitions for gamma in transition.outputs}
    name = f"s_{location}"
    while name in outputs:
        name += "'"
    return name


def _candidate(
    des: DES,
    wish: SignatureCandidate,
    forbid: tuple[tuple[str, str], ...],
    verdict: Callable[[int], TransitionVerdict],
) -> FeasibleCandidate:
    """Keep what a residual shows; where that is nothing, what negation shows."""
    verdicts = tuple(
        verdict(number)
        for number, transition in enumerate(des.transitions)
        if transition.target == wish.location and (transition.source, transition.target) not in forbid
    )
    residual = tuple(v.transition for v in verdicts if v.residual != "never") if wish.by != "negation" else ()
    negation = tuple(v.transition for v in verdicts if v.negation != "never") if wish.by != "residual" else ()
    transitions = residual or negation
    confusion = {v.transition: v.confusion for v in verdicts}
    candidate = Candidate(
        name=signature_name(des, wish.location),
        location=wish.location,
        transitions=transitions,
        cost=wish.cost,
        residual=wish.by != "negation" and transitions == residual,
        negation=wish.by != "residual" and set(transitions) <= set(negation),
        confusion=tuple(confusion[number] for number in transitions) if any(confusion.values()) else (),
    )
    return FeasibleCandidate(candidate, verdicts)


def _covering(des: DES, detector: CoveringDetector, forbid: tuple[tuple[str, str], ...]) -> FeasibleCandidate:
    verdict = _unknown(f"nothing is said of how the detector `{detector.name}` works")
    covers = tuple(location for location in des.locations if location in set(detector.covers))
    arcs = enumerate(des.transitions)
    taken = tuple(n for n, t in arcs if t.target in set(covers) and (t.source, t.target) not in forbid)
    candidate = Candidate.covering(signature_name(des, detector.name), covers, taken, cost=detector.cost)
    return FeasibleCandidate(candidate, tuple(verdict(number) for number in taken))


def _unknown(reason: str) -> Callable[[int], TransitionVerdict]:
    return lambda number: TransitionVerdict(number, "unknown", "unknown", reason)


class _Physics:
    """Verdicts from the dynamics, by pairs of locations."""

    def __init__(self, system: HybridSystem, des: DES, pairs: tuple[PairSeparation, ...]) -> None:
        self.system, self.des = system, des
        self.pairs = {name: pair for pair in pairs for name in ((pair.first, pair.second), (pair.second, pair.first))}

    def verdict(self, number: int) -> TransitionVerdict:
        """Return the verdict on transition `number`."""
        transition = self.des.transitions[number]
        if transition.source == transition.target:
            kick, why = self._kick(self.system.transitions[number])
            return TransitionVerdict(number, kick, "never", why)
        return self._against(number, transition.target, alternatives(self.des, transition))

    def _against(self, number: int, target: str, others: tuple[str, ...]) -> TransitionVerdict:
        residual: Feasibility = "always"
        negation: Feasibility = "always"
        reason = f"`{target}` always shows against " + ", ".join(f"`{name}`" for name in others)
        for other in others:
            for first, second in ((target, other), (other, target)):
                found, why = self._told_apart(first, second)
                if worst_of((found, residual)) != residual:
                    residual, reason = found, f"`{first}` against `{second}`: {why}"
            negation = worst_of((negation, self._told_apart(target, other)[0]))
        nearest = min(self.pairs[target, other].typical for other in others)
        return TransitionVerdict(number, residual, negation, reason, round(1.0 / (1.0 + nearest), CONFUSION_DIGITS))

    def _told_apart(self, first: str, second: str) -> tuple[Feasibility, str]:
        pair = self.pairs[first, second]
        forward = pair.first == first
        return (pair.forward, pair.reasons[0]) if forward else (pair.backward, pair.reasons[1])

    def _kick(self, loop: HybridTransition) -> tuple[Feasibility, str]:
        """A self-loop shows only where its reset moves the state in a direction that the outputs see."""
        from deshybrid.linear.observability import kalman_split

        dynamics, reset = self.system.location(loop.source).dynamics, loop.reset
        if dynamics is None or reset is None:
            return "never", "a self-loop changes no dynamics"
        split = kalman_split(dynamics.A, dynamics.C)
        seen = split.inverse[: split.observable_dimension]
        linear, offset = seen @ (reset.matrix - np.eye(len(reset.offset))), seen @ reset.offset
        if np.any(np.abs(linear) > 1e-12):
            return "generic", "a self-loop changes no dynamics; its reset shows unless it happens to keep the state"
        if np.any(np.abs(offset) > 1e-12):
            return "always", "a self-loop changes no dynamics; its reset shifts the outputs"
        return "never", "a self-loop changes no dynamics, and its reset changes nothing that the outputs see"


def feasibility(
    candidates: tuple[FeasibleCandidate, ...],
    location: str,
    by: Literal["residual", "negation"],
    transitions: tuple[int, ...],
) -> Feasibility:
    """Return the verdict on the signature of `location`: the worst over the transitions that it instruments.

    `never` where the location has no candidate.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> feasibility(discrete_candidates(des), "5", "residual", (0,))
    'unknown'
    """
    found = next((entry for entry in candidates if entry.location == location), None)
    return "never" if found is None else found.feasibility(by, transitions)


__all__ = [
    "Feasibility",
    "FeasibleCandidate",
    "TransitionVerdict",
    "alternatives",
    "discrete_candidates",
    "feasibility",
    "offers",
    "signature_candidates",
    "signature_name",
]
