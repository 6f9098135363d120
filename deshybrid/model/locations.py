"""The locations of a system: dynamics, stays, invariants and noise of each, its own keys before the defaults.

In: the decoded file and the channels.  Out: one `Location` each, in the order written.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.channels import Channels
from deshybrid.model.covariances import covariance
from deshybrid.model.dynamics import Sizes, Written, build_dynamics, sizes_of
from deshybrid.model.fields import NO_FIELDS, Field, Fields
from deshybrid.model.problems import Problems
from deshybrid.model.shapes import Expected, checked
from deshybrid.model.system import Dwell, Location, NoiseForm


@dataclass(frozen=True, slots=True, eq=False)
class _Common:
    """What all locations share: the defaults, the channels, and the noise of the file's head."""

    defaults: Fields
    channels: Channels
    noise: Fields
    process: FloatArray | None
    measurement: FloatArray | None
    problems: Problems


def location_bodies(model: Fields) -> Mapping[str, tuple[Fields, Span]]:
    """Return the written keys and the place of the name of every location."""
    field = model.get("locations")
    if field is None:
        return {}
    if isinstance(field.value, Fields):
        return {name: (body.fields, body.key.span if body.key else body.span) for name, body in field.fields}
    return {item.text: (NO_FIELDS, item.span) for item in field.items if item.text is not None}


def build_locations(model: Fields, channels: Channels, problems: Problems) -> tuple[Location, ...]:
    """Return the locations; reports DH0203, DH0205, DH0208, DH0210 and DH0212, each location by its name."""
    noise = model.fields("noise")
    common = _Common(
        model.fields("defaults"),
        channels,
        noise,
        covariance(noise.get("process"), "process noise", channels.state(), problems),
        covariance(noise.get("measurement"), "measurement noise", channels.all_outputs(), problems),
        problems,
    )
    return tuple(_location(name, body, span, common) for name, (body, span) in location_bodies(model).items())


def _location(name: str, body: Fields, span: Span, common: _Common) -> Location:
    keys, channels, problems = body.over(common.defaults), common.channels, common.problems
    inputs, outputs = _own(keys, "input", channels), _own(keys, "output", channels)
    sizes = sizes_of(keys, channels, inputs, outputs)
    where = f"location `{name}`"
    dynamics = build_dynamics(Written(where, keys, span), channels, sizes, problems) if channels.states else None
    process, measurement = _noise(body, common, sizes, outputs)
    return Location(
        name,
        dynamics,
        _dwell(where, keys.get("dwell"), problems),
        keys.predicate("invariant"),
        tuple(channels.inputs.index(channel) for channel in inputs),
        tuple(channels.outputs.index(channel) for channel in outputs),
        process,
        measurement,
        span,
        MappingProxyType({key: field.span for key, field in keys}),
        keys.text("observed_as") or None,
        _noise_form(where, body, common, sizes, outputs),
    )


def _own(keys: Fields, kind: str, channels: Channels) -> tuple[str, ...]:
    field = keys.get(kind)
    return channels.common.get(kind, ()) if field is None else field.names


def _noise(
    body: Fields, common: _Common, sizes: Sizes, outputs: tuple[str, ...]
) -> tuple[FloatArray | None, FloatArray | None]:
    """The covariances of a location: its own, else those of the defaults, else the rows of the head's it measures."""
    own = body.fields("noise").over(common.defaults.fields("noise"))
    process = covariance(own.get("process"), "process noise", sizes.state, common.problems)
    measurement = covariance(own.get("measurement"), "measurement noise", sizes.outputs, common.problems)
    if own.get("process") is None:
        process = common.process
    if own.get("measurement") is None and common.measurement is not None:
        index = [common.channels.outputs.index(channel) for channel in outputs]
        measurement = frozen_array(common.measurement[np.ix_(index, index)], (len(index), len(index)))
    return process, measurement


def _noise_form(where: str, body: Fields, common: _Common, sizes: Sizes, outputs: tuple[str, ...]) -> NoiseForm:
    """What `noise` says beside covariances: each key the location's own, else that of the defaults or of the head."""
    own = body.fields("noise").over(common.defaults.fields("noise"))
    stated, tails = own.over(common.noise), own.over(common.noise).fields("tails")
    moved = Expected("matrix", "process_by_state", where, sizes.state, sizes.state)
    by_head = own.get("measurement_by_state") is None
    rows = common.channels.all_outputs() if by_head else sizes.outputs
    seen = checked(
        stated.get("measurement_by_state"),
        Expected("matrix", "measurement_by_state", where, rows, sizes.state),
        common.problems,
    )
    if seen is not None and by_head:
        seen = frozen_array(
            seen[[common.channels.outputs.index(channel) for channel in outputs]], (len(outputs), sizes.state.size)
        )
    process = checked(stated.get("process_by_state"), moved, common.problems)
    return NoiseForm(process, seen, tails.number("share") or 0.0, tails.number("factor") or 1.0)


def _dwell(where: str, field: Field | None, problems: Problems) -> Dwell:
    if field is None:
        return Dwell()
    dwell = Dwell(field.fields.number("min"), field.fields.number("max"))
    shortest, longest = field.fields.get("min"), field.fields.get("max")
    if dwell.min is not None and dwell.max is not None and dwell.min > dwell.max:
        text = f"the shortest stay in {where} is longer than the longest"
        context = ((longest.span, f"longest: {dwell.max:g} s"),) if longest else ()
        place = shortest.span if shortest else None
        problems.add(diagnostic("DH0208", text, place, f"shortest: {dwell.min:g} s", context=context))
    return dwell


__all__ = ["build_locations", "location_bodies"]
