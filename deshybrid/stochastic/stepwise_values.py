"""What the filters' reference step reads, remembers, works in and tells: flat arrays, and what a row can come to.

In: nothing.  Out: `Constants`, `State`, `Room`, `Out` and the codes of a row.  This file is part of generated Python,
word for word.

Source: `deshybrid.stochastic.stepwise`.
"""

from typing import Any, NamedTuple

Numbers = Any


class Constants(NamedTuple):
    """A system, its matrices flat: mode by mode, row by row.  `powers` are 2, 2², 2⁴, ... as far as they are finite."""

    modes: int
    n: int
    m: int
    p: int
    F: Numbers
    Q: Numbers
    B: Numbers
    f: Numbers
    H: Numbers
    R: Numbers
    D: Numbers
    g: Numbers
    measured: Numbers  # 1 where a mode measures an output, else 0
    probability_to_from: Numbers
    x: Numbers
    P: Numbers
    mu: Numbers
    powers: Numbers
    least: float  # below it exp is 0
    largest: float  # beyond it a number is no measurement, and an estimate starts again
    limits: Numbers  # of the squared distance by number of measured outputs, 0 to p; none without a gate
    patience: int  # after so many outliers in a row the gate opens, after so many rows within it closes again


class State(NamedTuple):
    """What a filter remembers.  A slot holds one Gaussian: one for each mode, or one alone where the mode is known."""

    x: Numbers  # (slots, n)
    P: Numbers  # (slots, n, n)
    mu: Numbers  # (modes)
    held: Numbers  # (m), the input since the last row
    started: Numbers  # (1), 1 after the first row
    count: Numbers  # (1), of outliers in a row; from `patience` on the gate is open, the rest are rows within it


class Room(NamedTuple):
    """Where a step works; what it holds between two steps is of no meaning."""

    x: Numbers  # (slots, n)
    P: Numbers  # (slots, n, n)
    FP: Numbers  # (n, n)
    spread: Numbers  # (n)
    seen: Numbers  # (p), 1 where an output was measured
    residual: Numbers  # (slots, p)
    S: Numbers  # (slots, p, p)
    L: Numbers  # (p, p)
    W: Numbers  # (p, n)
    e: Numbers  # (p)
    before: Numbers  # (m), the input of the step that leads to the row
    distance: Numbers  # (slots), r S⁻¹ r
    fit: Numbers  # (slots), r S⁻¹ r + log det S
    weight: Numbers  # (modes)
    predicted: Numbers  # (modes)


class Out(NamedTuple):
    """Mean (n) and covariance (n, n) of the mixture; log-likelihood and squared residual (NIS) of the row."""

    x: Numbers
    P: Numbers
    told: Numbers  # (2)


OK, RESTARTED, INVALID, OUTLIER, READMITTED = 0, 1, 2, 3, 4
"""A row was taken; the filter started again; the mode does not exist; the row was left out; taken though beyond it."""

__all__ = ["INVALID", "OK", "OUTLIER", "READMITTED", "RESTARTED", "Constants", "Numbers", "Out", "Room", "State"]
