"""Dwell-time certificates: the error contracts at rate μ if every stay is long enough.

In: error dynamics F_i with resets R¹_ij, rate μ, dwell time D, detection delay Δ.  Out: a certificate that holds or
not, with all numbers that prove it.  The idea: while i is active the error shrinks like κ_i e^{α_i t}, a reset
stretches it by at most r_i, so what a stay gains must outweigh what its end costs:

    α_i + max{0, log(r_i κ_i)}/(D - Δ) <= -μ  for every persistent location i,

hence the required dwell time Δ + max_i max{0, log(r_i κ_i)}/(-μ - α_i).  All norms are ‖diag(scale)⁻¹ ·‖₂ with one
scale for all locations; the certificate holds for the plant whatever the scale, so the scale is chosen to ask for the
least dwell time (Nelder and Mead's search from the bounds of the states and from units), then the column lengths of
each T_i.  In sampled time ‖M^k‖ <= κ e^{α k h} and stays are whole steps: the required dwell time is rounded up to
them.

All stored numbers are rounded up, and `deshybrid.verify` proves the condition from them and from T in rational
arithmetic. O(n^3) for an evaluation of the scale, a few hundred of them.

Source: Balluchi et al. (2012), (20), Theorems 6 and 7 and their proofs (β = D - Δ).
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, inf, isfinite, nextafter
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from deshybrid.continuous.checks import require_not_negative, require_positive
from deshybrid.continuous.error import ErrorDynamics, error_dynamics, sampled_error_dynamics
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.modes import ROUND_UP, ModalBasis, modal_basis
from deshybrid.continuous.scale import best_scale
from deshybrid.continuous.search import needed_dwell, reset_norm
from deshybrid.linear.arrays import ComplexArray, FloatArray
from deshybrid.model.system import HybridSystem

Theorem: TypeAlias = Literal["B12-6", "B12-7", "B12-6-sampled", "B12-7-sampled"]
LEAST = 0.01
NOTHING = 1e-6
"""A required time below this (s) is said to be none; the number itself stays in the certificate."""
PART_OF_A_STEP = 1e-6
"""A duration within this share of a step of a whole number of steps is that number of steps."""


@dataclass(frozen=True, slots=True)
class DwellTerms:
    """One location's part of (20): alpha (1/s), kappa, r (largest reset norm), required (s): its least D - Δ."""

    alpha: float
    kappa: float
    r: float
    required: float


@dataclass(frozen=True, slots=True, eq=False)
class DwellTimeCertificate:
    """A claim "every stay of at least `dwell` seconds: the error decays at `rate`", and what proves it.

    rate (1/s), dwell, delay and required_dwell (s; infinite where no dwell time is enough); holds: whether
    required_dwell <= dwell; terms by location; T: the basis of each location (n, n), F_i T_i = T_i diag(λ); scale
    (n,): the norm is ‖diag(scale)⁻¹ ζ‖₂; matrices: F_i, or M_i of the sampled observer; step (s) in sampled time, else
    None; P: None here (matrix inequalities have their own certificates); reason: one sentence.
    """

    theorem: Theorem
    rate: float
    dwell: float
    delay: float
    holds: bool
    required_dwell: float
    terms: Mapping[str, DwellTerms]
    T: Mapping[str, ComplexArray]
    scale: FloatArray
    matrices: Mapping[str, FloatArray]
    step: float | None
    reason: str
    P: Mapping[str, FloatArray] | None = None


def certify_dwell(
    system: HybridSystem,
    gains: ObserverGains,
    *,
    rate: float | None = None,
    dwell: float | None = None,
    delay: float = 0.0,
) -> DwellTimeCertificate:
    """Return whether Theorem 6 (Theorem 7 with a detection delay > 0) certifies the switching observer.

    Parameters
    ----------
    rate : float, 1/s
        μ > 0; default `gains.rate`.
    dwell : float, s
        D, a lower bound of all stays; default `gains.dwell`, and where that is None the required dwell time itself
        (but at least 1 % of 1/μ longer than the delay).
    delay : float, s
        Δ, a bound of the time between a transition and its detection.

    Raises `UsageError` (DH0508) for a rate or dwell time that is not positive or a negative delay.  "No" is a value.

    >>> from deshybrid.continuous.gains import design_gains
    >>> from deshybrid.model.load import loads
    >>> system = loads('''
    ... {format: deshybrid/1, name: kicked, state: [x], output: [y], disturbance: [w], bounds: {disturbance: 0.1},
    ...  locations: {p: {A: [[-1]], C: [[0]], E: [[1]]}},
    ...  transitions: [{from: p, to: p, event: kick, emits: kick, reset: {matrix: [[4]]}}]}
    ... ''')
    >>> gains = design_gains(system, ("p",), rate=0.5)
    >>> found = certify_dwell(system, gains, dwell=3.0)
    >>> found.holds, round(found.required_dwell, 6)  # log(4)/(1 - 0.5)
    (True, 2.772589)
    """
    dynamics = error_dynamics(system, gains.gains)
    return certify(dynamics, gains, rate=rate, dwell=dwell, delay=delay)


def certify_sampled(
    system: HybridSystem,
    gains: ObserverGains,
    *,
    step: float,
    rate: float | None = None,
    dwell: float | None = None,
    delay: float = 0.0,
) -> DwellTimeCertificate:
    """Return the certificate of the sampled observer M_i = A_d - G_d C_i: what generated code with this step (s) runs.

    Switches are taken at the ticks; where the plant switches between them, count the step into `delay`.
    """
    require_positive("step", step)
    dynamics = sampled_error_dynamics(system, gains.gains, step)
    return certify(dynamics, gains, rate=rate, dwell=dwell, delay=delay, sampled=True)


