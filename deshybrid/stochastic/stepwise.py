"""The filters once more, number by number: the reference of generated code.

In: constants, a state and room to work in, all flat; numbers are `float` or `numpy.float32`.  Out: the state after a
measurement, and what is known then, written into `Out`.  Every sum runs from left to right, and nothing is used but
+ - * / and comparisons, so that C does the same operations in the same order and is equal bit for bit; therefore `exp`
and `log` are made here.  This file is part of generated Python, word for word.

Probabilities are plain numbers here, not logarithms: each is weighed against the best, so that the best is never lost,
and one that is smaller than about 1e-304 (in single precision 1e-35) times the best is zero.  It comes back by the
chain, as every mode that can be entered does.

O(M² n² + M n³) operations.  Source: Hwang et al. (2006), section 3; `deshybrid.stochastic.multiple`.
"""

from typing import Any, NamedTuple

Numbers = Any


class Constants(NamedTuple):
    """A system, its matrices flat: mode by mode, row by row.  `powers` are 2, 2², 2⁴, ... as far as they are finite."""

    modes: int
    n: int
    m: int
    p: int
    F: Numbers
    Q: Numbers
    B: Numbers
    f: Numbers
    H: Numbers
    R: Numbers
    D: Numbers
    g: Numbers
    measured: Numbers  # 1 where a mode measures an output, else 0
    probability_to_from: Numbers
    x: Numbers
    P: Numbers
    mu: Numbers
    powers: Numbers
    least: float  # below it exp is 0
    largest: float  # beyond it a number is no measurement, and an estimate starts again


class State(NamedTuple):
    """What a filter remembers.  A slot holds one Gaussian: one for each mode, or one alone where the mode is known."""

    x: Numbers  # (slots, n)
    P: Numbers  # (slots, n, n)
    mu: Numbers  # (modes)
    held: Numbers  # (m), the input since the last row
    started: Numbers  # (1), 1 after the first row


class Room(NamedTuple):
    """Where a step works; what it holds between two steps is of no meaning."""

    x: Numbers  # (slots, n)
    P: Numbers  # (slots, n, n)
    FP: Numbers  # (n, n)
    spread: Numbers  # (n)
    seen: Numbers  # (p), 1 where an output was measured
    residual: Numbers  # (slots, p)
    S: Numbers  # (slots, p, p)
    L: Numbers  # (p, p)
    W: Numbers  # (p, n)
    e: Numbers  # (p)
    fit: Numbers  # (slots), r S⁻¹ r + log det S
    weight: Numbers  # (modes)
    predicted: Numbers  # (modes)


class Out(NamedTuple):
    """Mean (n) and covariance (n, n) of the mixture; log-likelihood and squared residual (NIS) of the row."""

    x: Numbers
    P: Numbers
    told: Numbers  # (2)


OK, RESTARTED, INVALID = 0, 1, 2
LOG2_E, LN2_HIGH, LN2_LOW = 1.4426950408889634, 0.693359375, -2.1219444005469057e-4  # k LN2_HIGH is exact
ROOT_2, HALF_LOG_2PI = 1.4142135623730951, 0.9189385332046727
FACTORIALS = (6227020800, 479001600, 39916800, 3628800, 362880, 40320, 5040, 720, 120, 24, 6, 2, 1, 1)
EXP = tuple(1.0 / factorial for factorial in FACTORIALS)
LOG = tuple(1.0 / odd for odd in (21, 19, 17, 15, 13, 11, 9, 7, 5, 3, 1))


def exp(c: Constants, x: Any) -> Any:
    """Return e^x for x <= 0: a polynomial of the remainder of x / log 2, and as many halvings as its quotient.

    0 for x below the constant `least`; the relative error is below 1e-15 in double precision.
    """
    if not x > c.least:
        return 0.0
    halvings = int(0.5 - x * LOG2_E)
    k = 0.0 * x + halvings  # a number of the type of x
    r = (x + k * LN2_HIGH) + k * LN2_LOW
    y = EXP[0]
    for i in range(1, len(EXP)):
        y = y * r + EXP[i]
    for i in range(len(c.powers)):
        if (halvings >> i) & 1:
            y = y / c.powers[i]
    return y


