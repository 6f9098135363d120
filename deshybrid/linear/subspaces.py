"""Invariant subspaces of a linear system: which states no output ever shows, and which an input can hide.

In: matrices A (n, n), B (n, m), C (p, n), D (p, m).  Out: a diagonal scaling of the state and an orthonormal basis in
the scaled coordinates z, x = diag(scale) z.  The idea: before any rank is decided, the state is balanced, time is
measured in units of 1/‖A‖ and every output row and input column has length one, so that a singular value below
`RANK_TOLERANCE` means "zero up to rounding" whatever the units of the model.  The nested sequence V_0 = R^n,
V_{k+1} = {v : some u gives A v + B u in V_k and C v + D u = 0} ends after at most n steps, each one singular value
decomposition: O(n^4).

Source: Wonham, Linear Multivariable Control, section 4.3 (output-nulling subspaces).
"""

from typing import NamedTuple

import numpy as np

from deshybrid.linear.arrays import FloatArray

RANK_TOLERANCE = 1e-10
"""A singular value counts as zero below this share of the largest one of the scaled matrices."""


class ScaledSystem(NamedTuple):
    """A system in balanced coordinates x = diag(scale) z, with norms near one; `speed` (1/s) is the unit of A."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    scale: FloatArray
    speed: float


def balanced_scale(A: FloatArray, B: FloatArray, C: FloatArray) -> FloatArray:
    """Return the state scaling (powers of two) that brings the rows and columns of [A B; C 0] to like size.

    Shapes: A (n, n), B (n, m), C (p, n) to (n,); x = diag(scale) z.

    >>> scale = balanced_scale(np.array([[-1.0, 1e6], [1e-6, -1.0]]), np.zeros((2, 0)), np.zeros((0, 2)))
    >>> bool(scale[0] > 100 * scale[1])
    True
    """
    n, m, p = A.shape[0], B.shape[1], C.shape[0]
    graph = np.zeros((n + m + p, n + m + p))
    graph[:n, :n], graph[:n, n : n + m], graph[n + m :, :n] = A, B, C
    return balanced(graph)[1][:n]


def balanced(matrix: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return diag(scale)⁻¹ matrix diag(scale) with rows and columns of like size, and the scale (powers of two).

    >>> balanced(np.array([[-1.0, 16.0], [1.0, -1.0]]))[1].tolist()
    [4.0, 1.0]
    """
    from scipy.linalg import matrix_balance

    with np.errstate(invalid="ignore"):  # it also turns the scale into a permutation, which nobody asked for
        found, (scale, _) = matrix_balance(matrix, permute=False, separate=True)
    return np.asarray(found), np.asarray(scale, dtype=np.float64)


def scaled_system(A: FloatArray, B: FloatArray, C: FloatArray, D: FloatArray) -> ScaledSystem:
    """Return the system balanced, in its own unit of time, with output rows and input columns of length one."""
    scale = balanced_scale(A, B, C)
    A, B, C = A * scale / scale[:, None], B / scale[:, None], C * scale
    speed = float(np.linalg.norm(A, 2)) if A.size else 0.0
    speed = speed or 1.0
    A, B = A / speed, B / speed
    columns = np.linalg.norm(np.vstack([B, D]), axis=0)
    columns[columns == 0] = 1.0
    B, D = B / columns, D / columns
    rows = np.linalg.norm(np.hstack([C, D]), axis=1)
    rows[rows == 0] = 1.0
    return ScaledSystem(A, B, C / rows[:, None], D / rows[:, None], scale, speed)


def null_space(matrix: FloatArray) -> FloatArray:
    """Return an orthonormal basis (columns) of the null space of a matrix whose natural size is one.

    >>> null_space(np.array([[1.0, 0.0]])).shape
    (2, 1)
    """
    if matrix.shape[0] == 0:
        return np.eye(matrix.shape[1])
    _, values, right = np.linalg.svd(matrix)
    limit = RANK_TOLERANCE * max(1.0, float(values.max(initial=0.0)))
    return np.asarray(right[int(np.sum(values > limit)) :].T)


def column_space(matrix: FloatArray) -> FloatArray:
    """Return an orthonormal basis (columns) of the span of the columns; their natural size is one."""
    if matrix.size == 0:
        return np.zeros((matrix.shape[0], 0))
    left, values, _ = np.linalg.svd(matrix, full_matrices=False)
    return np.asarray(left[:, values > RANK_TOLERANCE * max(1.0, float(values.max(initial=0.0)))])


def output_nulling(system: ScaledSystem) -> FloatArray:
    """Return a basis of the states from which *some* input keeps the output at zero for ever.

    Columns are orthonormal in the scaled coordinates; with no input these are the unobservable states.

    >>> chain = scaled_system(np.array([[0.0, 1], [0, 0]]), np.zeros((2, 0)), np.array([[0.0, 1]]), np.zeros((1, 0)))
    >>> output_nulling(chain).shape
    (2, 1)
    """
    n = system.A.shape[0]
    basis = np.eye(n)
    while True:
        outside = np.eye(n) - basis @ basis.T
        step = np.block([[outside @ system.A, outside @ system.B], [system.C, system.D]])
        smaller = column_space(null_space(step)[:n])
        if smaller.shape[1] >= basis.shape[1]:
            return basis
        basis = smaller


__all__ = [
    "RANK_TOLERANCE",
    "ScaledSystem",
    "balanced",
    "balanced_scale",
    "column_space",
    "null_space",
    "output_nulling",
    "scaled_system",
]
