"""Ultimate bound: how large the error stays under bounded disturbance, noise and detection delay.

In: a system with bounds, gains, rate μ, dwell time D, detection delay Δ, for which (20) holds with β = D - Δ.  Out: a
number b and one bound per state, which the error does not exceed once its initial value has died out: ‖ζ(t)‖ <= c
‖ζ(t_K)‖ e^{-μ t} + b.  Two coarse ways first, the better one of each state:

In norms, (31).  While j is active the error is at most κ_j times its value at the last switch plus g_j = N_j W_j,
where N_j bounds the integral of |e^{F_j t}| and W_j = |E| w̄ + |G_j| v̄ is the disturbance as it enters.  A switch
multiplies by at most e^{-μ β} and adds a kick ‖|R¹_ij| g_i‖, hence the level E = max kick / (1 - e^{-μ β}), and b =
max_j {κ_j E + ‖g_j‖}.  The factors √n ‖e^{F t}‖₁ W of the paper are replaced by the 2-norm of g, which is never
larger.  Several norms are tried.

State by state, `continuous/entrywise.py`: no κ enters, nor any unit.

Where only a certificate by forms holds, its ellipsoids are the start (`continuous/ellipsoids.py`), or, where its forms
are not plain quadratic ones, sets that grow until no switch leads out of them.  From what these leave, reachable sets
go down to nearly what an adversary reaches (`continuous/reach.py`).

With a delay the plant is in i while the observer still follows j; see `continuous/mismatch.py`: this is (49),
repaired.  Cost: a second for three locations of three states.

Source: Balluchi et al. (2012), (27), (31), (49) and the appendix.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import expm1

import numpy as np

from deshybrid.continuous.dwell import DwellTimeCertificate, certify_dwell, stay_steps
from deshybrid.continuous.ellipsoids import entry_ellipsoids
from deshybrid.continuous.entrywise import Stay, entrywise_bound
from deshybrid.continuous.error import ErrorDynamics, dynamics_of, error_dynamics, state_scale
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.impulse import impulse_norm
from deshybrid.continuous.inductive import FLAT, UltimateCertificate, inductive_sets, settled
from deshybrid.continuous.lmi import InequalityCertificate
from deshybrid.continuous.mismatch import Mismatch, mismatches, missing_bounds
from deshybrid.continuous.modes import ModalBasis, modal_basis
from deshybrid.continuous.reach import Levels, entry_sets, highest, outer_set, seen_exits
from deshybrid.continuous.responses import Flow
from deshybrid.continuous.search import needed_dwell, reset_norm
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.system import HybridSystem

ROUNDING = 1e-12
"""A norm is raised by this share: it is then no less than that of the exact numbers."""


@dataclass(frozen=True, slots=True, eq=False)
class UltimateBound:
    """A bound that the error does not exceed once the initial error has died out.

    value: bound of ‖ζ‖₂ in the states' own units, None where there is none; by_state (n,): one bound per state, in its
    unit; rate (1/s), dwell and delay (s) for which it holds; reason: one sentence; certificate: sets that prove
    by_state by induction, None where there are none (a detection delay, or a bound of zero).
    """

    value: float | None
    by_state: FloatArray | None
    rate: float
    dwell: float
    delay: float
    reason: str
    certificate: UltimateCertificate | None = None


def ultimate_bound(
    system: HybridSystem,
    gains: ObserverGains,
    *,
    rate: float | None = None,
    dwell: float | None = None,
    delay: float = 0.0,
    forms: InequalityCertificate | None = None,
) -> UltimateBound:
    """Return the ultimate bound for the given rate (1/s), dwell time and detection delay (s).

    Defaults are those of `certify_dwell`.  It has to hold, or `forms`, a certificate by quadratic forms for the same
    dwell time and delay, in its place; else `value` is None and `reason` says why.  Also needed:
    `bounds.disturbance` where a disturbance enters; with a delay also `bounds.state` and `bounds.input`.  Measurement
    noise counts as zero where `bounds.measurement` is not stated, and the reason says so.

    >>> from deshybrid.continuous.gains import design_gains
    >>> from deshybrid.model.load import loads
    >>> system = loads('''
    ... {format: deshybrid/1, name: kicked, state: [x], output: [y], disturbance: [w], bounds: {disturbance: 0.1},
    ...  locations: {p: {A: [[-1]], C: [[0]], E: [[1]]}},
    ...  transitions: [{from: p, to: p, event: kick, emits: kick, reset: {matrix: [[4]]}}]}
    ... ''')
    >>> gains = design_gains(system, ("p",), rate=0.5)
    >>> round(ultimate_bound(system, gains, dwell=6.0).value, 2)  # at most 0.1, four times that after a kick
    0.43
    """
    certificate = certify_dwell(system, gains, rate=rate, dwell=dwell, delay=delay)
    terms = certificate.rate, certificate.dwell, delay
    missing = missing_bounds(system, gains.locations, delay)
    if missing:
        return bound_of(terms, None, missing)
    dynamics = error_dynamics(system, gains.gains)
    bases = {name: modal_basis(dynamics.matrices[name], certificate.scale, step=dynamics.step) for name in gains.gains}
    growing = [name for name, basis in bases.items() if not basis.alpha < 0]
    if growing:
        return bound_of(terms, None, f"no bound is computed where errors grow during a stay, as in `{growing[0]}`")
    beta, longest = certificate.dwell - delay, certificate.dwell
    if dynamics.step is not None:
        beta, longest = (stay_steps(stay, dynamics.step) * dynamics.step for stay in (beta, longest))
    stays = _stays(system, gains, bases, mismatches(system, gains.gains, delay, longest))
    start, known = "equation (31)" if delay == 0 else "equation (49), its lemma repaired", None
    if certificate.holds:
        known = _by_condition_20(system, gains, certificate, stays, beta)
    elif forms is not None and forms.holds and forms.plain is not None:
        start = "forms that decrease from entry to entry"
        known = entry_ellipsoids(dynamics, forms.plain.P, forms.plain.ends, stays, dict.fromkeys(stays, beta))
    if known is None and forms is not None and forms.holds:
        start = "sets that no switch leads out of, next to a certificate by forms"
        known = _by_induction(system, gains, stays, beta)
    if known is None:
        return bound_of(terms, None, f"(20) does not hold: {certificate.reason}")
    by_state, sets = _reachable(system, gains, stays, known, beta)
    return bound_of(terms, by_state, f"{start}, tightened by reachable sets{noise_words(system)}", sets)


def noise_words(system: HybridSystem) -> str:
    """Return what has to be said where no bound of the measurements is stated."""
    return "" if system.bounds.measurement is not None else ", measurements taken as exact (no bound stated)"


def bound_of(
    terms: tuple[float, float, float],
    by_state: FloatArray | None,
    reason: str,
    sets: UltimateCertificate | None = None,
) -> UltimateBound:
    """Return the bound for a rate (1/s), a dwell time and a delay (s), its norm rounded up."""
    rate, dwell, delay = terms
    return UltimateBound(
        value=None if by_state is None else float(np.linalg.norm(by_state)) * (1 + ROUNDING),
        by_state=None if by_state is None else frozen_array(by_state, by_state.shape),
        rate=rate,
        dwell=dwell,
        delay=delay,
        reason=reason,
        certificate=sets,
    )


def _by_condition_20(
    system: HybridSystem,
    gains: ObserverGains,
    certificate: DwellTimeCertificate,
    stays: Mapping[str, Stay],
    beta: float,
) -> Mapping[str, Levels]:
    """Bounds along rows from those state by state, the better one of the two coarse ways each time."""
    dynamics = error_dynamics(system, gains.gains)
    found = [_in_norm(dynamics, stays, scale, certificate.rate, beta) for scale in _scales(system, gains, certificate)]
    bounds = [*found, entrywise_bound(stays, beta, dynamics.step)]
    by_state = np.min([bound for bound in bounds if bound is not None], axis=0)
    return dict.fromkeys(stays, lambda rows: np.asarray(np.abs(rows) @ by_state))


def _scales(system: HybridSystem, gains: ObserverGains, certificate: DwellTimeCertificate) -> tuple[FloatArray, ...]:
    """That of the certificate first: in it (20) holds; then those in which the bound may be smaller."""
    return certificate.scale, gains.scale, state_scale(system, gains.locations), np.ones(len(system.state_names))


def _stays(
    system: HybridSystem,
    gains: ObserverGains,
    bases: Mapping[str, ModalBasis],
    late: Mapping[str, tuple[Mismatch, ...]],
) -> dict[str, Stay]:
    return {name: Stay(_forced(system, gains, name, bases[name]), bases[name], late[name]) for name in gains.locations}


def _forced(system: HybridSystem, gains: ObserverGains, name: str, basis: ModalBasis) -> FloatArray:
    """g_j = N_j W_j in the states' units."""
    drive = np.abs(drive_of(system, gains, name)).sum(axis=1)
    return np.asarray(impulse_norm(basis.eigenvalues, basis.basis, step=system.time_step) @ drive)


