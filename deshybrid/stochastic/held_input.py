"""A system whose known inputs are held at constant values: what is known of them becomes offsets.

In: a `StochasticSystem` and one number for each input.  Out: the system without inputs that moves and measures alike,
with f + B u for f and g + D u for g.  Whatever looks at means (delays, distances of outputs) so takes known inputs in.

O(M (n + p) m).  Source: Hwang et al. (2006), section 4, whose inputs of the modes are constant.
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.steady_state import SteadyFilter
from deshybrid.stochastic.system import Mode, StochasticSystem


def hold_input(system: StochasticSystem, u: ArrayLike) -> StochasticSystem:
    """Return the system without inputs that does what `system` does under the constant input u (m,).

    Raises `UsageError` (DH1107) where u does not fit.

    >>> push = Mode("push", F=[[1.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]], B=[[2.0]])
    >>> from deshybrid.stochastic.system import ModeTransition
    >>> one = StochasticSystem([push], ModeTransition(["push"], [[1.0]]), x=[0.0], P=[[1.0]], mu=[1.0])
    >>> hold_input(one, [3.0]).modes[0].f.tolist()
    [6.0]
    """
    held, m = np.asarray(u, dtype=np.float64), system.bank.B.shape[2]
    if held.shape != (m,) or not np.isfinite(held).all():
        text = f"the held input has shape {held.shape}, expected ({m},) with finite numbers"
        raise UsageError(diagnostic("DH1107", text))
    modes = [_held(mode, held) for mode in system.modes]
    return StochasticSystem(modes, system.chain, x=system.x, P=system.P, mu=system.mu)


def hold_filter(filter_of: SteadyFilter, u: FloatArray) -> SteadyFilter:
    """Return the steady-state filter of a mode under a constant input u (m,): gains and covariances are the same.

    >>> from deshybrid.stochastic.steady_state import steady_state
    >>> push = Mode("push", F=[[1.0]], H=[[1.0]], Q=[[1.0]], R=[[1.0]], B=[[2.0]])
    >>> hold_filter(steady_state(push).filter, np.array([3.0])).mode.f.tolist()
    [6.0]
    """
    return replace(filter_of, mode=_held(filter_of.mode, u))


def _held(mode: Mode, u: FloatArray) -> Mode:
    return Mode(
        mode.name,
        F=mode.F,
        H=mode.H,
        Q=mode.Q,
        R=mode.R,
        f=mode.f + mode.B @ u,
        g=mode.g + mode.D @ u,
        output_index=mode.output_index,
        noise=mode.noise,
    )


__all__ = ["hold_filter", "hold_input"]
