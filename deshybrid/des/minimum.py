"""All cheapest sets of signatures: every choice with the least cost of generators and the fewest transitions.

In: a `DES` and candidates.  Out: `MinimumSets`.  Idea: the search of `hitting` settles the first two objectives; then
every choice that succeeds is forbidden, and the next one asked for, until there is none.
Cost: one 0/1 program for each set, and for each round of new demands.
Source: Moreno-Centeno and Karp (2013), with the usual cuts.
"""

import time
from dataclasses import dataclass

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate
from deshybrid.des.hitting import Choice, Search
from deshybrid.des.plan import Signature
from deshybrid.des.program import Program, Row, Selection, build_program
from deshybrid.des.separation import separation
from deshybrid.des.signatures import SignaturePlan, recover_observability, signatures_of
from deshybrid.diagnostics import Diagnostic, LimitReached, diagnostic

MOST_SETS = 100


@dataclass(frozen=True, slots=True)
class MinimumSet:
    """One cheapest set: its signatures, and the generators (locations, or names of detectors) that they take."""

    signatures: tuple[Signature, ...]
    generators: tuple[str, ...]

    def __str__(self) -> str:
        names = ",".join(signature.name for signature in self.signatures)
        return f"{{{names}}} with {', '.join(self.generators) or 'no generator'}"


@dataclass(frozen=True, slots=True)
class MinimumSets:
    """All cheapest sets, in the order of their generators and transitions; `complete`: there are no others.

    `plan` is one of them, with its proof; without a recoverable system there is no set.
    """

    plan: SignaturePlan
    sets: tuple[MinimumSet, ...]
    complete: bool

    @property
    def undecided(self) -> tuple[Diagnostic, ...]:
        """The message that a limit was reached before all sets were found (DH0908); none where all are there."""
        if self.complete:
            return ()
        text = f"there may be more cheapest sets than the {len(self.sets)} that are listed: a limit was reached"
        return (diagnostic("DH0908", text, helps=("raise `--most`, or allow more time",)),)

    def __str__(self) -> str:
        count = f"{len(self.sets)} cheapest sets" + ("" if self.complete else ", and perhaps more")
        return "\n".join([count, *(f"  {one}" for one in self.sets)])


def all_minimum_sets(
    des: DES,
    candidates: tuple[Candidate, ...],
    *,
    most: int = MOST_SETS,
    max_states: int = 100_000,
    seconds: float | None = None,
) -> MinimumSets:
    """Return every set of signatures with the least cost of generators and the fewest instrumented transitions.

    Sets differ in the transitions that carry a signature, or in the generators that make the same signatures (another
    one is a negation).  At most `most` are returned, and what was found within `seconds`; `complete` is then false.

    Raises `UsageError` (DH0406) and `LimitReached` (DH0901) as `recover_observability` does.

    >>> arcs = [("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")]
    >>> offered = (Candidate("s_2", "2", (0,), negation=False), Candidate("s_3", "3", (1,), negation=False))
    >>> print(all_minimum_sets(DES.from_transitions(arcs), offered))
    2 cheapest sets
      {s_2} with 2
      {s_3} with 3
    """
    plan = recover_observability(des, candidates, max_states=max_states, seconds=seconds)
    return minimum_sets_of(plan, most=most, seconds=seconds)


def minimum_sets_of(plan: SignaturePlan, *, most: int = MOST_SETS, seconds: float | None = None) -> MinimumSets:
    """Return all cheapest sets of the system and the candidates of a plan, as `all_minimum_sets` does."""
    if plan.already_observable or not plan.recoverable:
        return MinimumSets(plan, (MinimumSet((), ()),) if plan.recoverable else (), True)
    if not plan.fewest:
        return MinimumSets(plan, (), False)
    candidates, program = plan.candidates, build_program(plan.des, plan.candidates)
    deadline = None if seconds is None else time.monotonic() + seconds
    search = Search(separation(plan.des, program.options), program, deadline)
    found: dict[tuple[Choice, Choice], MinimumSet] = {}
    try:
        search.settle(2)
        complete = _enumerate(search, candidates, found, most)
    except (LimitReached, MemoryError):
        complete = False
    order = sorted(found, key=lambda choice: (sorted(choice[0]), sorted(choice[1])))
    return MinimumSets(plan, tuple(found[choice] for choice in order), complete)


def _enumerate(
    search: Search, candidates: tuple[Candidate, ...], found: dict[tuple[Choice, Choice], MinimumSet], most: int
) -> bool:
    """Fill `found`, and return whether it holds all."""
    program, cuts = search.program, list[Row]()
    while True:
        selection = search.best(tuple(cuts))
        if selection is None:
            return True
        if len(found) == most:
            return False
        generators = _needed(program, selection)
        signatures = signatures_of(candidates, program, selection.options, generators)
        names = tuple(program.generators[generator] for generator in sorted(generators))
        found[generators, selection.options] = MinimumSet(signatures, names)
        cuts.append(_cut(program, generators, selection.options))


def _needed(program: Program, selection: Selection) -> Choice:
    """The generators that the options take; others may be there for nothing."""
    ways = (next(way for way in program.ways(option) if way <= selection.generators) for option in selection.options)
    return frozenset[int]().union(*ways)


def _cut(program: Program, generators: Choice, options: Choice) -> Row:
    """Not all of these again."""
    taken = [*sorted(generators), *(variable for option in sorted(options) for variable in program.carries(option))]
    return dict.fromkeys(taken, 1.0), len(generators) + len(options) - 1.0


__all__ = ["MOST_SETS", "MinimumSet", "MinimumSets", "all_minimum_sets", "minimum_sets_of"]
