"""Default gains: poles for one location found from the rate and the dwell time that are asked for.

In: the dynamics of a location, rate μ, dwell time D, the largest reset norm r.  Out: a gain.  The idea: try a short
ladder of speeds σ, and on each rung four shapes of spectrum: real poles close together, spread, and wide apart, and
the plant's own poles moved left of -σ (an oscillation is kept: turning it into real poles costs gain).  The lowest
rung with a gain that meets condition (20) wins, and on it the smallest gain; if no rung does, the smallest gain that
needs at most 1.1 times the least dwell time found (twice, where no dwell time was stated).  At most 40 placements.
Another way to gains than by these four shapes, such as a filter's, climbs the same ladder.

Source: Balluchi et al. (2012), (20); the ladder is this project's.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from math import inf, log
from typing import TypeAlias

import numpy as np

from deshybrid.continuous.modes import ModalBasis, modal_basis
from deshybrid.continuous.placement import place_detectable
from deshybrid.diagnostics import GainError, diagnostic
from deshybrid.linear.arrays import ComplexArray, FloatArray
from deshybrid.linear.observability import KalmanSplit, sorted_spectrum

RUNGS = 10
RATIO = 1.6
SHAPES = (1.15, 1.5, 2.2)
FARTHEST = 30.0
"""Poles of a system in discrete time are not placed nearer to zero than exp(-30)."""


@dataclass(frozen=True, slots=True, eq=False)
class GainTask:
    """What is asked of one location: rate in 1/s as asked, `certified_rate` after fixed modes capped it, dwell in s.

    `patience`: where no gain is good enough, a smaller one is preferred that needs so many times the least dwell time.
    """

    A: FloatArray
    C: FloatArray
    split: KalmanSplit
    scale: FloatArray
    reset_norm: float
    rate: float
    certified_rate: float
    dwell: float
    patience: float
    step: float | None


@dataclass(frozen=True, slots=True, eq=False)
class _Trial:
    gain: FloatArray
    needed: float
    size: float


Way: TypeAlias = Callable[[GainTask, float], Iterator[FloatArray]]
"""Gains for a task whose closed loops decay at a speed (1/s), or nearly."""


def placements(task: GainTask, speed: float) -> Iterator[FloatArray]:
    """Yield the gains of the four shapes of spectrum, leaving out what floating point cannot place."""
    for poles in _shapes(task.split, speed, task.step):
        try:
            yield place_detectable(task.split, poles, task.scale)
        except GainError:
            continue


def default_gain(task: GainTask, way: Way = placements) -> FloatArray:
    """Return the gain of the search described above; shape (n, p)."""
    if task.split.observable_dimension == 0:
        return np.zeros((len(task.A), len(task.C)))
    floor = task.rate + max(0.0, log(max(task.reset_norm, 1e-300))) / task.dwell
    trials: list[_Trial] = []
    for rung in range(RUNGS):
        speed = 1.25 * floor * RATIO**rung
        level = [_trial(task, gain) for gain in way(task, speed)]
        good = [trial for trial in level if trial.needed <= task.dwell]
        if good:
            return min(good, key=lambda trial: trial.size).gain
        trials += level
    if not trials:
        raise GainError(diagnostic("DH0509", "no gain was found in floating point"))
    least = min(trial.needed for trial in trials)
    near = [trial for trial in trials if trial.needed <= task.patience * least]
    return min(near, key=lambda trial: trial.size).gain


def needed_dwell(basis: ModalBasis, reset_norm: float, rate: float) -> float:
    """Return the dwell time (s) that (20) asks of a location: log(r κ)/(-μ - α), 0 where r κ <= 1, else infinite.

    >>> needed_dwell(ModalBasis(np.array([-3 + 0j]), np.eye(1), -3.0, np.e), 1.0, 1.0)
    0.5
    """
    if basis.alpha > -rate or basis.kappa == inf:
        return inf
    excess = log(max(1.0, reset_norm * basis.kappa))
    if excess == 0.0:
        return 0.0
    return excess / (-rate - basis.alpha) if basis.alpha < -rate else inf


def reset_norm(matrices: list[FloatArray], scale: FloatArray) -> float:
    """Return r = max ‖R¹‖₂ in the norm of `scale`; 0 where the location is never left.

    >>> reset_norm([np.eye(2)], np.array([1.0, 100.0]))
    1.0
    """
    return max((float(np.linalg.norm(R * scale / scale[:, None], 2)) for R in matrices), default=0.0)


def from_plane_s(poles: ComplexArray, step: float | None) -> ComplexArray:
    """Map poles given in 1/s to the plane of the system: e^{λ h} for a system with step h.

    >>> from_plane_s(np.array([-np.log(2) + 0j]), 1.0)
    array([0.5+0.j])
    """
    if step is None:
        return poles
    clipped = np.maximum(poles.real * step, -FARTHEST) + 1j * poles.imag * step
    return np.asarray(np.exp(clipped), dtype=np.complex128)


def to_plane_s(values: ComplexArray, step: float | None) -> ComplexArray:
    """Map eigenvalues of the system to 1/s; the inverse of `from_plane_s`, zero going to -30/h."""
    if step is None:
        return values
    safe = np.where(np.abs(values) < np.exp(-FARTHEST), np.exp(-FARTHEST), values)
    return np.asarray(np.log(safe) / step, dtype=np.complex128)


def _shapes(split: KalmanSplit, speed: float, step: float | None) -> Iterator[ComplexArray]:
    count = split.observable_dimension
    for ratio in SHAPES:
        yield from_plane_s(np.asarray(-speed * ratio ** np.arange(count), dtype=np.complex128), step)
    yield from_plane_s(_moved_left(to_plane_s(sorted_spectrum(split.A_o), step), speed, step), step)


def _moved_left(own: ComplexArray, speed: float, step: float | None) -> ComplexArray:
    """The plant's own modes, each at least as fast as `speed`, no two alike; conjugate pairs stay pairs."""
    size = float(np.abs(own).max(initial=0.0)) + speed
    limit = np.inf if step is None else 0.999 * np.pi / step
    moved: list[complex] = []
    for mode in own:
        if mode.imag < 0:
            continue
        pair = 1e-9 * size < mode.imag < limit
        real = min(mode.real, -speed)
        while any(abs(other - complex(real, mode.imag if pair else 0.0)) < 0.1 * speed for other in moved):
            real -= 0.1 * speed
        moved += [complex(real, mode.imag), complex(real, -mode.imag)] if pair else [complex(real, 0.0)]
    # A mode on the negative real axis of the z-plane has no partner in the s-plane; it became a real one above.
    while len(moved) < len(own):
        moved.append(complex(min(value.real for value in moved) - 0.2 * speed, 0.0))
    return np.array(moved[: len(own)], dtype=np.complex128)


def gain_size(task: GainTask, gain: FloatArray) -> float:
    """Return ‖G‖₂ with every state in its own size and every output in that of its row of C."""
    weights = np.linalg.norm(task.C * task.scale, axis=1)
    return float(np.linalg.norm(gain * weights / task.scale[:, None], 2))


def _trial(task: GainTask, gain: FloatArray) -> _Trial:
    """One gain with what it needs and its size."""
    basis = modal_basis(task.A - gain @ task.C, task.scale, step=task.step, improve=False)
    return _Trial(gain, needed_dwell(basis, task.reset_norm, task.certified_rate), gain_size(task, gain))


__all__ = [
    "GainTask",
    "Way",
    "default_gain",
    "from_plane_s",
    "gain_size",
    "needed_dwell",
    "placements",
    "reset_norm",
    "to_plane_s",
]
