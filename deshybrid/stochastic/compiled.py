"""IMM and MMAE over whole records, compiled by numba (extra `numba`), a block of trials at a time.

In: the arrays of a `Bank`, logarithms of Π, a prior, measurements (rows, p, trials), inputs (rows, m, trials), a gate.
Out: the columns of `Estimates`, trials last.  Idea: every entry of every matrix is a short line of `LANES` trials,
which stays in the first cache and is what the compiler turns into vector instructions; lower halves of covariances
only.  The results are those of numpy up to rounding: 1e-9 of the largest number of a record in the tests.

O(M² n² + M n³) a row and trial; the first call compiles for seconds, later processes take that from a cache.
"""

from typing import TypeAlias

import numpy as np
from numba import njit

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.gating import PATIENCE
from deshybrid.stochastic.system import Bank

Columns: TypeAlias = tuple[FloatArray, ...]

LANES = 16
_HALF_LOG_2PI = 0.5 * np.log(2.0 * np.pi)


@njit(cache=True, error_model="numpy")
def _predict_mu(log_Pi, log_mu, predicted, weights):
    """log µ⁻_j and the weights of mixing; a mode that cannot be entered keeps its own estimate."""
    modes, lanes = log_mu.shape
    for j in range(modes):
        for t in range(lanes):
            largest = -np.inf
            for i in range(modes):
                largest = max(largest, log_Pi[j, i] + log_mu[i, t])
            total = 0.0
            for i in range(modes):
                weights[j, i, t] = (
                    np.exp(log_Pi[j, i] + log_mu[i, t] - largest) if largest > -np.inf else (1.0 if i == j else 0.0)
                )
                total += weights[j, i, t]
            for i in range(modes):
                weights[j, i, t] /= total
            predicted[j, t] = largest + np.log(total)


@njit(cache=True, error_model="numpy")
def _blend(weights, x, P, mean, covariance, spread):
    """Mean and lower half of the covariance of a mixture."""
    modes, n, lanes = x.shape
    for a in range(n):
        for t in range(lanes):
            mean[a, t] = 0.0
        for i in range(modes):
            for t in range(lanes):
                mean[a, t] += weights[i, t] * x[i, a, t]
        for b in range(a + 1):
            for t in range(lanes):
                covariance[a, b, t] = 0.0
    for i in range(modes):
        for a in range(n):
            for t in range(lanes):
                spread[a, t] = x[i, a, t] - mean[a, t]
            for b in range(a + 1):
                for t in range(lanes):
                    covariance[a, b, t] += weights[i, t] * (P[i, a, b, t] + spread[a, t] * spread[b, t])


@njit(cache=True, error_model="numpy")
def _move(F, Q, B, f, u, x0, P0, x, P, FP):
    """F x + B u + f and the lower half of F P Fᵀ + Q, from the lower half of P."""
    n, lanes = x0.shape
    for a in range(n):
        for t in range(lanes):
            x[a, t] = f[a]
        for k in range(n):
            for t in range(lanes):
                x[a, t] += F[a, k] * x0[k, t]
        for k in range(u.shape[0]):
            for t in range(lanes):
                x[a, t] += B[a, k] * u[k, t]
        for b in range(n):
            for t in range(lanes):
                FP[b, t] = 0.0
            for k in range(n):
                high, low = (k, b) if k >= b else (b, k)
                for t in range(lanes):
                    FP[b, t] += F[a, k] * P0[high, low, t]
        for b in range(a + 1):
            for t in range(lanes):
                P[a, b, t] = Q[a, b]
            for k in range(n):
                for t in range(lanes):
                    P[a, b, t] += FP[k, t] * F[b, k]


@njit(cache=True, error_model="numpy")
def _innovate(H, R, D, g, u, z, x, P, e, S, W):
    """Residual, lower half of S and W = H P; a missing channel has residual 0 and variance 1."""
    p, n = H.shape
    lanes = x.shape[1]
    for i in range(p):
        for t in range(lanes):
            e[i, t] = z[i, t] - g[i]
        for k in range(u.shape[0]):
            for t in range(lanes):
                e[i, t] -= D[i, k] * u[k, t]
        for k in range(n):
            for t in range(lanes):
                e[i, t] -= H[i, k] * x[k, t]
        for t in range(lanes):
            e[i, t] = 0.0 if np.isnan(z[i, t]) else e[i, t]
        for b in range(n):
            for t in range(lanes):
                W[i, b, t] = 0.0
            for k in range(n):
                high, low = (k, b) if k >= b else (b, k)
                for t in range(lanes):
                    W[i, b, t] += H[i, k] * P[high, low, t]
            for t in range(lanes):
                W[i, b, t] = 0.0 if np.isnan(z[i, t]) else W[i, b, t]
        for b in range(i + 1):
            for t in range(lanes):
                S[i, b, t] = R[i, b]
            for k in range(n):
                for t in range(lanes):
                    S[i, b, t] += W[i, k, t] * H[b, k]
            for t in range(lanes):
                if np.isnan(z[i, t]) or np.isnan(z[b, t]):
                    S[i, b, t] = 1.0 if i == b else 0.0


