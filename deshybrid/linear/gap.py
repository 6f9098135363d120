"""The ν-gap between two transfer matrices: how far apart two plants are for what feedback can see of them.

In: A, B, C, D of two systems with the same inputs and outputs.  Out: a number from 0 (the same transfer matrix) to 1.

    δ(P, Q) = sup over ω of σ_max((1 + Q Q*)^{-1/2} (P - Q) (1 + P* P)^{-1/2})

if det(1 + Q* P) does not vanish on the imaginary axis and does not wind around zero more than the poles of P and Q make
it, else 1.  With P = N M⁻¹ and Q = M'⁻¹ N' factored such that (N, M) and (N', M') are stable and of gain one, the
quotient is the stable M'(P - Q) M, whose H∞ norm is found exactly by level sets, and the condition is that
N_Q~ N + M_Q~ M has as many zeros as poles to the right of the axis: both are eigenvalues, no contour is drawn.

Only what inputs reach and outputs show counts.  Cost: two Riccati equations and some eigenvalues of size 4 n.
Source: Vinnicombe (1993), IEEE Trans. Automatic Control 38(9), and Uncertainty and Feedback (2001), chapters 3 and 4;
the norm after Bruinsma and Steinbuch (1990).
"""

from itertools import pairwise
from typing import NamedTuple

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.observability import kalman_split

PRECISION = 1e-6
CLOSE = 1e-3  # share of its modulus that the real part of an eigenvalue may have that counts as on the imaginary axis
MOST_LEVELS = 60


class Realisation(NamedTuple):
    """P(s) = C (s - A)⁻¹ B + D; shapes (n, n), (n, m), (p, n), (p, m)."""

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray

    @property
    def dual(self) -> "Realisation":
        """The transposed transfer matrix."""
        return Realisation(self.A.T, self.C.T, self.B.T, self.D.T)

    def at(self, omega: float) -> np.ndarray[tuple[int, ...], np.dtype[np.complex128]]:
        """P(jω), (p, m)."""
        inverse = np.linalg.solve(1j * omega * np.eye(len(self.A)) - self.A, self.B.astype(np.complex128))
        return np.asarray(self.C @ inverse + self.D)


def nu_gap(P: Realisation, Q: Realisation) -> float:
    """Return the ν-gap of two systems in continuous time, to six digits.

    ValueError where they differ in the numbers of inputs and outputs, or have none.

    >>> unstable, stable = (Realisation(*(np.array([[x]]) for x in (a, 1.0, 1.0, 0.0))) for a in (0.001, -0.001))
    >>> round(nu_gap(unstable, stable), 6), nu_gap(stable, stable)
    (0.002, 0.0)
    """
    if P.D.shape != Q.D.shape or 0 in P.D.shape:
        raise ValueError(f"transfer matrices of shape {P.D.shape} and {Q.D.shape} cannot be compared")
    P, Q = _minimal(P), _minimal(Q)
    graph, other = _graph(P), _graph(Q)
    if not _winds_as_it_should(graph, other):
        return 1.0
    return min(1.0, _norm(_series(graph, _annihilator(Q))))


def _annihilator(Q: Realisation) -> Realisation:
    """(-M', N') with Q = M'⁻¹ N', stable, M' M'~ + N' N'~ = 1: zero on what belongs together."""
    A, B, C, D = _graph(Q.dual).dual  # (N', M')
    m = Q.D.shape[1]
    return Realisation(A, np.hstack([-B[:, m:], B[:, :m]]), C, np.hstack([-D[:, m:], D[:, :m]]))


def bilinear(P: Realisation) -> Realisation | None:
    """Return the system in continuous time with P(z) at z = (1 + s)/(1 - s), the unit circle becoming the axis.

    The gap is the same; None where P has a pole at -1, which would go to infinity.

    >>> bilinear(Realisation(*(np.array([[x]]) for x in (0.5, 1.0, 1.0, 0.0)))).D.round(3).tolist()
    [[-0.667]]
    """
    A, B, C, D = P
    shifted = np.eye(len(A)) + A
    if np.linalg.matrix_rank(shifted) < len(A):
        return None
    into = np.linalg.solve(shifted, B)
    outward = np.linalg.solve(shifted.T, C.T).T
    moved = np.linalg.solve(shifted, A - np.eye(len(A)))
    parts = (moved, np.sqrt(2.0) * into, np.sqrt(2.0) * outward, D - C @ into)
    return Realisation(*(np.asarray(part, dtype=np.float64) for part in parts))


