"""A measured morning on a freeway: how well the speed at stations without a loop is known, with and without cars.

In: one-minute means of loop stations (CSV: `pos_km`, `t_min`, `speed_kmh`).  Out: the root mean square error of the
switching Kalman filter at stations that were withheld, beside linear interpolation in space, and in space and time.

No floating car was recorded.  A car here is a withheld station that is revealed in one minute, at a random one (Poisson
arrivals): the mean of that minute, so kinder than one driver.  A station is not scored in a minute that reveals it.
Numbers are those of least squared error on one half of the morning, and scored on the other half; so for all methods.

The speeds obey v(k+1) = A v(k) + f + d(k): a share of each downstream neighbour in A, because waves of congestion run
upstream, and a share of each upstream neighbour, because free traffic carries its speed along; a slow return to a
common level; and a disturbance d that is alike nearby and that forgets itself within 7 minutes, or at once: white.
A mode is a set of stations that report.  O(n³) a row and trial, n the stations, or twice as many; minutes in all.
Source: the freeway paper's mode-switched Kalman filter (`docs/measured-traffic.md`).

`python models/measured/freeway_day.py DAY.csv` prints the numbers and both tables.
"""

import csv
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from deshybrid.stochastic.record import estimate_known
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem

RATES = (4.0, 2.0, 1.0, 0.5)  # minutes from one car to the next, on average
SEEDS = 3
MEMORY = {"slow": 7.0, "white": 0.0}  # minutes; of the slow disturbance as the paper's claim takes it, not tuned
STARTS = ((4.0, 4.0, 6.0, 1.5, 100.0), (12.0, 8.0, 1.0, 3.0, 1000.0))
"""Where the search for the numbers begins: wave, forward, reach, strength, relaxation."""
ENDS = (-5.0, 8.5)  # of their logarithms
SETTLED = 10  # minutes that are not scored: there the prior speaks

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class Day:
    """Stations at `position` (S,) km, downstream last; mean speeds (N, S) km/h, a row a minute."""

    position: Array
    speed: Array

    def rows(self, begin: int, end: int) -> "Day":
        """Return these minutes alone."""
        return Day(self.position, self.speed[begin:end])


@dataclass(frozen=True, slots=True)
class Numbers:
    """`wave` km/h upstream, `forward` km/h downstream, `reach` km over which disturbances are alike, their `strength`.

    `strength` is in km/h a minute; `relaxation`, min, is the time in which speeds go back to `level`, km/h, and
    `memory`, min, that of the disturbance.
    `noise`, km/h, is that of a minute's mean; only its ratio to `strength` moves the estimate.
    """

    wave: float
    forward: float
    reach: float
    strength: float
    relaxation: float
    memory: float = 0.0
    noise: float = 5.0
    level: float = 80.0


def read_day(path: str | Path) -> Day:
    """Return a day; ValueError where a column is missing or the stations do not have the same minutes."""
    with Path(path).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    wanted = ("pos_km", "t_min", "speed_kmh")
    missing = [name for name in wanted if not rows or name not in rows[0]]
    if missing:
        raise ValueError(f"{path} has no column {missing[0]}")
    position, minute, speed = (np.array([float(row[name]) for row in rows]) for name in wanted)
    stations, minutes = np.unique(position), np.unique(minute)
    order = np.lexsort((position, minute))
    grid = np.array([(m, p) for m in minutes for p in stations])
    if len(grid) != len(rows) or (np.column_stack((minute, position))[order] != grid).any():
        raise ValueError(f"{path}: not every station has a row for every minute")
    return Day(stations, speed[order].reshape(len(minutes), len(stations)))


def exchange(position: Array, numbers: Numbers) -> Array:
    """Return A (S, S): what of each speed comes from its own place, from downstream, and from upstream.

    >>> exchange(np.array([0.0, 1.0]), Numbers(6.0, 12.0, 1.0, 1.0, np.inf)).tolist()
    [[0.9, 0.1], [0.2, 0.8]]
    """
    first = np.arange(len(position) - 1)
    back, ahead = (np.minimum(speed / 60.0 / np.diff(position), 0.5) for speed in (numbers.wave, numbers.forward))
    A = np.eye(len(position))
    A[first, first] -= back
    A[first, first + 1] += back
    A[first + 1, first + 1] -= ahead
    A[first + 1, first] += ahead
    return np.asarray(A * np.exp(-1.0 / numbers.relaxation))


