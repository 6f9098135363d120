"""Random executions of a plant and an observer that learns of every switch late, many at once.

Inputs steer each plant within the bounds of its state and the invariants and, once a stay has lasted long enough,
towards the guard of a transition that was drawn; else they, and disturbances and noise always, are bang-bang and turn
round at random times.
A plant that leaves them all the same starts anew; what it did until then counts.
"""

from dataclasses import dataclass

import numpy as np

from deshybrid.continuous.gains import ObserverGains
from deshybrid.linear.sampling import flow_and_integral
from deshybrid.model.predicates import Affine, And, Predicate
from deshybrid.model.system import HybridSystem
from tests.property.test_continuous_bounds import dynamics

CHOICES = np.linspace(-1.0, 1.0, 9)
"""Shares of the bound of the input, of which one is held over each cell."""
SETTLED = 3
"""With this transition the observer starts, without an error: the plant may have begun anywhere."""


@dataclass(frozen=True)
class Grid:
    """Width of a cell (s), cells of the shortest stay and of the longest delay."""

    width: float
    stay: int
    delay: int


def conditions(guard: Predicate | None) -> list[Affine]:
    parts = guard.parts if isinstance(guard, And) else [] if guard is None else [guard]
    plain = [part for part in parts if isinstance(part, Affine)]
    assert len(plain) == len(parts)
    return plain


