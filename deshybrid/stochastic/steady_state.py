"""The steady-state Kalman filter of each mode: whether it exists, its gain, and how fast its error decays.

In: a `Mode`.  Out: what speaks against a steady state, and the filter where nothing does.  The Riccati equation
P = F P Fᵀ - F P Hᵀ (R + H P Hᵀ)⁻¹ H P Fᵀ + Q has one stabilising solution if and only if (F, H) is detectable and
(F, Q^½) is controllable on the unit circle.  The paper adds that this solution is positive definite: it is positive
semidefinite, and definite only where noise reaches every state, directly or in time.

Two gains go by the name of Kalman: the *predictor* gain K_p = F K_f of Hwang et al. (2003), whose error obeys
F - K_p H, and the *filter* gain K_f of (2006), whose error obeys (I - K_f H) F.  Both have the same eigenvalues, and
other eigenvectors, so that κ differs.

O(n³) for each mode.  Source: Hwang, Balakrishnan and Tomlin (2003), section 3.2, Theorem 2, (13) to (20).
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.observability import fixed_modes
from deshybrid.stochastic.lanes import symmetric
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.system import Mode

ON_THE_CIRCLE = 1e-8
"""An eigenvalue counts as one on the unit circle if its absolute value is within this distance of 1."""
NOTHING = 1e-12
"""An eigenvalue of a covariance below this share of the largest is zero."""


@dataclass(frozen=True, slots=True, eq=False)
class SteadyFilter:
    """P (n, n) of the prediction, S (p, p) of the residual, and both gains (n, p), of one mode."""

    mode: Mode
    P: FloatArray
    S: FloatArray
    predictor_gain: FloatArray
    filter_gain: FloatArray

    @property
    def predictor_error(self) -> FloatArray:
        """F - K_p H, what the error of the prediction obeys while the filter is of the true mode."""
        error: FloatArray = self.mode.F - self.predictor_gain @ self.mode.H
        return error

    @property
    def filter_error(self) -> FloatArray:
        """(I - K_f H) F, what the error of the estimate after the measurement obeys."""
        error: FloatArray = self.mode.F - self.filter_gain @ self.mode.H @ self.mode.F
        return error

    @property
    def radius(self) -> float:
        """The spectral radius of both, below 1: the factor by which the error shrinks a step in the long run."""
        return float(np.abs(np.linalg.eigvals(self.predictor_error)).max(initial=0.0))

    @property
    def positive_definite(self) -> bool:
        """Whether P is positive definite, as the paper says of every stabilising solution."""
        sizes = np.linalg.eigvalsh(self.P)
        return bool(sizes[0] > NOTHING * sizes[-1])


@dataclass(frozen=True, slots=True, eq=False)
class SteadyState:
    """The filter of one mode, or what speaks against it.

    `undetectable`: eigenvalues of F on or outside the unit circle that no output shows; `undisturbed`: eigenvalues on
    the unit circle that no process noise reaches, so that the filter trusts its model ever more and forgets nothing.
    """

    mode: Mode
    undetectable: tuple[complex, ...]
    undisturbed: tuple[complex, ...]
    filter: SteadyFilter | None

    @property
    def reason(self) -> str:
        """Why there is no filter, in one sentence; empty where there is one."""
        if self.filter is not None:
            return ""
        if self.undetectable:
            return f"no output shows what its eigenvalue {_shown(self.undetectable[0])} does, which does not decay"
        if self.undisturbed:
            return f"no process noise reaches its eigenvalue {_shown(self.undisturbed[0])} on the unit circle"
        return "its filter is so close to the edge of stability that double precision does not find it"


def steady_state(mode: Mode) -> SteadyState:
    """Return the steady-state filter of a mode or what speaks against it.

    >>> steady_state(Mode("steady", F=[[1.0]], H=[[1.0]], Q=[[2.0]], R=[[1.0]])).filter.P.round(9).tolist()
    [[2.732050808]]
    >>> steady_state(Mode("constant", F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[1.0]])).reason
    'no process noise reaches its eigenvalue 1 on the unit circle'
    """
    require_fixed_noise((mode,), "a steady-state filter")
    hidden, calm = fixed_modes(mode.F, mode.H), fixed_modes(mode.F.T, _root(mode.Q).T)
    undetectable = tuple(complex(v) for v in hidden if abs(v) >= 1.0 - ON_THE_CIRCLE)
    undisturbed = tuple(complex(v) for v in calm if abs(abs(v) - 1.0) <= ON_THE_CIRCLE)
    found = None if undetectable or undisturbed else _solved(mode)
    return SteadyState(mode, undetectable, undisturbed, found)


def _root(Q: FloatArray) -> FloatArray:
    """Some G with G Gᵀ = Q, without the columns that are rounding."""
    sizes, directions = np.linalg.eigh(Q)
    kept = sizes > NOTHING * max(float(sizes[-1]), 0.0)
    root: FloatArray = directions[:, kept] * np.sqrt(sizes[kept])
    return root


def _solved(mode: Mode) -> SteadyFilter | None:
    from scipy.linalg import LinAlgError, solve_discrete_are

    try:
        P = symmetric(np.asarray(solve_discrete_are(mode.F.T, mode.H.T, mode.Q, mode.R)))
    except (LinAlgError, ValueError):
        return None
    S = symmetric(mode.H @ P @ mode.H.T + mode.R)
    gain = np.linalg.solve(S, mode.H @ P).T
    n, p = gain.shape
    found = SteadyFilter(
        mode,
        frozen_array(P, (n, n)),
        frozen_array(S, (p, p)),
        frozen_array(mode.F @ gain, (n, p)),
        frozen_array(gain, (n, p)),
    )
    left = mode.F @ (P - gain @ mode.H @ P) @ mode.F.T + mode.Q - P
    good = np.abs(left).max(initial=0.0) <= ON_THE_CIRCLE * np.abs(P).max(initial=1.0) and found.radius < 1.0
    return found if good else None


def _shown(value: complex) -> str:
    return f"{value.real:.4g}" if value.imag == 0.0 else f"{value:.4g}"


__all__ = ["SteadyFilter", "SteadyState", "steady_state"]
