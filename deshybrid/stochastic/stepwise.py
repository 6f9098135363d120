"""The filters once more, number by number: the reference of generated code.

In: `Constants`, a `State` and `Room` to work in, all flat; numbers are `float` or `numpy.float32`.  Out: the state
after a measurement, and what is known then, written into `Out`.  Every sum runs from left to right, so that C, which
does the same operations in the same order, is equal bit for bit.  This file and the three that it imports are part of
generated Python, word for word.

Probabilities are plain numbers here, not logarithms: each is weighed against the best, so that the best is never lost,
and one that is smaller than about 1e-304 (in single precision 1e-35) times the best is zero.  It comes back by the
chain, as every mode that can be entered does.

O(M² n² + M n³) operations.  Source: Hwang et al. (2006), section 3; `deshybrid.stochastic.multiple` and, for the gate,
`deshybrid.stochastic.gating`.
"""

from deshybrid.stochastic.stepwise_gaussians import blend, correct, innovate, leave_out, mix, move, predict_mu
from deshybrid.stochastic.stepwise_numbers import HALF_LOG_2PI, eliminate, exp, is_within, log
from deshybrid.stochastic.stepwise_values import (
    INVALID,
    OK,
    OUTLIER,
    READMITTED,
    RESTARTED,
    Constants,
    Numbers,
    Out,
    Room,
    State,
)