def freeway_system(position: Array, reporting: Flags, numbers: Numbers) -> StochasticSystem:
    """Return the system whose mode m is that the stations `reporting[m]` (M, S) are measured; states are v, then d.

    With white disturbances, `memory` 0, the states are v alone.
    """
    count = len(position)
    A = exchange(position, numbers)
    alike = np.exp(-np.abs(position[:, None] - position) / numbers.reach)
    spread, zero, one = numbers.strength**2 * alike, np.zeros((count, count)), np.eye(count)
    F, Q, prior = A, spread, 30.0**2 * alike
    x = np.full(count, numbers.level)
    push = numbers.level * (1.0 - A.sum(axis=1))
    if numbers.memory > 0.0:
        keep = np.exp(-1.0 / numbers.memory)
        F = np.block([[A, one], [zero, keep * one]])
        Q = np.block([[zero, zero], [zero, (1.0 - keep**2) * spread]])
        prior = np.block([[prior, zero], [zero, spread]])
        x, push = np.r_[x, np.zeros(count)], np.r_[push, np.zeros(count)]
    modes = []
    for m, stations in enumerate(reporting):
        places = np.flatnonzero(stations).tolist()
        H, R = np.eye(count, len(x))[places], numbers.noise**2 * np.eye(len(places))
        modes.append(Mode(f"mode_{m}", F=F, H=H, Q=Q, R=R, f=push, output_index=places))
    names = tuple(mode.name for mode in modes)
    chain = ModeTransition(names, np.full((len(modes), len(modes)), 1.0 / len(modes)))
    return StochasticSystem(modes, chain, x=x, P=prior, mu=np.full(len(modes), 1.0 / len(modes)))


def filtered(day: Day, seen: Flags, numbers: Numbers) -> Array:
    """Return the filter's speeds (T, N, S) in T trials in which `seen` (T, N, S) was measured."""
    reporting, modes = np.unique(seen.reshape(-1, seen.shape[-1]), axis=0, return_inverse=True)
    system = freeway_system(day.position, reporting, numbers)
    z = np.where(seen, day.speed, np.nan)
    x: Array = estimate_known(system, z, modes.reshape(seen.shape[:-1])).x
    return x[..., : len(day.position)]


def interpolated(day: Day, seen: Flags, *, wave: float = 0.0, oldest: int = 0) -> Array:
    """Return speeds (T, N, S) interpolated linearly between what was measured up to `oldest` minutes ago.

    What is old has moved upstream with `wave` km/h.  With `oldest` 0 it is interpolation in space.
    """
    found = np.empty(seen.shape)
    for trial, k in np.ndindex(seen.shape[:2]):
        ages = range(min(oldest, k) + 1)
        at = np.concatenate([day.position[seen[trial, k - a]] - wave / 60.0 * a for a in ages])
        value = np.concatenate([day.speed[k - a, seen[trial, k - a]] for a in ages])
        order = np.argsort(at, kind="stable")
        found[trial, k] = np.interp(day.position, at[order], value[order])
    return found


def draw_cars(rows: int, places: Flags, every: float, seed: int) -> Flags:
    """Return which stations (rows, S) a car reports from: one car every `every` minutes, at one of `places` (S,)."""
    chance = 1.0 - np.exp(-1.0 / (every * places.sum()))
    cars: Flags = places & (np.random.default_rng(seed).random((rows, len(places))) < chance)
    return cars


@dataclass(frozen=True, slots=True, eq=False)
class Trials:
    """What is measured, and what is scored: (T, N, S) both."""

    seen: Flags
    scored: Flags

    def rms(self, day: Day, speed: Array) -> float:
        """Return the root mean square error of `speed` (T, N, S), km/h."""
        return float(np.sqrt(np.mean((speed - day.speed)[self.scored] ** 2)))


def trials_of(day: Day, loops: Flags, cars_at: Flags, scored: Flags, every: float | None) -> Trials:
    """Return trials in which `loops` (S,) always report, and cars at `cars_at` from time to time; None: no cars."""
    rows = len(day.speed)
    seeds = range(SEEDS if every is not None else 1)
    none = np.zeros((rows, len(loops)), dtype=bool)
    seen = loops | np.stack([none if every is None else draw_cars(rows, cars_at, every, seed) for seed in seeds])
    counted = scored & ~seen
    counted[:, :SETTLED] = False
    return Trials(seen, counted)


def withheld_stations(count: int) -> Flags:
    """Return every third station, the ends not among them.

    >>> np.flatnonzero(withheld_stations(8)).tolist()
    [1, 4]
    """
    withheld = np.zeros(count, dtype=bool)
    withheld[1 : count - 1 : 3] = True
    return withheld


@dataclass(frozen=True, slots=True)
class Tuned:
    """What was tuned on a stretch of the day: the numbers of each filter, and wave and age of interpolation."""

    filters: dict[str, Numbers]
    wave: float
    oldest: int

    def errors(self, day: Day, trials: Trials) -> list[float]:
        """Return the error (km/h) of each method, in the order of `METHODS`."""
        found = [trials.rms(day, filtered(day, trials.seen, numbers)) for numbers in self.filters.values()]
        found.append(trials.rms(day, interpolated(day, trials.seen, wave=self.wave, oldest=self.oldest)))
        return [*found, trials.rms(day, interpolated(day, trials.seen))]


METHODS = (*(f"filter, {kind} disturbance" for kind in MEMORY), "interpolated in space and time", "in space")


