"""A bound of the error state by state, without norms.

In: per location g_j (the forced error), the modes of F_j, and what its exits cost.  Out: one bound per state, or
None.  The idea: v_j bounds |ζ| at the entry of j.  A stay of at least β turns it into at most Z_j v_j + g_j, Z_j >=
|e^{F_j t}| for t >= β, and the exit to i into |R¹_ji| (Z_j v_j + g_j) + kick; so every v with

    v_i >= |R¹_ji| (Z_j v_j + g_j) + kick_ji   for all transitions j -> i

bounds the error that started from zero.  Iteration from zero finds the least one, a little is added, and the
inequality is then checked, up to rounding.  Between switches the error is at most P_j v_j + g_j + shown, P_j >=
|e^{F_j t}| for t >= 0; kick and shown are what a delay adds.  The initial error adds a part that decays at the
certified rate.  At most 2,000 rounds of O(transitions · n²).

Source: this project, from (28)-(29) of Balluchi et al. (2012) with entries in place of norms.
"""

from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from deshybrid.continuous.impulse import peak_norm
from deshybrid.continuous.mismatch import Mismatch
from deshybrid.continuous.modes import ModalBasis
from deshybrid.linear.arrays import FloatArray

MOST_ROUNDS = 2_000
SETTLED = 1e-9
ROOM = 1e-6
DIVERGED = 1e100
"""An entry level beyond this grows for ever; nothing settles there."""


class Stay(NamedTuple):
    """One location: forced = g_j (n,), the modes of F_j, and what its exits cost."""

    forced: FloatArray
    modes: ModalBasis
    exits: tuple[Mismatch, ...]


def entrywise_bound(stays: Mapping[str, Stay], beta: float, step: float | None) -> FloatArray | None:
    """Return a bound (n,) of |ζ|, for stays of at least `beta` seconds; None where the iteration does not settle."""
    kicks = {n: [exit.most()[0] for exit in s.exits] for n, s in stays.items()}
    after = {n: peak_norm(s.modes.eigenvalues, s.modes.basis, start=beta, step=step) for n, s in stays.items()}
    entry = {name: np.zeros(len(stay.forced)) for name, stay in stays.items()}
    for _ in range(MOST_ROUNDS):
        longer = _one_switch(stays, kicks, after, entry)
        if max((level.max(initial=0.0) for level in longer.values()), default=0.0) > DIVERGED:
            return None
        settled = all((longer[name] <= entry[name] * (1 + SETTLED)).all() for name in stays)
        entry = longer
        if settled:
            break
    entry = {name: level * (1 + ROOM) for name, level in entry.items()}
    longer = _one_switch(stays, kicks, after, entry)
    if not all((longer[name] <= entry[name] * (1 + SETTLED)).all() for name in stays):
        return None
    peaks = []
    for name, stay in stays.items():
        during = peak_norm(stay.modes.eigenvalues, stay.modes.basis, step=step)
        here = during @ entry[name] + stay.forced
        peaks += [here, *(here + exit.most()[1] for exit in stay.exits)]
    return np.asarray(np.max(peaks, axis=0)) if peaks else None


def _one_switch(
    stays: Mapping[str, Stay],
    kicks: Mapping[str, list[FloatArray]],
    after: Mapping[str, FloatArray],
    entry: Mapping[str, FloatArray],
) -> dict[str, FloatArray]:
    """The entry levels that follow from given ones, at least those themselves."""
    longer = {name: level.copy() for name, level in entry.items()}
    for name, stay in stays.items():
        left = after[name] @ entry[name] + stay.forced
        for exit, kick in zip(stay.exits, kicks[name], strict=True):
            pushed = np.abs(exit.reset) @ left + kick
            longer[exit.target] = np.maximum(longer[exit.target], pushed)
    return longer


__all__ = ["Stay", "entrywise_bound"]
