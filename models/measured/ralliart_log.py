"""Logs of the measured car: what they say on a regular grid, what was true, and what a ratio comparison makes of it.

In: a raw log (CSV, one row per engine frame, about 100 Hz, times in `t_s`).  Out: samples on the 10 ms grid, each the
previous row's value, in SI units: engine torque (N m), crankshaft and wheel speed (rad/s; the output shaft turns
`FINAL_DRIVE` times for one turn of a wheel), and the truth: q_i where gear i is reported engaged with its clutch
closed, qN everywhere else.  The ratio comparison is what cars do today; it is the bar for the detector.

One pass.  Source: Balluchi et al. (2012), section 5, for the truth's meaning.
"""

import csv
import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from deshybrid.model.load import load
from deshybrid.simulate.comparison import compare_ratios

FINAL_DRIVE = 4.062
STEP = 0.01
MODEL = Path(__file__).with_name("ralliart.yaml")
REVERSE_LEVER = 7
_RAD_PER_S = 2.0 * np.pi / 60.0  # of one revolution per minute

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One log on the grid: arrays of equal length; `gear`: 1 to 6, -1 reverse, 0 = not closed."""

    name: str
    time: Array
    torque: Array
    crank: Array
    wheel: Array
    gear: NDArray[np.int64]

    @property
    def location(self) -> list[str]:
        """Names of the true locations, sample by sample."""
        return [f"q{'N' if g == 0 else 'R' if g < 0 else g}" for g in self.gear.tolist()]

    def stays(self) -> Iterator[tuple[int, int, int]]:
        """Stretches of one gear: (first index, index behind the last, gear)."""
        edges = [0, *(np.flatnonzero(np.diff(self.gear)) + 1).tolist(), len(self.gear)]
        for begin, end in itertools.pairwise(edges):
            yield begin, end, int(self.gear[begin])


def read_log(path: str | Path, *, step: float = STEP) -> Drive:
    """Return a raw log on a grid of `step` seconds, by previous value; ValueError where a column is missing."""
    with Path(path).open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    if not rows:
        raise ValueError(f"{path} has no rows")

    def column(name: str) -> Array:
        if name not in rows[0]:
            raise ValueError(f"{path} has no column {name}")
        return np.array([float(row[name]) for row in rows])

    raw = column("t_s")
    grid = raw[0] + step * np.arange(int((raw[-1] - raw[0]) / step + 1e-9) + 1)
    index = np.searchsorted(raw, grid + 1e-9, side="right") - 1
    closed = column("clutch_closed") > 0
    gear = np.where(closed, column("gear_actual"), 0).astype(np.int64)
    gear[closed & (column("lever") == REVERSE_LEVER)] = -1
    return Drive(
        Path(path).stem,
        np.round(grid - raw[0], 9),
        column("engine_torque_nm")[index],
        column("engine_rpm")[index] * _RAD_PER_S,
        column("output_shaft_rpm")[index] * _RAD_PER_S / FINAL_DRIVE,
        gear[index],
    )


def trace_text(drive: Drive) -> str:
    """Return the drive as a trace: `time,T_e,omega_e,omega_w,true_location`."""
    lines = ["time,T_e,omega_e,omega_w,true_location"]
    numbers = zip(drive.time.tolist(), drive.torque.tolist(), drive.crank.tolist(), drive.wheel.tolist(), strict=True)
    lines += [
        f"{t!r},{torque!r},{crank!r},{wheel!r},{name}"
        for (t, torque, crank, wheel), name in zip(numbers, drive.location, strict=True)
    ]
    return "\n".join(lines) + "\n"


def ratio_names(drive: Drive) -> tuple[str | None, ...]:
    """Return the location that the model's ratio comparison names, sample by sample."""
    rule = load(MODEL).simulation.comparison
    if rule is None:
        raise ValueError(f"{MODEL} states no comparison")
    return compare_ratios(rule, drive.time.tolist(), drive.crank.tolist(), drive.wheel.tolist())


@dataclass(frozen=True, slots=True)
class GearScore:
    """Shares of samples, and per closing (time, location, length, signed delay or None = never named), in seconds.

    `right`, `wrong`: of the closed samples.  `false`: share of the samples that are not closed in which a gear is
    named, 0.6 s before a closing of that gear and 0.1 s after an opening not counted.
    """

    right: float
    wrong: float
    false: float
    closings: tuple[tuple[float, str, float, float | None], ...]

    def delays(self, shortest: float = 0.3) -> list[float | None]:
        """Signed delays of the closings that last at least `shortest` seconds."""
        return [delay for _, _, length, delay in self.closings if length >= shortest - 1e-9]


def score_gears(drive: Drive, named: Sequence[str | None], *, step: float = STEP) -> GearScore:
    """Return how well `named` (location names, None = unknown) fits the drive."""
    truth = drive.location
    closed = [k for k, name in enumerate(truth) if name != "qN"]
    right = sum(named[k] == truth[k] for k in closed)
    wrong = sum(named[k] not in (truth[k], "qN", None) for k in closed)
    stays = list(drive.stays())
    early, late = round(0.6 / step), round(0.1 / step)
    excused = np.zeros(len(truth), dtype=bool)
    for begin, end, gear in stays:
        if gear != 0:
            excused[end : end + late] = True
            for k in range(max(0, begin - early), begin):
                excused[k] = excused[k] or named[k] == truth[begin]
    is_open = [k for k, name in enumerate(truth) if name == "qN"]
    false = sum(named[k] not in ("qN", None) and not excused[k] for k in is_open)
    closings = tuple(
        (round(begin * step, 9), truth[begin], round((end - begin) * step, 9), _delay(truth, named, begin, end, step))
        for begin, end, gear in stays
        if gear != 0 and begin > 0
    )
    return GearScore(right / max(1, len(closed)), wrong / max(1, len(closed)), false / max(1, len(is_open)), closings)


def _delay(truth: Sequence[str], named: Sequence[str | None], begin: int, end: int, step: float) -> float | None:
    """Beginning of the naming that holds at the closing, back to the last opening; else the first naming after it."""
    gear = truth[begin]
    if named[begin] != gear:
        found = next((k for k in range(begin, end) if named[k] == gear), None)
        return None if found is None else round((found - begin) * step, 9)
    first = begin
    while first > 0 and named[first - 1] == gear and truth[first - 1] == "qN":
        first -= 1
    return round((first - begin) * step, 9)
