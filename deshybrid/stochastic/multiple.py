"""Multiple-model filters: MMAE, whose Kalman filters run alone, and IMM, whose filters exchange their estimates.

In: a `StochasticSystem`, a `Belief`, an input and a measurement, with any leading axes.  Out: the next `Belief`.  All
functions are pure, so that one measurement at a time and a whole record are the same code.

    predict   µ⁻ = Π µ; IMM: every filter starts from x_0j = Σ_i Π_ji µ_i x_i / µ⁻_j and its covariance; F, Q
    update    Kalman update of every mode; µ_j ∝ µ⁻_j N(r_j; 0, S_j)

Both use Π: without it (Π = I) the probabilities of MMAE lock in.  The likelihood is the normal density with |S|^(-1/2)
and (2π)^(-p/2); the paper prints the exponents -1 and -n/2, which is no density of the residual.

O(M² n² + M n³) a step and trial.  Source: Hwang et al. (2006), section 3, equations (5) to (11).
"""

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import gaussian, noise
from deshybrid.stochastic.belief import Belief, Posterior, log_sum, mixture_covariance, sealed
from deshybrid.stochastic.gating import Gate, Judgement
from deshybrid.stochastic.gaussian import Correction
from deshybrid.stochastic.lanes import product, times, trials_last
from deshybrid.stochastic.system import Bank, StochasticSystem


def predict_mmae(system: StochasticSystem, belief: Belief, u: FloatArray | None = None) -> Belief:
    """Return the belief one step later, every filter on its own; u (..., m) is held over the step.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> predict_mmae(calm_and_wild(), Belief.prior(calm_and_wild())).mu.round(3).tolist()
    [0.55, 0.45]
    """
    log_mu = log_sum(_log_joint(system, belief))
    return _moved(system.comparable_bank, belief.x, belief.P, log_mu, u)


def predict_imm(system: StochasticSystem, belief: Belief, u: FloatArray | None = None) -> Belief:
    """Return the belief one step later, every filter started from the mixture that leads to its mode.

    A mode that cannot be entered (µ⁻ = 0) keeps its own estimate.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> predict_imm(calm_and_wild(), Belief.prior(calm_and_wild())).P[:, 0, 0].tolist()
    [1.1, 10.0]
    """
    x, P, log_mu = _mixed(system, belief)
    return _moved(system.comparable_bank, x, P, sealed(log_mu), u)


def mix(system: StochasticSystem, belief: Belief) -> Belief:
    """Return the initial conditions x_0j, P_0j of every mode, with the predicted probabilities.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> mix(calm_and_wild(), Belief.prior(calm_and_wild())).x.tolist()
    [[0.0], [0.0]]
    """
    x, P, log_mu = _mixed(system, belief)
    return Belief(sealed(x), sealed(P), sealed(log_mu))


def _mixed(system: StochasticSystem, belief: Belief) -> tuple[FloatArray, FloatArray, FloatArray]:
    """x_0j, P_0j, log µ⁻; of few beliefs P_0j is symmetric up to rounding only."""
    joint = _log_joint(system, belief)
    log_mu = log_sum(joint)
    possible = np.isfinite(log_mu)
    if possible.all():
        weights = np.exp(joint - log_mu[..., None])  # (..., to, from)
    else:
        with np.errstate(invalid="ignore"):
            weights = np.exp(joint - log_mu[..., None])
        weights = np.where(possible[..., None], weights, np.eye(joint.shape[-1]))
    x = product(weights, belief.x)
    spread = belief.x[..., None, :, :] - x[..., :, None, :]
    if belief.x.ndim > 2:  # trials: one operation for all of them at each entry
        return x, mixture_covariance(weights, spread, belief.P[..., None, :, :, :]), log_mu
    modes, n = belief.x.shape
    inner = (weights @ belief.P.reshape(modes, n * n)).reshape(modes, n, n)
    return x, inner + (spread * weights[..., None]).swapaxes(-1, -2) @ spread, log_mu


