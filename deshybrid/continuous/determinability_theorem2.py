"""Theorem 2 of Balluchi et al. (2003), as printed and corrected, and its Corollary 3.

In: error dynamics F_i with resets R¹_ij and a dwell time D.  Out: for each location α(F_i) and how much an exit can
stretch the error in eigenvector coordinates x̄ = T_i x, T_i F_i T_i⁻¹ diagonal, hence the dwell time that is enough:

    α(F_i) + max{0, log max_j ‖T_j R¹_ij T_i⁻¹‖}/D < 0  for every location i.

The paper prints ‖T_i R¹_ij T_j⁻¹‖.  With its own x̄ = T x a switch takes x̄_i to T_j R¹_ij T_i⁻¹ x̄_i, so the printed
norm bounds nothing: there are pairs of locations for which it is at most 1, whatever D, and which diverge.  Only the
corrected form is a verdict here; the printed one is told beside it.

T_i has rows such that the columns of T_i⁻¹ are eigenvectors of unit length.  O(n³) a location and reset.

Source: Balluchi et al. (2003), Theorem 2 and Corollary 3.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import inf, isfinite, log
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.checks import require_positive
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.modes import ROUND_UP, condition, decay_rate
from deshybrid.linear.arrays import ComplexArray


class StretchTerms(NamedTuple):
    """One location: alpha (1/s), the largest ‖T_j R¹_ij T_i⁻¹‖ of its exits, and the printed ‖T_i R¹_ij T_j⁻¹‖."""

    alpha: float
    stretch: float
    stretch_printed: float


@dataclass(frozen=True, slots=True, eq=False)
class SwitchingTheorem:
    """Theorem 2 for a dwell time (s; None: not stated); required_dwell (s) is infinite where none is enough.

    holds and required_dwell are those of the corrected form, holds_printed and required_dwell_printed of the printed.
    """

    dwell: float | None
    holds: bool
    required_dwell: float
    holds_printed: bool
    required_dwell_printed: float
    terms: Mapping[str, StretchTerms]

    @property
    def corollary_3(self) -> bool:
        """True where some dwell time is enough: every location decays and can be diagonalised."""
        return isfinite(self.required_dwell)

    def record(self) -> dict[str, object]:
        """Return the JSON form; infinite numbers are null."""
        return {
            "theorem": "B03-2",
            "dwell": self.dwell,
            "holds": self.holds,
            "required_dwell": self.required_dwell if isfinite(self.required_dwell) else None,
            "holds_printed": self.holds_printed,
            "required_dwell_printed": self.required_dwell_printed if isfinite(self.required_dwell_printed) else None,
            "corollary_3": self.corollary_3,
        }


def theorem_2(dynamics: ErrorDynamics, dwell: float | None = None) -> SwitchingTheorem:
    """Return what Theorem 2 says of error dynamics in continuous or sampled time.

    Raises `UsageError` (DH0508) for a dwell time that is not positive.

    >>> from deshybrid.continuous.error import ErrorReset
    >>> jump = ErrorReset("p", "p", np.array([[4.0]]), np.zeros(1))
    >>> found = theorem_2(ErrorDynamics(("p",), {"p": np.array([[-1.0]])}, (jump,)), dwell=2.0)
    >>> found.holds, round(found.required_dwell, 4)  # log(4)/1
    (True, 1.3863)
    """
    require_positive("dwell time", dwell)
    bases = {name: _unit_columns(matrix) for name, matrix in dynamics.matrices.items()}
    terms = {}
    for name in dynamics.locations:
        stretch = printed = 0.0 if condition(bases[name]) < inf else inf
        for reset in dynamics.exits(name):
            here, there = bases[name], bases[reset.target]
            if condition(here) == inf or condition(there) == inf:
                stretch = printed = inf
                continue
            stretch = max(stretch, _norm(np.asarray(np.linalg.solve(there, reset.matrix @ here))))
            printed = max(printed, _norm(np.asarray(np.linalg.solve(here, reset.matrix @ there))))
        alpha = decay_rate(np.linalg.eigvals(dynamics.matrices[name]).astype(np.complex128), dynamics.step)
        terms[name] = StretchTerms(alpha, stretch, printed)
    corrected = max((_required(term.alpha, term.stretch) for term in terms.values()), default=0.0)
    printed = max((_required(term.alpha, term.stretch_printed) for term in terms.values()), default=0.0)
    return SwitchingTheorem(
        dwell=dwell,
        holds=dwell is not None and corrected < dwell,
        required_dwell=corrected,
        holds_printed=dwell is not None and printed < dwell,
        required_dwell_printed=printed,
        terms=MappingProxyType(terms),
    )


def _unit_columns(matrix: "np.ndarray[tuple[int, ...], np.dtype[np.float64]]") -> ComplexArray:
    return np.linalg.eig(matrix)[1].astype(np.complex128)


def _norm(matrix: ComplexArray) -> float:
    return float(np.linalg.norm(matrix, 2))


def _required(alpha: float, stretch: float) -> float:
    """log(stretch)/(-α), rounded up; 0 where nothing is stretched, infinite where the location does not decay."""
    if alpha >= 0 or stretch == inf:
        return inf
    return log(stretch) / -alpha * (1 + ROUND_UP) if stretch > 1 else 0.0


__all__ = ["StretchTerms", "SwitchingTheorem", "theorem_2"]
