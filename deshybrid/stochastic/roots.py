"""The IMM on square roots: S with P = S Sᵀ in place of P, for covariances that spread over more than eight digits.

In: a `StochasticSystem`, a `RootBelief`, an input and a measurement, with any leading axes.  Out: the next belief.
Idea: a sum of covariances A Aᵀ + B Bᵀ is L Lᵀ of the triangle L to which rotations bring [A B], so that P is never
formed by the filter, never loses its sign, and has twice the digits.  The estimates are those of `multiple` where that
has digits enough; it takes several times as long.

    mix      S_0j = triangle of the columns √w_ji S_i, √w_ji (x_i - x_0j)
    predict  S = triangle of F S, Q^(1/2)
    update   the triangle of [R^(1/2), H S; 0, S] is [S_z, 0; K S_z, S⁺]

O(M² n³) a step and trial.  Source: Kailath, Sayed and Hassibi (2000), chapter 12 (array algorithms).
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import gaussian
from deshybrid.stochastic.belief import Belief, Posterior, log_sum
from deshybrid.stochastic.gating import Gate, Judgement
from deshybrid.stochastic.lanes import solve_lower, times
from deshybrid.stochastic.multiple import expected, pushed, weighed
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.system import StochasticSystem

_LOG_2PI = float(np.log(2.0 * np.pi))


@dataclass(frozen=True, slots=True, eq=False)
class RootBelief:
    """x (..., M, n), S (..., M, n, n) with P = S Sᵀ, and log_mu (..., M)."""

    x: FloatArray
    S: FloatArray
    log_mu: FloatArray

    @classmethod
    def prior(cls, system: StochasticSystem, trials: tuple[int, ...] = ()) -> "RootBelief":
        """Return the system's prior in every mode.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> RootBelief.prior(calm_and_wild()).S.tolist()
        [[[1.0]], [[1.0]]]
        """
        require_fixed_noise(system.modes, "the engine `roots`")
        belief = Belief.prior(system, trials)
        return cls(belief.x, np.broadcast_to(_root(system.P), belief.P.shape), belief.log_mu)

    @property
    def belief(self) -> Belief:
        """The same with covariances."""
        return Belief(self.x, self.S @ self.S.swapaxes(-1, -2), self.log_mu)


def _root(covariance: FloatArray) -> FloatArray:
    """S with S Sᵀ = covariance, also where it is singular."""
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return root


def _triangle(columns: FloatArray) -> FloatArray:
    """Lower triangular L (..., n, n) with L Lᵀ = A Aᵀ of A (..., n, k), k >= n."""
    upper: FloatArray = np.asarray(np.linalg.qr(columns.swapaxes(-1, -2), mode="r"))
    return upper.swapaxes(-1, -2)


def predict_roots(system: StochasticSystem, belief: RootBelief, u: FloatArray | None = None) -> RootBelief:
    """Return the belief one step later, as `predict_imm`.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> predict_roots(calm_and_wild(), RootBelief.prior(calm_and_wild())).belief.P[:, 0, 0].round(12).tolist()
    [1.1, 10.0]
    """
    bank = system.comparable_bank
    joint = system.log_probability_to_from + belief.log_mu[..., None, :]
    log_mu = log_sum(joint)
    with np.errstate(invalid="ignore"):
        weights = np.exp(joint - log_mu[..., None])
    weights = np.where(np.isfinite(log_mu)[..., None], weights, np.eye(joint.shape[-1]))  # (..., to, from)
    x = weights @ belief.x
    share = np.sqrt(weights)[..., None]
    spread = share * (belief.x[..., None, :, :] - x[..., :, None, :])  # (..., to, from, n)
    scaled = share[..., None] * belief.S[..., None, :, :, :]
    columns = np.concatenate([scaled, spread[..., None]], axis=-1)  # (..., to, from, n, n + 1)
    columns = np.moveaxis(columns, -3, -2)  # (..., to, n, from, n + 1)
    mixed = _triangle(columns.reshape(*columns.shape[:-2], -1))
    noise = np.broadcast_to(_root(bank.Q), mixed.shape)
    S = _triangle(np.concatenate([bank.F @ mixed, noise], axis=-1))
    return RootBelief(times(bank.F, x) + pushed(bank.B, bank.f, u), S, log_mu)


def update_roots(
    system: StochasticSystem,
    belief: RootBelief,
    z: FloatArray,
    u: FloatArray | None = None,
    *,
    gate: Gate | None = None,
) -> tuple[RootBelief, Posterior]:
    """Return the belief after the measurement z (..., p), and its posterior; as `multiple.update`.

    Raises `UsageError`: DH1105 where the covariance of a residual is singular, DH1108 where it is not finite.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> update_roots(calm_and_wild(), RootBelief.prior(calm_and_wild()), np.array([2.0]))[0].x.round(12).tolist()
    [[1.0], [1.0]]
    """
    bank = system.comparable_bank
    measured = np.where(bank.measured, z[..., None, :], np.nan)
    residual = measured - expected(bank, belief.x, u)
    made = _corrected(belief, residual, bank.H, bank.R)
    judgement = Judgement.none(z.shape[:-1])
    if gate is not None:
        judgement = gate.judge((made.e**2).sum(axis=-1), belief.log_mu, measured[..., 0, :])
        made = _corrected(belief, np.where(judgement.gated[..., None, None], np.nan, residual), bank.H, bank.R)
    log_mu, log_likelihood = weighed(belief.log_mu, made.log_likelihood)
    after = RootBelief(made.x, made.S, log_mu)
    return after, Posterior(after.belief, log_likelihood, np.exp(belief.log_mu), made.residual, made.S_z, judgement)


@dataclass(frozen=True, slots=True, eq=False)
class _Corrected:
    x: FloatArray
    S: FloatArray
    residual: FloatArray
    S_z: FloatArray  # covariance of the residual
    e: FloatArray  # the residual in units of its deviation
    log_likelihood: FloatArray


def _corrected(belief: RootBelief, residual: FloatArray, H: FloatArray, R: FloatArray) -> _Corrected:
    p, n = H.shape[-2:]
    seen = ~np.isnan(residual)
    both = seen[..., :, None] & seen[..., None, :]
    noise = _root(np.where(both, R, np.eye(p)))
    residual = np.where(seen, residual, 0.0)
    array = np.zeros((*residual.shape[:-1], p + n, p + n))
    array[..., :p, :p] = noise
    array[..., :p, p:] = np.where(seen[..., None], H @ belief.S, 0.0)
    array[..., p:, p:] = belief.S
    triangle = _triangle(array)
    S_y = triangle[..., :p, :p]
    sizes = np.abs(np.diagonal(S_y, axis1=-2, axis2=-1))
    covariance = S_y @ S_y.swapaxes(-1, -2)
    with np.errstate(divide="ignore", invalid="ignore"):
        gaussian.require_factor(covariance, np.where(sizes > 0.0, sizes, np.nan)[..., None])
    e = solve_lower(S_y, residual[..., None])[..., 0]
    x = belief.x + times(triangle[..., p:, :p], e)
    constant = 0.5 * _LOG_2PI * seen.sum(axis=-1)
    log_likelihood = -0.5 * (e * e).sum(axis=-1) - np.log(sizes).sum(axis=-1) - constant
    return _Corrected(x, triangle[..., p:, p:], residual, covariance, e, log_likelihood)


__all__ = ["RootBelief", "predict_roots", "update_roots"]