def update(
    system: StochasticSystem,
    belief: Belief,
    z: FloatArray,
    u: FloatArray | None = None,
    *,
    gate: Gate | None = None,
) -> Posterior:
    """Return the belief after the measurement z (..., p), NaN where a channel is missing; u (..., m) acts through D.

    Without any measurement the belief stays as predicted and the log-likelihood is 0; with a gate so it is for an
    outlier, and the gate of the next row is `judgement.gate` of the posterior.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> system = calm_and_wild()
    >>> update(system, predict_imm(system, Belief.prior(system)), np.array([30.0])).belief.mu.round(6).tolist()
    [0.0, 1.0]
    """
    correction, judgement = correct(system.comparable_bank, belief, z, u, gate)
    log_mu, log_likelihood = weighed(belief.log_mu, correction.log_likelihood)
    posterior = Belief(sealed(correction.x), sealed(correction.P), sealed(log_mu))
    return Posterior(posterior, log_likelihood, belief.mu, correction.residual, correction.S, judgement)


def correct(
    bank: Bank, belief: Belief, z: FloatArray, u: FloatArray | None, gate: Gate | None = None
) -> tuple[Correction, Judgement]:
    """Return the Kalman update of every mode, and where z was an outlier and counted as missing.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> correct(calm_and_wild().bank, Belief.prior(calm_and_wild()), np.array([2.0]), None)[0].x.round(12).tolist()
    [[1.0], [1.0]]
    """
    measured = trials_last(z, 1)[..., None, :]
    if not bank.whole:
        measured = np.where(bank.measured, measured, np.nan)
    residual = measured - expected(bank, belief.x, u)
    R = noise.grown(bank.R, bank.measurement_by_state, belief.x, belief.P)
    correction = noise.update(belief.x, belief.P, residual, bank.H, R, tails=bank.tails)
    if gate is None:
        return correction, Judgement.none(z.shape[:-1])
    judgement = gate.judge(correction.distance, belief.log_mu, measured[..., 0, :])
    if judgement.gated.any():
        residual = np.where(judgement.gated[..., None, None], np.nan, residual)
        correction = noise.update(belief.x, belief.P, residual, bank.H, R, tails=bank.tails)
    return correction, judgement


def expected(bank: Bank, x: FloatArray, u: FloatArray | None) -> FloatArray:
    """Return the measurement H x + D u + g that every mode expects; x (..., M, n).

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> expected(calm_and_wild().bank, np.ones((2, 1)), None).tolist()
    [[1.0], [1.0]]
    """
    return times(bank.H, x) + pushed(bank.D, bank.g, u)


def pushed(matrix: FloatArray, offset: FloatArray, u: FloatArray | None) -> FloatArray:
    """Return matrix u + offset of every mode (..., M, k); without an input the offset alone.

    >>> pushed(np.ones((2, 1, 1)), np.zeros((2, 1)), np.array([3.0])).tolist()
    [[3.0], [3.0]]
    """
    return offset if u is None else times(matrix, u[..., None, :]) + offset


def weighed(log_predicted: FloatArray, log_likelihood: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return log µ_j ∝ µ⁻_j Λ_j, and the logarithm of the sum that it was divided by.

    >>> [part.tolist() for part in weighed(np.log([0.5, 0.5]), np.log([0.25, 0.25]))]
    [[-0.693..., -0.693...], -1.386...]
    """
    joint = log_predicted + log_likelihood
    total = log_sum(joint)
    return joint - total[..., None], total


def _log_joint(system: StochasticSystem, belief: Belief) -> FloatArray:
    """log Π_ji µ_i, axes (..., to, from)."""
    return system.log_probability_to_from + belief.log_mu[..., None, :]


def _moved(bank: Bank, x: FloatArray, P: FloatArray, log_mu: FloatArray, u: FloatArray | None) -> Belief:
    Q = noise.grown(bank.Q, bank.process_by_state, x, P)
    x, P = gaussian.predict(x, P, bank.F, Q, pushed(bank.B, bank.f, u))
    return Belief(sealed(x), sealed(P), log_mu)


__all__ = [
    "correct",
    "expected",
    "mix",
    "predict_imm",
    "predict_mmae",
    "pushed",
    "update",
    "weighed",
]
