"""The sharper test: the error contracts from switch to switch, for all stays of a box and any number of cycles.

In: error dynamics (F_i, or M_i in sampled time) with resets, and for each location the shortest and the longest stay.
Out: a certificate: matrices P_i > 0 and a factor γ < 1 with

    E_ij(τ)ᵀ P_j E_ij(τ) <= γ² P_i,  E_ij(τ) = R¹_ij e^{F_i τ},  for every reset and every stay τ of location i,

so that ζᵀ P ζ, taken at the entries of locations, falls by γ² with every switch.  No location has to decay by itself:
what one does not show may grow there, as long as another one takes it away.

Between grid points.  The stays of a location are cut into cells [a, b].  In a cell of width w, with s = τ - a,
e^{F τ} = e^{F a} + s F e^{F a} + rest, where ‖rest‖ <= w²/2 ‖F² e^{F a}‖ b and b bounds ‖e^{F u}‖ for u <= w, all
norms in P.  Hence ‖E(τ)‖ <= ‖R (e^{F a} + w/2 F e^{F a})‖ + w/2 ‖R F e^{F a}‖ + ‖R‖ ‖rest‖; cells are halved until that
is below γ.  Fast modes have died out before the shortest stay, so few cells are needed.  In sampled time N = (M - I)/h
takes the place of F and M^k that of e^{F k h}; the same bound holds, and a cell of one step has its two ends only.

P without a solver: P_i = I + γ₀⁻² Σ E_ij(τ)ᵀ P_j E_ij(τ) over the resets and the two ends of the stays, in the units of
the states; it exists for γ₀ above the root of the spectral radius of that sum.  Where it fails and Clarabel is
installed (extra `lmi`), the linear matrix inequalities on a grid of stays find P.  `deshybrid.verify` proves what is
claimed, without this module.  Cost: a hundred or so matrix exponentials a location.

Source: error dynamics (24) of Balluchi et al. (2003); the quadratic certificates of switched systems.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from math import ceil, floor, log
from types import MappingProxyType
from typing import Literal, NamedTuple, TypeAlias

import numpy as np

from deshybrid.continuous.error import ErrorDynamics
from deshybrid.linear.arrays import FloatArray, frozen_array

GRID = 33
"""So many stays are looked at before cells decide."""
RATIOS = (1.02, 1.1, 1.3, 1.7, 2.5, 4.0)
"""γ₀ over its least value; a larger one makes P rounder."""
ROOM = 1.02
"""γ is claimed this far above what the grid shows."""
MOST_CELLS = 20_000
MARGIN = 1e-7
PART_OF_A_STEP = 1e-6

Stay: TypeAlias = tuple[float, float]
BoxTheorem: TypeAlias = Literal["B03-box", "B03-box-sampled"]


class WorstRound(NamedTuple):
    """The cycle and stays (s) that contract least among those looked at, and the spectral radius of one round."""

    locations: tuple[str, ...]
    stays: tuple[float, ...]
    growth: float


@dataclass(frozen=True, slots=True, eq=False)
class ContractionCertificate:
    """A claim "the error contracts by γ with every switch, as long as every stay lies within its bounds".

    gamma: in the norm of P at the entries of the locations; rate (1/s): what γ gives if all stays are the longest;
    stays by location (s); P (n, n) by location; cells: the ends of the cells of each location's stays (s); matrices:
    F_i, or M_i where `step` (s) is not None; delay (s): by how much the stays were widened; worst: the least
    contracting round found.
    """

    theorem: BoxTheorem
    holds: bool
    gamma: float
    rate: float
    stays: Mapping[str, Stay]
    delay: float
    P: Mapping[str, FloatArray]
    cells: Mapping[str, tuple[float, ...]]
    matrices: Mapping[str, FloatArray]
    step: float | None
    reason: str

    def record(self) -> dict[str, object]:
        """Return the JSON form, with all that proves the claim."""
        record: dict[str, object] = {
            "theorem": self.theorem,
            "rate": self.rate,
            "dwell": min((stay[0] for stay in self.stays.values()), default=None),
            "delay": self.delay,
            "holds": self.holds,
            "P": {name: matrix.tolist() for name, matrix in self.P.items()} if self.holds else None,
            "required_dwell": None,
            "reason": self.reason,
            "step": self.step,
            "gamma": self.gamma,
            "stays": {name: list(stay) for name, stay in self.stays.items()},
            "cells": {name: list(ends) for name, ends in self.cells.items()},
        }
        if self.step is not None:
            record["matrices"] = {name: matrix.tolist() for name, matrix in self.matrices.items()}
        return record


def certify_box(
    dynamics: ErrorDynamics, stays: Mapping[str, Stay], scale: FloatArray, *, delay: float = 0.0
) -> ContractionCertificate:
    """Return whether the error contracts for all stays; stays (s) by location, scale (n,): sizes of the states.

    delay (s): a stay of the observer may be so much shorter or longer than the plant's.  "No" is a value.

    >>> from deshybrid.continuous.error import ErrorReset
    >>> jump = ErrorReset("p", "p", np.array([[0.5]]), np.zeros(1))
    >>> growing = ErrorDynamics(("p",), {"p": np.array([[0.1]])}, (jump,))
    >>> certify_box(growing, {"p": (1.0, 6.0)}, np.ones(1)).holds, 0.5 * np.exp(0.6) < 1
    (True, np.True_)
    >>> certify_box(growing, {"p": (1.0, 7.0)}, np.ones(1)).holds, 0.5 * np.exp(0.7) < 1
    (False, np.False_)
    """
    box = Box(dynamics, {name: _widened(stays[name], delay, dynamics.step) for name in dynamics.locations})
    found = min(_candidates(box, scale), key=lambda pair: pair[0], default=None)
    if found is None:
        return _certificate(box, None, delay, _why_not(box))
    peak, P = found
    gamma = (peak + 1) / 2 if peak * ROOM >= 1 else peak * ROOM
    cells = None if peak >= 1 else _all_cells(box, P, gamma)
    if cells is None:
        return _certificate(box, None, delay, _why_not(box))
    return _certificate(box, (gamma, P, cells), delay, "")


@dataclass(frozen=True, eq=False)
class Box:
    """The error dynamics with the stays of each location, in sampled time whole steps."""

    dynamics: ErrorDynamics
    stays: Mapping[str, Stay]

    def flow(self, name: str, duration: float) -> FloatArray:
        """e^{F τ}, or M^k for k steps."""
        from scipy.linalg import expm

        matrix, step = self.dynamics.matrices[name], self.dynamics.step
        if step is None:
            return np.asarray(expm(matrix * duration))
        return np.asarray(np.linalg.matrix_power(matrix, round(duration / step)))

    def generator(self, name: str) -> FloatArray:
        """F, or (M - I)/h."""
        matrix, step = self.dynamics.matrices[name], self.dynamics.step
        return matrix if step is None else (matrix - np.eye(len(matrix))) / step

    def sampled(self, name: str, count: int) -> FloatArray:
        """So many stays of a location, ends included, as time allows them."""
        times = np.linspace(*self.stays[name], count)
        step = self.dynamics.step
        return times if step is None else np.unique(np.round(times / step)) * step


def _widened(stay: Stay, delay: float, step: float | None) -> Stay:
    low, high = max(stay[0] - delay, 0.0), stay[1] + delay
    if step is None:
        return low, high
    first = max(1, ceil(low / step - PART_OF_A_STEP))
    return first * step, max(first, floor(high / step + PART_OF_A_STEP)) * step


def _candidates(box: Box, scale: FloatArray) -> list[tuple[float, Mapping[str, FloatArray]]]:
    """Matrices P with the largest ‖E‖ that the grid shows in them."""
    maps = {name: [box.flow(name, float(t)) for t in box.sampled(name, GRID)] for name in box.dynamics.locations}
    ends = {name: (flows[0], flows[-1]) for name, flows in maps.items()}
    least = mean_square_growth(box.dynamics, ends)
    found = []
    for ratio in RATIOS:
        P = _summed(box.dynamics, ends, max(least, 1e-12) * ratio, scale)
        if P is not None:
            found.append((_peak(box.dynamics, maps, P), P))
    if min((peak for peak, _ in found), default=1.0) >= 1.0 / ROOM:
        from deshybrid.continuous.determinability_solver import solve_inequalities

        solved = solve_inequalities(box.dynamics, maps, scale)
        if solved is not None:
            found.append((_peak(box.dynamics, maps, solved), solved))
    return found


def mean_square_growth(dynamics: ErrorDynamics, flows: Mapping[str, tuple[FloatArray, ...]]) -> float:
    """Return the root of the spectral radius of P ↦ Σ EᵀPE over resets and the given flows, an upper bound of growth.

    >>> from deshybrid.continuous.error import ErrorReset
    >>> jump = ErrorReset("p", "p", np.array([[0.5]]), np.zeros(1))
    >>> mean_square_growth(ErrorDynamics(("p",), {"p": np.eye(1)}, (jump,)), {"p": (np.eye(1),)})
    0.5
    """
    names = dynamics.locations
    n = len(next(iter(dynamics.matrices.values())))
    P = {name: np.eye(n) for name in names}
    growth = 0.0
    for _ in range(60):
        P = {name: _images(dynamics, flows, P, name) for name in names}
        size = max(float(np.trace(matrix)) for matrix in P.values())
        if size == 0.0:
            return 0.0
        growth, P = size, {name: matrix / size for name, matrix in P.items()}
    # Not every round of a ring has the same size: the last full turns are averaged by a longer product.
    sizes = []
    for _ in range(12 * len(names)):
        P = {name: _images(dynamics, flows, P, name) for name in names}
        size = max(float(np.trace(matrix)) for matrix in P.values())
        if size == 0.0:
            return 0.0
        sizes.append(log(size))
        P = {name: matrix / size for name, matrix in P.items()}
    return float(np.exp(np.mean(sizes) / 2)) if growth else 0.0


def _images(
    dynamics: ErrorDynamics, flows: Mapping[str, tuple[FloatArray, ...]], P: Mapping[str, FloatArray], name: str
) -> FloatArray:
    total = np.zeros_like(P[name])
    for reset in dynamics.exits(name):
        for flow in flows[name]:
            E = reset.matrix @ flow
            total = total + E.T @ P[reset.target] @ E
    return total


def _summed(
    dynamics: ErrorDynamics, flows: Mapping[str, tuple[FloatArray, ...]], level: float, scale: FloatArray
) -> Mapping[str, FloatArray] | None:
    """P_i = S⁻² + γ₀⁻² Σ EᵀPE by iteration; None where it does not settle."""
    start = np.diag(1 / scale**2)
    P = dict.fromkeys(dynamics.locations, start)
    for _ in range(500):
        after = {name: start + _images(dynamics, flows, P, name) / level**2 for name in P}
        change = max(float(np.abs(after[name] - P[name]).max() / np.abs(after[name]).max()) for name in P)
        P = after
        if not all(np.isfinite(matrix).all() for matrix in P.values()):
            return None
        if change < 1e-6:
            return P
    return P


def _peak(dynamics: ErrorDynamics, maps: Mapping[str, list[FloatArray]], P: Mapping[str, FloatArray]) -> float:
    """The largest ‖E‖ on the grid; infinite where a P is not positive definite."""
    try:
        roots = {name: np.linalg.cholesky(matrix).T for name, matrix in P.items()}
    except np.linalg.LinAlgError:
        return np.inf
    inverses = {name: np.linalg.inv(root) for name, root in roots.items()}
    return max(
        (
            float(np.linalg.norm(roots[reset.target] @ reset.matrix @ flow @ inverses[reset.source], 2))
            for reset in dynamics.resets
            for flow in maps[reset.source]
        ),
        default=0.0,
    )


def _all_cells(box: Box, P: Mapping[str, FloatArray], gamma: float) -> Mapping[str, tuple[float, ...]] | None:
    cells = {}
    for name in box.dynamics.locations:
        ends = _Cells(box, P, name).ends(gamma * (1 - MARGIN))
        if ends is None:
            return None
        cells[name] = ends
    return cells


class _Cells:
    """The cells of one location: where they end, such that the bound of each is below a level."""

    def __init__(self, box: Box, P: Mapping[str, FloatArray], name: str) -> None:
        roots = {place: np.linalg.cholesky(matrix).T for place, matrix in P.items()}
        self.box, self.name, self.N = box, name, box.generator(name)
        self.root, self.back = roots[name], np.linalg.inv(roots[name])
        self.jumps = [roots[reset.target] @ reset.matrix for reset in box.dynamics.exits(name)]
        inside = self.root @ box.dynamics.matrices[name] @ self.back
        if box.dynamics.step is None:
            self.speed = max(0.0, float(np.linalg.eigvalsh((inside + inside.T) / 2).max()))
        else:
            self.speed = log(max(1.0, float(np.linalg.norm(inside, 2)))) / box.dynamics.step

    def bound(self, a: float, b: float) -> float:
        """The largest ‖E‖ in a cell, bounded as the module says; a single step has two stays, which need no bound."""
        step = self.box.dynamics.step
        if step is not None and round((b - a) / step) == 1:
            return max(self.bound(a, a), self.bound(b, b))
        flow, w = self.box.flow(self.name, a), b - a
        slope = self.N @ flow
        rest = w * w / 2 * float(np.linalg.norm(self.root @ self.N @ slope @ self.back, 2))
        rest *= float(np.exp(min(self.speed * w, 700.0)))
        bounds = [
            float(np.linalg.norm(jump @ (flow + w / 2 * slope) @ self.back, 2))
            + w / 2 * float(np.linalg.norm(jump @ slope @ self.back, 2))
            + float(np.linalg.norm(jump @ self.back, 2)) * rest
            for jump in self.jumps
        ]
        return max(bounds, default=0.0)

    def ends(self, level: float) -> tuple[float, ...] | None:
        """The ends of cells whose bounds are below the level; None where too many would be needed."""
        low, high = self.box.stays[self.name]
        found, waiting = [low], [(low, high)]
        for _ in range(MOST_CELLS):
            if not waiting:
                return tuple(found)
            a, b = waiting.pop()
            if self.bound(a, b) <= level:
                found.append(b)
                continue
            middle = self._middle(a, b)
            if not a < middle < b:
                return None
            waiting += [(middle, b), (a, middle)]
        return None

    def _middle(self, a: float, b: float) -> float:
        step = self.box.dynamics.step
        if step is None:
            return (a + b) / 2 if b - a > MARGIN * max(b, 1.0) else a
        first, last = round(a / step), round(b / step)
        return a if last - first < 2 else (first + last) // 2 * step


def _why_not(box: Box) -> str:
    worst = worst_round(box)
    round_trip = " -> ".join((*worst.locations, *worst.locations[:1]))
    stays = ", ".join(f"{stay:.4g}" for stay in worst.stays)
    if worst.growth >= 1:
        return f"the round {round_trip} with stays of {stays} s multiplies an error by {worst.growth:.4g}"
    looked = f"the worst round looked at, {round_trip} with stays of {stays} s, has spectral radius {worst.growth:.4g}"
    return f"no certificate was found; {looked}"


def worst_round(box: Box) -> WorstRound:
    """Return the least contracting of the rounds of up to 4 locations, each stay one of the two ends or the middle."""
    from deshybrid.continuous.cycles import closed_walks

    worst = WorstRound((), (), 0.0)
    times = {name: box.sampled(name, 3) for name in box.dynamics.locations}
    flows = {name: [box.flow(name, float(t)) for t in values] for name, values in times.items()}
    n = len(next(iter(box.dynamics.matrices.values())))
    for walk, _ in zip(closed_walks(box.dynamics), range(300), strict=False):
        for choice in np.ndindex(*(len(times[reset.source]) for reset in walk)):
            whole = np.eye(n)
            for reset, k in zip(walk, choice, strict=True):
                whole = reset.matrix @ flows[reset.source][k] @ whole
            growth = float(np.abs(np.linalg.eigvals(whole)).max())
            if growth > worst.growth:
                places = tuple(reset.source for reset in walk)
                stays = tuple(float(times[place][k]) for place, k in zip(places, choice, strict=True))
                worst = WorstRound(places, stays, growth)
    return worst


def _certificate(
    box: Box,
    proof: tuple[float, Mapping[str, FloatArray], Mapping[str, tuple[float, ...]]] | None,
    delay: float,
    reason: str,
) -> ContractionCertificate:
    gamma, P, cells = proof if proof is not None else (1.0, {}, {})
    longest = max((stay[1] for stay in box.stays.values()), default=1.0)
    rate = -log(gamma) / longest * (1 - MARGIN) if gamma < 1 else 0.0
    low = min((stay[0] for stay in box.stays.values()), default=0.0)
    text = f"the error contracts by {gamma:.4g} with every switch, for all stays from {low:.4g} to {longest:.4g} s"
    return ContractionCertificate(
        theorem="B03-box" if box.dynamics.step is None else "B03-box-sampled",
        holds=proof is not None,
        gamma=gamma,
        rate=rate,
        stays=MappingProxyType(dict(box.stays)),
        delay=delay,
        P=MappingProxyType({name: frozen_array((m + m.T) / 2, m.shape) for name, m in P.items()}),
        cells=MappingProxyType(dict(cells)),
        matrices=box.dynamics.matrices,
        step=box.dynamics.step,
        reason=reason or text,
    )


__all__ = ["Box", "ContractionCertificate", "WorstRound", "certify_box", "mean_square_growth", "worst_round"]
