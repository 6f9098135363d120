"""Means of the residual and of the error of a Kalman filter whose mode is not the true one.

In: the steady-state filter of a mode i, with its filter gain K, and the true mode T.  Out: the recursions' matrices

    r̄(k) = H_T F_T ē(k-1) + Hx x̂(k-1) + Hu u(k-1) + Hd u(k) + Hc
    ē(k) = (I - K H_T) F_T ē(k-1) + Gx x̂(k-1) + Gu u(k-1) + Gd u(k) + Gc,      ē = mean of x - x̂_i

their steady state, and the equalities under which it vanishes, so that the means never tell i from T.

With ΔA = F_T - F_i and so on, Hx = H_T F_T - H_i F_i is the paper's C_T ΔA + ΔC A_T - ΔC ΔA, and Gx = ΔA - K Hx its
(I - K C_T) ΔA - K ΔC A_i; what acts on inputs is the same with B.  The paper's inputs u_i that differ between modes
are offsets f and g here, which give Hc and Gc: they vanish where its Δu does.  The recursions are right as printed; x̂_k
in the one of the error is a misprint for x̂_i.  The steady state takes no inverse Θ = (I - (I - K H_T) F_T)⁻¹, which may
be missing: written in x in place of x̂, the error obeys the filter's own stable matrix, whatever the true mode.  The
equalities are sufficient for a mean of zero and not necessary, and residuals of mean zero may still tell by their
covariance (`telling_apart`).

O(n³) for each pair.  Source: Hwang, Balakrishnan and Tomlin (2006), section 4.1, (16), (26), (27).
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.observability import ROUNDING
from deshybrid.stochastic.steady_state import SteadyFilter
from deshybrid.stochastic.system import Mode

SETTLED = 1.0 - 1e-9
"""A plant whose spectral radius is below this comes to rest."""


@dataclass(frozen=True, slots=True, eq=False)
class Mismatch:
    """The matrices of the recursions for the filter of mode `own` while `true` is the true mode.

    error (n, n) = (I - K H_T) F_T; seen (p, n) = H_T F_T; G* act on the error (n, ·), H* on the residual (p, ·): x on
    the estimate, u on the input of the step, d on the input of the row, c is constant.
    """

    own: SteadyFilter
    true: Mode
    error: FloatArray
    seen: FloatArray
    Gx: FloatArray
    Gu: FloatArray
    Gd: FloatArray
    Gc: FloatArray
    Hx: FloatArray
    Hu: FloatArray
    Hd: FloatArray
    Hc: FloatArray


@dataclass(frozen=True, slots=True)
class Equality:
    """One of the equalities under which the steady-state mean of the residual is zero; `size`: its largest entry."""

    name: str
    holds: bool
    size: float


def mismatch(own: SteadyFilter, true: Mode) -> Mismatch:
    """Return the matrices of the recursions.

    >>> from deshybrid.stochastic.steady_state import steady_state
    >>> slow, fast = (Mode("m", F=[[F]], H=[[1.0]], Q=[[1.0]], R=[[1.0]]) for F in (0.5, 0.9))
    >>> mismatch(steady_state(slow).filter, fast).Hx.round(9).tolist()
    [[0.4]]
    """
    mode, K = own.mode, own.filter_gain
    Hx, Hu = true.H @ true.F - mode.H @ mode.F, true.H @ true.B - mode.H @ mode.B
    Hd, Hc = true.D - mode.D, true.H @ true.f + true.g - mode.H @ mode.f - mode.g
    return Mismatch(
        own=own,
        true=true,
        error=true.F - K @ true.H @ true.F,
        seen=true.H @ true.F,
        Gx=true.F - mode.F - K @ Hx,
        Gu=true.B - mode.B - K @ Hu,
        Gd=-K @ Hd,
        Gc=true.f - mode.f - K @ Hc,
        Hx=Hx,
        Hu=Hu,
        Hd=Hd,
        Hc=Hc,
    )


def mean_recursion(
    pair: Mismatch, x: FloatArray, error: FloatArray, rows: int, u: FloatArray | None = None
) -> tuple[FloatArray, FloatArray]:
    """Return the means of the residual (rows, p) and of the error (rows, n) of the rows after the one given.

    x (n,): the mean estimate at that row, error (n,) that of its error; u (rows + 1, m): the inputs from that row on.

    >>> from deshybrid.stochastic.steady_state import steady_state
    >>> slow, fast = (Mode("m", F=[[F]], H=[[1.0]], Q=[[1.0]], R=[[1.0]]) for F in (0.5, 0.9))
    >>> pair = mismatch(steady_state(slow).filter, fast)
    >>> mean_recursion(pair, np.array([1.0]), np.array([0.0]), 1)[0].round(9).tolist()
    [[0.4]]
    """
    mode, K = pair.own.mode, pair.own.filter_gain
    held = np.zeros((rows + 1, mode.B.shape[1])) if u is None else u
    residuals, errors = [], []
    for k in range(rows):
        before, now = held[k], held[k + 1]
        residual = pair.seen @ error + pair.Hx @ x + pair.Hu @ before + pair.Hd @ now + pair.Hc
        error = pair.error @ error + pair.Gx @ x + pair.Gu @ before + pair.Gd @ now + pair.Gc
        x = mode.F @ x + mode.B @ before + mode.f + K @ residual
        residuals.append(residual)
        errors.append(error)
    return np.array(residuals), np.array(errors)


def steady_residual(pair: Mismatch, u: FloatArray | None = None) -> FloatArray | None:
    """Return the steady-state mean of the residual (p,) under a constant input u (m,), None where there is none.

    The estimate that it depends on settles with the plant, x = F_T x + B_T u + f_T; where Gx and Hx vanish it does not
    matter that the plant goes on moving.

    >>> from deshybrid.stochastic.steady_state import steady_state
    >>> still, pushed = (Mode("m", F=[[0.5]], H=[[1.0]], Q=[[1.0]], R=[[1.0]], f=[f]) for f in (0.0, 1.0))
    >>> own = steady_state(still).filter
    >>> round(float(steady_residual(mismatch(own, pushed))[0] * (1 - float(own.filter_error[0, 0]))), 9)
    1.0
    """
    true, identity = pair.true, np.eye(len(pair.Gc))
    held = np.zeros(true.B.shape[1]) if u is None else u
    rest: FloatArray = np.zeros(len(identity))
    if not (_vanishes(pair.Gx, true.F) and _vanishes(pair.Hx, pair.seen)):
        if float(np.abs(np.linalg.eigvals(true.F)).max(initial=0.0)) >= SETTLED:
            return None
        rest = np.asarray(np.linalg.solve(identity - true.F, true.B @ held + true.f), dtype=np.float64)
    # With x̂ = x - ē the error obeys the filter's own matrix, error - Gx = (I - K H_i) F_i, which is stable.
    constant = pair.Gx @ rest + pair.Gu @ held + pair.Gd @ held + pair.Gc
    error = np.linalg.solve(identity - pair.own.filter_error, constant)
    seen = pair.seen @ error + pair.Hx @ (rest - error)
    residual: FloatArray = seen + pair.Hu @ held + pair.Hd @ held + pair.Hc
    return residual


def equalities(pair: Mismatch) -> tuple[Equality, ...]:
    """Return the paper's list: where all hold, the means of the residual never tell the mode from the true one.

    Sizes count as zero up to rounding, in units of the terms that cancel.

    >>> from deshybrid.stochastic.steady_state import steady_state
    >>> still, pushed = (Mode("m", F=[[0.5]], H=[[1.0]], Q=[[1.0]], R=[[1.0]], f=[f]) for f in (0.0, 1.0))
    >>> [(e.name, e.holds) for e in equalities(mismatch(steady_state(still).filter, pushed))][-2:]
    [('C_T ΔB + ΔC B_T - ΔC ΔB = 0', True), ('Δu = 0', False)]
    """
    true, own = pair.true, pair.own.mode
    inputs_on_error = np.hstack([pair.Gu, pair.Gd])
    inputs_on_residual = np.hstack([pair.Hu, pair.Hd])
    listed = (
        ("(I - K C_T) ΔA - K ΔC A_i = 0", pair.Gx, (true.F, own.F)),
        ("C_T ΔA + ΔC A_T - ΔC ΔA = 0", pair.Hx, (pair.seen, own.H @ own.F)),
        ("(I - K C_T) ΔB - K ΔC B_i = 0", inputs_on_error, (true.B, own.B)),
        ("C_T ΔB + ΔC B_T - ΔC ΔB = 0", inputs_on_residual, (true.D, own.D, true.H @ true.B, own.H @ own.B)),
        ("Δu = 0", np.concatenate([pair.Gc, pair.Hc]), (true.f, own.f, true.g, own.g)),
    )
    return tuple(Equality(name, _vanishes(value, *terms), _size(value)) for name, value, terms in listed)


def _size(value: FloatArray) -> float:
    return float(np.abs(value).max(initial=0.0))


def _vanishes(value: FloatArray, *terms: FloatArray) -> bool:
    return _size(value) <= ROUNDING * max(map(_size, terms))


__all__ = ["Equality", "Mismatch", "equalities", "mean_recursion", "mismatch", "steady_residual"]
