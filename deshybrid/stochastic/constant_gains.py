"""Switching Kalman filters that keep each mode's constant, limiting gain: do they converge whatever the switching?

In: a `StochasticSystem`.  Out: the constant gains, a certificate that says after how many steps of each mode the error
has contracted, and the worst switching cycle.  The idea: with the predictor gain K_p = F K_f, the error of the
prediction moves by M_i = F_i - K_p,i H_i in mode i whatever the modes before and after, so that the certificates of
switched error dynamics apply, in discrete time and with nothing lost at a switch.  M_i of each mode alone decays; a
product of several need not, even where F itself decays under every switching.  The filter of Riccati's recursion, whose
gains follow the switching, stays bounded there.

One Riccati equation a mode, then the conic problems of `deshybrid.continuous.lmi`.
Source: the freeway paper's mode-switched filter with limiting gains (`docs/stochastic.md`); Balluchi et al. (2012),
section 4.2, for the setting of dwell times.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from deshybrid.continuous.checks import require_positive
from deshybrid.continuous.cycles import grows
from deshybrid.continuous.dwell import stay_steps
from deshybrid.continuous.error import ErrorDynamics, ErrorReset
from deshybrid.continuous.lmi import InequalityCertificate, certify_by_inequalities
from deshybrid.continuous.modes import decay_rate
from deshybrid.diagnostics import GainError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.observability import sorted_spectrum
from deshybrid.stochastic.steady_state import steady_state
from deshybrid.stochastic.system import Mode, StochasticSystem

NEAR_ZERO = 1e-6
"""The default rate, as a share of that of the slowest mode."""


@dataclass(frozen=True, slots=True, eq=False)
class ConstantGains:
    """Constant gains by mode, and what is certified of the filter that switches between them.

    predictor K_p = F K_f and filter K_f (n, p_i) by mode; error: M = F - K_p H; certificate: after stays of at least
    `certificate.required_dwell` (s) in each mode the error contracts at `certificate.rate`; its `limit.cycle` is the
    worst switching cycle; diverges: whether with stays of one step a cycle was found, and proved, along which the error
    does not contract at all.
    """

    predictor: Mapping[str, FloatArray]
    filter: Mapping[str, FloatArray]
    error: Mapping[str, FloatArray]
    certificate: InequalityCertificate
    diverges: bool

    @property
    def required_steps(self) -> int | None:
        """The required stay in steps, None where none was found; 1: any switching converges."""
        needed, step = self.certificate.required_dwell, self.certificate.step
        return None if step is None or not np.isfinite(needed) else max(1, stay_steps(needed, step))

    def __str__(self) -> str:
        cycle, steps = self.certificate.limit.cycle, self.required_steps
        needed = "any switching contracts" if steps == 1 else f"stays of at least {steps} steps contract"
        worst = "" if cycle is None else f"; the cycle {' -> '.join(cycle.locations)} with shorter ones does not"
        return f"constant gains: {'no stays are certified' if steps is None else needed}{worst}"


def constant_gain(mode: Mode) -> tuple[FloatArray, FloatArray]:
    """Return the limiting gains (K_p, K_f) of one mode's Kalman filter, both (n, p).

    K_f = P Hᵀ (H P Hᵀ + R)⁻¹ with P of the Riccati equation, K_p = F K_f: the first corrects the prediction of the
    next state, the second the present estimate.
    Raises `GainError` (DH0503) where there is no gain with which the error decays.

    >>> steady = Mode("steady", F=[[1.0]], H=[[1.0]], Q=[[2.0]], R=[[1.0]])
    >>> [gain.round(6).tolist() for gain in constant_gain(steady)]  # P = 2
    [[[0.732051]], [[0.732051]]]
    """
    state = steady_state(mode)
    if state.filter is None:
        text = f"mode `{mode.name}` has no constant Kalman gain"
        raise GainError(diagnostic("DH0503", text, notes=(state.reason,)))
    return state.filter.predictor_gain, state.filter.filter_gain


def certify_constant_gains(
    system: StochasticSystem, *, step: float = 1.0, rate: float | None = None, dwell: float | None = None
) -> ConstantGains:
    """Return what is certified of the switching Kalman filter with constant gains.

    Switches are those that the chain gives a probability above zero.

    Parameters
    ----------
    step : float, s
        One step of the system.
    rate : float, 1/s
        The rate at which the error has to contract; default: a millionth of the slowest mode's.
    dwell : float, s
        A stay that the certificate is asked about; default: the required one itself.

    Raises `GainError` (DH0503) for a mode without a constant gain, `UsageError` (DH0508, DH0518) for numbers out of
    range and where the solver of matrix inequalities (extra `lmi`) is missing.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> found = certify_constant_gains(calm_and_wild())
    >>> found.required_steps, found.diverges
    (1, False)
    """
    require_positive("step", step)
    pairs = {mode.name: constant_gain(mode) for mode in system.modes}
    moves = {mode.name: frozen_array(mode.F - pairs[mode.name][0] @ mode.H, mode.F.shape) for mode in system.modes}
    n = len(system.x)
    switches = np.argwhere(system.chain.probability_to_from.T > 0)
    resets = tuple(ErrorReset(system.names[i], system.names[j], np.eye(n), np.zeros(n)) for i, j in switches if i != j)
    dynamics = ErrorDynamics(system.names, MappingProxyType(moves), resets, step)
    slowest = min(-decay_rate(sorted_spectrum(M), step) for M in moves.values())
    made = certify_by_inequalities(
        dynamics, rate=NEAR_ZERO * slowest if rate is None else rate, dwell=dwell, sampled=True
    )
    return ConstantGains(
        predictor=MappingProxyType({name: pair[0] for name, pair in pairs.items()}),
        filter=MappingProxyType({name: pair[1] for name, pair in pairs.items()}),
        error=dynamics.matrices,
        certificate=made,
        diverges=grows(dynamics, made.limit.cycle, 0.0),
    )


__all__ = ["ConstantGains", "certify_constant_gains", "constant_gain"]
