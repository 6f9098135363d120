"""Messages about gains: what is wrong with a wish, and what a warning has to name.

In: a system and the Kalman split of a location.  Out: diagnostics DH0502 to DH0513; explanations in `explanations/05`.
"""

from collections.abc import Mapping, Sequence
from math import inf, isfinite

import numpy as np

from deshybrid.continuous.error import dynamics_of
from deshybrid.continuous.modes import decay_rate
from deshybrid.continuous.placement import placeable, pole_problem
from deshybrid.diagnostics import Diagnostic, UsageError, diagnostic
from deshybrid.linear.arrays import ComplexArray, FloatArray
from deshybrid.linear.observability import KalmanSplit, sorted_spectrum
from deshybrid.model.scalars import LARGEST, SMALLEST, odd_size
from deshybrid.model.system import HybridSystem, Location

STABLE = 1e-9
"""A mode counts as decaying if its rate exceeds this share of the size of the location's matrix."""
ROOM = 0.95
"""A rate above this share of the slowest fixed mode's is out of reach."""
FAINT = 1e-5
"""A mode of which outputs show a smaller share than this is named in a warning."""
INVOLVED = 0.1
"""A state is named with a mode if its share of the mode's eigenvector, in scaled units, exceeds this."""


def require_positive(what: str, value: float | None) -> None:
    """Raise `UsageError` (DH0508) unless `value` is None or a positive number of a size that models may have."""
    if value is not None and not (isfinite(value) and value > 0):
        raise UsageError(diagnostic("DH0508", f"the {what} must be positive and finite, it is {value:g}"))
    if value is not None and odd_size(value):
        raise UsageError(diagnostic("DH0508", f"the {what} is {value:g}, beyond {SMALLEST:g} to {LARGEST:g}"))


def require_not_negative(what: str, value: float) -> None:
    """Raise `UsageError` (DH0508) unless `value` is a finite number of at least zero."""
    if not (isfinite(value) and value >= 0):
        raise UsageError(diagnostic("DH0508", f"the {what} must not be negative and finite, it is {value:g}"))


def rate_left(split: KalmanSplit, requested: float, step: float | None) -> float:
    """Return the rate (1/s) to certify: what is asked, or half of what the fixed modes have where that is too slow."""
    allowed = -decay_rate(sorted_spectrum(split.A_u), step)
    return requested if requested <= ROOM * allowed else allowed / 2


def gain_problems(system: HybridSystem, name: str, split: KalmanSplit, *, alone: bool = True) -> list[Diagnostic]:
    """Return what stands against a gain for this location: fixed modes that stay, poles or gains that do not fit.

    Fixed modes may stay where the location has a longest stay: whether it is left in time, certificates tell.
    alone: the location has to make its own error decay; else other locations are relied on for modes it does not see.
    """
    location, dynamics = system.location(name), dynamics_of(system, name)
    problems = _undetectable(system, location, split) if alone and location.dwell.max is None else []
    gain, poles = system.observer.gains.get(name), system.observer.poles.get(name)
    wanted = (len(dynamics.A), len(dynamics.C))
    if gain is not None and gain.shape != wanted:
        problems.append(diagnostic("DH0507", f"the gain of `{name}` has shape {gain.shape}, expected {wanted}"))
    if gain is None and poles is not None:
        problems += _pole_problems(location, np.array(poles, dtype=np.complex128), split)
    return problems


def cap_warning(system: HybridSystem, name: str, split: KalmanSplit, requested: float) -> tuple[Diagnostic, ...]:
    """Return a warning (DH0502) if the fixed modes of this location are too slow for the rate that was asked for.

    Or one (DH0503) if they do not decay at all and the location has to be left in time.
    """
    if must_be_left(system, name, split):
        return (_growing(system, system.location(name), split),)
    left = rate_left(split, requested, system.time_step)
    if left == requested:
        return ()
    location, own = system.location(name), 2 * left
    message = f"fixed modes of `{name}` cap the rate of convergence: {requested:.6g} 1/s asked, {left:.6g} 1/s left"
    return (
        diagnostic(
            "DH0502",
            message,
            location.span,
            notes=_modes(system, location, split),
            helps=(f"ask for a rate below {own:.6g} 1/s, or measure one of the states named",),
            severity="warning",
        ),
    )


