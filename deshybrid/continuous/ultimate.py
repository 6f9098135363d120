"""Ultimate bound: how large the error stays under bounded disturbance, noise and detection delay.

In: a system with bounds, gains, rate μ, dwell time D, detection delay Δ, for which (20) holds with β = D - Δ.  Out: a
number b and one bound per state, which the error never leaves for good: ‖ζ(t)‖ <= c ‖ζ(t_K)‖ e^{-μ t} + b.  The idea,
per location j:
- while j is active the error is at most κ_j times its value at the last switch plus g_j = N_j W_j, where N_j bounds
  the integral of |e^{F_j t}| entry by entry and W_j = |E| w̄ + |G_j| v̄ is the disturbance as it enters;
- a switch multiplies by at most e^{-μ β} over the stay and adds a kick, hence the level E = max kick / (1 - e^{-μ β});
- b = max_j {κ_j E + ‖g_j‖}.
Without delay the kick is ‖|R¹_ij| g_i‖: this is (31), with its factors √n ‖e^{F t}‖₁ W replaced by the 2-norm of g,
which is never larger.  With a delay the plant is in i while the observer still follows j; see
`continuous/mismatch.py`: this is (49), its lemma repaired.  The bound is computed in several norms (scales of the
state) and the best of each state is kept. Cost: a few hundred thousand operations a location and scale.

Source: Balluchi et al. (2012), (27), (31), (49) and the appendix.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import exp
from types import MappingProxyType

import numpy as np

from deshybrid.continuous.dwell import DwellTimeCertificate, certify_dwell, stay_steps
from deshybrid.continuous.error import dynamics_of, error_dynamics, state_scale
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.impulse import impulse_norm
from deshybrid.continuous.mismatch import Mismatch, mismatches, missing_bounds
from deshybrid.continuous.modes import ModalBasis, modal_basis
from deshybrid.continuous.search import needed_dwell, reset_norm
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.system import HybridSystem


@dataclass(frozen=True, slots=True)
class UltimatePart:
    """One location's part, in the norm of the bound's scale: kappa, forced = ‖g_j‖, kick = worst kick of its exits."""

    kappa: float
    forced: float
    kick: float


@dataclass(frozen=True, slots=True, eq=False)
class UltimateBound:
    """A bound that the error does not exceed once the initial error has died out.

    value: bound of ‖ζ‖₂ in the states' own units, None where there is none; by_state (n,): one bound per state, in its
    unit; parts by location in the norm ‖diag(scale)⁻¹ ·‖₂ that gave `value`; reason: one sentence.
    """

    value: float | None
    by_state: FloatArray | None
    parts: Mapping[str, UltimatePart]
    rate: float
    dwell: float
    delay: float
    scale: FloatArray
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class _Bound:
    scale: FloatArray
    value: float
    by_state: FloatArray
    parts: Mapping[str, UltimatePart]


def ultimate_bound(
    system: HybridSystem,
    gains: ObserverGains,
    *,
    rate: float | None = None,
    dwell: float | None = None,
    delay: float = 0.0,
) -> UltimateBound:
    """Return the ultimate bound for the given rate (1/s), dwell time and detection delay (s).

    Defaults are those of `certify_dwell`, which has to hold; else `value` is None and `reason` says why.  Also needed:
    `bounds.disturbance` where a disturbance enters; with a delay also `bounds.state` and `bounds.input`.  Measurement
    noise counts as zero where `bounds.measurement` is not stated, and the reason says so.
    """
    certificate = certify_dwell(system, gains, rate=rate, dwell=dwell, delay=delay)
    missing = missing_bounds(system, gains.locations, delay)
    if not certificate.holds:
        missing = f"(20) does not hold: {certificate.reason}"
    if missing:
        return _none(certificate, missing)
    scales = _scales(system, gains, certificate)
    found = [bound for scale in scales for bound in _bounds_in(system, gains, certificate, scale)]
    best = min(found, key=lambda bound: bound.value)
    by_state = np.min([bound.by_state for bound in found], axis=0)
    value = min(best.value, float(np.linalg.norm(by_state)))
    return UltimateBound(
        value=value,
        by_state=frozen_array(by_state, by_state.shape),
        parts=best.parts,
        rate=certificate.rate,
        dwell=certificate.dwell,
        delay=delay,
        scale=best.scale,
        reason=_reason(system, delay),
    )


def _none(certificate: DwellTimeCertificate, reason: str) -> UltimateBound:
    empty: Mapping[str, UltimatePart] = MappingProxyType({})
    return UltimateBound(
        None, None, empty, certificate.rate, certificate.dwell, certificate.delay, certificate.scale, reason
    )


def _reason(system: HybridSystem, delay: float) -> str:
    noise = "" if system.bounds.measurement is not None else ", measurements taken as exact (no bound stated)"
    return f"{'equation (31)' if delay == 0 else 'equation (49), its lemma repaired'}{noise}"


def _scales(system: HybridSystem, gains: ObserverGains, certificate: DwellTimeCertificate) -> tuple[FloatArray, ...]:
    ones = frozen_array(np.ones(len(system.state_names)), (len(system.state_names),))
    return certificate.scale, gains.scale, state_scale(system, gains.locations), ones


def _bounds_in(
    system: HybridSystem, gains: ObserverGains, certificate: DwellTimeCertificate, scale: FloatArray
) -> Iterator[_Bound]:
    """Yield the bound in the norm of one scale, or nothing where (20) does not hold in that norm."""
    dynamics, names = error_dynamics(system, gains.gains), gains.locations
    rate, stay = certificate.rate, certificate.dwell - certificate.delay
    if dynamics.step is not None:
        stay = stay_steps(stay, dynamics.step) * dynamics.step
    bases = {name: modal_basis(dynamics.matrices[name], scale, step=dynamics.step) for name in names}
    for name, basis in bases.items():
        norm = reset_norm([reset.matrix for reset in dynamics.exits(name)], scale)
        if needed_dwell(basis, norm, rate) > stay:
            return
    forced = {name: _forced(system, gains, name, bases[name], delayed=certificate.delay > 0) for name in names}
    late = mismatches(system, gains.gains, bases, scale, certificate.delay)
    kicks = {name: max((_kick(m, forced[name], scale) for m in late[name]), default=0.0) for name in names}
    level = max(kicks.values(), default=0.0) / (1 - exp(-rate * stay))
    parts, peaks, by_state = {}, [0.0], [np.zeros(len(scale))]
    for name in names:
        kappa = bases[name].kappa
        parts[name] = UltimatePart(kappa, _size(forced[name], scale), kicks[name])
        for push, jump in [(np.zeros(len(scale)), 0.0), *((m.push, m.jump) for m in late[name])]:
            peaks.append(kappa * (level + jump) + _size(forced[name] + push, scale))
            by_state.append(scale * kappa * (level + jump) + forced[name] + push)
    largest = np.max(by_state, axis=0)
    yield _Bound(scale, float(scale.max()) * max(peaks), largest, MappingProxyType(parts))


def _forced(system: HybridSystem, gains: ObserverGains, name: str, basis: ModalBasis, *, delayed: bool) -> FloatArray:
    """g_j = N_j W_j in the states' units; with a delay the disturbance may still enter as in another location."""
    reach = [name, *(other for other in system.successors(name) if delayed and other in gains.locations)]
    drive = np.zeros(len(system.state_names))
    if system.bounds.disturbance is not None:
        drive = np.max([np.abs(dynamics_of(system, n).E) @ system.bounds.disturbance for n in reach], axis=0)
    if system.bounds.measurement is not None:
        noise = system.bounds.measurement[list(system.location(name).output_index)]
        drive = drive + np.abs(gains.gains[name]) @ noise
    return np.asarray(impulse_norm(basis.eigenvalues, basis.basis, step=system.time_step) @ drive)


def _kick(late: Mismatch, forced: FloatArray, scale: FloatArray) -> float:
    """What one switch adds to the error: the forced part through the reset, and what the delay costs."""
    return _size(np.abs(late.reset) @ (forced + late.push), scale) + late.extra


def _size(vector: FloatArray, scale: FloatArray) -> float:
    return float(np.linalg.norm(vector / scale))


__all__ = ["UltimateBound", "UltimatePart", "ultimate_bound"]
