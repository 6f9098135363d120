"""What the forms of a certificate may depend on: the location, the transitions before it, and how long the stay lasts.

In: error dynamics, a shape.  Out: the nodes that carry a form P at the entry, and the spans of stays that carry forms Q
at the end of a stay.  The idea: an execution walks through the nodes, one for each location and each history of
`memory` transitions; a stay that ends within a span is measured by the forms of that span, linear in time between the
two ends of a finite one.  With memory 0 and one endless span this is one P and one Q for each location.

Spans of a location that may be stayed in without end begin at fixed parts of its own time scale, and the last has no
end; those of one with a longest stay are equal parts of what lies between its shortest and longest stay.
Source: path-dependent forms as in Lee and Dullerud (2006), "Uniform stabilization of discrete-time switched and
Markovian jump linear systems"; forms linear in time, Allerhand and Shaked (2011), "Robust stability and stabilization
of linear switched systems with dwell time".
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from math import ceil, inf
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.modes import ROUND_UP, decay_rate
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.observability import sorted_spectrum

CUTS: Mapping[int, tuple[float, ...]] = MappingProxyType({0: (), 1: (0.8,), 2: (0.4, 1.2), 4: (0.25, 0.6, 1.2, 2.2)})
"""Where spans begin after the shortest stay, in radians of the fastest oscillation or in time constants."""
FINE = 0.5
"""A span of a location that has to be left in time is no longer than so many radians or time constants,"""
MOST_SPANS = 12
"""but there are not more than this many of them, times the cuts."""


class Shape(NamedTuple):
    """2 · degree: of the forms; cuts: spans of stays are told apart by so many cuts; memory: transitions remembered."""

    degree: int = 1
    cuts: int = 0
    memory: int = 0


PLAIN = Shape()


@dataclass(frozen=True, slots=True, eq=False)
class Node:
    """A location with a history; exits: the node that is entered by each reset, by their places in the dynamics."""

    location: str
    exits: Mapping[int, str]


@dataclass(frozen=True, slots=True, eq=False)
class StayForms:
    """The forms at the end of stays at a node that last `start` to `end` seconds longer than the shortest one.

    Q: one form where `end` is infinite, it decreases by itself; else those of both ends, linear in time between them.
    """

    node: str
    start: float
    end: float
    Q: tuple[FloatArray, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Forms:
    """P by node, (N, N), and the forms of stays, in the monomials of degree `degree` (lexicographic, no weights)."""

    degree: int
    nodes: Mapping[str, Node]
    P: Mapping[str, FloatArray]
    stays: tuple[StayForms, ...]

    @property
    def is_plain(self) -> bool:
        """Whether these are quadratic forms, one P and one Q for each location."""
        return self.degree == 1 and set(self.nodes) == set(self.ends)

    @property
    def ends(self) -> Mapping[str, FloatArray]:
        """Q at the end of stays of any length, by location; empty where forms depend on more than the location."""
        endless = {stay.node: stay.Q[0] for stay in self.stays if stay.end == inf and stay.start == 0}
        return endless if len(endless) == len(self.nodes) == len({n.location for n in self.nodes.values()}) else {}


def nodes_of(dynamics: ErrorDynamics, memory: int) -> Mapping[str, Node]:
    """Return one node for each location and each walk of `memory` transitions that leads to it.

    Where no longer walk leads to a location, shorter ones count.

    >>> from deshybrid.continuous.error import ErrorReset
    >>> one = np.eye(1)
    >>> arcs = tuple(ErrorReset(a, b, one, np.zeros(1)) for a, b in ("pq", "qp", "qq"))
    >>> twin = ErrorDynamics(("p", "q"), {"p": -one, "q": -one}, arcs)
    >>> {name: dict(node.exits) for name, node in nodes_of(twin, 1).items()}
    {'p after 1': {0: 'q after 0'}, 'q after 0': {1: 'p after 1', 2: 'q after 2'}, \
'q after 2': {1: 'p after 1', 2: 'q after 2'}}
    """
    made: dict[str, Node] = {}
    for place in dynamics.locations:
        for walk in _histories(dynamics, place, memory):
            exits = {
                number: _name(reset.target, (number, *walk)[:memory])
                for number, reset in enumerate(dynamics.resets)
                if reset.source == place
            }
            made[_name(place, walk)] = Node(place, MappingProxyType(exits))
    return MappingProxyType(made)


def _histories(dynamics: ErrorDynamics, place: str, memory: int) -> Iterator[tuple[int, ...]]:
    """The last transitions before a location, the latest first."""
    entries = [(k, reset) for k, reset in enumerate(dynamics.resets) if reset.target == place]
    if memory == 0 or not entries:
        yield ()
        return
    for number, reset in entries:
        for before in _histories(dynamics, reset.source, memory - 1):
            yield (number, *before)


def _name(place: str, walk: tuple[int, ...]) -> str:
    return f"{place} after {', '.join(map(str, walk))}" if walk else place


class Spans:
    """The spans of stays of one location, always as many, whatever the shortest stay."""

    def __init__(self, F: FloatArray, step: float | None, most: float, cuts: int) -> None:
        values = sorted_spectrum(F)
        rates = values if step is None else np.log(np.where(values == 0, 1e-300, values).astype(complex)) / step
        turning, growing = float(np.abs(rates.imag).max()), float(rates.real.max())
        clock = turning or float(np.abs(rates.real).min()) or 1.0
        self.step, self.most = step, most
        self.endless = most == inf or (cuts == 0 and decay_rate(values, step) < 0)
        self.cuts = tuple(cut / clock for cut in CUTS[cuts])
        parts = ceil(most * max(turning, growing) / FINE) if not self.endless else 0
        self.parts = min(max(1, parts), MOST_SPANS) * (1 + cuts // 2)

    @property
    def count(self) -> int:
        """How many spans there are."""
        return 1 + len(self.cuts) if self.endless else self.parts

    def ends(self, shortest: float) -> list[tuple[float, float]]:
        """Start and end (s) of every span, after a shortest stay (s); in sampled time whole steps."""
        if self.endless:
            starts = [0.0, *self.cuts]
        else:
            over = max(self.most * (1 + ROUND_UP) - shortest, ROUND_UP * self.most)
            starts = [over * k / self.parts for k in range(self.parts + 1)]
        if self.step is not None:
            starts = [ceil(start / self.step - 1e-6) * self.step for start in starts]
        return list(zip(starts, [*starts[1:], inf], strict=True))[: self.count]


__all__ = ["PLAIN", "Forms", "Node", "Shape", "Spans", "StayForms", "nodes_of"]
