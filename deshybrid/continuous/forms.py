"""Forms that decrease from entry to entry: the unknowns of a certificate by matrix inequalities.

In: the error dynamics times e^{μ t}, a degree 2d, a shortest stay T_i for each location.  Out: forms P_i at the entry
and Q_i at the end of a stay with, in the monomials of degree d,

    F_iᵀ Q_i + Q_i F_i < 0,      e^{F_iᵀ T_i} Q_i e^{F_i T_i} < P_i,      R¹_ijᵀ P_j R¹_ij < Q_i,

or the same with M_iᵀ Q_i M_i < Q_i and M_i^k in sampled time.  With Q_i = e^{-F_iᵀ T} P_i e^{-F_i T} these are the
classical conditions on P_i alone; with Q_i as an unknown of its own nothing is ever multiplied by e^{-F T}, which has
entries beyond all bounds.  The idea that makes the numbers small: P_i and Q_i are sought near the identity of frames
of their own, taken from Lyapunov's equation at first, then from the last forms that were found.

m locations, N = n(n+1)/2 with n the number of monomials: 2 m N unknowns.  Source: Geromel and Colaneri (2006),
"Stability and stabilization of continuous-time switched linear systems"; forms of degree 2d by Parrilo and Jadbabaie
(2008).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.conic import Solution, Term, congruence, drift, identity, solve
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.lifting import lifted, lifted_generator, lifting_weights

MARGIN = 1e-7
"""Forms count as found where every inequality, in frames in which P is near the identity, has this margin."""
LOOKS = 3
"""Frames are renewed at most so often for one set of stays."""
FLATTEST = 1e-12
"""A frame is not flatter than this."""
SLOWEST = 1e-9
"""Rates (1/s, or a part of a step) below this are not scaled up."""


class Forms(NamedTuple):
    """P and Q by location, (N, N) in the monomials of degree `degree` (lexicographic, without weights)."""

    degree: int
    P: Mapping[str, FloatArray]
    Q: Mapping[str, FloatArray]


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Coordinates for each location at the entry and at the end of a stay: z = entry[i] ζ, z = end[i] ζ."""

    entry: tuple[FloatArray, ...]
    end: tuple[FloatArray, ...]


