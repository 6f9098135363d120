"""What a multiple-model filter holds: one Gaussian for each mode, and the probabilities of the modes.

In: arrays with any leading axes (trials, targets).  Out: `Belief`, its mixture, and `Posterior`, a belief after a
measurement.  Probabilities are kept as logarithms: a mode that is out of the race by a factor e^1000 can come back.
Source: Hwang et al. (2006), section 3.
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.gaussian import times
from deshybrid.stochastic.system import StochasticSystem


def read_only(array: FloatArray) -> FloatArray:
    """Return the array itself where it is read-only, else a read-only copy.

    >>> read_only(np.zeros(1)).flags.writeable
    False
    """
    if array.flags.writeable:
        array = array.copy()
        array.flags.writeable = False
    return array


def log_sum(values: FloatArray) -> FloatArray:
    """Return log Σ exp over the last axis, without overflow; -inf where every term is.

    >>> float(log_sum(np.array([-1000.0, -1000.0]))) == -1000.0 + float(np.log(2.0))
    True
    """
    largest = values.max(axis=-1, keepdims=True)
    shift = np.where(np.isfinite(largest), largest, 0.0)
    with np.errstate(divide="ignore"):
        total: FloatArray = np.log(np.exp(values - shift).sum(axis=-1)) + shift[..., 0]
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
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @classmethod
    def prior(cls, system: StochasticSystem, trials: tuple[int, ...] = ()) -> "Belief":
        """Return the system's prior in every mode, for `trials` (any leading axes) at once.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> Belief.prior(calm_and_wild(), (100,)).x.shape
        (100, 2, 1)
        """
        modes, n = len(system.modes), len(system.x)
        return cls(
            np.broadcast_to(system.x, (*trials, modes, n)).copy(),
            np.broadcast_to(system.P, (*trials, modes, n, n)).copy(),
            np.broadcast_to(log_probability(system.mu), (*trials, modes)).copy(),
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
        return mixture_covariance(self.mu, self.x - self.mean[..., None, :], self.P)


def mixture_covariance(weights: FloatArray, spread: FloatArray, P: FloatArray) -> FloatArray:
    """Return Σ_i w_i (P_i + d_i d_iᵀ); weights (..., M), spread d (..., M, n), P (..., M, n, n).

    >>> mixture_covariance(np.array([0.5, 0.5]), np.array([[1.0], [-1.0]]), np.ones((2, 1, 1))).tolist()
    [[2.0]]
    """
    flat = P.reshape(*P.shape[:-2], -1)
    inside = (weights[..., None, :] @ flat).reshape(*weights.shape[:-1], *P.shape[-2:])
    between: FloatArray = (spread * weights[..., None]).swapaxes(-1, -2) @ spread
    return inside + between


@dataclass(frozen=True, slots=True, eq=False)
class Posterior:
    """A belief after a measurement, with log p(z | what was seen before) and the residual's statistics.

    residual (..., M, p) and S (..., M, p, p) are those of each mode; `log_likelihood` (...) and `nis` (...) those of
    the predicted mixture: the squared residual in units of its covariance, a channel that was missing left out.
    """

    belief: Belief
    log_likelihood: FloatArray
    residual: FloatArray
    S: FloatArray
    nis: FloatArray


__all__ = ["Belief", "Posterior", "log_probability", "log_sum", "mixture_covariance", "read_only"]
