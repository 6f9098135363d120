"""Measured flights: how their tracks are read, what tunes the model of an aircraft, and how well turns are seen.

In: a track (CSV, a row a second with gaps; `t_s`, `x_east_m`, `y_north_m`, and for the score `turn_rate_dps`).
Out: the best numbers on one flight, and on the other the score of the IMM filter beside a single Kalman filter for
straight flight whose noise was tuned for the smallest prediction error.

A position that repeats is a frozen receiver, not an aircraft that stands still: it counts as missing.  The truth is
derived from the recorded turn rate: a turn begins above 0.5 and ends below 0.25 deg/s.  A turn is named from the row in
which its probability passes `sure` to that in which it falls below a half.

A flight is tuned on in pieces, all at once as trials, each with some rows before it that are not counted.
Some 300 runs of 0.3 s a flight.  Source: Hwang et al. (2006), sections 3 and 5.

`python models/measured/aircraft_flights.py ONE.csv OTHER.csv` tunes on each and scores on the other.
"""

import csv
import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize, minimize_scalar

from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import with_parameters
from deshybrid.model.source import read_source
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.multiple import predict_imm, update
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem

MODEL = Path(__file__).with_name("aircraft.yaml")
BEFORE = {"r": 10.0, "w_turn": 1.5, "spin": 0.5, "leave": 0.01, "end": 0.03}
"""What is expected of the numbers that are tuned, before any flight: m, m/s², deg/s, probabilities of a second."""
DOUBLED = 0.01  # what it costs to double or halve one of them
SURE = (0.5, 0.6, 0.7, 0.8, 0.9)
FALSE = 2.0  # turns an hour: so many false ones are let pass where `sure` is tuned
BEGIN, END = 0.5, 0.25  # deg/s
APART = 10  # rows: a named turn that is farther from every true one is false
ROWS, WARM = 150, 40  # of a piece, and before it
SINGLE_R = 30.0  # m; only the ratio of its noises moves the prediction of a single filter

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Flight:
    """One track on the grid of a second: z (N, 2) in m, NaN where missing; `turn` (N,): is 1 to the left, -1, or 0."""

    name: str
    z: Array
    turn: NDArray[np.int64]


def read_flight(path: str | Path) -> Flight:
    """Return a track on a grid of one second; ValueError where a column is missing or there is no row."""
    with Path(path).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    wanted = ("t_s", "x_east_m", "y_north_m", "turn_rate_dps")
    missing = [name for name in wanted if not rows or name not in rows[0]]
    if missing:
        raise ValueError(f"{path} has no column {missing[0]}")
    time, x, y, rate = (np.array([float(row[name]) for row in rows]) for name in wanted)
    at = np.rint(time - time[0]).astype(np.int64)
    moved = np.r_[True, (np.diff(x) != 0.0) | (np.diff(y) != 0.0)]
    z = np.full((at[-1] + 1, 2), np.nan)
    z[at[moved]] = np.column_stack((x, y))[moved]
    turn = np.zeros(at[-1] + 1, dtype=np.int64)
    held = np.searchsorted(at, np.arange(at[-1] + 1), side="right") - 1
    turn[:] = turns(rate)[held]
    return Flight(Path(path).stem, z, turn)


def turns(rate: Array) -> NDArray[np.int64]:
    """Return 1, -1 (left, right) or 0 for each turn rate (deg/s, clockwise positive), with hysteresis.

    >>> turns(np.array([0.0, 0.6, 0.3, 0.2, -0.7])).tolist()
    [0, -1, -1, 0, 1]
    """
    found = np.zeros(len(rate), dtype=np.int64)
    for k, value in enumerate(rate.tolist()):
        side = 0 if k == 0 else int(found[k - 1])
        if side * -value < END:
            side = 0
        if side == 0 and abs(value) >= BEGIN:
            side = -1 if value > 0.0 else 1
        found[k] = side
    return found


def system_with(values: Mapping[str, float]) -> StochasticSystem:
    """Return the model with these parameters."""
    return stochastic_system(elaborate(with_parameters(read_source(MODEL), values)))


