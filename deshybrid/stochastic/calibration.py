"""Calibration of filters whose prediction is a mixture: each measurement as the standard normal number it ought to be.

In: a system, and measurements.  Out: scores (..., N, p).  The filter's density of a row, given the rows before, turns
its first output into u₁ = F(z₁), the next into u₂ = F(z₂ | z₁), and so on; Φ⁻¹(u) is then a standard normal number, and
all of them are independent, if the density is right: for any density, while squared residuals (NIS) follow χ² for a
Gaussian only.  So the sum of their squares is χ² distributed.  With one Gaussian it is the NIS itself.

An IMM filter is an approximation; what this finds beyond chance is what it loses by merging Gaussians, or a model that
does not fit.  O(M p³) a row besides the filter.
Source: Rosenblatt (1952); Diebold, Gunther and Tay (1998).
"""

from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import multiple, noise
from deshybrid.stochastic.belief import Belief, log_sum, sealed
from deshybrid.stochastic.lanes import cholesky, product, solve_lower
from deshybrid.stochastic.record import rows_of
from deshybrid.stochastic.system import StochasticSystem


def normal_scores(
    system: StochasticSystem, z: ArrayLike, u: ArrayLike | None = None, *, method: Literal["imm", "mmae"] = "imm"
) -> FloatArray:
    """Return the scores (..., N, p) of measurements z (..., N, p) under a multiple-model filter, NaN where one misses.

    Raises `UsageError` as `estimate`.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> normal_scores(calm_and_wild(), [[1.0], [9.0]]).round(2).tolist()
    [[0.51], [2.87]]
    """
    predict = multiple.predict_imm if method == "imm" else multiple.predict_mmae
    rows = rows_of(system, z, u)
    belief, found = Belief.prior(system, rows[0][0].shape[:-1]), []
    for measured, before, now in rows:
        predicted = predict(system, belief, before)
        found.append(_scores(*_components(system, predicted, measured, now)))
        belief = multiple.update(system, predicted, measured, now).belief
    return sealed(np.stack(found, axis=-2))


def _components(
    system: StochasticSystem, predicted: Belief, z: FloatArray, u: FloatArray | None
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Logarithms of weights (..., J), residuals (..., J, p) and covariances (..., J, p, p) of the predicted mixture."""
    bank, x, P = system.comparable_bank, predicted.x, predicted.P
    measured = np.where(bank.measured, z[..., None, :], np.nan)
    residual = measured - multiple.expected(bank, x, u)
    HPH = product(product(bank.H, P), bank.H.swapaxes(-1, -2))
    R = noise.grown(bank.R, bank.measurement_by_state, x, P)
    if bank.tails is None:
        return predicted.log_mu, residual, HPH + R
    share, factor = bank.tails[:, 0], bank.tails[:, 1]
    with np.errstate(divide="ignore"):
        weights = (predicted.log_mu + np.log1p(-share), predicted.log_mu + np.log(share))
    spreads = (HPH + R, HPH + factor[:, None, None] * R)
    return np.concatenate(weights, -1), np.concatenate((residual, residual), -2), np.concatenate(spreads, -3)


def _scores(log_weight: FloatArray, residual: FloatArray, S: FloatArray) -> FloatArray:
    """The score of each output given those before it; a component's factor L makes its residuals independent."""
    from scipy.special import log_ndtr, ndtri_exp

    seen = ~np.isnan(residual)
    both = seen[..., :, None] & seen[..., None, :]
    L = cholesky(np.where(both, S, np.eye(residual.shape[-1])))
    e = solve_lower(L, np.where(seen, residual, 0.0)[..., None])[..., 0]
    scores = np.empty(e.shape[:-2] + e.shape[-1:])
    for i in range(e.shape[-1]):
        weight = log_weight - log_sum(log_weight)[..., None]
        below, above = (log_sum(weight + log_ndtr(sign * e[..., i])) for sign in (1.0, -1.0))
        scores[..., i] = np.where(below < above, ndtri_exp(below), -ndtri_exp(above))
        density = -0.5 * e[..., i] ** 2 - np.log(L[..., i, i])
        log_weight = log_weight + np.where(seen[..., i], density, 0.0)
    return np.where(seen[..., 0, :], scores, np.nan)


__all__ = ["normal_scores"]
