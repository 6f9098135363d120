"""Chance in a stochastic model: process noise, measurement noise, and locations that follow a Markov chain.

In: a system with `noise`, `prior`, `transition_probability`, and a seed.  Out: a `Chance` that a running plant asks.
Covariances mean what the filters of `stochastic` take them for: `process` is that of one step in discrete time, else an
intensity, of which a sub-step gets its share exactly; `measurement` is that of one sample.  The location at the end of
a sub-step decides.  Process noise is drawn where no bound of the disturbance is stated: a bound is never passed.
Without `transitions` the locations follow the chain, one draw a row: the location of a row governs the step that leads
to it and what is measured there; the prior lies one step before the first row.

One draw for each state of a sub-step and each output of a row.  Source: Hwang et al. (2006), (1) and (2).
"""

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.sampling import covariance_root, sample_covariance
from deshybrid.model.system import HybridSystem
from deshybrid.simulate.signals import CHAIN, PROCESS, SAMPLES, START, stream


class Chance:
    """What is drawn in one run; remembers how far its random streams have come, and nothing else."""

    def __init__(self, system: HybridSystem, seed: int, tick: float) -> None:
        for location in system.locations:
            location.noise_form.require_fixed("the simulation", location.name)
        self.system, self.seed = system, seed
        self.is_chain = system.probability_from_to is not None and not system.transitions
        self._process, self._chain = stream(seed, PROCESS), stream(seed, CHAIN)
        self._roots = {} if system.bounds.disturbance is not None else _process_roots(system, tick)

    def shake(self, location: str, x: FloatArray) -> FloatArray:
        """Return the state x (n,) with the noise of one sub-step in it."""
        root = self._roots.get(location)
        return x if root is None else x + root @ self._process.standard_normal(len(x))

    def next_location(self, location: str) -> str:
        """Return the location of the next row, by the chain."""
        row = (self.system.probability_from_to or {}).get(location, {})
        return _choose(row, self._chain)

    def start(self) -> tuple[str, FloatArray] | None:
        """Return location and state one step before the first row, where a chain starts from a prior; else None."""
        prior, wishes = self.system.prior, self.system.simulation
        if not self.is_chain or wishes.state is not None or prior is None:
            return None
        if prior.mean is None or prior.covariance is None:
            return None
        generator = stream(self.seed, START)
        x = prior.mean + covariance_root(prior.covariance) @ generator.standard_normal(len(prior.mean))
        return wishes.location or _choose(prior.probability or dict.fromkeys(self.system.initial, 1.0), generator), x

    def errors(self, places: NDArray[np.int64]) -> FloatArray:
        """Return the measurement noise (N, p) of rows in the locations of these numbers (N,)."""
        noise = np.zeros((len(places), len(self.system.output_names)))
        generator = stream(self.seed, SAMPLES)
        for number, location in enumerate(self.system.locations):
            covariance, rows = location.measurement_noise, np.flatnonzero(places == number)
            if covariance is not None:
                drawn = generator.standard_normal((len(rows), len(covariance))) @ covariance_root(covariance).T
                noise[np.ix_(rows, np.asarray(location.output_index, dtype=np.intp))] = drawn
        return noise


def _process_roots(system: HybridSystem, tick: float) -> dict[str, FloatArray]:
    roots = {}
    for location in system.locations:
        covariance, dynamics = location.process_noise, location.dynamics
        if covariance is not None and dynamics is not None and covariance.any():
            shared = covariance if system.time_step is not None else sample_covariance(dynamics.A, covariance, tick)
            roots[location.name] = covariance_root(shared)
    return roots


def _choose(weights: Mapping[str, float], generator: np.random.Generator) -> str:
    names, heights = list(weights), np.cumsum(list(weights.values()))
    return names[int(np.searchsorted(heights[:-1], generator.random() * heights[-1], side="right"))]
