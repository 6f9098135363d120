"""The hysteresis of a relay from a demanded rate of false alarms: how often noise alone switches it off and on again.

The residual of a generator is taken as its mean plus stationary Gaussian noise, with the deviation σ and the
correlation ρ of neighbouring samples that follow from the noise model (`innovation`) through the generator.  A relay
goes off where a row rises above its release level, and on where it falls below its threshold.  Wherever the mean is,
one of the two is at least half of what lies between them away from it, and to go off and on again the residual must
pass both: on either side of zero and in each of the q rows this happens at most as often as the noise rises above

    u = (release - 1) threshold / (2 σ)

deviations.  Samples of a Gaussian process do so at the rate

    ν(u) = (1/h) ∫ exp(-u²/(1 + sin θ)) dθ / 2π,   θ from asin ρ to π/2,

which is the probability of being below u at one sample and above it at the next; for short steps it tends to Rice's
formula, √(-ρ''(0)) exp(-u²/2) / 2π.  The release is the least for which 2 q ν(u) is the demanded rate.  Debounce only
makes false alarms rarer: a relay that noise has put on between its levels mostly stays on.

In: a system, a generator with its levels, a rate.  Out: a release factor, or the rate for one.
Cost: a Lyapunov equation, and a quadrature for each bisection.
Source: Rice (1945), Mathematical Analysis of Random Noise, section 3.3; the integral is Plackett's (1954) for the
bivariate normal distribution.
"""

import numpy as np

from deshybrid.detector.innovation import measurement_covariance, process_covariance
from deshybrid.detector.levels import Part
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem

NODES = 200
HALVINGS = 60


def crossing_rate(level: float, correlation: float, step: float) -> float:
    """Return how often a second a Gaussian process of deviation 1 rises above a level between samples; step in s.

    `correlation` is that of neighbouring samples.

    >>> round(crossing_rate(0.0, 0.0, 1.0), 6)  # a quarter of the pairs of independent samples rise through the mean
    0.25
    """
    nodes, weights = np.polynomial.legendre.leggauss(NODES)
    low, high = np.arcsin(np.clip(correlation, -1.0, 1.0)), np.pi / 2.0
    angles = low + (high - low) * (nodes + 1.0) / 2.0
    with np.errstate(over="ignore", divide="ignore"):
        heights = np.exp(-(level**2) / (1.0 + np.sin(angles)))
    return float(weights @ heights * (high - low) / 2.0 / (2.0 * np.pi) / step)


def switching_rate(system: HybridSystem, part: Part, release: float) -> float:
    """Return how often a second (1/s) noise alone switches the relay of a generator off and on at most.

    Raises `UsageError` (DH0614) where the model states no measurement noise.
    """
    return _rate(*_noise(system, part), part.generator.step, release)


def hysteresis(system: HybridSystem, part: Part, rate: float) -> float:
    """Return the least release factor with which noise alone switches the relay at most at this rate (1/s).

    Raises `UsageError` (DH0614) where the model states no measurement noise.
    """
    shares, correlations = _noise(system, part)
    step, low, high = part.generator.step, 1.0, 2.0
    if _rate(shares, correlations, step, low) <= rate:
        return low
    while _rate(shares, correlations, step, high) > rate:
        low, high = high, 2.0 * high
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _rate(shares, correlations, step, middle) > rate else (low, middle)
    return high


def _rate(shares: FloatArray, correlations: FloatArray, step: float, release: float) -> float:
    moving = ((share, rho) for share, rho in zip(shares, correlations, strict=True) if share > 0.0)
    return sum(2.0 * crossing_rate((release - 1.0) / (2.0 * share), rho, step) for share, rho in moving)


def _noise(system: HybridSystem, part: Part) -> tuple[FloatArray, FloatArray]:
    """By row: the deviation of the residual in units of its threshold, and the correlation of neighbouring samples."""
    from scipy.linalg import solve_discrete_lyapunov

    g = part.generator
    V, Q = measurement_covariance(system, g.location), process_covariance(system, g)
    k = len(g.F)
    drive = g.gain @ V @ g.gain.T + g.T @ Q @ g.T.T
    P = solve_discrete_lyapunov(g.F, drive) if k else np.zeros((0, 0))
    variance = np.diag(g.H @ P @ g.H.T + g.J @ V @ g.J.T)
    next_one = np.diag(g.H @ (g.F @ P @ g.H.T + g.gain @ V @ g.J.T))
    correlation = np.divide(next_one, variance, out=np.zeros(len(variance)), where=variance > 0.0)
    return np.sqrt(variance) / part.threshold.level, correlation


__all__ = ["crossing_rate", "hysteresis", "switching_rate"]
