"""Filter gains: the stationary Kalman-Bucy (or Kalman) gain of one location, made fast enough by a shift.

In: a location's Kalman split, its noises, rates σ (1/s).  Out: gains.  The idea: the gain that is best for A + σ I
leaves every eigenvalue of A - G C left of -σ (prescribed degree of stability); σ = 0 is the filter of least error
variance.  In sampled time e^{σ h} A takes the place of A + σ I, and the gain is that of the predictor.  Only the
observable part is filtered; the gain of the rest decouples it as far as it can, as for placed poles.

The noises of a location are, in this order: its `noise` covariances; those of a disturbance and of sensor errors as
large as `bounds` say, E diag(w²) Eᵀ and diag(v²); else a push that would move every state by its own size within 1/μ
and sensor errors of 1 % of an output's size.  A thousandth of these defaults is always added, so that the filter trusts
neither the model nor a sensor without end.  Only the ratio of the two noises matters for the gain.

One Riccati equation a gain, O(n^3).  Source: Kalman and Bucy (1961); Anderson and Moore (1969), "Linear system
optimisation with prescribed degree of stability".
"""

from collections.abc import Iterator
from math import exp
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.placement import decoupling_gain
from deshybrid.continuous.search import GainTask
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.observability import KalmanSplit
from deshybrid.model.system import HybridSystem

SENSOR = 0.01
"""Where nothing is said of a sensor, its errors are this share of the output's size."""
FLOOR = 1e-3
"""This share of the default noises (as deviations) is always added."""


class Noise(NamedTuple):
    """Process noise (n, n) and measurement noise (p, p): covariances, or their intensities in continuous time."""

    process: FloatArray
    measurement: FloatArray


def location_noise(system: HybridSystem, name: str, scale: FloatArray, rate: float) -> Noise:
    """Return the noises of a location as described above; scale (n,): sizes of the states, rate (1/s): μ."""
    location = system.location(name)
    location.noise_form.require_fixed("a stationary Kalman gain", name)
    dynamics = location.dynamics
    if dynamics is None:
        return Noise(np.zeros((0, 0)), np.zeros((0, 0)))
    push = scale * rate * (1.0 if system.time_step is None else system.time_step)
    sizes = np.linalg.norm(dynamics.C * scale, axis=1)
    sensor = SENSOR * np.where(sizes > 0, sizes, 1.0)
    process, measurement = location.process_noise, location.measurement_noise
    if process is None and system.bounds.disturbance is not None:
        moved = dynamics.E * system.bounds.disturbance
        process = moved @ moved.T
    if measurement is None and system.bounds.measurement is not None:
        measurement = np.diag(system.bounds.measurement[list(location.output_index)] ** 2)
    process = np.diag(push**2) if process is None else process + np.diag((FLOOR * push) ** 2)
    measurement = np.diag(sensor**2) if measurement is None else measurement + np.diag((FLOOR * sensor) ** 2)
    return Noise(np.asarray(process), np.asarray(measurement))


def filter_gain(split: KalmanSplit, noise: Noise, shift: float, *, step: float | None = None) -> FloatArray | None:
    """Return the gain (n, p) for A + shift I (e^{shift h} A); None where floating point does not find it.

    >>> from deshybrid.linear.observability import kalman_split
    >>> split = kalman_split(np.zeros((1, 1)), np.eye(1))
    >>> filter_gain(split, Noise(4 * np.eye(1), np.eye(1)), 0.0).round(6).tolist()  # sqrt(4/1)
    [[2.0]]
    """
    k = split.observable_dimension
    if k == 0:
        return np.zeros((len(split.transform), len(split.C_o)))
    process = split.inverse[:k] @ noise.process @ split.inverse[:k].T
    upper = _riccati_gain(split.A_o, split.C_o, Noise(process, noise.measurement), shift, step)
    return None if upper is None else np.asarray(split.transform @ np.vstack([upper, decoupling_gain(split)]))


def filter_gains(task: GainTask, noise: Noise, speed: float) -> Iterator[FloatArray]:
    """Yield the filter as it is, and the one whose error decays at `speed` (1/s) at least."""
    for shift in (0.0, speed):
        gain = filter_gain(task.split, noise, shift, step=task.step)
        if gain is not None:
            yield gain


def error_variance(F: FloatArray, gain: FloatArray, noise: Noise, scale: FloatArray, step: float | None) -> float:
    """Return the stationary variance of the estimation error in one location: the trace, every state in its own size.

    F = A - G C has to decay.

    >>> error_variance(-np.eye(1), np.eye(1), Noise(np.zeros((1, 1)), np.eye(1)), np.ones(1), None)
    0.5
    """
    from scipy.linalg import solve_continuous_lyapunov, solve_discrete_lyapunov

    pushed = noise.process + gain @ noise.measurement @ gain.T
    pushed, inside = pushed / scale / scale[:, None], F * scale / scale[:, None]
    solved = solve_continuous_lyapunov(inside, -pushed) if step is None else solve_discrete_lyapunov(inside, pushed)
    return float(np.trace(solved))


def _riccati_gain(A: FloatArray, C: FloatArray, noise: Noise, shift: float, step: float | None) -> FloatArray | None:
    """Solved with states of equal deviation and sensors of unit noise."""
    from scipy.linalg import LinAlgError, solve_continuous_are, solve_discrete_are

    sizes = np.sqrt(np.diag(noise.process))
    whitening = np.linalg.inv(np.linalg.cholesky(noise.measurement))
    rows, W = whitening @ C * sizes, noise.process / sizes / sizes[:, None]
    inside, one = A * sizes / sizes[:, None], np.eye(len(C))
    moved = inside + shift * np.eye(len(A)) if step is None else inside * exp(shift * step)
    if not np.isfinite(moved).all():
        return None
    try:
        P = (solve_continuous_are if step is None else solve_discrete_are)(moved.T, rows.T, W, one)
    except (LinAlgError, ValueError):
        return None
    gain = P @ rows.T
    if step is not None:
        gain = inside @ np.linalg.solve((rows @ P @ rows.T + one).T, gain.T).T
    found = np.asarray(sizes[:, None] * gain @ whitening)
    return found if np.isfinite(found).all() else None


__all__ = ["FLOOR", "SENSOR", "Noise", "error_variance", "filter_gain", "filter_gains", "location_noise"]
