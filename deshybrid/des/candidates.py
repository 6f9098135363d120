"""Candidate signatures: which transitions may be instrumented, how, and what a residual generator costs.

A signature s_q says that the plant has entered q.  By residual, the generator of q itself says so.  By negation,
nothing else can be the case: the detector knows that the plant was in p, so q is what remains when the generators of
all other alternatives, {p} and Reach(p), are silent.  A self-loop changes nothing that silence could show, so there is
no negation on it.

In: a `DES` and `Candidate`s.  Out: `Option`s, one for each transition that can be instrumented.
Cost: transitions times branching.  Source: Balluchi et al. (2012), sections 4.1 and 5.1.
"""

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass

from deshybrid.des.automaton import DES
from deshybrid.diagnostics import Diagnostic, UsageError, diagnostic, raise_all


@dataclass(frozen=True, slots=True)
class Candidate:
    """A signature that may be used: `name` is emitted when `location` is entered by one of `transitions` (numbers).

    `cost` is the cost of a residual generator for `location` (the least one where several candidates name it).
    `residual`: such a generator can be built.  `negation`: the signature may also be obtained without it.  A candidate
    without transitions offers a generator only, which the negation of others may need.
    """

    name: str
    location: str
    transitions: tuple[int, ...]
    cost: float = 1.0
    residual: bool = True
    negation: bool = True


@dataclass(frozen=True, slots=True)
class Option:
    """How transition number `transition` can carry the signature of candidate number `candidate`.

    `negation`: the locations whose generators must be there for it, None where negation is not possible.
    """

    transition: int
    candidate: int
    residual: bool
    negation: tuple[str, ...] | None


def require_fitting(des: DES, candidates: tuple[Candidate, ...]) -> None:
    """Raise `UsageError` (DH0406) with everything in `candidates` that does not fit the system."""
    raise_all(_misfits(des, candidates), UsageError)


def generator_costs(des: DES, candidates: tuple[Candidate, ...]) -> dict[str, float]:
    """Return the cost of a residual generator for each location that can have one, in order of declaration.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> generator_costs(des, (Candidate("s_5", "5", (0,), cost=2.0), Candidate("s_2", "2", (1,), residual=False)))
    {'5': 2.0}
    """
    offers: dict[str, list[float]] = {location: [] for location in des.locations}
    for candidate in candidates:
        if candidate.residual:
            offers[candidate.location].append(candidate.cost)
    return {location: min(costs) for location, costs in offers.items() if costs}


def options(des: DES, candidates: tuple[Candidate, ...]) -> tuple[Option, ...]:
    """Return what can be instrumented, and how, ordered by transition; transitions that cannot be are left out.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> options(des, (Candidate("s_5", "5", (0,)), Candidate("s_2", "2", (1,), residual=False)))
    (Option(transition=0, candidate=0, residual=True, negation=None), Option(..., residual=False, negation=('5',)))
    """
    available = generator_costs(des, candidates)
    alternatives = {location: {location} for location in des.locations}
    for transition in des.transitions:
        alternatives[transition.source].add(transition.target)
    found = []
    for index, candidate in enumerate(candidates):
        for number in candidate.transitions:
            source = des.transitions[number].source
            others = tuple(name for name in des.locations if name in alternatives[source] - {candidate.location})
            deniable = candidate.negation and source != candidate.location and all(name in available for name in others)
            if candidate.residual or deniable:
                found.append(Option(number, index, candidate.residual, others if deniable else None))
    return tuple(sorted(found, key=lambda option: option.transition))


def _misfits(des: DES, candidates: tuple[Candidate, ...]) -> Iterator[Diagnostic]:
    for candidate in candidates:
        for problem in _own_problems(des, candidate):
            yield diagnostic("DH0406", f"candidate `{candidate.name}` {problem}")
    names = Counter(candidate.name for candidate in candidates)
    users = Counter(number for candidate in candidates for number in candidate.transitions)
    yield from (diagnostic("DH0406", f"candidate `{name}` is given {n} times") for name, n in names.items() if n > 1)
    for number, count in users.items():
        if count > 1:
            yield diagnostic("DH0406", f"transition number {number} is given {count} times among the candidates")


def _own_problems(des: DES, candidate: Candidate) -> Iterator[str]:
    if candidate.location not in des.locations:
        yield f"names the unknown location `{candidate.location}`"
    if not (math.isfinite(candidate.cost) and candidate.cost >= 0):
        yield f"costs {candidate.cost}, expected a finite number that is not negative"
    for number in candidate.transitions:
        if not 0 <= number < len(des.transitions):
            yield f"names transition number {number}, the system has {len(des.transitions)}"
        elif des.transitions[number].target != candidate.location:
            yield f"is for location `{candidate.location}`, but {des.transitions[number]} leads elsewhere"
        elif des.transitions[number].signature is not None:
            yield f"is for {des.transitions[number]}, which carries a signature already"


__all__ = ["Candidate", "Option", "generator_costs", "options", "require_fitting"]
