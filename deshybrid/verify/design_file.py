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
from math import isfinite
from pathlib import Path
from typing import NamedTuple, NoReturn

from deshybrid.diagnostics import LimitReached, UsageError, diagnostic
from deshybrid.linear.exact import Rational, combined, product

LARGEST_FILE = 64_000_000
LARGEST_STATE = 40
BOX_THEOREMS = ("B03-box", "B03-box-sampled")
LARGEST_INTEGER = int(sys.float_info.max)


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
    """A and C by location, gains, resets, and the step of a system in discrete time."""

    locations: Mapping[str, tuple[Rational, Rational]]
    gains: Mapping[str, Rational]
    resets: tuple[Jump, ...]
    time_step: Fraction | None

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
        _refuse(f"`{path}` cannot be read: {getattr(error, 'strerror', None) or 'it is not UTF-8 text'}")
    if len(text) > LARGEST_FILE:
        _refuse(f"`{path}` is longer than {LARGEST_FILE // 1_000_000} million characters")
    try:
        tree = json.loads(text, parse_constant=_no_constant, object_pairs_hook=_no_key_twice)
        json.dumps(tree, ensure_ascii=False).encode()
    except UnicodeEncodeError:
        _refuse(f"`{path}` holds half of a character, an escape from `\\ud800` to `\\udfff` that stands alone")
    except (ValueError, RecursionError) as error:
        _refuse(f"`{path}` is not JSON: {error}")
    if not isinstance(tree, dict):
        _refuse(f"`{path}` holds no JSON object")
    return tree


def read_summary(document: Mapping[str, object], plant: Plant) -> Summary:
    """Return what the design says outside of its certificates and can be checked against them."""
    for key in ("rate", "required_dwell"):
        _require(key in document, key, "a number")
    _same_names(_mapping(document, "gains", "design"), "gains", plant)
    required, spectra = document["required_dwell"], {}
    if "eigenvalues" in document:
        given = _mapping(document, "eigenvalues", "design")
        _same_names(given, "eigenvalues", plant)
        for name, (A, _) in plant.locations.items():
            rows = _matrix(given.get(name), f"eigenvalues.{name}", columns=2, rows=len(A))
            spectra[name] = tuple((row[0], row[1]) for row in rows)
    wanted = None if required is None else _number(required, "required_dwell")
    return Summary(_number(document["rate"], "rate"), wanted, spectra)


def _same_names(found: Mapping[str, object], where: str, plant: Plant) -> None:
    _require(set(found) == set(plant.locations), where, "one entry for each location of `system`, and no other")


def read_plant(document: Mapping[str, object]) -> Plant:
    """Return the matrices of the persistent locations, with their gains."""
    system = _mapping(document, "system", "design")
    places = _mapping(system, "locations", "system")
    locations: dict[str, tuple[Rational, Rational]] = {}
    gains: dict[str, Rational] = {}
    given = _mapping(document, "gains", "design")
    for name, value in places.items():
        entry = _as_mapping(value, f"system.locations.{name}")
        A = _matrix(entry.get("A"), f"system.locations.{name}.A")
        n = len(A)
        if n > LARGEST_STATE:
            raise LimitReached(diagnostic("DH0512", f"`{name}` has {n} states, exact checks stop at {LARGEST_STATE}"))
        _require(n > 0 and all(len(row) == n for row in A), f"system.locations.{name}.A", "a square matrix")
        C = _matrix(entry.get("C"), f"system.locations.{name}.C", columns=n)
        locations[name] = A, C
        gains[name] = _matrix(given.get(name), f"gains.{name}", columns=len(C), rows=n)
    _require(len({len(A) for A, _ in locations.values()}) == 1, "system.locations", "locations with equal states")
    step = system.get("time_step")
    jumps = _jumps(system, locations)
    return Plant(locations, gains, jumps, None if step is None else _number(step, "system.time_step"))


