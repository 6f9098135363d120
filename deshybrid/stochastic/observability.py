"""Observability of a stochastic linear hybrid system as Hwang et al. (2003) state it, read literally.

In: a `StochasticSystem`.  Out: the verdicts of Lemma 2 (the first mode), Lemma 3 (the first switch), Theorem 1 (both).
Covariances of outputs are compared, never means; Π₀, the covariance of the state at the first row, is the prior's P.

What the paper says and what holds:
- Lemma 2 compares windows of κ = τ̄ rows, τ̄ the joint observability index.  That is sufficient and not necessary: the
  covariance is a leading block of that of a longer window, where modes may still differ; at τ̄ = 1 no process noise is
  seen at all.  It takes one Π₀ for all modes; so read, it calls the paper's own example without noise observable, which
  the paper calls unobservable, since other states of the other mode give the same outputs.
- Lemma 3 compares the one row at the switch, H' M H'ᵀ + R' against H M Hᵀ + R with the same M.  Where H and R are
  common to the modes both sides are identical, so that Theorem 1 declares both of the paper's aircraft unobservable.
  In the paper's indexing a mode governs the step that leaves its rows, so that the switch shows one row later.

`deshybrid.stochastic.telling_apart` says what holds on a window.  O(M² τ̄² n² p).
Source: Hwang, Balakrishnan and Tomlin (2003), section 2.
"""

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.observability import observability_index
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.outputs import OutputGaussian, staying
from deshybrid.stochastic.system import Mode, StochasticSystem

ROUNDING = 1e-9
"""Two covariances are equal where every entry agrees up to this share of what the diagonal allows it."""


@dataclass(frozen=True, slots=True)
class LiteralVerdict:
    """The two lemmas by what violates them; `index` is τ̄, None where a mode is not observable."""

    index: int | None
    unobservable: tuple[str, ...]
    equal_modes: tuple[tuple[str, str], ...]
    equal_switches: tuple[tuple[str, str], ...]

    @property
    def lemma_2(self) -> bool:
        """Every mode is observable, and no two have equal covariances of τ̄ rows."""
        return self.index is not None and not self.equal_modes

    @property
    def lemma_3(self) -> bool:
        """No switch leaves the covariance of the row at the switch as it is."""
        return self.index is not None and not self.equal_switches

    @property
    def theorem_1(self) -> bool:
        """Both lemmas."""
        return self.lemma_2 and self.lemma_3


def literal_verdict(system: StochasticSystem) -> LiteralVerdict:
    """Return what the paper's lemmas say; Lemma 3 with a switch τ̄ rows after the first.

    Raises `UsageError` (DH1103) where modes measure different outputs.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> literal = literal_verdict(calm_and_wild())  # process noise alone differs: not in one row
    >>> literal.index, literal.equal_modes, literal.equal_switches
    (1, (('calm', 'wild'),), (('calm', 'wild'), ('wild', 'calm')))
    """
    system.comparable_bank  # noqa: B018 - refuses modes whose outputs cannot be compared
    indices = {mode.name: observability_index(mode.F, mode.H) for mode in system.modes}
    found = [index for index in indices.values() if index is not None]
    unobservable = tuple(name for name, index in indices.items() if index is None)
    if unobservable:
        return LiteralVerdict(None, unobservable, (), ())
    index = max(found)
    seen = {mode.name: staying(mode, index, x=system.x, P=system.P).covariance for mode in system.modes}
    equal = tuple((a, b) for a, b in combinations(system.names, 2) if covariances_agree(seen[a], seen[b]))
    switches = tuple((a.name, b.name) for a, b in permutations(system.modes, 2) if _hidden(a, b, system.P, index))
    return LiteralVerdict(index, (), equal, switches)


def covariances_agree(first: FloatArray, second: FloatArray) -> bool:
    """Return whether two covariances are equal up to rounding, in whatever units.

    >>> covariances_agree(np.diag([1.0, 1e-12]), np.diag([1.0, 2e-12]))
    False
    """
    return bool(_agreement(first, second).all())


def rows_that_agree(first: OutputGaussian, second: OutputGaussian) -> tuple[int, int]:
    """Return the longest windows whose outputs have equal covariances, and equal means and covariances; N for "all".

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> calm, wild = (staying(mode, 9, x=[0.0], P=[[1.0]]) for mode in calm_and_wild().modes)
    >>> rows_that_agree(calm, wild)
    (1, 1)
    """
    p = len(first.mean) // first.rows
    size = np.sqrt(np.maximum(first.covariance.diagonal(), second.covariance.diagonal()))
    equal = _agreement(first.covariance, second.covariance)
    scale = size + np.maximum(np.abs(first.mean), np.abs(second.mean))
    means = np.abs(first.mean - second.mean) <= ROUNDING * scale
    covariance = [bool(equal[:end, :end].all()) for end in range(p, len(means) + 1, p)]
    both = [agree and bool(means[: p * (k + 1)].all()) for k, agree in enumerate(covariance)]
    return sum(covariance), sum(both)


def _agreement(first: FloatArray, second: FloatArray) -> np.ndarray[tuple[int, ...], np.dtype[np.bool_]]:
    size = np.sqrt(np.maximum(first.diagonal(), second.diagonal()))
    agree: np.ndarray[tuple[int, ...], np.dtype[np.bool_]] = np.abs(first - second) <= ROUNDING * np.outer(size, size)
    return agree


def _hidden(source: Mode, target: Mode, P: FloatArray, steps: int) -> bool:
    """Lemma 3: both sides agree, M being the state's covariance `steps` steps of the source after P."""
    require_fixed_noise((source, target), "Lemma 3")
    M = P
    for _ in range(steps):
        M = source.F @ M @ source.F.T + source.Q
    return covariances_agree(target.H @ M @ target.H.T + target.R, source.H @ M @ source.H.T + source.R)


__all__ = ["ROUNDING", "LiteralVerdict", "covariances_agree", "literal_verdict", "rows_that_agree"]
