"""The switched error dynamics: what every certificate is about.

In: a hybrid system and one gain per persistent location.  Out: the error ζ = x̂ - x as matrices only: ζ' = F_i ζ while
location i is active, F_i = A_i - G_i C_i, and ζ := R¹_ij ζ at a transition; disturbances and offsets drop out.  The
sampled form ζ(k+1) = M_i ζ(k), M_i = A_d - G_d C_i, is what generated code runs.

Source: Balluchi et al. (2012), (18)-(19).
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.linear.sampling import sample_dynamics, sample_gain
from deshybrid.linear.subspaces import balanced_scale
from deshybrid.model.system import HybridSystem


class ErrorReset(NamedTuple):
    """ζ := matrix ζ when `source` is left for `target`; the plant itself jumps to matrix x + offset."""

    source: str
    target: str
    matrix: FloatArray
    offset: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class ErrorDynamics:
    """One matrix per location and one per jump; `step` None = continuous time, else seconds per multiplication."""

    locations: tuple[str, ...]
    matrices: Mapping[str, FloatArray]
    resets: tuple[ErrorReset, ...]
    step: float | None = None

    def exits(self, location: str) -> tuple[ErrorReset, ...]:
        """Return the resets R¹_ij over Reach(q_i), one per transition."""
        return tuple(reset for reset in self.resets if reset.source == location)


def dynamics_of(system: HybridSystem, name: str) -> LinearDynamics:
    """Return the linear dynamics of a location; `UsageError` (DH0501) where there is none.

    Such are a purely discrete model and a name that is no location's.
    """
    found = next((location for location in system.locations if location.name == name), None)
    if found is None:
        raise UsageError(diagnostic("DH0501", f"there is no location `{name}`"))
    if found.dynamics is None:
        raise UsageError(diagnostic("DH0501", f"location `{name}` has no continuous dynamics", found.span))
    return found.dynamics


def state_scale(system: HybridSystem, locations: tuple[str, ...]) -> FloatArray:
    """Return typical sizes of the states (n,): their bounds, else the mean balanced scale of the locations, not 0."""
    if system.bounds.state is not None and (system.bounds.state > 0).all():
        return system.bounds.state
    pairs = [dynamics_of(system, name) for name in locations]
    scales = [balanced_scale(dynamics.A, np.zeros((len(dynamics.A), 0)), dynamics.C) for dynamics in pairs]
    mean = np.exp(np.mean(np.log(scales), axis=0)) if scales else np.ones(len(system.state_names))
    return frozen_array(mean, mean.shape)


def error_resets(system: HybridSystem, locations: tuple[str, ...]) -> tuple[ErrorReset, ...]:
    """Return the resets between the given locations, in the order of the transitions; none written = identity."""
    n = len(system.state_names)
    identity, nothing = frozen_array(np.eye(n), (n, n)), frozen_array(np.zeros(n), (n,))
    return tuple(
        ErrorReset(t.source, t.target, t.reset.matrix, t.reset.offset)
        if t.reset is not None
        else ErrorReset(t.source, t.target, identity, nothing)
        for t in system.transitions
        if t.source in locations and t.target in locations
    )


def error_dynamics(system: HybridSystem, gains: Mapping[str, FloatArray]) -> ErrorDynamics:
    """Return F_i = A_i - G_i C_i for every location that has a gain, with the resets between them."""
    pairs = [(name, dynamics_of(system, name), gain) for name, gain in gains.items()]
    matrices = ((name, dynamics.A - gain @ dynamics.C) for name, dynamics, gain in pairs)
    return _collected(system, matrices, system.time_step)


def sampled_error_dynamics(system: HybridSystem, gains: Mapping[str, FloatArray], step: float) -> ErrorDynamics:
    """Return M_i = A_d - G_d C_i at a step in seconds, A_d = e^{A h}, G_d of `sample_gain`: what generated code runs.

    A system in discrete time is its own sampled form.
    """
    if system.time_step is not None:
        return error_dynamics(system, gains)
    matrices = []
    for name, gain in gains.items():
        dynamics = dynamics_of(system, name)
        sampled = sample_dynamics(dynamics, step)
        matrices.append((name, sampled.A - sample_gain(dynamics, gain, step) @ dynamics.C))
    return _collected(system, matrices, step)


def _collected(system: HybridSystem, matrices: Iterable[tuple[str, FloatArray]], step: float | None) -> ErrorDynamics:
    frozen = {name: frozen_array(matrix, matrix.shape) for name, matrix in matrices}
    names = tuple(frozen)
    return ErrorDynamics(names, MappingProxyType(frozen), error_resets(system, names), step)


__all__ = [
    "ErrorDynamics",
    "ErrorReset",
    "dynamics_of",
    "error_dynamics",
    "error_resets",
    "sampled_error_dynamics",
    "state_scale",
]
