"""How well a residual generator sees that the plant is in another location: what designs are compared by.

In: a `ResidualGenerator`.  Out: one number.  The idea: while the plant is in a neighbour r, plant and generator are one
linear system, whose response from every state and input of full scale is summed; what counts is its size beside the
residual that the bounds allow in the own location, which thresholds lie above.

Cost: ten time constants of a product of size n + k.  Source: the ratio of sensitivity to robustness that designs of
residuals maximise, Chen and Patton (1999), section 2.8; this form of it is this project's.
"""

import numpy as np

from deshybrid.detector.residual import ResidualGenerator
from deshybrid.detector.thresholds import floor, steady_bound
from deshybrid.detector.together import driven_together
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location

MOST_SAMPLES = 2_000


def contrast(system: HybridSystem, generator: ResidualGenerator) -> float:
    """Return how large a typical residual is in the nearest other location, in units of the own one's steady bound.

    Root mean square over states and inputs of full scale and over ten time constants, from no error at the entry; the
    largest of the residual's rows, the least of the neighbours.
    """
    level = steady_bound(system, generator) + floor(system, generator)
    near = {t.source for t in system.transitions if t.target == generator.location.name}
    near |= {t.target for t in system.transitions if t.source in near | {generator.location.name}}
    rivals = (system.location(name) for name in sorted(near - {generator.location.name}))
    sizes = (_shown(system, generator, rival) / level for rival in rivals)
    return min((float(size.max(initial=0.0)) for size in sizes), default=0.0)


def _shown(system: HybridSystem, generator: ResidualGenerator, rival: Location) -> FloatArray:
    """Root mean square of each row of the residual (q,) while the plant is in `rival`, over (x, u) of length one."""
    joint = driven_together(system, generator, rival)
    if joint is None:
        return np.zeros(len(generator.channels))
    samples = max(1, round(10 * generator.time_constant / generator.step))
    return _mean_square(*joint, _starts(system, generator), min(samples, MOST_SAMPLES))


def _starts(system: HybridSystem, generator: ResidualGenerator) -> FloatArray:
    """Columns: every state and input at its bound, z without error, the constant last."""
    bounds, (k, n), m = system.bounds, generator.T.shape, len(system.input_names)
    state = np.ones(n) if bounds.state is None else bounds.state
    inputs = np.ones(m) if bounds.input is None else bounds.input
    starts = np.zeros((n + k + m + 1, n + m + 1))
    starts[:n, :n], starts[n : n + k, :n] = np.diag(state), generator.T * state
    starts[n + k : n + k + m, n : n + m], starts[-1, -1] = np.diag(inputs), 1.0
    return starts


def _mean_square(shown: FloatArray, moved: FloatArray, starts: FloatArray, samples: int) -> FloatArray:
    total = np.zeros(len(shown))
    for _ in range(samples):
        seen = shown @ starts
        total += (seen[:, :-1] ** 2).mean(axis=1) + seen[:, -1] ** 2 if seen.shape[1] > 1 else seen[:, -1] ** 2
        starts = moved @ starts
    return np.asarray(np.sqrt(total / samples))


__all__ = ["contrast"]
