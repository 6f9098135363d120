"""Check certificates by matrix inequalities, and the switching cycle that shows how good they can be.

In: the plant of a design, the entries of its certificates with theorem `LMI` or `LMI-sampled` (`verify/form_file.py`),
the lower limit and its witness cycle.  Out: one check per inequality of `deshybrid.linear.exact_inequalities`, and one
for the cycle: a growing cycle with stays no shorter than the limit.

The argument: whatever the plant does, its location and its last transitions name a node.  There the error enters with a
form P; a stay of T = max(required dwell, the location's own shortest stay) - Δ or longer, up to the longest one plus Δ,
ends in one of the spans, where Q is below P; and Q is above the form of the node that any reset leads to.
Nothing is rounded but enclosures, outwards.

About 0.1 s a location for n = 6 and plain quadratic forms.
Source: Geromel and Colaneri (2006); Balluchi et al. (2012), proof of Theorem 7, for T = D - Δ.
"""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from itertools import pairwise
from math import floor

from deshybrid.linear.exact import Rational, transposed
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_inequalities import (
    Leg,
    Motion,
    does_not_contract,
    flow_decreases,
    jump_decreases,
    span_decreases,
    stay_decreases,
)
from deshybrid.verify.design_file import Plant
from deshybrid.verify.form_file import PART_OF_A_STEP, FormClaim, SpanClaim
from deshybrid.verify.sampled import made_from_the_gains
from deshybrid.verify.values import as_mapping, matrix_at, number_at, require

Said = tuple[str, str, bool]
"""The place, what is said of it, and whether it was proved."""


def form_checks(plant: Plant, claim: FormClaim) -> Iterator[Said]:
    """Check everything that one certificate says."""
    yield from (("every location", said, proved) for said, proved in _statement(plant, claim))
    if claim.theorem.endswith("-sampled") and claim.step is not None:
        for name in plant.locations:
            yield f"location `{name}`", *made_from_the_gains(plant, claim.matrices[name], name, claim.step)
    for name in claim.nodes:
        for said, proved in _node(plant, claim, name):
            yield f"location `{name}`", said, proved


def limit_checks(document: Mapping[str, object], plant: Plant, rate: Fraction) -> Iterator[Said]:
    """Check that the lower limit is one: its cycle exists, has no shorter stays, and does not contract."""
    limit, cycle = document.get("dwell_lower_limit"), document.get("witness_cycle")
    if cycle is None:
        yield "witness cycle", "a lower limit above zero has a witness", limit is None or limit == 0
        return
    tree = as_mapping(cycle, "witness_cycle")
    shortest = number_at(limit, "dwell_lower_limit")
    numbers = matrix_at([tree.get("resets")], "witness_cycle.resets")[0]
    known = all(value.denominator == 1 and 0 <= value < len(plant.resets) for value in numbers)
    require(bool(numbers) and known, "witness_cycle.resets", "places in the list of resets")
    stays = matrix_at([tree.get("stays")], "witness_cycle.stays", columns=len(numbers))[0]
    jumps = [plant.resets[int(value)] for value in numbers]
    follows = all(jump.target == after.source for jump, after in zip(jumps, [*jumps[1:], jumps[0]], strict=True))
    yield "witness cycle", "each reset starts where the one before it ends", follows
    named = tree.get("locations") == [jump.source for jump in jumps]
    yield "witness cycle", "its locations are those that its resets leave", named
    step = plant.time_step
    ends = [_longest(plant, jump.source) for jump in jumps]
    free = [stay for stay, end in zip(stays, ends, strict=True) if stay != end]
    yield "witness cycle", "no stay is shorter than the lower limit", all(stay >= shortest for stay in free)
    within = all(end is None or stay <= end for stay, end in zip(stays, ends, strict=True))
    yield "witness cycle", "no stay is longer than its location allows", within
    whole = [stay if step is None else round(stay / step) * step for stay in stays]
    legs = [
        Leg(Motion(plant.error_matrix(jump.source), step), stay, jump.matrix)
        for jump, stay in zip(jumps, whole, strict=True)
    ]
    said = "the product of e^{μ t} R e^{F t} over the cycle does not contract"
    yield "witness cycle", said, all(stay > 0 for stay in whole) and does_not_contract(legs, rate)


