"""Outputs of a window and distances of Gaussians, written straight from the definitions."""

import numpy as np


def stacked_outputs(measuring, moving, x, P, u):
    """Mean and covariance of all outputs: every source of randomness is pushed through the recursion alone.

    Sources: the state at the first row, the noise of every step, the noise of every measurement.
    """
    rows, n, p = len(measuring), len(x), len(measuring[0].g)

    def run(start, steps, known):
        state, out = start, []
        for k, sensor in enumerate(measuring):
            if k:
                before = moving[k - 1]
                state = before.F @ state + steps[k - 1] + known * (before.B @ u[k - 1] + before.f)
            out.append(sensor.H @ state + known * (sensor.D @ u[k] + sensor.g))
        return np.concatenate(out)

    none = np.zeros((rows - 1, n))
    mean = run(np.asarray(x), none, 1.0)
    columns = np.column_stack([run(unit, none, 0.0) for unit in np.eye(n)])
    covariance = columns @ P @ columns.T
    for k, mode in enumerate(moving):
        noisy = []
        for unit in np.eye(n):
            steps = none.copy()
            steps[k] = unit
            noisy.append(run(np.zeros(n), steps, 0.0))
        columns = np.column_stack(noisy)
        covariance += columns @ mode.Q @ columns.T
    for k, mode in enumerate(measuring):
        covariance[p * k : p * (k + 1), p * k : p * (k + 1)] += mode.R
    return mean, covariance


def kullback_leibler(m1, S1, m2, S2):
    """Divergence of N(m2, S2) from N(m1, S1)."""
    gap = m1 - m2
    size = np.linalg.slogdet(S2)[1] - np.linalg.slogdet(S1)[1]
    return 0.5 * (np.trace(np.linalg.solve(S2, S1)) - len(m1) + gap @ np.linalg.solve(S2, gap) + size)


def bhattacharyya(m1, S1, m2, S2):
    """-ln of the integral of √(p_1 p_2)."""
    gap, middle = m1 - m2, (S1 + S2) / 2
    size = np.linalg.slogdet(middle)[1] - 0.5 * (np.linalg.slogdet(S1)[1] + np.linalg.slogdet(S2)[1])
    return gap @ np.linalg.solve(middle, gap) / 8 + 0.5 * size


def covariance_as_printed(mode, P, rows):
    """O Π₀ Oᵀ + T Q̄ Tᵀ + R̄ with O and T of the paper's equation (2) written out."""
    n, p = len(mode.f), len(mode.g)
    power = [np.linalg.matrix_power(mode.F, k) for k in range(rows)]
    visible = np.vstack([mode.H @ power[k] for k in range(rows)])
    T = np.zeros((rows * p, (rows - 1) * n))
    for i in range(rows):
        for j in range(i):
            T[p * i : p * (i + 1), n * j : n * (j + 1)] = mode.H @ power[i - j - 1]
    return visible @ P @ visible.T + T @ np.kron(np.eye(rows - 1), mode.Q) @ T.T + np.kron(np.eye(rows), mode.R)
