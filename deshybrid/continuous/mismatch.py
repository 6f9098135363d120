"""What a detection delay costs: the plant is in i already, the observer still follows j.

In: a system with bounds |x| <= B, |u| <= ū, |w| <= w̄, |v| <= v̄, the observer's gains, a delay Δ, the shortest stay D of
the plant.  Out: for every transition j -> i bounds, along given rows, of all that the delay s <= Δ adds to the error.
The idea: plant and error are one linear system meanwhile,

    (x, ζ)' = [[A_i, 0], [M, F_j]] (x, ζ) + signals,   M = A_j - A_i - G_j (C_j - C_i),

which starts from x⁺ = R x⁻ + r and ζ⁻ + x⁻ - x⁺, and the observer makes the jump s too late: ζ := R ζ + (R - I) x + r.
So the error at the end is d R e^{F_j s} ζ⁻, which the stay accounts for, and a row times x⁻, which is known to lie in a
set (`continuous/plant_sets.py`), and what the signals add: exact for each s, up to rounding, but for the bounds of the
state during the delay.  These give a second number, the integral of ‖d R e^{F_j s} [M B, ...]‖₁, and the lower of both
counts.  What the signals of the observer's own location would have added within s is taken off, since the stay has
counted it.

The paper bounds ‖I - e^{A t}‖ by κ ‖A‖ t, which is false where A is not stable (A = 1, t = 2), and mixes the 2-norm
with |.| <= B per channel; none of that is needed here.  O(rows · cells · n²) a transition.

Source: Balluchi et al. (2012), Theorem 7, (32)-(49), and Lemma 8, (25), with reachable sets in the place of norms.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.course import Course, course
from deshybrid.continuous.error import dynamics_of
from deshybrid.continuous.plant_sets import Whereabouts, jump_of, plant_sets, state_box
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, HybridTransition


class Late(NamedTuple):
    """What the delay adds: starts (c,) of the cells of s, and bounds (K, c) for all s in each of them."""

    starts: FloatArray
    most: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Mismatch:
    """One transition: its target, its reset (n, n); `delayed` None where it is seen at once and costs nothing."""

    target: str
    reset: FloatArray
    delayed: "Delayed | None" = None

    def kick(self, directions: FloatArray) -> Late:
        """Return what the delay adds along directions (K, n) to the error with which the target is entered."""
        n = len(self.reset)
        if self.delayed is None:
            return _nothing(len(directions))
        return self.delayed.added(directions @ (self.reset - np.eye(n)), directions @ self.reset, directions)

    def shown(self) -> Late:
        """Return what the delay adds to each state's error while it lasts."""
        n = len(self.reset)
        return _nothing(n) if self.delayed is None else self.delayed.added(np.zeros((n, n)), np.eye(n), None)

    def most(self) -> tuple[FloatArray, FloatArray]:
        """Return bounds (n,) of what any delay adds to each state: as the target is entered, and before that."""
        kicked, shown = self.kick(np.eye(len(self.reset))), self.shown()
        return np.asarray(kicked.most.max(axis=1)), np.asarray(shown.most.max(axis=1))


def _nothing(count: int) -> Late:
    return Late(np.zeros(1), np.zeros((count, 1)))


@dataclass(frozen=True, slots=True, eq=False)
class Delayed:
    """(x, ζ, 1) during the delay: its course, what drives it, what would have driven ζ in the observer's own location.

    tied (n, r): the model error with the state anywhere within its bounds.
    """

    joint: Course
    drive: FloatArray
    own: FloatArray
    tied: FloatArray
    where: Whereabouts
    jump: tuple[FloatArray, FloatArray]
    box: FloatArray

    def added(self, state: FloatArray, error: FloatArray, jumped: FloatArray | None) -> Late:
        """Return bounds for rows (K, n) over x and ζ; rows `jumped` (K, n) of the offset where the jump is made."""
        n, (matrix, offset) = len(self.box), self.jump
        final = np.zeros(len(state)) if jumped is None else jumped @ offset
        moved = self.joint.rows(np.hstack([state, error, final[:, None]]))
        plant, late, constant = moved[:, :, :n], moved[:, :, n : 2 * n], moved[:, :, 2 * n]
        leapt = late @ (np.eye(n) - matrix)
        bent = self.joint.bends(moved) @ self._sizes()
        flowing = self.where.farthest(plant @ matrix + leapt, (plant - late) @ offset + constant)
        flowing = self._over(flowing, bent) + self._until(self.joint.pushed(moved, self.drive)[1])
        # The constant part of the model error is in `tied`.
        held = self.where.farthest(leapt, final[:, None] - late @ offset) + (np.abs(state) @ self.box)[:, None]
        held = self._over(held, bent) + self._until(self._pushed(moved, self.tied)[1])
        counted, starts = self._pushed(moved, self.own)[0], self.joint.times
        if self.joint.step is None:
            counted, starts = counted[:, :-1], starts[:-1]
        return Late(starts, np.minimum(flowing, held) - counted)

    def _pushed(self, moved: FloatArray, columns: FloatArray) -> tuple[FloatArray, FloatArray]:
        n = len(self.box)
        whole = np.vstack([np.zeros((n, columns.shape[1])), columns, np.zeros((1, columns.shape[1]))])
        return self.joint.pushed(moved, whole)

    def _sizes(self) -> FloatArray:
        """Bounds of the start of (x, ζ, 1) but for ζ⁻."""
        matrix, offset = self.jump
        leap = self.where.farthest(np.eye(len(matrix)) - matrix, -offset)
        return np.concatenate([self.where.farthest(matrix, offset), leap, np.ones(1)])

    def _over(self, at: FloatArray, bent: FloatArray) -> FloatArray:
        """A convex function of rows over each cell, or at each step."""
        return at if self.joint.step is not None else np.maximum(at[:, :-1], at[:, 1:]) + bent

    def _until(self, pushed: FloatArray) -> FloatArray:
        return pushed if self.joint.step is not None else pushed[:, 1:]


