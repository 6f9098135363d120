"""Candidate signatures: which transitions may be instrumented, how, and what a residual generator costs.

A signature s_q says that the plant has entered q.  By residual, the generator of q itself says so.  By negation,
nothing else can be the case: the detector knows that the plant was in p, so q is what remains when the generators of
all other alternatives, {p} and Reach(p), are silent.  What no command permits together with the transition is none of
its alternatives.  A self-loop changes nothing that silence could show, so there is no negation on it.

A *covering* candidate stands for one detector that announces the entry of any of several locations by one signature:
it says "one of these".  It is there with all of its transitions or not at all, costs what one generator costs, and is
never a negation, nor does its silence help another one.  A transition that several detectors announce carries all of
their signatures at once, joined by `+` in the order of the candidates.

In: a `DES` and `Candidate`s.  Out: `Option`s, each of which is a yes or no of the plan.
Cost: transitions times branching.  Source: Balluchi et al. (2012), sections 4.1 and 5.1.
"""

import math
from collections import Counter
from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from deshybrid.des.automaton import DES, Transition
from deshybrid.diagnostics import Diagnostic, UsageError, diagnostic, raise_all

TOGETHER = "+"


@dataclass(frozen=True, slots=True)
class Candidate:
    """A signature that may be used: `name` is emitted when `location` is entered by one of `transitions` (numbers).

    `cost` is the cost of a residual generator for `location` (the least one where several candidates name it).
    `residual`: such a generator can be built.  `negation`: the signature may also be obtained without it.  A candidate
    without transitions offers a generator only, which the negation of others may need.

    `covers`: the locations of a covering detector, which has `location` = these names joined by `|` (see `covering`).
    `confusion`: for each of `transitions` how easily it is taken for another, between 0 and 1; empty where not known.
    """

    name: str
    location: str
    transitions: tuple[int, ...]
    cost: float = 1.0
    residual: bool = True
    negation: bool = True
    covers: tuple[str, ...] = ()
    confusion: tuple[float, ...] = ()

    @classmethod
    def covering(
        cls, name: str, covers: Iterable[str], transitions: Iterable[int], *, cost: float = 1.0
    ) -> "Candidate":
        """Return one detector for all of `covers`: `name` is emitted when any of them is entered by `transitions`.

        >>> Candidate.covering("s_front", ["2", "5"], [0, 1], cost=2.0).location
        '2|5'
        """
        locations = tuple(covers)
        return cls(name, "|".join(locations), tuple(transitions), cost, negation=False, covers=locations)

    @property
    def generator(self) -> str:
        """What has to be there: the residual generator of a location, called by it, or a detector, by its name."""
        return self.name if self.covers else self.location

    @property
    def entered(self) -> tuple[str, ...]:
        """The locations whose entry the signature announces."""
        return self.covers or (self.location,)

    def confusion_of(self, transitions: Iterable[int]) -> float:
        """Return the sum of the confusions of some of its transitions; 0 where nothing is known of them."""
        known = dict(zip(self.transitions, self.confusion, strict=False))
        return sum(known.get(number, 0.0) for number in transitions)


@dataclass(frozen=True, slots=True)
class Option:
    """How `transitions` can carry the signature of candidate number `candidate`: one of them, or all that it covers.

    `negation`: the locations whose generators must be there for it, None where negation is not possible.
    """

    transitions: tuple[int, ...]
    candidate: int
    residual: bool
    negation: tuple[str, ...] | None
    covering: bool = False


def require_fitting(des: DES, candidates: tuple[Candidate, ...]) -> None:
    """Raise `UsageError` (DH0406) with everything in `candidates` that does not fit the system."""
    raise_all(_misfits(des, candidates), UsageError)


def generator_costs(des: DES, candidates: tuple[Candidate, ...]) -> dict[str, float]:
    """Return the cost of each residual generator, by location in order of declaration, then of covering detectors.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> generator_costs(des, (Candidate("s_5", "5", (0,), cost=2.0), Candidate("s_2", "2", (1,), residual=False)))
    {'5': 2.0}
    """
    offers: dict[str, list[float]] = {location: [] for location in des.locations}
    for candidate in candidates:
        if candidate.residual:
            offers.setdefault(candidate.generator, []).append(candidate.cost)
    return {generator: min(costs) for generator, costs in offers.items() if costs}


