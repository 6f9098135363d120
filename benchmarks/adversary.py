"""The worst that disturbance, noise and switching do to the error: a lower bound of every bound, found by search.

Backwards from one state's error: a row d, the stay before it, the exit that led there.  For a given sequence of stays
the worst signals are bang-bang and reach the sum of the integrals of ‖d e^{F s} N‖₁; the search picks the sequence
greedily, with several guesses of what is still to come.  It shares no code with the bounds: times are on a grid and
exponentials are those of scipy.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm

Array = NDArray[np.float64]
CELLS = 400
STAYS = 12
DEEPEST = 60
GUESSES = (1.0, 0.3, 0.1, 0.03, 0.0)


class Jump(NamedTuple):
    """ζ := matrix ζ from `source` to `target`."""

    source: str
    target: str
    matrix: Array


class Place(NamedTuple):
    """One location on a grid of time: powers[k] = e^{F k width}, the drive's columns."""

    powers: Array
    drive: Array
    width: float


def place(F: Array, drive: Array, least_stay: float) -> Place:
    """Return the grid of one location: a whole number of cells makes the least stay, and longer stays follow."""
    size = float(np.abs(np.linalg.eigvals(F)).max())
    per_stay = max(20, int(np.ceil(least_stay * size / 0.1)))
    width = least_stay / per_stay
    power, powers = expm(F * width), [np.eye(len(F))]
    for _ in range(min(per_stay * STAYS, 20_000)):
        powers.append(powers[-1] @ power)
    return Place(np.array(powers), drive, width)


def worst_errors(places: Mapping[str, Place], jumps: Sequence[Jump], least_stay: float, guess: Array) -> Array:
    """Return what the search reaches for each state (n,); `guess` (n,) is a rough idea of the errors' sizes."""
    n = len(guess)
    best = np.zeros(n)
    for state in range(n):
        for name in places:
            for share in GUESSES:
                reached = _backwards(places, jumps, least_stay, share * guess, (name, np.eye(n)[state]))
                best[state] = max(best[state], reached)
    return best


def _backwards(
    places: Mapping[str, Place],
    jumps: Sequence[Jump],
    least_stay: float,
    guess: Array,
    end: tuple[str, Array],
) -> float:
    name, row = end
    gained, row = _best_stay(places[name], row, 0.0, guess)
    total = gained
    for _ in range(DEEPEST):
        options = [
            (*_best_stay(places[jump.source], row @ jump.matrix, least_stay, guess), jump.source)
            for jump in jumps
            if jump.target == name
        ]
        if not options:
            break
        gained, row, name = max(options, key=lambda option: option[0] + float(np.abs(option[1]) @ guess))
        total += gained
        if gained < 1e-9 * total:
            break
    return total


def _best_stay(here: Place, row: Array, least_stay: float, guess: Array) -> tuple[float, Array]:
    rows = row @ here.powers
    values = np.abs(rows @ here.drive).sum(axis=1)
    # Never more than the integral: the smaller end of each cell.
    gained = np.concatenate([[0.0], np.cumsum(np.minimum(values[:-1], values[1:]))]) * here.width
    first = round(least_stay / here.width)
    place = first + int(np.argmax(gained[first:] + np.abs(rows[first:]) @ guess))
    return float(gained[place]), rows[place]
