"""Stretches of traces in which the location is known: what parameters are identified from.

In: traces, with `true_location` or with a comparison of ratios in their model.  Out: `Stretch`es, each within one stay
in one location, without samples that were not measured, and long enough to say something.  Outputs are brought forward
by the delays that the model states of its sensors.  A name of the comparison comes and goes late by its debounce, so
that much is cut from the end of each stretch.

One pass.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.simulate.comparison import names_by_ratio
from deshybrid.simulate.trace import Trace

SHORTEST = 20  # samples of a stretch that is used


@dataclass(frozen=True, slots=True, eq=False)
class Stretch:
    """Samples in one location: `inputs` (N, m) and `outputs` (N, p) are those of the location, rows a step apart."""

    location: str
    inputs: FloatArray
    outputs: FloatArray


def stretches_of(traces: Sequence[Trace], *, only: Sequence[str], by_ratio: bool) -> tuple[Stretch, ...]:
    """Return the stretches of some traces of one model, in the locations `only`.

    `by_ratio`: by the model's comparison of ratios even where the true location is known.  Raises `UsageError`: DH0732
    where a trace does not tell the location, DH0733 where no stretch is long enough.
    """
    found = tuple(
        stretch
        for trace in traces
        for name, begin, end in _stays(trace, by_ratio)
        if name in only
        for stretch in _measured(trace, name, begin, end)
    )
    if not found:
        text = f"no trace has {SHORTEST} measured samples in a row in one of the locations {', '.join(only)}"
        raise UsageError(diagnostic("DH0733", text, helps=("choose other locations with `--only`, or more traces",)))
    return found


def _stays(trace: Trace, by_ratio: bool) -> Iterator[tuple[str, int, int]]:
    """Stays in a known location: (name, first row, row behind the last)."""
    rule, late = trace.system.simulation.comparison, 0
    names: Sequence[str | None]
    if trace.true_location is not None and not by_ratio:
        names = trace.true_location
    elif rule is not None and len(trace) > 1:
        names = names_by_ratio(rule, trace)
        late = round(rule.debounce / float(np.diff(trace.time).mean()))
    else:
        helps = ("add a column `true_location`, or `simulation: {comparison: ...}` to the model",)
        raise UsageError(diagnostic("DH0732", "the trace does not tell the location", helps=helps))
    edges = [0, *(row for row in range(1, len(names)) if names[row] != names[row - 1]), len(names)]
    for begin, end in pairwise(edges):
        name = names[begin]
        if name is not None and end - begin > late:
            yield name, begin, end if end == len(names) else end - late


def _measured(trace: Trace, name: str, begin: int, end: int) -> Iterator[Stretch]:
    """The parts of a stay in which all outputs of its location were measured, each output in its own time."""
    location = trace.system.location(name)
    delays = [_delay(trace, channel) for channel in location.output_index]
    end -= max([delay - (len(trace) - end) for delay in delays if delay > len(trace) - end], default=0)
    inputs = trace.inputs[begin:end, list(location.input_index)]
    columns = zip(location.output_index, delays, strict=True)
    outputs = np.array([trace.outputs[begin + late : end + late, channel] for channel, late in columns]).T
    gaps = [-1, *np.flatnonzero(np.isnan(outputs).any(axis=1)).tolist(), len(outputs)]
    for before, after in pairwise(gaps):
        if after - before - 1 >= SHORTEST:
            yield Stretch(name, inputs[before + 1 : after], outputs[before + 1 : after])


def _delay(trace: Trace, channel: int) -> int:
    """The rows by which a sensor is late."""
    sensor = trace.system.simulation.measurement.get(trace.system.output_names[channel])
    if sensor is None or len(trace) < 2:
        return 0
    return round(sensor.delay / float(np.diff(trace.time).mean()))


__all__ = ["Stretch", "stretches_of"]
