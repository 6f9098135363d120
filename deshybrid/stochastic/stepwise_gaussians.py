"""The Gaussians of the filters' reference step: mixed, carried over one step, and corrected by a measurement.

In: `Constants`, `State` and `Room`, all flat.  Out: Gaussians in the state or the room, changed in place, and the fit
of each.  This file is part of generated Python, word for word.

O(M² n²) operations for mixing, O(n³ + p n²) for each Gaussian.  Source: `deshybrid.stochastic.stepwise`.
"""

from deshybrid.stochastic.stepwise_numbers import eliminate, log, mirror
from deshybrid.stochastic.stepwise_values import Constants, Numbers, Room, State


def predict_mu(c: Constants, state: State, w: Room) -> None:
    """Set the predicted probabilities of the modes."""
    for j in range(c.modes):
        total = 0.0
        for i in range(c.modes):
            total = total + c.probability_to_from[j * c.modes + i] * state.mu[i]
        w.predicted[j] = total


def mix(c: Constants, state: State, w: Room) -> None:
    """Predict the probabilities, and set the Gaussians from which every mode starts: `predicted`, x, P of `w`."""
    predict_mu(c, state, w)
    for j in range(c.modes):
        total = w.predicted[j]
        for i in range(c.modes):
            joint = c.probability_to_from[j * c.modes + i] * state.mu[i]
            w.weight[i] = joint / total if total > 0.0 else float(i == j)
        blend(c, state, w, w.x, w.P, j)


def blend(c: Constants, state: State, w: Room, x: Numbers, P: Numbers, slot: int) -> None:
    """Set Gaussian `slot` of (x, P) to the mixture of those of the state, with the weights of `w`."""
    n = c.n
    at, square = slot * n, slot * n * n
    for a in range(n):
        total = 0.0
        for i in range(c.modes):
            total = total + w.weight[i] * state.x[i * n + a]
        x[at + a] = total
    P[square : square + n * n] = [0.0] * (n * n)
    for i in range(c.modes):
        if w.weight[i] > 0.0:
            for a in range(n):
                w.spread[a] = state.x[i * n + a] - x[at + a]
            for a in range(n):
                for b in range(a + 1):
                    part = state.P[(i * n + a) * n + b] + w.spread[a] * w.spread[b]
                    P[square + a * n + b] = P[square + a * n + b] + w.weight[i] * part
    mirror(n, P, square)


def move(c: Constants, state: State, w: Room, slot: int, mode: int) -> None:
    """Carry Gaussian `slot` over one step of `mode`, with the input `before`, from `w` to the state."""
    n, m = c.n, c.m
    at, square, rows = slot * n, slot * n * n, mode * n
    for a in range(n):
        total = c.f[rows + a]
        for b in range(n):
            total = total + c.F[(rows + a) * n + b] * w.x[at + b]
        for b in range(m):
            total = total + c.B[(rows + a) * m + b] * w.before[b]
        state.x[at + a] = total
    for a in range(n):
        for b in range(n):
            total = 0.0
            for k in range(n):
                total = total + c.F[(rows + a) * n + k] * w.P[square + k * n + b]
            w.FP[a * n + b] = total
    for a in range(n):
        for b in range(a + 1):
            total = c.Q[(rows + a) * n + b]
            for k in range(n):
                total = total + w.FP[a * n + k] * c.F[(rows + b) * n + k]
            state.P[square + a * n + b] = total
    mirror(n, state.P, square)


def innovate(c: Constants, state: State, w: Room, slot: int, mode: int, z: Numbers) -> None:
    """Set residual, S, W = H P and e of Gaussian `slot`, as `mode` measures z; missing channels: 0, variance 1."""
    n, p = c.n, c.p
    at, rows = slot * n, mode * p
    for i in range(p):
        w.seen[i] = c.measured[rows + i] if -c.largest <= z[i] and z[i] <= c.largest else 0
        total = z[i] - c.g[rows + i] if w.seen[i] else 0.0
        for b in range(c.m):
            total = total - c.D[(rows + i) * c.m + b] * state.held[b]
        for b in range(n):
            total = total - c.H[(rows + i) * n + b] * state.x[at + b]
        w.residual[slot * p + i] = total if w.seen[i] else 0.0
        w.e[i] = w.residual[slot * p + i]
        for b in range(n):
            total = 0.0
            for k in range(n):
                total = total + c.H[(rows + i) * n + k] * state.P[(at + k) * n + b]
            w.W[i * n + b] = total if w.seen[i] else 0.0
        for b in range(i + 1):
            total = c.R[(rows + i) * p + b]
            for k in range(n):
                total = total + w.W[i * n + k] * c.H[(rows + b) * n + k]
            both = w.seen[i] and w.seen[b]
            w.S[(slot * p + i) * p + b] = total if both else (1.0 if i == b else 0.0)


def correct(c: Constants, state: State, w: Room, slot: int) -> bool:
    """Update Gaussian `slot`, P - Σ w wᵀ / d over the rows of L⁻¹ W; False where S is not positive definite."""
    n, p = c.n, c.p
    at, square = slot * n, slot * n * n
    for i in range(p):
        w.L[i * p : i * p + i + 1] = w.S[(slot * p + i) * p : (slot * p + i) * p + i + 1]
    if not eliminate(p, n, w.L, w.e, w.W):
        return False
    w.distance[slot] = 0.0
    w.fit[slot] = 0.0
    for i in range(p):
        d = w.L[i * p + i]
        scaled = w.e[i] / d
        w.distance[slot] = w.distance[slot] + w.e[i] * scaled
        w.fit[slot] = w.fit[slot] + (w.e[i] * scaled + log(c.powers, d))
        for a in range(n):
            state.x[at + a] = state.x[at + a] + w.W[i * n + a] * scaled
            share = w.W[i * n + a] / d
            for b in range(a + 1):
                state.P[square + a * n + b] = state.P[square + a * n + b] - share * w.W[i * n + b]
    mirror(n, state.P, square)
    return True


def leave_out(c: Constants, w: Room, slot: int) -> None:
    """Forget what Gaussian `slot` measured: residual 0, S = 1, and a perfect fit."""
    p = c.p
    w.fit[slot] = 0.0
    for i in range(p):
        w.seen[i] = 0
        w.residual[slot * p + i] = 0.0
        for b in range(i + 1):
            w.S[(slot * p + i) * p + b] = 1.0 if i == b else 0.0


__all__ = ["blend", "correct", "innovate", "leave_out", "mix", "move", "predict_mu"]