def options(des: DES, candidates: tuple[Candidate, ...]) -> tuple[Option, ...]:
    """Return what can be instrumented, and how, ordered by transition; transitions that cannot be are left out.

    Covering detectors come last, in the order of the candidates.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> options(des, (Candidate("s_5", "5", (0,)), Candidate("s_2", "2", (1,), residual=False)))
    (Option(transitions=(0,), candidate=0, residual=True, ...), Option(..., residual=False, negation=('5',), ...))
    """
    available = generator_costs(des, candidates)
    rivals = _rivals(des)
    found, covering = [], []
    for index, candidate in enumerate(candidates):
        if candidate.covers:
            covering += [Option(candidate.transitions, index, True, None, True)] if candidate.transitions else []
            continue
        for number in candidate.transitions:
            source = des.transitions[number].source
            alternatives = {source, *(t.target for t in rivals[source] if t.coincides(des.transitions[number]))}
            others = tuple(name for name in des.locations if name in alternatives - {candidate.location})
            deniable = candidate.negation and source != candidate.location and all(name in available for name in others)
            if candidate.residual or deniable:
                found.append(Option((number,), index, candidate.residual, others if deniable else None))
    return (*sorted(found, key=lambda option: option.transitions), *covering)


def _rivals(des: DES) -> dict[str, list[Transition]]:
    """The transitions out of each location, one for each target and commands."""
    leaving: dict[str, dict[tuple[object, ...], Transition]] = {location: {} for location in des.locations}
    for transition in des.transitions:
        leaving[transition.source].setdefault((transition.target, transition.commands), transition)
    return {location: list(found.values()) for location, found in leaving.items()}


def joint_signatures(candidates: tuple[Candidate, ...], chosen: Iterable[Option]) -> dict[int, str]:
    """Return the signature that each transition (number) carries under the `chosen` options; several are joined.

    >>> both = (Candidate("s_5", "5", (0,)), Candidate.covering("s_any", ["2", "5"], [0, 1]))
    >>> joint_signatures(both, [Option((0,), 0, True, None), Option((0, 1), 1, True, None, covering=True)])
    {0: 's_5+s_any', 1: 's_any'}
    """
    names: dict[int, list[str]] = {}
    for option in sorted(chosen, key=lambda option: option.candidate):
        for number in option.transitions:
            names.setdefault(number, []).append(candidates[option.candidate].name)
    return {number: TOGETHER.join(names[number]) for number in sorted(names)}


def _misfits(des: DES, candidates: tuple[Candidate, ...]) -> Iterator[Diagnostic]:
    for candidate in candidates:
        for problem in _own_problems(des, candidate):
            yield diagnostic("DH0406", f"candidate `{candidate.name}` {problem}")
    names = Counter(candidate.name for candidate in candidates)
    users = Counter(number for candidate in candidates if not candidate.covers for number in candidate.transitions)
    yield from (diagnostic("DH0406", f"candidate `{name}` is given {n} times") for name, n in names.items() if n > 1)
    for number, count in users.items():
        if count > 1:
            yield diagnostic("DH0406", f"transition number {number} is given {count} times among the candidates")
    if any(candidate.covers for candidate in candidates):
        for name in names:
            if TOGETHER in name:
                text = f"candidate `{name}` has a `{TOGETHER}` in its name, which joins signatures that come together"
                yield diagnostic("DH0406", text)


def _own_problems(des: DES, candidate: Candidate) -> Iterator[str]:
    for location in candidate.entered:
        if location not in des.locations:
            yield f"names the unknown location `{location}`"
    if not (math.isfinite(candidate.cost) and candidate.cost >= 0):
        yield f"costs {candidate.cost}, expected a finite number that is not negative"
    yield from _covering_problems(des, candidate) if candidate.covers else ()
    if candidate.confusion and len(candidate.confusion) != len(candidate.transitions):
        yield f"has {len(candidate.confusion)} confusions for {len(candidate.transitions)} transitions"
    for number in candidate.transitions:
        if not 0 <= number < len(des.transitions):
            yield f"names transition number {number}, the system has {len(des.transitions)}"
        elif des.transitions[number].target not in candidate.entered:
            yield f"is for location `{candidate.location}`, but {des.transitions[number]} leads elsewhere"
        elif des.transitions[number].signature is not None:
            yield f"is for {des.transitions[number]}, which carries a signature already"


def _covering_problems(des: DES, candidate: Candidate) -> Iterator[str]:
    if len(set(candidate.covers)) < len(candidate.covers):
        yield "covers a location twice"
    if len(set(candidate.transitions)) < len(candidate.transitions):
        yield "names a transition twice"
    if candidate.location != "|".join(candidate.covers):
        yield f"has the location `{candidate.location}`, expected the covered ones joined by `|`"
    if candidate.negation or not candidate.residual:
        yield "covers several locations, which a detector of its own does, not a negation"
    if candidate.name in des.locations:
        yield "has the name of a location, which a residual generator goes by"


__all__ = ["TOGETHER", "Candidate", "Option", "generator_costs", "joint_signatures", "options", "require_fitting"]
