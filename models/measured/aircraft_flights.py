"""Measured flights: how their tracks are read, what tunes the model of an aircraft, and how well turns are seen.

In: a track (CSV, a row a second with gaps; `t_s`, `x_east_m`, `y_north_m`, and for the score `turn_rate_dps`).
Out: the best numbers on one flight, and on the other the score of the IMM filter beside a single Kalman
filter for straight flight whose noise was tuned in the same way.

A position that repeats is a frozen receiver, not an aircraft that stands still: it counts as missing.  The truth is
derived from the recorded turn rate: a turn begins above 0.5 and ends below 0.25 deg/s.
Some hundred runs over a flight: 2 s each, 0.1 s with the extra `numba`.
Source: Hwang et al. (2006), sections 3 and 5.

`python models/measured/aircraft_flights.py ONE.csv OTHER.csv` tunes on each and scores on the other.
"""

import csv
import itertools
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import with_parameters
from deshybrid.model.source import read_source
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.record import Engine, Estimates, estimate
from deshybrid.stochastic.system import ModeTransition, StochasticSystem

MODEL = Path(__file__).with_name("aircraft.yaml")
TUNED = {"imm": ("rate", "w", "w_turn", "v", "leave", "end"), "straight": ("w",)}
BEGIN, END = 0.5, 0.25  # deg/s
APART = 10  # rows: a named turn that is farther from every true one is false

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


def system_with(values: Mapping[str, float], *, single: bool = False) -> StochasticSystem:
    """Return the model with these parameters; `single`: its straight mode alone."""
    system = stochastic_system(elaborate(with_parameters(read_source(MODEL), values)))
    if not single:
        return system
    mode = system.modes[0]
    return StochasticSystem((mode,), ModeTransition((mode.name,), [[1.0]]), x=system.x, P=system.P, mu=[1.0])


def tune(flight: Flight, kind: str, start: Mapping[str, float], *, engine: Engine = "numpy") -> dict[str, float]:
    """Return the best parameters on a flight; `kind`: `imm` or `straight`; searched from `start`.

    The single filter is tuned for the smallest prediction error, on which only w/v acts, so v stays.  For the IMM
    that error, in units of the single filter's at its start, and the share of rows whose turn is wrong are added.
    Likelihood was no use here: positions that come late are outliers to every mode, and of greatest likelihood is a
    "turn" with noise of 400 m/s² for them.
    """
    names, single = TUNED[kind], kind == "straight"
    unit = score(flight, system_with({"w": start["w"], "v": start["v"]}, single=True)).prediction

    def tuned(logarithms: Array) -> dict[str, float]:
        return {"v": start["v"], **dict(zip(names, np.exp(logarithms).tolist(), strict=True))}

    def loss(logarithms: Array) -> float:
        values = tuned(logarithms)
        if values.get("leave", 0.0) >= 1.0 or values.get("end", 0.0) >= 1.0:
            return np.inf
        reached = score(flight, system_with(values, single=single), engine=engine)
        return reached.prediction / unit + (0.0 if single else 1.0 - reached.right)

    begin = np.log([start[name] for name in names])
    simplex = np.vstack((begin, begin + 0.7 * np.eye(len(names))))  # each number doubled in turn
    limits = {"maxfev": 60 * len(names), "xatol": 0.02, "fatol": 1e-4, "initial_simplex": simplex}
    done = minimize(loss, begin, method="Nelder-Mead", options=limits)
    return tuned(done.x)


@dataclass(frozen=True, slots=True)
class TurnScore:
    """How well turns were named, and how far one-step predictions lie from what was measured.

    `delays`: seconds from the beginning of each true turn to its first row named so, None where it never is; `false`:
    named turns per hour that no true turn is near; `right`: share of rows; `prediction`: root mean square of the
    distance in m, `prediction_in_turns` the same in true turns.
    """

    delays: tuple[int | None, ...]
    false: float
    right: float
    prediction: float
    prediction_in_turns: float

    def __str__(self) -> str:
        seen = sorted(delay for delay in self.delays if delay is not None)
        middle = f"{np.median(seen):.0f} s in the median, {seen[int(0.9 * len(seen))]} s at 90 %" if seen else "none"
        return (
            f"{len(seen)} of {len(self.delays)} turns named, after {middle}; {self.false:.1f} false turns an hour; "
            f"{100 * self.right:.1f} % of rows right; prediction {self.prediction:.1f} m rms, in turns "
            f"{self.prediction_in_turns:.1f} m"
        )


def named_turns(system: StochasticSystem, found: Estimates) -> NDArray[np.int64]:
    """Return 1, -1 or 0 for the most probable mode of each row."""
    sides = np.array([{"left": 1, "right": -1}.get(name, 0) for name in system.names])
    return np.asarray(sides[found.most_probable], dtype=np.int64)


def stays(values: NDArray[np.int64]) -> list[tuple[int, int, int]]:
    """Return the stretches of equal values that are not 0: (first row, row behind the last, value).

    >>> stays(np.array([0, 1, 1, 0, -1]))
    [(1, 3, 1), (4, 5, -1)]
    """
    edges = [0, *(np.flatnonzero(np.diff(values)) + 1).tolist(), len(values)]
    return [(a, b, int(values[a])) for a, b in itertools.pairwise(edges) if values[a] != 0]


def predictions(system: StochasticSystem, found: Estimates) -> Array:
    """Return the position (N, 2) that the filter expects a row later; row k from what is known at row k-1.

    The mixture of the modes' predictions, each from the common estimate: what a display would extrapolate.
    """
    probability = found.mu @ system.chain.probability_to_from.T
    F, H = np.stack([mode.F for mode in system.modes]), np.stack([mode.H for mode in system.modes])
    moved = np.einsum("mpn,mnk,tk->tmp", H, F, found.x)
    expected = np.einsum("tm,tmp->tp", probability, moved)
    return np.vstack((np.full((1, expected.shape[1]), np.nan), expected[:-1]))


def score(flight: Flight, system: StochasticSystem, *, engine: Engine = "numpy") -> TurnScore:
    """Run the IMM filter (a Kalman filter where there is one mode) over a flight, and compare with its truth."""
    found = estimate(system, flight.z, engine=engine)
    named, true = named_turns(system, found), flight.turn
    near = np.convolve(true != 0, np.ones(2 * APART + 1), mode="same") > 0.5
    false = sum(not near[a:b].any() for a, b, _ in stays(named))
    delays = tuple(next((int(k) for k in np.flatnonzero(named[a:b] == side)), None) for a, b, side in stays(true))
    distance = np.linalg.norm(predictions(system, found) - flight.z, axis=1)
    distance[:10] = np.nan
    return TurnScore(
        delays,
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
    """Tune on each flight and score on the other; print both."""
    flights = [read_flight(path) for path in paths]
    start = {"rate": 1.5, "w": 1.0, "w_turn": 2.0, "v": 30.0, "leave": 0.01, "end": 0.05}
    engine: Engine = "numba" if find_spec("numba") else "numpy"
    for one, other in itertools.permutations(flights, 2):
        print(f"tuned on {one.name}, scored on {other.name}")
        for kind in ("imm", "straight"):
            values = tune(one, kind, start, engine=engine)
            print("  " + kind + ": " + ", ".join(f"{name} {value:.3g}" for name, value in values.items()))
            print(f"    {score(other, system_with(values, single=kind == 'straight'))}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