@njit(cache=True, error_model="numpy")
def _eliminate(L, e, W):
    """S = L D Lᵀ in place, D on the diagonal; e becomes L⁻¹ e, W becomes L⁻¹ W."""
    p, lanes = e.shape
    for i in range(p):
        for j in range(i):
            for k in range(j):
                for t in range(lanes):
                    L[i, j, t] -= L[i, k, t] * L[k, k, t] * L[j, k, t]
            for t in range(lanes):
                L[i, j, t] /= L[j, j, t]
        for k in range(i):
            for t in range(lanes):
                L[i, i, t] -= L[i, k, t] * L[k, k, t] * L[i, k, t]
                e[i, t] -= L[i, k, t] * e[k, t]
            for b in range(W.shape[1]):
                for t in range(lanes):
                    W[i, b, t] -= L[i, k, t] * W[k, b, t]


@njit(cache=True, error_model="numpy")
def _correct(L, e, W, x, P, log_likelihood, distance):
    """x + Σ w e / d, P - Σ w wᵀ / d over the rows of L⁻¹ W, Σ e² / d, and the log-likelihood but for its constant."""
    p, n, lanes = W.shape
    for t in range(lanes):
        log_likelihood[t] = 0.0
        distance[t] = 0.0
    for i in range(p):
        for t in range(lanes):
            distance[t] += e[i, t] * e[i, t] / L[i, i, t]
            log_likelihood[t] -= 0.5 * (e[i, t] * e[i, t] / L[i, i, t] + np.log(L[i, i, t]))
        for a in range(n):
            for t in range(lanes):
                x[a, t] += W[i, a, t] * e[i, t] / L[i, i, t]
            for b in range(a + 1):
                for t in range(lanes):
                    P[a, b, t] -= W[i, a, t] / L[i, i, t] * W[i, b, t]


@njit(cache=True, error_model="numpy")
def _weigh(predicted, fit, log_mu, mu, total):
    """log µ_j ∝ µ⁻_j Λ_j, µ, and the logarithm of the sum."""
    modes, lanes = fit.shape
    for t in range(lanes):
        largest = -np.inf
        for j in range(modes):
            largest = max(largest, predicted[j, t] + fit[j, t])
        total[t] = 0.0
        for j in range(modes):
            total[t] += np.exp(predicted[j, t] + fit[j, t] - largest)
        total[t] = largest + np.log(total[t])
        for j in range(modes):
            log_mu[j, t] = predicted[j, t] + fit[j, t] - total[t]
            mu[j, t] = np.exp(log_mu[j, t])


@njit(cache=True, error_model="numpy")
def _admit(z, distance, predicted, gate, count, gated, readmitted):
    """Which lanes are left out and which are taken beyond the gate, as `gating.Gate.judge` says."""
    (modes, lanes), (limits, patience) = distance.shape, gate
    for t in range(lanes):
        measured = 0
        for i in range(z.shape[0]):
            measured += 0 if np.isnan(z[i, t]) else 1
        beyond = measured > 0
        for j in range(modes):
            if predicted[j, t] > -np.inf and not distance[j, t] > limits[measured]:
                beyond = False
        is_open = count[t] >= patience
        gated[t], readmitted[t] = beyond and not is_open, beyond and is_open
        if measured > 0 and beyond == is_open:
            count[t] = patience if is_open else 0
        elif measured > 0:
            count[t] = (count[t] + 1) % (2 * patience)


@njit(cache=True, error_model="numpy")
def _leave_out(gated, predicted_x, predicted_P, x, P, residual, S, fit):
    """Put back what was predicted, for the lanes that are left out: residual 0, S = 1, a perfect fit."""
    for t in range(len(gated)):
        if gated[t]:
            fit[t] = 0.0
            for a in range(x.shape[0]):
                x[a, t] = predicted_x[a, t]
                for b in range(a + 1):
                    P[a, b, t] = predicted_P[a, b, t]
            for i in range(residual.shape[0]):
                residual[i, t] = 0.0
                for b in range(i + 1):
                    S[i, b, t] = 1.0 if i == b else 0.0