def log(c: Constants, x: Any) -> Any:
    """Return the logarithm of x > 0: doublings or halvings until x is near 1, then 2 atanh((x - 1) / (x + 1))."""
    doublings = 0
    for i in range(len(c.powers) - 1, -1, -1):
        if x >= c.powers[i]:
            x = x / c.powers[i]
            doublings = doublings + (1 << i)
        elif x * c.powers[i] <= 1.0:
            x = x * c.powers[i]
            doublings = doublings - (1 << i)
    if x > ROOT_2:
        x = x / 2.0
        doublings = doublings + 1
    elif x * ROOT_2 < 1.0:
        x = x * 2.0
        doublings = doublings - 1
    s = (x - 1.0) / (x + 1.0)
    t = s * s
    y = LOG[0]
    for i in range(1, len(LOG)):
        y = y * t + LOG[i]
    k = 0.0 * x + doublings
    return k * LN2_HIGH + (k * LN2_LOW + 2.0 * s * y)


def start(c: Constants, state: State) -> None:
    """Set the state before the first row: the prior in every slot."""
    n = c.n
    for slot in range(len(state.x) // n):
        state.x[slot * n : (slot + 1) * n] = c.x
        state.P[slot * n * n : (slot + 1) * n * n] = c.P
    state.mu[:] = c.mu
    state.held[:] = [0.0] * c.m
    state.started[0] = 0


def mix(c: Constants, state: State, w: Room) -> None:
    """Predict the probabilities, and set the Gaussians from which every mode starts: `predicted`, x, P of `w`."""
    for j in range(c.modes):
        total = 0.0
        for i in range(c.modes):
            total = total + c.probability_to_from[j * c.modes + i] * state.mu[i]
        w.predicted[j] = total
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


def mirror(n: int, P: Numbers, square: int) -> None:
    """Copy the lower half of a matrix to its upper half."""
    for a in range(n):
        for b in range(a):
            P[square + b * n + a] = P[square + a * n + b]


def move(c: Constants, state: State, w: Room, slot: int, mode: int) -> None:
    """Carry Gaussian `slot` over one step of `mode`, with the input held since the last row, from `w` to the state."""
    n, m = c.n, c.m
    at, square, rows = slot * n, slot * n * n, mode * n
    for a in range(n):
        total = c.f[rows + a]
        for b in range(n):
            total = total + c.F[(rows + a) * n + b] * w.x[at + b]
        for b in range(m):
            total = total + c.B[(rows + a) * m + b] * state.held[b]
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


def eliminate(p: int, n: int, L: Numbers, e: Numbers, W: Numbers) -> bool:
    """Turn the lower half of S in `L` into L D Lᵀ, D on the diagonal, `e` (p) into L⁻¹ e, `W` (p, n) into L⁻¹ W.

    Returns whether S is positive definite; where it is not, nothing is of use.
    """
    for i in range(p):
        for j in range(i):
            total = L[i * p + j]
            for k in range(j):
                total = total - L[i * p + k] * L[k * p + k] * L[j * p + k]
            L[i * p + j] = total / L[j * p + j]
        for k in range(i):
            L[i * p + i] = L[i * p + i] - L[i * p + k] * L[k * p + k] * L[i * p + k]
            e[i] = e[i] - L[i * p + k] * e[k]
            for b in range(n):
                W[i * n + b] = W[i * n + b] - L[i * p + k] * W[k * n + b]
        if not L[i * p + i] > 0.0:
            return False
    return True


def correct(c: Constants, state: State, w: Room, slot: int) -> bool:
    """Update Gaussian `slot`, P - Σ w wᵀ / d over the rows of L⁻¹ W; False where S is not positive definite."""
    n, p = c.n, c.p
    at, square = slot * n, slot * n * n
    for i in range(p):
        w.L[i * p : i * p + i + 1] = w.S[(slot * p + i) * p : (slot * p + i) * p + i + 1]
    if not eliminate(p, n, w.L, w.e, w.W):
        return False
    w.fit[slot] = 0.0
    for i in range(p):
        d = w.L[i * p + i]
        scaled = w.e[i] / d
        w.fit[slot] = w.fit[slot] + (w.e[i] * scaled + log(c, d))
        for a in range(n):
            state.x[at + a] = state.x[at + a] + w.W[i * n + a] * scaled
            share = w.W[i * n + a] / d
            for b in range(a + 1):
                state.P[square + a * n + b] = state.P[square + a * n + b] - share * w.W[i * n + b]
    mirror(n, state.P, square)
    return True


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
            w.weight[j] = w.predicted[j] * exp(c, 0.5 * (w.fit[best] - w.fit[j]))
        total = total + w.weight[j]
    for j in range(c.modes):
        state.mu[j] = w.weight[j] / total
        w.weight[j] = state.mu[j]
    out.told[0] = log(c, total) - 0.5 * w.fit[best]
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


def is_within(c: Constants, numbers: Numbers, length: int) -> bool:
    """Whether all numbers are finite and not beyond `largest`."""
    return all(-c.largest <= numbers[i] and numbers[i] <= c.largest for i in range(length))


def hold(c: Constants, state: State, u: Numbers) -> None:
    """Keep the input of a row until the next; one that is no number leaves the last in place."""
    if is_within(c, u, c.m):
        state.held[:] = u


def imm(c: Constants, state: State, w: Room, out: Out, u: Numbers, z: Numbers) -> int:
    """Take one row: input u (m) and measurement z (p), of which what is no number counts as missing.

    Returns `OK`, or `RESTARTED` where numbers ran away or a covariance was lost, and the filter starts from the prior.
    """
    if not state.started[0]:
        hold(c, state, u)
        state.started[0] = 1
    mix(c, state, w)
    for j in range(c.modes):
        move(c, state, w, j, j)
    hold(c, state, u)
    for j in range(c.modes):
        innovate(c, state, w, j, j, z)
        if not correct(c, state, w, j):
            return restart(c, state, out)
    weigh(c, state, w, out)
    judge(c, w, out)
    blend(c, state, w, out.x, out.P, 0)
    return checked(c, state, out)


def known(c: Constants, state: State, w: Room, out: Out, u: Numbers, z: Numbers, mode: int) -> int:
    """Take one row of a known mode; as `imm`, and `INVALID` for a mode that does not exist, where nothing changes."""
    if mode < 0 or mode >= c.modes:
        tell(c, state, out)
        return INVALID
    if not state.started[0]:
        hold(c, state, u)
        state.started[0] = 1
    w.x[:] = state.x
    w.P[:] = state.P
    move(c, state, w, 0, mode)
    hold(c, state, u)
    innovate(c, state, w, 0, mode, z)
    if not correct(c, state, w, 0):
        return restart(c, state, out)
    tell(c, state, out)
    out.told[0] = -0.5 * w.fit[0]
    for i in range(c.p):
        if w.seen[i]:
            out.told[0] = out.told[0] - HALF_LOG_2PI
        out.told[1] = out.told[1] + w.e[i] * w.e[i] / w.L[i * c.p + i]
    return checked(c, state, out)


def tell(c: Constants, state: State, out: Out) -> None:
    """Tell the Gaussian of the first slot, and nothing of the row."""
    out.x[:] = state.x[: c.n]
    out.P[:] = state.P[: c.n * c.n]
    out.told[:] = (0.0, 0.0)


def checked(c: Constants, state: State, out: Out) -> int:
    """Start again where what is told has run away."""
    if is_within(c, out.x, c.n) and is_within(c, out.P, c.n * c.n):
        return OK
    return restart(c, state, out)


def restart(c: Constants, state: State, out: Out) -> int:
    """Return to the prior, and tell it."""
    start(c, state)
    tell(c, state, out)
    return RESTARTED


__all__ = ["INVALID", "OK", "RESTARTED", "Constants", "Out", "Room", "State", "exp", "imm", "known", "log", "start"]
