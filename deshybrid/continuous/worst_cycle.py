"""Switching cycles that a certificate finds hardest: a search guided by its forms.

In: the error dynamics times e^{μ t}, quadratic forms P_i, a shortest stay T for each location.  Out: cycles, worst
first, with stays that make them grow.  The idea: from many errors, always take the transition and the stay after which
the form has grown most; such greedy runs end in the cycles that keep the certificate from being better.  The stays of
the best cycles are then improved along the gradient of the logarithm of the spectral radius.

`STARTS` runs of `STEPS` steps over `GRID` stays a transition, O(n^2) each.  Every cycle is a true one whatever P was.
Source: this project; dual to the bound by forms as in Legat, Parrilo and Jungers (2020), "Certifying unstability of
switched systems using sum of squares programming".
"""

from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.cycles import whole_most
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.forms import root
from deshybrid.linear.arrays import FloatArray

STARTS, STEPS, GRID = 40, 36, 40
LONGEST = 12
"""Cycles of up to so many transitions are looked at."""
KEPT = 8
"""So many of the worst cycles are improved."""
SEED = 1
AHEAD = 5.0
"""Stays are looked at up to so many of the slowest time constants beyond the shortest one."""
IMPROVEMENTS = 60


class Cycle(NamedTuple):
    """Resets by their number in the dynamics, and the stay (s) before each; `growth`: log of the spectral radius."""

    resets: tuple[int, ...]
    stays: tuple[float, ...]
    growth: float


