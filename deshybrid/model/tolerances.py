"""How far the matrices of a plant may be from the model's: from tolerances of its parameters.

In: the tree, the shares by which parameters may be wrong, the locations.  Out: the locations with their `deviation`,
the largest |true - nominal| of every entry, by interval arithmetic on what is written; arrays from files are exact.
Entries are taken each for itself: that a parameter moves several at once is not used, so that the deviations are upper
bounds.

Cost: linear in the file.  Source: as `intervals`.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.expressions import ExpressionError, parse_arithmetic
from deshybrid.model.intervals import Interval, enclosure
from deshybrid.model.problems import Problems
from deshybrid.model.system import Bounds, Location
from deshybrid.model.tree import MappingNode, Node, ScalarNode, SequenceNode

KEYS = ("A", "B", "C", "D", "E", "f", "g")


def with_deviations(
    locations: tuple[Location, ...], tree: MappingNode, tolerance: Mapping[str, float], problems: Problems
) -> tuple[Location, ...]:
    """Return the locations with what their matrices may be wrong by; the tolerances are shares of the parameters.

    Reports DH0221 where no bound is known.

    >>> from deshybrid.model.load import loads
    >>> pump = loads('''
    ... {format: deshybrid/1, parameters: {k: 2, r: 1/k}, tolerance: {k: 0.1}, state: [h], output: [y],
    ...  bounds: {state: 1}, locations: {on: {A: [[-k]], C: [[r]]}}, transitions: [{from: on, to: on, event: a}]}
    ... ''')
    >>> [f"{float(M[0, 0]):.4f}" for M in (pump.locations[0].deviation.A, pump.locations[0].deviation.C)]
    ['0.2000', '0.0556']
    """
    known = _parameters(tree, tolerance, problems)
    return tuple(_deviating(location, tree, known, problems) for location in locations)


def check_bounds(place: Span, bounds: Bounds, inputs: tuple[str, ...], problems: Problems) -> None:
    """Report DH0222 where a bound is missing without which nothing bounds what a wrong parameter does."""
    missing = ["state"] if bounds.state is None else []
    missing += ["input"] if inputs and bounds.input is None else []
    if missing:
        text = f"`tolerance` is stated, but no bound for {' and '.join(missing)}"
        helps = ("what a wrong parameter does grows with the state and the inputs: state `bounds` of both",)
        problems.add(diagnostic("DH0222", text, place, helps=helps))


def _parameters(tree: MappingNode, tolerance: Mapping[str, float], problems: Problems) -> dict[str, Interval]:
    written = tree.get("parameters")
    found: dict[str, Interval] = {}
    for name, entry in written.entries.items() if isinstance(written, MappingNode) else ():
        if not isinstance(entry.value, ScalarNode):
            continue
        own = _enclosed(entry.value, found, problems)
        if own is not None:
            off = tolerance.get(name, 0.0) * max(abs(own.low), abs(own.high))
            found[name] = Interval(own.low - off, own.high + off)
    return found


def _deviating(location: Location, tree: MappingNode, known: Mapping[str, Interval], problems: Problems) -> Location:
    if location.dynamics is None:
        return location
    wrong = {}
    for key in KEYS:
        nominal: FloatArray = getattr(location.dynamics, key)
        scalars = list(_scalars(_written(tree, location.name, key)))
        off = np.zeros(nominal.size)
        for entry, node in enumerate(scalars if len(scalars) == nominal.size else ()):
            off[entry] = _deviation(node, float(nominal.flat[entry]), known, problems)
        wrong[key] = frozen_array(off.reshape(nominal.shape), nominal.shape)
    return replace(location, deviation=LinearDynamics(**wrong))


def _written(tree: MappingNode, name: str, key: str) -> Node | None:
    """The location's own matrix, else that of the defaults."""
    places, defaults = tree.get("locations"), tree.get("defaults")
    body = places.get(name) if isinstance(places, MappingNode) else None
    own = body.get(key) if isinstance(body, MappingNode) else None
    return defaults.get(key) if own is None and isinstance(defaults, MappingNode) else own


def _scalars(node: Node | None) -> Iterator[ScalarNode]:
    if isinstance(node, ScalarNode):
        yield node
    elif isinstance(node, SequenceNode):
        for item in node.items:
            yield from _scalars(item)


def _deviation(node: ScalarNode, nominal: float, known: Mapping[str, Interval], problems: Problems) -> float:
    found = _enclosed(node, known, problems)
    return 0.0 if found is None else max(found.high - nominal, nominal - found.low)


def _enclosed(node: ScalarNode, known: Mapping[str, Interval], problems: Problems) -> Interval | None:
    """The interval of what is written; None where a mistake was reported here or before."""
    try:
        return enclosure(parse_arithmetic(node.text), known)
    except ExpressionError as error:
        problems.add(diagnostic(error.code, error.message, node.span, f"in `{node.text}`"))
    except KeyError:
        return None  # a parameter whose own mistake was reported
    return None


__all__ = ["check_bounds", "with_deviations"]
