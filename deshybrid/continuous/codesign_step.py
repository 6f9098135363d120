"""One step of the co-design: gains, forms and a dwell time, all changed at once to first order.

In: plants (A_i, C_i) with resets, gains, frames in which the forms that were found are the identity, the dwell time
they prove.  Out: gains near these, within their caps, for which a shorter dwell time is expected.
The idea: the inequalities of `continuous/forms.py` are linear in P_i and Q_i; with F_i = A_i - G_i C_i and e^{F_i T}
replaced by their tangents at the present gains and T they are linear in P_i, Q_i, G_i and T together, and T is made
least.  A trust region keeps the tangents honest: each G_i moves by a share of its cap at most.

One conic problem of 2 m N + m n p + 1 unknowns (m locations, N = n (n+1)/2, p outputs); the tangents take m n p
exponentials of (2n, 2n).  Source: Van Loan (1978), "Computing integrals involving the matrix exponential", for the
tangent; sequential convex programs in gains as in Tran Dinh, Gumussoy, Michiels and Diehl (2012), "Combining
convex-concave decompositions and linearization approaches for solving BMIs".
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import floor
from typing import NamedTuple, TypeAlias

import numpy as np

from deshybrid.continuous.conic import congruence, drift, identity, settings, unpacking
from deshybrid.continuous.dwell import stay_steps
from deshybrid.continuous.error import ErrorDynamics, ErrorReset
from deshybrid.continuous.forms import MARGIN, Frames
from deshybrid.linear.arrays import FloatArray, frozen_array

Gains: TypeAlias = Mapping[str, FloatArray]
SLOWEST = 1e-9
"""Rates (1/s, or a part of a step) below this are not scaled up."""
BOLDEST = 0.3
"""One step shortens the dwell time by this share at most."""


@dataclass(frozen=True, slots=True, eq=False)
class GainPlant:
    """The plants times e^{μ t}: A (n, n) and C (p_i, n) by location, the resets, and the step (s) of sampled time.

    least: the shortest stays (s) that locations have on their own.
    """

    A: Mapping[str, FloatArray]
    C: Mapping[str, FloatArray]
    resets: tuple[ErrorReset, ...]
    step: float | None
    least: Mapping[str, float]

    @property
    def locations(self) -> tuple[str, ...]:
        """The locations, in their order."""
        return tuple(self.A)

    @property
    def shortest(self) -> float:
        """The shortest dwell time (s) there is: zero, or one step."""
        return 0.0 if self.step is None else self.step

    def whole(self, stay: float) -> float:
        """Return the least stay (s) that time allows and that is not shorter."""
        return stay if self.step is None else max(1, stay_steps(stay, self.step)) * self.step

    def stays(self, dwell: float) -> list[float]:
        """Return the shortest stay of each location where every stay lasts at least `dwell` seconds."""
        return [self.whole(max(dwell, self.least.get(name, 0.0))) for name in self.locations]

    def shorter(self, dwell: float, change: float) -> float:
        """Return the dwell time after a change (s, negative): one step shorter at least in sampled time."""
        if self.step is None:
            return dwell + change
        return max(1, min(round(dwell / self.step) - 1, floor((dwell + change) / self.step))) * self.step

    def loops(self, gains: Gains) -> ErrorDynamics:
        """Return the error dynamics with these gains."""
        loops = {name: frozen_array(A - gains[name] @ self.C[name], A.shape) for name, A in self.A.items()}
        return ErrorDynamics(self.locations, loops, self.resets, self.step)


class Point(NamedTuple):
    """Gains in units, a dwell time (s) that forms prove for them, and the frames in which these are the identity."""

    gains: Gains
    dwell: float
    frames: Frames


class Proposal(NamedTuple):
    """Gains, and by how much (s, negative) they are expected to change the dwell time; None where there are none."""

    gains: Gains
    change: float


def proposed(plant: GainPlant, point: Point, caps: Mapping[str, float], radius: float) -> Proposal | None:
    """Return the gains of the step described above; None where the solver gave up.

    caps: the largest ‖G_i‖₂ of the locations whose gains may move, by `radius` · cap at most in the Frobenius norm.
    """
    import clarabel
    from scipy.sparse import csc_matrix

    rows = _Rows(plant, point, caps)
    for i, stay in enumerate(plant.stays(point.dwell)):
        rows.add_location(i, stay, shortens=stay <= point.dwell)
    for reset in plant.resets:
        rows.add_jump(reset)
    for name, cap in caps.items():
        rows.add_cap(name, cap, radius * cap)
    rows.add_dwell(point.dwell)
    cost = np.zeros(rows.columns)
    cost[-1] = 1.0
    zero = csc_matrix((rows.columns, rows.columns))
    matrix, right = csc_matrix(np.vstack(rows.blocks)), np.concatenate(rows.rights)
    found = clarabel.DefaultSolver(zero, cost, matrix, right, rows.cones, settings(rows.packed)).solve()
    values = np.asarray(found.x)
    if str(found.status) not in ("Solved", "AlmostSolved") or not np.isfinite(values).all():
        return None
    moved = {name: gain + rows.part(values, name) if name in caps else gain for name, gain in point.gains.items()}
    return Proposal(moved, float(values[-1]))


class _Rows:
    """The rows of A x + s = b, s in the cones: x holds P and Q by location, the changes of G, and that of T."""

    def __init__(self, plant: GainPlant, point: Point, caps: Mapping[str, float]) -> None:
        import clarabel

        self.plant, self.gains, self.frames = plant, point.gains, point.frames
        self.n, self.m = len(point.frames.entry[0]), len(plant.locations)
        self.packed = self.n * (self.n + 1) // 2
        self.pack = unpacking(self.n).T
        self.columns, self.place = 2 * self.m * self.packed, dict[str, int]()
        for name in caps:
            self.place[name] = self.columns
            self.columns += point.gains[name].size
        self.columns += 1
        trace = np.zeros((1, self.columns))
        trace[0, : self.m * self.packed] = np.tile(self.pack @ np.eye(self.n).ravel(), self.m)
        self.blocks = [trace]
        self.rights = [np.array([float(self.m * self.n)])]
        self.cones: list[object] = [clarabel.ZeroConeT(1)]

    def part(self, values: FloatArray, name: str) -> FloatArray:
        start, shape = self.place[name], self.gains[name].shape
        return np.asarray(values[start : start + self.gains[name].size].reshape(shape))

    def add_location(self, i: int, stay: float, *, shortens: bool) -> None:
        """P_i > 0, the flow of Q_i, and Q_i at the end of a stay below P_i."""
        name = self.plant.locations[i]
        U, V_inverse = self.frames.end[i], np.linalg.inv(self.frames.entry[i])
        U_inverse = np.linalg.inv(U)
        F = self.plant.A[name] - self.gains[name] @ self.plant.C[name]
        turns = self._turns(name)
        inside, one = U @ F @ U_inverse, identity(self.n)
        moved = [U @ D @ U_inverse for D in turns]
        if self.plant.step is None:
            size, flow = max(float(np.linalg.norm(inside, 2)), SLOWEST), -drift(inside)
            tangent = [-(D + D.T) for D in moved]
        else:
            size, flow = max(float(np.linalg.norm(np.eye(self.n) - inside, 2)), SLOWEST), one - congruence(inside)
            tangent = [_twice(-inside.T @ D) for D in moved]
        end, turned, later = self._ends(F, turns, stay)
        end, later = U @ end @ V_inverse, U @ later @ V_inverse
        self._add([(i, one)])
        self._add([(self.m + i, flow / size)], name, [D / size for D in tangent])
        self._add(
            [(i, one), (self.m + i, -congruence(end))],
            name,
            [_twice(-end.T @ U @ D @ V_inverse) for D in turned],
            _twice(-end.T @ later) if shortens else None,
        )

    def add_jump(self, reset: ErrorReset) -> None:
        i, j = self.plant.locations.index(reset.source), self.plant.locations.index(reset.target)
        jump = self.frames.entry[j] @ reset.matrix @ np.linalg.inv(self.frames.end[i])
        self._add([(self.m + i, identity(self.n)), (j, -congruence(jump))])

    def add_cap(self, name: str, cap: float, radius: float) -> None:
        """‖G‖₂ <= cap as [[cap I, G], [Gᵀ, cap I]] >= 0, and ‖change‖_F <= radius."""
        import clarabel

        gain = self.gains[name]
        n, size = len(gain), sum(gain.shape)
        pack, start = unpacking(size).T, self.place[name]
        whole = np.eye(size) * cap
        whole[:n, n:], whole[n:, :n] = gain, gain.T
        block = np.zeros((len(pack), self.columns))
        for k, (a, b) in enumerate(np.ndindex(gain.shape)):
            unit = np.zeros((size, size))
            unit[a, n + b] = unit[n + b, a] = 1.0
            block[:, start + k] = -pack @ unit.ravel()
        ball = np.zeros((gain.size + 1, self.columns))
        ball[1:, start : start + gain.size] = -np.eye(gain.size)
        self._append(block, pack @ whole.ravel(), clarabel.PSDTriangleConeT(size))
        self._append(ball, np.append(radius, np.zeros(gain.size)), clarabel.SecondOrderConeT(gain.size + 1))

    def add_dwell(self, dwell: float) -> None:
        """-BOLDEST · T <= change <= 0."""
        import clarabel

        block = np.zeros((2, self.columns))
        block[:, -1] = -1.0, 1.0
        self._append(block, np.array([BOLDEST * dwell, 0.0]), clarabel.NonnegativeConeT(2))

    def _turns(self, name: str) -> list[FloatArray]:
        """The directions -e_a C_b in which an entry of the gain moves F; none where the gain stays."""
        if name not in self.place:
            return []
        made = []
        for a, b in np.ndindex(self.gains[name].shape):
            D = np.zeros((self.n, self.n))
            D[a] = -self.plant.C[name][b]
            made.append(D)
        return made

    def _ends(
        self, F: FloatArray, turns: list[FloatArray], stay: float
    ) -> tuple[FloatArray, list[FloatArray], FloatArray]:
        """e^{F T} or M^k, its derivatives in the directions, and its derivative in the stay (1/s)."""
        from scipy.linalg import expm

        n, step, turned = self.n, self.plant.step, []
        for D in turns:
            block = np.block([[F, D], [np.zeros((n, n)), F]])
            over = expm(block * stay) if step is None else np.linalg.matrix_power(block, round(stay / step))
            turned.append(np.asarray(over[:n, n:]))
        if step is None:
            end = expm(F * stay)
            return end, turned, F @ end
        count = round(stay / step)
        end = np.linalg.matrix_power(F, count)
        before = np.linalg.matrix_power(F, max(count - 1, 0))
        return end, turned, (end - before) / step

    def _add(
        self,
        terms: Sequence[tuple[int, FloatArray]],
        name: str = "",
        tangent: Sequence[FloatArray] = (),
        later: FloatArray | None = None,
    ) -> None:
        """Σ L_k(X_k) + tangents >= MARGIN/2, half of what forms that were found have."""
        import clarabel

        block = np.zeros((self.packed, self.columns))
        for k, linear in terms:
            block[:, k * self.packed : (k + 1) * self.packed] -= linear
        for k, change in enumerate(tangent):
            block[:, self.place[name] + k] = -self.pack @ change.ravel()
        if later is not None:
            block[:, -1] = -self.pack @ later.ravel()
        least = -MARGIN / 2 * (self.pack @ np.eye(self.n).ravel())
        self._append(block, least, clarabel.PSDTriangleConeT(self.n))

    def _append(self, block: FloatArray, right: FloatArray, cone: object) -> None:
        self.blocks.append(block)
        self.rights.append(right)
        self.cones.append(cone)


def _twice(matrix: FloatArray) -> FloatArray:
    return np.asarray(matrix + matrix.T)


__all__ = ["GainPlant", "Gains", "Point", "Proposal", "proposed"]
