"""The JSON of `recover`, read for a checker: the system, the candidates, the signatures and the constraints.

In: the JSON tree.  Out: a `Plan`; numbers are exact, a decimal counts as written.  Nothing in the file is trusted:
every malformed part is a `UsageError` (DH0408) that names its path in the tree.  Cost: linear in the file.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import isfinite
from typing import NamedTuple, NoReturn, TypeAlias, TypeVar

from deshybrid.diagnostics import UsageError, diagnostic

T = TypeVar("T")
Step: TypeAlias = tuple[int, str | None, str | None]  # transition, output, command


class Arc(NamedTuple):
    """One transition; an output None is ε.  `commands` permit it; where none is known, `commands` is (None,)."""

    source: str
    event: str
    target: str
    outputs: tuple[str | None, ...]
    commands: tuple[str | None, ...]

    def coincides(self, other: "Arc") -> bool:
        """Return whether some command permits both."""
        return None in self.commands + other.commands or not set(self.commands).isdisjoint(other.commands)


class Offer(NamedTuple):
    """A candidate; `generator` is what it takes by residual: a location's name, or its own if it covers several."""

    name: str
    locations: tuple[str, ...]
    covering: bool
    transitions: tuple[int, ...]
    cost: Fraction
    residual: bool
    negation: bool

    @property
    def generator(self) -> str:
        """What it takes by residual; a detector has no location's name, so that the two are kept apart."""
        return self.name if self.covering else self.locations[0]


class Claimed(NamedTuple):
    """A constraint as the file states it: one of these is needed, because of these runs."""

    condition: str
    transitions: tuple[int, ...]
    detectors: tuple[str, ...]
    runs: tuple[tuple[Step, ...], ...]
    cycles: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True)
class Plan:
    """What is checked; `instrumented` holds (candidate number, by, numbers of transitions) for each signature."""

    locations: tuple[str, ...]
    initial: tuple[str, ...]
    arcs: tuple[Arc, ...]
    offers: tuple[Offer, ...]
    instrumented: tuple[tuple[int, str, tuple[int, ...]], ...]
    generators: tuple[str, ...]
    count: int
    cost: Fraction
    lower_bound: Fraction
    optimal: bool
    gap: Fraction
    constraints: tuple[Claimed, ...]


def is_plan(document: Mapping[str, object]) -> bool:
    """Return whether a JSON tree is what `recover --json` writes, rather than a design."""
    return "recoverable" in document


def read_plan(document: Mapping[str, object]) -> Plan:
    """Return the plan; the system must be recoverable.

    Raises `UsageError` (DH0408) where a part is missing or malformed.
    """
    if document.get("recoverable") is not True:
        _refuse("it says that nothing recovers the system, which has no proof here")
    system = _mapping(document.get("system"), "system")
    locations = _texts(system.get("locations"), "system.locations")
    arcs = _each(system.get("transitions"), "system.transitions", lambda v, at: _arc(v, at, locations))
    offers = _each(document.get("candidates"), "candidates", lambda v, at: _offer(v, at, locations, len(arcs)))
    names = [offer.name for offer in offers]
    _require(len(set(names)) == len(names), "candidates", "different names")
    initial = _texts(system.get("initial"), "system.initial", locations)
    return Plan(
        locations,
        initial,
        arcs,
        offers,
        _signatures(document, names, len(arcs)),
        _texts(document.get("generator_names"), "generator_names"),
        _whole(document.get("generators"), "generators", None),
        _number(document.get("cost"), "cost"),
        _number(document.get("lower_bound"), "lower_bound"),
        _flag(document.get("optimal"), "optimal"),
        _number(document.get("gap"), "gap"),
        _each(document.get("constraints"), "constraints", lambda v, at: _constraint(v, at, names, len(arcs))),
    )


def _arc(value: object, where: str, locations: tuple[str, ...]) -> Arc:
    row = _list(value, where)
    _require(len(row) in (4, 5), where, "4 entries, and perhaps a list of commands")
    source, event, target = _texts(row[:3], where)
    _require(source in locations and target in locations, where, "known locations")
    outputs = _each(row[3], f"{where}[3]", _output)
    _require(bool(outputs), f"{where}[3]", "an output, null for none")
    commands = _texts(row[4], f"{where}[4]") if len(row) > 4 else (None,)
    _require(bool(commands), f"{where}[4]", "a command")
    return Arc(source, event, target, outputs, commands)


