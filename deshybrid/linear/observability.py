"""Observability of one location: the matrix, the verdict, the Kalman split, and the modes that no gain can move.

In: A (n, n) and C (p, n).  Out: verdicts and subspaces.  The idea: ranks are decided on the balanced system by nested
null spaces (`linear/subspaces.py`), never on the observability matrix itself, whose rows grow like ‖A‖^k.  O(n^4).

Source: Kalman (1963); Balluchi et al. (2012), Theorem 6 (which asks it of every persistent location).
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import ComplexArray, FloatArray, frozen_array
from deshybrid.linear.subspaces import null_space, output_nulling, scaled_system


@dataclass(frozen=True, slots=True, eq=False)
class KalmanSplit:
    """Coordinates x = transform @ (x_o, x_u) in which A = [[A_o, 0], [coupling, A_u]] and C = [C_o, 0].

    Shapes: transform and inverse (n, n), A_o (k, k), C_o (p, k), A_u (n-k, n-k), coupling (n-k, k).
    """

    transform: FloatArray
    inverse: FloatArray
    A_o: FloatArray
    C_o: FloatArray
    A_u: FloatArray
    coupling: FloatArray

    @property
    def observable_dimension(self) -> int:
        """The number k of state components that the output shows."""
        return len(self.A_o)


def observability_matrix(A: FloatArray, C: FloatArray) -> FloatArray:
    """Return [C; C A; ...; C A^(n-1)], shape (n p, n), as it stands in the books (use `is_observable` for its rank).

    >>> observability_matrix(np.array([[0.0, 1], [-2, -3]]), np.array([[1.0, 0]]))
    array([[1., 0.],
           [0., 1.]])
    """
    rows = [np.asarray(C, dtype=np.float64)]
    for _ in range(A.shape[0] - 1):
        rows.append(rows[-1] @ A)
    return np.vstack(rows)


def kalman_split(A: FloatArray, C: FloatArray) -> KalmanSplit:
    """Return the observable and the unobservable part of (A, C); bases are orthonormal after balancing.

    >>> split = kalman_split(np.diag([-1.0, -2.0]), np.array([[1.0, 0.0]]))
    >>> split.observable_dimension, split.A_u.tolist()
    (1, [[-2.0]])
    """
    n, p = A.shape[0], C.shape[0]
    scaled = scaled_system(A, np.zeros((n, 0)), C, np.zeros((p, 0)))
    hidden = output_nulling(scaled)
    seen = null_space(hidden.T)
    basis = np.hstack([seen, hidden])
    transform = scaled.scale[:, None] * basis
    inverse = basis.T / scaled.scale
    inside = inverse @ A @ transform
    k = seen.shape[1]
    return KalmanSplit(
        frozen_array(transform, (n, n)),
        frozen_array(inverse, (n, n)),
        frozen_array(inside[:k, :k], (k, k)),
        frozen_array((C @ transform)[:, :k], (p, k)),
        frozen_array(inside[k:, k:], (n - k, n - k)),
        frozen_array(inside[k:, :k], (n - k, k)),
    )


def is_observable(A: FloatArray, C: FloatArray) -> bool:
    """Return whether the output y = C x determines x; a singular value below 1e-10 of the scaled matrices is zero.

    >>> is_observable(np.array([[0.0, 1], [0, 0]]), np.array([[1.0, 0]]))
    True
    """
    return kalman_split(A, C).observable_dimension == len(A)


def observability_index(A: FloatArray, C: FloatArray) -> int | None:
    """Return the least number of rows C, C A, C A², ... that have rank n, else None; ranks as for `is_observable`.

    >>> observability_index(np.array([[0.0, 1], [0, 0]]), np.array([[1.0, 0]]))
    2
    >>> observability_index(np.eye(2), np.array([[1.0, 0]])) is None
    True
    """
    n = len(A)
    scaled = scaled_system(A, np.zeros((n, 0)), C, np.zeros((len(C), 0)))
    hidden = np.eye(n)
    for rows in range(1, n + 1):
        outside = np.eye(n) - hidden @ hidden.T
        smaller = null_space(np.vstack([outside @ scaled.A, scaled.C]))
        if smaller.shape[1] == 0:
            return rows
        if smaller.shape[1] == hidden.shape[1]:
            return None
        hidden = smaller
    return None


def fixed_modes(A: FloatArray, C: FloatArray) -> ComplexArray:
    """Return the eigenvalues of the unobservable part: eigenvalues of A - G C for every gain G; sorted, shape (n - k,).

    >>> fixed_modes(np.diag([-1.0, -2.0]), np.array([[1.0, 0.0]]))
    array([-2.+0.j])
    """
    return sorted_spectrum(kalman_split(A, C).A_u)


def sorted_spectrum(matrix: FloatArray) -> ComplexArray:
    """Return the eigenvalues, the slowest (largest real part) first; of a conjugate pair, that above the axis first."""
    values = np.linalg.eigvals(matrix).astype(np.complex128) if matrix.size else np.zeros(0, dtype=np.complex128)
    return values[np.lexsort((-values.imag, -values.real))]


__all__ = [
    "KalmanSplit",
    "fixed_modes",
    "is_observable",
    "kalman_split",
    "observability_index",
    "observability_matrix",
    "sorted_spectrum",
]
