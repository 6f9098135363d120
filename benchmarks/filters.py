"""MMAE, IMM and RMIMM on the two aircraft examples of Hwang, Balakrishnan and Tomlin (2006), over levels of noise.

    python -m benchmarks.filters

Prints the tables of `docs/stochastic.md`.  The first example (section 4.3) is drawn from its own model: a turn of known
acceleration from 45 s to 56 s.  The second (section 5) is the paper's flight, whose turns no mode describes exactly.
100 flights each, the same for every method; an interval is 1.96 standard errors of the mean over the flights.
"""

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from deshybrid.model.load import loads
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.record import estimate
from deshybrid.stochastic.sample import sample

MODELS = Path(__file__).parents[1] / "models/hwang2006"
METHODS = ("mmae", "imm", "rmimm")
TRIALS = 100
SPEED = 480 * 1852 / 3600  # m/s
SEGMENTS = ((30, 0.0), (20, -3.0), (20, 0.0), (20, 1.5), (20, 0.0), (20, -4.5), (20, 0.0))  # s, degrees a second


@dataclass(frozen=True)
class Flights:
    """What was measured, and what is true of it: the mode by row, position and speed where they stand in the state."""

    z: np.ndarray
    modes: np.ndarray
    x: np.ndarray


def system_of(name: str, **parameters: float):
    """The model's system with some of its parameters changed."""
    text = (MODELS / f"{name}.yaml").read_text(encoding="utf-8")
    for key, value in parameters.items():
        head, line, tail = text.partition("parameters: {")
        inside, brace, rest = tail.partition("}")
        pairs = dict(pair.split(": ") for pair in inside.split(", ")) | {key: repr(value)}
        text = head + line + ", ".join(f"{k}: {v}" for k, v in pairs.items()) + brace + rest
    return stochastic_system(loads(text))


def matched(system, seed: int) -> Flights:
    modes = np.array([int(45 <= k < 56) for k in range(100)])
    runs = sample(system, 100, seed=seed, trials=(TRIALS,), modes=modes)
    return Flights(runs.z, modes, runs.x[..., [0, 1, 2, 3]])


def flown(deviation: float, seed: int) -> Flights:
    """The flight of Figure 1: exact circles at constant speed, sampled every second."""
    rates = np.concatenate([np.full(length, np.radians(rate)) for length, rate in SEGMENTS])
    fine = 100
    heading = np.cumsum(np.repeat(rates, fine)) / fine
    velocity = SPEED * np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    position = np.cumsum(velocity, axis=0) / fine
    at = slice(fine - 1, None, fine)
    truth = np.concatenate([position[at], velocity[at]], axis=-1)[:, [0, 2, 1, 3]]
    noise = deviation * np.random.default_rng(seed).standard_normal((TRIALS, len(rates), 2))
    return Flights(truth[:, [0, 2]] + noise, (rates != 0.0).astype(int), truth)


def interval(values: np.ndarray, digits: int = 3) -> str:
    return f"{values.mean():.{digits}f} ± {1.96 * values.std(ddof=1) / np.sqrt(len(values)):.{digits}f}"


def delays(named: np.ndarray, modes: np.ndarray) -> str:
    """Rows from 1 to the first that names the mode of a stay, for every switch.

    A stay never named counts whole, plus 1; in brackets stands how many flights never named it.
    """
    starts = [*(np.flatnonzero(np.diff(modes)) + 1).tolist(), len(modes)]
    texts = []
    for start, end in pairwise(starts):
        right = named[:, start:end] == modes[start]
        first = np.where(right.any(axis=1), 1.0 + right.argmax(axis=1), 1.0 + end - start)
        missed = int((~right.any(axis=1)).sum())
        texts.append(interval(first, 1) + (f" ({missed})" if missed else ""))
    return ", ".join(texts)


def rows(system, flights: Flights, places: list[int], label: str) -> list[str]:
    lines = []
    for method in METHODS:
        made = estimate(system, flights.z, method=method)
        wrong = (made.most_probable != flights.modes).mean(axis=1)
        sure = made.mu.max(axis=-1).mean(axis=1)
        errors = (made.x[..., places] - flights.x) ** 2
        position, speed = (np.sqrt((errors[..., i] + errors[..., i + 2]).mean(axis=1)) for i in (0, 1))
        cells = [label, method, delays(made.most_probable, flights.modes)]
        lines.append("| " + " | ".join([*cells, *map(interval, (wrong, sure, position, speed))]) + " |")
    return lines


def main() -> None:
    head = "| {} | method | delay (rows) | wrong mode | largest probability | position (rms, m) | speed (rms, m/s) |"
    print(head.format("noise w, v"), "|---|---|---|---|---|---|---|", sep="\n")
    for w in (0.02, 0.05, 0.2):
        for v in (0.3, 1.0, 5.0):
            system = system_of("turn", w=w, v=v)
            print(*rows(system, matched(system, seed=43), [0, 1, 2, 3], f"{w:g} m/s², {v:g} m"), sep="\n")
    print()
    print(head.format("noise v"), "|---|---|---|---|---|---|---|", sep="\n")
    for v in (10.0, 30.0, 100.0):
        print(*rows(system_of("maneuver", v=v), flown(v, seed=5), [0, 1, 3, 4], f"{v:g} m"), sep="\n")


if __name__ == "__main__":
    main()
