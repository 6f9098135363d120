"""Filters written straight from the equations, one trial at a time: what the batched ones are held against.

Probabilities are plain numbers here, sums are loops, and densities come from scipy.
"""

from dataclasses import dataclass

import numpy as np
from scipy.stats import multivariate_normal

from deshybrid.stochastic.residual_mean import FLOOR
from deshybrid.stochastic.system import Mode, StochasticSystem


@dataclass
class Naive:
    """One trial's estimates, row by row."""

    mu: list
    x: list
    P: list
    log_likelihood: list


def kalman_predict(mode: Mode, x, P, u):
    return mode.F @ x + mode.B @ u + mode.f, mode.F @ P @ mode.F.T + mode.Q


def kalman_update(mode: Mode, x, P, z, u):
    """The textbook update, (I - K H) P, and the density of the measurement; missing channels are struck out."""
    seen = ~np.isnan(z)
    if not seen.any():
        return x, P, 1.0
    H, R = mode.H[seen], mode.R[np.ix_(seen, seen)]
    S = H @ P @ H.T + R
    K = P @ H.T @ np.linalg.inv(S)
    expected = H @ x + (mode.D @ u + mode.g)[seen]
    density = multivariate_normal.pdf(z[seen], expected, S)
    return x + K @ (z[seen] - expected), (np.eye(len(x)) - K @ H) @ P, density


def combined(weights, xs, Ps):
    mean = sum(w * x for w, x in zip(weights, xs, strict=True))
    spread = sum(w * (P + np.outer(x - mean, x - mean)) for w, x, P in zip(weights, xs, Ps, strict=True))
    return mean, spread


def multiple_models(system: StochasticSystem, z, u, *, method: str) -> Naive:
    """IMM, MMAE where the filters do not interact, RMIMM; z (N, p), u (N, m); every mode measures all outputs."""
    Pi, count = system.chain.probability_to_from, len(system.modes)
    mu, xs, Ps = system.mu.copy(), [system.x] * count, [system.P] * count
    errors = [np.zeros(len(system.x))] * count
    out = Naive([], [], [], [])
    for k, row in enumerate(z):
        predicted = [sum(Pi[j, i] * mu[i] for i in range(count)) for j in range(count)]
        if method != "mmae":
            weights = [[Pi[j, i] * mu[i] / predicted[j] for i in range(count)] for j in range(count)]
            mixed = [combined(weights[j], xs, Ps) for j in range(count)]
            xs, Ps = [m[0] for m in mixed], [m[1] for m in mixed]
        before, now = u[max(k - 1, 0)], u[k]
        moved = [kalman_predict(mode, xs[j], Ps[j], before) for j, mode in enumerate(system.modes)]
        done = [kalman_update(mode, *moved[j], row, now) for j, mode in enumerate(system.modes)]
        trust = np.ones(count)
        if method == "rmimm":
            found = [
                expected_residual(
                    system, j, predicted, start=xs[j], P=Ps[j], error=errors[j], z=row, inputs=(before, now)
                )
                for j in range(count)
            ]
            errors, trust = [f[0] for f in found], np.array([1.0 / max(f[1], FLOOR) for f in found])
        xs, Ps = [d[0] for d in done], [d[1] for d in done]
        joint = np.array([predicted[j] * done[j][2] for j in range(count)])
        mu = joint * trust / (joint * trust).sum()
        mean, spread = combined(mu, xs, Ps)
        out.mu.append(mu)
        out.x.append(mean)
        out.P.append(spread)
        out.log_likelihood.append(np.log(joint.sum()))
    return out