def _offer(value: object, where: str, locations: tuple[str, ...], arcs: int) -> Offer:
    tree = _mapping(value, where)
    entered = _texts(tree.get("locations"), f"{where}.locations", locations)
    covering = _flag(tree.get("covering"), f"{where}.covering")
    residual, negation = (_flag(tree.get(key), f"{where}.{key}") for key in ("residual", "negation"))
    _require(bool(entered) and (covering or len(entered) == 1), f"{where}.locations", "one location, or a detector")
    _require(not covering or (residual and not negation), where, "a detector without negation")
    cost = _number(tree.get("cost"), f"{where}.cost")
    _require(cost >= 0, f"{where}.cost", "no negative number")
    numbers = _numbers(tree.get("transitions"), f"{where}.transitions", arcs)
    name = _text(tree.get("name"), f"{where}.name")
    _require(not (covering and name in locations), f"{where}.name", "another name than that of a location")
    return Offer(name, entered, covering, numbers, cost, residual, negation)


def _signatures(
    document: Mapping[str, object], names: list[str], arcs: int
) -> tuple[tuple[int, str, tuple[int, ...]], ...]:
    numbers = _mapping(document.get("instrumented"), "instrumented")
    found = []
    for place, value in enumerate(_list(document.get("signatures"), "signatures")):
        where = f"signatures[{place}]"
        tree = _mapping(value, where)
        name, by = _text(tree.get("name"), f"{where}.name"), _text(tree.get("by"), f"{where}.by")
        _require(name in names, f"{where}.name", "the name of a candidate")
        found.append((names.index(name), by, _numbers(numbers.get(name), f"instrumented.{name}", arcs)))
    _require(len(found) == len(numbers), "instrumented", "the names of the signatures")
    return tuple(found)


def _constraint(value: object, where: str, names: list[str], arcs: int) -> Claimed:
    tree = _mapping(value, where)
    runs = _each(tree.get("runs"), f"{where}.runs", lambda v, at: _each(v, at, lambda w, on: _step(w, on, arcs)))
    cycles = _each(tree.get("cycles"), f"{where}.cycles", lambda v, at: _numbers(_list(v, at, 2), at, None))
    return Claimed(
        _text(tree.get("condition"), f"{where}.condition"),
        _numbers(tree.get("transitions"), f"{where}.transitions", arcs),
        _texts(tree.get("detectors"), f"{where}.detectors", tuple(names)),
        runs,
        tuple((start, stop) for start, stop in cycles),
    )


def _step(value: object, where: str, arcs: int) -> Step:
    row = _list(value, where)
    _require(len(row) in (2, 3), where, "a transition, an output, and perhaps a command")
    return _whole(row[0], where, arcs), _output(row[1], where), _output(row[2], where) if len(row) > 2 else None


def _output(value: object, where: str) -> str | None:
    return None if value is None else _text(value, where)


def _each(value: object, where: str, read: Callable[[object, str], T]) -> tuple[T, ...]:
    return tuple(read(item, f"{where}[{place}]") for place, item in enumerate(_list(value, where)))


def _list(value: object, where: str, length: int | None = None) -> list[object]:
    _require(isinstance(value, list), where, "a list")
    items = value if isinstance(value, list) else []
    _require(length is None or len(items) == length, where, f"{length} entries")
    return items


def _texts(value: object, where: str, known: tuple[str, ...] | None = None) -> tuple[str, ...]:
    found = _each(value, where, _text)
    _require(known is None or set(found) <= set(known), where, "known names")
    return found


def _numbers(value: object, where: str, below: int | None) -> tuple[int, ...]:
    return _each(value, where, lambda item, at: _whole(item, at, below))


def _whole(value: object, where: str, below: int | None) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 0 or (below is not None and value >= below):
        _refuse(f"`{where}`: expected a whole number" + ("" if below is None else f" below {below}"))
    return value


def _number(value: object, where: str) -> Fraction:
    if isinstance(value, bool) or not isinstance(value, int | float) or not isfinite(value):
        _refuse(f"`{where}`: expected a finite number")
    return Fraction(repr(value))


def _flag(value: object, where: str) -> bool:
    if not isinstance(value, bool):
        _refuse(f"`{where}`: expected true or false")
    return value


def _text(value: object, where: str) -> str:
    if not isinstance(value, str):
        _refuse(f"`{where}`: expected a text")
    return value


def _mapping(value: object, where: str) -> Mapping[str, object]:
    if not isinstance(value, Mapping):
        _refuse(f"`{where}` is missing or no JSON object")
    return value


def _require(condition: bool, where: str, expected: str) -> None:
    if not condition:
        _refuse(f"`{where}`: expected {expected}")


def _refuse(message: str) -> NoReturn:
    raise UsageError(
        diagnostic("DH0408", f"no plan to verify: {message}", helps=("write it with `deshybrid recover --json`",))
    )


__all__ = ["Arc", "Claimed", "Offer", "Plan", "Step", "is_plan", "read_plan"]
