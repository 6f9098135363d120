"""The flow of one location over a stretch of time in which inputs and disturbances are held.

In: a location's dynamics.  Out: a `Flow` that maps z = (x, u, w, 1), with the inputs and disturbances of the whole
system, to the state after a whole sub-step (one product with a matrix exponential made once) or after any shorter
time (the exponential's series applied to one vector, or a matrix exponential where the series would be long).  Both are
exact up to rounding; nothing is integrated step by step.

Source: the variation of constants; Van Loan (1978) for the exponential of the block matrix [[A, b], [0, 0]].
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location

_SERIES = 1.0  # largest norm of A · duration for which the series is summed: then no term cancels another
_TERMS = 30
_NEGLIGIBLE = 1e-18


@dataclass(frozen=True, slots=True, eq=False)
class Flow:
    """x' = rate @ z, or x(k+1) = rate @ z where time is discrete; `whole` (n, n + m + r + 1) is one sub-step."""

    rate: FloatArray
    whole: FloatArray
    is_sampled: bool

    def after(self, z: FloatArray, duration: float) -> FloatArray:
        """Return the state (n,) a `duration` (s, continuous time only) after z, with u and w held.

        With d = x' at z it is x + sum over k of duration^k A^(k-1) d / k!, summed until a term changes nothing.
        """
        n = len(self.rate)
        matrix = self.rate[:, :n] * duration
        if float(np.abs(matrix).sum(axis=1).max()) > _SERIES:
            return self._exponential(z, duration)
        term = self.rate @ z * duration
        total = z[:n] + term
        for k in range(2, _TERMS):
            term = matrix @ term / k
            total += term
            if np.abs(term).max() <= _NEGLIGIBLE * np.abs(total).max():
                break
        return np.asarray(total, dtype=np.float64)

    def _exponential(self, z: FloatArray, duration: float) -> FloatArray:
        from scipy.linalg import expm

        n = len(self.rate)
        block = np.zeros((n + 1, n + 1))
        block[:n, :n] = self.rate[:, :n]
        block[:n, n] = self.rate[:, n:] @ z[n:]
        return np.asarray(expm(block * duration)[:n] @ np.append(z[:n], 1.0), dtype=np.float64)


def build_flow(system: HybridSystem, location: Location, tick: float) -> Flow:
    """Return the flow of a location for sub-steps of `tick` seconds.

    >>> from deshybrid.linear.dynamics import LinearDynamics
    >>> shapes = ((1, 0), (0, 1), (0, 0), (1, 0), (1,), (0,))
    >>> decay = LinearDynamics(np.array([[-2.0]]), *map(np.zeros, shapes))
    >>> flow = build_flow(HybridSystem("d", (), (), (), ("x",)), Location("a", decay), 0.5)
    >>> np.allclose(flow.whole @ np.array([1.0, 1.0]), np.exp(-1.0), rtol=1e-15)
    True
    """
    from scipy.linalg import expm

    dynamics = location.dynamics
    if dynamics is None:
        raise ValueError(f"location `{location.name}` has no dynamics")
    n, m, r = len(dynamics.A), len(system.input_names), dynamics.E.shape[1]
    rate = np.zeros((n, n + m + r + 1))
    rate[:, :n] = dynamics.A
    rate[:, [n + place for place in location.input_index]] = dynamics.B
    rate[:, n + m : n + m + r] = dynamics.E
    rate[:, -1] = dynamics.f
    if system.time_step is not None:
        return Flow(rate, rate, is_sampled=True)
    size = n + m + r + 1
    block = np.zeros((size, size))
    block[:n] = rate
    return Flow(rate, np.asarray(expm(block * tick)[:n], dtype=np.float64), is_sampled=False)


def outputs_of(
    system: HybridSystem, location: Location, states: FloatArray, inputs: FloatArray
) -> tuple[list[int], FloatArray]:
    """Return the channels a location measures and their values (N, p_i) for states (N, n) and inputs (N, m)."""
    dynamics = location.dynamics
    if dynamics is None:
        return [], np.zeros((len(states), 0))
    values = states @ dynamics.C.T + inputs[:, list(location.input_index)] @ dynamics.D.T + dynamics.g
    return list(location.output_index), values
