"""Guards and invariants along a flow: when does a predicate begin or cease to hold?

In: the predicates that matter in one location, its flow, and a stretch of time with held inputs.  Out: the stretch cut
into `Piece`s, each an instant or an open interval in which no comparison changes, so that the truth of every predicate
is constant on it; from them follows the first time at which a predicate holds, or does not.

Each comparison is a function v(t) whose value and slope are known at both ends of the stretch.  A change of sign is a
root; a slope that turns towards zero and back is searched for its extremum first, so that a pair of roots (grazing) is
found too.  What is missed: more than one extremum within one sub-step, which the choice of sub-steps rules out for
oscillations of the model's own (16 sub-steps a period).  Roots are found to rounding.

Some products of a matrix and a vector for each stretch, and some hundreds for each root.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.predicates import Affine, And, Not, Predicate
from deshybrid.simulate.flow import Flow

RESOLUTION = 1e-6  # of a sub-step: instants closer than this are one instant
_ROOT = 1e-14  # of a sub-step: to which a root is found, so that its comparison is zero up to rounding there
_ZERO = 1e-12  # relative: in discrete time, a comparison closer to zero than this is zero

Values = Mapping[Affine, float]


@dataclass(frozen=True, slots=True)
class Piece:
    """From `offset` (s after the start of the stretch) on: the sign of each comparison."""

    offset: float
    values: Values


@dataclass(frozen=True, slots=True, eq=False)
class Watch:
    """The comparisons of one location: `rows` (k, n + m + r + 1) give their values at z, `slopes` their slopes."""

    atoms: tuple[Affine, ...]
    rows: FloatArray
    slopes: FloatArray
    flow: Flow
    tick: float

    def values(self, z: FloatArray) -> Values:
        """Return the values at one point; those that are zero up to rounding are zero."""
        values = self.rows @ z
        values[np.abs(values) <= _ZERO * (np.abs(self.rows) @ np.abs(z))] = 0.0
        return dict(zip(self.atoms, values.tolist(), strict=True))

    def pieces(self, z: FloatArray, duration: float) -> list[Piece]:
        """Return the pieces of the stretch that begins at z and lasts `duration` s (0 = the point alone)."""
        if not self.atoms:
            return []
        if duration <= 0.0 or self.flow.is_sampled:
            return [Piece(0.0, self.values(z))]
        end = z.copy()
        whole = duration >= self.tick
        end[: len(self.flow.rate)] = self.flow.whole @ z if whole else self.flow.after(z, duration)
        first, last = self.rows @ z, self.rows @ end
        if not (np.isfinite(first).all() and np.isfinite(last).all()):
            return []
        roots = self._roots(z, duration, (first, last, self.slopes @ z, self.slopes @ end))
        if not roots:
            return [Piece(0.0, dict(zip(self.atoms, (first + last).tolist(), strict=True)))]
        return list(self._cut(z, duration, roots))

    def _roots(
        self, z: FloatArray, duration: float, ends: tuple[FloatArray, FloatArray, FloatArray, FloatArray]
    ) -> list[tuple[float, int]]:
        """Roots (offset, atom) later than the resolution, in order of time."""
        first, last, rising, ended = ends
        crossing = first * last < 0.0
        turning = rising * ended < 0.0
        found: list[tuple[float, int]] = []
        for atom in np.flatnonzero(crossing | turning).tolist():
            value = self._along(self.rows[atom], z)
            if not turning[atom]:
                found.append((_bisect(value, 0.0, duration, self.tick), atom))
                continue
            if not (crossing[atom] or _may_touch(first[atom], last[atom], rising[atom], ended[atom], duration)):
                continue
            middle = _bisect(self._along(self.slopes[atom], z), 0.0, duration, self.tick)
            height = value(middle)
            if height * first[atom] < 0.0:
                found.append((_bisect(value, 0.0, middle, self.tick), atom))
            if height * last[atom] < 0.0:
                found.append((_bisect(value, middle, duration, self.tick), atom))
        return sorted(root for root in found if root[0] > RESOLUTION * self.tick)

    def _along(self, row: FloatArray, z: FloatArray) -> Callable[[float], float]:
        n = len(self.flow.rate)
        constant = float(row[n:] @ z[n:])
        return lambda offset: float(row[:n] @ self.flow.after(z, offset)) + constant

    def _cut(self, z: FloatArray, duration: float, roots: Sequence[tuple[float, int]]) -> Iterator[Piece]:
        """Intervals at their middles, and each instant between them with its roots exactly zero."""
        groups: list[tuple[float, list[int]]] = []
        for offset, atom in roots:
            if groups and offset - groups[-1][0] <= RESOLUTION * self.tick:
                groups[-1][1].append(atom)
            else:
                groups.append((offset, [atom]))
        times = [0.0, *(offset for offset, _ in groups), duration]
        yield Piece(0.0, self._sample(z, times[1] / 2.0))
        for index, (offset, atoms) in enumerate(groups, start=1):
            at = self._sample(z, offset)
            yield Piece(offset, {**at, **{self.atoms[atom]: 0.0 for atom in atoms}})
            yield Piece(offset, self._sample(z, (offset + times[index + 1]) / 2.0))

    def _sample(self, z: FloatArray, offset: float) -> Values:
        point = z.copy()
        point[: len(self.flow.rate)] = self.flow.after(z, offset)
        return dict(zip(self.atoms, (self.rows @ point).tolist(), strict=True))


def build_watch(predicates: Sequence[Predicate], flow: Flow, tick: float) -> Watch:
    """Return the watch over all comparisons in these predicates."""
    atoms = tuple(dict.fromkeys(atom for predicate in predicates for atom in atoms_of(predicate)))
    n, width = flow.rate.shape
    rows = np.zeros((len(atoms), width))
    for index, atom in enumerate(atoms):
        rows[index, :n] = atom.state
        rows[index, n : n + len(atom.input)] = atom.input
        rows[index, -1] = atom.constant
    return Watch(atoms, rows, rows[:, :n] @ flow.rate, flow, tick)


def atoms_of(predicate: Predicate) -> tuple[Affine, ...]:
    """Return the comparisons a predicate is built from, in the order written.

    >>> atom = Affine(np.array([1.0]), np.array([]), 0.0, "<=")
    >>> atoms_of(And((atom, Not(atom)))) == (atom, atom)
    True
    """
    if isinstance(predicate, Affine):
        return (predicate,)
    if isinstance(predicate, Not):
        return atoms_of(predicate.part)
    return tuple(atom for part in predicate.parts for atom in atoms_of(part))


def holds(predicate: Predicate, values: Values) -> bool:
    """Return whether a predicate holds where its comparisons have these values.

    >>> atom = Affine(np.array([1.0]), np.array([]), 0.0, "<")
    >>> holds(atom, {atom: 0.0}), holds(Not(atom), {atom: 0.0})
    (False, True)
    """
    if isinstance(predicate, Affine):
        value = values[predicate]
        if predicate.relation == "==":
            return value == 0.0
        return value < 0.0 if predicate.relation == "<" else value <= 0.0
    if isinstance(predicate, Not):
        return not holds(predicate.part, values)
    if isinstance(predicate, And):
        return all(holds(part, values) for part in predicate.parts)
    return any(holds(part, values) for part in predicate.parts)


def first_time(pieces: Sequence[Piece], predicate: Predicate, wanted: bool) -> float | None:
    """Return the offset of the first piece on which the predicate is `wanted`, or None."""
    return next((piece.offset for piece in pieces if holds(predicate, piece.values) is wanted), None)


def _may_touch(first: float, last: float, rising: float, ended: float, duration: float) -> bool:
    """Could a curve with one extremum reach zero?  It stays on one side of the meeting point of its end tangents."""
    if first == 0.0:
        return True
    if first * rising >= 0.0:
        return False  # it moves away from zero first, so its extremum is farther away
    meeting = (last - ended * duration - first) / (rising - ended)
    return (first + rising * meeting) * first <= 0.0


def _bisect(value: Callable[[float], float], low: float, high: float, tick: float) -> float:
    """A root between two times of opposite sign (Brent's method); where one of them is zero, that one."""
    from scipy.optimize import brentq

    at_low, at_high = value(low), value(high)
    if at_low == 0.0 or at_high == 0.0 or at_low * at_high > 0.0:
        return low if abs(at_low) <= abs(at_high) else high
    return float(brentq(value, low, high, xtol=_ROOT * tick, rtol=1e-14))