def in_time(target: str, reset: FloatArray) -> Mismatch:
    """Return the exit to `target` that is seen at once: it costs nothing.

    >>> in_time("p", np.eye(2)).shown().most.tolist()
    [[0.0], [0.0]]
    """
    return Mismatch(target, reset)


def missing_bounds(system: HybridSystem, locations: tuple[str, ...], delay: float) -> str:
    """Return what keeps the ultimate bound from being computed, or the empty string."""
    bounds = system.bounds
    if bounds.disturbance is None and any(dynamics_of(system, name).E.any() for name in locations):
        return "`bounds` states no bound of the disturbance"
    if delay == 0:
        return ""
    if bounds.state is None:
        return "`bounds` states no bound of the state, which a detection delay needs"
    if bounds.input is None and system.input_names:
        return "`bounds` states no bound of the input, which a detection delay needs"
    for transition in _between(system, locations):
        old, new = system.location(transition.source), system.location(transition.target)
        if not set(old.output_index) <= set(new.output_index):
            return f"`{new.name}` does not measure all that the observer of `{old.name}` still reads during the delay"
    return ""


def mismatches(
    system: HybridSystem, gains: Mapping[str, FloatArray], delay: float, stay: float
) -> dict[str, tuple[Mismatch, ...]]:
    """Return the cost of the delay (s) for every transition, by source location, for stays of at least `stay` (s)."""
    transitions = _between(system, tuple(gains))
    exits = [in_time(t.target, jump_of(system, t)[0]) for t in transitions]
    if delay > 0:
        errors = tuple(_model_error(system, gains[t.source], t) for t in transitions)
        sets = plant_sets(system, transitions, tuple(error.state for error in errors), stay)
        exits = [
            Mismatch(t.target, exit.reset, _delayed(system, gains[t.source], t, where, delay))
            for t, exit, where in zip(transitions, exits, sets, strict=True)
        ]
    pairs = list(zip(transitions, exits, strict=True))
    return {name: tuple(exit for t, exit in pairs if t.source == name) for name in gains}


def _between(system: HybridSystem, locations: tuple[str, ...]) -> tuple[HybridTransition, ...]:
    return tuple(t for t in system.transitions if t.source in locations and t.target in locations)


class _ModelError(NamedTuple):
    """The observer of `source` driven by the plant of `target`: M (n, n), and what inputs and constants add."""

    state: FloatArray
    input: FloatArray
    constant: FloatArray


def _model_error(system: HybridSystem, gain: FloatArray, transition: HybridTransition) -> _ModelError:
    old, new = dynamics_of(system, transition.source), dynamics_of(system, transition.target)
    here, there = system.location(transition.source), system.location(transition.target)
    rows = [there.output_index.index(channel) for channel in here.output_index]
    m = len(system.input_names)
    old_B, new_B = _spread(old.B, here.input_index, m), _spread(new.B, there.input_index, m)
    old_D, new_D = _spread(old.D, here.input_index, m), _spread(new.D[rows], there.input_index, m)
    return _ModelError(
        old.A - new.A - gain @ (old.C - new.C[rows]),
        old_B - new_B - gain @ (old_D - new_D),
        old.f - new.f - gain @ (old.g - new.g[rows]),
    )


def _delayed(
    system: HybridSystem, gain: FloatArray, transition: HybridTransition, where: Whereabouts, delay: float
) -> Delayed:
    error = _model_error(system, gain, transition)
    old, new, bounds = dynamics_of(system, transition.source), dynamics_of(system, transition.target), system.bounds
    n, m, step, box = len(old.A), len(system.input_names), system.time_step, state_box(system)
    noise = (
        gain
        * _bound_of(bounds.measurement, len(system.output_names))[list(system.location(transition.source).output_index)]
    )
    inputs, winds = _bound_of(bounds.input, m), new.E * _bound_of(bounds.disturbance, new.E.shape[1])
    felt = np.hstack([error.input * inputs, -winds, noise])
    drives = _spread(new.B, system.location(transition.target).input_index, m) * inputs
    joint = np.zeros((2 * n + 1, 2 * n + 1))
    joint[:n, :n], joint[n : 2 * n, :n], joint[n : 2 * n, n : 2 * n] = new.A, error.state, old.A - gain @ old.C
    joint[:n, 2 * n], joint[n : 2 * n, 2 * n], joint[2 * n, 2 * n] = new.f, error.constant, 0.0 if step is None else 1.0
    return Delayed(
        joint=course(joint, delay, step),
        drive=np.vstack([np.hstack([drives, winds, noise * 0]), felt, np.zeros((1, felt.shape[1]))]),
        own=np.hstack([old.E * _bound_of(bounds.disturbance, old.E.shape[1]), noise]),
        tied=np.hstack([error.state * box, felt, error.constant[:, None]]),
        where=where,
        jump=jump_of(system, transition),
        box=box,
    )


def _spread(matrix: FloatArray, index: tuple[int, ...], m: int) -> FloatArray:
    """The columns of a location's inputs among those of the system."""
    whole = np.zeros((matrix.shape[0], m))
    whole[:, list(index)] = matrix
    return whole


def _bound_of(bound: FloatArray | None, size: int) -> FloatArray:
    return np.zeros(size) if bound is None else bound


__all__ = ["Delayed", "Late", "Mismatch", "in_time", "mismatches", "missing_bounds"]
