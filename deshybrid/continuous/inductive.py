"""Sets of entry errors that no switch leads out of: what proves an ultimate bound to a checker that trusts nothing.

In: the polytopes that reachable sets left (`continuous/reach.py`), how the error flows, the exits.  Out: per location
{|d ζ| <= h} around the entry errors that started from zero, with

    max over stays t >= β of  s(d R e^{F t}) + ∫_0^t ‖d R e^{F s} N‖₁ ds  <  h'(d)

for every exit and direction d of its target, s the support function of the set that is left, h' the levels of the one
that is entered.  The idea: the left side, F(h), grows with the levels h, but less than they do, or there would be no
bound; so h := 1.003 F(h) settles too, where F(h) is below h by a share that is room for a checker's own rounding.
Without detection delay and up to four states only.  O(rounds · directions · times · corners), as for the sets.

Source: this project; inductive (invariant) sets are classical.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from deshybrid.continuous.mismatch import Mismatch
from deshybrid.continuous.reach import Outer, highest, one_switch, outer_set, polar, seen_exits
from deshybrid.continuous.responses import Flow
from deshybrid.linear.arrays import FloatArray, frozen_array

ROOM = 3e-3
"""By so much levels exceed what they lead to, while they are iterated; half of it is asked for in the end."""
FLAT = 1e-5
"""No set is thinner than this share of the errors that a stay reaches."""
ALIKE = 1e4
"""Modes count as nearly alike where their basis has a condition number beyond this."""
MOST_ROUNDS = 200


@dataclass(frozen=True, slots=True, eq=False)
class InductiveSet:
    """{|d ζ| <= level}: directions (m, n), the identity's rows first; levels (m,).

    bases (k, n): numbers of n independent directions; over all of them the least |r D⁻¹| levels is the support of the
    set along r, or near it.
    """

    directions: FloatArray
    levels: FloatArray
    bases: NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class UltimateCertificate:
    """Sets by location that hold all entry errors from zero for stays of at least `stay` (s); proved by induction."""

    stay: float
    sets: Mapping[str, InductiveSet]


def inductive_sets(
    flows: Mapping[str, Flow],
    exits: Mapping[str, tuple[Mismatch, ...]],
    sets: Mapping[str, Outer],
    stay: float,
) -> tuple[UltimateCertificate, FloatArray] | None:
    """Return sets with room, and the bound (n,) of the states that they give; None where none was found.

    None too where a checker would lack room: with more than four states, where sets are intersections of
    parallelotopes, and where modes nearly agree, so that bounds of curvature are large.
    """
    if any(outer.corners is None for outer in sets.values()) or any(f.modes.kappa > ALIKE for f in flows.values()):
        return None
    found = settled(flows, exits, sets, stay)
    if found is None:
        return None
    peaks = np.max([highest(flow, exits[name], found[name], stay) for name, flow in flows.items()], axis=0)
    kept = {name: _kept(outer) for name, outer in found.items()}
    return UltimateCertificate(stay, kept), np.asarray(peaks * (1 + ROOM / 2))


def settled(
    flows: Mapping[str, Flow],
    exits: Mapping[str, tuple[Mismatch, ...]],
    sets: Mapping[str, Outer],
    stay: float,
) -> Mapping[str, Outer] | None:
    """Return sets that no switch leads out of, with room, found from any sets; None where the iteration does not end.

    As zero is in them, they hold all entry errors from zero: no certificate is needed for that.
    """
    peaks = np.max([highest(flow, exits[name], sets[name], stay) for name, flow in flows.items()], axis=0)
    found = {name: _thick(outer, FLAT * peaks) for name, outer in sets.items()}
    seen = seen_exits(flows, exits, found, dict.fromkeys(flows, stay))
    least = {name: np.abs(outer.directions) @ (FLAT * peaks) for name, outer in found.items()}
    for _ in range(MOST_ROUNDS):
        after = one_switch(seen, found, least)
        if all((after[name] * (1 + ROOM / 2) <= found[name].levels).all() for name in found):
            return found
        found = {name: outer.at(after[name] * (1 + ROOM)) for name, outer in found.items()}
    return None


def _thick(outer: Outer, by: FloatArray) -> Outer:
    """The set and a box around each of its points: a switch may make a state exact, and leave a set without inside."""
    shape = outer.shape()
    thick = np.asarray(np.linalg.cholesky(shape @ shape.T + np.diag(by**2)))
    return outer_set(thick, lambda rows: np.asarray(outer.support(rows) + np.abs(rows) @ by))


def _kept(outer: Outer) -> InductiveSet:
    m, n = outer.directions.shape
    if n == 1:
        bases = np.array([[int(np.argmin(outer.levels / np.abs(outer.directions[:, 0])))]])
    else:
        # A facet of the polar polytope names the directions that meet in a corner; opposite corners name the same.
        bases = np.unique(np.sort(polar(outer.directions, outer.levels)[0].simplices % m, axis=1), axis=0)
    return InductiveSet(
        frozen_array(outer.directions, (m, n)), frozen_array(outer.levels, (m,)), np.asarray(bases, dtype=np.intp)
    )


__all__ = ["InductiveSet", "UltimateCertificate", "inductive_sets", "settled"]