def read_claims(document: Mapping[str, object], plant: Plant) -> tuple[Claim, ...]:
    """Return the certificates, in the order of the file."""
    entries = document.get("certificates")
    if not isinstance(entries, list):
        _refuse("`certificates` is not a list")
    numbered = ((k, _as_mapping(entry, f"certificates[{k}]")) for k, entry in enumerate(entries))
    return tuple(_claim(entry, k, plant) for k, entry in numbered if entry.get("theorem") not in BOX_THEOREMS)


def read_contractions(document: Mapping[str, object], plant: Plant) -> tuple[Contraction | str, ...]:
    """Return the contractions over a box of stays that are claimed; of one that is not claimed, the name alone."""
    entries = document.get("certificates")
    numbered = enumerate(entries if isinstance(entries, list) else [])
    found = ((k, _as_mapping(entry, f"certificates[{k}]")) for k, entry in numbered)
    return tuple(_contraction(entry, k, plant) for k, entry in found if entry.get("theorem") in BOX_THEOREMS)


def _jumps(system: Mapping[str, object], locations: Mapping[str, tuple[Rational, Rational]]) -> tuple[Jump, ...]:
    entries = system.get("resets")
    if not isinstance(entries, list):
        _refuse("`system.resets` is not a list")
    jumps = []
    for k, value in enumerate(entries):
        entry, where = _as_mapping(value, f"system.resets[{k}]"), f"system.resets[{k}]"
        source, target = entry.get("from"), entry.get("to")
        known = all(isinstance(name, str) and name in locations for name in (source, target))
        _require(known, where, "`from` and `to` that name locations")
        n = len(next(iter(locations.values()))[0])
        jumps.append(Jump(str(source), str(target), _matrix(entry.get("matrix"), where, columns=n, rows=n)))
    return tuple(jumps)


def _claim(entry: Mapping[str, object], number: int, plant: Plant) -> Claim:
    where, theorem, holds = f"certificates[{number}]", entry.get("theorem"), entry.get("holds")
    name = f"certificate {number + 1} ({theorem})"
    _require(isinstance(theorem, str), f"{where}.theorem", "a text")
    _require(isinstance(holds, bool), f"{where}.holds", "true or false")
    if not holds:
        zero, stated = Fraction(), entry.get("required_dwell")
        needed = None if stated is None else _number(stated, f"{where}.required_dwell")
        return Claim(name, str(theorem), False, zero, zero, zero, needed, None, (), {}, {}, {})
    n = len(next(iter(plant.locations.values()))[0])
    scale = _matrix([entry.get("scale")], f"{where}.scale", columns=n)[0]
    for key in ("terms", "T"):
        _same_names(_mapping(entry, key, where), f"{where}.{key}", plant)
    terms, bases, matrices = {}, {}, {}
    for location in plant.locations:
        place = f"{where}.terms.{location}"
        term = _mapping(_mapping(entry, "terms", where), location, f"{where}.terms")
        terms[location] = Term(*(_number(term.get(key), f"{place}.{key}") for key in ("alpha", "kappa", "r")))
        bases[location] = _complex_matrix(_mapping(entry, "T", where).get(location), f"{where}.T.{location}", n)
        if str(theorem).endswith("-sampled"):
            made = _mapping(entry, "matrices", where).get(location)
            matrices[location] = _matrix(made, f"{where}.matrices.{location}", columns=n, rows=n)
    rate, dwell, delay = (_number(entry.get(key), f"{where}.{key}") for key in ("rate", "dwell", "delay"))
    required, step = entry.get("required_dwell"), entry.get("step")
    wanted = None if required is None else _number(required, f"{where}.required_dwell")
    tick = None if step is None else _number(step, f"{where}.step")
    _require(tick is None or tick > 0, f"{where}.step", "a positive step or null")
    return Claim(name, str(theorem), True, rate, dwell, delay, wanted, tick, scale, terms, bases, matrices)


