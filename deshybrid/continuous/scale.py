"""The common norm: one scale for the states, in which all locations together ask for the least dwell time.

In: error dynamics, a first guess (the bounds of the states), the rate.  Out: a scale s (n,); errors are then measured
as ‖diag(s)⁻¹ ζ‖₂.  A common norm changes no truth about the plant, only how much (20) asks.  Nelder and Mead's search
over log s, from the guess or from units: 60 n evaluations of all locations, O(n^3) each; deterministic.
"""

from math import inf

import numpy as np

from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.modes import modal_basis
from deshybrid.continuous.search import needed_dwell, reset_norm
from deshybrid.linear.arrays import FloatArray, frozen_array


def best_scale(dynamics: ErrorDynamics, start: FloatArray, rate: float) -> FloatArray:
    """Return the state scale (n,), first component as in `start`, that asks for the least dwell time."""
    from scipy.optimize import minimize

    def cost(logarithms: FloatArray) -> float:
        scale = np.exp(np.append(0.0, logarithms)) * start[0]
        needs = []
        for name in dynamics.locations:
            basis = modal_basis(dynamics.matrices[name], scale, step=dynamics.step, improve=False)
            norm = reset_norm([reset.matrix for reset in dynamics.exits(name)], scale)
            needs.append(needed_dwell(basis, norm, rate))
        return max(needs, default=0.0)

    n = len(start)
    starts = [np.log(start[1:] / start[0]), np.zeros(n - 1)]
    first = min(starts, key=cost)
    if n > 1 and 0 < cost(first) < inf:
        found = minimize(cost, first, method="Nelder-Mead", options={"maxfev": 60 * n, "xatol": 1e-3, "fatol": 1e-6})
        first = found.x if found.fun < cost(first) else first
    return frozen_array(np.exp(np.append(0.0, first)) * start[0], (n,))


__all__ = ["best_scale"]
