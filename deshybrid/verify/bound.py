"""Check the ultimate bound of a design: sets of entry errors that no switch leads out of, and the peaks of a stay.

In: the plant of a design; β, and per location the disturbance as it enters, the noise of its measurements and a set
{|d ζ| <= h}; the bound of every state.  Out: one check per exit and location (`verify/bound_stay.py`), and that the
design states these bounds.  With zero in the sets, every error that started from zero enters a location in its set, by
induction over the switches; what is left of any other start dies out by a certificate of the design for stays of β.
The drive is N = [disturbance, G noise], with the gains of the design.

Limits: without detection delay; beyond 30 million products nothing is looked at, and the bound stays among what is not
checked.  Some 1 s per million.

Source: this project; the sets are proposed by `deshybrid.continuous.inductive`, of which nothing is used.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import ceil

from deshybrid.linear.exact import Rational, diagonal, product
from deshybrid.linear.exact_inequalities import Motion
from deshybrid.verify.bound_stay import EntrySet, StayBound
from deshybrid.verify.design_file import Claim, Plant, same_names
from deshybrid.verify.form_file import FormClaim
from deshybrid.verify.forms import Said
from deshybrid.verify.values import as_mapping, mapping_at, matrix_at, number_at, require

PART_OF_A_STEP = Fraction(1, 10**6)
LARGEST_WORK = 30_000_000
"""Products of long integers, all locations together."""


@dataclass(frozen=True, slots=True, eq=False)
class BoundClaim:
    """An ultimate bound as a file states it: `stay` is β (s), `by_state` in the order of the states."""

    value: Fraction
    by_state: tuple[Fraction, ...]
    stay: Fraction
    drives: Mapping[str, Rational]
    sets: Mapping[str, EntrySet]


def read_bound(document: Mapping[str, object], plant: Plant) -> BoundClaim | None:
    """Return what the file claims of the ultimate bound; None where it comes without sets.

    Raises `UsageError` (DH0511) for malformed entries.
    """
    if document.get("ultimate_certificate") is None:
        return None
    tree = mapping_at(document, "ultimate_certificate", "design")
    places = mapping_at(tree, "locations", "ultimate_certificate")
    same_names(places, "ultimate_certificate.locations", plant)
    n, drives, sets = plant.size, {}, {}
    for name in plant.locations:
        where = f"ultimate_certificate.locations.{name}"
        place = as_mapping(places.get(name), where)
        noise = matrix_at([place.get("noise")], f"{where}.noise", columns=len(plant.locations[name][1]))[0]
        disturbance = matrix_at(place.get("disturbance"), f"{where}.disturbance", rows=n)
        require(len({len(row) for row in disturbance}) == 1, f"{where}.disturbance", "rows of equal length")
        drives[name] = _drive(disturbance, plant.gains[name], noise)
        sets[name] = _set(place, where, n)
    stated = mapping_at(document, "ultimate_bound_by_state", "design")
    require(len(stated) == n, "ultimate_bound_by_state", f"{n} states")
    by_state = tuple(number_at(value, f"ultimate_bound_by_state.{key}") for key, value in stated.items())
    value = number_at(document.get("ultimate_bound"), "ultimate_bound")
    return BoundClaim(value, by_state, number_at(tree.get("stay"), "ultimate_certificate.stay"), drives, sets)


def bound_checks(
    plant: Plant, claim: BoundClaim, certificates: tuple[Claim | FormClaim, ...]
) -> tuple[Said, ...] | None:
    """Check everything that the claim says, `certificates` being those that hold; None where that would take too long.

    Exits and peaks are looked at where the rest was proved only.
    """
    found = [*_statement(plant, claim, certificates)]
    if not all(proved for _, _, proved in found):
        return tuple(found)
    stays = {
        name: StayBound(Motion(plant.error_matrix(name), plant.time_step), claim.drives[name], claim.sets[name])
        for name in plant.locations
    }
    decay = {name: stay.decays() for name, stay in stays.items()}
    if all(decay.values()) and sum(s.work(_rows(plant, claim, k), claim.stay) for k, s in stays.items()) > LARGEST_WORK:
        return None
    for name, stay in stays.items():
        place = f"location `{name}`"
        found.append((place, "norms are found in which errors and disturbances decay", decay[name]))
        if decay[name]:
            said = list(_leaving(plant, claim, name, stay))
            if not all(proved for _, proved in said):
                said = list(_leaving(plant, claim, name, stay.finer()))
            found += [(place, *each) for each in said]
    return tuple(found)


def _statement(plant: Plant, claim: BoundClaim, certificates: tuple[Claim | FormClaim, ...]) -> Iterator[Said]:
    everywhere, step = "every location", plant.time_step
    norm = sum((value * value for value in claim.by_state), Fraction())
    nonnegative = claim.value >= 0 and all(value >= 0 for value in claim.by_state)
    yield (
        everywhere,
        "`ultimate_bound` is no less than the norm of those by state",
        nonnegative and claim.value**2 >= norm,
    )
    stay = claim.stay if step is None else round(claim.stay / step) * step
    plain = [c for c in certificates if not c.theorem.endswith("-sampled") or step is not None]
    plain = [c for c in plain if c.delay == 0]
    shortest = all(stay <= _stay(c.dwell, step) for c in plain)
    yield everywhere, "the bound is for stays no longer than the dwell time of the certificates", shortest
    lasting = any(c.required is not None and _stay(c.required, step) <= stay for c in plain)
    yield everywhere, "what any start leaves dies out: some certificate without delay holds for these stays", lasting
    whole = step is None or (claim.stay > 0 and abs(claim.stay / step - round(claim.stay / step)) <= PART_OF_A_STEP)
    yield everywhere, "the shortest stay is positive, in discrete time a number of steps", claim.stay > 0 and whole
    for name, entered in claim.sets.items():
        n = len(claim.by_state)
        box = entered.directions[:n] == diagonal([1] * n) and all(level > 0 for level in entered.levels)
        yield f"location `{name}`", "the set has an inside, and its first directions are the states", box


def _stay(dwell: Fraction, step: Fraction | None) -> Fraction:
    return dwell if step is None else ceil(dwell / step - PART_OF_A_STEP) * step


def _rows(plant: Plant, claim: BoundClaim, name: str) -> int:
    return plant.size + sum(len(claim.sets[jump.target].directions) for jump in plant.exits(name))


def _leaving(plant: Plant, claim: BoundClaim, name: str, stay: StayBound) -> Iterator[tuple[str, bool]]:
    """The peaks of a stay and its exits, along all rows at once."""
    rows, levels, starts = diagonal([1] * plant.size), claim.by_state, [Fraction()] * plant.size
    for jump in plant.exits(name):
        entered = claim.sets[jump.target]
        rows = (*rows, *product(entered.directions, jump.matrix))
        levels = (*levels, *entered.levels)
        starts += [claim.stay] * len(entered.levels)
    try:
        below = stay.stays_below(rows, levels, starts, claim.stay)
    except ValueError:
        # An exponential is out of proportion.
        below = [False] * len(rows)
    said = "no error during a stay exceeds `ultimate_bound_by_state`: s(e^{F t}) + ∫‖e^{F s} N‖₁ ds <= b, t >= 0"
    yield said, all(below[: plant.size])
    first = plant.size
    for jump in plant.exits(name):
        last = first + len(claim.sets[jump.target].levels)
        said = "s(d R e^{F t}) + ∫‖d R e^{F s} N‖₁ ds <= h, t >= β, for every direction d of the set of"
        yield f"{said} `{jump.target}`", all(below[first:last])
        first = last


def _drive(disturbance: Rational, gain: Rational, noise: tuple[Fraction, ...]) -> Rational:
    felt = product(gain, diagonal(noise)) if noise else tuple(() for _ in disturbance)
    return tuple((*first, *second) for first, second in zip(disturbance, felt, strict=True))


def _set(place: Mapping[str, object], where: str, n: int) -> EntrySet:
    directions = matrix_at(place.get("directions"), f"{where}.directions", columns=n)
    levels = matrix_at([place.get("levels")], f"{where}.levels", columns=len(directions))[0]
    numbers = matrix_at(place.get("bases"), f"{where}.bases", columns=n)
    known = all(value.denominator == 1 and 0 <= value < len(directions) for row in numbers for value in row)
    require(bool(numbers) and known, f"{where}.bases", "numbers of directions")
    return EntrySet(directions, levels, tuple(tuple(int(value) for value in row) for row in numbers))


__all__ = ["BoundClaim", "bound_checks", "read_bound"]
