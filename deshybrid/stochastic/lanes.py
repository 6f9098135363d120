"""Small matrices of many trials: products, factors and solutions without one call for each matrix.

In: matrices (..., i, k), whose leading axes are trials and modes.  Out: new arrays of the same kind.  Idea: trials lie
*last in memory*, whatever the axes are called, so that one operation on an entry of a matrix runs over all trials at
once; a matrix that the trials share multiplies all of them in one call.  Shapes stay those of the field: an array in
this order is a view with its trials in front (`trials_last`).  Element-wise operations of numpy keep the order.

O(i k j) for each product, O(p³) for each factor, in about as many calls as a matrix has columns.
Source: structure of arrays; the factor is Cholesky's, Golub and Van Loan (2013), algorithm 4.2.1.
"""

from math import prod

import numpy as np

from deshybrid.linear.arrays import FloatArray

_FEW = 16
"""So many matrices are multiplied one by one: fewer calls, and nothing to gain from their order in memory."""


def trials_last(array: FloatArray, core: int) -> FloatArray:
    """Return the array itself or a copy, whose axes before the last `core` ones are the closest in memory.

    >>> trials_last(np.zeros((100, 2, 3)), 2).strides
    (8, 2400, 800)
    """
    if array.ndim == core:
        return array
    return in_front(np.ascontiguousarray(behind(array, core)), core)


def behind(array: FloatArray, core: int) -> FloatArray:
    """Return a view with the axes before the last `core` ones moved behind them.

    >>> behind(np.zeros((100, 2, 3)), 2).shape
    (2, 3, 100)
    """
    lead = array.ndim - core
    return array.transpose((*range(lead, array.ndim), *range(lead)))


def in_front(array: FloatArray, core: int) -> FloatArray:
    """Return the inverse of `behind`.

    >>> in_front(np.zeros((2, 3, 100)), 2).shape
    (100, 2, 3)
    """
    return array.transpose((*range(core, array.ndim), *range(core)))


def product(A: FloatArray, B: FloatArray) -> FloatArray:
    """Return A B for A (..., i, k) and B (..., k, j); the one with fewer axes is shared by the trials of the other.

    >>> product(np.eye(2), np.ones((100, 2, 3))).shape
    (100, 2, 3)
    """
    if A.ndim < B.ndim:
        columns = behind(B, A.ndim)
        flat = columns.reshape(*columns.shape[: A.ndim - 1], prod(columns.shape[A.ndim - 1 :]))
        made = A @ flat
        return in_front(made.reshape(*made.shape[:-1], *columns.shape[A.ndim - 1 :]), A.ndim)
    if B.ndim < A.ndim:
        rows = behind(A, B.ndim)
        flat = rows.reshape(*rows.shape[: B.ndim], prod(rows.shape[B.ndim :]))
        made = B.swapaxes(-1, -2)[..., None, :, :] @ flat
        return in_front(made.reshape(*made.shape[:-1], *rows.shape[B.ndim :]), B.ndim)
    if A.shape[-1] == 0 or prod(B.shape[:-2]) <= _FEW:
        return A @ B
    total: FloatArray = A[..., :, 0, None] * B[..., 0, None, :]
    term = np.empty_like(total)
    for k in range(1, A.shape[-1]):
        total += np.multiply(A[..., :, k, None], B[..., k, None, :], out=term)
    return total


def times(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Return matrix (..., k, n) times vector (..., n); trials may share the matrix.

    >>> times(np.eye(2), np.array([1.0, 2.0])).tolist()
    [1.0, 2.0]
    """
    return product(matrix, vector[..., None])[..., 0]


def symmetric(matrix: FloatArray) -> FloatArray:
    """Return the symmetric part of (..., n, n).

    >>> symmetric(np.array([[1.0, 2.0], [0.0, 1.0]])).tolist()
    [[1.0, 1.0], [1.0, 1.0]]
    """
    part: FloatArray = matrix + matrix.swapaxes(-1, -2)
    part *= 0.5
    return part


def cholesky(S: FloatArray) -> FloatArray:
    """Return lower triangular L with L Lᵀ = S, from its lower half; NaN in L where S is not positive definite.

    >>> cholesky(np.array([[4.0, 2.0], [2.0, 5.0]])).tolist()
    [[2.0, 0.0], [1.0, 2.0]]
    """
    if S.shape[-1] > 1 and prod(S.shape[:-2]) <= _FEW:
        try:
            factor: FloatArray = np.asarray(np.linalg.cholesky(S), dtype=np.float64)
        except np.linalg.LinAlgError:
            pass  # some are not positive definite: below, one by one
        else:
            return factor
    L = np.zeros_like(S)  # in the order of S
    with np.errstate(invalid="ignore", divide="ignore"):
        for j in range(S.shape[-1]):
            column = S[..., j:, j]
            for k in range(j):
                column = column - L[..., j:, k] * L[..., j, None, k]
            L[..., j:, j] = column / np.sqrt(column[..., :1])
    return L


def solve_lower(L: FloatArray, B: FloatArray) -> FloatArray:
    """Return L⁻¹ B of a lower triangular L (..., p, p) and B (..., p, j).

    >>> solve_lower(np.array([[2.0, 0.0], [1.0, 2.0]]), np.array([[2.0], [3.0]])).tolist()
    [[1.0], [1.0]]
    """
    X = B.copy(order="K")
    for i in range(L.shape[-1]):
        for k in range(i):
            X[..., i, :] -= L[..., i, k, None] * X[..., k, :]
        X[..., i, :] /= L[..., i, i, None]
    return X


def solve_upper(L: FloatArray, B: FloatArray) -> FloatArray:
    """Return L⁻ᵀ B of a lower triangular L (..., p, p) and B (..., p, j).

    >>> solve_upper(np.array([[2.0, 0.0], [1.0, 2.0]]), np.array([[3.0], [2.0]])).tolist()
    [[1.0], [1.0]]
    """
    X = B.copy(order="K")
    size = L.shape[-1]
    for i in reversed(range(size)):
        for k in range(i + 1, size):
            X[..., i, :] -= L[..., k, i, None] * X[..., k, :]
        X[..., i, :] /= L[..., i, i, None]
    return X


__all__ = [
    "behind",
    "cholesky",
    "in_front",
    "product",
    "solve_lower",
    "solve_upper",
    "symmetric",
    "times",
    "trials_last",
]
