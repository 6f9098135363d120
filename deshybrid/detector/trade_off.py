"""The trade-off between disturbance, noise and speed: the gain of a residual generator as an optimisation.

In: a `Followed`, bounds, a rate σ.  Out: the generator of least residual variance among those whose error decays at
least at σ.  The error obeys e := (A - L C) e + (Y + L W) v - T d, the residual is r = C e - W v: for white v and d with
the deviations that the bounds state, its variance is least for the gain of the stationary Kalman predictor (the H₂
optimum), from one Riccati equation with correlated noises (Y couples them where something is decoupled).  For the
decay e^{σ h} A and its noises take the place of A (prescribed degree of stability): σ trades speed for variance.

The guarantee is not this variance: thresholds are peak gains of the result, as for any generator.

Cost: one discrete Riccati equation of size k.  Source: Anderson and Moore, Optimal Filtering (1979), section 5.4
(correlated noises); Anderson and Moore (1969), prescribed degree of stability.
"""

import numpy as np

from deshybrid.detector.residual import Followed, ResidualGenerator, generator_of, sampled_dynamics
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem

LEAST = 1e-6
"""This share of the sizes of states and outputs counts as noise besides: nothing is trusted without end."""
DEADBEAT = 1e-12
FILTERING = "H₂ filter, least variance at the wanted speed"


def filtering_generator(system: HybridSystem, followed: Followed, rate: float) -> ResidualGenerator:
    """Return the generator of least residual variance whose error decays at `rate` (1/s) at least.

    Raises `UsageError` (DH0613) where the Riccati equation has no solution in floating point.
    """
    step, k = followed.step, len(followed.A)
    if k == 0:
        return generator_of(followed, np.zeros((0, len(followed.C))), (), FILTERING)
    gain = _gain(system, followed, float(np.exp(rate * step)))
    values = np.linalg.eigvals(followed.A - gain @ followed.C).astype(np.complex128)
    moduli = np.maximum(np.abs(values), DEADBEAT)
    poles = (np.log(moduli) + 1j * np.angle(values)) / step
    return generator_of(followed, gain, tuple(complex(pole) for pole in poles), FILTERING)


def _gain(system: HybridSystem, followed: Followed, growth: float) -> FloatArray:
    from scipy.linalg import LinAlgError, solve_discrete_are

    process, measurement = _noises(system, followed)
    Q = process + followed.Y @ measurement @ followed.Y.T
    R, S = followed.W @ measurement @ followed.W.T, -followed.Y @ measurement @ followed.W.T
    size = np.sqrt(np.diag(Q))
    inside, seen = growth * followed.A * size / size[:, None], followed.C * size
    scaled = growth**2 * Q / size / size[:, None], R, growth * S / size[:, None]
    try:
        P = solve_discrete_are(inside.T, seen.T, scaled[0], scaled[1], s=scaled[2])
    except (LinAlgError, ValueError) as error:
        text = f"no filter of location `{followed.location.name}` weighs disturbance against noise: {error}"
        helps = ("state bounds of disturbance and measurement, or take the design `luenberger`",)
        raise UsageError(diagnostic("DH0613", text, followed.location.span, helps=helps)) from None
    whole = inside @ P @ seen.T + scaled[2]
    return np.asarray(size[:, None] * np.linalg.solve((seen @ P @ seen.T + R).T, whole.T).T / growth)


def _noises(system: HybridSystem, followed: Followed) -> tuple[FloatArray, FloatArray]:
    """Covariances of T d (k, k) and of v (p, p): bounds as deviations, and a little of everything."""
    dynamics, bounds = followed.dynamics, system.bounds
    own = list(followed.location.output_index)
    state = np.ones(dynamics.A.shape[0]) if bounds.state is None else bounds.state
    sizes = np.linalg.norm(dynamics.C * state, axis=1)
    floor = LEAST * np.where(sizes > 0.0, sizes, 1.0)
    sensor = floor if bounds.measurement is None else np.hypot(bounds.measurement[own], floor)
    pushed = LEAST * np.linalg.norm(followed.T * state, axis=1)
    process = np.diag(np.where(pushed > 0.0, pushed, LEAST) ** 2)
    if bounds.disturbance is not None:
        entering = followed.T @ sampled_dynamics(system, dynamics, followed.step).E * bounds.disturbance
        process = process + entering @ entering.T
    return process, np.diag(sensor**2)


__all__ = ["filtering_generator"]
