"""Observer gains: one G_i per persistent location, and what the closed loop A_i - G_i C_i is then like.

In: a hybrid system, its persistent locations, the rate μ (1/s) and the dwell time D (s) that are wanted.  Out: gains,
spectra, eigenvectors, and the modes that no gain moves.  What the model says of a location comes first: its `gains`
are taken as they are, its `poles` are placed; every other location gets the default search of `continuous/search.py`.

Defaults.  D: the model's `observer.dwell`, else the least `dwell.min` if every persistent location states one.  μ: the
model's `observer.rate`, else 1/D, else the geometric mean of the nonzero |eigenvalues| of the persistent locations (as
fast as the plant), else 1/s.  If no D is known, the search aims at D = 1/μ.  In discrete time all poles and rates are
still in 1/s and mapped by λ -> e^{λ h}; gains are those of the predictor x̂(k+1) = A x̂ + B u + G (y - C x̂ - D u).

A detectable location keeps its fixed modes.  Where they are too slow for μ, μ becomes half of what they have, so that
the required dwell time is at most twice the least that any rate would ask, and a warning says so.

Source: Balluchi et al. (2012), section 3.2, (16), (20).
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import inf
from types import MappingProxyType
from typing import Literal, TypeAlias

import numpy as np

from deshybrid.continuous.checks import (
    cap_warning,
    faint_warning,
    gain_problems,
    loop_problems,
    loop_warnings,
    must_be_left,
    rate_left,
    require_not_negative,
    require_positive,
    spread_warning,
    unplaced_warning,
)
from deshybrid.continuous.error import dynamics_of, error_dynamics, error_resets, state_scale
from deshybrid.continuous.lqe import filter_gains, location_noise
from deshybrid.continuous.modes import condition
from deshybrid.continuous.placement import output_rank, place_detectable, place_gain, placeable, spread_poles
from deshybrid.continuous.scale import best_scale
from deshybrid.continuous.search import GainTask, default_gain, from_plane_s, reset_norm, to_plane_s
from deshybrid.diagnostics import Diagnostic, GainError, raise_all
from deshybrid.linear.arrays import ComplexArray, FloatArray, frozen_array
from deshybrid.linear.observability import KalmanSplit, kalman_split, sorted_spectrum
from deshybrid.model.system import HybridSystem

Method: TypeAlias = Literal["place", "lqe", "lmi"]
"""Placed poles, filters, or gains and forms together; see `deshybrid.continuous.methods`."""
GainSource: TypeAlias = Literal["model gains", "model poles", "search", "lqe", "lmi"]


@dataclass(frozen=True, slots=True, eq=False)
class ObserverGains:
    """Gains and closed loops by location, in the order of `locations`; read-only.

    gains (n, p_i); closed_loop F = A - G C (n, n); eigenvalues (n,), slowest first; eigenvectors (n, n) with columns
    of unit length in the norm ‖diag(scale)⁻¹ ·‖₂; condition: κ of these columns in that norm (infinite where F is
    defective); fixed_modes: the eigenvalues that no gain moves; sources: where each gain came from; `rate` (1/s) is
    what may be certified, `requested_rate` what was asked (or the default); `dwell` (s): the stated dwell time or
    None.
    """

    locations: tuple[str, ...]
    gains: Mapping[str, FloatArray]
    closed_loop: Mapping[str, FloatArray]
    eigenvalues: Mapping[str, ComplexArray]
    eigenvectors: Mapping[str, ComplexArray]
    condition: Mapping[str, float]
    fixed_modes: Mapping[str, ComplexArray]
    sources: Mapping[str, GainSource]
    method: Method
    scale: FloatArray
    rate: float
    requested_rate: float
    dwell: float | None
    warnings: tuple[Diagnostic, ...] = ()

    def lines(self) -> list[str]:
        """Return the poles of every location in words, and its fixed modes."""
        made = []
        for name in self.locations:
            text, fixed = f"{name}: poles {_poles(self.eigenvalues[name])}", _poles(self.fixed_modes[name])
            made.append(f"{text}; fixed, as no output shows them: {fixed}" if fixed else text)
        return made


def design_gains(
    system: HybridSystem,
    locations: tuple[str, ...],
    *,
    rate: float | None = None,
    dwell: float | None = None,
    delay: float = 0.0,
    method: Literal["place", "lqe"] = "place",
) -> ObserverGains:
    """Return one gain per location of `locations` (the persistent ones), aiming at (20) for the time D - delay.

    The search goes over placed poles ("place") or over filters ("lqe", `deshybrid.continuous.lqe`).

    Raises
    ------
    UsageError
        DH0501 a location without continuous dynamics; DH0508 a rate, dwell time or delay that makes no sense.
    GainError
        DH0503 a location keeps a mode that neither decays nor is seen; DH0504 a given gain leaves a location unstable,
        both without a longest stay;
        DH0505 given poles do not fit; DH0507 a given gain has the wrong shape.  All of them together.

    Whether the gains meet (20) is decided by `deshybrid.continuous.dwell.certify_dwell`.

    >>> from deshybrid.model.load import loads
    >>> system = loads('''
    ... format: deshybrid/1
    ... name: twin
    ... state: [a, b]
    ... output: [y]
    ... locations:
    ...   p: {A: [[0, 1], [-4, -1]], C: [[1, 0]]}
    ...   q: {A: [[0, 1], [-9, -1]], C: [[1, 0]]}
    ... transitions:
    ...   - {from: p, to: q, event: up, emits: up}
    ...   - {from: q, to: p, event: down, emits: down}
    ... ''')
    >>> made = design_gains(system, ("p", "q"), rate=2.0, dwell=1.5)
    >>> [bool(made.eigenvalues[name].real.max() < -2.0) for name in made.locations]
    [True, True]
    """
    require_positive("rate", rate)
    require_positive("dwell time", dwell)
    require_not_negative("delay", delay)
    splits = {name: _split(system, name) for name in locations}
    raise_all([p for name in locations for p in gain_problems(system, name, splits[name])], GainError)
    plan = _plan(system, splits, rate=rate, dwell=dwell, delay=delay)
    found = {name: _gain(plan, name, method) for name in locations}
    if any(source in ("search", "lqe") for _, source, _ in found.values()):
        # The first gains show which norm suits the closed loops; searching again in it finds smaller gains.
        loops = error_dynamics(system, {name: gain for name, (gain, _, _) in found.items()})
        plan = replace(plan, scale=best_scale(loops, plan.scale, plan.certified))
        found = {name: _gain(plan, name, method) for name in locations}
    made = analysed(plan, found, method)
    raise_all(loop_problems(system, made.closed_loop, made.eigenvalues, made.warnings), GainError)
    return made


@dataclass(frozen=True, slots=True, eq=False)
class GainPlan:
    """What the search is told: rates in 1/s as asked and as left by fixed modes; `aim`: the dwell time to aim at."""

    system: HybridSystem
    splits: Mapping[str, KalmanSplit]
    scale: FloatArray
    requested: float
    certified: float
    dwell: float | None
    aim: float


def stated_dwell(system: HybridSystem, locations: tuple[str, ...]) -> float | None:
    """Return the dwell time D (s): the observer's, or the least of the locations' if each states one, else None."""
    if system.observer.dwell is not None:
        return system.observer.dwell
    stated = [system.location(name).dwell.min for name in locations]
    known = [value for value in stated if value]
    return min(known) if known and len(known) == len(stated) else None


def _split(system: HybridSystem, name: str) -> KalmanSplit:
    dynamics = dynamics_of(system, name)
    return kalman_split(dynamics.A, dynamics.C)


def default_rate(system: HybridSystem, locations: tuple[str, ...], dwell: float | None) -> float:
    """Return the rate μ (1/s) that is aimed at where none is asked for, as the module says."""
    if system.observer.rate is not None:
        return system.observer.rate
    if dwell is not None:
        return 1 / dwell
    spectra = [np.linalg.eigvals(dynamics_of(system, name).A).astype(np.complex128) for name in locations]
    sizes = np.abs(to_plane_s(np.concatenate(spectra), system.time_step)) if spectra else np.ones(0)
    moving = sizes[sizes > 1e-6 * sizes.max(initial=0.0)]
    return float(np.exp(np.log(moving).mean())) if moving.size else 1.0


def _plan(
    system: HybridSystem,
    splits: Mapping[str, KalmanSplit],
    *,
    rate: float | None,
    dwell: float | None,
    delay: float,
) -> GainPlan:
    locations = tuple(splits)
    dwell = stated_dwell(system, locations) if dwell is None else dwell
    requested = default_rate(system, locations, dwell) if rate is None else rate
    lasting = [split for name, split in splits.items() if not must_be_left(system, name, split)]
    certified = min(requested, *(rate_left(split, requested, system.time_step) for split in lasting), inf)
    aim = 1 / requested if dwell is None else max(dwell - delay, 0.05 * dwell)
    return GainPlan(system, splits, state_scale(system, locations), requested, certified, dwell, aim)


def _task(plan: GainPlan, name: str) -> GainTask:
    dynamics = dynamics_of(plan.system, name)
    jumps = [reset.matrix for reset in error_resets(plan.system, tuple(plan.splits)) if reset.source == name]
    return GainTask(
        dynamics.A,
        dynamics.C,
        plan.splits[name],
        plan.scale,
        reset_norm(jumps, plan.scale),
        plan.requested,
        plan.certified,
        plan.aim,
        1.1 if plan.dwell is not None else 2.0,
        plan.system.time_step,
    )


FoundGain: TypeAlias = tuple[FloatArray, GainSource, tuple[Diagnostic, ...]]


def _gain(plan: GainPlan, name: str, method: Literal["place", "lqe"]) -> FoundGain:
    system, task = plan.system, _task(plan, name)
    warning = cap_warning(system, name, task.split, task.rate) + faint_warning(system, name, task.split)
    if name in system.observer.gains:
        return system.observer.gains[name], "model gains", warning
    if name not in system.observer.poles:
        return (*_searched(plan, name, task, method), warning)
    poles, fixed = np.array(system.observer.poles[name], dtype=np.complex128), sorted_spectrum(task.split.A_u)
    if len(poles) > task.split.observable_dimension:
        poles = placeable(poles, to_plane_s(fixed, task.step))
        warning = (*warning, unplaced_warning(system.location(name), poles, fixed))
    poles, changed = spread_poles(from_plane_s(poles, task.step), output_rank(task.C, task.scale))
    if changed:
        warning = (*warning, spread_warning(system.location(name), poles))
    if task.split.observable_dimension == len(task.A):
        return place_gain(task.A, task.C, poles, scale=task.scale), "model poles", warning
    return place_detectable(task.split, poles, task.scale), "model poles", warning


def _searched(
    plan: GainPlan, name: str, task: GainTask, method: Literal["place", "lqe"]
) -> tuple[FloatArray, GainSource]:
    if method == "place":
        return default_gain(task), "search"
    noise = location_noise(plan.system, name, state_scale(plan.system, tuple(plan.splits)), plan.requested)
    return default_gain(task, lambda wanted, speed: filter_gains(wanted, noise, speed)), "lqe"


def analysed(plan: GainPlan, found: Mapping[str, FoundGain], method: Method) -> ObserverGains:
    """Return the value of a design: the gains found, with what their closed loops are like."""
    gains, loops, spectra, bases, kappas = {}, {}, {}, {}, {}
    for name, (gain, _, _) in found.items():
        dynamics = dynamics_of(plan.system, name)
        gains[name] = frozen_array(gain, gain.shape)
        loops[name] = frozen_array(dynamics.A - gain @ dynamics.C, dynamics.A.shape)
        spectra[name], bases[name], kappas[name] = _eigen(loops[name], plan.scale)
    warnings = tuple(warning for _, _, extra in found.values() for warning in extra)
    return ObserverGains(
        locations=tuple(found),
        gains=MappingProxyType(gains),
        closed_loop=MappingProxyType(loops),
        eigenvalues=MappingProxyType(spectra),
        eigenvectors=MappingProxyType(bases),
        condition=MappingProxyType(kappas),
        fixed_modes=MappingProxyType({name: sorted_spectrum(plan.splits[name].A_u) for name in found}),
        sources=MappingProxyType({name: source for name, (_, source, _) in found.items()}),
        method=method,
        scale=frozen_array(plan.scale, plan.scale.shape),
        rate=plan.certified,
        requested_rate=plan.requested,
        dwell=plan.dwell,
        warnings=(*warnings, *loop_warnings(plan.system, kappas)),
    )


def with_gains(
    system: HybridSystem,
    made: ObserverGains,
    gains: Mapping[str, FloatArray],
    sources: Mapping[str, GainSource],
    *,
    method: Method,
) -> ObserverGains:
    """Return a design with other gains, of which those in `sources` come from there; all else stays."""
    splits = {name: _split(system, name) for name in made.locations}
    plan = GainPlan(system, splits, made.scale, made.requested_rate, made.rate, made.dwell, 0.0)
    found: dict[str, FoundGain] = {
        name: (gains[name], sources.get(name, made.sources[name]), ()) for name in made.locations
    }
    other = analysed(plan, found, method)
    told = tuple(warning for warning in made.warnings if warning.code != "DH0510")
    return replace(other, warnings=(*told, *other.warnings))


def _poles(values: ComplexArray) -> str:
    return ", ".join(f"{pole.real:.4g}{pole.imag:+.4g}j" if pole.imag else f"{pole.real:.4g}" for pole in values)


def _eigen(F: FloatArray, scale: FloatArray) -> tuple[ComplexArray, ComplexArray, float]:
    """Eigenvalues in the order of `sorted_spectrum`, unit eigenvectors in the scaled norm, and their κ."""
    values, vectors = np.linalg.eig(F * scale / scale[:, None])
    order = np.lexsort((-values.imag, -values.real))
    vectors = vectors[:, order].astype(np.complex128)
    return values[order].astype(np.complex128), scale[:, None] * vectors, condition(vectors)


__all__ = [
    "FoundGain",
    "GainPlan",
    "GainSource",
    "Method",
    "ObserverGains",
    "analysed",
    "default_rate",
    "design_gains",
    "place_gain",
    "stated_dwell",
    "with_gains",
]
