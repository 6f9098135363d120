"""The observer at work on a trace, with what its residual generators were judged by.

In: a `HybridObserver` and a trace.  Out: the estimates as from `replay`, and a `Judged` for each generator.
One step a row.  Source: Balluchi et al. (2012), section 4.1.
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.observer.hybrid import Estimate, HybridObserver, ObserverState
from deshybrid.observer.judgement import Scale
from deshybrid.simulate.replay import EstimateTrace, estimate_trace, steps
from deshybrid.simulate.trace import Trace


@dataclass(frozen=True, slots=True, eq=False)
class Judged:
    """What one generator was judged by on a trace of N rows.

    `values` (N, c): a column for each curve of `scale`, NaN in rows that were not judged; `active`: whether the
    location was accepted, after the debounce; `signature`: that of its entry, None where none is by its residual.
    """

    location: str
    signature: str | None
    scale: Scale
    values: FloatArray
    active: tuple[bool, ...]


def replay_judged(observer: HybridObserver, trace: Trace) -> tuple[EstimateTrace, tuple[Judged, ...]]:
    """Run an observer over a trace; return its estimates, and by generator what it was judged by.

    >>> import deshybrid as dh
    >>> from deshybrid.simulate.execution import simulate
    >>> tank = dh.load("models/two_tank.yaml")
    >>> estimates, judged = replay_judged(dh.compile(tank).observer, simulate(tank, duration=1.0).trace)
    >>> [(entry.location, entry.scale.levels, entry.values.shape) for entry in judged]
    [('fill', (1.0, 1.0), (101, 1)), ('drain', (1.0, 1.0), (101, 1))]
    """
    estimates: list[Estimate] = []
    numbers: list[tuple[tuple[float, ...], ...]] = []
    active: list[tuple[bool, ...]] = []
    before: ObserverState = observer.start()
    for after, estimate in steps(observer, trace):
        estimates.append(estimate)
        numbers.append(() if after.sample is before.sample else observer.judged(before, after))
        active.append(after.active)
        before = after
    return estimate_trace(trace, estimates), tuple(
        Judged(
            observer.tables.location_names[location],
            _signature_of(observer, observer.tables.location_names[location]),
            observer.scales[g],
            _column(numbers, g, len(observer.scales[g].curves)),
            tuple(flags[g] for flags in active),
        )
        for g, location in enumerate(observer.tables.generators.locations)
        if observer.tables.generators.locations.index(location) == g  # the others of `imm` are judged with their first
    )


def _column(numbers: list[tuple[tuple[float, ...], ...]], generator: int, width: int) -> FloatArray:
    """What one generator was judged by, (N, width)."""
    unknown = (np.nan,) * width
    values = np.array([row[generator] if row else unknown for row in numbers], dtype=np.float64)
    values = values.reshape(len(numbers), width)
    values.flags.writeable = False
    return values


def _signature_of(observer: HybridObserver, location: str) -> str | None:
    by_residual = (s.name for s in observer.plan.signatures if s.by == "residual" and s.location == location)
    return next(by_residual, None)


__all__ = ["Judged", "replay_judged"]
