"""Pole placement for one location: G such that A - G C has the wanted eigenvalues.

In: A (n, n), C (p, n) and poles (rad/s, or in the z-plane for a system in discrete time).  Out: G (n, p).  The idea:
place on a scaled realisation, so that a torsion of 0.1 rad and a speed of 100 rad/s weigh alike when the eigenvectors
are chosen as orthogonal as they can be; redundant outputs are compressed first.  A pole repeated more often than
rank(C) has no diagonalisable closed loop: it is spread by 1 % a copy.  O(n^3) an iteration.

Source: Kautsky, Nichols and van Dooren (1985) and Tits and Yang (1996), by `scipy.signal.place_poles`, on the dual
pair.
"""

import warnings
from collections.abc import Iterable

import numpy as np

from deshybrid.diagnostics import GainError, diagnostic
from deshybrid.linear.arrays import ComplexArray, FloatArray, frozen_array
from deshybrid.linear.observability import KalmanSplit, kalman_split
from deshybrid.linear.subspaces import RANK_TOLERANCE, balanced_scale

SPREAD = 0.01
SAME = 1e-6
"""Poles closer than this share of their size are the same pole."""


def place_gain(
    A: FloatArray, C: FloatArray, poles: Iterable[complex], *, scale: FloatArray | None = None
) -> FloatArray:
    """Return G, shape (n, p), such that A - G C has the given eigenvalues; `scale` (n,): typical sizes of the states.

    Raises `GainError`: DH0509 if (A, C) is not observable, DH0505 if the poles are not n in number or not closed under
    conjugation.

    >>> A, C = np.array([[0.0, 1], [0, 0]]), np.array([[1.0, 0]])
    >>> place_gain(A, C, (-1, -2)).ravel().round(9).tolist()
    [3.0, 2.0]
    """
    wanted = np.array(list(poles), dtype=np.complex128)
    split = kalman_split(A, C)
    if split.observable_dimension < len(A):
        raise GainError(diagnostic("DH0509", "the pair (A, C) is not observable, so not every pole can be placed"))
    problem = pole_problem(wanted, len(A))
    if problem:
        raise GainError(diagnostic("DH0505", problem))
    size = balanced_scale(A, np.zeros((len(A), 0)), C) if scale is None else scale
    return frozen_array(_placed(A, C, wanted, size), (len(A), len(C)))


def place_detectable(split: KalmanSplit, poles: ComplexArray, scale: FloatArray) -> FloatArray:
    """Return a gain that places the observable part only; the fixed modes stay, decoupled as far as they can be."""
    k = split.observable_dimension
    if k == 0:
        return np.zeros((len(scale), len(split.C_o)))
    inside = np.linalg.norm(split.inverse[:k] * scale, axis=1)
    upper = _placed(split.A_o, split.C_o, poles, inside)
    return np.asarray(split.transform @ np.vstack([upper, decoupling_gain(split)]))


def decoupling_gain(split: KalmanSplit) -> FloatArray:
    """Return the gain of the unobservable part that decouples it best from the observable one, shape (n - k, p).

    The least-squares solution of coupling = G_u C_o, which keeps the eigenvectors of the closed loop apart.
    """
    return np.asarray(np.linalg.lstsq(split.C_o.T, split.coupling.T, rcond=RANK_TOLERANCE)[0].T)


def pole_problem(poles: ComplexArray, count: int) -> str:
    """Return what is wrong with a list of poles, or the empty string."""
    if len(poles) != count:
        return f"{len(poles)} poles given, {count} needed"
    if not np.isfinite(poles).all():
        return "a pole is not finite"
    rest = list(poles)
    for pole in poles:
        partner = min(rest, key=lambda other: abs(other - pole.conjugate()), default=None)
        if partner is None or abs(partner - pole.conjugate()) > SAME * max(abs(pole), SAME):
            return f"complex poles must come in conjugate pairs, {pole:.6g} has no partner"
        rest.remove(partner)
    return ""


def placeable(poles: ComplexArray, fixed: ComplexArray) -> ComplexArray:
    """Return the poles left when every fixed mode has taken the place of the one nearest to it (a pair of a pair).

    Poles and fixed modes are closed under conjugation.

    >>> placeable(np.array([-3 + 0j, -4]), np.array([-4.1 + 0j]))
    array([-3.+0.j])
    """
    rest = list(poles)
    for mode in fixed:
        alike = [pole for pole in rest if (pole.imag == 0) == (mode.imag == 0)]
        rest.remove(min(alike or rest, key=lambda pole: abs(pole - mode)))
    return np.array(rest, dtype=np.complex128)


def spread_poles(poles: ComplexArray, rank: int) -> tuple[ComplexArray, bool]:
    """Move apart the copies of a pole beyond the first `rank`; return the poles and whether any moved.

    Copy number c of a pole is multiplied by 1 + 0.01 floor(c / rank); a conjugate pair moves together.

    >>> spread_poles(np.array([-2.0 + 0j, -2.0]), 1)
    (array([-2.  +0.j, -2.02+0.j]), True)
    """
    moved, changed = [], False
    for position, pole in enumerate(poles):
        before = sum(abs(other - pole) <= SAME * abs(pole) for other in poles[:position])
        changed = changed or bool(before >= rank)
        moved.append(pole * (1 + SPREAD * (before // max(rank, 1))))
    return np.array(moved, dtype=np.complex128), changed


def output_rank(C: FloatArray, scale: FloatArray) -> int:
    """Return rank(C) in units of the states' sizes: as often can one pole be repeated."""
    return len(_compressed(C * scale)[1])


def _compressed(C: FloatArray) -> tuple[FloatArray, FloatArray]:
    """C = left @ rows with independent, orthogonal rows of unit length; outputs of different size count alike."""
    lengths = np.linalg.norm(C, axis=1)
    lengths[lengths == 0] = 1.0
    left, values, right = np.linalg.svd(C / lengths[:, None], full_matrices=False)
    rank = int(np.sum(values > RANK_TOLERANCE * max(1.0, float(values.max(initial=0.0)))))
    inverse = (left[:, :rank] / values[:rank]).T / lengths
    return inverse, right[:rank]


def _placed(A: FloatArray, C: FloatArray, poles: ComplexArray, scale: FloatArray) -> FloatArray:
    from scipy.signal import place_poles

    inverse, rows = _compressed(C * scale)
    wanted, _ = spread_poles(poles, len(rows))
    with warnings.catch_warnings():
        # It warns when the eigenvectors could be made a little more orthogonal; the poles are placed all the same.
        warnings.simplefilter("ignore", UserWarning)
        try:
            found = place_poles((A * scale / scale[:, None]).T, rows.T, wanted)
        except ValueError as error:
            message = "these poles lie too close together to be placed in floating point"
            raise GainError(diagnostic("DH0505", message, helps=("write fewer fast poles, further apart",))) from error
    return np.asarray(scale[:, None] * found.gain_matrix.T @ inverse)


__all__ = [
    "SPREAD",
    "decoupling_gain",
    "output_rank",
    "place_detectable",
    "place_gain",
    "placeable",
    "pole_problem",
    "spread_poles",
]