def expected_residual(system, j, predicted, *, start, P, error, z, inputs):
    """(26) and (27) of Hwang et al. (2006) for filter j, averaged over the mode i that may be true.

    With ΔA = A_i - A_j, ΔC = C_i - C_j as printed, and what inputs and offsets differ by.  Returns the new mean error
    and the norm of the mean residual.
    """
    before, now = inputs
    own, seen = system.modes[j], ~np.isnan(z)
    _, covariance = kalman_predict(own, start, P, before)
    H, R = own.H[seen], own.R[np.ix_(seen, seen)]
    S = H @ covariance @ H.T + R
    K = covariance @ H.T @ np.linalg.inv(S)
    residual, left = np.zeros(seen.sum()), np.zeros(len(start))
    for weight, true in zip(predicted, system.modes, strict=True):
        dA, C, dC = true.F - own.F, true.H[seen], (true.H - own.H)[seen]
        push = (true.B - own.B) @ before + true.f - own.f
        own_next = own.F @ start + own.B @ before + own.f
        offset = ((true.D - own.D) @ now + true.g - own.g)[seen]
        residual += weight * (C @ (true.F @ error + dA @ start + push) + dC @ own_next + offset)
        left += weight * (
            (np.eye(len(start)) - K @ C) @ (true.F @ error + dA @ start + push) - K @ (dC @ own_next + offset)
        )
    return left, float(np.sqrt(residual @ np.linalg.solve(S, residual))) if seen.any() else 0.0


def batch_least_squares(system: StochasticSystem, z, u, modes):
    """The last state of a run with known modes, and its covariance."""
    n = len(system.x)
    solution, covariance = whole_least_squares(system, z, u, modes)
    return solution[-n:], covariance[-n:, -n:]


def whole_least_squares(system: StochasticSystem, z, u, modes):
    """All states of a run with known modes, one after the other, as one least-squares problem.

    Unknown: x at the prior's time and at every row.  No recursion, no gain, no covariance update.
    """
    n, rows = len(system.x), len(z)
    blocks, values = [], []

    def add(places, covariance, value):
        white = np.linalg.inv(np.linalg.cholesky(covariance))
        line = np.zeros((len(value), n * (rows + 1)))
        for place, matrix in places.items():
            line[:, n * place : n * (place + 1)] = matrix
        blocks.append(white @ line)
        values.append(white @ value)

    add({0: np.eye(n)}, system.P, system.x)
    for k, number in enumerate(modes):
        mode = system.modes[number]
        add({k: -mode.F, k + 1: np.eye(n)}, mode.Q, mode.B @ u[max(k - 1, 0)] + mode.f)
        measured = z[k][list(mode.output_index)]
        seen = ~np.isnan(measured)
        if seen.any():
            R = mode.R[np.ix_(seen, seen)]
            add({k + 1: mode.H[seen]}, R, (measured - mode.D @ u[k] - mode.g)[seen])
    A, b = np.vstack(blocks), np.concatenate(values)
    information = A.T @ A
    solution = np.linalg.lstsq(A, b, rcond=None)[0]
    return solution, np.linalg.inv(information)


def enumerated(system: StochasticSystem, z, u):
    """The exact posterior of a short record given all of it: every sequence of modes, each by its Kalman filter.

    Returns mu (N, M) and the mean of x (N, n): M ** N runs.
    """
    count, n, rows = len(system.modes), len(system.x), len(z)
    Pi = system.chain.probability_to_from
    mu, x, total = np.zeros((rows, count)), np.zeros((rows, n)), 0.0
    for sequence in np.ndindex(*(count,) * rows):
        weight, mean, P, before = 1.0, system.x, system.P, system.mu
        for k, j in enumerate(sequence):
            weight *= float(Pi[j] @ before)
            before = np.eye(count)[j]
            mean, P = kalman_predict(system.modes[j], mean, P, u[max(k - 1, 0)])
            mean, P, density = kalman_update(system.modes[j], mean, P, z[k], u[k])
            weight *= density
        states = whole_least_squares(system, z, u, sequence)[0].reshape(rows + 1, n)[1:]
        total += weight
        mu += weight * np.eye(count)[list(sequence)]
        x += weight * states
    return mu / total, x / total


