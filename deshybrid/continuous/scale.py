"""The common norm: one scale for the states, in which all locations together ask for the least dwell time.

In: error dynamics, a first guess (the bounds of the states), the rate.  Out: a scale s (n,); errors are then measured
as ‖diag(s)⁻¹ ζ‖₂.  A common norm changes no truth about the plant, only how much (20) asks.  Nelder and Mead's search
over log s, from the guess or from units: 60 n evaluations of all locations, O(n^3) each; deterministic.
"""

from math import inf

import numpy as np

from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.modes import MOST_SEARCHED, modal_basis, simplex_search
from deshybrid.continuous.search import needed_dwell, reset_norm
from deshybrid.linear.arrays import FloatArray, frozen_array


def best_scale(dynamics: ErrorDynamics, start: FloatArray, rate: float) -> FloatArray:
    """Return the state scale (n,), first component as in `start`, that asks for the least dwell time."""

    def cost(logarithms: FloatArray) -> float:
        scale = _scale(start, logarithms)
        needs = []
        for name in dynamics.locations:
            basis = modal_basis(dynamics.matrices[name], scale, step=dynamics.step, improve=False)
            norm = reset_norm([reset.matrix for reset in dynamics.exits(name)], scale)
            needs.append(needed_dwell(basis, norm, rate))
        return max(needs, default=0.0)

    units = -np.log(start[1:] / start[0])
    first = min((np.zeros(len(units)), units), key=cost)
    if 0 < len(units) < MOST_SEARCHED and 0 < cost(first) < inf:
        first = simplex_search(cost, first, 60 * len(start))
    return frozen_array(_scale(start, first), start.shape)


def _scale(start: FloatArray, logarithms: FloatArray) -> FloatArray:
    return np.asarray(start * np.exp(np.append(0.0, logarithms)))


__all__ = ["best_scale"]