def faint_warning(system: HybridSystem, name: str, split: KalmanSplit) -> tuple[Diagnostic, ...]:
    """Return a warning (DH0515) if the outputs of this location barely show some mode.

    Measured by Popov, Belevitch and Hautus: the least singular value of [A - λ I; C] over the modes λ, for balanced
    states, ‖A‖ = 1 and rows of C of unit length.
    """
    A, C = split.A_o, split.C_o
    size, rows = float(np.linalg.norm(A, 2)) if A.size else 0.0, np.linalg.norm(C, axis=1)
    if size == 0.0 or not rows.any():
        return ()
    seen = C[rows > 0] / rows[rows > 0][:, None]
    for mode in sorted_spectrum(A):
        block = np.vstack([(A - mode * np.eye(len(A))) / size, seen])
        shown = float(np.linalg.svd(block, compute_uv=False).min())
        if shown < FAINT:
            location = system.location(name)
            message = f"outputs of `{name}` barely show the mode {_number(mode)}: {shown:.1g} of what they could show"
            helps = ("expect large gains, or measure something that moves with this mode",)
            return (diagnostic("DH0515", message, location.span, helps=helps, severity="warning"),)
    return ()


def spread_warning(location: Location, poles: ComplexArray) -> Diagnostic:
    """Return the warning (DH0506) that repeated poles were moved apart."""
    used = ", ".join(_number(pole) for pole in poles)
    return diagnostic(
        "DH0506",
        f"poles of `{location.name}` are repeated more often than its outputs allow; placed at {used}",
        location.span,
        notes=("a pole repeated more often than rank(C) has too few eigenvectors, so κ would be infinite",),
        helps=("write distinct poles",),
        severity="warning",
    )


def unplaced_warning(location: Location, poles: ComplexArray, fixed: ComplexArray) -> Diagnostic:
    """Return the warning (DH0513) that a pole was given for every state, but fixed modes keep their place."""
    kept, used = (", ".join(_number(value) for value in values) for values in (fixed, poles))
    return diagnostic(
        "DH0513",
        f"{len(fixed)} of the poles of `{location.name}` cannot be placed, as the location is not observable",
        location.span,
        notes=(f"fixed modes, which no pole replaces: {kept}", f"poles placed: {used or 'none'}"),
        severity="warning",
    )


def loop_problems(
    system: HybridSystem,
    loops: Mapping[str, FloatArray],
    spectra: Mapping[str, ComplexArray],
    warnings: Sequence[Diagnostic] = (),
) -> list[Diagnostic]:
    """Return an error (DH0504) for every location whose closed loop does not decay, beyond what rounding may hide.

    A location with a longest stay need not decay.

    Warnings (DH0515) that outputs barely show a mode are repeated as notes, as they tell why.
    """
    found = []
    for name, values in spectra.items():
        rate = decay_rate(values, system.time_step)
        if system.location(name).dwell.max is not None or rate < -STABLE * _speed(loops[name], system.time_step):
            continue
        given = "the given gain" if name in system.observer.gains else "the gain found"
        worst = ", ".join(_number(v) for v in values if decay_rate(np.array([v]), system.time_step) >= rate - 1e-9)
        found.append(
            diagnostic(
                "DH0504",
                f"{given} leaves the observer of `{name}` unstable: eigenvalue {worst}",
                system.location(name).span,
                notes=tuple(d.message for d in warnings if d.code == "DH0515" and f"`{name}`" in d.message),
                helps=("every eigenvalue of A - G C must decay; remove the gain to have one designed",),
            )
        )
    return found


def loop_warnings(system: HybridSystem, kappas: Mapping[str, float]) -> tuple[Diagnostic, ...]:
    """Return a warning (DH0510) for every location whose closed loop is defective."""
    return tuple(
        diagnostic(
            "DH0510",
            f"the closed loop of `{name}` is not diagonalisable, so its condition number is infinite",
            system.location(name).span,
            notes=("condition (20) cannot hold with κ = ∞",),
            helps=("choose distinct poles",),
            severity="warning",
        )
        for name, kappa in kappas.items()
        if kappa == inf
    )