class CycleSearch:
    """Growth of cycles, for given error dynamics (times e^{μ t}); most: longest stays (s), where there are any."""

    def __init__(self, dynamics: ErrorDynamics, most: Mapping[str, float]) -> None:
        self.dynamics, self.most = dynamics, whole_most(most, dynamics.step)

    def whole(self, duration: FloatArray) -> FloatArray:
        """The stays as time allows them: whole steps, at least one."""
        step = self.dynamics.step
        return duration if step is None else np.maximum(1, np.ceil(duration / step - 1e-6)) * step

    def flows(self, name: str, stays: FloatArray) -> FloatArray:
        """e^{F t} for several stays, (k, n, n)."""
        from scipy.linalg import expm

        F, step = self.dynamics.matrices[name], self.dynamics.step
        if step is None:
            return np.asarray(expm(F * stays[:, None, None]))
        return np.array([np.linalg.matrix_power(F, round(float(stay) / step)) for stay in stays])

    def growth(self, resets: Sequence[int], stays: Sequence[float]) -> tuple[float, FloatArray]:
        """The logarithm of the spectral radius over one round, and its gradient in the stays (continuous time)."""
        legs = [self.dynamics.resets[k] for k in resets]
        flows = [self.flows(leg.source, np.array([stay]))[0] for leg, stay in zip(legs, stays, strict=True)]
        maps = [leg.matrix @ flow for leg, flow in zip(legs, flows, strict=True)]
        before = [np.eye(len(maps[0]))]
        for matrix in maps:
            before.append(matrix @ before[-1])
        values, right = np.linalg.eig(before[-1])
        k = int(np.abs(values).argmax())
        others, left = np.linalg.eig(before[-1].T)
        row = left[:, int(np.abs(others - values[k]).argmin())]
        gradient = np.zeros(len(maps))
        size, scale = abs(values[k]), row @ right[:, k] * values[k]
        if self.dynamics.step is None and scale != 0:
            for place in range(len(maps) - 1, -1, -1):
                drift = self.dynamics.matrices[legs[place].source] @ (before[place] @ right[:, k])
                gradient[place] = (row @ (maps[place] @ drift) / scale).real
                row = row @ maps[place]
        return float(np.log(max(size, np.finfo(float).tiny))), gradient

    def improved(self, cycle: Cycle, shortest: Mapping[str, float]) -> Cycle:
        """The cycle with stays, none shorter than `shortest` of its location, at which it grows most nearby."""
        from scipy.optimize import minimize

        places = [self.dynamics.resets[k].source for k in cycle.resets]
        least = np.array([shortest[place] for place in places])
        most = np.array([max(shortest[place], self.most.get(place, np.inf)) for place in places])
        start = self.whole(np.clip(cycle.stays, least, most))
        if self.dynamics.step is not None:
            return Cycle(cycle.resets, tuple(start.tolist()), self.growth(cycle.resets, start.tolist())[0])

        def cost(stays: FloatArray) -> tuple[float, FloatArray]:
            value, gradient = self.growth(cycle.resets, stays.tolist())
            return -value, -gradient

        found = minimize(
            cost,
            start,
            jac=True,
            bounds=list(zip(least.tolist(), most.tolist(), strict=True)),
            method="L-BFGS-B",
            options={"maxiter": IMPROVEMENTS},
        )
        stays = np.clip(found.x, least, most)
        return max(
            (Cycle(cycle.resets, tuple(t.tolist()), self.growth(cycle.resets, t.tolist())[0]) for t in (start, stays)),
            key=lambda made: made.growth,
        )

    def candidates(self, P: Mapping[str, FloatArray], shortest: Mapping[str, float]) -> list[Cycle]:
        """Cycles that greedy runs end in, those that grow most for each transition first."""
        found: dict[tuple[tuple[int, float], ...], None] = {}
        for run, last in self._runs(P, shortest):
            for length in range(1, min(LONGEST, len(run)) + 1):
                for end in range(len(run), max(len(run) - 4, length - 1), -1):
                    legs = run[end - length : end]
                    entered = last if end == len(run) else self.dynamics.resets[run[end][0]].source
                    if self.dynamics.resets[legs[0][0]].source == entered:
                        found[min(tuple(legs[k:] + legs[:k]) for k in range(length))] = None
        cycles = []
        for legs_found in found:
            resets, stays = tuple(k for k, _ in legs_found), tuple(stay for _, stay in legs_found)
            cycles.append(Cycle(resets, stays, self.growth(resets, stays)[0]))
        return sorted(cycles, key=lambda cycle: -cycle.growth / len(cycle.resets))[:KEPT]

    def _runs(
        self, P: Mapping[str, FloatArray], shortest: Mapping[str, float]
    ) -> Iterator[tuple[list[tuple[int, float]], str]]:
        """Greedy runs: the (reset, stay) of each step, and the location entered last."""
        rng = np.random.default_rng(SEED)
        roots = {name: root(form) for name, form in P.items()}
        stays = {name: self._stays(name, shortest[name]) for name in P}
        flows = {name: self.flows(name, stays[name]) for name in P}
        choices: dict[str, list[tuple[int, str, FloatArray]]] = {name: [] for name in P}
        for number, reset in enumerate(self.dynamics.resets):
            choices[reset.source].append((number, reset.target, reset.matrix @ flows[reset.source]))
        places = [name for name in P if choices[name]]
        for start in range(STARTS if places else 0):
            name, run = places[start % len(places)], []
            error = rng.standard_normal(len(P[name]))
            for _ in range(STEPS):
                if not choices[name]:
                    break
                ends = [(number, target, moved @ error) for number, target, moved in choices[name]]
                sizes = [np.linalg.norm(moved @ roots[target].T, axis=1) for _, target, moved in ends]
                best = max(range(len(ends)), key=lambda k: sizes[k].max())
                place = int(sizes[best].argmax())
                number, target, moved = ends[best]
                run.append((number, float(stays[name][place])))
                size = float(sizes[best][place])
                if not 0 < size < np.inf:
                    break
                name, error = target, moved[place] / size
            if run:
                yield run, name

    def _stays(self, name: str, shortest: float) -> FloatArray:
        """The shortest stay, and others up to five time constants of the location beyond it."""
        F, step = self.dynamics.matrices[name], self.dynamics.step
        values = np.linalg.eigvals(F)
        slowest = -values.real.max() if step is None else -np.log(max(np.abs(values).max(), 1e-300)) / step
        horizon = AHEAD / slowest if slowest > 0 else 10 * shortest + 1.0
        more = np.append(0.0, np.geomspace(horizon * 1e-3, horizon, GRID - 1))
        return np.unique(np.minimum(self.whole(shortest + more), max(shortest, self.most.get(name, np.inf))))


__all__ = ["Cycle", "CycleSearch"]
