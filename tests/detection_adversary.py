"""The latest signature that an adversary finds: input, disturbance and noise by linear programs.

The plant rests in the source; then, for `back` samples before and `ahead` samples after the transition, all signals are
unknowns within their bounds.  The residuals are affine in them, so that "the rival's relay stays on for so many
samples" and "the own residual is beyond its level so late" are linear.  It is written from the definitions of plant and
filter and shares nothing with the bounds; what it finds is a run for the real observer.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product
from typing import NamedTuple, TypeAlias

import numpy as np
from scipy.linalg import expm
from scipy.optimize import linprog

from deshybrid.detector.residual import ResidualGenerator
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location

INSIDE = 1.0 - 1e-6
"""Bounds are kept with this margin, so that rounding leaves none."""
BEFORE = 3
"""Samples before the entry for which the others are kept silent."""


@dataclass(frozen=True)
class Affine:
    """matrix s + constant, s the unknown signals."""

    matrix: FloatArray
    constant: FloatArray

    def __add__(self, other: "Affine") -> "Affine":
        return Affine(self.matrix + other.matrix, self.constant + other.constant)

    def by(self, M: FloatArray) -> "Affine":
        """Return M times this."""
        return Affine(M @ self.matrix, M @ self.constant)


@dataclass(frozen=True)
class Scene:
    """A stay in `source` up to x, then `back` free samples, the entry of `target` at `begin` under `held` inputs.

    `memory`: the state of each generator with x.
    """

    system: HybridSystem
    step: float
    source: Location
    target: Location
    begin: FloatArray
    held: FloatArray
    x: FloatArray
    memory: tuple[FloatArray, ...]
    back: int
    ahead: int

    @property
    def widths(self) -> tuple[int, int, int]:
        """Inputs, disturbances, outputs."""
        return len(self.system.input_names), len(self.system.disturbance_names), len(self.system.output_names)

    @property
    def count(self) -> int:
        """How many unknowns there are."""
        m, r, p = self.widths
        return self.back * m + (self.back + self.ahead) * (r + p)


class Signals(NamedTuple):
    """By sample: inputs (back, m), disturbances and noise (back + ahead, r) and (back + ahead, p)."""

    u: FloatArray
    w: FloatArray
    v: FloatArray


def split(scene: Scene, found: FloatArray) -> Signals:
    m, r, p = scene.widths
    steps, first = scene.back + scene.ahead, scene.back * m
    u, w, v = found[:first], found[first : first + steps * r], found[first + steps * r : first + steps * (r + p)]
    return Signals(u.reshape(-1, m), w.reshape(-1, r), v.reshape(-1, p))


class Course(NamedTuple):
    """The states before the entry, and the residuals of each generator by sample, as functions of the unknowns."""

    states: tuple[Affine, ...]
    residuals: tuple[tuple[Affine, ...], ...]


def course(scene: Scene, generators: tuple[ResidualGenerator, ...]) -> Course:
    flows = {place.name: sampled(place, scene.step) for place in (scene.source, scene.target)}
    x, states = fixed(scene, scene.x), []
    memories = [fixed(scene, z) for z in scene.memory]
    residuals: list[list[Affine]] = [[] for _ in generators]
    for k in range(scene.back + scene.ahead):
        place = scene.source if k < scene.back else scene.target
        x = fixed(scene, scene.begin) if k == scene.back else x
        u, w, v = unknowns(scene, k)
        states.append(x)
        y = measured(scene, place, x, u, v)
        for number, g in enumerate(generators):
            heard, z = y.by(rows_of(g.location.output_index, len(y.constant))), memories[number]
            shown = z.by(g.H) + u.by(g.through) + heard.by(g.J)
            residuals[number].append(Affine(shown.matrix, shown.constant + g.residual_offset))
            moved = z.by(g.F) + u.by(g.input) + heard.by(g.gain)
            memories[number] = Affine(moved.matrix, moved.constant + g.offset)
        A, B, E, f = flows[place.name]
        moved = x.by(A) + u.by(B) + w.by(E)
        x = Affine(moved.matrix, moved.constant + f)
    return Course(tuple(states), tuple(tuple(rows) for rows in residuals))


def fixed(scene: Scene, value: FloatArray) -> Affine:
    return Affine(np.zeros((len(value), scene.count)), np.asarray(value, dtype=float))


def rows_of(index: tuple[int, ...], size: int) -> FloatArray:
    return np.eye(size)[list(index)].reshape(len(index), size)


def unknowns(scene: Scene, k: int) -> tuple[Affine, Affine, Affine]:
    """u, w, v at sample k; after the entry u is the motion's."""
    every = np.eye(scene.count)
    m, r, p = scene.widths
    first, steps = scene.back * m, scene.back + scene.ahead
    free = k < scene.back
    u = every[k * m : (k + 1) * m] if free else np.zeros((m, scene.count))
    w = every[first + k * r : first + (k + 1) * r]
    v = every[first + steps * r + k * p : first + steps * r + (k + 1) * p]
    return (
        Affine(u, np.zeros(m) if free else np.asarray(scene.held, dtype=float)),
        Affine(w, np.zeros(r)),
        Affine(v, np.zeros(p)),
    )