@njit(cache=True, error_model="numpy")
def _rows(bank, log_Pi, belief, z, u, u_before, mixing, gate, columns):
    """All rows of one block; the belief (x, P, log_mu) changes in place; gate: limits or none, patience."""
    F, H, Q, R, B, D, f, g = bank
    x, P, log_mu = belief
    means, covariances, probabilities, log_likelihoods, nis, gated, readmitted = columns
    (modes, p, n), lanes = H.shape, x.shape[2]
    x0, P0, spread, FP = np.empty_like(x), np.empty_like(P), np.empty((max(n, p), lanes)), np.empty((n, lanes))
    predicted, weights, mu = np.empty((modes, lanes)), np.empty((modes, modes, lanes)), np.empty((modes, lanes))
    residual, S, fit = np.empty((modes, p, lanes)), np.empty((modes, p, p, lanes)), np.empty((modes, lanes))
    moved_x, moved_P, count = np.empty_like(x), np.empty_like(P), np.zeros(lanes, np.int64)
    distance = np.empty((modes, lanes))
    e, L, W, nothing = np.empty((p, lanes)), np.empty((p, p, lanes)), np.empty((p, n, lanes)), np.empty((p, 0, lanes))
    for row in range(z.shape[0]):
        _predict_mu(log_Pi, log_mu, predicted, weights)
        for j in range(modes):
            if mixing:
                _blend(weights[j], x, P, x0[j], P0[j], spread)
            else:
                _copy(x[j], P[j], x0[j], P0[j])
        for j in range(modes):
            _move(F[j], Q[j], B[j], f[j], u_before[row], x0[j], P0[j], x[j], P[j], FP)
            _innovate(H[j], R[j], D[j], g[j], u[row], z[row], x[j], P[j], residual[j], S[j], W)
            _copy(residual[j], S[j], e, L)
            if len(gate[0]):
                _copy(x[j], P[j], moved_x[j], moved_P[j])
            _eliminate(L, e, W)
            _correct(L, e, W, x[j], P[j], fit[j], distance[j])
        if len(gate[0]):
            _admit(z[row], distance, predicted, gate, count, gated[row], readmitted[row])
            for j in range(modes):
                _leave_out(gated[row], moved_x[j], moved_P[j], x[j], P[j], residual[j], S[j], fit[j])
        _weigh(predicted, fit, log_mu, probabilities[row], log_likelihoods[row])
        _blend(probabilities[row], x, P, means[row], covariances[row], spread)
        _mirror(covariances[row])
        for j in range(modes):
            for t in range(lanes):
                mu[j, t] = np.exp(predicted[j, t])
        _blend(mu, residual, S, e, L, spread)
        _eliminate(L, e, nothing)
        _judge(z[row], gated[row], e, L, log_likelihoods[row], nis[row])


@njit(cache=True, error_model="numpy")
def _copy(x, P, to_x, to_P):
    for a in range(x.shape[0]):
        for t in range(x.shape[1]):
            to_x[a, t] = x[a, t]
        for b in range(a + 1):
            for t in range(x.shape[1]):
                to_P[a, b, t] = P[a, b, t]


@njit(cache=True, error_model="numpy")
def _mirror(P):
    for a in range(P.shape[0]):
        for b in range(a):
            for t in range(P.shape[2]):
                P[b, a, t] = P[a, b, t]


@njit(cache=True, error_model="numpy")
def _judge(z, gated, e, D, log_likelihood, nis):
    """The squared residual of the mixture from its factors, and the constant of the likelihood."""
    p, lanes = e.shape
    for t in range(lanes):
        nis[t] = 0.0
        for i in range(p):
            nis[t] += e[i, t] * e[i, t] / D[i, i, t]
            log_likelihood[t] -= 0.0 if np.isnan(z[i, t]) or gated[t] else _HALF_LOG_2PI


def run(
    bank: Bank,
    log_Pi: FloatArray,
    prior: Belief,
    rows_of: tuple[FloatArray, FloatArray],
    *,
    mixing: bool,
    limits: FloatArray,
) -> Columns:
    """Return x (N, n, T), P (N, n, n, T), mu (N, M, T), log_likelihood, nis, gated, readmitted (N, T) of T trials.

    `rows_of`: z (N, p, T), NaN where a measurement is missing, and the input u (N, m, T) of each row; `prior` is that
    of one trial, `limits` (p + 1,) those of a gate, empty without one.
    """
    z, u = rows_of
    modes, n = prior.x.shape
    rows, _, trials = z.shape
    arrays = (bank.F, bank.H, bank.Q, bank.R, bank.B, bank.D, bank.f, bank.g)
    blocks = []
    for first in range(0, max(trials, 1), LANES):
        at = slice(first, first + LANES)
        lanes = min(LANES, trials - first)
        belief = tuple(np.repeat(part[..., None], lanes, axis=-1) for part in (prior.x, prior.P, prior.log_mu))
        now = np.ascontiguousarray(u[..., at])
        before = np.concatenate([now[:1], now[:-1]])
        columns = tuple(np.empty((rows, *shape, lanes)) for shape in ((n,), (n, n), (modes,), (), ()))
        columns += tuple(np.zeros((rows, lanes), dtype=np.bool_) for _ in ("gated", "readmitted"))
        _rows(
            arrays, log_Pi, belief, np.ascontiguousarray(z[..., at]), now, before, mixing, (limits, PATIENCE), columns
        )
        blocks.append(columns)
    return tuple(np.concatenate(parts, axis=-1) for parts in zip(*blocks, strict=True))


__all__ = ["LANES", "run"]
