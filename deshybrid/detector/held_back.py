"""Outputs that are measured late, taken as of one time.

In: a generator for outputs without delay, and the delays that the model states.  Out: the generator that holds inputs
and earlier outputs back by whole samples, so that all are of the time of the latest output: it is late by the largest
delay, and exact.  What is left of a delay, below half a sample, belongs to the measurement bound.  `realised` gives it
the memory for the held samples; it stays a linear filter.

Cost: a state for each held sample of each channel.  Source: a chain of unit delays, as in any book on sampled systems.
"""

from dataclasses import replace

import numpy as np

from deshybrid.detector.residual import ResidualGenerator
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem


def held_back(system: HybridSystem, generator: ResidualGenerator) -> ResidualGenerator:
    """Return the generator for outputs that are measured late by what the model says: all of one time."""
    delay = system.observer.detector.delay
    if delay is None:
        return generator
    late = [round(float(delay[channel]) / generator.step) for channel in generator.location.output_index]
    lag = max(late, default=0)
    return replace(generator, held=(*(lag - samples for samples in late), lag)) if lag else generator


def realised(generator: ResidualGenerator) -> ResidualGenerator:
    """Return the linear filter that runs: a generator that holds channels back gets a state for each held sample.

    The result holds nothing back; its T is meaningless beyond the first states, which are those of the generator.
    """
    if not any(generator.held):
        return generator
    (k, m), p = generator.input.shape, generator.gain.shape[1]
    holds = (*(generator.held[-1],) * m, *generator.held[:-1])
    size = k + sum(holds)
    shift, fed, taken = np.zeros((size, size)), np.zeros((size, m + p)), np.zeros((m + p, size))
    direct, first = np.zeros((m + p, m + p)), k
    for channel, count in enumerate(holds):
        if count == 0:
            direct[channel, channel] = 1.0
            continue
        fed[first, channel] = taken[channel, first + count - 1] = 1.0
        shift[first + 1 : first + count, first : first + count - 1] = np.eye(count - 1)
        first += count
    driven, through = np.hstack([generator.input, generator.gain]), np.hstack([generator.through, generator.J])
    F = shift + np.vstack([driven, np.zeros((size - k, m + p))]) @ taken
    F[:k, :k] += generator.F
    enters = fed + np.vstack([driven @ direct, np.zeros((size - k, m + p))])
    rest = np.zeros((size - k, 1))
    return replace(
        generator,
        F=F,
        input=enters[:, :m],
        gain=enters[:, m:],
        offset=np.vstack([generator.offset[:, None], rest])[:, 0],
        H=np.hstack([generator.H, np.zeros((len(generator.H), size - k))]) + through @ taken,
        through=through[:, :m] @ direct[:m, :m],
        J=through[:, m:] @ direct[m:, m:],
        start=np.vstack([generator.start, _first_samples(holds, m, p)]),
        start_offset=np.vstack([generator.start_offset[:, None], rest])[:, 0],
        T=np.vstack([generator.T, np.zeros((size - k, generator.T.shape[1]))]),
        held=(),
    )


def _first_samples(holds: tuple[int, ...], m: int, p: int) -> FloatArray:
    """Outputs were what the first sample says, inputs zero."""
    rows = [np.eye(m + p)[channel, m:] * (channel >= m) for channel, count in enumerate(holds) for _ in range(count)]
    return np.array(rows).reshape(sum(holds), p)


__all__ = ["held_back", "realised"]
