"""Sensors: what the channels of a simulated plant look like in a log.

In: outputs or inputs on the fine grid (NaN where the current location does not measure a channel).  Out: the rows of a
trace.  A sensor lags (first order), delays by whole sub-steps, holds what it took at its own rate, adds its bias and
white noise, then rounds to multiples of its quantum.  An output that the model's `simulation` does not mention has
uniform errors within its bound, or noise of its location's covariance where no bound is stated; an input is told as it
is.

Linear in the number of rows.  Source: Balluchi et al. (2012), section 5 (quantised and delayed speeds).
"""

import math

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, MeasurementModel
from deshybrid.simulate.signals import INPUT_NOISE, NOISE, stream

_FINEST = 2.0**53
Indices = NDArray[np.intp]


def measure(
    system: HybridSystem, outputs: FloatArray, errors: FloatArray, *, substeps: int, tick: float, seed: int
) -> FloatArray:
    """Return what the sensors report at every `substeps`-th row of `outputs` (N, p), whose rows are `tick` s apart.

    `errors` (rows, p) are added where neither a sensor nor a bound is stated.
    """
    rows = np.arange(0, len(outputs), substeps)
    values = outputs[rows]
    for channel, name in enumerate(system.output_names):
        generator = stream(seed, NOISE, channel)
        sensor = system.simulation.measurement.get(name)
        if sensor is not None:
            values[:, channel] = read_sensor(sensor, outputs[:, channel], rows, tick, generator)
        elif system.bounds.measurement is not None:
            bound = float(system.bounds.measurement[channel])
            values[:, channel] += generator.uniform(-bound, bound, len(rows))
        else:
            values[:, channel] += errors[:, channel]
    return values


def measure_inputs(system: HybridSystem, inputs: FloatArray, *, substeps: int, tick: float, seed: int) -> FloatArray:
    """Return what the trace tells of `inputs` (N, m) at every `substeps`-th row, the rows `tick` s apart."""
    rows = np.arange(0, len(inputs), substeps)
    values = inputs[rows]
    for channel, name in enumerate(system.input_names):
        sensor = system.simulation.measurement.get(name)
        if sensor is not None:
            generator = stream(seed, INPUT_NOISE, channel)
            values[:, channel] = read_sensor(sensor, inputs[:, channel], rows, tick, generator)
    return values


def read_sensor(
    sensor: MeasurementModel, values: FloatArray, rows: Indices, tick: float, generator: np.random.Generator
) -> FloatArray:
    """Return one sensor's readings of `values` (N,) at the indices `rows`; before the start it saw the first value.

    >>> sensor = MeasurementModel(quantum=0.5, delay=0.2)
    >>> ramp = np.array([0.0, 0.3, 0.6, 0.9, 1.2])
    >>> read_sensor(sensor, ramp, np.array([0, 2, 4]), 0.1, np.random.default_rng(0)).tolist()
    [0.0, 0.0, 0.5]
    >>> read_sensor(MeasurementModel(period=0.3), ramp, np.array([0, 2, 4]), 0.1, np.random.default_rng(0)).tolist()
    [0.0, 0.0, 0.9]
    """
    seen = values if sensor.lag == 0.0 else lagged(values, sensor.lag, tick)
    delay = round(min(sensor.delay / tick, len(values)))
    taken, noise = np.maximum(rows - delay, 0), generator.standard_normal(len(rows))
    if sensor.period > 0.0:
        taken -= taken % max(1, round(min(sensor.period / tick, len(values))))
        _, first, again = np.unique(taken, return_index=True, return_inverse=True)
        noise = noise[first][again]  # what is held keeps its noise
    readings = seen[taken] + sensor.bias + sensor.noise * noise
    if sensor.quantum > 0.0:
        with np.errstate(over="ignore"):
            counts = readings / sensor.quantum
        coarse = ~(np.abs(counts) > _FINEST)  # a finer quantum than the number's own changes nothing
        readings[coarse] = np.round(counts[coarse]) * sensor.quantum + 0.0
    return np.asarray(readings, dtype=np.float64)


def lagged(values: FloatArray, lag: float, tick: float) -> FloatArray:
    """Return y with lag · y' = values - y, values held over each `tick` (s); it starts settled, after NaN anew.

    >>> lagged(np.array([0.0, 1.0, 1.0, np.nan, 5.0]), 1.0, np.log(2.0)).round(12).tolist()
    [0.0, 0.0, 0.5, nan, 5.0]
    """
    kept, result = math.exp(-tick / lag), []
    before = settled = math.nan
    for value in values.tolist():
        known = not (math.isnan(value) or math.isnan(settled))
        settled = kept * settled + (1.0 - kept) * before if known else value
        before = value
        result.append(settled)
    return np.array(result)
