"""Random runs of a stochastic system, for matched simulation: any number of trials, the same seed the same numbers.

In: a `StochasticSystem`, a number of rows, a seed; the modes where they shall be given ones.  Out: `Runs`.
The mode of a row governs the step that leads to it and its measurement.  One draw for each state and output of a row.
Source: Hwang et al. (2006), equations (1) and (2).
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.sampling import covariance_root
from deshybrid.stochastic.belief import read_only
from deshybrid.stochastic.lanes import times
from deshybrid.stochastic.noise import at
from deshybrid.stochastic.switching import ModeNumbers
from deshybrid.stochastic.system import StochasticSystem


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """True modes (..., N) by number, true x (..., N, n), and z (..., N, p), NaN where a mode does not measure."""

    modes: ModeNumbers
    x: FloatArray
    z: FloatArray

    def __post_init__(self) -> None:
        for name in ("modes", "x", "z"):
            object.__setattr__(self, name, read_only(getattr(self, name)))


def sample(
    system: StochasticSystem, rows: int, *, seed: int, trials: tuple[int, ...] = (), modes: ArrayLike | None = None
) -> Runs:
    """Return runs without input; `modes` (N,) by number are those of every trial, by default drawn from the chain.

    Raises `UsageError` (DH1107) where `modes` does not fit.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> sample(calm_and_wild(), 50, seed=1, trials=(8,)).z.shape
    (8, 50, 1)
    """
    rng = np.random.default_rng(seed)
    bank = system.bank
    known = _drawn(system, rows, rng, trials) if modes is None else _given(system, rows, trials, modes)
    roots = {key: covariance_root(getattr(bank, key)) for key in "QR"}
    x = system.x + times(covariance_root(system.P), rng.standard_normal((*trials, len(system.x))))
    states, outputs = [], []
    for k in range(rows):
        mode = known[..., k]
        grown = _grown(bank.process_by_state, mode, x, rng)
        x = times(bank.F[mode], x) + bank.f[mode] + times(roots["Q"][mode], rng.standard_normal(x.shape)) + grown
        noise = times(roots["R"][mode], rng.standard_normal((*trials, bank.H.shape[1])))
        noise = noise + _grown(bank.measurement_by_state, mode, x, rng)
        if bank.tails is not None:
            share, factor = bank.tails[mode, 0], bank.tails[mode, 1]
            noise = noise * np.where(rng.random(trials) < share, np.sqrt(factor), 1.0)[..., None]
        z = times(bank.H[mode], x) + bank.g[mode] + noise
        states.append(x)
        outputs.append(np.where(bank.measured[mode], z, np.nan))
    return Runs(known, np.stack(states, axis=-2), np.stack(outputs, axis=-2))


def _grown(
    by_state: FloatArray | None, mode: ModeNumbers, x: FloatArray, rng: np.random.Generator
) -> FloatArray | float:
    """e G x with e drawn for each trial."""
    G = at(by_state, mode)
    return 0.0 if G is None else rng.standard_normal(mode.shape)[..., None] * times(G, x)


def _drawn(system: StochasticSystem, rows: int, rng: np.random.Generator, trials: tuple[int, ...]) -> ModeNumbers:
    heights = np.cumsum(system.chain.probability_to_from, axis=0)[:-1].T  # (from, to)
    start = np.cumsum(system.mu)[:-1]
    mode = (rng.random(trials)[..., None] >= start).sum(axis=-1)
    known = np.empty((*trials, rows), dtype=np.intp)
    for k in range(rows):
        mode = (rng.random(trials)[..., None] >= heights[mode]).sum(axis=-1)
        known[..., k] = mode
    return known


def _given(system: StochasticSystem, rows: int, trials: tuple[int, ...], modes: ArrayLike) -> ModeNumbers:
    known = np.asarray(modes)
    if known.shape != (rows,) or known.dtype.kind not in "iu" or not set(known.tolist()) <= set(range(len(system.mu))):
        text = f"`modes` has shape {known.shape}, expected ({rows},) with numbers below {len(system.mu)}"
        raise UsageError(diagnostic("DH1107", text))
    return np.broadcast_to(known.astype(np.intp), (*trials, rows)).copy()


__all__ = ["Runs", "sample"]
