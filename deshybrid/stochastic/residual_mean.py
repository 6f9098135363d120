"""RMIMM: an IMM whose likelihoods are divided by how far off each filter expects its own residual to be.

If mode i is true, filter j makes a residual whose mean follows from the error it started with.  RMIMM keeps that mean
error ē_j for every filter, and weighs its likelihood with N_j = 1 / ‖r̄_j‖.

    r̄_j = Σ_i µ⁻_i {H_i F_i ē_j + (H_i F_i - H_j F_j) x_0j}            plus what inputs and offsets differ by
    ē_j := Σ_i µ⁻_i {F_i ē_j + (F_i - F_j) x_0j} - K_j r̄_j

The paper's (28) uses the index j for the filter and for the sum, and the true mode, which is unknown at run time.  Read
with that clash, all r̄_j are equal and RMIMM is IMM.  Here the sum is over the mode i that may be true, x_0j is the
mixed estimate that filter j starts from (unmixed, a mode of constant velocity expects no residual for ever and the
filter locks on it), and the norm is that of S_j⁻¹, which has no units.  It is at least `FLOOR`, so that no weight is
infinite.  The probabilities are surer than an IMM's, also where they are wrong: prefer IMM (`docs/stochastic.md`).

O(M² n² + M n³) a step and trial.  Source: Hwang et al. (2006), section 5, (26) to (29).
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import multiple
from deshybrid.stochastic.belief import Belief, Posterior, read_only
from deshybrid.stochastic.gating import Gate
from deshybrid.stochastic.gaussian import squared_norm
from deshybrid.stochastic.lanes import times
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.system import StochasticSystem

FLOOR = 0.1
"""The smallest expected residual, in standard deviations, that still gives a weight of its own."""


@dataclass(frozen=True, slots=True, eq=False)
class ResidualBelief:
    """The belief of an IMM, and the mean error ē_j (..., M, n) that every filter expects of itself; read-only."""

    belief: Belief
    error_mean: FloatArray

    def __post_init__(self) -> None:
        object.__setattr__(self, "error_mean", read_only(self.error_mean))

    @classmethod
    def prior(cls, system: StochasticSystem, trials: tuple[int, ...] = ()) -> "ResidualBelief":
        """Return the system's prior, whose mean has no error.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> ResidualBelief.prior(calm_and_wild()).error_mean.tolist()
        [[0.0], [0.0]]
        """
        require_fixed_noise(system.modes, "`rmimm`")
        belief = Belief.prior(system, trials)
        return cls(belief, np.zeros_like(belief.x))


@dataclass(frozen=True, slots=True, eq=False)
class ResidualPrediction:
    """A predicted belief; reached (..., M, M, n): the mean state [filter j, true mode i], were i the true mode."""

    belief: Belief
    reached: FloatArray


def predict_rmimm(system: StochasticSystem, state: ResidualBelief, u: FloatArray | None = None) -> ResidualPrediction:
    """Return the belief one step later, as `predict_imm`, and where each true mode would have led.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> system = calm_and_wild()
    >>> predict_rmimm(system, ResidualBelief.prior(system)).reached.shape
    (2, 2, 1)
    """
    bank = system.comparable_bank
    start = multiple.mix(system, state.belief).x + state.error_mean
    push = multiple.pushed(bank.B, bank.f, u)
    reached = times(bank.F, start[..., :, None, :]) + push[..., None, :, :]
    return ResidualPrediction(multiple.predict_imm(system, state.belief, u), reached)


def update_rmimm(
    system: StochasticSystem,
    prediction: ResidualPrediction,
    z: FloatArray,
    u: FloatArray | None = None,
    *,
    gate: Gate | None = None,
) -> tuple[ResidualBelief, Posterior]:
    """Return the state after the measurement z (..., p), and its posterior; the log-likelihood is that of an IMM.

    With a gate an outlier counts as missing.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> system = calm_and_wild()
    >>> state, _ = update_rmimm(system, predict_rmimm(system, ResidualBelief.prior(system)), np.array([1.0]))
    >>> state.error_mean.tolist()
    [[0.0], [0.0]]
    """
    bank, prior = system.comparable_bank, prediction.belief
    correction, judgement = multiple.correct(bank, prior, z, u, gate)
    true = multiple.expected(bank, prediction.reached, _for_every_filter(u))  # (..., filter, true mode, p)
    ahead = true - multiple.expected(bank, prior.x, u)[..., :, None, :]
    seen = ~(np.isnan(z) | judgement.gated[..., None])[..., None, :] & bank.measured
    residual_mean = np.where(seen, np.einsum("...jip,...i->...jp", ahead, prior.mu), 0.0)
    drift = np.einsum("...jin,...i->...jn", prediction.reached, prior.mu) - prior.x
    weight = -np.log(np.maximum(np.sqrt(squared_norm(residual_mean, correction.S)), FLOOR))
    log_mu, _ = multiple.weighed(prior.log_mu, correction.log_likelihood + weight)
    _, log_likelihood = multiple.weighed(prior.log_mu, correction.log_likelihood)
    posterior = Belief(correction.x, correction.P, log_mu)
    state = ResidualBelief(posterior, drift - times(correction.gain, residual_mean))
    return state, Posterior(posterior, log_likelihood, prior.mu, correction.residual, correction.S, judgement)


def _for_every_filter(u: FloatArray | None) -> FloatArray | None:
    return None if u is None else u[..., None, :]


__all__ = ["FLOOR", "ResidualBelief", "ResidualPrediction", "predict_rmimm", "update_rmimm"]