def _longest(plant: Plant, name: str) -> Fraction | None:
    """The longest stay of a location as a double; in discrete time the steps that it has."""
    end, step = plant.longest.get(name), plant.time_step
    if end is None or step is None:
        return end
    return Fraction(floor(end / step + PART_OF_A_STEP) * float(step))


def _statement(plant: Plant, claim: FormClaim) -> Iterator[tuple[str, bool]]:
    yield "the rate is positive", claim.rate > 0
    yield "0 <= delay < dwell", 0 <= claim.delay < claim.dwell
    yield "delay <= required dwell", claim.delay <= claim.required
    enough = all(claim.stay(name, claim.required) <= claim.stay(name, claim.dwell) for name in plant.locations)
    yield "required dwell <= dwell", enough
    expected = plant.time_step is not None or claim.theorem.endswith("-sampled")
    yield "a step is stated in sampled time only", (claim.step is not None) == expected
    if plant.time_step is not None:
        yield "the step is that of the system", claim.step == plant.time_step
    places = {node.location for node in claim.nodes.values()}
    yield "every location has a node", places == set(plant.locations)
    yield "every reset leads from each node of its source to a node of its target", _follows_resets(plant, claim)


def _follows_resets(plant: Plant, claim: FormClaim) -> bool:
    for node in claim.nodes.values():
        leaving = {k: jump.target for k, jump in enumerate(plant.resets) if jump.source == node.location}
        if {k: claim.nodes[target].location for k, target in node.exits.items()} != leaving:
            return False
    return True


def _node(plant: Plant, claim: FormClaim, name: str) -> Iterator[tuple[str, bool]]:
    P, spans = claim.P[name], [span for span in claim.spans if span.node == name]
    yield "P is symmetric and positive definite", _is_form(P)
    location = claim.nodes[name].location
    shortest = claim.stay(location, claim.required)
    said = "the spans cover all stays from T on, up to the longest one where it is stated"
    yield said, _covers(spans, shortest, claim.longest_stay(location))
    for span in spans:
        yield from _span(plant, claim, span, shortest)


def _covers(spans: list[SpanClaim], shortest: Fraction, longest: Fraction | None) -> bool:
    if not spans or spans[0].start != 0 or any(a.end is None or b.start > a.end for a, b in pairwise(spans)):
        return False
    end = spans[-1].end
    return end is None or (longest is not None and shortest + end >= longest)


def _span(plant: Plant, claim: FormClaim, span: SpanClaim, shortest: Fraction) -> Iterator[tuple[str, bool]]:
    node, degree, rate = claim.nodes[span.node], claim.degree, claim.rate
    motion = Motion(claim.matrices[node.location], claim.step)
    where = "" if span.start == 0 else f", for stays longer than T + {float(span.start):.6g} s"
    yield f"Q is symmetric and positive definite{where}", all(_is_form(Q) for Q in span.Q)
    if span.end is None:
        flow = "M^[d]ᵀ Q M^[d] < e^{-2 d μ h} Q" if claim.step else "F^[d]ᵀ Q + Q F^[d] + 2 d μ Q < 0 with F = A - G C"
        yield f"flow inequality: {flow}{where}", flow_decreases(motion, span.Q[0], degree, rate)
    else:
        flow = "M^[d]ᵀ Q⁺ M^[d] < e^{-2 d μ h} Q" if claim.step else "Q' + F^[d]ᵀ Q + Q F^[d] + 2 d μ Q < 0"
        falls = span_decreases(motion, span.end - span.start, *span.Q, degree=degree, rate=rate)
        yield f"flow inequality: {flow}, Q linear in time{where}", falls
    stay = shortest + span.start
    proved = stay >= 0 and stay_decreases(motion, stay, claim.P[span.node], span.Q[0], degree=degree, rate=rate)
    yield f"stay inequality: e^{{2 d μ T}} E^[d]ᵀ Q E^[d] < P with E = e^{{F T}} or M^k{where}", proved
    for number, target in node.exits.items():
        said = f"jump inequality: R^[d]ᵀ P R^[d] < Q for the reset to `{target}`{where}"
        yield said, all(jump_decreases(plant.resets[number].matrix, claim.P[target], Q, degree) for Q in span.Q)


def _is_form(matrix: Rational) -> bool:
    return matrix == transposed(matrix) and is_positive_definite(matrix)


__all__ = ["Said", "form_checks", "limit_checks"]
