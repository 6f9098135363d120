"""What a detection delay costs: the plant is in i already, the observer still follows j.

In: a system with bounds |x| <= B_x, |u| <= B_u, |w| <= w̄, the observer's gains, a delay Δ.  Out, per transition j ->
i:
- push: |e^{F_j t}| integrated over [0, Δ] times V, V >= |[(A_j - A_i) - G_j (C_j - C_i)] x + ... u + ...|, the model
  error that drives the observer meanwhile;
- jump: ‖x⁻ - x⁺‖, the plant's reset that the observer has not made yet;
- extra: what is left of it after the observer's own reset, a time s <= Δ too late:
  (R - I)(x(t+s) - x⁺) + R (e^{F_j s} - I)(x⁻ - x⁺), zero for the identity reset, and of order Δ else.

The paper bounds ‖I - e^{A t}‖ by κ ‖A‖ t, which is false where A is not stable (A = 1, t = 2); here it is e^{‖A‖ t} -
1.  It also mixes the 2-norm with |.| <= B_x per channel; here all vectors are bounded entry by entry first.

Source: Balluchi et al. (2012), Theorem 7, (32)-(49), and Lemma 8, (25).
"""

from collections.abc import Mapping
from math import expm1
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.dwell import PART_OF_A_STEP
from deshybrid.continuous.error import ErrorReset, dynamics_of, error_resets
from deshybrid.continuous.impulse import impulse_norm, short_norm
from deshybrid.continuous.modes import ModalBasis
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem


class Mismatch(NamedTuple):
    """One transition under delay: reset (n, n); push (n,) in the states' units; jump and extra in the scaled norm."""

    reset: FloatArray
    push: FloatArray
    jump: float
    extra: float


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
    system: HybridSystem,
    gains: Mapping[str, FloatArray],
    bases: Mapping[str, ModalBasis],
    scale: FloatArray,
    delay: float,
) -> dict[str, tuple[Mismatch, ...]]:
    """Return the cost of the delay for every transition, by source location; all zero without delay."""
    found: dict[str, tuple[Mismatch, ...]] = dict.fromkeys(gains, ())
    for reset in error_resets(system, tuple(gains)):
        if delay == 0:
            entry = Mismatch(reset.matrix, np.zeros(len(scale)), 0.0, 0.0)
        else:
            entry = _mismatch(system, gains[reset.source], bases[reset.source], scale, (delay, reset))
        found[reset.source] = (*found[reset.source], entry)
    return found


def _mismatch(
    system: HybridSystem, gain: FloatArray, basis: ModalBasis, scale: FloatArray, late: tuple[float, ErrorReset]
) -> Mismatch:
    delay, reset = late
    old, new = dynamics_of(system, reset.source), dynamics_of(system, reset.target)
    state, step = _bound_of(system.bounds.state, len(scale)), system.time_step
    F = old.A - gain @ old.C
    late_flow = impulse_norm(basis.eigenvalues, basis.basis, step=step)
    if step is None:
        late_flow = np.minimum(late_flow, short_norm(F, delay))
    push = late_flow @ _model_error(system, gain, reset)
    jumped = np.minimum(2 * state, np.abs(np.eye(len(scale)) - reset.matrix) @ state + np.abs(reset.offset))
    jump = _norm(jumped, scale)
    drive = np.abs(new.B) @ _bound_of(system.bounds.input, len(system.input_names))[list(_inputs(system, reset))]
    drive = drive + np.abs(new.E) @ _bound_of(system.bounds.disturbance, new.E.shape[1]) + np.abs(new.f)
    grown, driven = _growth(_scaled(new.A, scale), delay, step)
    moved = min(2 * _norm(state, scale), grown * _norm(state, scale) + driven * _norm(drive, scale))
    turned = min(_growth(_scaled(F, scale), delay, step)[0], 1 + basis.kappa)
    R = _scaled(reset.matrix, scale)
    extra = float(np.linalg.norm(R - np.eye(len(scale)), 2)) * moved + float(np.linalg.norm(R, 2)) * turned * jump
    return Mismatch(reset.matrix, np.asarray(push), jump, extra)


def _model_error(system: HybridSystem, gain: FloatArray, reset: ErrorReset) -> FloatArray:
    """V, entry by entry: the observer of `source` driven by the plant of `target`."""
    old, new = dynamics_of(system, reset.source), dynamics_of(system, reset.target)
    here, there = system.location(reset.source), system.location(reset.target)
    rows = [there.output_index.index(channel) for channel in here.output_index]
    m = len(system.input_names)
    old_B, new_B = _spread(old.B, here.input_index, m), _spread(new.B, there.input_index, m)
    old_D, new_D = _spread(old.D, here.input_index, m), _spread(new.D[rows], there.input_index, m)
    by_state = np.abs(old.A - new.A - gain @ (old.C - new.C[rows])) @ _bound_of(system.bounds.state, len(old.A))
    by_input = np.abs(old_B - new_B - gain @ (old_D - new_D)) @ _bound_of(system.bounds.input, m)
    return np.asarray(by_state + by_input + np.abs(old.f - new.f - gain @ (old.g - new.g[rows])))


def _inputs(system: HybridSystem, reset: ErrorReset) -> tuple[int, ...]:
    return system.location(reset.target).input_index


def _spread(matrix: FloatArray, index: tuple[int, ...], m: int) -> FloatArray:
    """The columns of a location's inputs among those of the system."""
    whole = np.zeros((matrix.shape[0], m))
    whole[:, list(index)] = matrix
    return whole


def _bound_of(bound: FloatArray | None, size: int) -> FloatArray:
    return np.zeros(size) if bound is None else bound


def _growth(matrix: FloatArray, delay: float, step: float | None) -> tuple[float, float]:
    """Bounds of ‖e^{A t} - I‖ and of the integral of ‖e^{A s}‖ over [0, t], t <= delay; in steps, of powers."""
    if step is None:
        size = float(np.linalg.norm(matrix, 2))
        grown = expm1(size * delay)
        return grown, grown / size if size > 0 else delay
    size = float(np.linalg.norm(matrix - np.eye(len(matrix)), 2))
    steps = int(delay / step + PART_OF_A_STEP)
    grown = (1 + size) ** steps - 1
    return grown, grown / size if size > 0 else float(steps)


def _scaled(matrix: FloatArray, scale: FloatArray) -> FloatArray:
    return np.asarray(matrix * scale / scale[:, None])


def _norm(vector: FloatArray, scale: FloatArray) -> float:
    return float(np.linalg.norm(vector / scale))


__all__ = ["Mismatch", "mismatches", "missing_bounds"]
