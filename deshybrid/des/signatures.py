"""Recovery: the cheapest signatures that make a system current-location observable, with a proof that none are cheaper.

Signatures only refine what is seen, so more of them never destroy observability, and a set that fails says what every
set that succeeds must contain: two runs that look alike under the failing set must be told apart.  This is an implicit
hitting set (`hitting`): the cheapest set that meets all constraints found so far is tested, until one succeeds.

A signature on p -> q makes {q} the entry estimate, whichever name it has, so of the signatures of single locations only
the set of instrumented transitions matters to the test.  A covering detector says "one of these": transitions that it
announces alike are compared by their labels (`separation`).  Cost: generators first, then instrumented transitions; see
`candidates` and `program`.

In: a `DES` and candidates.  Out: a `SignaturePlan`.  Cost: NP-hard in general; each test takes the joint moves.
Source: Balluchi et al. (2012), section 4.1; Moreno-Centeno and Karp (2013), implicit hitting sets.
"""

import time
from fractions import Fraction
from math import ceil, gcd, lcm, nextafter
from typing import Literal

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate, generator_costs, joint_signatures, require_fitting
from deshybrid.des.hitting import Choice, Outcome, Search
from deshybrid.des.observability import check_observability
from deshybrid.des.plan import Constraint, Signature, SignaturePlan
from deshybrid.des.program import Program, build_program
from deshybrid.des.separation import Demand, separation
from deshybrid.diagnostics.limits import last_moments

_LAST_LOOK = 60.0  # seconds
_TRUST = Fraction(1, 10**6)  # how far below its own bound the solver is believed, in units of the largest cost
_WHOLE = 10**5  # costs that are at most so many of a common unit: a bound between two sums is rounded up


def recover_observability(
    des: DES,
    candidates: tuple[Candidate, ...],
    *,
    max_states: int = 100_000,
    max_rounds: int = 10_000,
    seconds: float | None = None,
) -> SignaturePlan:
    """Return the cheapest signatures that make `des` current-location observable (Balluchi et al., 2012, section 4.1).

    The cheapest plan has the least cost of residual generators; among those, the fewest instrumented transitions; then
    those that are confused least with others; then the negations that deny least, then what is declared first (all
    objectives: `program`).  `max_states` limits the observers of the reports.  After `max_rounds` programs, or
    `seconds`, the best plan so far is returned with a lower bound: its `optimal` or `fewest` is then false.

    Raises `UsageError` (DH0406) where a candidate does not fit, `LimitReached` (DH0901) where tens of millions of pairs
    of transitions have a common output.

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")], name="pair")
    >>> print(recover_observability(des, (Candidate("s_2", "2", (1,)), Candidate("s_5", "5", (0,)))))
    pair: current-location observable with signatures {s_5}
      s_5 by residual on 2 -d-> 5
      residual generators: 5; cost 1, proven least
    """
    deadline = None if seconds is None else time.monotonic() + seconds
    trivial = _without_search(des, candidates, max_states)
    if trivial is not None:
        return trivial
    program = build_program(des, candidates)
    search = Search(separation(des, program.options), program, deadline, max_rounds)
    outcome = search.run()
    if outcome.settled == len(program.objectives):
        return _plan(des, candidates, program, outcome, max_states)
    with last_moments(_LAST_LOOK):  # a limit was reached: the plan so far is told all the same
        return _plan(des, candidates, program, outcome, max_states)


def _without_search(des: DES, candidates: tuple[Candidate, ...], max_states: int) -> SignaturePlan | None:
    """The plan where nothing is needed, or nothing helps; None where something has to be found."""
    require_fitting(des, candidates)
    report = check_observability(des, max_states=max_states)
    if report.current_location_observable:
        return SignaturePlan(des, candidates, True, True, (), (), 0.0, 0.0, True, True, (), None, None, report)
    everything = des.with_signatures(joint_signatures(candidates, build_program(des, candidates).options))
    best = check_observability(everything, max_states=max_states)
    if best.current_location_observable:
        return None
    return SignaturePlan(des, candidates, False, False, (), (), None, None, False, False, (), best.witness, None, best)


def _plan(
    des: DES, candidates: tuple[Candidate, ...], program: Program, outcome: Outcome, max_states: int
) -> SignaturePlan:
    costs = [_exactly(cost) for cost in generator_costs(des, candidates).values()]
    cost = sum((costs[generator] for generator in outcome.generators), Fraction())
    lower_bound = cost if outcome.settled else min(cost, _lower_bound(costs, outcome.bound))
    chosen = [program.options[option] for option in sorted(outcome.options)]
    complementary = des.with_signatures(joint_signatures(candidates, chosen))
    return SignaturePlan(
        des=des,
        candidates=candidates,
        recoverable=True,
        already_observable=False,
        signatures=signatures_of(candidates, program, outcome.options, outcome.generators),
        generators=tuple(program.generators[generator] for generator in sorted(outcome.generators)),
        cost=float(cost),
        lower_bound=_float_below(lower_bound) if lower_bound < cost else float(cost),
        optimal=lower_bound == cost,
        fewest=outcome.settled == len(program.objectives),
        constraints=tuple(_constraint(candidates, program, demand) for demand in outcome.demands),
        confused=None,
        complementary=complementary,
        report=check_observability(complementary, max_states=max_states),
    )


def _exactly(cost: float) -> Fraction:
    """The number that was written, not the double nearest to it."""
    return Fraction(repr(float(cost)))


def _lower_bound(costs: list[Fraction], bound: float) -> Fraction:
    """What every plan costs at least, from the solver's bound in units of the largest cost."""
    largest = max(costs, default=Fraction()) or Fraction(1)
    trusted = (Fraction(bound) - _TRUST) * largest
    unit = Fraction(gcd(*(c.numerator for c in costs)), lcm(*(c.denominator for c in costs)))
    if unit > 0 and largest <= _WHOLE * unit:
        trusted = ceil(trusted / unit) * unit
    return max(trusted, Fraction())


def _float_below(value: Fraction) -> float:
    """The largest double whose decimal, as it is written, is not above the value."""
    near = float(value)
    return near if _exactly(near) <= value else nextafter(near, 0.0)


def signatures_of(
    candidates: tuple[Candidate, ...], program: Program, chosen: Choice, generators: Choice
) -> tuple[Signature, ...]:
    """Return the signatures that chosen options and generators (numbers) make, in the order of the candidates."""
    there = {program.generators[generator] for generator in generators}
    used: dict[int, list[int]] = {}
    found = []
    for option in sorted(chosen):
        used.setdefault(program.options[option].candidate, []).extend(program.options[option].transitions)
    for number, transitions in sorted(used.items()):
        candidate = candidates[number]
        by: Literal["residual", "negation"] = "negation"
        if candidate.residual and candidate.generator in there:
            by = "residual"
        numbers = tuple(sorted(transitions))
        found.append(Signature(candidate.name, candidate.location, numbers, by, candidate.covers))
    return tuple(found)


def _constraint(candidates: tuple[Candidate, ...], program: Program, demand: Demand) -> Constraint:
    options = [program.options[option] for option in sorted(demand.options)]
    return Constraint(
        demand.condition,
        tuple(option.transitions[0] for option in options if not option.covering),
        tuple(candidates[option.candidate].name for option in options if option.covering),
        demand.runs,
        demand.cycles,
    )


__all__ = ["Candidate", "Constraint", "Signature", "SignaturePlan", "recover_observability", "signatures_of"]
