"""Matrices P for the contraction over a box of stays, by linear matrix inequalities with Clarabel.

In: flows of each location on a grid of stays.  Out: P_i >= S⁻² with EᵀP_jE <= γ² P_i on the grid, γ the least to 2 %
by bisection; None without Clarabel (extra `lmi`) or without a solution.  A semidefinite program of N n(n+1)/2 unknowns
for every γ that is tried.

Source: Boyd et al. (1994), Linear matrix inequalities in system and control theory.
"""

from collections.abc import Mapping
from importlib.util import find_spec
from math import sqrt

import numpy as np

from deshybrid.continuous.error import ErrorDynamics
from deshybrid.linear.arrays import FloatArray

LARGEST = 0.9999
MOST_FLOWS = 9
"""Stays of a location that enter the program, ends included."""
BISECTIONS = 8


def solve_inequalities(
    dynamics: ErrorDynamics, flows: Mapping[str, list[FloatArray]], scale: FloatArray
) -> Mapping[str, FloatArray] | None:
    """Return P by location for the least γ found, or None where there is no solver or no γ < 1."""
    if find_spec("clarabel") is None:
        return None
    low, high, best = 0.0, LARGEST, _solved(dynamics, flows, scale, LARGEST)
    for _ in range(BISECTIONS if best is not None else 0):
        middle = (low + high) / 2
        found = _solved(dynamics, flows, scale, middle)
        if found is None:
            low = middle
        else:
            high, best = middle, found
    return best


def _solved(
    dynamics: ErrorDynamics, flows: Mapping[str, list[FloatArray]], scale: FloatArray, gamma: float
) -> Mapping[str, FloatArray] | None:
    """One program in units of the states: least trace of P with P_i >= I."""
    import clarabel
    from scipy import sparse

    n, names = len(scale), dynamics.locations
    pairs = [(i, j) for j in range(n) for i in range(j + 1)]
    units = [_unit(n, i, j) for i, j in pairs]
    m = len(pairs)
    blocks = [
        (np.hstack([-_rows(units, pairs, None) * (k == i) for k in range(len(names))]), -np.eye(n))
        for i in range(len(names))
    ]
    for reset in dynamics.resets:
        chosen = flows[reset.source]
        for k in np.unique(np.linspace(0, len(chosen) - 1, MOST_FLOWS).round().astype(int)):
            E = reset.matrix @ chosen[k] * scale / scale[:, None]
            block = np.zeros((m, m * len(names)))
            i, j = names.index(reset.source), names.index(reset.target)
            block[:, i * m : (i + 1) * m] -= gamma**2 * _rows(units, pairs, None)
            block[:, j * m : (j + 1) * m] += _rows(units, pairs, E)
            blocks.append((block, np.zeros((n, n))))
    cost = np.tile([float(i == j) for i, j in pairs], len(names))
    settings = clarabel.DefaultSettings()
    settings.verbose = False
    empty = sparse.csc_matrix((len(cost), len(cost)))
    sides = np.concatenate([_vector(side, pairs) for _, side in blocks])
    matrix = sparse.csc_matrix(np.vstack([block for block, _ in blocks]))
    cones = [clarabel.PSDTriangleConeT(n)] * len(blocks)
    answer = clarabel.DefaultSolver(empty, cost, matrix, sides, cones, settings).solve()
    if str(answer.status) != "Solved":
        return None
    values = np.array(answer.x).reshape(len(names), m)
    solved = (sum(value * unit for value, unit in zip(row, units, strict=True)) for row in values)
    return {name: P / scale / scale[:, None] for name, P in zip(names, solved, strict=True)}


def _unit(n: int, i: int, j: int) -> FloatArray:
    unit = np.zeros((n, n))
    unit[i, j] = unit[j, i] = 1.0
    return unit


def _rows(units: list[FloatArray], pairs: list[tuple[int, int]], E: FloatArray | None) -> FloatArray:
    return np.array([_vector(unit if E is None else E.T @ unit @ E, pairs) for unit in units]).T


def _vector(matrix: FloatArray, pairs: list[tuple[int, int]]) -> FloatArray:
    """The upper triangle by columns, what is beside the diagonal times √2, as the solver's cone wants it."""
    return np.array([matrix[i, j] * (1.0 if i == j else sqrt(2)) for i, j in pairs])


__all__ = ["solve_inequalities"]
