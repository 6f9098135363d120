"""A plant for the observer's tests, written from the definition: exact flow by matrix exponential, resets at switches.

It knows nothing of the product's simulator, so that an agreement of the two is no accident.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import expm

from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, Location


@dataclass(frozen=True)
class Sampled:
    """Samples of a run: location, state (n,), input (m,), output (p,) of the system, event since the sample before."""

    location: str
    state: FloatArray
    input: FloatArray
    output: FloatArray
    event: str | None


def drive(
    system: HybridSystem,
    visits: Sequence[tuple[str, float, str | None]],
    *,
    state: FloatArray,
    step: float,
    after: float,
    input: Callable[[float], Sequence[float]],
    disturbance: Callable[[float], Sequence[float]] | None = None,
    noise: Callable[[float], Sequence[float]] | None = None,
) -> list[Sampled]:
    """Run through `visits`: (location, time of entry, output shown at the entry); a switch may fall between samples.

    Input and disturbance are held over a step; the last visit lasts `after` seconds.
    """
    samples = []
    place, event, x = 0, None, np.array(state, dtype=float)
    end = visits[-1][1] + after
    for tick in range(round(end / step)):
        time = tick * step
        location = visits[place][0]
        u = np.array(input(time), dtype=float)
        w = np.array(disturbance(time), dtype=float) if disturbance else np.zeros(len(system.disturbance_names))
        v = np.array(noise(time), dtype=float) if noise else np.zeros(len(system.output_names))
        samples.append(Sampled(location, x, u, output_of(system, location, x, u, v), event))
        event, left = None, step
        while place + 1 < len(visits) and visits[place + 1][1] <= time + step:
            before = visits[place + 1][1] - (time + step - left)
            x = flow(system, visits[place][0], x, (u, w), before)
            x = reset(system, visits[place][0], visits[place + 1][0], x)
            place, left, event = place + 1, left - before, visits[place + 1][2]
        x = flow(system, visits[place][0], x, (u, w), left)
    return samples


def flow(
    system: HybridSystem, name: str, x: FloatArray, held: tuple[FloatArray, FloatArray], time: float
) -> FloatArray:
    u, w = held
    location = system.location(name)
    dynamics = location.dynamics
    assert dynamics is not None
    constant = dynamics.B @ u[list(location.input_index)] + dynamics.f
    if len(w):
        constant = constant + dynamics.E @ w
    state_part, constant_part = transition_matrices(dynamics.A.tobytes(), len(x), time)
    return np.asarray(state_part @ x + constant_part @ constant)


@lru_cache(maxsize=1000)
def transition_matrices(A: bytes, n: int, time: float) -> tuple[FloatArray, FloatArray]:
    """e^{A t} and its integral, from one exponential of [[A, 1], [0, 0]]."""
    block = np.zeros((2 * n, 2 * n))
    block[:n, :n], block[:n, n:] = np.frombuffer(A).reshape(n, n), np.eye(n)
    whole = expm(block * time)
    return np.asarray(whole[:n, :n]), np.asarray(whole[:n, n:])


def reset(system: HybridSystem, source: str, target: str, x: FloatArray) -> FloatArray:
    (found,) = {id(t.reset): t.reset for t in system.transitions if (t.source, t.target) == (source, target)}.values()
    return x if found is None else np.asarray(found.matrix @ x + found.offset)


def output_of(system: HybridSystem, name: str, x: FloatArray, u: FloatArray, v: FloatArray) -> FloatArray:
    """The channels that the location does not measure read 0."""
    location = system.location(name)
    dynamics = location.dynamics
    assert dynamics is not None
    y, rows = np.zeros(len(system.output_names)), list(location.output_index)
    y[rows] = dynamics.C @ x + dynamics.D @ u[list(location.input_index)] + dynamics.g + v[rows]
    return y


def random_location(rng: np.random.Generator, name: str) -> Location:
    """A stable location with two states, one input, `y2` or both outputs, offsets and feedthrough."""
    p = int(rng.integers(1, 3))
    A = rng.normal(size=(2, 2))
    A -= (np.abs(np.linalg.eigvals(A)).max() + rng.uniform(0.2, 2.0)) * np.eye(2)
    dynamics = LinearDynamics(
        A=frozen_array(A, (2, 2)),
        B=frozen_array(rng.normal(size=(2, 1)), (2, 1)),
        C=frozen_array(rng.normal(size=(p, 2)), (p, 2)),
        D=frozen_array(0.3 * rng.normal(size=(p, 1)), (p, 1)),
        E=frozen_array(rng.normal(size=(2, 1)), (2, 1)),
        f=frozen_array(0.2 * rng.normal(size=2), (2,)),
        g=frozen_array(0.2 * rng.normal(size=p), (p,)),
    )
    return Location(name, dynamics, input_index=(0,), output_index=(0, 1) if p == 2 else (1,))


def jumping(rng: np.random.Generator, limits: list[float]) -> Callable[[float], list[float]]:
    """Random signs at full size: bounded, and as rough as a sampled signal can be."""
    return lambda time: [float(limit * rng.choice([-1.0, 1.0])) for limit in limits]
