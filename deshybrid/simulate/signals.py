"""Test signals on a time grid: what drives a simulated plant.

In: a `SignalModel` (points, ripple, jitter) and the times of the grid.  Out: one value per time.  A channel that the
model's `simulation` does not mention moves at random within its bound, redrawn about every second, and is zero where it
has no bound.  Each channel has its own random stream, made from the seed and the channel's place, so that adding a
channel leaves the others as they were.

Linear in the number of times.
"""

from collections.abc import Mapping, Sequence

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import SignalModel

INPUT, UNMEASURED, DISTURBANCE, NOISE, EVENTS, START, COMMANDS, INPUT_NOISE, PROCESS, CHAIN, SAMPLES = range(11)
_SLACK = 1e-9  # of a period or a second, by which a change may come early, so that rounding never delays it


def stream(seed: int, kind: int, channel: int = 0) -> np.random.Generator:
    """Return the random stream of one channel of one kind.

    >>> bool(stream(1, NOISE, 0).random() == stream(1, NOISE, 0).random())
    True
    """
    return np.random.default_rng([seed, kind, channel])


def sample_signal(signal: SignalModel, time: FloatArray, generator: np.random.Generator) -> FloatArray:
    """Return the values of a signal at increasing times (s), shape as `time`.

    >>> steps = SignalModel(points=((0.0, 1.0), (2.0, 5.0)))
    >>> sample_signal(steps, np.array([0.0, 1.9, 2.0, 9.0]), stream(0, INPUT)).tolist()
    [1.0, 1.0, 5.0, 5.0]
    """
    values = np.zeros(len(time))
    if signal.points:
        places = np.array([place for place, _ in signal.points])
        heights = np.array([height for _, height in signal.points])
        if signal.hold:
            index = np.searchsorted(places, time + _SLACK, side="right") - 1
            values += heights[np.maximum(index, 0)]
        else:
            values += np.interp(time, places, heights)
    if signal.amplitude:
        values += signal.amplitude * np.sin(2.0 * np.pi * signal.frequency * time)
    if signal.random and len(time):
        period = np.floor(time / max(signal.period, _SLACK) + _SLACK)
        index = np.cumsum(np.diff(period, prepend=period[0]) != 0.0)
        values += generator.uniform(-signal.random, signal.random, int(index[-1]) + 1)[index]
    return values


def sample_channels(
    names: Sequence[str],
    signals: Mapping[str, SignalModel],
    bounds: FloatArray | None,
    time: FloatArray,
    *,
    seed: int,
    kind: int,
    period: float,
) -> FloatArray:
    """Return the values of all channels, shape (len(time), len(names)).

    `bounds` (len(names),) and `period` (s) say how a channel without a signal moves; None: it stays zero.
    """
    values = np.zeros((len(time), len(names)))
    for channel, name in enumerate(names):
        bound = 0.0 if bounds is None else float(bounds[channel])
        signal = signals.get(name, SignalModel(random=bound, period=period))
        values[:, channel] = sample_signal(signal, time, stream(seed, kind, channel))
    return values