class Fleet:
    """All runs at one time: where plant and observer are, (x, x̂), and what each run is about to do."""

    def __init__(self, system: HybridSystem, gains: ObserverGains, grid: Grid, count: int, seed: int = 1) -> None:
        self.system, self.grid, self.rng = system, grid, np.random.default_rng(seed)
        self.names, self.n, bounds = gains.locations, len(system.state_names), system.bounds
        assert bounds.state is not None
        assert bounds.input is not None
        self.box, sizes = bounds.state, [bounds.input, bounds.disturbance, bounds.measurement]
        self.scale = np.concatenate([*(size for size in sizes if size is not None), [1.0]])
        self.flows = [[self._flow(gains, i, j) for j in self.names] for i in self.names]
        self.flow = np.array([[flow for flow, _ in row] for row in self.flows])
        self.push = np.array([[push for _, push in row] for row in self.flows]) * self.scale
        self.arcs = system.transitions
        self.leaving = [[k for k, t in enumerate(self.arcs) if t.source == name] for name in self.names]
        signals = len(self.scale) - 1
        self.signs = self.rng.choice([-1.0, 1.0], size=(count, signals))
        self.turning = 10 ** self.rng.uniform(-2.5, -0.3, size=count)
        self.both, self.plant, self.observer = np.zeros((count, 2 * self.n)), np.zeros(count, int), np.zeros(count, int)
        self.arc, self.waited, self.wanted = np.zeros(count, int), np.zeros(count, int), np.zeros(count, int)
        self.late, self.passed, self.last = (np.zeros(count, int) for _ in range(3))
        for run in range(count):
            self._begin(run)

    def _flow(self, gains: ObserverGains, i: str, j: str) -> tuple[np.ndarray, np.ndarray]:
        here, seen, G = dynamics(self.system, i), dynamics(self.system, j), gains.gains[j]
        joint = np.block([[here.A, np.zeros((self.n, self.n))], [G @ here.C, seen.A - G @ seen.C]])
        plant = np.hstack([here.B, here.E, G * 0, here.f[:, None]])
        observer = np.hstack([seen.B, here.E * 0, G, seen.f[:, None]])
        columns = np.vstack([plant, observer])
        return (joint, columns) if self.system.time_step else flow_and_integral(joint, columns, self.grid.width)

    def _begin(self, run: int) -> None:
        self.both[run], self.passed[run], self.late[run] = 0.0, 0, -1
        self.plant[run] = self.observer[run] = len(self.names) - 1
        self._enter(run)

    def _enter(self, run: int) -> None:
        """Draw the next transition and how long the stay before it is; every second one is as short as it may be."""
        self.waited[run], self.arc[run] = 0, self.rng.choice(self.leaving[self.plant[run]])
        self.wanted[run] = self.grid.stay + (self.rng.geometric(0.05) if self.rng.random() < 0.5 else 0)

    def step(self) -> np.ndarray:
        """Go on by one cell; return the largest errors (n,) of the runs whose observers have started."""
        self.signs = np.where(self.rng.random(self.signs.shape) < self.turning[:, None], -self.signs, self.signs)
        whole = np.hstack([self.signs, np.ones((len(self.signs), 1))])
        flow, push = self.flow[self.plant, self.observer], self.push[self.plant, self.observer]
        whole[:, 0] = self._steered(flow, push, whole)
        self.both = np.einsum("bij,bj->bi", flow, self.both) + np.einsum("bij,bj->bi", push, whole)
        self.waited, self.late = self.waited + 1, self.late - 1
        x = self.both[:, : self.n]
        left = (np.abs(x) > self.box).any(axis=1) | (self._outside(x) > 0)
        for run in np.flatnonzero(left):
            self._begin(run)
        self._switch()
        counted = self.both[self.passed >= SETTLED]
        return np.abs(counted[:, self.n :] - counted[:, : self.n]).max(axis=0, initial=0.0)

    def _steered(self, flow: np.ndarray, push: np.ndarray, whole: np.ndarray) -> np.ndarray:
        """The share of the input that costs each run least: the bounds count most, then the guard, then the sign."""
        x = np.einsum("bij,bj->bi", flow[:, : self.n], self.both)
        rest = np.einsum("bij,bj->bi", push[:, : self.n, 1:], whole[:, 1:])
        costs = np.empty((len(whole), len(CHOICES)))
        for k, share in enumerate(CHOICES):
            after = x + rest + push[:, : self.n, 0] * share
            outside = np.maximum(np.abs(after) - 0.97 * self.box, 0.0) / np.where(self.box > 0, self.box, 1.0)
            away = np.where(self.waited + 1 >= self.wanted, self._violation(after), 0.0)
            kept = outside.sum(axis=1) + self._outside(after)
            costs[:, k] = 1e6 * kept + 1e3 * away + np.abs(share - whole[:, 0])
        return np.asarray(CHOICES[np.argmin(costs, axis=1)])

    def _outside(self, x: np.ndarray) -> np.ndarray:
        """How far states (runs, n) are from the invariants of the locations that the plants are in."""
        found = np.zeros(len(x))
        for k, name in enumerate(self.names):
            here = self.plant == k
            for part in conditions(self.system.location(name).invariant):
                found[here] += np.maximum(x[here] @ part.state + part.constant, 0.0)
        return found

    def _violation(self, x: np.ndarray) -> np.ndarray:
        """How far states (runs, n) are from the guards of the transitions that were drawn."""
        found = np.zeros(len(x))
        for k, arc in enumerate(self.arcs):
            chosen = self.arc == k
            for part in conditions(arc.guard):
                found[chosen] += np.maximum(x[chosen] @ part.state + part.constant, 0.0)
        return found

    def _switch(self) -> None:
        """Plants whose stay is over and whose guard holds jump; observers whose delay is over follow."""
        ready = (self.waited >= self.wanted) & (self._violation(self.both[:, : self.n]) <= 0)
        for run in np.flatnonzero(ready):
            x, target = self._jumped(self.arc[run], self.both[run, : self.n])
            invariant = conditions(self.system.location(self.names[target]).invariant)
            if (np.abs(x) > self.box).any() or any(part.state @ x + part.constant > 0 for part in invariant):
                continue
            self.both[run, : self.n], self.plant[run], self.last[run] = x, target, self.arc[run]
            self.passed[run] += 1
            longest = self.grid.delay if self.rng.random() < 0.5 else self.rng.integers(0, self.grid.delay + 1)
            self.late[run] = longest if self.passed[run] > SETTLED else 0
            self._enter(run)
        for run in np.flatnonzero(self.late == 0):
            after, self.observer[run] = self._jumped(self.last[run], self.both[run, self.n :])
            self.both[run, self.n :] = after if self.passed[run] > SETTLED else self.both[run, : self.n]

    def _jumped(self, number: int, state: np.ndarray) -> tuple[np.ndarray, int]:
        arc = self.arcs[number]
        after = state if arc.reset is None else arc.reset.matrix @ state + arc.reset.offset
        return np.asarray(after), self.names.index(arc.target)


def largest_errors(system: HybridSystem, gains: ObserverGains, grid: Grid, size: tuple[int, int]) -> np.ndarray:
    """Return the largest errors (n,) of so many executions over so many cells."""
    fleet, largest = Fleet(system, gains, grid, size[0]), np.zeros(len(system.state_names))
    for _ in range(size[1]):
        largest = np.maximum(largest, fleet.step())
    return largest