def drive_of(system: HybridSystem, gains: ObserverGains, name: str) -> FloatArray:
    """Return [E_j w̄, G_j v̄]: disturbance and noise as they enter, a column for each signal between -1 and 1."""
    parts = [np.zeros((len(system.state_names), 0))]
    if system.bounds.disturbance is not None:
        parts.append(dynamics_of(system, name).E * system.bounds.disturbance)
    if system.bounds.measurement is not None:
        parts.append(gains.gains[name] * system.bounds.measurement[list(system.location(name).output_index)])
    return np.hstack(parts)


def _flows(system: HybridSystem, gains: ObserverGains, stays: Mapping[str, Stay]) -> dict[str, Flow]:
    return {n: Flow(stay.modes, drive_of(system, gains, n), system.time_step) for n, stay in stays.items()}


def _by_induction(
    system: HybridSystem, gains: ObserverGains, stays: Mapping[str, Stay], beta: float
) -> Mapping[str, Levels] | None:
    """Sets that grew from what one stay adds until no switch led out of them: they hold all errors from zero."""
    size = np.max([stay.forced + kick for stay in stays.values() for kick, _ in map(Mismatch.most, stay.exits)], axis=0)
    size = np.where(size > 0, size, max(float(size.max()), 1.0) * FLAT)
    exits = {name: stay.exits for name, stay in stays.items()}
    first = {name: outer_set(np.diag(size), lambda rows: np.asarray(np.abs(rows) @ size)) for name in stays}
    found = settled(_flows(system, gains, stays), exits, first, beta)
    return None if found is None else {name: outer.support for name, outer in found.items()}