def required_dwell(
    system: HybridSystem, gains: ObserverGains, *, rate: float | None = None, delay: float = 0.0
) -> float:
    """Return the least dwell time (s) for which `certify_dwell` holds; infinite if there is none."""
    return certify_dwell(system, gains, rate=rate, delay=delay, dwell=None).required_dwell


def certify(
    dynamics: ErrorDynamics,
    gains: ObserverGains,
    *,
    rate: float | None = None,
    dwell: float | None = None,
    delay: float = 0.0,
    sampled: bool = False,
) -> DwellTimeCertificate:
    """Return the certificate for given error dynamics; the common part of the two functions above."""
    rate = gains.rate if rate is None else rate
    dwell = gains.dwell if dwell is None else dwell
    require_positive("rate", rate)
    require_positive("dwell time", dwell)
    require_not_negative("delay", delay)
    scale = best_scale(dynamics, gains.scale, rate)
    bases = {name: modal_basis(dynamics.matrices[name], scale, step=dynamics.step) for name in dynamics.locations}
    terms = {name: location_terms(dynamics, name, bases[name], scale, rate) for name in dynamics.locations}
    required = sum_rounded_up(delay, max((term.required for term in terms.values()), default=0.0))
    stated = dwell if dwell is not None else max(required, delay + LEAST / rate)
    holds = isfinite(required) and long_enough(stated - delay, required - delay, dynamics.step)
    theorem: Theorem = "B12-6" if delay == 0 else "B12-7"
    if sampled:
        theorem = "B12-6-sampled" if delay == 0 else "B12-7-sampled"
    return DwellTimeCertificate(
        theorem=theorem,
        rate=rate,
        dwell=stated,
        delay=delay,
        holds=holds,
        required_dwell=required,
        terms=MappingProxyType(terms),
        T=MappingProxyType({name: _read_only(basis.basis) for name, basis in bases.items()}),
        scale=scale,
        matrices=dynamics.matrices,
        step=dynamics.step,
        reason=_reason(terms, rate, stated, delay, holds=holds),
    )


def location_terms(dynamics: ErrorDynamics, name: str, basis: ModalBasis, scale: FloatArray, rate: float) -> DwellTerms:
    """Return one location's part of (20), every number rounded up."""
    norm = _rounded_norm(dynamics, name, scale)
    required = needed_dwell(basis, norm, rate) * (1 + ROUND_UP)
    if dynamics.step is not None and isfinite(required):
        required = ceil(required / dynamics.step) * dynamics.step
    return DwellTerms(basis.alpha, basis.kappa, norm, required)


def stay_steps(duration: float, step: float) -> int:
    """Return the least number of steps that a stay of `duration` seconds has, if it is a whole number of steps.

    >>> stay_steps(0.3, 0.1), stay_steps(0.31, 0.1)
    (3, 4)
    """
    return max(0, ceil(duration / step - PART_OF_A_STEP))


def most_steps(duration: float, step: float) -> int:
    """Return the largest number of steps that a stay of at most `duration` seconds has.

    >>> most_steps(0.3, 0.1), most_steps(0.39, 0.1)
    (3, 3)
    """
    return floor(duration / step + PART_OF_A_STEP)


def _rounded_norm(dynamics: ErrorDynamics, name: str, scale: FloatArray) -> float:
    """r_i, rounded up unless every reset is exactly the identity (then it is 1) or there is none (then 0)."""
    matrices = [reset.matrix for reset in dynamics.exits(name)]
    if all(np.array_equal(matrix, np.eye(len(scale))) for matrix in matrices):
        return 1.0 if matrices else 0.0
    return reset_norm(matrices, scale) * (1 + ROUND_UP)


def sum_rounded_up(delay: float, stay: float) -> float:
    """Return delay + stay (s), such that the exact difference to the delay is not below the stay."""
    return nextafter(delay + stay, inf) if delay > 0 and 0 < stay < inf else delay + stay


def long_enough(stay: float, required: float, step: float | None) -> bool:
    """Return whether D - Δ is as long as required (s), in whole steps where there is a step."""
    if step is None:
        return stay >= required and stay > 0
    return stay_steps(stay, step) >= max(1, stay_steps(required, step))


def _reason(terms: Mapping[str, DwellTerms], rate: float, dwell: float, delay: float, *, holds: bool) -> str:
    """One sentence that names the location that decides."""
    if not terms:
        return "there is no persistent location"
    name = max(terms, key=lambda location: terms[location].required)
    worst = terms[name]
    if worst.kappa == inf:
        return f"the closed loop of `{name}` is not diagonalisable (κ = ∞); choose distinct poles"
    if worst.required == inf:
        return f"location `{name}` contracts at {-worst.alpha:.6g} 1/s only, which is not faster than {rate:.6g} 1/s"
    if holds and worst.required < NOTHING:
        return "any stay is long enough" + (f" that is longer than the detection delay {delay:.6g} s" if delay else "")
    needs = f"location `{name}` needs {worst.required + delay:.6g} s"
    if holds:
        return f"every stay of at least {dwell:.6g} s is long enough; {needs}"
    if dwell <= delay:
        return f"the dwell time {dwell:.6g} s is not longer than the detection delay {delay:.6g} s"
    return f"{needs} (κ = {worst.kappa:.4g}, r = {worst.r:.4g}), more than the dwell time {dwell:.6g} s"


def _read_only(array: ComplexArray) -> ComplexArray:
    array = array.copy()
    array.flags.writeable = False
    return array


__all__ = [
    "DwellTerms",
    "DwellTimeCertificate",
    "Theorem",
    "certify",
    "certify_dwell",
    "certify_sampled",
    "location_terms",
    "long_enough",
    "most_steps",
    "required_dwell",
    "stay_steps",
    "sum_rounded_up",
]
