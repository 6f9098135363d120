"""Certificates by matrix inequalities as a file states them, read into exact numbers.

In: the JSON tree of a design and its plant.  Out: claims with their nodes, forms and spans of stays; what is malformed
is refused with its path (DH0511).  Nothing is believed here: `verify/forms.py` checks what is said.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import ceil, floor

from deshybrid.diagnostics import LimitReached, diagnostic
from deshybrid.linear.exact import Rational
from deshybrid.linear.lifting import lifted_size
from deshybrid.verify.design_file import FORM_THEOREMS, Plant, same_names
from deshybrid.verify.values import as_mapping, mapping_at, matrix_at, number_at, refuse, require

PART_OF_A_STEP = Fraction(1, 10**6)
LARGEST_FORM = 130
"""Forms with more rows are refused: they would take minutes each."""


@dataclass(frozen=True, slots=True, eq=False)
class NodeClaim:
    """A location with a history; exits: the node that is entered by each reset, by their places in the system."""

    location: str
    exits: Mapping[int, str]


@dataclass(frozen=True, slots=True, eq=False)
class SpanClaim:
    """The forms of stays at a node that last `start` to `end` seconds longer than the shortest; one Q without an end.

    With an end there are two, at start and end, and they are linear in time between them.
    """

    node: str
    start: Fraction
    end: Fraction | None
    Q: tuple[Rational, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FormClaim:
    """One certificate that claims to hold; degree: d; matrices: M of the sampled observer, else A - G C.

    shortest and longest: stays (s) of locations on their own, where stated.
    """

    name: str
    theorem: str
    rate: Fraction
    dwell: Fraction
    delay: Fraction
    required: Fraction
    step: Fraction | None
    degree: int
    shortest: Mapping[str, Fraction]
    longest: Mapping[str, Fraction]
    nodes: Mapping[str, NodeClaim]
    P: Mapping[str, Rational]
    spans: tuple[SpanClaim, ...]
    matrices: Mapping[str, Rational]

    def stay(self, name: str, dwell: Fraction) -> Fraction:
        """T = max(dwell, the location's own shortest stay) - Δ, no longer than its longest stay lasts.

        In sampled time the least whole number of steps.
        """
        stay, longest = max(dwell, self.shortest.get(name, Fraction())) - self.delay, self.longest_stay(name)
        if self.step is not None:
            stay = max(1, ceil(stay / self.step - PART_OF_A_STEP)) * self.step
        return stay if longest is None else min(stay, longest)

    def longest_stay(self, name: str) -> Fraction | None:
        """The longest stay that the observer can see: that of the location, and Δ; in sampled time whole steps."""
        if name not in self.longest:
            return None
        stay = self.longest[name] + self.delay
        return stay if self.step is None else max(1, floor(stay / self.step + PART_OF_A_STEP)) * self.step


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
    size = lifted_size(plant.size, degree)
    if size > LARGEST_FORM:
        raise LimitReached(diagnostic("DH0512", f"forms of {size} rows, exact checks stop at {LARGEST_FORM}"))
    step = None if entry.get("step") is None else number_at(entry.get("step"), f"{where}.step")
    require(step is None or step > 0, f"{where}.step", "a positive step or null")
    shortest = {
        key: number_at(value, f"{where}.shortest_stays.{key}")
        for key, value in mapping_at(entry, "shortest_stays", where).items()
    }
    require(set(shortest) <= set(plant.locations), f"{where}.shortest_stays", "names of locations")
    nodes = _nodes(entry, where, plant)
    return FormClaim(
        name,
        theorem,
        rate,
        dwell,
        delay,
        required,
        step,
        degree,
        shortest,
        plant.longest,
        nodes,
        _forms(entry, where, size, nodes),
        _spans(entry, where, size, nodes, step),
        _matrices(entry, where, plant) if theorem.endswith("-sampled") else _error_matrices(plant),
    )


def _degree(value: object, where: str) -> int:
    if not isinstance(value, int) or isinstance(value, bool) or value < 2 or value % 2:
        refuse(f"`{where}`: expected an even number, 2 or more")
    return value // 2


def _nodes(entry: Mapping[str, object], where: str, plant: Plant) -> Mapping[str, NodeClaim]:
    tree, found = mapping_at(entry, "nodes", where), {}
    for name, value in tree.items():
        node, place = as_mapping(value, f"{where}.nodes.{name}"), f"{where}.nodes.{name}"
        location, exits = node.get("location"), node.get("exits")
        require(isinstance(location, str) and location in plant.locations, f"{place}.location", "a location's name")
        if not isinstance(exits, list):
            refuse(f"`{place}.exits` is not a list")
        for pair in exits:
            known = isinstance(pair, list) and len(pair) == 2 and isinstance(pair[1], str) and pair[1] in tree
            require(known, f"{place}.exits", "pairs of a reset's place and a node's name")
            number = number_at(pair[0], f"{place}.exits")
            inside = number.denominator == 1 and 0 <= number < len(plant.resets)
            require(inside, f"{place}.exits", "places in the list of resets")
        found[name] = NodeClaim(str(location), {int(pair[0]): pair[1] for pair in exits})
    return found


def _forms(
    entry: Mapping[str, object], where: str, size: int, nodes: Mapping[str, NodeClaim]
) -> Mapping[str, Rational]:
    tree = mapping_at(entry, "P", where)
    require(set(tree) == set(nodes), f"{where}.P", "one form for each of `nodes`, and no other")
    return {name: matrix_at(value, f"{where}.P.{name}", columns=size, rows=size) for name, value in tree.items()}


def _spans(
    entry: Mapping[str, object], where: str, size: int, nodes: Mapping[str, NodeClaim], step: Fraction | None
) -> tuple[SpanClaim, ...]:
    """The spans; in sampled time their ends are the nearest whole steps."""
    listed, found = entry.get("stays"), []
    if not isinstance(listed, list):
        refuse(f"`{where}.stays` is not a list")
    for k, value in enumerate(listed):
        span, place = as_mapping(value, f"{where}.stays[{k}]"), f"{where}.stays[{k}]"
        node, forms = span.get("node"), span.get("Q")
        require(isinstance(node, str) and node in nodes, f"{place}.node", "a node's name")
        start = _whole(number_at(span.get("from"), f"{place}.from"), step)
        end = None if span.get("to") is None else _whole(number_at(span.get("to"), f"{place}.to"), step)
        require(end is None or end >= start, f"{place}.to", "no time before `from`, or null")
        count = 1 if end is None else 2
        if not isinstance(forms, list) or len(forms) != count:
            refuse(f"`{place}.Q`: expected {count} of them")
        Q = tuple(matrix_at(form, f"{place}.Q", columns=size, rows=size) for form in forms)
        found.append(SpanClaim(str(node), start, end, Q))
    return tuple(found)


def _whole(time: Fraction, step: Fraction | None) -> Fraction:
    return time if step is None else round(time / step) * step


def _matrices(entry: Mapping[str, object], where: str, plant: Plant) -> Mapping[str, Rational]:
    found, n = mapping_at(entry, "matrices", where), plant.size
    same_names(found, f"{where}.matrices", plant)
    return {name: matrix_at(value, f"{where}.matrices.{name}", columns=n, rows=n) for name, value in found.items()}


def _error_matrices(plant: Plant) -> Mapping[str, Rational]:
    return {name: plant.error_matrix(name) for name in plant.locations}


__all__ = ["FormClaim", "NodeClaim", "SilentForm", "SpanClaim", "read_forms"]