def _minimal(P: Realisation) -> Realisation:
    """What inputs reach and outputs show."""
    seen = _observable(P)
    return _observable(seen.dual).dual


def _observable(P: Realisation) -> Realisation:
    split = kalman_split(P.A, P.C)
    return Realisation(split.A_o, split.inverse[: split.observable_dimension] @ P.B, split.C_o, P.D)


def _graph(P: Realisation) -> Realisation:
    """(N; M) with P = N M⁻¹, stable, N~ N + M~ M = 1: outputs first, then inputs."""
    from scipy.linalg import solve_continuous_are, sqrtm

    A, B, C, D = P
    R = np.eye(D.shape[1]) + D.T @ D
    root = np.linalg.inv(np.real(sqrtm(R)))
    X = solve_continuous_are(A, B, C.T @ C, R, s=C.T @ D) if len(A) else np.zeros((0, 0))
    F = -np.linalg.solve(R, D.T @ C + B.T @ X)
    return Realisation(A + B @ F, B @ root, np.vstack([C + D @ F, F]), np.vstack([D @ root, root]))


def _series(first: Realisation, then: Realisation) -> Realisation:
    """then(s) first(s)."""
    A = np.block([[first.A, np.zeros((len(first.A), len(then.A)))], [then.B @ first.C, then.A]])
    B = np.vstack([first.B, then.B @ first.D])
    return Realisation(A, B, np.hstack([then.D @ first.C, then.C]), then.D @ first.D)


def _winds_as_it_should(graph: Realisation, other: Realisation) -> bool:
    """Whether det(other~ graph) has as many zeros as poles to the right of the axis; its poles there are other's."""
    adjoint = Realisation(-other.A.T, -other.C.T, other.B.T, other.D.T)
    A, B, C, D = _series(graph, adjoint)
    if np.linalg.matrix_rank(D) < len(D):
        return False
    zeros = np.linalg.eigvals(A - B @ np.linalg.solve(D, C))
    return int((zeros.real > 0.0).sum()) == len(other.A)


def _norm(H: Realisation) -> float:
    """The H∞ norm of a stable system: the level is raised to what is reached between the frequencies that cross it."""
    poles = np.abs(np.linalg.eigvals(H.A))
    level = max([_gain(H, omega) for omega in (0.0, *poles.tolist())] + [float(np.linalg.norm(H.D, 2))])
    for _ in range(MOST_LEVELS):
        if level < PRECISION:
            return 0.0
        crossed = [0.0, *_crossings(H, (1.0 + PRECISION) * level)]
        higher = max((_gain(H, (low + high) / 2.0) for low, high in pairwise(crossed)), default=0.0)
        if higher <= (1.0 + PRECISION) * level:
            break
        level = higher
    return level


def _gain(H: Realisation, omega: float) -> float:
    return float(np.linalg.norm(H.at(omega), 2))


def _crossings(H: Realisation, level: float) -> list[float]:
    """The frequencies at which a singular value of H may be the level, from below: eigenvalues close to the axis.

    Near a peak two of them meet and leave the axis by rounding, so that close is not very close.
    """
    A, B, C, D = H
    inner = level**2 * np.eye(D.shape[1]) - D.T @ D
    mixed = A + B @ np.linalg.solve(inner, D.T @ C)
    outer = C.T @ (np.eye(len(D)) + D @ np.linalg.solve(inner, D.T)) @ C
    values = np.linalg.eigvals(np.block([[mixed, B @ np.linalg.solve(inner, B.T)], [-outer, -mixed.T]]))
    close = (values.imag >= 0.0) & (np.abs(values.real) <= CLOSE * np.abs(values))
    return sorted(values[close].imag.tolist())


__all__ = ["Realisation", "bilinear", "nu_gap"]
