"""Does the covariance of the switching Kalman filter stay bounded, however the modes switch?

In: a `StochasticSystem` whose modes are known row by row (they may measure different outputs), and a dwell time of d
rows.  Out: the number of rows after which every sequence of modes that keeps to it has shown the whole state, which
proves boundedness; or a cycle of modes along which a part of the state that grows is never seen, which disproves it.

The paper takes it as proved where every mode is observable and controllable.  That is not enough: modes that switch
fast may each look where the state has just left.  What counts is observability along the sequence.  The subspace of
states that are unseen so far is carried along all sequences; it can only shrink, and where it is zero nothing that
comes later matters.

Each sequence up to the row that shows the state is looked at, exponentially many at worst: `MOST_SEQUENCES` is the
limit.  A given sequence is answered row by row (`rows_that_show`).
Source: Böker, State estimation of switched systems; Anderson and Moore (1981) for what observability gives.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.observability import fixed_modes
from deshybrid.linear.subspaces import balanced_scale, column_space, null_space
from deshybrid.stochastic.system import StochasticSystem

MOST_SEQUENCES = 20_000
"""Sequences of modes that are looked at before the question is left undecided."""
GROWING = 1.0 + 1e-8
"""An eigenvalue of a cycle beyond this grows."""
FADING = 1e-4
"""An eigenvalue below this may be the rounding of a zero: what it belongs to leaves by itself."""


@dataclass(frozen=True, slots=True)
class Boundedness:
    """Of the covariance, for all stays of at least `dwell` rows.

    `bounded` true: every sequence of `rows` rows shows the whole state.  False: along `cycle`, repeated, some part is
    never seen and grows by the factor `growth` each time.  None: a part along `cycle` is never seen and does not grow,
    or, without a cycle, the limit came first.
    """

    dwell: int
    bounded: bool | None
    rows: int | None = None
    cycle: tuple[str, ...] = ()
    growth: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class _Path:
    """A sequence of modes, the age of its last stay (at most the dwell time), and what is unseen after it."""

    modes: tuple[int, ...]
    ages: tuple[int, ...]
    dimensions: tuple[int, ...]
    hidden: FloatArray

    def cycle(self) -> tuple[int, ...]:
        """The modes since the last time that all was as it is now; empty if it never was."""
        states = list(zip(self.modes, self.ages, self.dimensions, strict=True))
        for place in range(len(states) - 2, -1, -1):
            if states[place] == states[-1]:
                return self.modes[place + 1 :]
        return ()


class _Sight:
    """The modes in balanced coordinates, in which a singular value tells what is zero."""

    def __init__(self, system: StochasticSystem) -> None:
        bank, n = system.bank, len(system.x)
        scale = balanced_scale(np.abs(bank.F).sum(axis=0), np.zeros((n, 0)), np.abs(bank.H).sum(axis=0))
        moving, seeing = bank.F * scale / scale[:, None], bank.H * scale
        sizes, lengths = np.linalg.norm(moving, 2, axis=(1, 2)), np.linalg.norm(seeing, axis=2)
        self.F = moving / np.where(sizes > 0.0, sizes, 1.0)[:, None, None]
        self.H = seeing / np.where(lengths > 0.0, lengths, 1.0)[:, :, None]

    def still_hidden(self, basis: FloatArray, mode: int) -> FloatArray:
        """What of a subspace of states the mode does not show."""
        return np.asarray(basis @ null_space(self.H[mode] @ basis)) if basis.shape[1] else basis

    def moved(self, basis: FloatArray, mode: int) -> FloatArray:
        """Where the mode leads a subspace of states."""
        return column_space(self.F[mode] @ basis)


def boundedness(system: StochasticSystem, dwell: int = 1) -> Boundedness:
    """Return whether the covariance stays bounded for all sequences that the chain allows with such stays.

    A sequence may begin in the middle of a stay.  Raises `UsageError` (DH1205) for a dwell time below one row.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> found = boundedness(calm_and_wild())
    >>> found.bounded, found.rows
    (True, 1)
    """
    if dwell < 1:
        raise UsageError(diagnostic("DH1205", f"a dwell time of {dwell} rows is none"))
    sight, n, modes = _Sight(system), len(system.x), range(len(system.modes))
    waiting = [_begun(sight.still_hidden(np.eye(n), mode), mode, dwell) for mode in reversed(modes)]
    longest, looked, open_cycle = 0, 0, Boundedness(dwell, True)
    while waiting:
        path = waiting.pop()
        looked += 1
        if path.hidden.shape[1] == 0:
            longest = max(longest, len(path.modes))
            continue
        if looked > MOST_SEQUENCES:
            return Boundedness(dwell, None)
        cycle = path.cycle()
        unseen = unseen_along(system, cycle)
        if unseen is not None:
            names = tuple(system.names[mode] for mode in cycle)
            open_cycle = Boundedness(dwell, None, None, names, unseen)
            if unseen > GROWING:
                return Boundedness(dwell, False, None, names, unseen)
            continue
        waiting.extend(_continued(system, sight, path, dwell))
    return open_cycle if open_cycle.bounded is None else Boundedness(dwell, True, longest)


def rows_that_show(system: StochasticSystem, modes: Sequence[int]) -> tuple[int | None, ...]:
    """Return, from each row of a given sequence of modes on, how many rows show the whole state; None: not by the end.

    The covariance stays bounded along a sequence, however long, in which these numbers do.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> rows_that_show(calm_and_wild(), [0, 1, 1])
    (1, 1, 1)
    """
    sight, found = _Sight(system), []
    for start, first in enumerate(modes):
        hidden, rows = sight.still_hidden(np.eye(len(system.x)), first), 1
        for mode in modes[start + 1 :]:
            if hidden.shape[1] == 0:
                break
            hidden, rows = sight.still_hidden(sight.moved(hidden, mode), mode), rows + 1
        found.append(rows if hidden.shape[1] == 0 else None)
    return tuple(found)


def unseen_along(system: StochasticSystem, cycle: Sequence[int]) -> float | None:
    """Return the largest eigenvalue (absolute) of what a repeated cycle of modes never shows; None where nothing lasts.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> unseen_along(calm_and_wild(), [0, 1]) is None
    True
    """
    if not cycle:
        return None
    flow, rows = np.eye(len(system.x)), []
    for mode in cycle:
        flow = system.bank.F[mode] @ flow
        rows.append(system.bank.H[mode] @ flow)
    hidden = np.abs(fixed_modes(flow, np.vstack(rows)))
    lasting = hidden[hidden > FADING]
    return float(lasting.max()) if lasting.size else None


def _begun(hidden: FloatArray, mode: int, age: int) -> _Path:
    return _Path((mode,), (age,), (hidden.shape[1],), hidden)


def _continued(system: StochasticSystem, sight: _Sight, path: _Path, dwell: int) -> list[_Path]:
    """The path with every mode that may come next, the last of them first."""
    last, age = path.modes[-1], path.ages[-1]
    allowed = np.flatnonzero(system.chain.probability_to_from[:, last] > 0.0).tolist()
    found = []
    for mode in reversed(allowed):
        if mode != last and age < dwell:
            continue
        hidden = sight.still_hidden(sight.moved(path.hidden, mode), mode)
        older = min(age + 1, dwell) if mode == last else 1
        found.append(_Path((*path.modes, mode), (*path.ages, older), (*path.dimensions, hidden.shape[1]), hidden))
    return found


__all__ = ["MOST_SEQUENCES", "Boundedness", "boundedness", "rows_that_show", "unseen_along"]
