"""The parts of a `design.json` that a checker needs, read into exact numbers; nothing in the file is trusted.

In: a path, a compiled folder or "-", and then the JSON tree.  Out: the plant (A, C, resets, gains) and the claims of
its certificates, shapes and finiteness checked.  Every malformed part is a `UsageError`
(DH0511) that names its path in the tree.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import NamedTuple

from deshybrid.diagnostics import LimitReached, diagnostic
from deshybrid.linear.exact import Rational, combined, product
from deshybrid.verify.values import (
    as_mapping,
    complex_matrix,
    mapping_at,
    matrix_at,
    no_constant,
    no_key_twice,
    number_at,
    refuse,
    require,
)

LARGEST_FILE = 64_000_000
LARGEST_STATE = 40
BOX_THEOREMS = ("B03-box", "B03-box-sampled")
FORM_THEOREMS = ("LMI", "LMI-sampled")


class Jump(NamedTuple):
    """One reset R¹_ij."""

    source: str
    target: str
    matrix: Rational


class Term(NamedTuple):
    """What a certificate says of one location."""

    alpha: Fraction
    kappa: Fraction
    r: Fraction


@dataclass(frozen=True, slots=True, eq=False)
class Plant:
    """A and C by location, gains, resets, the step of a system in discrete time, and longest stays (s) where stated."""

    locations: Mapping[str, tuple[Rational, Rational]]
    gains: Mapping[str, Rational]
    resets: tuple[Jump, ...]
    time_step: Fraction | None
    longest: Mapping[str, Fraction]

    @property
    def size(self) -> int:
        """The number of states."""
        return len(next(iter(self.locations.values()))[0])

    def error_matrix(self, name: str) -> Rational:
        """Return A - G C, exactly."""
        A, C = self.locations[name]
        return combined(A, product(self.gains[name], C), -1) if C else A

    def exits(self, name: str) -> tuple[Jump, ...]:
        """Return the resets that leave a location."""
        return tuple(jump for jump in self.resets if jump.source == name)


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """One certificate; `bases`: real and imaginary part of T; `required`: None where the file says null."""

    name: str
    theorem: str
    holds: bool
    rate: Fraction
    dwell: Fraction
    delay: Fraction
    required: Fraction | None
    step: Fraction | None
    scale: tuple[Fraction, ...]
    terms: Mapping[str, Term]
    bases: Mapping[str, tuple[Rational, Rational]]
    matrices: Mapping[str, Rational]


@dataclass(frozen=True, slots=True, eq=False)
class Contraction:
    """A claim that the error contracts by γ with every switch; stays and the ends of cells in s, by location.

    matrices: M of the sampled observer, else F = A - G C; `step` (s): None in continuous time.
    """

    name: str
    theorem: str
    gamma: Fraction
    rate: Fraction
    delay: Fraction
    dwell: Fraction
    step: Fraction | None
    stays: Mapping[str, tuple[Fraction, Fraction]]
    cells: Mapping[str, tuple[Fraction, ...]]
    P: Mapping[str, Rational]
    matrices: Mapping[str, Rational]


@dataclass(frozen=True, slots=True, eq=False)
class Summary:
    """What a design states once for all: rate, required dwell time, and eigenvalues (re, im) by location."""

    rate: Fraction
    required: Fraction | None
    eigenvalues: Mapping[str, tuple[tuple[Fraction, Fraction], ...]]


def read_design(path: str) -> Mapping[str, object]:
    """Return the tree of a design file, of the `design.json` in a compiled folder, or of standard input ("-").

    Raises `UsageError` (DH0511) where there is no such file, or it is not JSON, or its numbers are not finite.
    """
    place = Path(path) / "design.json" if path != "-" and Path(path).is_dir() else Path(path)
    path = str(place)
    try:
        if path == "-":
            text = sys.stdin.read(LARGEST_FILE + 1)
        else:
            with place.open(encoding="utf-8") as file:
                text = file.read(LARGEST_FILE + 1)
    except (OSError, UnicodeDecodeError) as error:
        refuse(f"`{path}` cannot be read: {getattr(error, 'strerror', None) or 'it is not UTF-8 text'}")
    if len(text) > LARGEST_FILE:
        refuse(f"`{path}` is longer than {LARGEST_FILE // 1_000_000} million characters")
    try:
        tree = json.loads(text, parse_constant=no_constant, object_pairs_hook=no_key_twice)
        json.dumps(tree, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        refuse(f"`{path}` holds half of a character, an escape from `\\ud800` to `\\udfff` that stands alone")
    except (ValueError, RecursionError) as error:
        refuse(f"`{path}` is not JSON: {error}")
    if not isinstance(tree, dict):
        refuse(f"`{path}` holds no JSON object")
    return tree


def read_summary(document: Mapping[str, object], plant: Plant) -> Summary:
    """Return what the design says outside of its certificates and can be checked against them."""
    for key in ("rate", "required_dwell"):
        require(key in document, key, "a number")
    same_names(mapping_at(document, "gains", "design"), "gains", plant)
    required, spectra = document["required_dwell"], {}
    if "eigenvalues" in document:
        given = mapping_at(document, "eigenvalues", "design")
        same_names(given, "eigenvalues", plant)
        for name, (A, _) in plant.locations.items():
            rows = matrix_at(given.get(name), f"eigenvalues.{name}", columns=2, rows=len(A))
            spectra[name] = tuple((row[0], row[1]) for row in rows)
    wanted = None if required is None else number_at(required, "required_dwell")
    return Summary(number_at(document["rate"], "rate"), wanted, spectra)


def same_names(found: Mapping[str, object], where: str, plant: Plant) -> None:
    """Refuse an object that has not exactly the locations as its keys."""
    require(set(found) == set(plant.locations), where, "one entry for each location of `system`, and no other")


def read_plant(document: Mapping[str, object]) -> Plant:
    """Return the matrices of the persistent locations, with their gains."""
    system = mapping_at(document, "system", "design")
    places = mapping_at(system, "locations", "system")
    locations: dict[str, tuple[Rational, Rational]] = {}
    gains: dict[str, Rational] = {}
    given = mapping_at(document, "gains", "design")
    for name, value in places.items():
        entry = as_mapping(value, f"system.locations.{name}")
        A = matrix_at(entry.get("A"), f"system.locations.{name}.A")
        n = len(A)
        if n > LARGEST_STATE:
            raise LimitReached(diagnostic("DH0512", f"`{name}` has {n} states, exact checks stop at {LARGEST_STATE}"))
        require(n > 0 and all(len(row) == n for row in A), f"system.locations.{name}.A", "a square matrix")
        C = matrix_at(entry.get("C"), f"system.locations.{name}.C", columns=n)
        locations[name] = A, C
        gains[name] = matrix_at(given.get(name), f"gains.{name}", columns=len(C), rows=n)
    require(len({len(A) for A, _ in locations.values()}) == 1, "system.locations", "locations with equal states")
    step = system.get("time_step")
    jumps = _jumps(system, locations)
    longest = {k: number_at(v, f"longest_stays.{k}") for k, v in _longest(system, locations).items()}
    return Plant(locations, gains, jumps, None if step is None else number_at(step, "system.time_step"), longest)


def read_claims(document: Mapping[str, object], plant: Plant) -> tuple[Claim, ...]:
    """Return the certificates, in the order of the file."""
    entries = document.get("certificates")
    if not isinstance(entries, list):
        refuse("`certificates` is not a list")
    numbered = ((k, as_mapping(entry, f"certificates[{k}]")) for k, entry in enumerate(entries))
    return tuple(
        _claim(entry, k, plant) for k, entry in numbered if entry.get("theorem") not in BOX_THEOREMS + FORM_THEOREMS
    )


def read_contractions(document: Mapping[str, object], plant: Plant) -> tuple[Contraction | str, ...]:
    """Return the contractions over a box of stays that are claimed; of one that is not claimed, the name alone."""
    entries = document.get("certificates")
    numbered = enumerate(entries if isinstance(entries, list) else [])
    found = ((k, as_mapping(entry, f"certificates[{k}]")) for k, entry in numbered)
    return tuple(_contraction(entry, k, plant) for k, entry in found if entry.get("theorem") in BOX_THEOREMS)


def _jumps(system: Mapping[str, object], locations: Mapping[str, tuple[Rational, Rational]]) -> tuple[Jump, ...]:
    entries = system.get("resets")
    if not isinstance(entries, list):
        refuse("`system.resets` is not a list")
    jumps = []
    for k, value in enumerate(entries):
        entry, where = as_mapping(value, f"system.resets[{k}]"), f"system.resets[{k}]"
        source, target = entry.get("from"), entry.get("to")
        known = all(isinstance(name, str) and name in locations for name in (source, target))
        require(known, where, "`from` and `to` that name locations")
        n = len(next(iter(locations.values()))[0])
        jumps.append(Jump(str(source), str(target), matrix_at(entry.get("matrix"), where, columns=n, rows=n)))
    return tuple(jumps)


def _longest(system: Mapping[str, object], locations: Mapping[str, object]) -> Mapping[str, object]:
    if system.get("longest_stays") is None:
        return {}
    found = mapping_at(system, "longest_stays", "system")
    require(set(found) <= set(locations), "system.longest_stays", "names of locations")
    return found


def _claim(entry: Mapping[str, object], number: int, plant: Plant) -> Claim:
    where, theorem, holds = f"certificates[{number}]", entry.get("theorem"), entry.get("holds")
    name = f"certificate {number + 1} ({theorem})"
    require(isinstance(theorem, str), f"{where}.theorem", "a text")
    require(isinstance(holds, bool), f"{where}.holds", "true or false")
    if not holds:
        zero, stated = Fraction(), entry.get("required_dwell")
        late = number_at(entry.get("delay"), f"{where}.delay")
        needed = None if stated is None else number_at(stated, f"{where}.required_dwell")
        return Claim(name, str(theorem), False, zero, zero, late, needed, None, (), {}, {}, {})
    n = len(next(iter(plant.locations.values()))[0])
    scale = matrix_at([entry.get("scale")], f"{where}.scale", columns=n)[0]
    for key in ("terms", "T"):
        same_names(mapping_at(entry, key, where), f"{where}.{key}", plant)
    terms, bases, matrices = {}, {}, {}
    for location in plant.locations:
        place = f"{where}.terms.{location}"
        term = mapping_at(mapping_at(entry, "terms", where), location, f"{where}.terms")
        terms[location] = Term(*(number_at(term.get(key), f"{place}.{key}") for key in ("alpha", "kappa", "r")))
        bases[location] = complex_matrix(mapping_at(entry, "T", where).get(location), f"{where}.T.{location}", n)
        if str(theorem).endswith("-sampled"):
            made = mapping_at(entry, "matrices", where).get(location)
            matrices[location] = matrix_at(made, f"{where}.matrices.{location}", columns=n, rows=n)
    rate, dwell, delay = (number_at(entry.get(key), f"{where}.{key}") for key in ("rate", "dwell", "delay"))
    required, step = entry.get("required_dwell"), entry.get("step")
    wanted = None if required is None else number_at(required, f"{where}.required_dwell")
    tick = None if step is None else number_at(step, f"{where}.step")
    require(tick is None or tick > 0, f"{where}.step", "a positive step or null")
    return Claim(name, str(theorem), True, rate, dwell, delay, wanted, tick, scale, terms, bases, matrices)


def _contraction(entry: Mapping[str, object], number: int, plant: Plant) -> Contraction | str:
    where, theorem, holds = f"certificates[{number}]", str(entry.get("theorem")), entry.get("holds")
    name = f"certificate {number + 1} ({theorem})"
    require(isinstance(holds, bool), f"{where}.holds", "true or false")
    if not holds:
        return name
    n, sampled = len(next(iter(plant.locations.values()))[0]), theorem.endswith("-sampled")
    timed = sampled or plant.time_step is not None
    parts = {key: mapping_at(entry, key, where) for key in ("stays", "cells", "P")}
    if timed:
        parts["matrices"] = mapping_at(entry, "matrices", where)
    for key, part in parts.items():
        same_names(part, f"{where}.{key}", plant)
    stays = {k: matrix_at([value], f"{where}.stays.{k}", columns=2)[0] for k, value in parts["stays"].items()}
    P = {k: matrix_at(value, f"{where}.P.{k}", columns=n, rows=n) for k, value in parts["P"].items()}
    given = parts.get("matrices", {})
    matrices = {k: matrix_at(value, f"{where}.matrices.{k}", columns=n, rows=n) for k, value in given.items()}
    step = number_at(entry.get("step"), f"{where}.step") if timed else None
    require(step is None or step > 0, f"{where}.step", "a positive step")
    return Contraction(
        name,
        theorem,
        number_at(entry.get("gamma"), f"{where}.gamma"),
        number_at(entry.get("rate"), f"{where}.rate"),
        number_at(entry.get("delay"), f"{where}.delay"),
        number_at(entry.get("dwell"), f"{where}.dwell"),
        step,
        {k: (stay[0], stay[1]) for k, stay in stays.items()},
        {k: matrix_at([value], f"{where}.cells.{k}")[0] for k, value in parts["cells"].items()},
        P,
        matrices if timed else {k: plant.error_matrix(k) for k in plant.locations},
    )


__all__ = [
    "FORM_THEOREMS",
    "Claim",
    "Contraction",
    "Jump",
    "Plant",
    "Summary",
    "Term",
    "read_claims",
    "read_contractions",
    "read_design",
    "read_plant",
    "read_summary",
    "same_names",
]
