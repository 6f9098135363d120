"""The channels of a hybrid model: states, inputs, outputs, disturbances, their units, and values given per channel.

In: the decoded file.  Out: `Channels`.  States and inputs must differ from each other and from the parameters, because
conditions name all three; inputs, outputs and commands must differ, because all are columns of a trace.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.fields import Field, Fields
from deshybrid.model.problems import Problems
from deshybrid.model.scope import Scope
from deshybrid.model.shapes import Extent, count
from deshybrid.model.system import Bounds

_DECLARING = ("state", "input", "output", "disturbance")


@dataclass(frozen=True, slots=True, eq=False)
class Channels:
    """Names by kind, their units, and the place of each declaration in the file's head.

    `inputs` and `outputs` are those of the whole system, the locations' own among them; `common` has those of the
    head alone, by kind, which every location has that does not list its own.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    common: Mapping[str, tuple[str, ...]]
    units: Mapping[str, str]
    spans: Mapping[str, Span]

    def state(self) -> Extent:
        """The size of the state, as the file's head states it."""
        return self.extent("state", self.states, "state component", "component")

    def all_outputs(self) -> Extent:
        """The number of outputs of the whole system."""
        return Extent(
            len(self.outputs), "output", self.spans.get("output"), f"the model has {count(len(self.outputs), 'output')}"
        )

    def extent(self, key: str, names: tuple[str, ...], item: str, noun: str, span: Span | None = None) -> Extent:
        """The size of a list of channels; `span` where it is not the file's head that lists them."""
        return Extent(len(names), item, span or self.spans.get(key), f"`{key}` names {count(len(names), noun)}")


def build_channels(model: Fields, scope: Scope, problems: Problems) -> Channels:
    """Return the channels of a model; reports DH0204 (a name with two meanings) and DH0215 (a column of a trace).

    >>> from deshybrid.model.load import loads
    >>> loads('''{format: deshybrid/1, state: {h: m}, locations: {on: {A: [[-1]]}},
    ...           transitions: [{from: on, to: on, event: a}]}''').units
    mappingproxy({'h': 'm'})
    """
    spans = {key: field.span for key in _DECLARING if (field := model.get(key)) is not None}
    names = scope.names
    _check_conditions(model, scope, problems)
    _check_columns(model, names["state"], problems)
    units = _units(model, problems)
    common = {kind: field.names for kind in ("input", "output") if (field := model.get(kind)) is not None}
    return Channels(names["state"], names["input"], names["output"], names["disturbance"], common, units, spans)


def per_channel(field: Field | None, names: tuple[str, ...], what: str, problems: Problems) -> FloatArray | None:
    """Return one number for each name from a number (all alike), a list, or a mapping by name; reports DH0214."""
    if field is None:
        return None
    if field.number is not None:
        return frozen_array(np.full(len(names), field.number), (len(names),))
    given = field.fields.entries
    missing = [name for name in names if name not in given]
    foreign = [name for name in given if name not in names]
    if isinstance(field.value, Fields) and (missing or foreign):
        text = f"{what} of `{missing[0]}` is missing" if missing else f"there is no `{foreign[0]}` here"
        helps = ("give one number for all, or one for each of " + ", ".join(f"`{name}`" for name in names),)
        problems.add(diagnostic("DH0214", text, field.span, helps=helps))
        return None
    values = [given[name].number for name in names] if given else [item.number for item in field.items]
    if len(values) != len(names):
        text = f"{what} has {len(values)} entries, expected {len(names)}"
        problems.add(diagnostic("DH0214", text, field.span))
        return None
    return frozen_array(np.array([value or 0.0 for value in values]), (len(names),))


def build_bounds(model: Fields, channels: Channels, problems: Problems) -> Bounds:
    """Return the bounds per channel; reports DH0214 where a mapping misses a channel."""
    given = model.fields("bounds")
    return Bounds(
        per_channel(given.get("state"), channels.states, "the bound", problems),
        per_channel(given.get("input"), channels.inputs, "the bound", problems),
        per_channel(given.get("disturbance"), channels.disturbances, "the bound", problems),
        per_channel(given.get("measurement"), channels.outputs, "the bound", problems),
    )


def declarations(model: Fields, kind: str) -> list[tuple[str, Span]]:
    """Every place where channels of a kind are declared: in the head, the defaults, the locations."""
    bodies = [model, model.fields("defaults"), *(body.fields for _, body in model.fields("locations"))]
    found = []
    for field in (body.get(kind) for body in bodies):
        if field is not None and isinstance(field.value, Fields):
            found += [(name, part.key.span) for name, part in field.fields if part.key is not None]
        elif field is not None:
            found += [(item.text, item.span) for item in field.items if item.text is not None]
    return found


def _check_conditions(model: Fields, scope: Scope, problems: Problems) -> None:
    meanings: dict[str, tuple[str, Span | None]] = {}
    for name in scope.parameters:
        meanings[name] = ("parameter", None)
    for kind in ("state", "input"):
        for name, span in declarations(model, kind):
            meaning, first = meanings.setdefault(name, (kind, span))
            if meaning != kind:
                text = f"`{name}` names both a {meaning} and a {kind}"
                context = ((first, f"a {meaning} here"),) if first is not None else ()
                helps = ("conditions name both, so give one of them another name",)
                problems.add(diagnostic("DH0204", text, span, context=context, helps=helps))


def _check_columns(model: Fields, states: tuple[str, ...], problems: Problems) -> None:
    columns = ["time", "event", "true_location", *(f"true_{name}" for name in states)]
    taken: dict[str, tuple[str, Span]] = {}
    for kind, what in (("input", "an input"), ("output", "an output"), ("commands", "a command")):
        for name, span in declarations(model, kind):
            meaning, first = taken.setdefault(name, (what, span))
            if name in columns:
                text, helps = f"`{name}` is a column that every trace may have", ("choose another name",)
                problems.add(diagnostic("DH0215", text, span, f"cannot name {what}", helps=helps))
            elif meaning != what:
                text, context = f"`{name}` names both {meaning} and {what}", ((first, f"{meaning} here"),)
                helps = ("both are columns of a trace, so give one of them another name",)
                problems.add(diagnostic("DH0215", text, span, context=context, helps=helps))


def _units(model: Fields, problems: Problems) -> Mapping[str, str]:
    units: dict[str, str] = {}
    bodies = [model, model.fields("defaults"), *(body.fields for _, body in model.fields("locations"))]
    for field in (body.get(kind) for body in bodies for kind in _DECLARING):
        for name, unit in field.fields if field is not None else ():
            if unit.text is not None and units.setdefault(name, unit.text) != unit.text:
                text = f"`{name}` has two units, `{units[name]}` and `{unit.text}`"
                problems.add(diagnostic("DH0204", text, unit.span))
    return MappingProxyType(units)


__all__ = ["Channels", "build_bounds", "build_channels", "declarations", "per_channel"]
