"""Matrix inequalities that are linear in unknown symmetric matrices, solved by Clarabel.

In: symmetric unknowns X_k (n, n) and inequalities Σ_k L_k(X_k) > 0, each L_k a sum of maps X ↦ Mᵀ X M and X ↦ Mᵀ X +
X M.  Out: unknowns for which the least eigenvalue of all inequalities together is as large as it can be, at a fixed sum
of traces of the first unknowns; negative where no unknowns satisfy all.  The idea: this always has a solution, so the
solver never has to prove that there is none.  The answer is a proposal: whoever uses it checks it.

N = n (n + 1)/2 numbers for each unknown, one cone of N rows for each inequality, a few dozen steps of O((rows)^3) at
worst.  Source: Goulart and Chen (2024), "Clarabel: an interior-point solver for conic programs with quadratic
objectives".
"""

from collections.abc import Sequence
from functools import lru_cache
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray

if TYPE_CHECKING:
    import clarabel
    from scipy.sparse import csc_matrix

DENSE_FROM = 40
"""From this many numbers in an unknown, the factorisation by dense blocks is the faster one."""


class Term(NamedTuple):
    """One unknown of an inequality with its linear map, (N, N) in packed form."""

    unknown: int
    map: FloatArray


class Solution(NamedTuple):
    """The unknowns and the least eigenvalue that the solver states; `margin` is -inf where it gave up."""

    unknowns: tuple[FloatArray, ...]
    margin: float


def has_solver() -> bool:
    """Return whether Clarabel is installed (extra `lmi`)."""
    from importlib.util import find_spec

    return find_spec("clarabel") is not None


def congruence(matrix: FloatArray) -> FloatArray:
    """Return X ↦ Mᵀ X M in packed form.

    >>> congruence(np.array([[3.0]]))
    array([[9.]])
    """
    unpack = unpacking(len(matrix))
    return np.asarray(unpack.T @ np.kron(matrix.T, matrix.T) @ unpack)


def drift(matrix: FloatArray) -> FloatArray:
    """Return X ↦ Mᵀ X + X M in packed form.

    >>> drift(np.array([[3.0]]))
    array([[6.]])
    """
    unpack, one = unpacking(len(matrix)), np.eye(len(matrix))
    return np.asarray(unpack.T @ (np.kron(matrix.T, one) + np.kron(one, matrix.T)) @ unpack)


def identity(size: int) -> FloatArray:
    """Return X ↦ X in packed form."""
    return np.eye(size * (size + 1) // 2)


def solve(size: int, count: int, inequalities: Sequence[Sequence[Term]], *, normalised: int) -> Solution:
    """Return `count` unknowns (size, size) with the largest common margin: every inequality >= margin · I.

    The first `normalised` unknowns have traces that sum to `normalised` · size.  Raises `UsageError` (DH0518) without
    the solver.

    >>> found = solve(1, 1, [[Term(0, np.eye(1))], [Term(0, np.eye(1) * 3)]], normalised=1)
    >>> round(found.margin, 6), round(float(found.unknowns[0][0, 0]), 6)
    (1.0, 1.0)
    """
    require_solver()
    import clarabel
    from scipy.sparse import csc_matrix

    packed = size * (size + 1) // 2
    columns = count * packed + 1
    cost = np.zeros(columns)
    cost[-1] = -1.0
    matrix, right = _rows(size, inequalities, columns, normalised)
    cones = [clarabel.ZeroConeT(1), *(clarabel.PSDTriangleConeT(size) for _ in inequalities)]
    solver = clarabel.DefaultSolver(csc_matrix((columns, columns)), cost, matrix, right, cones, settings(packed))
    found = solver.solve()
    values = np.asarray(found.x)
    unpack = unpacking(size)
    unknowns = tuple((unpack @ part).reshape(size, size) for part in values[:-1].reshape(count, packed))
    solved = str(found.status) in ("Solved", "AlmostSolved") and bool(np.isfinite(values).all())
    return Solution(unknowns, float(values[-1]) if solved else -np.inf)


def require_solver() -> None:
    """Raise `UsageError` (DH0518) where Clarabel is not installed."""
    if not has_solver():
        message = "certificates by matrix inequalities need the solver Clarabel"
        raise UsageError(diagnostic("DH0518", message, helps=("install the extra: `pip install deshybrid[lmi]`",)))


def settings(packed: int) -> "clarabel.DefaultSettings":
    """Return how the solver is run, for unknowns of `packed` numbers: silently, and always the same."""
    import clarabel

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    settings.max_iter = 80
    settings.max_threads = 1
    settings.direct_solve_method = "faer" if packed >= DENSE_FROM else "qdldl"
    return settings


def _rows(
    size: int, inequalities: Sequence[Sequence[Term]], columns: int, normalised: int
) -> "tuple[csc_matrix, FloatArray]":
    """The sparse matrix A and vector b of A x + s = b, s in the cones; the last column is the margin."""
    from scipy.sparse import coo_matrix, csc_matrix

    one = unpacking(size).T @ np.eye(size).ravel()
    packed, places = len(one), np.flatnonzero(one)
    rows, where, values = [], [], []
    for k in range(normalised):
        rows.append(np.zeros(size, dtype=int))
        where.append(places + k * packed)
        values.append(one[places])
    for number, terms in enumerate(inequalities):
        start = 1 + number * packed
        for term in terms:
            row, column = np.nonzero(term.map)
            rows.append(row + start)
            where.append(column + term.unknown * packed)
            values.append(-term.map[row, column])
        rows.append(places + start)
        where.append(np.full(size, columns - 1))
        values.append(one[places])
    height = 1 + len(inequalities) * packed
    entries = np.concatenate(values), (np.concatenate(rows), np.concatenate(where))
    right = np.zeros(height)
    right[0] = normalised * size
    return csc_matrix(coo_matrix(entries, shape=(height, columns))), right


@lru_cache(maxsize=32)
def unpacking(size: int) -> FloatArray:
    """From the packed upper triangle by columns, off-diagonal entries times √2, to all entries of the matrix."""
    matrix = np.zeros((size * size, size * (size + 1) // 2))
    place = 0
    for j in range(size):
        for i in range(j + 1):
            for entry in {i * size + j, j * size + i}:
                matrix[entry, place] = 1.0 if i == j else np.sqrt(0.5)
            place += 1
    return matrix


__all__ = [
    "Solution",
    "Term",
    "congruence",
    "drift",
    "has_solver",
    "identity",
    "require_solver",
    "settings",
    "solve",
    "unpacking",
]
