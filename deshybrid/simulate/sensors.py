"""Sensors: what a simulated plant's outputs look like in a log.

In: the outputs on the fine grid (NaN where the current location does not measure a channel).  Out: the rows of a
trace.  A sensor delays by whole sub-steps, then adds noise, then rounds to multiples of its quantum.  A channel that
the model's `simulation` does not mention gets uniform noise within its bound.

Linear in the number of rows.  Source: Balluchi et al. (2012), section 5 (quantised and delayed speeds).
"""

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, MeasurementModel
from deshybrid.simulate.signals import NOISE, stream

_FINEST = 2.0**53


def measure(system: HybridSystem, outputs: FloatArray, *, substeps: int, tick: float, seed: int) -> FloatArray:
    """Return what the sensors report at every `substeps`-th row of `outputs` (N, p), whose rows are `tick` s apart."""
    rows = np.arange(0, len(outputs), substeps)
    values = np.empty((len(rows), outputs.shape[1]))
    for channel, name in enumerate(system.output_names):
        generator = stream(seed, NOISE, channel)
        sensor = system.simulation.measurement.get(name)
        if sensor is None:
            bound = 0.0 if system.bounds.measurement is None else float(system.bounds.measurement[channel])
            values[:, channel] = outputs[rows, channel] + generator.uniform(-bound, bound, len(rows))
        else:
            values[:, channel] = read_sensor(sensor, outputs[:, channel], rows, tick, generator)
    return values


def read_sensor(
    sensor: MeasurementModel, values: FloatArray, rows: np.ndarray, tick: float, generator: np.random.Generator
) -> FloatArray:
    """Return one sensor's readings of `values` (N,) at the indices `rows`; before the start it saw the first value.

    >>> sensor = MeasurementModel(quantum=0.5, delay=0.2)
    >>> ramp = np.array([0.0, 0.3, 0.6, 0.9, 1.2])
    >>> read_sensor(sensor, ramp, np.array([0, 2, 4]), 0.1, np.random.default_rng(0)).tolist()
    [0.0, 0.0, 0.5]
    """
    lag = round(min(sensor.delay / tick, len(values)))
    readings = values[np.maximum(rows - lag, 0)] + sensor.noise * generator.standard_normal(len(rows))
    if sensor.quantum > 0.0:
        with np.errstate(over="ignore"):
            counts = readings / sensor.quantum
        coarse = ~(np.abs(counts) > _FINEST)  # a finer quantum than the number's own changes nothing
        readings[coarse] = np.round(counts[coarse]) * sensor.quantum + 0.0
    return np.asarray(readings, dtype=np.float64)
