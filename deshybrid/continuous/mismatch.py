"""What a detection delay costs: the plant is in i already, the observer still follows j.

In: a system with bounds |x| <= B_x, |u| <= B_u, |w| <= w̄, the observer's gains, a delay Δ.  Out, per transition j ->
i, bounded entry by entry:
- drive (n, r): the model error that drives the observer meanwhile, [(A_j - A_i) - G_j (C_j - C_i)] x + ... u + ... w +
  ..., a column for each signal between -1 and 1; push: what it adds within Δ, |e^{F_j t}| integrated over [0, Δ] times
  its row sums;
- jump: |x⁻ - x⁺|, the plant's reset that the observer has not made yet;
- extra: what is left of it after the observer's own reset, a time s <= Δ too late:
  (R - I)(x(t+s) - x⁺) + R (e^{F_j s} - I)(x⁻ - x⁺), zero for the identity reset, and of order Δ else.

The paper bounds ‖I - e^{A t}‖ by κ ‖A‖ t, which is false where A is not stable (A = 1, t = 2).  Here |I - e^{A t}| is
at most e^{|A| t} - I, entry by entry, and a difference of two states at most 2 B_x.  The paper also mixes the 2-norm
with |.| <= B_x per channel; vectors avoid that.

Source: Balluchi et al. (2012), Theorem 7, (32)-(49), and Lemma 8, (25).
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.dwell import PART_OF_A_STEP
from deshybrid.continuous.error import ErrorReset, dynamics_of, error_resets
from deshybrid.continuous.impulse import impulse_norm, peak_norm
from deshybrid.continuous.modes import ModalBasis
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.sampling import flow_and_integral
from deshybrid.model.system import HybridSystem

FARTHEST = 200.0
NOTHING_KNOWN = 1e100
"""Stands for e^{|A| t} where that is beyond e^200; the other bounds are then the smaller ones."""


class Mismatch(NamedTuple):
    """One transition under delay (s): reset (n, n); push, jump and extra (n,), at least zero, in the states' units."""

    target: str
    reset: FloatArray
    push: FloatArray
    jump: FloatArray
    extra: FloatArray
    drive: FloatArray
    delay: float


def in_time(target: str, reset: FloatArray) -> Mismatch:
    """Return the exit to `target` that is seen at once: it costs nothing.

    >>> in_time("p", np.eye(2)).push.tolist()
    [0.0, 0.0]
    """
    nothing = np.zeros(len(reset))
    return Mismatch(target, reset, nothing, nothing, nothing, np.zeros((len(reset), 0)), 0.0)


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
    for reset in error_resets(system, locations):
        old, new = system.location(reset.source), system.location(reset.target)
        if not set(old.output_index) <= set(new.output_index):
            return f"`{new.name}` does not measure all that the observer of `{old.name}` still reads during the delay"
    return ""


def mismatches(
    system: HybridSystem, gains: Mapping[str, FloatArray], bases: Mapping[str, ModalBasis], delay: float
) -> dict[str, tuple[Mismatch, ...]]:
    """Return the cost of the delay for every transition, by source location; all zero without delay."""
    found: dict[str, tuple[Mismatch, ...]] = dict.fromkeys(gains, ())
    for reset in error_resets(system, tuple(gains)):
        entry = in_time(reset.target, reset.matrix)
        if delay > 0:
            entry = _mismatch(system, gains[reset.source], bases[reset.source], delay, reset)
        found[reset.source] = (*found[reset.source], entry)
    return found


def _mismatch(system: HybridSystem, gain: FloatArray, basis: ModalBasis, delay: float, reset: ErrorReset) -> Mismatch:
    old, new, step = dynamics_of(system, reset.source), dynamics_of(system, reset.target), system.time_step
    state, identity = _bound_of(system.bounds.state, len(old.A)), np.eye(len(old.A))
    F = old.A - gain @ old.C
    turned, late_flow = _grown(F, delay, step)
    turned = np.minimum(turned, peak_norm(basis.eigenvalues, basis.basis, step=step) + identity)
    late_flow = np.minimum(late_flow, impulse_norm(basis.eigenvalues, basis.basis, step=step))
    jump = np.minimum(2 * state, np.abs(identity - reset.matrix) @ state + np.abs(reset.offset))
    inputs = _bound_of(system.bounds.input, len(system.input_names))[list(system.location(reset.target).input_index)]
    drive = np.abs(new.B) @ inputs + np.abs(new.E) @ _bound_of(system.bounds.disturbance, new.E.shape[1])
    grown, driven = _grown(new.A, delay, step)
    moved = np.minimum(2 * state, grown @ state + driven @ (drive + np.abs(new.f)))
    extra = np.abs(reset.matrix - identity) @ moved + np.abs(reset.matrix) @ turned @ jump
    error = _model_error(system, gain, reset)
    return Mismatch(reset.target, reset.matrix, late_flow @ np.abs(error).sum(axis=1), jump, extra, error, delay)


def _model_error(system: HybridSystem, gain: FloatArray, reset: ErrorReset) -> FloatArray:
    """The observer of `source` driven by the plant of `target`: a column for each state, input, disturbance, and f."""
    old, new = dynamics_of(system, reset.source), dynamics_of(system, reset.target)
    here, there = system.location(reset.source), system.location(reset.target)
    rows = [there.output_index.index(channel) for channel in here.output_index]
    m = len(system.input_names)
    old_B, new_B = _spread(old.B, here.input_index, m), _spread(new.B, there.input_index, m)
    old_D, new_D = _spread(old.D, here.input_index, m), _spread(new.D[rows], there.input_index, m)
    parts = (
        (old.A - new.A - gain @ (old.C - new.C[rows])) * _bound_of(system.bounds.state, len(old.A)),
        (old_B - new_B - gain @ (old_D - new_D)) * _bound_of(system.bounds.input, m),
        (old.E - new.E) * _bound_of(system.bounds.disturbance, new.E.shape[1]),
        (old.f - new.f - gain @ (old.g - new.g[rows]))[:, None],
    )
    return np.hstack(parts)


def _spread(matrix: FloatArray, index: tuple[int, ...], m: int) -> FloatArray:
    """The columns of a location's inputs among those of the system."""
    whole = np.zeros((matrix.shape[0], m))
    whole[:, list(index)] = matrix
    return whole


def _bound_of(bound: FloatArray | None, size: int) -> FloatArray:
    return np.zeros(size) if bound is None else bound


def _grown(matrix: FloatArray, delay: float, step: float | None) -> tuple[FloatArray, FloatArray]:
    """Entrywise bounds of |e^{A t} - I|, t <= delay, and of the integral of |e^{A t}| over [0, delay]; or of powers."""
    identity = np.eye(len(matrix))
    if step is None:
        if float(np.abs(matrix).sum(axis=1).max()) * delay > FARTHEST:
            return np.full_like(identity, NOTHING_KNOWN), np.full_like(identity, NOTHING_KNOWN)
        flow, integral = flow_and_integral(np.abs(matrix), identity, delay)
        return flow - identity, integral
    base = identity + np.abs(matrix - identity)
    power, total = identity, np.zeros_like(identity)
    for _ in range(int(delay / step + PART_OF_A_STEP)):
        total = np.minimum(total + power, NOTHING_KNOWN)
        power = np.minimum(power @ base, NOTHING_KNOWN)
    return power - identity, total


__all__ = ["Mismatch", "in_time", "mismatches", "missing_bounds"]