def start(c: Constants, state: State) -> None:
    """Set the state before the first row: the prior in every slot."""
    n = c.n
    for slot in range(len(state.x) // n):
        state.x[slot * n : (slot + 1) * n] = c.x
        state.P[slot * n * n : (slot + 1) * n * n] = c.P
    state.mu[:] = c.mu
    state.held[:] = [0.0] * c.m
    state.started[0] = 0
    state.count[0] = 0


def weigh(c: Constants, state: State, w: Room, out: Out) -> None:
    """Set the probabilities, and the log-likelihood of the row; each mode is weighed against the one that fits best."""
    best = -1
    for j in range(c.modes):
        if w.predicted[j] > 0.0 and (best < 0 or w.fit[j] < w.fit[best]):
            best = j
    total = 0.0
    for j in range(c.modes):
        w.weight[j] = 0.0
        if w.predicted[j] > 0.0:
            w.weight[j] = w.predicted[j] * exp(c.powers, c.least, 0.5 * (w.fit[best] - w.fit[j]))
        total = total + w.weight[j]
    for j in range(c.modes):
        state.mu[j] = w.weight[j] / total
        w.weight[j] = state.mu[j]
    out.told[0] = log(c.powers, total) - 0.5 * w.fit[best]
    for i in range(c.p):
        if w.seen[i]:
            out.told[0] = out.told[0] - HALF_LOG_2PI


def judge(c: Constants, w: Room, out: Out) -> None:
    """Set the squared residual of the predicted mixture, in units of its covariance."""
    p = c.p
    for i in range(p):
        w.e[i] = 0.0
        for j in range(c.modes):
            w.e[i] = w.e[i] + w.predicted[j] * w.residual[j * p + i]
    for i in range(p):
        for b in range(i + 1):
            total = 0.0
            for j in range(c.modes):
                spread = (w.residual[j * p + i] - w.e[i]) * (w.residual[j * p + b] - w.e[b])
                total = total + w.predicted[j] * (w.S[(j * p + i) * p + b] + spread)
            w.L[i * p + b] = total
    eliminate(p, 0, w.L, w.e, w.W)
    out.told[1] = 0.0
    for i in range(p):
        out.told[1] = out.told[1] + w.e[i] * w.e[i] / w.L[i * p + i]


def hold(c: Constants, state: State, u: Numbers) -> None:
    """Keep the input of a row until the next; one that is no number leaves the last in place."""
    if is_within(c.largest, u, c.m):
        state.held[:] = u


def begin(c: Constants, state: State, w: Room, u: Numbers) -> None:
    """Set the input of the step that leads to a row with the input u, and keep u."""
    if not state.started[0]:
        hold(c, state, u)
        state.started[0] = 1
    w.before[:] = state.held
    hold(c, state, u)


def admit(c: Constants, state: State, beyond: bool) -> int:
    """Return what becomes of a row, `beyond` the gate or not, and count it.

    `OUTLIER`: it is left out; `READMITTED`: it is taken although it lies beyond, because the gate is open.
    """
    is_open = state.count[0] >= c.patience
    if beyond == is_open:
        state.count[0] = c.patience if is_open else 0
    else:
        state.count[0] = (state.count[0] + 1) % (2 * c.patience)
    if not beyond:
        return OK
    return READMITTED if is_open else OUTLIER


def measured_outputs(c: Constants, w: Room) -> int:
    """How many outputs of the row were measured; without a gate none needs to be counted."""
    count = 0
    if c.limits:
        for i in range(c.p):
            if w.seen[i]:
                count = count + 1
    return count


def imm(c: Constants, state: State, w: Room, out: Out, u: Numbers, z: Numbers) -> int:
    """Take one row: input u (m) and measurement z (p), of which what is no number counts as missing.

    Returns `OK`, `OUTLIER` or `READMITTED` as `admit` says, or `RESTARTED` where numbers ran away or a covariance was
    lost, and the filter starts from the prior.
    """
    mix(c, state, w)
    return bank(c, state, w, out, u, z)


def mmae(c: Constants, state: State, w: Room, out: Out, u: Numbers, z: Numbers) -> int:
    """Take one row, as `imm`, but every mode starts from its own Gaussian."""
    predict_mu(c, state, w)
    w.x[:] = state.x
    w.P[:] = state.P
    return bank(c, state, w, out, u, z)


def bank(c: Constants, state: State, w: Room, out: Out, u: Numbers, z: Numbers) -> int:
    """Take one row with the modes' Gaussians of `w`, whose probabilities are predicted."""
    begin(c, state, w, u)
    for j in range(c.modes):
        move(c, state, w, j, j)
        innovate(c, state, w, j, j, z)
        if not correct(c, state, w, j):
            return restart(c, state, out)
    verdict, count = OK, measured_outputs(c, w)
    if count > 0:
        beyond = True
        for j in range(c.modes):
            if w.predicted[j] > 0.0 and not w.distance[j] > c.limits[count]:
                beyond = False
        verdict = admit(c, state, beyond)
    if verdict == OUTLIER:
        for j in range(c.modes):
            move(c, state, w, j, j)
            leave_out(c, w, j)
    weigh(c, state, w, out)
    judge(c, w, out)
    blend(c, state, w, out.x, out.P, 0)
    return checked(c, state, out, verdict)


def known(c: Constants, state: State, w: Room, out: Out, u: Numbers, z: Numbers, mode: int) -> int:
    """Take one row of a known mode; as `imm`, and `INVALID` for a mode that does not exist, where nothing changes."""
    if mode < 0 or mode >= c.modes:
        tell(c, state, out)
        return INVALID
    w.x[:] = state.x
    w.P[:] = state.P
    begin(c, state, w, u)
    move(c, state, w, 0, mode)
    innovate(c, state, w, 0, mode, z)
    if not correct(c, state, w, 0):
        return restart(c, state, out)
    verdict, count = OK, measured_outputs(c, w)
    if count > 0:
        verdict = admit(c, state, w.distance[0] > c.limits[count])
    if verdict == OUTLIER:
        move(c, state, w, 0, mode)
        leave_out(c, w, 0)
        w.distance[0] = 0.0
    tell(c, state, out)
    out.told[0] = -0.5 * w.fit[0]
    out.told[1] = w.distance[0]
    for i in range(c.p):
        if w.seen[i]:
            out.told[0] = out.told[0] - HALF_LOG_2PI
    return checked(c, state, out, verdict)


def tell(c: Constants, state: State, out: Out) -> None:
    """Tell the Gaussian of the first slot, and nothing of the row."""
    out.x[:] = state.x[: c.n]
    out.P[:] = state.P[: c.n * c.n]
    out.told[:] = (0.0, 0.0)


def checked(c: Constants, state: State, out: Out, verdict: int) -> int:
    """Return the verdict; start again where what is told has run away."""
    if is_within(c.largest, out.x, c.n) and is_within(c.largest, out.P, c.n * c.n):
        return verdict
    return restart(c, state, out)


def restart(c: Constants, state: State, out: Out) -> int:
    """Return to the prior, and tell it."""
    start(c, state)
    tell(c, state, out)
    return RESTARTED


__all__ = ["imm", "known", "mmae", "start"]