class FormProblem:
    """The inequalities of one degree; `solve` remembers frames from call to call, so that near stays come easily."""

    def __init__(self, dynamics: ErrorDynamics, degree: int = 1, frames: Frames | None = None) -> None:
        self.dynamics, self.degree = dynamics, degree
        self.base = frames or lyapunov_frames(dynamics)
        n = len(next(iter(dynamics.matrices.values())))
        self.weights = lifting_weights(n, degree)
        units = tuple(np.eye(len(self.weights)) for _ in dynamics.locations)
        self.inner = Frames(units, units)
        self._local = tuple(
            _conjugated(U, dynamics.matrices[name], U)
            for name, U in zip(dynamics.locations, self.base.end, strict=True)
        )

    def solve(self, stays: Sequence[float]) -> Forms | None:
        """Return forms for these shortest stays (s; one per location), None where none were found.

        A margin that is positive but too small to trust grows in the frames of the forms that have it: look again.
        """
        for _ in range(LOOKS):
            found = self._proposed(stays)
            if found.margin <= 0:
                return None
            forms = self._accept(found.unknowns)
            if found.margin >= MARGIN:
                return forms
        return None

    def _proposed(self, stays: Sequence[float]) -> Solution:
        places, size = self.dynamics.locations, len(self.weights)
        inequalities: list[list[Term]] = []
        for i, stay in enumerate(stays):
            inequalities.append([Term(i, identity(size))])
            inequalities.append(self._flow(i))
            end = self.inner.end[i] @ self._lifted(self._over(i, stay)) @ np.linalg.inv(self.inner.entry[i])
            inequalities.append([Term(i, identity(size)), Term(len(places) + i, -congruence(end))])
        for reset in self.dynamics.resets:
            i, j = places.index(reset.source), places.index(reset.target)
            jump = self._lifted(_conjugated(self.base.entry[j], reset.matrix, self.base.end[i]))
            jump = self.inner.entry[j] @ jump @ np.linalg.inv(self.inner.end[i])
            inequalities.append([Term(len(places) + i, identity(size)), Term(j, -congruence(jump))])
        return solve(size, 2 * len(places), inequalities, normalised=len(places))

    def frames(self) -> Frames:
        """Return the frames of the last forms that were found, for a problem of higher degree; of degree 2 only."""
        pairs = ((self.inner.entry, self.base.entry), (self.inner.end, self.base.end))
        entry, end = (tuple(a @ b for a, b in zip(*pair, strict=True)) for pair in pairs)
        return Frames(entry, end)

    def _flow(self, i: int) -> list[Term]:
        size, frame, unknown = len(self.weights), self.inner.end[i], len(self.dynamics.locations) + i
        if self.dynamics.step is None:
            generator = self._weighted(lifted_generator(self._local[i].tolist(), self.degree))
            inside = _conjugated(frame, generator, frame)
            return [Term(unknown, -drift(inside) / max(float(np.linalg.norm(inside, 2)), SLOWEST))]
        inside = _conjugated(frame, self._lifted(self._local[i]), frame)
        lost = identity(size) - congruence(inside)
        return [Term(unknown, lost / max(float(np.linalg.norm(np.eye(size) - inside, 2)), SLOWEST))]

    def _over(self, i: int, stay: float) -> FloatArray:
        from scipy.linalg import expm

        step, change = self.dynamics.step, self.base.end[i] @ np.linalg.inv(self.base.entry[i])
        if step is None:
            return np.asarray(expm(self._local[i] * stay) @ change)
        return np.asarray(np.linalg.matrix_power(self._local[i], round(stay / step)) @ change)

    def _lifted(self, matrix: FloatArray) -> FloatArray:
        return matrix if self.degree == 1 else self._weighted(lifted(matrix.tolist(), self.degree))

    def _weighted(self, rows: Sequence[Sequence[float]]) -> FloatArray:
        return np.asarray(self.weights[:, None] * np.array(rows) / self.weights)

    def _accept(self, unknowns: Sequence[FloatArray]) -> Forms:
        """Take the new frames, and the forms in the monomials of the states."""
        count = len(self.dynamics.locations)
        entry = tuple(root(X) @ frame for X, frame in zip(unknowns[:count], self.inner.entry, strict=True))
        end = tuple(root(X) @ frame for X, frame in zip(unknowns[count:], self.inner.end, strict=True))
        self.inner = Frames(entry, end)
        return Forms(self.degree, self._forms(self.base.entry, entry), self._forms(self.base.end, end))

    def _forms(self, outer: Sequence[FloatArray], inner: Sequence[FloatArray]) -> Mapping[str, FloatArray]:
        found = {}
        for name, base, frame in zip(self.dynamics.locations, outer, inner, strict=True):
            whole = frame @ self._lifted(base) * self.weights
            form = whole.T @ whole
            found[name] = frozen_array((form + form.T) / 2, form.shape)
        return MappingProxyType(found)


def lyapunov_frames(dynamics: ErrorDynamics) -> Frames:
    """Return frames in which each flow alone decreases: roots of the solution of Lyapunov's (Stein's) equation."""
    from scipy.linalg import matrix_balance, solve_continuous_lyapunov, solve_discrete_lyapunov

    frames = []
    for F in dynamics.matrices.values():
        balanced, (sizes, _) = matrix_balance(F, permute=False, separate=True)
        one = np.eye(len(F))
        if dynamics.step is None:
            X = solve_continuous_lyapunov(balanced.T, -one * np.linalg.norm(balanced, 2))
        else:
            X = solve_discrete_lyapunov(balanced.T, one)
        frames.append(root((X + X.T) / 2 / sizes / sizes[:, None]))
    return Frames(tuple(frames), tuple(frames))


def _conjugated(left: FloatArray, matrix: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(right.T, (left @ matrix).T).T)


def root(X: FloatArray) -> FloatArray:
    """Return S with Sᵀ S = X, X made positive definite where it is not quite; eigenvectors in units of its diagonal."""
    sizes = np.sqrt(np.maximum(np.diag(X), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(X / sizes / sizes[:, None])
    values = np.maximum(values, values.max() * FLATTEST)
    return np.asarray((vectors * np.sqrt(values)).T * sizes)


__all__ = ["FormProblem", "Forms", "Frames", "lyapunov_frames", "root"]
