"""The IMM with hindsight: location and state of a row, given a number of rows after it (fixed lag) or all of them.

In: the beliefs of an IMM after each row.  Out: smoothed beliefs.  Idea: one step back is a Rauch-Tung-Striebel step for
every pair of modes (i now, j next), weighed by how probable the pair is in hindsight, and collapsed over j.

    µ_ij = µˢ_j Π_ji µ_i / µ⁻_j
    x_ij = x_i + G (xˢ_j - F_j x_i - ...),  G = P_i F_jᵀ (F_j P_i F_jᵀ + Q_j)⁺

The belief of row k given the rows up to k + d comes from that of row k + 1 given the same rows, so that all rows of a
record take each of the `lag` steps at once.  With one mode this is the exact smoother; with several the pairs are
collapsed as the IMM collapses them.  A pseudo-inverse serves modes whose states have no noise.

O(lag M² n³) a row and trial.  Source: Kim (1994), Journal of Econometrics 60; Rauch, Tung and Striebel (1965).
"""

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.belief import Belief, log_sum, mixture_covariance, sealed
from deshybrid.stochastic.gating import Gate
from deshybrid.stochastic.lanes import product, symmetric, times
from deshybrid.stochastic.multiple import predict_imm, pushed, update
from deshybrid.stochastic.noise import grown
from deshybrid.stochastic.record import Estimates, estimate, rows_of
from deshybrid.stochastic.system import StochasticSystem

_SINGULAR = 1e-12  # of the largest eigenvalue: below it a predicted covariance counts as singular


def smooth(
    system: StochasticSystem, z: ArrayLike, u: ArrayLike | None = None, *, lag: int, gate: float | None = None
) -> Estimates:
    """Return the estimates of an IMM, of each row given the rows up to `lag` after it; z (..., N, p), u (..., N, m).

    `log_likelihood`, `nis`, `channels` and `gated` are those of the filter, which `lag` 0 is.

    Raises `UsageError` as `estimate`, and DH1112 for a negative lag.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> smooth(calm_and_wild(), [[0.1], [0.2], [9.0], [9.1]], lag=2).most_probable.tolist()
    [0, 1, 1, 1]
    """
    if lag < 0:
        raise UsageError(diagnostic("DH1112", f"a lag of {lag} rows looks into the past"))
    filtered = estimate(system, z, u, gate=gate)
    rows = rows_of(system, z, u)
    trials = filtered.x.shape[:-2]
    opening = None if gate is None else Gate.of(system.bank.H.shape[1], gate, trials)
    beliefs = []
    belief = Belief.prior(system, trials)
    for measured, before, now in rows:
        posterior = update(system, predict_imm(system, belief, before), measured, now, gate=opening)
        belief, opening = posterior.belief, posterior.judgement.gate
        beliefs.append(belief)
    known = _together(beliefs)
    inputs = None if rows[0][2] is None else np.stack([now for _, _, now in rows if now is not None], axis=-2)
    smoothed = known
    for _ in range(min(lag, len(rows) - 1)):
        held = None if inputs is None else inputs[..., :-1, :]
        back = step_back(system, _rows(known, slice(None, -1)), _rows(smoothed, slice(1, None)), held)
        smoothed = _appended(back, _rows(known, slice(-1, None)))
    x, P = smoothed.mixture()
    return replace(filtered, x=sealed(x), P=sealed(P), mu=sealed(smoothed.mu))


def step_back(system: StochasticSystem, now: Belief, later: Belief, u: FloatArray | None = None) -> Belief:
    """Return the belief `now`, of an IMM after its measurement, in the light of the smoothed belief one row later.

    u (..., m) is the input that was held in between.  For a stream, keep the beliefs of the last rows and step back
    from the newest.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> system = calm_and_wild()
    >>> now = Belief.prior(system)
    >>> later = update(system, predict_imm(system, now), np.array([20.0])).belief
    >>> bool(step_back(system, now, later).mu[1] > now.mu[1])
    True
    """
    bank = system.comparable_bank
    joint = system.log_probability_to_from + now.log_mu[..., None, :]  # (..., j, i)
    predicted = log_sum(joint)
    with np.errstate(invalid="ignore"):
        pair = joint + (later.log_mu - predicted)[..., None]
    pair = np.where(np.isneginf(joint), -np.inf, pair)
    x, P = now.x[..., None, :, :], now.P[..., None, :, :, :]  # (..., 1, i, n)
    by_state = None if bank.process_by_state is None else bank.process_by_state[:, None]
    F, Q = bank.F[:, None], grown(bank.Q[:, None], by_state, x, P)
    moved = times(F, x) + pushed(bank.B, bank.f, u)[..., :, None, :]
    FP = product(F, P)
    covariance = symmetric(product(FP, F.swapaxes(-1, -2)) + Q)
    G = (np.linalg.pinv(covariance, rcond=_SINGULAR, hermitian=True) @ FP).swapaxes(-1, -2)
    smooth_x = x + times(G, later.x[..., :, None, :] - moved)
    smooth_P = symmetric(P + G @ (later.P[..., :, None, :, :] - covariance) @ G.swapaxes(-1, -2))
    log_mu = log_sum(pair.swapaxes(-1, -2))  # (..., i), over j
    return _collapsed(now, pair.swapaxes(-1, -2), log_mu, smooth_x.swapaxes(-2, -3), smooth_P.swapaxes(-3, -4))


def _collapsed(now: Belief, pair: FloatArray, log_mu: FloatArray, x: FloatArray, P: FloatArray) -> Belief:
    """The mixtures over j of pairs (..., i, j); a mode that hindsight excludes keeps what it had."""
    possible = np.isfinite(log_mu)
    with np.errstate(invalid="ignore"):
        weights = np.where(possible[..., None], np.exp(pair - log_mu[..., None]), 0.0)
    mean = product(weights[..., None, :], x)[..., 0, :]
    spread = mixture_covariance(weights, x - mean[..., None, :], P)
    kept = possible[..., None]
    return Belief(np.where(kept, mean, now.x), np.where(kept[..., None], spread, now.P), log_mu)


def _together(beliefs: list[Belief]) -> Belief:
    """The beliefs of all rows as one, with the rows as the last of its leading axes."""
    x = np.stack([belief.x for belief in beliefs], axis=-3)
    P = np.stack([belief.P for belief in beliefs], axis=-4)
    return Belief(x, P, np.stack([belief.log_mu for belief in beliefs], axis=-2))


def _rows(belief: Belief, rows: slice) -> Belief:
    return Belief(belief.x[..., rows, :, :], belief.P[..., rows, :, :, :], belief.log_mu[..., rows, :])


def _appended(first: Belief, last: Belief) -> Belief:
    x = np.concatenate([first.x, last.x], axis=-3)
    P = np.concatenate([first.P, last.P], axis=-4)
    return Belief(x, P, np.concatenate([first.log_mu, last.log_mu], axis=-2))


__all__ = ["smooth", "step_back"]
