"""Prediction errors of one location: the Kalman filter that predicts each sample from those before it.

In: a location's dynamics, a step, and the sizes of what is not known: white noise of each output, and disturbances that
wander and forget.  Out: whitened prediction errors of stretches, and the logarithm of the size by which they were
whitened.

    x' = A x + B u + E w + f,   w' = -w / memory + (white),   y = C x + D u + g + (white)

The filter starts without knowledge of x and w, so the first errors of a stretch weigh nothing and its initial state is
free.  Its gains do not depend on the data: they are computed once for each location, until they no longer change.

Cost: O((n + r)³) a sample until then, O((n + r)²) afterwards.  Source: Ljung, System Identification, sections 4.3, 7.
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.fit.stretches import Stretch
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.linear.sampling import flow_and_integral, sample_covariance, sample_dynamics

UNKNOWN = 100.0  # by which the start's standard deviation exceeds the size of a state
_SETTLED = 1e-9  # relative change of gain and covariance from one sample to the next, below which they stay
_LOOK = 8  # samples between two looks at that


@dataclass(frozen=True, slots=True, eq=False)
class Doubt:
    """What is not known: standard deviations of the outputs' noise (p,), intensities of the wandering disturbances (r,)
    in their unit per square root of a second, zero where one does not wander, their memories (r,) in s, and sizes of
    the start (n,) and (r,).
    """

    noise: FloatArray
    drift: FloatArray
    memory: FloatArray
    state: FloatArray
    disturbance: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Predictor:
    """One location: x := (A - K C) x + (B - K D) u + K (y - g) + f predicts y; gains and whitening by sample."""

    dynamics: LinearDynamics
    A: FloatArray
    C: FloatArray
    gains: tuple[FloatArray, ...]
    whitening: tuple[FloatArray, ...]

    def errors(self, stretch: Stretch) -> tuple[FloatArray, float]:
        """Return the whitened prediction errors (N, p) of a stretch, and the sum of log det of their covariances."""
        last = len(self.gains) - 1
        places = np.minimum(np.arange(len(stretch.outputs)), last)
        gains, whitening = np.array(self.gains)[places], np.array(self.whitening)[places]
        shown = stretch.outputs - stretch.inputs @ self.dynamics.D.T - self.dynamics.g
        n = len(self.dynamics.A)
        push = np.einsum("kij,kj->ki", gains, shown)
        push[:, :n] += stretch.inputs @ self.dynamics.B.T + self.dynamics.f
        flows = [self.A - gain @ self.C for gain in self.gains]
        x = np.zeros(len(self.A))
        expected = np.empty((len(shown), len(x)))
        for k, place in enumerate(places.tolist()):
            expected[k] = x
            x = flows[place] @ x + push[k]
        white = np.einsum("kij,kj->ki", whitening, shown - expected @ self.C.T)
        return white, -2.0 * float(np.log(np.diagonal(whitening, axis1=1, axis2=2)).sum())


def build_predictor(
    dynamics: LinearDynamics, doubt: Doubt, *, step: float, is_sampled: bool, samples: int
) -> Predictor:
    """Return the predictor of a location for stretches of at most so many samples, `step` seconds apart.

    Raises `numpy.linalg.LinAlgError` where the covariance of a prediction error is not positive definite.
    """
    n, p = len(dynamics.A), len(dynamics.C)
    wandering = np.flatnonzero((doubt.drift > 0.0) & np.abs(dynamics.E).any(axis=0))
    r = len(wandering)
    intensity = np.zeros((n + r, n + r))
    intensity[n:, n:] = np.diag(doubt.drift[wandering] ** 2)
    A, C = np.zeros((n + r, n + r)), np.hstack([dynamics.C, np.zeros((p, r))])
    A[:n, :n], A[:n, n:] = dynamics.A, dynamics.E[:, wandering]
    if is_sampled:
        sampled, Q = dynamics, intensity * step
        A[n:, n:] = np.diag(np.exp(-step / doubt.memory[wandering]))
    else:
        A[n:, n:] = -np.diag(1.0 / doubt.memory[wandering])
        sampled, Q = sample_dynamics(dynamics, step), sample_covariance(A, intensity, step)
        A, _ = flow_and_integral(A, np.zeros((n + r, 0)), step)
    P = np.diag(np.concatenate([doubt.state, doubt.disturbance[wandering]]) * UNKNOWN) ** 2
    gains, whitening = _riccati(A, C, Q=Q, R=np.diag(doubt.noise**2), P=P, samples=samples)
    return Predictor(sampled, A, C, gains, whitening)


def _riccati(
    A: FloatArray, C: FloatArray, *, Q: FloatArray, R: FloatArray, P: FloatArray, samples: int
) -> tuple[tuple[FloatArray, ...], tuple[FloatArray, ...]]:
    """The gains and whitening matrices of the first samples, up to the one from which on they stay."""
    gains: list[FloatArray] = []
    covariances: list[FloatArray] = []
    for sample in range(samples):
        shown = C @ P
        S = shown @ C.T + R
        gain = A @ np.linalg.solve(S, shown).T
        flow = A - gain @ C
        P = flow @ P @ flow.T + gain @ R @ gain.T + Q
        P = 0.5 * (P + P.T)
        gains.append(gain)
        covariances.append(S)
        if sample % _LOOK == _LOOK - 1 and _same(gain, gains[-2]) and _same(S, covariances[-2]):
            break
    return tuple(gains), tuple(np.linalg.inv(np.linalg.cholesky(np.array(covariances))))


def _same(matrix: FloatArray, before: FloatArray) -> bool:
    return bool(np.abs(matrix - before).max() <= _SETTLED * np.abs(matrix).max())


__all__ = ["Doubt", "Predictor", "build_predictor"]