def is_detectable(system: HybridSystem, name: str, split: KalmanSplit) -> bool:
    """Return whether every mode that no output of the location shows decays by itself."""
    rate = decay_rate(sorted_spectrum(split.A_u), system.time_step)
    return rate < -STABLE * _speed(dynamics_of(system, name).A, system.time_step)


def must_be_left(system: HybridSystem, name: str, split: KalmanSplit) -> bool:
    """Return whether a mode of the location neither decays nor is seen, but its stays are bounded."""
    return system.location(name).dwell.max is not None and not is_detectable(system, name, split)


def _growing(system: HybridSystem, location: Location, split: KalmanSplit) -> Diagnostic:
    message = f"an unobservable mode of `{location.name}` does not decay: the other locations have to make up for it"
    helps = ("only certificates by matrix inequalities take the longest stay into account (extra `lmi`)",)
    notes = _modes(system, location, split)
    return diagnostic("DH0503", message, location.span, notes=notes, helps=helps, severity="warning")


def _undetectable(system: HybridSystem, location: Location, split: KalmanSplit) -> list[Diagnostic]:
    if is_detectable(system, location.name, split):
        return []
    message = f"no gain exists for `{location.name}`: an unobservable mode of this persistent location does not decay"
    helps = (
        "measure one of the states named, or model the damping that makes the mode decay",
        "other locations may determine the mode if every stay ends in time, by Balluchi et al. (2003): state"
        " `dwell: {min: …, max: …}` for all persistent locations",
    )
    return [diagnostic("DH0503", message, location.span, notes=_modes(system, location, split), helps=helps)]


def _pole_problems(location: Location, poles: ComplexArray, split: KalmanSplit) -> list[Diagnostic]:
    name, modes = location.name, sorted_spectrum(split.A_u)
    every = len(poles) == len(split.transform) and not pole_problem(poles, len(poles))
    problem = pole_problem(placeable(poles, modes) if every else poles, split.observable_dimension)
    if problem:
        fixed = ", ".join(_number(mode) for mode in modes)
        notes = (f"fixed modes, which no pole replaces: {fixed}",) if fixed else ()
        return [diagnostic("DH0505", f"poles of `{name}`: {problem}", location.span, notes=notes)]
    if (poles.real >= 0).any():
        message = f"poles of `{name}`: {_number(poles[poles.real >= 0][0])} does not decay"
        helps = ("poles are in 1/s with negative real part, also in discrete time",)
        return [diagnostic("DH0505", message, location.span, helps=helps)]
    return []


def _modes(system: HybridSystem, location: Location, split: KalmanSplit) -> tuple[str, ...]:
    """One note a fixed mode: its eigenvalue and the states that move in it."""
    k = split.observable_dimension
    values, vectors = np.linalg.eig(split.A_u)
    order = np.lexsort((-values.imag, -values.real))
    hidden = split.transform[:, k:]
    sizes = np.linalg.norm(split.inverse, axis=0)
    notes = []
    for value, vector in zip(values[order], vectors[:, order].T, strict=True):
        if value.imag < 0:
            continue
        shares = np.abs(hidden @ vector) * sizes
        names = [n for n, share in zip(system.state_names, shares, strict=True) if share > INVOLVED * shares.max()]
        moving = ", ".join(f"`{n}`" for n in names)
        notes.append(f"`{location.name}`: mode {_number(value)} in {moving}, which no output shows")
    return tuple(notes)


def _speed(matrix: FloatArray, step: float | None) -> float:
    return float(np.linalg.norm(matrix, 2)) if step is None else 1 / step


def _number(value: complex) -> str:
    """An eigenvalue as one reads it, a conjugate pair by its upper member."""
    if abs(value.imag) <= 1e-9 * abs(value):
        return f"{value.real:.6g}"
    return f"{value.real:.6g}{value.imag:+.6g}j"


__all__ = [
    "cap_warning",
    "faint_warning",
    "gain_problems",
    "is_detectable",
    "loop_problems",
    "loop_warnings",
    "must_be_left",
    "rate_left",
    "require_not_negative",
    "require_positive",
    "spread_warning",
    "unplaced_warning",
]
