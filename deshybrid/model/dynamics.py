"""The matrices of one location: what is written, what is inherited from `defaults`, what is zero or the identity.

In: a location's keys over the defaults, and the channels.  Out: `LinearDynamics`; DH0203 for a wrong shape, DH0205 for
a matrix that is needed and missing, DH0212 where E and the disturbances do not fit.
Source: Balluchi et al. (2012), (1) and (12).
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.channels import Channels
from deshybrid.model.fields import Fields
from deshybrid.model.problems import Problems
from deshybrid.model.shapes import Expected, Extent, checked, count

_TITLES = {
    "A": "dynamics matrix",
    "B": "input map",
    "C": "output map",
    "D": "feedthrough",
    "E": "disturbance map",
    "f": "constant part",
    "g": "constant output",
}


@dataclass(frozen=True, slots=True, eq=False)
class Sizes:
    """The extents of one location: state, inputs, outputs, disturbances."""

    state: Extent
    inputs: Extent
    outputs: Extent
    disturbances: Extent


@dataclass(frozen=True, slots=True, eq=False)
class Written:
    """What a file says of one location, its own keys over the defaults, and the place of its name."""

    where: str
    keys: Fields
    place: Span | None


def sizes_of(keys: Fields, channels: Channels, inputs: tuple[str, ...], outputs: tuple[str, ...]) -> Sizes:
    """Return the extents that the matrices of a location must have."""
    state = channels.state()
    written = keys.get("A")
    array = None if written is None else written.array
    size = state.size
    if written is not None and array is not None and array.shape == (size, size):
        fact = f"`A` is ({size}, {size}), so the state has {count(size, 'component')}"
        state = Extent(size, state.item, written.span, fact)
    spans: dict[str, Span | None] = {key: field.span for key, field in keys if key in ("input", "output")}
    return Sizes(
        state,
        channels.extent("input", inputs, "input", "input", spans.get("input")),
        channels.extent("output", outputs, "output", "output", spans.get("output")),
        channels.extent("disturbance", channels.disturbances, "disturbance", "disturbance"),
    )


def build_dynamics(written: Written, channels: Channels, sizes: Sizes, problems: Problems) -> LinearDynamics | None:
    """Return the dynamics of a location, or None where a mistake was reported at it."""
    shapes: dict[str, tuple[Extent, Extent | None]] = {
        "A": (channels.state(), channels.state()),
        "B": (sizes.state, sizes.inputs),
        "C": (sizes.outputs, sizes.state),
        "D": (sizes.outputs, sizes.inputs),
        "E": (sizes.state, sizes.disturbances),
        "f": (sizes.state, None),
        "g": (sizes.outputs, None),
    }
    if not _disturbances_fit(written, channels, problems):
        del shapes["E"]
    arrays: dict[str, FloatArray | None] = {}
    for key, (rows, columns) in shapes.items():
        expected = Expected(_TITLES[key], key, written.where, rows, columns)
        if written.keys.get(key) is None:
            arrays[key] = _missing(expected, written.place, problems)
        else:
            arrays[key] = checked(written.keys.get(key), expected, problems)
        if key == "A" and arrays[key] is None:
            return None  # what does not fit to a wrong A says nothing more
    found = {key: array for key, array in arrays.items() if array is not None}
    return LinearDynamics(**found) if len(found) == len(_TITLES) else None


def _missing(expected: Expected, place: Span | None, problems: Problems) -> FloatArray | None:
    key, rows, columns = expected.key, expected.rows, expected.columns
    if columns is None:
        return frozen_array(np.zeros(rows.size), (rows.size,))
    if key == "E" and rows.size == columns.size:
        return frozen_array(np.eye(rows.size), (rows.size, rows.size))
    if key in ("A", "B", "C") and rows.size * columns.size > 0:
        text = f"{expected.where} has no {expected.title} `{key}`"
        helps = (f"write `{key}` here or under `defaults`: one row per {rows.item}, one column per {columns.item}",)
        problems.add(diagnostic("DH0205", text, place, f"expected `{key}`, ({rows.size}, {columns.size})", helps=helps))
        return None
    return frozen_array(np.zeros((rows.size, columns.size)), (rows.size, columns.size))


def _disturbances_fit(written: Written, channels: Channels, problems: Problems) -> bool:
    where, matrix, declared = written.where, written.keys.get("E"), channels.spans.get("disturbance")
    number = len(channels.disturbances)
    if matrix is not None and declared is None:
        helps = ("name them: `disturbance: [w]`, one name per column of `E`",)
        problems.add(diagnostic("DH0212", f"`E` of {where} has no disturbances to map", matrix.span, helps=helps))
    elif matrix is None and number not in (0, len(channels.states)):
        text = f"{where} has no disturbance map `E`"
        context = ((declared, f"`disturbance` names {number}, the state has {len(channels.states)} components"),)
        helps = ("write `E` here or under `defaults`, with one column per disturbance",)
        problems.add(diagnostic("DH0212", text, written.place, "expected `E`", context=context, helps=helps))
    else:
        return True
    return False


__all__ = ["Sizes", "build_dynamics", "sizes_of"]
