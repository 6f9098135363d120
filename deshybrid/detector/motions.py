"""Ways in which a plant can move in a location, along which excitation is measured.

In: a location.  Out: its `Motion`s: along a real mode, x = s v e^{λ t}; the steady state of one input that is held,
s u; and rest, where only the known offsets f and g show.  Strength s is a share of full scale: at s = 1 the first
component of x or u reaches its bound.  Complex modes are none: they pass through zero.

Cost: a spectrum.  Source: this project's.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, Location

REAL = 1e-9
"""A mode counts as real where its imaginary part is below this share of its size."""


@dataclass(frozen=True, slots=True, eq=False)
class Motion:
    """One way to move: `state` (n,) at the entry and `input` (m of the system) at full strength; `name` tells which."""

    kind: Literal["mode", "input", "rest"]
    name: str
    state: FloatArray
    input: FloatArray


def motions(system: HybridSystem, location: Location, *, entered: bool = True) -> tuple[Motion, ...]:
    """Return the motions of a location: its real modes, slowest first, its inputs, and, where `entered`, rest."""
    dynamics, m = location.dynamics, len(system.input_names)
    bound, prefix = system.bounds.state, "" if entered else f"as in {location.name}: "
    if dynamics is None or bound is None:
        return ()
    found = []
    values, vectors = np.linalg.eig(dynamics.A)
    for number in np.lexsort((values.imag, -values.real)):
        value = values[number]
        if abs(value.imag) <= REAL * max(abs(value), 1.0):
            vector = _scaled(vectors[:, number].real, bound)
            found.append(Motion("mode", prefix + _shape(system, vector), vector, np.zeros(m)))
    for channel, column in zip(location.input_index, dynamics.B.T, strict=True):
        held = _held(system, dynamics, channel, column)
        found += [Motion("input", f"{prefix}{system.input_names[channel]} held", *held)] if held is not None else []
    return (*found, *([Motion("rest", "rest", np.zeros(len(bound)), np.zeros(m))] if entered else []))


def _scaled(vector: FloatArray, bound: FloatArray) -> FloatArray:
    share = float(np.max(np.abs(vector) / np.where(bound > 0.0, bound, 1.0)))
    return np.asarray(vector / share) if share > 0.0 else vector


def _shape(system: HybridSystem, vector: FloatArray) -> str:
    named = zip(system.state_names, vector, strict=True)
    return ", ".join(f"{name} {value:.3g}" for name, value in named if abs(value) > REAL * np.abs(vector).max())


def _held(
    system: HybridSystem, dynamics: LinearDynamics, channel: int, column: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """The steady state of one input, as far as the bounds allow; None where there is none."""
    bounds = system.bounds
    if bounds.input is None or bounds.state is None or not bounds.input[channel]:
        return None
    inside = dynamics.A if system.time_step is None else dynamics.A - np.eye(len(dynamics.A))
    if np.linalg.matrix_rank(inside) < len(inside):
        return None
    state, acting = -np.linalg.solve(inside, column), np.zeros(len(system.input_names))
    share = np.abs(state) / np.where(bounds.state > 0.0, bounds.state, 1.0)
    size = 1.0 / max(1.0 / float(bounds.input[channel]), float(share.max(initial=0.0)))
    acting[channel] = size
    return np.asarray(state * size), acting


def equilibrium(system: HybridSystem, dynamics: LinearDynamics) -> FloatArray:
    """Return where the known offsets leave the state at rest; 0 where they leave it nowhere."""
    inside = dynamics.A if system.time_step is None else dynamics.A - np.eye(len(dynamics.A))
    rest = np.linalg.lstsq(inside, -dynamics.f, rcond=None)[0]
    return np.asarray(rest) if np.allclose(inside @ rest, -dynamics.f, atol=1e-12) else np.zeros(len(inside))


__all__ = ["Motion", "equilibrium", "motions"]
