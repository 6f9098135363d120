"""The IMM over any filters: extended and unscented ones, and modes whose states differ in number or meaning.

In: one `ModeFilter` for each mode, their Markov chain, and for each pair of modes with different states the map that
turns an estimate of the one into one of the other.  Out: a belief, step by step.  It is the filter of
`deshybrid.stochastic.multiple`, mode by mode in place of all modes at once: the same numbers, slower.

A map x_to = matrix x_from + offset, with a covariance for what the other mode does not know: where a turning mode has
a turn rate that a straight mode has not, the rate is 0 with the variance that turns have.

O(M² n² + M n³) a row and trial.  Source: Hwang et al. (2006), section 3; Granström, Willett and Bar-Shalom (2015) for
modes with different states.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.stochastic.belief import log_probability, log_sum, mixture_covariance, squared_residual
from deshybrid.stochastic.filters import ModeFilter
from deshybrid.stochastic.gating import Gate, Judgement
from deshybrid.stochastic.gaussian import Correction
from deshybrid.stochastic.lanes import product, symmetric, times
from deshybrid.stochastic.multiple import weighed
from deshybrid.stochastic.system import ModeTransition


@dataclass(frozen=True, slots=True, eq=False)
class Conversion:
    """x_to = matrix x_from + offset, P_to = matrix P_from matrixᵀ + covariance; the matrix is (n_to, n_from)."""

    matrix: FloatArray
    offset: FloatArray
    covariance: FloatArray

    def __call__(self, x: FloatArray, P: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the Gaussian in the other mode's states."""
        moved = product(product(self.matrix, P), self.matrix.T) + self.covariance
        return times(self.matrix, x) + self.offset, symmetric(moved)


def conversion(
    matrix: ArrayLike, *, offset: ArrayLike | None = None, covariance: ArrayLike | None = None
) -> Conversion:
    """Return a conversion by its matrix (n_to, n_from); offset and covariance are zero by default.

    >>> conversion([[1.0], [0.0]], covariance=[[0.0, 0.0], [0.0, 4.0]])(np.array([3.0]), np.eye(1))[1].tolist()
    [[1.0, 0.0], [0.0, 4.0]]
    """
    map_ = np.asarray(matrix, dtype=np.float64)
    n = map_.shape[0]
    return Conversion(
        frozen_array(map_, map_.shape),
        frozen_array(np.zeros(n) if offset is None else offset, (n,)),
        frozen_array(np.zeros((n, n)) if covariance is None else covariance, (n, n)),
    )


@dataclass(frozen=True, slots=True, eq=False)
class ModeBelief:
    """One Gaussian for each mode, x[j] (..., n_j) and P[j] (..., n_j, n_j), and log_mu (..., M)."""

    x: tuple[FloatArray, ...]
    P: tuple[FloatArray, ...]
    log_mu: FloatArray

    @property
    def mu(self) -> FloatArray:
        """Probabilities of the modes (..., M)."""
        probabilities: FloatArray = np.exp(self.log_mu)
        return probabilities


