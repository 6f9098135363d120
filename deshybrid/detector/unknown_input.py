"""Residuals that an unknown disturbance cannot move: what is left to follow once it is decoupled.

In: a location, a step, the disturbances w_S to decouple.  Out: a `Followed`.  The idea: let E be the columns in which
w_S enters over a step, rank(C E) = rank(E) = s.  Then P = I - E (C E)⁺ C has P E = 0, and x = P x + E (C E)⁺ (y - D u -
g): the part of the state that w_S moves is read off the outputs.  So T x, with T a basis of P of n - s rows, moves
without w_S, driven by u and y; and the p - s combinations W y with W C E = 0 show it.  What these do not show is left
out, so that the order is the least that the decoupling permits.  A disturbance that is not constant over a step leaves
the small part that `thresholds` bounds.

The condition rank(C E) = rank(E) is asked of the continuous matrices: sampled ones meet it for every disturbance that
any output ever sees, by tiny numbers whose inverses are noise.

Cost: two singular value decompositions.  Source: Chen and Patton, Robust Model-Based Fault Diagnosis (1999), chapter 3
(unknown-input observers); Darouach et al. (1994).
"""

import numpy as np

from deshybrid.detector.residual import Followed, sampled_dynamics
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem

RANK = 1e-9
"""A singular value counts as zero below this share, for columns of length one and outputs of the size of their rows."""


def decouplable(dynamics: LinearDynamics, kept: tuple[int, ...] = ()) -> tuple[int, ...]:
    """Return the disturbances (numbers) each of which can be decoupled together with those `kept`.

    >>> z = np.zeros
    >>> decouplable(LinearDynamics(-np.eye(2), z((2, 0)), np.eye(2), z((2, 0)), np.eye(2), z(2), z(2)))
    (0, 1)
    """
    entering = (int(column) for column in np.flatnonzero((dynamics.C @ dynamics.E).any(axis=0)))
    return tuple(c for c in entering if c not in kept and not obstacle(dynamics, (*kept, c)))


def obstacle(dynamics: LinearDynamics, columns: tuple[int, ...]) -> str:
    """Return why these disturbances cannot be decoupled together, or the empty string.

    >>> z = np.zeros
    >>> tank = LinearDynamics(-np.eye(2), z((2, 0)), np.eye(2), z((2, 0)), np.eye(2), z(2), z(2))
    >>> obstacle(tank, (0,)), obstacle(tank, (0, 1))
    ('', 'rank(C E) = 2, and 2 outputs leave no residual')
    """
    E = dynamics.E[:, list(columns)]
    E = E[:, E.any(axis=0)]
    unit = E / np.linalg.norm(E, axis=0)
    rows = dynamics.C / np.where(dynamics.C.any(axis=1), np.linalg.norm(dynamics.C, axis=1), 1.0)[:, None]
    entering, seen = _rank(unit), _rank(rows @ unit)
    if seen < entering:
        return f"rank(C E) = {seen}, below rank(E) = {entering}"
    if seen >= len(dynamics.C):
        return f"rank(C E) = {seen}, and {len(dynamics.C)} outputs leave no residual"
    return ""


def decoupled(system: HybridSystem, followed: Followed, columns: tuple[int, ...]) -> Followed:
    """Return what is left to follow once these disturbances (numbers, one at least) are decoupled.

    Raises `UsageError` (DH0612) where they cannot be.
    """
    location, dynamics = followed.location, followed.dynamics
    reason = obstacle(dynamics, columns)
    if reason:
        names = ", ".join(f"`{system.disturbance_names[column]}`" for column in columns)
        text = f"location `{location.name}` cannot decouple {names}: {reason}"
        helps = ("name others under `decouple`, measure more, or take the design `h2`",)
        raise UsageError(diagnostic("DH0612", text, location.span, helps=helps))
    sampled = sampled_dynamics(system, dynamics, followed.step)
    entering = sampled.E[:, list(columns)]
    entering = entering[:, entering.any(axis=0)]
    read = entering @ np.linalg.pinv(dynamics.C @ entering)  # (n, p): what the outputs say of the part that w moves
    W, channels = _left_over(dynamics.C @ entering)
    T, back = _basis(np.eye(len(read)) - read @ dynamics.C)
    whole = followed._replace(
        A=T @ sampled.A @ back,
        B=T @ sampled.B,
        offset=T @ sampled.f,
        Y=T @ sampled.A @ read,
        C=W @ dynamics.C @ back,
        W=W,
        T=T,
        channels=channels,
    )
    return _observable(whole)


def _observable(followed: Followed) -> Followed:
    """The part that the residuals show."""
    from deshybrid.linear.observability import kalman_split

    k, step = len(followed.A), followed.step
    split = kalman_split((followed.A - np.eye(k)) / step, followed.C)
    seen, back = split.inverse[: split.observable_dimension], split.transform[:, : split.observable_dimension]
    return followed._replace(
        A=seen @ followed.A @ back,
        B=seen @ followed.B,
        offset=seen @ followed.offset,
        Y=seen @ followed.Y,
        C=followed.C @ back,
        T=seen @ followed.T,
    )


def _left_over(seen: FloatArray) -> tuple[FloatArray, tuple[int, ...]]:
    """W (q, p) with W seen = 0 and a one, alone in its column, in each row; and the columns of these ones."""
    from scipy.linalg import qr

    left, values, _ = np.linalg.svd(seen)
    rows = left[:, int(np.sum(values > RANK * values.max(initial=0.0))) :].T
    pivots = qr(rows, mode="r", pivoting=True)[1][: len(rows)]
    channels = tuple(sorted(int(column) for column in pivots))
    return np.linalg.solve(rows[:, list(channels)], rows), channels


def _basis(projector: FloatArray) -> tuple[FloatArray, FloatArray]:
    """T (k, n) and back (n, k) with projector = back T and T back = 1."""
    _, values, right = np.linalg.svd(projector)
    k = int(np.sum(values > RANK * values.max(initial=0.0)))
    T = right[:k]
    return T, projector @ T.T


def _rank(matrix: FloatArray) -> int:
    return int(np.linalg.matrix_rank(matrix, tol=RANK)) if matrix.size else 0


__all__ = ["decouplable", "decoupled", "obstacle"]
