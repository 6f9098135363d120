"""A first set around the entry errors where a certificate by forms holds: one ellipsoid for each location.

In: quadratic forms P_i, Q_i that decrease from entry to entry (`continuous/forms.py`), what each stay and exit adds.
Out: the level γ of ζᵀ P_i ζ <= γ² that no entry error exceeds once it started from zero, as bounds along rows.  The
idea: one stay and one exit multiply ‖ζ‖_P by at most ρ, with

    ρ² = max_i λ_max(e^{F_iᵀ β_i} Q_i e^{F_i β_i}, P_i) · max_ij λ_max(R¹_ijᵀ P_j R¹_ij, Q_i) < 1

for all stays of at least β_i, since Q_i decreases along the flow; and they add at most the size κ of what the
disturbance and the exit add, hence γ = κ/(1 - ρ).  O(m n³).

Source: this project; the forms are those of Geromel and Colaneri (2006).
"""

from collections.abc import Mapping

import numpy as np

from deshybrid.continuous.entrywise import Stay
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.reach import Levels
from deshybrid.linear.arrays import FloatArray

ROUNDING = 1e-6
"""Relative amount by which ρ² and the level are raised above their computed values."""


def entry_ellipsoids(
    dynamics: ErrorDynamics,
    P: Mapping[str, FloatArray],
    Q: Mapping[str, FloatArray],
    stays: Mapping[str, Stay],
    beta: Mapping[str, float],
) -> Mapping[str, Levels] | None:
    """Return bounds of the entry errors along rows, by location; None where the forms do not decrease by ρ < 1.

    `beta`: the shortest stay (s) of each location.

    >>> from deshybrid.continuous.error import ErrorReset
    >>> from deshybrid.continuous.mismatch import in_time
    >>> from deshybrid.continuous.modes import modal_basis
    >>> one = np.eye(1)
    >>> dynamics = ErrorDynamics(("p",), {"p": -one}, (ErrorReset("p", "p", one, np.zeros(1)),))
    >>> stay = Stay(np.ones(1), modal_basis(-one, np.ones(1)), (in_time("p", one),))
    >>> levels = entry_ellipsoids(dynamics, {"p": one}, {"p": one}, {"p": stay}, {"p": 1.0})
    >>> levels["p"](one).round(3).tolist()  # 1/(1 - e⁻¹)
    [1.582]
    """
    kept = max(_ratio(_over(dynamics, name, beta[name]), Q[name], P[name]) for name in dynamics.locations)
    passed = max((_ratio(r.matrix, P[r.target], Q[r.source]) for r in dynamics.resets), default=0.0)
    rho = float(np.sqrt(kept * passed * (1 + ROUNDING)))
    if not rho < 1:
        return None
    added = [
        size_in_form(np.abs(exit.reset) @ stay.forced + exit.most()[0], P[exit.target])
        for stay in stays.values()
        for exit in stay.exits
    ]
    level = max(added, default=0.0) / (1 - rho) * (1 + ROUNDING)
    return {name: along_ellipsoid(np.asarray(np.linalg.inv(P[name])), level) for name in dynamics.locations}


def _over(dynamics: ErrorDynamics, name: str, stay: float) -> FloatArray:
    from scipy.linalg import expm

    F, step = dynamics.matrices[name], dynamics.step
    return np.asarray(expm(F * stay) if step is None else np.linalg.matrix_power(F, round(stay / step)))


def _ratio(matrix: FloatArray, after: FloatArray, before: FloatArray) -> float:
    """The largest eigenvalue of Mᵀ after M with respect to before."""
    from scipy.linalg import eigh

    return float(eigh(matrix.T @ after @ matrix, before, eigvals_only=True).max())


def size_in_form(entries: FloatArray, form: FloatArray) -> float:
    """Return a bound of sqrt(ζᵀ form ζ) over all |ζ| <= entries (n,).

    >>> size_in_form(np.array([3.0, 4.0]), np.eye(2))
    5.0
    """
    return float(np.sqrt(entries @ np.abs(form) @ entries))


def along_ellipsoid(inverse: FloatArray, level: float) -> Levels:
    """Return the support of {ζᵀ P ζ <= level²}; inverse: P⁻¹ (n, n)."""
    return lambda rows: np.asarray(level * np.sqrt(np.maximum(((rows @ inverse) * rows).sum(axis=-1), 0.0)))


__all__ = ["along_ellipsoid", "entry_ellipsoids", "size_in_form"]
