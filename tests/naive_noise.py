"""IMM and switching Kalman filter with noise beyond a fixed covariance, straight from the definition, one trial."""

import numpy as np
from scipy.stats import multivariate_normal

from tests.naive_filters import combined


def predicted(mode, x, P):
    """Mean and covariance of F x + f + e G x + w."""
    Q = mode.Q
    if mode.noise.process_by_state is not None:
        G = mode.noise.process_by_state
        Q = Q + G @ (P + np.outer(x, x)) @ G.T
    return mode.F @ x + mode.f, mode.F @ P @ mode.F.T + Q


def updated(mode, x, P, z):
    """Mean and covariance given z, and its density: a good row and a bad one, each by the textbook's Kalman filter."""
    seen = ~np.isnan(z)
    if not seen.any():
        return x, P, 1.0
    H, R = mode.H[seen], mode.R
    if mode.noise.measurement_by_state is not None:
        G = mode.noise.measurement_by_state
        R = R + G @ (P + np.outer(x, x)) @ G.T
    R = R[np.ix_(seen, seen)]
    parts, densities = [], []
    for share, factor in ((1.0 - mode.noise.share, 1.0), (mode.noise.share, mode.noise.factor)):
        S = H @ P @ H.T + factor * R
        K = P @ H.T @ np.linalg.inv(S)
        expected = H @ x + mode.g[seen]
        parts.append((x + K @ (z[seen] - expected), (np.eye(len(x)) - K @ H) @ P))
        densities.append(share * multivariate_normal.pdf(z[seen], expected, S))
    density = sum(densities)
    mean, spread = combined([d / density for d in densities], [p[0] for p in parts], [p[1] for p in parts])
    return mean, spread, density


def interacting(system, z):
    """IMM over z (N, p): mu, x, P and log-likelihood row by row."""
    Pi, modes = system.chain.probability_to_from, system.modes
    count = len(modes)
    mu, xs, Ps, rows = system.mu, [system.x] * count, [system.P] * count, []
    for row in z:
        before = Pi @ mu
        mixed = [combined([Pi[j, i] * mu[i] / before[j] for i in range(count)], xs, Ps) for j in range(count)]
        moved = [predicted(mode, *mixed[j]) for j, mode in enumerate(modes)]
        done = [updated(mode, *moved[j], row) for j, mode in enumerate(modes)]
        xs, Ps = [d[0] for d in done], [d[1] for d in done]
        joint = np.array([before[j] * done[j][2] for j in range(count)])
        mu = joint / joint.sum()
        rows.append((mu, *combined(mu, xs, Ps), np.log(joint.sum())))
    return rows


def known(system, z, modes):
    """The switching Kalman filter over z (N, p) with the modes' numbers (N,): x, P and log-likelihood row by row."""
    x, P, rows = system.x, system.P, []
    for row, number in zip(z, modes, strict=True):
        x, P, density = updated(system.modes[number], *predicted(system.modes[number], x, P), row)
        rows.append((x, P, np.log(density)))
    return rows