def smoothed(system: StochasticSystem, beliefs, u, k, lag):
    """mu, x, P of each mode of row k given `lag` rows more, pair by pair; beliefs are the (mu, xs, Ps) of every row."""
    Pi, count = system.chain.probability_to_from, len(system.modes)
    if lag == 0 or k == len(beliefs) - 1:
        return beliefs[k]
    mu, xs, Ps = beliefs[k]
    later_mu, later_x, later_P = smoothed(system, beliefs, u, k + 1, lag - 1)
    predicted = Pi @ mu
    new_mu, new_x, new_P = [], [], []
    for i in range(count):
        weights, means, spreads = [], [], []
        for j, mode in enumerate(system.modes):
            moved, covariance = kalman_predict(mode, xs[i], Ps[i], u[k])
            G = Ps[i] @ mode.F.T @ np.linalg.inv(covariance)
            weights.append(later_mu[j] * Pi[j, i] * mu[i] / predicted[j])
            means.append(xs[i] + G @ (later_x[j] - moved))
            spreads.append(Ps[i] + G @ (later_P[j] - covariance) @ G.T)
        new_mu.append(sum(weights))
        mean, spread = combined([w / sum(weights) for w in weights], means, spreads)
        new_x.append(mean)
        new_P.append(spread)
    return np.array(new_mu), new_x, new_P


def skipping_imm(system: StochasticSystem, z, u, *, limit=np.inf, patience=0):
    """x, P, mu, log-likelihood of each row, and what became of it: 0 taken, 1 left out, 2 taken although beyond.

    A row of z that is None is predicted and nothing else; so is one whose squared distance from what every mode expects
    is above `limit`, until `patience` in a row were: then all are taken until as many in a row are not above it.
    """
    Pi, modes = system.chain.probability_to_from, range(len(system.modes))
    mu, xs, Ps = system.mu, [system.x for _ in modes], [system.P for _ in modes]
    found, out, inside, is_open = [], 0, 0, False
    for k, row in enumerate(z):
        predicted = Pi @ mu
        mixed = [combined(Pi[j] * mu / predicted[j], xs, Ps) for j in modes]
        moved = [kalman_predict(system.modes[j], *mixed[j], u[max(k - 1, 0)]) for j in modes]
        fate = 0
        if row is not None:
            beyond = min(squared_distance(system.modes[j], *moved[j], row, u[k]) for j in modes) > limit
            fate = 0 if not beyond else 2 if is_open else 1
            out, inside = (out + 1, 0) if beyond else (0, inside + 1)
            is_open = inside < patience if is_open else out == patience
        mu, likelihood = predicted, 1.0
        if row is not None and fate != 1:
            done = [kalman_update(system.modes[j], *moved[j], row, u[k]) for j in modes]
            joint = predicted * [one[2] for one in done]
            moved, likelihood = [one[:2] for one in done], joint.sum()
            mu = joint / likelihood
        xs, Ps = [x for x, _ in moved], [P for _, P in moved]
        found.append((*combined(mu, xs, Ps), mu, np.log(likelihood), fate))
    return [np.array(column) for column in zip(*found, strict=True)]


def squared_distance(mode: Mode, x, P, z, u):
    """How far z is from what a mode expects, squared, in units of its covariance."""
    residual = z - mode.H @ x - mode.D @ u - mode.g
    return residual @ np.linalg.inv(mode.H @ P @ mode.H.T + mode.R) @ residual


def constant_gain_step(own, plant: Mode, states, u, noise=(0.0, 0.0)):
    """One row of a filter that keeps its filter gain, on a plant of another mode: state, estimate, residual.

    states: of the plant, and the estimate; u: the inputs of the step and of the row; noise: w and v.
    """
    mode, (x, estimate), (before, now), (w, v) = own.mode, states, u, noise
    x = plant.F @ x + plant.B @ before + plant.f + w
    ahead = mode.F @ estimate + mode.B @ before + mode.f
    residual = plant.H @ x + plant.D @ now + plant.g + v - mode.H @ ahead - mode.D @ now - mode.g
    return x, ahead + own.filter_gain @ residual, residual
