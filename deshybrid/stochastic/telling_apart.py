"""Which modes, and which switches, the outputs of a window tell apart, and how many rows that takes.

In: a `StochasticSystem` and a `Window`.  Out: for every two modes, and for every switch that the chain allows, from
which row on the outputs differ at all, how far apart they are on every window, and the rows that a stated error needs.
Means and covariances both count: known inputs and offsets may tell what noise does not.

The state at the first row has the prior's mean and covariance Π₀, the same in all modes: errors are averages over it.
A test that has to work for every state has also to tell the *worst states* apart: a pair of known states, one in each
mode, with the nearest outputs, anew for every window.

A switch is compared with no switch at all, and with a switch that many rows later.  Its rows count from the first row
of the new mode, which governs the step to that row (`stochastic/system.py`): 1 is "at once".

O((N p)³) for each comparison.  Source: Hwang, Balakrishnan and Tomlin (2003), section 2; distances: `output_distance`.
"""

from dataclasses import dataclass
from itertools import combinations, permutations

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.distance import OutputDistance, chernoff_distance, least_error, output_distance, unexplained
from deshybrid.stochastic.observability import rows_that_agree
from deshybrid.stochastic.outputs import OutputGaussian, staying, switching_once
from deshybrid.stochastic.system import Mode, StochasticSystem


@dataclass(frozen=True, slots=True)
class Window:
    """`rows` rows are compared; a switch comes after `before` further rows; `error` is the probability of a wrong name.

    Raises `UsageError` (DH1204) where these are no whole numbers above zero and no probability below one half.
    """

    rows: int = 100
    before: int = 20
    error: float = 0.01

    def __post_init__(self) -> None:
        if self.rows < 1 or self.before < 1 or not 0.0 < self.error < 0.5:
            text = f"{self.rows} rows after {self.before} with an error of {self.error:g} are no window"
            helps = ("take at least one row each, and an error between 0 and 0.5, the error of a coin",)
            raise UsageError(diagnostic("DH1204", text, helps=helps))


@dataclass(frozen=True, slots=True, eq=False)
class ModePair:
    """Two modes, each kept for the whole window.

    `covariances_differ_from`, `differ_from`: the shortest window on which the covariances, and on which means or
    covariances differ beyond rounding; None where none does.  `worst_states` (N,): the Bhattacharyya distance that is
    left for the worst states.
    """

    first: str
    second: str
    covariances_differ_from: int | None
    differ_from: int | None
    distance: OutputDistance
    worst_states: FloatArray

    def rows_needed_from_worst_states(self, error: float) -> int | None:
        """The first window on which a test might be as good as `error` for every pair of states, else None."""
        holds = least_error(self.worst_states) <= error
        return int(np.argmax(holds)) + 1 if holds.any() else None


@dataclass(frozen=True, slots=True, eq=False)
class SwitchComparison:
    """A switch against none; windows count rows of the new mode.

    `differ_from` as in `ModePair`.  `time_known_to`: the least d such that a switch d rows later is told apart within
    the window with the window's error; None where no d is.
    """

    source: str
    target: str
    differ_from: int | None
    distance: OutputDistance
    time_known_to: int | None


def compare_modes(
    system: StochasticSystem, window: Window | None = None, u: FloatArray | None = None
) -> tuple[ModePair, ...]:
    """Return how every two modes compare, in their order; u (rows, m) is the known input, else zero.

    Raises `UsageError`: DH1103 where modes measure different outputs, DH1201 where outputs have no density.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> (pair,) = compare_modes(calm_and_wild(), Window(rows=40))
    >>> pair.differ_from, pair.distance.rows_needed(0.01), pair.distance.rows_that_suffice(0.01)
    (2, 8, 16)
    """
    system.comparable_bank  # noqa: B018 - refuses modes whose outputs cannot be compared
    window = window or Window()
    found = []
    for first, second in combinations(system.modes, 2):
        one, two = (staying(mode, window.rows, x=system.x, P=system.P, u=u) for mode in (first, second))
        covariance, both = rows_that_agree(one, two)
        found.append(
            ModePair(
                first.name,
                second.name,
                _first_after(covariance, window.rows),
                _first_after(both, window.rows),
                output_distance(one, two),
                _from_worst_states(first, second, window.rows, u),
            )
        )
    return tuple(found)


def compare_switches(
    system: StochasticSystem, window: Window | None = None, u: FloatArray | None = None
) -> tuple[SwitchComparison, ...]:
    """Return how every switch of positive probability compares with none; u (before + rows, m).

    Raises as `compare_modes`.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> [(s.source, s.target, s.differ_from) for s in compare_switches(calm_and_wild(), Window(rows=20))]
    [('calm', 'wild', 1), ('wild', 'calm', 1)]
    """
    system.comparable_bank  # noqa: B018 - refuses modes whose outputs cannot be compared
    window, names = window or Window(), system.names
    allowed = [
        (source, target)
        for source, target in permutations(system.modes, 2)
        if system.chain.probability_to_from[names.index(target.name), names.index(source.name)] > 0.0
    ]
    return tuple(_compared(system, source, target, window, u) for source, target in allowed)


def _compared(
    system: StochasticSystem, source: Mode, target: Mode, window: Window, u: FloatArray | None
) -> SwitchComparison:
    before, total = window.before, window.before + window.rows

    def switching(at: int) -> OutputGaussian:
        return switching_once(source, target, at, total, x=system.x, P=system.P, u=u)

    switched, stayed = switching(before), switching(total)
    _, agreeing = rows_that_agree(switched, stayed)
    whole = output_distance(switched, stayed)
    parts = (whole.forward, whole.backward, whole.bhattacharyya, whole.chernoff)
    distance = OutputDistance(*(part[before:] for part in parts))
    known_to = None
    if distance.rows_that_suffice(window.error) is not None:
        later = range(1, window.rows + 1)
        told = (d for d in later if _told(switched, switching(before + d), window.error))
        known_to = next(told, None)
    return SwitchComparison(source.name, target.name, _first_after(agreeing - before, window.rows), distance, known_to)


def _told(first: OutputGaussian, second: OutputGaussian, error: float) -> bool:
    """Whether the whole window tells the two apart."""
    return bool(0.5 * np.exp(-chernoff_distance(first, second)[-1]) <= error)


def _first_after(agreeing: int, rows: int) -> int | None:
    return None if agreeing >= rows else agreeing + 1


def _from_worst_states(first: Mode, second: Mode, rows: int, u: FloatArray | None) -> FloatArray:
    """The Bhattacharyya distance of the modes where every state is known, the nearest pair of states taken."""
    n = len(first.f)
    one, two = (staying(mode, rows, x=np.zeros(n), P=np.zeros((n, n)), u=u) for mode in (first, second))
    return unexplained(one, two, np.hstack([_states_to_outputs(first, rows), -_states_to_outputs(second, rows)]))


def _states_to_outputs(mode: Mode, rows: int) -> FloatArray:
    """O of the window: H; H F; H F²; ..."""
    lines = [mode.H]
    for _ in range(rows - 1):
        lines.append(lines[-1] @ mode.F)
    return np.vstack(lines)


__all__ = ["ModePair", "SwitchComparison", "Window", "compare_modes", "compare_switches"]
