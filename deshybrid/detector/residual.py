"""Residual generators: one sampled linear filter per location whose residual is small while the plant is there.

In: a location with its dynamics x' = A x + B u + E w + f, y = C x + D u + g + v, a step h, and poles.  Out: the
generator

    z := F z + Bz u + G y + c,   r = H z + K u + J y + l,

whose state follows T x: with T A_d = F T + G C and H T + J C = 0 (and the like for B, D, f, g) the error e = z - T x
obeys e := F e + G v - T (what w does in a step) and r = H e + J v, whatever the step.  A_d is the exact flow over a
step.  Each row of the residual belongs to one output channel, of which it contains -1.

What z follows is a `Followed`: T x with T A_d = A T + Y C, seen through W y = C T x.  Any gain L with A - L C stable
makes a generator of it: F = A - L C, G = Y + L W, r = C z - W y.  Here: the whole observable part (Y = 0, W = 1) with L
placed, which is the Luenberger observer of the paper.  What the outputs never show is left out, so it can neither
disturb the residual nor make the generator unstable.  L is placed on the sampled pair itself, at e^{pole·h}, so that
the residual of the own location decays at the chosen rate.  Other choices: `unknown_input` of T, `trade_off` of L.

Cost: one Kalman decomposition, one matrix exponential and one pole placement per location.
Source: Balluchi et al. (2012), section 5.1 (Luenberger residual), sampled.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deshybrid.diagnostics import GainError, UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, Location

RATE_FACTOR = 5.0
STAY_FACTOR = 10.0
FASTEST_PER_STEP = 0.3
DEFAULT_PER_STEP = 0.1
SLOWEST_PER_STEP = 1e-3
LEAST_PER_STEP = 2e-4
PLACED = "Luenberger observer, poles placed"


@dataclass(frozen=True, slots=True, eq=False)
class ResidualGenerator:
    """The generator of one location: k its order, m and p the location's own channels, q <= p rows of the residual.

    Shapes: F (k, k), input (k, m), gain (k, p), offset (k,); H (q, k), through (q, m), J (q, p), residual_offset (q,);
    start (k, p), start_offset (k,); T (k, n), the state that z follows is T x.  `channels`: by row of the residual the
    own output that it belongs to.  `poles` in rad/s.  `design`: how its gain was found, in words.

    `held`: by own output, and last for all inputs, how many samples each is held back before it enters, so that all
    are of one time; `lag` is the largest, by which the residual is late.  Empty where nothing is.
    """

    location: Location
    dynamics: LinearDynamics
    step: float
    poles: tuple[complex, ...]
    F: FloatArray
    input: FloatArray
    gain: FloatArray
    offset: FloatArray
    H: FloatArray
    through: FloatArray
    J: FloatArray
    residual_offset: FloatArray
    start: FloatArray
    start_offset: FloatArray
    T: FloatArray
    channels: tuple[int, ...]
    design: str
    held: tuple[int, ...] = ()

    @property
    def lag(self) -> int:
        """Samples by which the residual is later than the latest sample."""
        return max(self.held, default=0)

    @property
    def time_constant(self) -> float:
        """Seconds in which the slowest mode of the residual decays by a factor e."""
        slowest = max((pole.real for pole in self.poles), default=-1.0 / self.step)
        return -1.0 / slowest


class Followed(NamedTuple):
    """What a generator follows: T x(k+1) = A T x + B u + Y (y - D u - g) + offset, W (y - D u - g) = C T x.

    Shapes: A (k, k), B (k, m), offset (k,), Y (k, p), C (q, k), W (q, p), T (k, n).  `channels`: by row of W the own
    output whose coefficient in it is one.
    """

    location: Location
    dynamics: LinearDynamics
    step: float
    A: FloatArray
    B: FloatArray
    offset: FloatArray
    Y: FloatArray
    C: FloatArray
    W: FloatArray
    T: FloatArray
    channels: tuple[int, ...]


def default_poles(
    count: int, *, rate: float | None, dwell: float | None, step: float, speed: float = 1.0
) -> tuple[complex, ...]:
    """Return `count` real, distinct poles (rad/s) between -b and -2b.

    The detector must be done well before the observer has converged and before the location is left: b is the larger
    of 5 times the observer's rate and 10 over the dwell time.  The samples must still resolve it: b is at most 0.3 over
    the step; and at least 0.001 over it.  With neither rate nor dwell time given, b is 0.1 over the step.  `speed`
    multiplies what is wanted, within the same limits.

    >>> default_poles(2, rate=2.0, dwell=None, step=0.01)
    ((-10+0j), (-15+0j))
    """
    wanted = [RATE_FACTOR * rate] if rate else []
    wanted += [STAY_FACTOR / dwell] if dwell else []
    base = speed * max(wanted, default=DEFAULT_PER_STEP / step)
    base = max(min(base, FASTEST_PER_STEP / step), SLOWEST_PER_STEP / step)
    return tuple(complex(-base * (1.0 + i / count)) for i in range(count))


def build_generator(
    system: HybridSystem,
    location: Location,
    *,
    rate: float | None,
    dwell: float | None,
    step: float,
    speed: float = 1.0,
) -> ResidualGenerator:
    """Return the residual generator of `location`, with the poles that the model states or the default ones.

    A model states one pole per state component; where the outputs show fewer modes, the first ones are taken.

    Raises `UsageError` (DH0602) where the stated poles are too few or one hardly decays in 5,000 samples, `GainError`
    (DH0603) where the location measures nothing, (DH0505) where the poles taken are not closed under conjugation.
    """
    followed = follow(system, location, step)
    default = default_poles(len(followed.A), rate=rate, dwell=dwell, step=step, speed=speed)
    return placed_generator(system, followed, default)


def follow(system: HybridSystem, location: Location, step: float) -> Followed:
    """Return the whole observable part of a location, sampled; raises `GainError` (DH0603) where there is none."""
    from deshybrid.linear.observability import kalman_split

    dynamics = location.dynamics
    if dynamics is None or dynamics.C.shape[0] == 0 or not np.any(dynamics.C):
        message = f"location `{location.name}` measures nothing of its state, so it has no residual"
        raise GainError(diagnostic("DH0603", message, location.span))
    sampled = sampled_dynamics(system, dynamics, step)
    split = kalman_split(dynamics.A, dynamics.C)
    k, p = split.observable_dimension, len(dynamics.C)
    embedding, T = split.transform[:, :k], split.inverse[:k]
    return Followed(
        location=location,
        dynamics=dynamics,
        step=step,
        A=T @ sampled.A @ embedding,
        B=T @ sampled.B,
        offset=T @ sampled.f,
        Y=np.zeros((k, p)),
        C=dynamics.C @ embedding,
        W=np.eye(p),
        T=T,
        channels=tuple(range(p)),
    )


def placed_generator(system: HybridSystem, followed: Followed, default: tuple[complex, ...]) -> ResidualGenerator:
    """Return the generator whose error decays with the poles that the model states, or with the default ones."""
    from deshybrid.continuous.placement import place_gain

    step, k = followed.step, len(followed.A)
    poles = _poles(system, followed.location, default, step)
    if k == 0:
        return generator_of(followed, np.zeros((0, len(followed.C))), poles, PLACED)
    # Placed on (A - 1)/h, which tends to the plant's own for short steps, where A tends to 1 and loses its digits.
    wanted = tuple(np.expm1(np.array(poles) * step) / step)
    gain = step * place_gain((followed.A - np.eye(k)) / step, followed.C, wanted)
    return generator_of(followed, gain, poles, PLACED)


def generator_of(followed: Followed, gain: FloatArray, poles: tuple[complex, ...], design: str) -> ResidualGenerator:
    """Return the generator with L = gain (k, q), found as `design` says; `poles` (rad/s) are those of A - L C."""
    dynamics, W, T = followed.dynamics, followed.W, followed.T
    (q, p), (k, n), m = W.shape, T.shape, dynamics.B.shape[1]
    whole = followed.Y + gain @ W
    start = T @ np.linalg.pinv(dynamics.C)
    return ResidualGenerator(
        location=followed.location,
        dynamics=dynamics,
        step=followed.step,
        poles=poles,
        F=frozen_array(followed.A - gain @ followed.C, (k, k)),
        input=frozen_array(followed.B - whole @ dynamics.D, (k, m)),
        gain=frozen_array(whole, (k, p)),
        offset=frozen_array(followed.offset - whole @ dynamics.g, (k,)),
        H=frozen_array(followed.C, (q, k)),
        through=frozen_array(W @ dynamics.D, (q, m)),
        J=frozen_array(-W, (q, p)),
        residual_offset=frozen_array(W @ dynamics.g, (q,)),
        start=frozen_array(start, (k, p)),
        start_offset=frozen_array(-start @ dynamics.g, (k,)),
        T=frozen_array(T, (k, n)),
        channels=followed.channels,
        design=design,
    )


def sampled_dynamics(system: HybridSystem, dynamics: LinearDynamics, step: float) -> LinearDynamics:
    """Return the exact flow over one step; the dynamics themselves where the model is in discrete time."""
    from deshybrid.linear.sampling import sample_dynamics

    return sample_dynamics(dynamics, step) if system.time_step is None else dynamics


def _poles(system: HybridSystem, location: Location, default: tuple[complex, ...], step: float) -> tuple[complex, ...]:
    count = len(default)
    stated = system.observer.detector.poles.get(location.name)
    if stated is None:
        return default
    poles = tuple(complex(pole) for pole in stated[:count])
    problems = []
    if len(poles) < count:
        problems.append(f"{len(poles)} detector poles for location `{location.name}`, expected {count}")
    if any(not pole.real < -LEAST_PER_STEP / step for pole in poles):
        limit = f"{-LEAST_PER_STEP / step:g}"
        problems.append(f"a detector pole of location `{location.name}` has a real part of {limit} or more")
    if problems:
        note = f"the outputs of `{location.name}` show {count} of its {len(system.state_names)} modes"
        raise UsageError(*(diagnostic("DH0602", text, location.span, notes=(note,)) for text in problems))
    return poles


__all__ = [
    "Followed",
    "ResidualGenerator",
    "build_generator",
    "default_poles",
    "follow",
    "generator_of",
    "placed_generator",
    "sampled_dynamics",
]
