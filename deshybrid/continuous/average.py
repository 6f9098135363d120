"""Average dwell time: short stays are harmless where long ones make up for them.

In: error dynamics F_i with resets, rate μ.  Out: a time τ with forms that prove it: where at most N0 + t/τ transitions
fall into every interval of length t, the error is at most c e^{-μ t}, with c depending on N0 only.  No single stay is
bounded below.  The idea: forms P_i that decrease at a faster rate λ > μ inside every location and grow at most
ρ-fold at a transition,

    F_iᵀ P_i + P_i F_i < -2 λ P_i,      R¹_ijᵀ P_j R¹_ij < ρ P_i,      τ = log ρ/(2 (λ - μ)),

or M_iᵀ P_i M_i < e^{-2 λ h} P_i in sampled time.  For a few λ between μ and the slowest location, forms come from
Lyapunov's equation and, with the solver of the extra `lmi`, from bisection on ρ; the λ with the least τ is kept, after
an exact proof.  Some 35 conic problems of m N unknowns (m locations, N = n (n+1)/2).

Source: Hespanha and Morse (1999), "Stability of switched systems with average dwell-time", Theorem 2; resets enter
like the change of forms.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from math import inf, log, sqrt
from types import MappingProxyType

import numpy as np

from deshybrid.continuous.checks import require_positive
from deshybrid.continuous.conic import Term, congruence, drift, has_solver, identity, solve
from deshybrid.continuous.error import ErrorDynamics, error_dynamics
from deshybrid.continuous.forms import MARGIN, lyapunov_frames
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.lmi import shifted_dynamics
from deshybrid.continuous.modes import decay_rate
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.exact import exponential_below, rational, scaled
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_inequalities import Motion, flow_decreases, jump_decreases
from deshybrid.linear.observability import sorted_spectrum
from deshybrid.model.system import HybridSystem

SHARES = (0.2, 0.4, 0.6, 0.8, 0.95)
"""λ = μ + share · (slowest decay - μ)."""
CUTS = 7
"""Bisections of log ρ."""
ROUND_UP = 1e-6
"""ρ and τ are raised by this share, so that exact arithmetic confirms them."""
LARGEST = 60_000
"""Beyond this many nonzero numbers in a conic problem, forms of Lyapunov's equation have to do."""


@dataclass(frozen=True, slots=True, eq=False)
class AverageDwell:
    """A claim "an average dwell time of at least `dwell` seconds: the error decays at `rate`", and what proves it.

    rate μ and decay λ in 1/s; jump: ρ; P (n, n) by location.  With `dwell` 0 every switching will do.
    """

    dwell: float
    rate: float
    decay: float
    jump: float
    P: Mapping[str, FloatArray]

    def record(self) -> dict[str, object]:
        """Return the claim as JSON values."""
        forms = {name: form.tolist() for name, form in self.P.items()}
        return {"dwell": self.dwell, "rate": self.rate, "decay": self.decay, "jump": self.jump, "P": forms}

    def __str__(self) -> str:
        if self.dwell == 0:
            return "average dwell time: any switching contracts at the rate"
        needed = f"{self.dwell:.6g} s is long enough without detection delay"
        return f"average dwell time: {needed}; single stays may be shorter"


def average_dwell(dynamics: ErrorDynamics, *, rate: float) -> AverageDwell | None:
    """Return the least average dwell time that was found and proved; None where some location is not faster than μ.

    rate (1/s): μ.  Raises `UsageError` (DH0508) for a rate that is not positive.

    >>> from deshybrid.continuous.error import ErrorReset
    >>> one = np.eye(1)
    >>> kicked = ErrorDynamics(("p",), {"p": -one}, (ErrorReset("p", "p", 4 * one, np.zeros(1)),))
    >>> found = average_dwell(kicked, rate=0.5)
    >>> bool(2.7725 < found.dwell)  # log(4)/(λ - 0.5) with λ below 1
    True
    """
    require_positive("rate", rate)
    slowest = min((-decay_rate(sorted_spectrum(F), dynamics.step) for F in dynamics.matrices.values()), default=inf)
    if not rate < slowest < inf:
        return None
    found = (_with_decay(dynamics, rate, rate + share * (slowest - rate)) for share in SHARES)
    proved = [entry for entry in found if entry is not None and is_proved_average(dynamics, entry)]
    return min(proved, key=lambda entry: entry.dwell, default=None)


