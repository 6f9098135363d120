"""Residual generators for statistical tests: stationary Kalman predictors, whose residuals are white.

The noise model.  Measurement errors are white: with the covariance `noise: measurement`, else uniform within the bound
on the measurement, independent from sample to sample and channel to channel, which has the variance bound²/3.
Disturbances are white too: `noise: process`, else held over each step and uniform within the bound.  A disturbance that
keeps its sign is not white; its share of the residual is a shift of the mean, which a test takes for a change of
location if it is large.

The error obeys e := (A - K C) e + (Y + K W) v - T d, and r = C e - W v, so that with P from the Riccati equation
P = A P Aᵀ + Q - K S Kᵀ, Q = T cov(d) Tᵀ + Y V Yᵀ, S = C P Cᵀ + W V Wᵀ, K = (A P Cᵀ - Y V Wᵀ) S⁻¹, the residual of the
own location is white with covariance S once the transient is over.

In: what a generator follows.  Out: the generator with the Kalman gain, and S.  Cost: one Riccati equation.
Source: Anderson and Moore, Optimal Filtering, sections 4.4 and 5.4; Willsky and Jones (1976).
"""

import numpy as np

from deshybrid.detector.residual import Followed, ResidualGenerator, generator_of, sampled_dynamics
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.system import HybridSystem, Location

REGULAR = 1e-9  # share of the measurement's variance that the state is driven by at least, so that P is unique


def white_generator(
    system: HybridSystem, followed: Followed, *, besides: FloatArray | None = None
) -> tuple[ResidualGenerator, FloatArray]:
    """Return the generator whose gain makes its residual white, and the residual's covariance S (q, q).

    `besides`: further process noise (n, n), written as that of the model is.

    Raises `UsageError` (DH0614) where the model states no measurement noise, or a singular one.
    """
    from scipy.linalg import solve_discrete_are

    location, A, C, W = followed.location, followed.A, followed.C, followed.W
    location.noise_form.require_fixed("a statistical test of residuals", location.name)
    V = measurement_covariance(system, location)
    k, R, N = len(A), W @ V @ W.T, -followed.Y @ V @ W.T
    drive = REGULAR * float(np.trace(V)) / len(V) * np.eye(k)
    Q = (
        followed.T @ process_covariance(system, followed, besides) @ followed.T.T
        + followed.Y @ V @ followed.Y.T
        + drive
    )
    P = solve_discrete_are(A.T, C.T, Q, R, s=N) if k else np.zeros((0, 0))
    S = C @ P @ C.T + R
    gain = np.asarray(np.linalg.solve(S, (A @ P @ C.T + N).T).T, dtype=np.float64)
    sizes = np.maximum(np.abs(np.linalg.eigvals(A - gain @ C)), np.finfo(np.float64).tiny)
    poles = tuple(complex(pole) for pole in np.log(sizes) / followed.step)
    made = generator_of(followed, gain, poles, "Kalman predictor, white residual")
    return made, frozen_array((S + S.T) / 2.0, S.shape)


def measurement_covariance(system: HybridSystem, location: Location) -> FloatArray:
    """Return the covariance of the measurement errors of a location's channels, (p, p).

    Raises `UsageError` (DH0614) where the model states none, or a singular one.
    """
    covariance, bound = location.measurement_noise, system.bounds.measurement
    if covariance is None and bound is not None:
        covariance = np.diag(bound[list(location.output_index)] ** 2 / 3.0)
    if covariance is None or not len(covariance) or np.linalg.eigvalsh(covariance)[0] <= 0.0:
        text = f"the detector of location `{location.name}` needs noise on every measurement"
        helps = ("state `bounds: {measurement: …}` or `noise: {measurement: …}`",)
        raise UsageError(diagnostic("DH0614", text, location.span, helps=helps))
    return covariance


def process_covariance(
    system: HybridSystem, followed: Followed | ResidualGenerator, besides: FloatArray | None = None
) -> FloatArray:
    """Return the covariance of what noise and disturbance do to the state in a step, (n, n); `besides` as noise."""
    location, dynamics, bound = followed.location, followed.dynamics, system.bounds.disturbance
    added = np.zeros_like(dynamics.A) if besides is None else _of_a_step(system, followed, besides)
    if location.process_noise is not None:
        return added + _of_a_step(system, followed, location.process_noise)
    if bound is None:
        return added
    entering = sampled_dynamics(system, dynamics, followed.step).E
    return np.asarray(added + entering @ np.diag(bound**2 / 3.0) @ entering.T)


def _of_a_step(system: HybridSystem, followed: Followed | ResidualGenerator, noise: FloatArray) -> FloatArray:
    from deshybrid.linear.sampling import sample_covariance

    return noise if system.time_step is not None else sample_covariance(followed.dynamics.A, noise, followed.step)


__all__ = ["measurement_covariance", "process_covariance", "white_generator"]
