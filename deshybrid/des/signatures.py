"""Recovery: the cheapest signatures that make a system current-location observable, with a proof that none are cheaper.

Signatures only refine what is seen, so more of them never destroy observability, and a set that fails says what every
set that succeeds must contain: two runs that look alike under the failing set must be told apart, by a signature on a
transition that only one of them takes.  This is an implicit hitting set: solve a 0/1 program for the cheapest set, test
the complementary DES, turn each confusion into a constraint, repeat until the test succeeds.  The
constraints are the proof.

A signature on p -> q makes {q} the entry estimate, whichever name it has, so only the set of instrumented transitions
matters to the test.  Cost: generators first, then instrumented transitions; see `candidates` and `program`.

In: a `DES` and candidates.  Out: a `SignaturePlan`.  Cost: NP-hard in general; each test takes the pair automaton.
Source: Balluchi et al. (2012), section 4.1; Moreno-Centeno and Karp (2013), implicit hitting sets.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate, generator_costs, require_fitting
from deshybrid.des.epsilon import OutputAutomaton, eliminate_epsilon
from deshybrid.des.observability import check_observability
from deshybrid.des.pairs import persistent_pairs
from deshybrid.des.program import Program, Selection, build_program, solve
from deshybrid.des.report import ObservabilityReport
from deshybrid.des.witness import Confusion, Witness, find_confusion
from deshybrid.diagnostics import LimitReached, diagnostic
from deshybrid.diagnostics.pictured import Explained


@dataclass(frozen=True, slots=True)
class Signature:
    """A signature of a plan: emitted on `transitions` (numbers), by a residual generator or by negation."""

    name: str
    location: str
    transitions: tuple[int, ...]
    by: Literal["residual", "negation"]

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class SignaturePlan(Explained):
    """The answer of `recover_observability`; everything in order of declaration.

    `generators` are the locations that need a residual generator, `cost` is what these cost, `lower_bound` what every
    plan costs at least.  `constraints` prove it: of each of these sets of transitions, one must carry a signature.
    `report` is that of the complementary DES; where nothing helps (`recoverable` is false, no cost), it is that of the
    system with all candidates, and `confused` shows what remains.
    """

    des: DES
    recoverable: bool
    already_observable: bool
    signatures: tuple[Signature, ...]
    generators: tuple[str, ...]
    cost: float | None
    lower_bound: float | None
    optimal: bool
    constraints: tuple[tuple[int, ...], ...]
    confused: Witness | None
    complementary: DES | None
    report: ObservabilityReport

    def _drawn(self) -> ObservabilityReport:
        return self.report

    @property
    def names(self) -> str:
        """The names of the signatures as a set, as the papers write it."""
        return "{" + ",".join(signature.name for signature in self.signatures) + "}"

    def __str__(self) -> str:
        if self.already_observable:
            return f"{self.des.name}: current-location observable without signatures"
        if not self.recoverable:
            return f"{self.des.name}: no set of the candidate signatures makes it current-location observable"
        lines = [f"{self.des.name}: current-location observable with signatures {self.names}"]
        for signature in self.signatures:
            taken = (self.des.transitions[number] for number in signature.transitions)
            arcs = ", ".join(f"{t.source} -{t.event}-> {t.target}" for t in taken)
            lines.append(f"  {signature.name} by {signature.by} on {arcs}")
        lines.append(f"  residual generators: {', '.join(self.generators) or 'none'}; cost {self.cost:g}, proven least")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"<SignaturePlan of {self.des.name}: recoverable={self.recoverable}, signatures={self.names}, "
            f"generators={len(self.generators)}, cost={self.cost}>"
        )


def recover_observability(
    des: DES, candidates: tuple[Candidate, ...], *, max_states: int = 100_000, max_rounds: int = 10_000
) -> SignaturePlan:
    """Return the cheapest signatures that make `des` current-location observable (Balluchi et al., 2012, section 4.1).

    The cheapest plan has the least cost of residual generators; among those, the fewest instrumented transitions; then
    the negations that deny least, then what is declared first (all objectives: `program`).  `max_states` limits the
    observers of the reports.

    Raises `UsageError` (DH0406) where a candidate does not fit, `LimitReached` (DH0902) after `max_rounds` programs.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")], name="pair")
    >>> print(recover_observability(des, (Candidate("s_2", "2", (1,)), Candidate("s_5", "5", (0,)))))
    pair: current-location observable with signatures {s_5}
      s_5 by residual on 2 -d-> 5
      residual generators: 5; cost 1, proven least
    """
    require_fitting(des, candidates)
    report = check_observability(des, max_states=max_states)
    if report.current_location_observable:
        return SignaturePlan(des, True, True, (), (), 0.0, 0.0, True, (), None, None, report)
    program = build_program(des, candidates)
    name_of = {option.transition: candidates[option.candidate].name for option in program.options}
    best = check_observability(des.with_signatures(name_of), max_states=max_states)
    if not best.current_location_observable:
        return SignaturePlan(des, False, False, (), (), None, None, False, (), best.witness, None, best)
    failing = set(report.c1_failures)
    silent: list[tuple[int, ...]] = [(number,) for number, t in enumerate(des.transitions) if t in failing]
    return _plan(des, candidates, _Search(des, program, name_of, silent, max_rounds), max_states)


def _plan(des: DES, candidates: tuple[Candidate, ...], search: "_Search", max_states: int) -> SignaturePlan:
    first, last = search.run()
    price = generator_costs(des, candidates)
    cost, lower_bound = (sum(price[location] for location in found.generators) for found in (last, first))
    complementary = des.with_signatures({number: search.name_of[number] for number in last.transitions})
    return SignaturePlan(
        des=des,
        recoverable=True,
        already_observable=False,
        signatures=tuple(_signatures(candidates, last)),
        generators=last.generators,
        cost=cost,
        lower_bound=lower_bound,
        optimal=cost <= lower_bound * (1 + 1e-6),
        constraints=tuple(search.constraints),
        confused=None,
        complementary=complementary,
        report=check_observability(complementary, max_states=max_states),
    )


def _signatures(candidates: tuple[Candidate, ...], selection: Selection) -> Iterator[Signature]:
    for candidate in candidates:
        used = tuple(number for number in selection.transitions if number in candidate.transitions)
        if used:
            residual = candidate.residual and candidate.location in selection.generators
            yield Signature(candidate.name, candidate.location, used, "residual" if residual else "negation")


@dataclass(slots=True)
class _Search:
    """The implicit hitting set: constraints grow, level by level of the objectives, until a selection recovers."""

    des: DES
    program: Program
    name_of: dict[int, str]
    constraints: list[tuple[int, ...]]
    max_rounds: int

    def run(self) -> tuple[Selection, Selection]:
        """Return the first selection of least cost that recovers, and the best one by all objectives."""
        settled: list[Selection] = []
        for _ in self.program.objectives:
            settled.append(self._settle([selection.objective for selection in settled]))
        return settled[0], settled[-1]

    def _settle(self, earlier: list[float]) -> Selection:
        """Solve and test until the solution recovers; being best for fewer constraints, it is best for all."""
        while self.max_rounds > 0:
            self.max_rounds -= 1
            selection = solve(self.program, self.constraints, earlier)
            new = self._constraints_against(selection.transitions)
            if not new:
                return selection
            self.constraints += new
        raise LimitReached(
            diagnostic("DH0902", "the cheapest signatures were not found in the permitted number of rounds")
        )

    def _constraints_against(self, chosen: tuple[int, ...]) -> list[tuple[int, ...]]:
        """Confusions that `chosen` leaves, as constraints with no transition in common; none where it recovers.

        After each confusion, all that could separate it is added, so that the next one is another.
        """
        found: list[tuple[int, ...]] = []
        tried = set(chosen)
        while True:
            automaton = eliminate_epsilon(self.des.with_signatures({number: self.name_of[number] for number in tried}))
            pairs = persistent_pairs(automaton)
            confused = pairs.first_confused()
            if confused is None:
                return found
            confusion = find_confusion(automaton, confused, pairs.holds)
            separating = _separating(automaton, confusion) - tried
            found.append(tuple(sorted(number for number in separating if number in self.name_of)))
            tried.update(found[-1])


def _separating(automaton: OutputAutomaton, confusion: Confusion) -> set[int]:
    """Transitions that tell the two runs apart if they carry a signature: without one of them, they stay alike.

    Where both runs take the same path, or end their paths with the same visible transition, a signature shows in both.
    """
    separating = set()
    for first, second in confusion.before + confusion.around + confusion.after:
        one, other = automaton.edges[first].path, automaton.edges[second].path
        if one != other:
            separating |= {*one[:-1], *other[:-1]}
        if one[-1] != other[-1]:
            separating |= {one[-1], other[-1]}
    return separating


__all__ = ["Candidate", "Signature", "SignaturePlan", "recover_observability"]