def _contraction(entry: Mapping[str, object], number: int, plant: Plant) -> Contraction | str:
    where, theorem, holds = f"certificates[{number}]", str(entry.get("theorem")), entry.get("holds")
    name = f"certificate {number + 1} ({theorem})"
    _require(isinstance(holds, bool), f"{where}.holds", "true or false")
    if not holds:
        return name
    n, sampled = len(next(iter(plant.locations.values()))[0]), theorem.endswith("-sampled")
    timed = sampled or plant.time_step is not None
    parts = {key: _mapping(entry, key, where) for key in ("stays", "cells", "P")}
    if timed:
        parts["matrices"] = _mapping(entry, "matrices", where)
    for key, part in parts.items():
        _same_names(part, f"{where}.{key}", plant)
    stays = {k: _matrix([value], f"{where}.stays.{k}", columns=2)[0] for k, value in parts["stays"].items()}
    P = {k: _matrix(value, f"{where}.P.{k}", columns=n, rows=n) for k, value in parts["P"].items()}
    given = parts.get("matrices", {})
    matrices = {k: _matrix(value, f"{where}.matrices.{k}", columns=n, rows=n) for k, value in given.items()}
    step = _number(entry.get("step"), f"{where}.step") if timed else None
    _require(step is None or step > 0, f"{where}.step", "a positive step")
    return Contraction(
        name,
        theorem,
        _number(entry.get("gamma"), f"{where}.gamma"),
        _number(entry.get("rate"), f"{where}.rate"),
        _number(entry.get("delay"), f"{where}.delay"),
        _number(entry.get("dwell"), f"{where}.dwell"),
        step,
        {k: (stay[0], stay[1]) for k, stay in stays.items()},
        {k: _matrix([value], f"{where}.cells.{k}")[0] for k, value in parts["cells"].items()},
        P,
        matrices if timed else {k: plant.error_matrix(k) for k in plant.locations},
    )


def _complex_matrix(value: object, where: str, n: int) -> tuple[Rational, Rational]:
    if not isinstance(value, list) or len(value) != n:
        _refuse(f"`{where}`: expected {n} rows of pairs [re, im]")
    rows = [_matrix(row, f"{where}[{k}]", columns=2, rows=n) for k, row in enumerate(value)]
    return tuple(tuple(pair[0] for pair in row) for row in rows), tuple(tuple(pair[1] for pair in row) for row in rows)


def _matrix(value: object, where: str, *, columns: int | None = None, rows: int | None = None) -> Rational:
    if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
        _refuse(f"`{where}` is not a matrix")
    _require(rows is None or len(value) == rows, where, f"{rows} rows")
    _require(columns is None or all(len(row) == columns for row in value), where, f"{columns} columns")
    return tuple(tuple(_number(entry, where) for entry in row) for row in value)


def _number(value: object, where: str) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, int | float):
        _refuse(f"`{where}` holds something else than finite numbers")
    if (abs(value) > LARGEST_INTEGER) if isinstance(value, int) else not isfinite(value):
        _refuse(f"`{where}` holds a number that is no finite double")
    return Fraction(value)


def _mapping(tree: Mapping[str, object], key: str, where: str) -> Mapping[str, object]:
    return _as_mapping(tree.get(key), f"{where}.{key}")


def _as_mapping(value: object, where: str) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        _refuse(f"`{where}` is missing or no JSON object")
    return value


def _require(condition: bool, where: str, expected: str) -> None:
    if not condition:
        _refuse(f"`{where}`: expected {expected}")


def _no_key_twice(pairs: list[tuple[str, object]]) -> dict[str, object]:
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key `{twice[:80]}` stands twice in one object")
    return found


def _no_constant(text: str) -> NoReturn:
    raise ValueError(f"{text} is not a number of JSON")


def _refuse(message: str) -> NoReturn:
    raise UsageError(
        diagnostic("DH0511", f"not a design: {message}", helps=("write it with `deshybrid design --json`",))
    )


__all__ = [
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
]
