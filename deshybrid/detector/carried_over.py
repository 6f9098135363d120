"""What a residual generator may carry over from the stay before an entry: the reach of plant and generator together.

In: a generator, the location p that the plant is in before the entry, and rows ρ over (x, z).  Out: an interval for
each ρ (x, z) at the entry.

While the plant is in p, (x, z) := M (x, z) + c + (u, w, v), all of them within their bounds, so that J samples before
the entry, |x| <= X and |z| <= Z being all that is known,

    ρ (x, z) ∈ ρ Σ_{i<J} Mⁱ c ± (Σ_{i<J} |ρ Mⁱ B| ū + |ρ M^J| (X, Z)),

for every J up to the samples of the shortest stay; the interval is the intersection over all J.  J = 0 is the box of
the bounds; a late J knows that the state of p is what its inputs can make of it, and that z follows it.

Cost: J products of size n + k, and as many for each row.  Source: the support function of a reachable set of a sampled
linear system, Girard (2005); this use of it is this project's.
"""

from typing import NamedTuple

import numpy as np

from deshybrid.detector.residual import ResidualGenerator, sampled_dynamics
from deshybrid.detector.thresholds import largest_state, measurement_bound, unmodelled
from deshybrid.detector.together import driven_together
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location

MOST_SAMPLES = 1_000
"""Longest look back; a longer one only forgets more."""


class Interval(NamedTuple):
    """Least and largest value of each row."""

    low: FloatArray
    high: FloatArray


def carried_over(
    system: HybridSystem, generator: ResidualGenerator, source: Location, rows: FloatArray
) -> Interval | None:
    """Return the interval of rows (x, z), shape (R, n + k), at the first sample after a stay in `source`.

    x is that at the end of the stay, before any reset.  None where the bounds on state or input are missing.

    >>> from deshybrid.model.load import loads
    >>> from deshybrid.detector.residual import build_generator
    >>> pump = loads('''
    ... {format: deshybrid/1, name: pump, state: [h], output: [y], defaults: {C: [[1]]}, bounds: {state: 8},
    ...  locations: {on: {A: [[-1]], f: [2]}, off: {A: [[-1]]}}, observer: {dwell: 5},
    ...  transitions: [{from: on, to: off, event: a}, {from: off, to: on, event: b}]}
    ... ''')
    >>> made = build_generator(pump, pump.location("off"), rate=1.0, dwell=5.0, step=0.1)
    >>> found = carried_over(pump, made, pump.location("on"), np.array([[1.0, 0.0]]))
    >>> print(f"{found.low[0]:.3f} {found.high[0]:.3f}")  # 2 + 6 e^-5 at most
    1.933 2.040
    """
    box, state = largest_state(system, generator), system.bounds.state
    if box is None or state is None:
        return None
    far = np.concatenate([state, box])
    spread, middle, reached = np.zeros(len(rows)), np.zeros(len(rows)), rows
    high = np.abs(rows) @ far
    low = -high
    joint = _moving(system, generator, source)
    if joint is None:
        return Interval(low, high)
    moved, constant, pushed = joint
    for _ in range(_samples(system, generator, source)):
        middle, spread = middle + reached @ constant, spread + np.abs(reached @ pushed).sum(axis=1)
        reached = reached @ moved
        around = spread + np.abs(reached) @ far
        low, high = np.maximum(low, middle - around), np.minimum(high, middle + around)
    return Interval(low, high)


def _samples(system: HybridSystem, generator: ResidualGenerator, source: Location) -> int:
    """Samples for which the plant has been in `source` at least; a generator that is late saw as many less of them."""
    dwell = source.dwell.min or system.observer.dwell
    return 0 if dwell is None else min(MOST_SAMPLES, max(0, int(dwell / generator.step) - generator.lag))


def _moving(
    system: HybridSystem, generator: ResidualGenerator, source: Location
) -> tuple[FloatArray, FloatArray, FloatArray] | None:
    """M, c and the columns of what moves (x, z) in a step, at their bounds."""
    joint, dynamics = driven_together(system, generator, source), source.dynamics
    if joint is None or dynamics is None:
        return None
    n, k, m = len(dynamics.A), len(generator.F), len(system.input_names)
    whole = joint[1][: n + k]
    bound = np.zeros(m) if system.bounds.input is None else system.bounds.input
    held, smeared = pushed_in_a_step(system, source, generator.step)
    by_plant = np.vstack([np.hstack([held, np.diag(smeared)]), np.zeros((k, held.shape[1] + n))])
    heard = generator.gain * measurement_bound(system, generator, source)
    by_noise = np.vstack([np.zeros((n, heard.shape[1])), heard])
    driven = whole[:, n + k : n + k + m] * bound
    return whole[:, : n + k], whole[:, -1], np.hstack([driven, by_plant, by_noise])


def pushed_in_a_step(system: HybridSystem, plant: Location, step: float) -> tuple[FloatArray, FloatArray]:
    """Return what moves x beside the inputs: columns (n, r) for a disturbance that is held, (n,) for what varies.

    The latter is what a disturbance that varies within the step adds, and what wrong parameters do.
    """
    moved, bound, dynamics = unmodelled(system, plant)[0], system.bounds.disturbance, plant.dynamics
    n = len(system.state_names)
    if dynamics is None:
        return np.zeros((n, 0)), np.zeros(n)
    held = np.zeros((n, 0)) if bound is None else sampled_dynamics(system, dynamics, step).E * bound
    if system.time_step is not None:
        return held, moved
    from scipy.linalg import expm

    rising = expm(np.abs(dynamics.A) * step)
    varying = np.zeros(n) if bound is None else step * (rising - np.eye(n)) @ np.abs(dynamics.E) @ bound
    return held, np.asarray(varying + step * rising @ moved)


__all__ = ["Interval", "carried_over", "pushed_in_a_step"]
