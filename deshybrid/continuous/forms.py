"""Forms that decrease from entry to entry: the unknowns of a certificate by matrix inequalities.

In: the error dynamics times e^{μ t}, the shape of the forms, a shortest stay T_i for each location, longest stays
where there are any.  Out: forms P at the entry of a node and Q over the spans of its stays
(`deshybrid.continuous.form_graph`) with, in the monomials of degree d,

    e^{Fᵀ t} Q e^{F t} < P  for the stay t with which a span begins,
    Q' + Fᵀ Q + Q F < 0     over the span (Q' = 0 in one without end; linear in time, so that its two ends are enough),
    R¹ᵀ P_j R¹ < Q          for every reset and the node j that it leads to, at both ends of a span,

or the same with Mᵀ Q(k+1) M < Q(k) and M^k in sampled time.  With one endless span and Q = e^{-Fᵀ T} P e^{-F T} these
are the classical conditions on P alone; with Q as an unknown of its own nothing is ever multiplied by e^{-F T}, which
has entries beyond all bounds.  The idea that makes the numbers small: P and Q are sought near the identity of frames
of their own, taken from Lyapunov's equation at first, then from the last forms that were found.

N = n(n+1)/2 unknowns a form, n the number of monomials.  Source: Geromel and Colaneri (2006), "Stability and
stabilization of continuous-time switched linear systems"; forms of degree 2d by Parrilo and Jadbabaie (2008).
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import inf
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.conic import Solution, Term, congruence, drift, identity, solve
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.form_graph import PLAIN, Forms, Shape, Spans, StayForms, nodes_of
from deshybrid.continuous.modes import decay_rate
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.lifting import lifted, lifted_generator, lifting_weights
from deshybrid.linear.observability import sorted_spectrum

MARGIN = 1e-7
"""Forms count as found where every inequality, in frames in which P is near the identity, has this margin."""
LOOKS = 3
"""Frames are renewed at most so often for one set of stays."""
FLATTEST = 1e-12
"""A frame is not flatter than this."""
SLOWEST = 1e-9
"""Rates (1/s, or a part of a step) below this are not scaled up."""
STEADY = 0.1
"""Where a location does not decay, its frame is that of a flow which does, at this share of its size."""


@dataclass(frozen=True, slots=True, eq=False)
class Frames:
    """Coordinates for each location at the entry and at the end of a stay: z = entry[i] ζ, z = end[i] ζ."""

    entry: tuple[FloatArray, ...]
    end: tuple[FloatArray, ...]


class _Span(NamedTuple):
    """A span of stays at a node: numbers of the node, of its location, of the span there, and of its unknowns Q."""

    node: int
    place: int
    number: int
    ends: tuple[int, ...]


class FormProblem:
    """The inequalities of one shape; `solve` remembers frames from call to call, so that near stays come easily.

    most: the longest stays (s) by location, where they are bounded.
    """

    def __init__(
        self,
        dynamics: ErrorDynamics,
        shape: Shape = PLAIN,
        *,
        frames: Frames | None = None,
        most: Mapping[str, float] = MappingProxyType({}),
    ) -> None:
        self.dynamics, self.shape = dynamics, shape
        self.base = frames or lyapunov_frames(dynamics)
        self.nodes = nodes_of(dynamics, shape.memory)
        matrices = dynamics.matrices
        self.spans = {name: Spans(F, dynamics.step, most.get(name, inf), shape.cuts) for name, F in matrices.items()}
        self.weights = lifting_weights(len(next(iter(matrices.values()))), shape.degree)
        self._local = tuple(_conjugated(U, F, U) for F, U in zip(matrices.values(), self.base.end, strict=True))
        self._layout = self._numbered()
        count = len(self.nodes) + sum(len(span.ends) for span in self._layout)
        self.inner = tuple(np.eye(len(self.weights)) for _ in range(count))

    def solve(self, stays: Sequence[float]) -> Forms | None:
        """Return forms for these shortest stays (s; one per location), None where none were found.

        A margin that is positive but too small to trust grows in the frames of the forms that have it: look again.
        """
        for _ in range(LOOKS):
            found = self._proposed(stays)
            if found.margin <= 0:
                return None
            self.inner = tuple(root(X) @ frame for X, frame in zip(found.unknowns, self.inner, strict=True))
            if found.margin >= MARGIN:
                return self._forms(stays)
        return None

    @property
    def size(self) -> int:
        """How many numbers the conic problem has that are not zero, roughly."""
        exits = [len(node.exits) for node in self.nodes.values()]
        jumps = sum(len(span.ends) * exits[span.node] for span in self._layout)
        rows = len(self.nodes) + 3 * len(self._layout) + jumps
        packed = len(self.weights) * (len(self.weights) + 1) // 2
        return int(packed**2) * rows

    def frames(self) -> Frames:
        """Return the frames of the last forms that were found, for another shape; of plain forms only."""
        count = len(self.nodes)
        entry, end = (
            tuple(a @ b for a, b in zip(inner, base, strict=True))
            for inner, base in ((self.inner[:count], self.base.entry), (self.inner[count:], self.base.end))
        )
        return Frames(entry, end)

    def _numbered(self) -> list[_Span]:
        """The spans of all nodes; unknowns of P come first."""
        layout, count = list[_Span](), len(self.nodes)
        for number, node in enumerate(self.nodes.values()):
            spans = self.spans[node.location]
            for k in range(spans.count):
                width = 1 if spans.endless and k == spans.count - 1 else 2
                place = self.dynamics.locations.index(node.location)
                layout.append(_Span(number, place, k, tuple(range(count, count + width))))
                count += width
        return layout

    def _proposed(self, stays: Sequence[float]) -> Solution:
        names, size = list(self.nodes), len(self.weights)
        ends = [self.spans[name].ends(stay) for name, stay in zip(self.dynamics.locations, stays, strict=True)]
        inverse = [np.asarray(np.linalg.inv(frame), dtype=np.float64) for frame in self.inner]
        inequalities: list[list[Term]] = [[Term(i, identity(size))] for i in range(len(names))]
        for span in self._layout:
            start, end = ends[span.place][span.number]
            first = span.ends[0]
            over = self.inner[first] @ self._lifted(self._over(span.place, stays[span.place] + start))
            reached = congruence(over @ inverse[span.node])
            inequalities.append([Term(span.node, identity(size)), Term(first, -reached)])
            inequalities += self._flow(span, end - start, inverse[first])
            for number, target in self.nodes[names[span.node]].exits.items():
                jump = self._jump(number, span.place)
                for Q in span.ends:
                    entered = names.index(target)
                    moved = congruence(self.inner[entered] @ jump @ inverse[Q])
                    inequalities.append([Term(Q, identity(size)), Term(entered, -moved)])
        return solve(size, len(self.inner), inequalities, normalised=len(names))

    def _flow(self, span: _Span, width: float, inverse: FloatArray) -> list[list[Term]]:
        """That the forms decrease over a span, in the frame of its first form."""
        first, step, size = span.ends[0], self.dynamics.step, len(self.weights)
        if step is not None and width < step / 2:
            return []
        one = identity(size)
        if step is None:
            generator = self._weighted(lifted_generator(self._local[span.place].tolist(), self.shape.degree))
            inside = self.inner[first] @ generator @ inverse
            moved, rate = drift(inside), float(np.linalg.norm(inside, 2))
        else:
            inside = self.inner[first] @ self._lifted(self._local[span.place]) @ inverse
            moved, rate = congruence(inside), float(np.linalg.norm(np.eye(size) - inside, 2))
        if len(span.ends) == 1:
            lost = -moved if step is None else one - moved
            return [[Term(first, lost / max(rate, SLOWEST))]]
        other = congruence(self.inner[span.ends[1]] @ inverse)
        part = 1 / width if step is None else 1 / round(width / step)
        unit = max(rate, SLOWEST) + part
        if step is None:
            pairs = [(part * one - moved, -part * one), (part * one, -moved - part * one)]
        else:
            pairs = [(one - (1 - part) * moved, -part * moved), (part * one, (1 - part) * one - moved)]
        return [[Term(first, a / unit), Term(span.ends[1], b @ other / unit)] for a, b in pairs]

    def _jump(self, number: int, source: int) -> FloatArray:
        reset = self.dynamics.resets[number]
        target = self.dynamics.locations.index(reset.target)
        return self._lifted(_conjugated(self.base.entry[target], reset.matrix, self.base.end[source]))

    def _over(self, i: int, stay: float) -> FloatArray:
        from scipy.linalg import expm

        step, change = self.dynamics.step, self.base.end[i] @ np.linalg.inv(self.base.entry[i])
        if step is None:
            return np.asarray(expm(self._local[i] * stay) @ change)
        return np.asarray(np.linalg.matrix_power(self._local[i], round(stay / step)) @ change)

    def _lifted(self, matrix: FloatArray) -> FloatArray:
        return matrix if self.shape.degree == 1 else self._weighted(lifted(matrix.tolist(), self.shape.degree))

    def _weighted(self, rows: Sequence[Sequence[float]]) -> FloatArray:
        return np.asarray(self.weights[:, None] * np.array(rows) / self.weights)

    def _forms(self, stays: Sequence[float]) -> Forms:
        """The forms of the present frames, in the monomials of the states."""
        places = self.dynamics.locations
        P = {
            name: self._form(self.base.entry[places.index(node.location)], frame)
            for (name, node), frame in zip(self.nodes.items(), self.inner, strict=False)
        }
        ends, names, made = [self.spans[name].ends(stay) for name, stay in zip(places, stays, strict=True)], list(P), []
        for span in self._layout:
            start, end = ends[span.place][span.number]
            Q = tuple(self._form(self.base.end[span.place], self.inner[k]) for k in span.ends)
            made.append(StayForms(names[span.node], start, end, Q))
        return Forms(self.shape.degree, self.nodes, MappingProxyType(P), tuple(made))

    def _form(self, base: FloatArray, frame: FloatArray) -> FloatArray:
        whole = frame @ self._lifted(base) * self.weights
        form = whole.T @ whole
        return frozen_array((form + form.T) / 2, form.shape)


def lyapunov_frames(dynamics: ErrorDynamics) -> Frames:
    """Return frames in which each flow alone decreases: roots of the solution of Lyapunov's (Stein's) equation."""
    from scipy.linalg import matrix_balance, solve_continuous_lyapunov, solve_discrete_lyapunov

    frames = []
    for F in dynamics.matrices.values():
        balanced, (sizes, _) = matrix_balance(_decaying(F, dynamics.step), permute=False, separate=True)
        one = np.eye(len(F))
        if dynamics.step is None:
            X = solve_continuous_lyapunov(balanced.T, -one * np.linalg.norm(balanced, 2))
        else:
            X = solve_discrete_lyapunov(balanced.T, one)
        frames.append(root((X + X.T) / 2 / sizes / sizes[:, None]))
    return Frames(tuple(frames), tuple(frames))


def _decaying(F: FloatArray, step: float | None) -> FloatArray:
    """The flow itself where it decays, else one that does."""
    values = sorted_spectrum(F)
    if decay_rate(values, step) < 0:
        return F
    if step is not None:
        return np.asarray(F * (1 - STEADY) / np.abs(values).max())
    return np.asarray(F - (values.real.max() + STEADY * np.abs(values).max() + SLOWEST) * np.eye(len(F)))


def _conjugated(left: FloatArray, matrix: FloatArray, right: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.solve(right.T, (left @ matrix).T).T)


def root(X: FloatArray) -> FloatArray:
    """Return S with Sᵀ S = X, X made positive definite where it is not quite; eigenvectors in units of its diagonal."""
    sizes = np.sqrt(np.maximum(np.diag(X), np.finfo(float).tiny))
    values, vectors = np.linalg.eigh(X / sizes / sizes[:, None])
    values = np.maximum(values, values.max() * FLATTEST)
    return np.asarray((vectors * np.sqrt(values)).T * sizes)


__all__ = ["FormProblem", "Frames", "lyapunov_frames", "root"]