def tune(day: Day, withheld: Flags, *, evaluations: int = 40) -> Tuned:
    """Return the numbers of least squared error: loops alone, a car every 2 minutes, and a loop that fails."""
    given = [trials_of(day, ~withheld, withheld, withheld, every) for every in (None, 2.0)]
    given.append(failed_loop(day, withheld, None, fails=True))
    filters = {kind: _tuned_filter(day, given, memory, evaluations) for kind, memory in MEMORY.items()}
    choices = [(wave, oldest) for wave in (1.0, 2.0, 3.0, 5.0, 7.0, 10.0, 15.0, 20.0) for oldest in (0, 2, 4, 8, 16)]
    tried = [
        sum(t.rms(day, interpolated(day, t.seen, wave=wave, oldest=oldest)) ** 2 for t in given)
        for wave, oldest in choices
    ]
    return Tuned(filters, *choices[int(np.argmin(tried))])


def _tuned_filter(day: Day, given: Sequence[Trials], memory: float, evaluations: int) -> Numbers:
    def numbers_of(logarithms: Array) -> Numbers:
        wave, forward, reach, strength, relaxation = np.exp(np.clip(logarithms, *ENDS)).tolist()
        return Numbers(wave, forward, reach, strength, relaxation, memory)

    def loss(logarithms: Array) -> float:
        numbers = numbers_of(logarithms)
        return sum(trials.rms(day, filtered(day, trials.seen, numbers)) ** 2 for trials in given)

    found = []
    for start in np.log(STARTS):
        simplex = np.vstack((start, start + 0.6 * np.eye(len(start))))
        done = minimize(
            loss,
            start,
            method="Nelder-Mead",
            options={"maxfev": evaluations, "xatol": 0.05, "fatol": 0.5, "initial_simplex": simplex},
        )
        found.append(done)
    return numbers_of(min(found, key=lambda done: float(done.fun)).x)


def failed_loop(day: Day, withheld: Flags, every: float | None, *, fails: bool) -> Trials:
    """Return trials in which the loop nearest to each withheld station fails, and cars report from its place."""
    parts = []
    for station in np.flatnonzero(withheld):
        distance = np.where(withheld, np.inf, np.abs(day.position - day.position[station]))
        failed, here = np.arange(len(withheld)) == distance.argmin(), np.arange(len(withheld)) == station
        parts.append(trials_of(day, ~withheld & ~(failed & fails), failed, here, every))
    return Trials(np.concatenate([part.seen for part in parts]), np.concatenate([part.scored for part in parts]))


def tables(day: Day, *, evaluations: int = 40) -> str:
    """Return numbers and both tables as text; each half of the day is scored with the numbers tuned on the other."""
    withheld, middle = withheld_stations(len(day.position)), len(day.speed) // 2
    halves = (day.rows(0, middle), day.rows(middle, len(day.speed)))
    tuned = tuple(tune(half, withheld, evaluations=evaluations) for half in halves)

    def line(name: str, trials: Sequence[Trials]) -> str:
        pairs = zip(*(t.errors(h, one) for t, h, one in zip(tuned[::-1], halves, trials, strict=True)), strict=True)
        return " | ".join([f"| {name}", *(f"{first:.2f}, {second:.2f}" for first, second in pairs)]) + " |"

    head = ["| measured | " + " | ".join(METHODS) + " |", "|" + "---|" * (1 + len(METHODS))]
    free, broken = [*head], [*head]
    for every in (None, *RATES):
        name = "loops only" if every is None else f"and a car every {every:g} min"
        free.append(line(name, [trials_of(half, ~withheld, withheld, withheld, every) for half in halves]))
    broken.append(line("all loops", [failed_loop(half, withheld, None, fails=False) for half in halves]))
    for every in (None, *RATES):
        name = "one failed" if every is None else f"one failed, a car there every {every:g} min"
        broken.append(line(name, [failed_loop(half, withheld, every, fails=True) for half in halves]))
    return "\n".join([*_numbers(tuned), "", *free, "", *broken]) + "\n"


def _numbers(tuned: Sequence[Tuned]) -> list[str]:
    columns = ("wave (km/h)", "forward (km/h)", "reach (km)", "strength (km/h)", "relaxation (min)", "oldest (min)")
    lines = ["| " + " | ".join(("tuned on", "method", *columns)) + " |", "|" + "---|" * (2 + len(columns))]
    for half, found in zip(("first half", "second half"), tuned, strict=True):
        for method, n in zip(METHODS, found.filters.values(), strict=False):
            told = " | ".join(f"{value:.4g}" for value in (n.wave, n.forward, n.reach, n.strength, n.relaxation))
            lines.append(f"| {half} | {method} | {told} | |")
        lines.append(f"| {half} | {METHODS[-2]} | {found.wave:g} | | | | | {found.oldest} |")
    return lines


def main(arguments: Sequence[str]) -> int:
    """Print the tables of the day in the file that is named."""
    if len(arguments) != 1:
        print("usage: freeway_day.py DAY.csv", file=sys.stderr)
        return 2
    print(tables(read_day(arguments[0])), end="")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
