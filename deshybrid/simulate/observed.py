"""A trace of a finer plant as the observer of a coarser model sees it, with the truth in that model's words.

In: a trace of the plant, which has its own model, and the system that the observer was made from.  Out: a trace of that
system: inputs, outputs, commands and true states are the plant's channels of the same names, and each location of the
plant counts as the one that its key `observed_as` names, or as the one of its own name.

Linear in the trace.
"""

import numpy as np

from deshybrid.diagnostics import Diagnostic, UsageError, diagnostic, raise_all
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.problems import did_you_mean
from deshybrid.model.system import HybridSystem
from deshybrid.simulate.trace import Trace


def require_observable_by(plant: HybridSystem, system: HybridSystem) -> None:
    """Raise `UsageError` where traces of the plant cannot be read as traces of the system.

    DH0725: an input or output of the system that the plant does not have; DH0726: a location of the plant that counts
    as none of the system's; all of them at once.
    """
    mistakes: list[Diagnostic] = []
    shown = (*plant.input_names, *plant.output_names)
    for kind, names in (("input", system.input_names), ("output", system.output_names)):
        for name in names:
            if name not in (shown if kind == "input" else plant.output_names):
                text = f"the plant `{plant.name}` does not show the {kind} `{name}` of `{system.name}`"
                mistakes.append(diagnostic("DH0725", text, helps=did_you_mean(name, shown)))
    known = [location.name for location in system.locations]
    for location in plant.locations:
        said = location.observed_as or location.name
        if said not in known:
            text = f"`{system.name}` has no location `{said}`, as which `{location.name}` of the plant counts"
            place = location.spans.get("observed_as", location.span)
            mistakes.append(diagnostic("DH0726", text, place, helps=did_you_mean(said, known)))
    raise_all(mistakes, UsageError)


def as_observed(trace: Trace, system: HybridSystem) -> Trace:
    """Return a trace of the plant as one of the system; an input may be one that the plant measures as an output.

    A state, or a command, that the plant does not have is unknown (NaN, None).  Raises `UsageError` as
    `require_observable_by`.

    >>> import deshybrid as dh
    >>> from deshybrid.simulate.execution import simulate
    >>> tank = dh.load("models/two_tank.yaml")
    >>> as_observed(simulate(tank, duration=1.0).trace, tank)
    Trace(two_tank: 101 rows, 0 s to 1 s, 1 events)
    """
    plant = trace.system
    require_observable_by(plant, system)
    inputs = dict(zip(plant.output_names, trace.outputs.T, strict=True))
    inputs |= zip(plant.input_names, trace.inputs.T, strict=True)
    outputs = dict(zip(plant.output_names, trace.outputs.T, strict=True))
    counts_as = {location.name: location.observed_as or location.name for location in plant.locations}
    truth = trace.true_location
    return Trace(
        system,
        trace.time,
        _columns(inputs, system.input_names, len(trace)),
        _columns(outputs, system.output_names, len(trace)),
        trace.events,
        None if truth is None else tuple(None if name is None else counts_as[name] for name in truth),
        _true_state(trace, system),
        _commands(trace, system),
    )


def _true_state(trace: Trace, system: HybridSystem) -> FloatArray | None:
    if trace.true_state is None:
        return None
    states = dict(zip(trace.system.state_names, trace.true_state.T, strict=True))
    return _columns(states, system.state_names, len(trace))


def _columns(found: dict[str, FloatArray], names: tuple[str, ...], rows: int) -> FloatArray:
    """The columns of these names (rows, k), NaN where there is none."""
    unknown = np.full(rows, np.nan)
    return np.array([found.get(name, unknown) for name in names]).reshape(len(names), rows).T


def _commands(trace: Trace, system: HybridSystem) -> tuple[tuple[str | None, ...], ...]:
    given = trace.system.command_names
    places = [given.index(name) if name in given else None for name in system.command_names]
    return tuple(tuple(None if place is None else row[place] for place in places) for row in trace.commands)


__all__ = ["as_observed", "require_observable_by"]