@dataclass(frozen=True, slots=True, eq=False)
class Interacting:
    """Filters with their chain; `conversions[to, from]` by names where states differ in number, else optional.

    Raises `UsageError`: DH1104 where names differ from those of the chain, a conversion is missing or does not fit.

    >>> from deshybrid.stochastic.filters import LinearFilter
    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> walk = calm_and_wild()
    >>> Interacting([LinearFilter(mode) for mode in walk.modes], walk.chain).names
    ('calm', 'wild')
    """

    filters: Sequence[ModeFilter]
    chain: ModeTransition
    conversions: Mapping[tuple[str, str], Conversion] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "filters", tuple(self.filters))
        object.__setattr__(self, "conversions", dict(self.conversions))
        names = tuple(one.name for one in self.filters)
        if names != self.chain.modes:
            text = f"the chain is over the modes {self.chain.modes}, the filters are of {names}"
            raise UsageError(diagnostic("DH1104", text))
        for to in self.filters:
            for source in self.filters:
                given = self.conversions.get((to.name, source.name))
                if given is None and to.n == source.n:
                    continue
                if given is None or given.matrix.shape != (to.n, source.n):
                    have = "no conversion" if given is None else f"a conversion of shape {given.matrix.shape}"
                    text = f"there is {have} from mode `{source.name}` to `{to.name}`, expected ({to.n}, {source.n})"
                    raise UsageError(diagnostic("DH1104", text))

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the modes."""
        return self.chain.modes

    def prior(
        self, x: Sequence[ArrayLike], P: Sequence[ArrayLike], mu: ArrayLike, trials: tuple[int, ...] = ()
    ) -> ModeBelief:
        """Return the belief before the first row: x[j] (n_j,), P[j] (n_j, n_j), mu (M,).

        Raises `UsageError` (DH1104) where a shape does not fit.
        """
        sizes = [one.n for one in self.filters]
        try:
            means = [frozen_array(value, (n,)) for value, n in zip(x, sizes, strict=True)]
            spreads = [frozen_array(value, (n, n)) for value, n in zip(P, sizes, strict=True)]
            weights = frozen_array(mu, (len(sizes),))
        except (ValueError, TypeError) as error:
            raise UsageError(diagnostic("DH1104", f"the prior does not fit: {error}")) from None
        return ModeBelief(
            tuple(np.broadcast_to(mean, (*trials, *mean.shape)) for mean in means),
            tuple(np.broadcast_to(spread, (*trials, *spread.shape)) for spread in spreads),
            np.broadcast_to(log_probability(weights), (*trials, len(sizes))),
        )

    def seen_as(self, to: int, belief: ModeBelief) -> tuple[FloatArray, FloatArray]:
        """Return every mode's Gaussian in the states of mode `to`: (..., M, n_to), (..., M, n_to, n_to)."""
        name, parts = self.names[to], []
        for place, source in enumerate(self.names):
            change = self.conversions.get((name, source))
            own = (belief.x[place], belief.P[place])
            parts.append(own if change is None or place == to else change(*own))
        return np.stack([x for x, _ in parts], axis=-2), np.stack([P for _, P in parts], axis=-3)

    def mixture(self, belief: ModeBelief, to: int = 0) -> tuple[FloatArray, FloatArray]:
        """Return mean (..., n) and covariance (..., n, n) of all modes, in the states of mode `to`."""
        x, P = self.seen_as(to, belief)
        mean = product(belief.mu[..., None, :], x)
        return mean[..., 0, :], mixture_covariance(belief.mu, x - mean, P)

    def predict(self, belief: ModeBelief, u: FloatArray | None = None) -> ModeBelief:
        """Return the belief one step later: mixed through the conversions, then moved by each filter."""
        joint = log_probability(self.chain.probability_to_from) + belief.log_mu[..., None, :]
        log_mu = log_sum(joint)
        moved = []
        for j, one in enumerate(self.filters):
            x, P = self.seen_as(j, belief)
            with np.errstate(invalid="ignore"):
                weights = np.exp(joint[..., j, :] - log_mu[..., j, None])
            weights = np.where(np.isfinite(log_mu[..., j, None]), weights, np.eye(len(self.names))[j])
            mean = product(weights[..., None, :], x)
            moved.append(one.move(mean[..., 0, :], mixture_covariance(weights, x - mean, P), u))
        return ModeBelief(tuple(x for x, _ in moved), tuple(P for _, P in moved), log_mu)

    def update(
        self, belief: ModeBelief, z: FloatArray, u: FloatArray | None = None, *, gate: Gate | None = None
    ) -> "ModePosterior":
        """Return the belief after the measurement z (..., p), NaN where a channel is missing.

        With a gate an outlier counts as missing; the gate of the next row is `judgement.gate` of the posterior.

        Raises `UsageError`: DH1105 where a covariance is singular, DH1108 where numbers overflow.
        """
        done = self._corrected(belief, z, u)
        judgement = Judgement.none(z.shape[:-1])
        if gate is not None:
            judgement = gate.judge(np.stack([one.distance for one in done], axis=-1), belief.log_mu, z)
        if judgement.gated.any():
            done = self._corrected(belief, np.where(judgement.gated[..., None], np.nan, z), u)
        log_mu, log_likelihood = weighed(belief.log_mu, np.stack([one.log_likelihood for one in done], axis=-1))
        posterior = ModeBelief(tuple(one.x for one in done), tuple(one.P for one in done), log_mu)
        residual, S = np.stack([one.residual for one in done], axis=-2), np.stack([one.S for one in done], axis=-3)
        return ModePosterior(posterior, log_likelihood, squared_residual(belief.mu, residual, S), judgement)

    def _corrected(self, belief: ModeBelief, z: FloatArray, u: FloatArray | None) -> list[Correction]:
        return [one.correct(x, P, z, u) for one, x, P in zip(self.filters, belief.x, belief.P, strict=True)]


@dataclass(frozen=True, slots=True, eq=False)
class ModePosterior:
    """A belief after a measurement, with log p(z | before) (...) and the mixture's squared residual `nis` (...).

    `judgement` says where the measurement was an outlier and taken for missing, and holds the gate of the next row.
    """

    belief: ModeBelief
    log_likelihood: FloatArray
    nis: FloatArray
    judgement: Judgement


__all__ = ["Conversion", "Interacting", "ModeBelief", "ModePosterior", "conversion"]
