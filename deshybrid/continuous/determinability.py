"""Determinability without observable locations: Theorem 4 of Balluchi et al. (2003), its quantities and its verdicts.

In: a cycle of S locations in Kalman coordinates with resets, perhaps gains and bounds D_m, D_M of all stays.  Out: for
every start of the cycle condition (16), R_N and the longest stay that (28) admits; for the best start the rest of
(19) and the speed condition (18).  The idea: what a location does not show, the next one may, so the error component
that no output sees all the way round is zero for instant switching, and small for switching that is fast enough.

Two readings of the paper.  The printed one takes (28) and (18) as they stand; the proven one repairs them:

- (28) uses ν_A of (19), which bounds e^{A^N t} - I for t <= 1 only, although (28) is there for longer stays.  Proven:
  R_N [(1 + δ)^S - 1] <= ε with δ = max |e^{λ t} - 1| over stays t and eigenvalues λ of A^N.
- (18) divides by 2^{S-1}; the proof has 2^S - 1 terms, R_X [(a + b)^S - a^S] with a = e^{α_A D_M} and b the bracket of
  (18).  Proven: ε + R_X [(a + b)^S - a^S] < 1.

Where A^N or F is not diagonal in the coordinates (Remark 6), logarithmic norms take the place of spectral abscissas
and ‖A^N‖ that of the largest eigenvalue.  O(S² n³).

Source: Balluchi et al. (2003), Theorem 4, (15) to (19), (26) to (28), Remarks 5 and 6.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from math import exp, inf, isfinite
from types import MappingProxyType

import numpy as np

from deshybrid.continuous.determinability_coordinates import hidden_dimensions, hidden_projection, written
from deshybrid.continuous.error import ErrorReset
from deshybrid.linear.arrays import ComplexArray, FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.linear.observability import KalmanSplit

DIAGONAL = 1e-9
"""Entries beside the diagonal below this share of the largest one are rounding."""
WELL_BASED = 1e7
"""Eigenvectors with a condition number beyond this are not used."""
HALVINGS = 200


@dataclass(frozen=True, slots=True)
class CycleStart:
    """What Theorem 4 says of one start: (16), R_N, and the longest stay (s) by (28) as printed and as proven, ε = 1.

    hidden: how many dimensions have been hidden by every location so far, location by location, and after the round.
    """

    location: str
    hidden: tuple[int, ...]
    R_N: float
    max_sojourn: float
    max_sojourn_proven: float

    @property
    def condition_16(self) -> bool:
        """True where nothing stays hidden all the way round."""
        return self.hidden[-1] == 0


@dataclass(frozen=True, slots=True)
class SpeedCondition:
    """(18) with its two sides as printed, and the proven form: the cycle map is at most `cycle_bound`, to be below 1.

    alpha_F (1/s); nu_P (1/s); R_X; epsilon of (28) for the longest stay, as printed; `holds`: the proven form.
    """

    alpha_F: float
    nu_P: float
    R_X: float
    epsilon: float
    left: float
    right: float
    holds_printed: bool
    cycle_bound: float
    holds: bool


@dataclass(frozen=True, slots=True, eq=False)
class Determinability:
    """Theorem 4 for one cycle; `start` is the best of `starts`: (16) first, then the longest stay.

    cycle: locations in the order they are passed; unobservable_dimension by location; nu_A, alpha_A (1/s) as in (19);
    stays: (D_m, D_M) in s where all locations state them; speed: None without stays or gains.
    """

    cycle: tuple[str, ...]
    start: CycleStart
    starts: tuple[CycleStart, ...]
    unobservable_dimension: Mapping[str, int]
    nu_A: float
    alpha_A: float
    stays: tuple[float, float] | None
    speed: SpeedCondition | None

    def record(self, *, contracts: bool) -> dict[str, object]:
        """Return the JSON form; `contracts` is the verdict of the sharper test over the box of all stays."""
        speed, start = self.speed, self.start
        return {
            "theorem": "B03-4",
            "cycle": list(self.cycle),
            "start": start.location,
            "unobservable_dimension": dict(self.unobservable_dimension),
            "condition_16": start.condition_16,
            "R_N": start.R_N,
            "nu_A": self.nu_A,
            "alpha_A": self.alpha_A,
            "nu_P": None if speed is None else speed.nu_P,
            "alpha_F": None if speed is None else _finite(speed.alpha_F),
            "R_X": None if speed is None else speed.R_X,
            "max_sojourn": _finite(start.max_sojourn),
            "condition_18": speed is not None and speed.holds,
            "contracts": contracts,
            "max_sojourn_proven": _finite(start.max_sojourn_proven),
            "condition_18_printed": None if speed is None else speed.holds_printed,
            "condition_18_sides": None if speed is None else [_finite(speed.left), _finite(speed.right)],
            "cycle_bound": None if speed is None else _finite(speed.cycle_bound),
            "epsilon": None if speed is None else _finite(speed.epsilon),
            "stays": None if self.stays is None else list(self.stays),
            "starts": [
                {
                    "location": entry.location,
                    "condition_16": entry.condition_16,
                    "hidden": list(entry.hidden),
                    "R_N": entry.R_N,
                    "max_sojourn": _finite(entry.max_sojourn),
                    "max_sojourn_proven": _finite(entry.max_sojourn_proven),
                }
                for entry in self.starts
            ],
        }

    def __str__(self) -> str:
        start = self.start
        round_trip = " -> ".join((*self.cycle, self.cycle[0]))
        k = self.cycle.index(start.location)
        order = self.cycle[k:] + self.cycle[:k]
        left = ", ".join(f"{count} in `{name}`" for name, count in zip(order, start.hidden, strict=False))
        holds = "holds" if start.condition_16 else "does not hold"
        hidden = ", ".join(f"{count} in `{name}`" for name, count in self.unobservable_dimension.items())
        lines = [
            f"cycle {round_trip}; dimensions hidden: {hidden}",
            f"(16) {holds} from `{start.location}`; hidden by every location so far: {left}",
            f"(28) as printed: {_up_to(start.max_sojourn)} (R_N = {start.R_N:.5g}, ν_A = {self.nu_A:.6g});"
            f" as proven: {_up_to(start.max_sojourn_proven)}",
        ]
        if self.speed is not None:
            lines.append(_speed_text(self.speed))
        return "\n".join(lines)


def _up_to(duration: float) -> str:
    return f"stays up to {duration:.5g} s" if isfinite(duration) else "stays of any length"


def _speed_text(speed: SpeedCondition) -> str:
    printed = f"(18) as printed {'holds' if speed.holds_printed else 'does not hold'}: {speed.left:.3g}"
    sides = f"{printed} {'<' if speed.holds_printed else 'is not below'} {speed.right:.3g}"
    return f"{sides}; as proven the cycle map is bounded by {speed.cycle_bound:.4g}, which has to be below 1"


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """One location in coordinates in which F and A^N are diagonal where they can be.

    seen (n, k) and hidden (n, n-k) are columns T'^O and T'^N, rows those of T^O and T^N; alpha: a bound of growth, the
    spectral abscissa of a diagonal matrix; rates: the eigenvalues of A^N, None where it is not diagonal.
    """

    seen: ComplexArray
    seen_rows: ComplexArray
    hidden: ComplexArray
    hidden_rows: ComplexArray
    size_A: float
    alpha_A: float
    rates: ComplexArray | None
    alpha_F: float
    size_P: float

    def drift(self, duration: float) -> float:
        """δ: a bound of ‖e^{A^N t} - I‖ over stays up to `duration`."""
        if self.rates is None:
            return exp(min(self.size_A * duration, 700.0)) - 1
        grown = np.exp(np.clip(self.rates.real, 0.0, None) * duration)
        turning = np.minimum(np.abs(self.rates) * duration * grown, 1 + grown)
        straight = np.abs(np.expm1(self.rates.real * duration))
        return float(np.where(self.rates.imag == 0, straight, turning).max(initial=0.0))


def determinability(
    cycle: Sequence[str],
    dynamics: Mapping[str, LinearDynamics],
    coordinates: Mapping[str, KalmanSplit],
    resets: Sequence[ErrorReset],
    *,
    gains: Mapping[str, FloatArray] | None = None,
    stays: tuple[float, float] | None = None,
) -> Determinability:
    """Return what Theorem 4 says of a cycle; resets[k] leads from cycle[k] to the next location.

    stays: (D_m, D_M) in s.  Without gains or stays the speed condition is left out.

    >>> from deshybrid.continuous.determinability_coordinates import kalman_coordinates
    >>> from tests.switched import linear
    >>> pair = {"p": linear(0.1 * np.eye(2), [[1, 0]]), "q": linear(0.1 * np.eye(2), [[0, 1]])}
    >>> splits = {name: kalman_coordinates(d.A, d.C) for name, d in pair.items()}
    >>> jumps = [ErrorReset(a, b, np.eye(2), np.zeros(2)) for a, b in (("p", "q"), ("q", "p"))]
    >>> found = determinability(("p", "q"), pair, splits, jumps)
    >>> found.start.condition_16, found.unobservable_dimension["p"]  # each shows what the other hides
    (True, 1)
    """
    parts = [_part(dynamics[name], coordinates[name], (gains or {}).get(name)) for name in cycle]
    exact = [hidden_projection(dynamics[name].A, dynamics[name].C) for name in cycle]
    moved = [written(reset.matrix) for reset in resets]
    nu = max((p.size_A * max(1.0, exp(min(p.alpha_A, 700.0))) for p in parts if p.size_A), default=0.0)
    starts = []
    for k, name in enumerate(cycle):
        order, jumps = parts[k:] + parts[:k], [reset.matrix for reset in (*resets[k:], *resets[:k])]
        R_N = _unseen_norm(order, jumps)
        left = hidden_dimensions(exact[k:] + exact[:k], moved[k:] + moved[:k])
        starts.append(CycleStart(name, left, R_N, _printed_limit(R_N, nu, len(cycle)), _proven_limit(R_N, parts)))
    best = max(starts, key=lambda start: (start.condition_16, start.max_sojourn))
    k = starts.index(best)
    ordered, jumps = parts[k:] + parts[:k], [reset.matrix for reset in (*resets[k:], *resets[:k])]
    alpha_A = max((abs(part.alpha_A) for part in parts if part.hidden.shape[1]), default=0.0)
    return Determinability(
        cycle=tuple(cycle),
        start=best,
        starts=tuple(starts),
        unobservable_dimension=MappingProxyType(
            {name: int(p.hidden.shape[1]) for name, p in zip(cycle, parts, strict=True)}
        ),
        nu_A=nu,
        alpha_A=alpha_A,
        stays=stays,
        speed=None if gains is None or stays is None else _speed(best, ordered, jumps, (nu, alpha_A), stays),
    )


def _part(dynamics: LinearDynamics, split: KalmanSplit, gain: FloatArray | None) -> _Part:
    k, A = split.observable_dimension, dynamics.A
    hidden, hidden_rows, rates = _diagonal(split.transform[:, k:], split.inverse[k:], split.A_u)
    inside = hidden_rows @ A @ hidden
    F = A if gain is None else A - gain @ dynamics.C
    loop = split.inverse[:k] @ F @ split.transform[:, :k]
    seen, seen_rows, poles = _diagonal(split.transform[:, :k], split.inverse[:k], loop)
    closed = seen_rows @ F @ seen
    return _Part(
        seen=seen,
        seen_rows=seen_rows,
        hidden=hidden,
        hidden_rows=hidden_rows,
        size_A=_norm(inside),
        alpha_A=_growth(inside, rates),
        rates=rates,
        alpha_F=_growth(closed, poles),
        size_P=_norm(hidden_rows @ F @ seen),
    )


def _diagonal(
    columns: FloatArray, rows: FloatArray, inside: FloatArray
) -> tuple[ComplexArray, ComplexArray, ComplexArray | None]:
    """Columns and rows in which the matrix is diagonal, and its eigenvalues; unchanged, with None, where it cannot be.

    Coordinates in which it is diagonal already are kept, so that a stated T counts as it stands.
    """
    beside = np.abs(inside - np.diag(np.diag(inside)))
    if (beside <= DIAGONAL * np.abs(inside).max(initial=0.0)).all():
        return columns.astype(complex), rows.astype(complex), np.diag(inside).astype(complex)
    values, vectors = np.linalg.eig(inside)
    if np.linalg.cond(vectors) > WELL_BASED:
        return columns.astype(complex), rows.astype(complex), None
    lengths = np.linalg.norm(columns @ vectors, axis=0)
    vectors = vectors / lengths
    return columns @ vectors, np.linalg.solve(vectors, rows.astype(complex)), values.astype(complex)


def _growth(matrix: ComplexArray, rates: ComplexArray | None) -> float:
    """α with ‖e^{M t}‖ <= e^{α t}: the spectral abscissa where M is diagonal, else the logarithmic norm."""
    if not matrix.size:
        return -inf
    if rates is not None:
        return float(rates.real.max())
    return float(np.linalg.eigvalsh((matrix + matrix.conj().T) / 2).max())


def _norm(matrix: ComplexArray) -> float:
    return float(np.linalg.norm(matrix, 2)) if matrix.size else 0.0


def _unseen_norm(parts: Sequence[_Part], resets: Sequence[FloatArray]) -> float:
    """R_N of (19)."""
    value = _norm(resets[-1] @ parts[-1].hidden) * _norm(parts[0].hidden_rows)
    for part, after, reset in zip(parts[:-1], parts[1:], resets[:-1], strict=True):
        value *= _norm(after.hidden_rows @ reset @ part.hidden)
    return value


def _widest_norm(parts: Sequence[_Part], resets: Sequence[FloatArray]) -> float:
    """R_X of (19)."""
    first, last = parts[0], parts[-1]
    value = max(_norm(resets[-1] @ last.seen), _norm(resets[-1] @ last.hidden))
    value *= max(_norm(first.seen_rows), _norm(first.hidden_rows))
    for part, after, reset in zip(parts[:-1], parts[1:], resets[:-1], strict=True):
        pairs = (
            (rows, columns) for rows in (after.seen_rows, after.hidden_rows) for columns in (part.seen, part.hidden)
        )
        value *= max(_norm(rows @ reset @ columns) for rows, columns in pairs)
    return value


def _printed_limit(R_N: float, nu: float, count: int) -> float:
    """The longest stay by (17) or, from one second on, by (28), with ε = 1."""
    if R_N == 0.0 or nu == 0.0:
        return inf
    limit = ((1 + 1 / R_N) ** (1 / count) - 1) / nu
    return limit if limit >= 1 else 1 / (R_N * ((nu + 1) ** count - 1))


def _proven_limit(R_N: float, parts: Sequence[_Part]) -> float:
    """The longest stay with R_N [(1 + δ)^S - 1] <= 1, by bisection from below; infinite where R_N is zero."""

    def fits(duration: float) -> bool:
        drift = max(part.drift(duration) for part in parts)
        return drift < 1e100 and R_N * ((1 + drift) ** len(parts) - 1) <= 1

    if R_N == 0.0:
        return inf
    high = 1.0
    while fits(high):
        high *= 2
        if high > 1e9:
            return inf
    low = 0.0
    for _ in range(HALVINGS):
        middle = (low + high) / 2
        low, high = (middle, high) if fits(middle) else (low, middle)
    return low


def _speed(
    start: CycleStart,
    parts: Sequence[_Part],
    resets: Sequence[FloatArray],
    hidden: tuple[float, float],
    stays: tuple[float, float],
) -> SpeedCondition:
    """(18) as printed and as proven, for gains that are part of the `parts`; hidden: ν_A and α_A."""
    (nu, alpha_A), (shortest, longest), S = hidden, stays, len(parts)
    alpha_F = max(part.alpha_F for part in parts)
    nu_P, R_X = max(part.size_P for part in parts), _widest_norm(parts, resets)
    epsilon = start.R_N * ((nu * longest + 1) ** S - 1)
    growth = max(0.0, alpha_A, *(part.alpha_A for part in parts))
    a, b = _power(growth * longest), inf
    if alpha_F < growth:
        gap = growth - alpha_F
        b = _power(alpha_F * shortest) + nu_P * (a - _power(alpha_F * longest)) / gap
    left = a ** (S - 1) * b
    right = (1 - epsilon) / (2 ** (S - 1) * R_X) if R_X else inf
    printed = start.condition_16 and epsilon < 1 and left < right
    drift = max(part.drift(longest) for part in parts)
    bound = start.R_N * ((1 + drift) ** S - 1) + R_X * ((a + b) ** S - a**S)
    return SpeedCondition(
        alpha_F, nu_P, R_X, epsilon, left, right, printed, bound, start.condition_16 and alpha_F < 0 and bound < 1
    )


def _power(exponent: float) -> float:
    return exp(exponent) if exponent < 200 else inf


def _finite(value: float) -> float | None:
    return value if isfinite(value) else None


__all__ = ["CycleStart", "Determinability", "SpeedCondition", "determinability"]