def measured(scene: Scene, place: Location, x: Affine, u: Affine, v: Affine) -> Affine:
    """The channels that the location does not measure read 0."""
    d, own = place.dynamics, list(place.output_index)
    assert d is not None
    C, D, g = (
        np.zeros((len(v.constant), len(d.A))),
        np.zeros((len(v.constant), d.B.shape[1])),
        np.zeros(len(v.constant)),
    )
    C[own], D[own], g[own] = d.C, d.D, d.g
    kept = np.zeros((len(g), len(g)))
    kept[own, own] = 1.0
    y = x.by(C) + u.by(D) + v.by(kept)
    return Affine(y.matrix, y.constant + g)


def sampled(place: Location, step: float) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    d = place.dynamics
    assert d is not None
    n, m, r = len(d.A), d.B.shape[1], d.E.shape[1]
    block = np.zeros((n + m + r + 1,) * 2)
    block[:n, :n], block[:n, n:] = d.A, np.hstack([d.B, d.E, d.f[:, None]])
    whole = expm(block * step)[:n]
    return whole[:, :n], whole[:, n : n + m], whole[:, n + m : -1], whole[:, -1]


Rows: TypeAlias = tuple[FloatArray, FloatArray]
"""Rows and right sides of rows s <= right side."""


def together(parts: Sequence[Rows]) -> Rows:
    return np.vstack([rows for rows, _ in parts]), np.concatenate([right for _, right in parts])


def below(row: Affine, level: FloatArray) -> Rows:
    """|row| <= level."""
    return np.vstack([row.matrix, -row.matrix]), np.concatenate([level - row.constant, level + row.constant])


def within_bounds(scene: Scene, found: Course) -> Rows:
    limit = scene.system.bounds.state
    assert limit is not None
    return together([below(x, INSIDE * limit) for x in found.states if x.matrix.any()])


def beyond_before(scene: Scene, found: Course, levels: Sequence[tuple[int, FloatArray]]) -> Iterator[Rows]:
    """Ways to keep the residuals of these generators (number, levels) beyond a level in the last samples before."""
    signed = [[(number, line, sign) for line in range(len(level)) for sign in (1.0, -1.0)] for number, level in levels]
    for way in product(*signed):
        parts = [within_bounds(scene, found)]
        for (number, line, sign), (_, level) in zip(way, levels, strict=True):
            for k in range(scene.back - BEFORE, scene.back):
                residual = found.residuals[number][k]
                right = sign * residual.constant[line : line + 1] - level[line]
                parts.append((-sign * residual.matrix[line : line + 1], right))
        wanted = together(parts)
        if linprog(np.zeros(scene.count), A_ub=wanted[0], b_ub=wanted[1], bounds=sizes(scene)).status == 0:
            yield wanted


def sizes(scene: Scene) -> list[tuple[float, float]]:
    bounds = scene.system.bounds
    steps = scene.back + scene.ahead
    stated = (bounds.input, scene.back), (bounds.disturbance, steps), (bounds.measurement, steps)
    every = np.concatenate([np.tile(bound, count) for bound, count in stated if bound is not None])
    return [(-size, size) for size in INSIDE * every]


def longest_on(
    scene: Scene, wanted: Rows, residuals: tuple[Affine, ...], level: FloatArray, ticks: int | None
) -> Signals | None:
    """The signals with |residual| <= level until the latest possible sample after the entry.

    `ticks`: for so many samples; None: for all since the entry.
    """
    low, high, best = -1, scene.ahead, None
    while high - low > 1:
        middle = (low + high) // 2
        begin = 0 if ticks is None else max(0, middle + 1 - ticks)
        kept = [below(residuals[scene.back + k], INSIDE * level) for k in range(begin, middle + 1)]
        whole = together([wanted, *kept])
        answer = linprog(np.zeros(scene.count), A_ub=whole[0], b_ub=whole[1], bounds=sizes(scene))
        low, high, best = (
            (middle, high, split(scene, np.asarray(answer.x))) if answer.status == 0 else (low, middle, best)
        )
    return best


def latest_beyond(scene: Scene, wanted: Rows, residuals: tuple[Affine, ...], level: FloatArray) -> Signals | None:
    """The signals with which a residual is beyond its level in some row at a late sample: the last but for gaps."""
    low, high, best = -1, scene.ahead, None
    while high - low > 1:
        middle = (low + high) // 2
        made = _beyond(scene, wanted, residuals[scene.back + middle], level)
        low, high, best = (middle, high, made) if made else (low, middle, best)
    return best


def _beyond(scene: Scene, wanted: Rows, residual: Affine, level: FloatArray) -> Signals | None:
    for line, sign in ((line, sign) for line in range(len(level)) for sign in (1.0, -1.0)):
        answer = linprog(-sign * residual.matrix[line], A_ub=wanted[0], b_ub=wanted[1], bounds=sizes(scene))
        if answer.status == 0 and sign * residual.constant[line] - answer.fun > level[line] * (1 + 1e-6):
            return split(scene, np.asarray(answer.x))
    return None
