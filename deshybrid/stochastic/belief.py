"""What a multiple-model filter holds: one Gaussian for each mode, and the probabilities of the modes.

In: arrays with any leading axes (trials, targets).  Out: `Belief`, its mixture, and `Posterior`, a belief after a
measurement.  Probabilities are kept as logarithms: a mode that is out of the race by a factor e^1000 can come back.
Source: Hwang et al. (2006), section 3.
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.gating import Judgement
from deshybrid.stochastic.gaussian import squared_norm
from deshybrid.stochastic.lanes import product, times, trials_last
from deshybrid.stochastic.system import StochasticSystem


def read_only(array: FloatArray) -> FloatArray:
    """Return the array itself where it is read-only, else a read-only copy.

    >>> read_only(np.zeros(1)).flags.writeable
    False
    """
    return sealed(array.copy(order="K")) if array.flags.writeable else array


def sealed(array: FloatArray) -> FloatArray:
    """Return the array itself, read-only from now on: for arrays that nobody else holds.

    >>> sealed(np.zeros(1)).flags.writeable
    False
    """
    array.flags.writeable = False
    return array


def log_sum(values: FloatArray) -> FloatArray:
    """Return log Σ exp over the last axis, without overflow; -inf where every term is.

    >>> float(log_sum(np.array([-1000.0, -1000.0]))) == -1000.0 + float(np.log(2.0))
    True
    """
    total: FloatArray = np.logaddexp.reduce(values, axis=-1)
    return total


def log_probability(values: FloatArray) -> FloatArray:
    """Return the logarithm, -inf for 0.

    >>> log_probability(np.array([1.0, 0.0])).tolist()
    [0.0, -inf]
    """
    with np.errstate(divide="ignore"):
        logarithm: FloatArray = np.log(values)
    return logarithm


@dataclass(frozen=True, slots=True, eq=False)
class Belief:
    """x (..., M, n), P (..., M, n, n), log_mu (..., M) with Σ exp(log_mu) = 1; read-only.

    After `predict` it is the prior of a step and `log_mu` the predicted probabilities, so that `mean` and `covariance`
    are those of the predicted mixture; after `update` they are those of the posterior.
    """

    x: FloatArray
    P: FloatArray
    log_mu: FloatArray

    def __post_init__(self) -> None:
        for name in ("x", "P", "log_mu"):
            array = getattr(self, name)
            if array.flags.writeable:
                object.__setattr__(self, name, read_only(array))

    @classmethod
    def prior(cls, system: StochasticSystem, trials: tuple[int, ...] = ()) -> "Belief":
        """Return the system's prior in every mode, for `trials` (any leading axes) at once.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> Belief.prior(calm_and_wild(), (100,)).x.shape
        (100, 2, 1)
        """
        modes, n = len(system.modes), len(system.x)
        return cls(
            trials_last(np.broadcast_to(system.x, (*trials, modes, n)), 2),
            trials_last(np.broadcast_to(system.P, (*trials, modes, n, n)), 3),
            trials_last(np.broadcast_to(log_probability(system.mu), (*trials, modes)), 1),
        )

    @property
    def mu(self) -> FloatArray:
        """Probabilities of the modes (..., M)."""
        probabilities: FloatArray = np.exp(self.log_mu)
        return probabilities

    @property
    def mean(self) -> FloatArray:
        """Mean of the mixture (..., n)."""
        return times(self.x.swapaxes(-1, -2), self.mu)

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the mixture (..., n, n): the modes' own, and their spread around the mean."""
        return self.mixture()[1]

    def mixture(self) -> tuple[FloatArray, FloatArray]:
        """Return `mean` and `covariance` together.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> [part.tolist() for part in Belief.prior(calm_and_wild()).mixture()]
        [[0.0], [[1.0]]]
        """
        mu = self.mu
        mean = times(self.x.swapaxes(-1, -2), mu)
        return mean, mixture_covariance(mu, self.x - mean[..., None, :], self.P)


def mixture_covariance(weights: FloatArray, spread: FloatArray, P: FloatArray) -> FloatArray:
    """Return Σ_i w_i (P_i + d_i d_iᵀ); weights (..., M), spread d (..., M, n), P (..., M, n, n).

    >>> mixture_covariance(np.array([0.5, 0.5]), np.array([[1.0], [-1.0]]), np.ones((2, 1, 1))).tolist()
    [[2.0]]
    """
    total = _weighted_scatter(weights[..., 0], spread[..., 0, :], P[..., 0, :, :])
    for i in range(1, P.shape[-3]):
        total += _weighted_scatter(weights[..., i], spread[..., i, :], P[..., i, :, :])
    return total


def _weighted_scatter(weight: FloatArray, spread: FloatArray, P: FloatArray) -> FloatArray:
    scatter: FloatArray = spread[..., :, None] * spread[..., None, :]
    scatter = np.add(scatter, P, out=scatter) if scatter.shape == P.shape else scatter + P
    scatter *= weight[..., None, None]
    return scatter


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """A belief after a measurement, with log p(z | what was seen before) and the residuals that it was made from.

    `log_likelihood` (...) is that of the predicted mixture; `predicted_mu` (..., M), residual (..., M, p) and
    S (..., M, p, p) are those of each mode before the measurement, a missing channel with residual 0 and variance 1.
    `judgement` says where the measurement was an outlier and taken for missing, and holds the gate of the next row.
    """

    belief: Belief
    log_likelihood: FloatArray
    predicted_mu: FloatArray
    residual: FloatArray
    S: FloatArray
    judgement: Judgement

    @property
    def nis(self) -> FloatArray:
        """r̄ᵀ S̄⁻¹ r̄ (...) of the predicted mixture's residual: squared, in units of its covariance."""
        return squared_residual(self.predicted_mu, self.residual, self.S)


def squared_residual(mu: FloatArray, residual: FloatArray, S: FloatArray) -> FloatArray:
    """Return r̄ᵀ S̄⁻¹ r̄ of a mixture with weights mu (..., M), residuals (..., M, p), covariances S (..., M, p, p).

    >>> float(squared_residual(np.array([1.0]), np.array([[2.0]]), np.array([[[4.0]]])))
    1.0
    """
    mean = product(mu[..., None, :], residual)
    return squared_norm(mean[..., 0, :], mixture_covariance(mu, residual - mean, S))


__all__ = [
    "Belief",
    "Posterior",
    "log_probability",
    "log_sum",
    "mixture_covariance",
    "read_only",
    "sealed",
    "squared_residual",
]
