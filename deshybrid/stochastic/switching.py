"""The switching Kalman filter: the mode is known, so that one Gaussian is the whole belief and exact.

In: a `StochasticSystem`, one Gaussian x (..., n), P (..., n, n), and the number of the mode (...).  Out: the next one.
Modes may measure different outputs and take different inputs.  The step and the measurement at its end may belong to
different modes, as at a switch of the freeway paper: A and noise of the mode that was left, C of the one entered.

The text forgets the offset g in the residual, prints ΓᵀQΓ for ΓQΓᵀ and mixes predicted and filtered covariances; here
they are as derived.  Every mode being observable does not bound the covariance under fast switching.
O(n³ + p³) a step and trial.  Source: the freeway paper's mode-switched Kalman filter (`docs/stochastic.md`).
"""

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import gaussian, noise
from deshybrid.stochastic.gating import Gate, Judgement
from deshybrid.stochastic.gaussian import Correction
from deshybrid.stochastic.lanes import times
from deshybrid.stochastic.system import StochasticSystem

ModeNumbers = NDArray[np.intp]


def predict(
    system: StochasticSystem, x: FloatArray, P: FloatArray, mode: ModeNumbers, *, u: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the Gaussian one step later, moved by `mode` (...); u (..., m) is held over the step.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> system = calm_and_wild()
    >>> predict(system, system.x, system.P, np.array(1))[1].tolist()
    [[10.0]]
    """
    bank = system.bank
    push = bank.f[mode] if u is None else times(bank.B[mode], u) + bank.f[mode]
    Q = noise.grown(bank.Q[mode], noise.at(bank.process_by_state, mode), x, P)
    return gaussian.predict(x, P, bank.F[mode], Q, push)


def update(
    system: StochasticSystem,
    x: FloatArray,
    P: FloatArray,
    mode: ModeNumbers,
    z: FloatArray,
    *,
    u: FloatArray | None = None,
    gate: Gate | None = None,
) -> tuple[Correction, Judgement]:
    """Return the Gaussian given z (..., p) as `mode` (...) measures it; channels it does not measure are not read.

    And whether z was an outlier, which with a gate counts as missing.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> system = calm_and_wild()
    >>> update(system, system.x, system.P, np.array(0), np.array([2.0]))[0].x.round(12).tolist()
    [1.0]
    """
    bank = system.bank
    offset = bank.g[mode] if u is None else times(bank.D[mode], u) + bank.g[mode]
    measured = np.where(bank.measured[mode], z, np.nan)
    residual = measured - times(bank.H[mode], x) - offset
    R = noise.grown(bank.R[mode], noise.at(bank.measurement_by_state, mode), x, P)
    tails = noise.at(bank.tails, mode)
    correction = noise.update(x, P, residual, bank.H[mode], R, tails=tails)
    if gate is None:
        return correction, Judgement.none(z.shape[:-1])
    distance = correction.distance[..., None]
    judgement = gate.judge(distance, np.zeros_like(distance), measured)
    if judgement.gated.any():
        residual = np.where(judgement.gated[..., None], np.nan, residual)
        correction = noise.update(x, P, residual, bank.H[mode], R, tails=tails)
    return correction, judgement


__all__ = ["ModeNumbers", "predict", "update"]
