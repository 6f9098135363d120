"""One location between two samples: exact discretisation with inputs held constant.

In: continuous-time dynamics and a step h in seconds.  Out: the same values in discrete time.  One matrix exponential
of a block matrix gives the flow and the integrals together, also where A is singular.

Source: Van Loan (1978), Computing integrals involving the matrix exponential.
"""

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.linear.subspaces import balanced

TINY = float(np.finfo(np.float64).tiny)
"""An input column is scaled by at least this, so that a column of zeros stays one."""


def flow_and_integral(A: FloatArray, inputs: FloatArray, step: float) -> tuple[FloatArray, FloatArray]:
    """Return e^{A h} and the integral of e^{A s} ds over [0, h] times `inputs`; shapes (n, n), (n, k).

    Raises `UsageError` (DH0514) where a number would grow beyond all doubles within the step.

    >>> flow, integral = flow_and_integral(np.zeros((1, 1)), np.ones((1, 1)), 0.5)
    >>> float(flow[0, 0]), float(integral[0, 0])
    (1.0, 0.5)
    """
    from scipy.linalg import expm

    n, k = A.shape[0], inputs.shape[1]
    # The exponential is as accurate as its matrix is balanced; the integral is linear in each column of `inputs`.
    inside, scale = balanced(A) if n else (A, np.ones(0))
    pushed = inputs / scale[:, None]
    size = max(1.0, float(np.abs(inside).max(initial=0.0)))
    units = np.maximum(np.abs(pushed).max(axis=0, initial=0.0) / size, TINY)
    block = np.zeros((n + k, n + k))
    block[:n, :n], block[:n, n:] = inside, pushed / units
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):
        try:
            whole = expm(block * step)
        except (ValueError, OverflowError):  # LAPACK met an infinite number
            whole = np.full(block.shape, np.inf)
        flow, integral = whole[:n, :n] * scale[:, None] / scale, whole[:n, n:] * scale[:, None] * units
    if not (np.isfinite(flow).all() and np.isfinite(integral).all()):
        raise _too_long(step)
    return flow, integral


def _too_long(step: float) -> UsageError:
    text = f"a step of {step:g} s is too long: the exponential of the dynamics over it overflows"
    return UsageError(diagnostic("DH0514", text, helps=("choose a shorter step, or check the units in `A`",)))


def sample_dynamics(dynamics: LinearDynamics, step: float) -> LinearDynamics:
    """Return x(k+1) = A_d x + B_d u + E_d w + f_d, exact for u and w held over `step` seconds; C, D, g stay.

    >>> from deshybrid.linear.dynamics import LinearDynamics
    >>> z = np.zeros
    >>> integrator = LinearDynamics(z((1, 1)), np.ones((1, 1)), np.ones((1, 1)), z((1, 1)), z((1, 0)), z(1), z(1))
    >>> float(sample_dynamics(integrator, 0.1).B[0, 0])
    0.1
    """
    n, m, r = dynamics.A.shape[0], dynamics.B.shape[1], dynamics.E.shape[1]
    driven = np.hstack([dynamics.B, dynamics.E, dynamics.f[:, None]])
    flow, integral = flow_and_integral(dynamics.A, driven, step)
    return LinearDynamics(
        A=frozen_array(flow, (n, n)),
        B=frozen_array(integral[:, :m], (n, m)),
        C=dynamics.C,
        D=dynamics.D,
        E=frozen_array(integral[:, m : m + r], (n, r)),
        f=frozen_array(integral[:, m + r], (n,)),
        g=dynamics.g,
    )


def sample_gain(dynamics: LinearDynamics, gain: FloatArray, step: float) -> FloatArray:
    """Return G_d, the integral of e^{(A - G C) s} ds over [0, h] times G; shape (n, p).

    The sampled observer is x := A_d x + B_d u + f_d + G_d (y - C x - D u - g), so that the sampled error obeys
    A_d - G_d C and needs no plant term: the observer stays exact where the plant's input is held over the step.
    (Holding y instead, with the flow e^{F h}, would leave an error of order h.)  G_d tends to h G for short steps;
    whether A_d - G_d C contracts is checked by `deshybrid.continuous.sampled`.

    >>> z = np.zeros
    >>> one = np.ones((1, 1))
    >>> integrator = LinearDynamics(z((1, 1)), one, one, z((1, 1)), z((1, 0)), z(1), z(1))
    >>> round(float(sample_gain(integrator, 2 * one, 0.1)[0, 0]), 6)  # 1 - exp(-0.2)
    0.181269
    """
    _, integral = flow_and_integral(dynamics.A - gain @ dynamics.C, gain, step)
    return frozen_array(integral, gain.shape)


def sample_covariance(A: FloatArray, intensity: FloatArray, step: float) -> FloatArray:
    """Return the integral of e^{A s} W e^{Aᵀ s} ds over [0, h]: what white noise of intensity W adds in a step.

    Van Loan's exponential holds e^{-A h}, which overflows for fast decaying modes; so it is taken over a short part of
    the step, and the part is doubled: Q(2h) = Q(h) + e^{A h} Q(h) e^{Aᵀ h}.  Raises `UsageError` (DH0514) as
    `flow_and_integral`.

    >>> sample_covariance(np.zeros((1, 1)), np.ones((1, 1)), 0.5).tolist()
    [[0.5]]
    """
    from scipy.linalg import expm

    n = A.shape[0]
    doublings = max(0, int(np.ceil(np.log2(max(1.0, float(np.abs(A).sum(axis=1).max(initial=0.0)) * step)))))
    block = np.block([[-A, intensity], [np.zeros((n, n)), A.T]])
    whole = expm(block * (step / 2.0**doublings))
    flow = whole[n:, n:].T
    covariance = flow @ whole[:n, n:]
    with np.errstate(over="ignore", invalid="ignore"):
        for _ in range(doublings):
            covariance = covariance + flow @ covariance @ flow.T
            flow = flow @ flow
    if not np.isfinite(covariance).all():
        raise _too_long(step)
    return frozen_array(0.5 * (covariance + covariance.T), (n, n))


def covariance_root(covariance: FloatArray) -> FloatArray:
    """Return S with S Sᵀ = covariance (..., n, n), also where it is singular.

    >>> covariance_root(np.array([[4.0, 0.0], [0.0, 0.0]])).tolist()
    [[0.0, 2.0], [0.0, 0.0]]
    """
    values, vectors = np.linalg.eigh(covariance)
    root: FloatArray = vectors * np.sqrt(np.maximum(values, 0.0))[..., None, :]
    return root


__all__ = ["covariance_root", "flow_and_integral", "sample_covariance", "sample_dynamics", "sample_gain"]
