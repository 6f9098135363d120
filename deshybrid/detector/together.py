"""A plant in one location and the residual generator of another, as one linear system.

In: a generator and the location that the plant is in.  Out: the matrices of (x, z, u, 1), the input held.  Linear in
the sizes.  Source: the joint system of Balluchi et al. (2012), section 4.1.
"""

import numpy as np

from deshybrid.detector.residual import ResidualGenerator, sampled_dynamics
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location


def driven_together(
    system: HybridSystem, generator: ResidualGenerator, plant: Location
) -> tuple[FloatArray, FloatArray] | None:
    """Return `shown` (q, n + k + m + 1), the residual, and `moved` (square), a step, of the vector (x, z, u, 1).

    u are the inputs of the system.  Delays of outputs are left out.  None where the plant does not measure all that the
    generator reads.
    """
    own = generator.location
    if plant.dynamics is None or not set(own.output_index) <= set(plant.output_index):
        return None
    sampled = sampled_dynamics(system, plant.dynamics, generator.step)
    (n, m), k = (len(sampled.A), len(system.input_names)), len(generator.F)
    rows = [plant.output_index.index(channel) for channel in own.output_index]
    taken, acting = _spread(own.input_index, m), _spread(plant.input_index, m)
    seen = np.hstack([sampled.C[rows], np.zeros((len(rows), k)), sampled.D[rows] @ acting, sampled.g[rows][:, None]])
    sample = np.vstack([np.hstack([np.zeros((len(taken), n + k)), taken, np.zeros((len(taken), 1))]), seen])
    moved = np.eye(n + k + m + 1)
    moved[:n] = np.hstack([sampled.A, np.zeros((n, k)), sampled.B @ acting, sampled.f[:, None]])
    moved[n : n + k] = np.hstack([generator.input, generator.gain]) @ sample
    moved[n : n + k, n : n + k] += generator.F
    moved[n : n + k, -1] += generator.offset
    shown = np.hstack([generator.through, generator.J]) @ sample
    shown[:, n : n + k] += generator.H
    shown[:, -1] += generator.residual_offset
    return shown, moved


def _spread(index: tuple[int, ...], m: int) -> FloatArray:
    """The inputs of a location out of those of the system, (own, m)."""
    return np.eye(m)[list(index)].reshape(len(index), m)


__all__ = ["driven_together"]