def average_dwell_of(system: HybridSystem, gains: ObserverGains) -> AverageDwell | None:
    """Return the average dwell time of a design, at the rate it certifies; without detection delay."""
    return average_dwell(error_dynamics(system, gains.gains), rate=gains.rate)


def is_proved_average(dynamics: ErrorDynamics, claim: AverageDwell) -> bool:
    """Return whether the claim holds in exact arithmetic, resets, flows and τ."""
    step = None if dynamics.step is None else Fraction(dynamics.step)
    P, decay, jump = {n: rational(X.tolist()) for n, X in claim.P.items()}, Fraction(claim.decay), Fraction(claim.jump)
    moves = [(Motion(rational(F.tolist()), step), P[name]) for name, F in dynamics.matrices.items()]
    if not all(is_positive_definite(form) and flow_decreases(move, form, 1, decay) for move, form in moves):
        return False
    for reset in dynamics.resets:
        if not jump_decreases(rational(reset.matrix.tolist()), P[reset.target], scaled(P[reset.source], jump), 1):
            return False
    return jump <= exponential_below(2 * (decay - Fraction(claim.rate)) * Fraction(claim.dwell))


def _with_decay(dynamics: ErrorDynamics, rate: float, decay: float) -> AverageDwell | None:
    """The least ρ found for this λ."""
    shifted = shifted_dynamics(dynamics, decay)
    frames = dict(zip(dynamics.locations, lyapunov_frames(shifted).entry, strict=True))
    jumps = [frames[r.target] @ r.matrix @ np.linalg.inv(frames[r.source]) for r in dynamics.resets]
    high = max((float(np.linalg.norm(jump, 2)) ** 2 for jump in jumps), default=0.0) * (1 + ROUND_UP)
    if not np.isfinite(high):
        return None
    inner = {name: np.eye(len(frame)) for name, frame in frames.items()}
    size = len(jumps[0]) if jumps else 0
    affordable = has_solver() and (size * (size + 1) // 2) ** 2 * (len(frames) + len(jumps)) <= LARGEST
    low = min(1.0, high)
    for _ in range(CUTS if affordable and high > 1 else 0):
        middle = sqrt(low * high)
        tried = _forms(shifted, frames, jumps, middle)
        low, high, inner = (low, middle, tried) if tried is not None else (middle, high, inner)
    jump = max(1.0, high * (1 + ROUND_UP))
    P = {name: _symmetric(frame.T @ inner[name] @ frame) for name, frame in frames.items()}
    dwell = log(jump) / (2 * (decay - rate)) * (1 + ROUND_UP) if high > 1 else 0.0
    return AverageDwell(dwell, rate, decay, jump if high > 1 else 1.0, MappingProxyType(P))


def _forms(
    shifted: ErrorDynamics, frames: Mapping[str, FloatArray], jumps: list[FloatArray], rho: float
) -> dict[str, FloatArray] | None:
    """Forms in the frames for this ρ, None where none were found."""
    places, inequalities = shifted.locations, list[list[Term]]()
    size = len(jumps[0])
    for i, name in enumerate(places):
        inside = frames[name] @ shifted.matrices[name] @ np.linalg.inv(frames[name])
        flow = -drift(inside) if shifted.step is None else identity(size) - congruence(inside)
        inequalities += [[Term(i, identity(size))], [Term(i, flow / max(float(np.linalg.norm(inside, 2)), MARGIN))]]
    for reset, jump in zip(shifted.resets, jumps, strict=True):
        source, target = places.index(reset.source), places.index(reset.target)
        if source == target:
            inequalities.append([Term(source, identity(size) - congruence(jump) / rho)])
        else:
            inequalities.append([Term(source, identity(size)), Term(target, -congruence(jump) / rho)])
    found = solve(size, len(places), inequalities, normalised=len(places))
    return None if found.margin < MARGIN else dict(zip(places, found.unknowns, strict=True))


def _symmetric(matrix: FloatArray) -> FloatArray:
    return frozen_array((matrix + matrix.T) / 2, matrix.shape)


__all__ = ["AverageDwell", "average_dwell", "average_dwell_of", "is_proved_average"]
