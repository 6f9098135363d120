"""Kalman filters of single modes, linear or not, behind one small protocol: move a Gaussian, correct a Gaussian.

In: means x (..., n), covariances P (..., n, n), an input u (..., m), a measurement z (..., p), NaN where a channel is
missing; leading axes are trials.  Out: the next Gaussian.  Functions of a nonlinear mode take arrays with leading axes
and return such: f(x, u) -> (..., n), h(x, u) -> (..., p), and for the extended filter their Jacobians F(x, u) and
H(x, u).  u is None where there is no input.

O(n³ + p³) a step.  Source: Bar-Shalom, Li and Kirubarajan (2001), chapters 5 and 10; Julier and Uhlmann (2004) with
the weights of van der Merwe (2004).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, TypeAlias

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import gaussian, noise
from deshybrid.stochastic.gaussian import Correction
from deshybrid.stochastic.lanes import cholesky, product, symmetric, times
from deshybrid.stochastic.system import Mode

Function: TypeAlias = Callable[[FloatArray, FloatArray | None], FloatArray]
Gaussian: TypeAlias = tuple[FloatArray, FloatArray]


class ModeFilter(Protocol):
    """One mode's filter; `n` is the number of its states."""

    @property
    def name(self) -> str:
        """The name of the mode."""

    @property
    def n(self) -> int:
        """The number of states."""

    def move(self, x: FloatArray, P: FloatArray, u: FloatArray | None) -> Gaussian:
        """Return the Gaussian one step later."""

    def correct(self, x: FloatArray, P: FloatArray, z: FloatArray, u: FloatArray | None) -> Correction:
        """Return the Gaussian given a measurement."""


@dataclass(frozen=True, slots=True, eq=False)
class LinearFilter:
    """The Kalman filter of a `Mode`, which measures the first p outputs.

    >>> still = LinearFilter(Mode("still", F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[1.0]]))
    >>> still.correct(np.zeros(1), np.eye(1), np.array([2.0]), None).x.round(12).tolist()
    [1.0]
    """

    mode: Mode

    @property
    def name(self) -> str:
        """The name of the mode."""
        return self.mode.name

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.mode.f)

    def move(self, x: FloatArray, P: FloatArray, u: FloatArray | None) -> Gaussian:
        """Return the Gaussian one step later."""
        push = self.mode.f if u is None else times(self.mode.B, u) + self.mode.f
        Q = noise.grown(self.mode.Q, self.mode.noise.process_by_state, x, P)
        return gaussian.predict(x, P, self.mode.F, Q, push)

    def correct(self, x: FloatArray, P: FloatArray, z: FloatArray, u: FloatArray | None) -> Correction:
        """Return the Gaussian given a measurement."""
        offset = self.mode.g if u is None else times(self.mode.D, u) + self.mode.g
        form = self.mode.noise
        R = noise.grown(self.mode.R, form.measurement_by_state, x, P)
        tails = np.array([form.share, form.factor]) if form.share else None
        return noise.update(x, P, z - times(self.mode.H, x) - offset, self.mode.H, R, tails=tails)


@dataclass(frozen=True, slots=True, eq=False)
class ExtendedFilter:
    """The extended Kalman filter: f and h are linearised at the mean; Q (n, n), R (p, p).

    >>> square = ExtendedFilter(
    ...     "square", f=lambda x, u: x, h=lambda x, u: x**2, F=lambda x, u: np.ones((*x.shape, 1)),
    ...     H=lambda x, u: 2.0 * x[..., None], Q=np.zeros((1, 1)), R=np.eye(1),
    ... )
    >>> square.correct(np.array([1.0]), np.eye(1), np.array([2.0]), None).x.round(12).tolist()
    [1.4]
    """

    name: str
    f: Function
    h: Function
    F: Function
    H: Function
    Q: FloatArray
    R: FloatArray

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.Q)

    def move(self, x: FloatArray, P: FloatArray, u: FloatArray | None) -> Gaussian:
        """Return the Gaussian one step later."""
        F = self.F(x, u)
        return self.f(x, u), symmetric(product(product(F, P), F.swapaxes(-1, -2)) + self.Q)

    def correct(self, x: FloatArray, P: FloatArray, z: FloatArray, u: FloatArray | None) -> Correction:
        """Return the Gaussian given a measurement."""
        return gaussian.update(x, P, z - self.h(x, u), self.H(x, u), self.R)


@dataclass(frozen=True, slots=True, eq=False)
class UnscentedFilter:
    """The unscented Kalman filter: f and h are evaluated at 2 n + 1 points around the mean; Q (n, n), R (p, p).

    `spread` (alpha), `prior_knowledge` (beta) and `scaling` (kappa) as van der Merwe names them.

    >>> square = UnscentedFilter("square", f=lambda x, u: x, h=lambda x, u: x**2, Q=np.zeros((1, 1)), R=np.eye(1))
    >>> square.correct(np.array([1.0]), np.eye(1), np.array([2.0]), None).residual.round(12).tolist()  # 2 - E x²
    [0.0]
    """

    name: str
    f: Function
    h: Function
    Q: FloatArray
    R: FloatArray
    spread: float = 1.0
    prior_knowledge: float = 2.0
    scaling: float = 0.0

    @property
    def n(self) -> int:
        """The number of states."""
        return len(self.Q)

    def move(self, x: FloatArray, P: FloatArray, u: FloatArray | None) -> Gaussian:
        """Return the Gaussian one step later."""
        points, weights, scatter_weights = self._points(x, P)
        moved = self.f(points, None if u is None else u[..., None, :])
        mean = (weights[:, None] * moved).sum(axis=-2)
        spread = moved - mean[..., None, :]
        return mean, symmetric(product(spread.swapaxes(-1, -2) * scatter_weights, spread) + self.Q)

    def correct(self, x: FloatArray, P: FloatArray, z: FloatArray, u: FloatArray | None) -> Correction:
        """Return the Gaussian given a measurement."""
        points, weights, scatter_weights = self._points(x, P)
        expected = self.h(points, None if u is None else u[..., None, :])
        mean = (weights[:, None] * expected).sum(axis=-2)
        spread = expected - mean[..., None, :]
        weighted = spread.swapaxes(-1, -2) * scatter_weights
        cross = product(weighted, points - x[..., None, :])
        return gaussian.condition(x, P, z - mean, cross, product(weighted, spread) + self.R)

    def _points(self, x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray]:
        """The points (..., 2 n + 1, n), their weights for means and for covariances (2 n + 1,)."""
        n = self.n
        size = self.spread**2 * (n + self.scaling)
        with np.errstate(invalid="ignore", divide="ignore"):
            root = cholesky(size * P).swapaxes(-1, -2)
        gaussian.require_factor(P, root)
        centre = x[..., None, :]
        points = np.concatenate([centre, centre + root, centre - root], axis=-2)
        weights = np.full(2 * n + 1, 0.5 / size)
        weights[0] = 1.0 - n / size
        scatter = weights.copy()
        scatter[0] += 1.0 - self.spread**2 + self.prior_knowledge
        return points, weights, scatter


__all__ = ["ExtendedFilter", "Function", "Gaussian", "LinearFilter", "ModeFilter", "UnscentedFilter"]