def single_filter(w: float) -> StochasticSystem:
    """Return the Kalman filter for straight flight with white accelerations of w m/s² and plain measurement noise."""
    system = system_with({})
    push = np.kron(np.eye(2), np.array([[0.5], [1.0]]))
    mode = Mode("straight", F=system.modes[0].F, H=system.modes[0].H, Q=w**2 * push @ push.T, R=SINGLE_R**2 * np.eye(2))
    return StochasticSystem((mode,), ModeTransition(("straight",), [[1.0]]), x=system.x, P=system.P, mu=[1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Track:
    """What a filter makes of z (..., N, 2): positions `expected` (..., N, 2) a row before, and `side` (..., N, 3).

    `side` holds the probabilities of straight flight, a turn to the left, and one to the right.
    """

    expected: Array
    side: Array


def followed(system: StochasticSystem, z: Array) -> Track:
    """Return what an IMM filter (a Kalman filter where there is one mode) expects and believes, row by row."""
    sides = np.array([[name not in ("left", "right"), name == "left", name == "right"] for name in system.names])
    belief, expected, side = Belief.prior(system, z.shape[:-2]), [], []
    for k in range(z.shape[-2]):
        predicted = predict_imm(system, belief)
        expected.append(predicted.mean[..., [0, 2]])
        belief = update(system, predicted, z[..., k, :]).belief
        side.append(belief.mu @ sides)
    return Track(np.stack(expected, axis=-2), np.stack(side, axis=-2))


def pieces(rows: Array) -> Array:
    """Return rows (N, ...) cut into pieces of `ROWS`, each with the `WARM` before it: (pieces, WARM + ROWS, ...).

    >>> pieces(np.arange(1000.0))[:2, [0, -1]].tolist()
    [[0.0, 189.0], [150.0, 339.0]]
    """
    starts = range(0, len(rows) - WARM - ROWS + 1, ROWS)
    return np.stack([rows[start : start + WARM + ROWS] for start in starts])


def tune_single(flight: Flight) -> tuple[float, float]:
    """Return the w of the single filter with the smallest prediction error on a flight, and that error in m."""
    z = pieces(flight.z)

    def loss(logarithm: float) -> float:
        return _prediction(followed(single_filter(float(np.exp(logarithm))), z), z)

    done = minimize_scalar(loss, bounds=(np.log(0.1), np.log(100.0)), method="bounded", options={"xatol": 0.02})
    return float(np.exp(done.x)), float(done.fun)


def tune(flight: Flight, unit: float, *, evaluations: int = 200) -> dict[str, float]:
    """Return the best numbers of the IMM filter on a flight, by Nelder and Mead's search from `BEFORE`.

    Best is the smallest sum of three: the prediction error in units of `unit` (m), that of the single filter; the mean
    of -log p of what the aircraft really does, straight or a turn to this side; and `DOUBLED` for each number, times
    the square of its distance from `BEFORE` in doublings, so that what a flight does not tell stays as expected.
    """
    z, turn = pieces(flight.z), pieces(flight.turn.astype(np.float64)).astype(np.int64)
    before = np.log(list(BEFORE.values()))

    def loss(logarithms: Array) -> float:
        values = dict(zip(BEFORE, np.exp(logarithms).tolist(), strict=True))
        if values["leave"] >= 0.5 or values["end"] >= 1.0:
            return np.inf
        track = followed(system_with(values), z)
        really = np.take_along_axis(track.side, (turn % 3)[..., None], axis=-1)[:, WARM:]
        surprise = -np.log(np.maximum(really, 1e-12)).mean()
        far = DOUBLED * (((logarithms - before) / np.log(2.0)) ** 2).sum()
        return float(_prediction(track, z) / unit + surprise + far)

    simplex = np.vstack((before, before + 0.5 * np.eye(len(before))))
    done = minimize(
        loss,
        before,
        method="Nelder-Mead",
        options={"maxfev": evaluations, "xatol": 0.03, "fatol": 3e-4, "initial_simplex": simplex},
    )
    return dict(zip(BEFORE, np.exp(done.x).tolist(), strict=True))


def tune_sure(flight: Flight, track: Track) -> float:
    """Return the smallest of `SURE` that names at most `FALSE` false turns an hour on a flight, else the largest."""
    return next((sure for sure in SURE if score(flight, track, sure).false <= FALSE), SURE[-1])


def _prediction(track: Track, z: Array) -> float:
    """Root mean square of the distance from what was expected, in m; of pieces, without the rows before them."""
    return _rms(np.linalg.norm(track.expected - z, axis=-1)[:, WARM:])


@dataclass(frozen=True, slots=True)
class TurnScore:
    """How well turns were named, and how far one-step predictions lie from what was measured.

    `delays`: seconds from the beginning of each true turn to its first row named so, None where it never is; `lasting`:
    which of them last 15 s and longer; `false`: named turns per hour that no true turn is near; `right`: share of rows;
    `prediction`: root mean square of the distance in m, `prediction_in_turns` the same in true turns.
    """

    delays: tuple[int | None, ...]
    lasting: tuple[bool, ...]
    false: float
    right: float
    prediction: float
    prediction_in_turns: float

    def __str__(self) -> str:
        seen = sorted(delay for delay in self.delays if delay is not None)
        middle = f"{np.median(seen):.0f} s in the median, {seen[int(0.9 * len(seen))]} s at 90 %" if seen else "none"
        long = sum(1 for delay, lasts in zip(self.delays, self.lasting, strict=True) if lasts and delay is not None)
        return (
            f"{len(seen)} of {len(self.delays)} turns named, {long} of {sum(self.lasting)} that last 15 s, "
            f"after {middle}; {self.false:.1f} false turns an hour; {100 * self.right:.1f} % of rows right; "
            f"prediction {self.prediction:.1f} m rms, in turns {self.prediction_in_turns:.1f} m"
        )


def named_turns(side: Array, sure: float) -> NDArray[np.int64]:
    """Return 1, -1 or 0 for each row of probabilities (N, 3): a turn from where it passes `sure` until below a half.

    >>> named_turns(np.array([[0.4, 0.6, 0.0], [0.1, 0.9, 0.0], [0.4, 0.6, 0.0], [0.6, 0.4, 0.0]]), 0.8).tolist()
    [0, 1, 1, 0]
    """
    found = np.zeros(len(side), dtype=np.int64)
    now = 0
    for k, chance in enumerate(side):
        if now and chance[now] < 0.5:
            now = 0
        if not now and chance[1:].max() >= sure:
            now = 1 if chance[1] > chance[2] else -1
        found[k] = now
    return found


def stays(values: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """Return the stretches of equal values that are not 0: (first row, row behind the last, value).

    >>> stays(np.array([0, 1, 1, 0, -1]))
    [(1, 3, 1), (4, 5, -1)]
    """
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return [(a, b, int(values[a])) for a, b in itertools.pairwise(edges) if values[a] != 0]


def score(flight: Flight, track: Track, sure: float) -> TurnScore:
    """Return how a filter's track of a whole flight compares with its truth."""
    named, true = named_turns(track.side, sure), flight.turn
    false = sum((true[max(a - APART, 0) : b + APART] != side).all() for a, b, side in stays(named))
    flown = stays(true)
    delays = tuple(next((int(k) for k in np.flatnonzero(named[a:b] == side)), None) for a, b, side in flown)
    distance = np.linalg.norm(track.expected - flight.z, axis=1)
    distance[:10] = np.nan
    return TurnScore(
        delays,
        tuple(b - a >= 15 for a, b, _ in flown),
        3600.0 * false / len(true),
        float((named == true).mean()),
        _rms(distance),
        _rms(distance[true != 0]),
    )


def _rms(values: Array) -> float:
    """Root mean square of the values that are there, NaN without any."""
    there = values[np.isfinite(values)]
    return float(np.sqrt(np.mean(there**2))) if there.size else float("nan")


def main(paths: Sequence[str]) -> int:
    """Tune on each flight and score on both; print what was found."""
    flights = [read_flight(path) for path in paths]
    for one in flights:
        w, unit = tune_single(one)
        values = tune(one, unit)
        system = system_with(values)
        sure = tune_sure(one, followed(system, one.z))
        told = ", ".join(f"{name} {value:.3g}" for name, value in values.items())
        print(f"tuned on {one.name}: {told}, sure {sure:g}; single filter: w {w:.3g}")
        for other in flights:
            print(f"  IMM on {other.name}: {score(other, followed(system, other.z), sure)}")
            print(f"  single filter on {other.name}: {score(other, followed(single_filter(w), other.z), sure)}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
