"""Check certificates by matrix inequalities, and the switching cycle that shows how good they can be.

In: the plant of a design, the entries of its certificates with theorem `LMI` or `LMI-sampled` (rate, dwell time, delay,
forms P and Q of degree 2 d by location), the lower limit and its witness cycle.  Out: one check per inequality of
`deshybrid.linear.exact_inequalities`, for stays of T_i = max(required dwell, the location's own shortest stay) - Δ, and
one for the cycle: a growing cycle with stays no shorter than the limit.  Nothing is rounded but enclosures, outwards.

About 0.1 s a location for n = 6 and quadratic forms.
Source: Geromel and Colaneri (2006); Balluchi et al. (2012), proof of Theorem 7, for T = D - Δ.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import ceil

from deshybrid.diagnostics import LimitReached, diagnostic
from deshybrid.linear.exact import Rational, transposed
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_inequalities import (
    Leg,
    Motion,
    does_not_contract,
    flow_decreases,
    jump_decreases,
    stay_decreases,
)
from deshybrid.linear.lifting import lifted_size
from deshybrid.verify.design_file import FORM_THEOREMS, Plant, same_names
from deshybrid.verify.sampled import made_from_the_gains
from deshybrid.verify.values import as_mapping, mapping_at, matrix_at, number_at, refuse, require

PART_OF_A_STEP = Fraction(1, 10**6)
LARGEST_FORM = 130
"""Forms with more rows are refused: they would take minutes each."""
Said = tuple[str, str, bool]
"""The place, what is said of it, and whether it was proved."""


@dataclass(frozen=True, slots=True, eq=False)
class FormClaim:
    """One certificate that claims to hold; degree: d; matrices: M of the sampled observer, else A - G C."""

    name: str
    theorem: str
    rate: Fraction
    dwell: Fraction
    delay: Fraction
    required: Fraction
    step: Fraction | None
    degree: int
    shortest: Mapping[str, Fraction]
    P: Mapping[str, Rational]
    Q: Mapping[str, Rational]
    matrices: Mapping[str, Rational]

    def stay(self, name: str, dwell: Fraction) -> Fraction:
        """T_i = max(dwell, the location's own shortest stay) - Δ; in sampled time the least whole number of steps."""
        stay = max(dwell, self.shortest.get(name, Fraction())) - self.delay
        if self.step is None:
            return stay
        return max(1, ceil(stay / self.step - PART_OF_A_STEP)) * self.step


@dataclass(frozen=True, slots=True, eq=False)
class SilentForm:
    """One certificate that does not claim to hold; `required`: what it says nevertheless."""

    name: str
    theorem: str
    delay: Fraction
    required: Fraction | None


def read_forms(document: Mapping[str, object], plant: Plant) -> tuple[FormClaim | SilentForm, ...]:
    """Return the certificates by matrix inequalities, in the order of the file.

    Raises `UsageError` (DH0511) for a malformed one, `LimitReached` (DH0512) for forms with more than 130 rows.
    """
    entries = document.get("certificates")
    numbered = enumerate(entries if isinstance(entries, list) else [])
    found = ((k, as_mapping(entry, f"certificates[{k}]")) for k, entry in numbered)
    return tuple(_read(entry, k, plant) for k, entry in found if entry.get("theorem") in FORM_THEOREMS)


def form_checks(plant: Plant, claim: FormClaim) -> Iterator[Said]:
    """Check everything that one certificate says."""
    yield from (("every location", said, proved) for said, proved in _statement(plant, claim))
    for name in plant.locations:
        for said, proved in _location(plant, claim, name):
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
    yield "witness cycle", "no stay is shorter than the lower limit", all(stay >= shortest for stay in stays)
    step = plant.time_step
    whole = [stay if step is None else round(stay / step) * step for stay in stays]
    legs = [
        Leg(Motion(plant.error_matrix(jump.source), step), stay, jump.matrix)
        for jump, stay in zip(jumps, whole, strict=True)
    ]
    said = "the product of e^{μ t} R e^{F t} over the cycle does not contract"
    yield "witness cycle", said, all(stay > 0 for stay in whole) and does_not_contract(legs, rate)


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


def _location(plant: Plant, claim: FormClaim, name: str) -> Iterator[tuple[str, bool]]:
    P, Q, motion = claim.P[name], claim.Q[name], Motion(claim.matrices[name], claim.step)
    if claim.theorem.endswith("-sampled") and claim.step is not None:
        yield made_from_the_gains(plant, claim.matrices[name], name, claim.step)
    for what, form in (("P", P), ("Q", Q)):
        yield f"{what} is symmetric and positive definite", form == transposed(form) and is_positive_definite(form)
    flow = "M^[d]ᵀ Q M^[d] < e^{-2 d μ h} Q" if claim.step else "F^[d]ᵀ Q + Q F^[d] + 2 d μ Q < 0 with F = A - G C"
    yield f"flow inequality: {flow}", flow_decreases(motion, Q, claim.degree, claim.rate)
    stay = claim.stay(name, claim.required)
    proved = stay >= 0 and stay_decreases(motion, stay, P, Q, degree=claim.degree, rate=claim.rate)
    yield "stay inequality: e^{2 d μ T} E^[d]ᵀ Q E^[d] < P with E = e^{F T} or M^k", proved
    for jump in plant.exits(name):
        said = f"jump inequality: R^[d]ᵀ P R^[d] < Q for the reset to `{jump.target}`"
        yield said, jump_decreases(jump.matrix, claim.P[jump.target], Q, claim.degree)


def _read(entry: Mapping[str, object], number: int, plant: Plant) -> FormClaim | SilentForm:
    where, theorem, holds = f"certificates[{number}]", str(entry.get("theorem")), entry.get("holds")
    name = f"certificate {number + 1} ({theorem})"
    require(isinstance(holds, bool), f"{where}.holds", "true or false")
    delay, stated = number_at(entry.get("delay"), f"{where}.delay"), entry.get("required_dwell")
    if not holds:
        return SilentForm(
            name, theorem, delay, None if stated is None else number_at(stated, f"{where}.required_dwell")
        )
    rate, dwell, required = (number_at(entry.get(key), f"{where}.{key}") for key in ("rate", "dwell", "required_dwell"))
    degree = _degree(entry.get("degree"), f"{where}.degree")
    n = len(next(iter(plant.locations.values()))[0])
    size = lifted_size(n, degree)
    if size > LARGEST_FORM:
        raise LimitReached(diagnostic("DH0512", f"forms of {size} rows, exact checks stop at {LARGEST_FORM}"))
    P, Q = (_by_location(entry, key, where, size, plant) for key in ("P", "Q"))
    sampled = theorem.endswith("-sampled")
    step = None if entry.get("step") is None else number_at(entry.get("step"), f"{where}.step")
    require(step is None or step > 0, f"{where}.step", "a positive step or null")
    own = {key: plant.error_matrix(key) for key in plant.locations}
    matrices = _by_location(entry, "matrices", where, n, plant) if sampled else own
    shortest = {
        key: number_at(value, f"{where}.shortest_stays.{key}")
        for key, value in mapping_at(entry, "shortest_stays", where).items()
    }
    require(set(shortest) <= set(plant.locations), f"{where}.shortest_stays", "names of locations")
    return FormClaim(name, theorem, rate, dwell, delay, required, step, degree, shortest, P, Q, matrices)


def _degree(value: object, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 2 or value % 2:
        refuse(f"`{where}`: expected an even number, 2 or more")
    return value // 2


def _by_location(entry: Mapping[str, object], key: str, where: str, size: int, plant: Plant) -> Mapping[str, Rational]:
    found = mapping_at(entry, key, where)
    same_names(found, f"{where}.{key}", plant)
    return {name: matrix_at(value, f"{where}.{key}.{name}", columns=size, rows=size) for name, value in found.items()}


__all__ = ["FormClaim", "SilentForm", "form_checks", "limit_checks", "read_forms"]