def _reachable(
    system: HybridSystem, gains: ObserverGains, stays: Mapping[str, Stay], known: Mapping[str, Levels], beta: float
) -> tuple[FloatArray, UltimateCertificate | None]:
    """The bounds (n,) that reachable sets leave of given ones, those of inductive sets where there are any."""
    states = np.eye(len(system.state_names))
    if not any(levels(states).any() for levels in known.values()):
        return np.zeros(len(states)), None
    flows = _flows(system, gains, stays)
    exits = {name: stay.exits for name, stay in stays.items()}
    sets = entry_sets(lambda s: seen_exits(flows, exits, s, dict.fromkeys(flows, beta)), known, len(states))
    if all(exit.delayed is None for leaving in exits.values() for exit in leaving):
        proved = inductive_sets(flows, exits, sets, beta)
        if proved is not None:
            return proved[1], proved[0]
    return np.asarray(
        np.max([highest(flow, exits[name], sets[name], beta) for name, flow in flows.items()], axis=0)
    ), None


def _in_norm(
    dynamics: ErrorDynamics, stays: Mapping[str, Stay], scale: FloatArray, rate: float, beta: float
) -> FloatArray | None:
    """(31) or (49) in the norm of one scale as bounds of the states (n,), None where (20) does not hold in it."""

    def size(vector: FloatArray) -> float:
        return float(np.linalg.norm(vector / scale))

    kappas, shown, kicks = {}, {}, [0.0]
    for name, stay in stays.items():
        basis = modal_basis(dynamics.matrices[name], scale, step=dynamics.step)
        norm = reset_norm([reset.matrix for reset in dynamics.exits(name)], scale)
        if needed_dwell(basis, norm, rate) > beta:
            return None
        kappas[name] = basis.kappa
        late = [exit.most() for exit in stay.exits]
        kicks += [size(np.abs(e.reset) @ stay.forced + kick) for e, (kick, _) in zip(stay.exits, late, strict=True)]
        shown[name] = np.max([np.zeros(len(scale)), *(most for _, most in late)], axis=0)
    level = max(kicks) / -expm1(-rate * beta)
    peaks = [np.zeros(len(scale))]
    for name, stay in stays.items():
        peaks.append(scale * kappas[name] * level + stay.forced + shown[name])
    return np.asarray(np.max(peaks, axis=0))


__all__ = ["UltimateBound", "bound_of", "drive_of", "noise_words", "ultimate_bound"]
