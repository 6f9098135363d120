"""A filter as flat constants, and rows with the results of its reference step: what generated filters are made from.

In: a `StochasticSystem`, the method, a gate, a seed.  Out: `Constants` of the reference step, whose numbers are `float`
or `numpy.float32`, and recorded rows.  The rows are drawn from the system itself; some lack a measurement, some
hold one that is no number or far out, and now and then the filter is reset.

`count` reference steps.
"""

from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from deshybrid.emit.ctables import Real
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import stepwise
from deshybrid.stochastic.gating import PATIENCE, gate_limits
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.stepwise_values import Constants, Out, Room, State
from deshybrid.stochastic.system import StochasticSystem

FilterKind = Literal["imm", "mmae", "skf"]
_STEPS = {"imm": stepwise.imm, "mmae": stepwise.mmae}
LARGEST = 1e30
"""Beyond it a number is taken for no measurement, and an estimate for a runaway."""
_POWERS = {"double": 10, "float": 7}  # 2 ** 512 and 2 ** 64 are the last squares in range
_LEAST = {"double": -700.0, "float": -80.0}


def flat_constants(system: StochasticSystem, kind: FilterKind, real: Real, *, gate: float | None = None) -> Constants:
    """Return the numbers of a system in the order of the reference step; with a gate also its limits.

    Raises `UsageError`: DH1103 where the modes of an IMM or MMAE measure different outputs, DH1111 for a wrong gate.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> flat_constants(calm_and_wild(), "imm", "double").Q
    (0.1, 9.0)
    """
    require_fixed_noise(system.modes, "a generated filter")
    bank = system.bank if kind == "skf" else system.comparable_bank
    modes, p, n = bank.H.shape
    number = float if real == "double" else np.float32

    def flat(array: FloatArray) -> tuple[Any, ...]:
        return tuple(number(value) for value in array.ravel().tolist())

    limits: tuple[Any, Any] = (number(_LEAST[real]), number(LARGEST))
    matrices = {key: flat(getattr(bank, key)) for key in ("F", "Q", "B", "f", "H", "R", "D", "g")}
    return Constants(
        modes=modes,
        n=n,
        m=bank.B.shape[2],
        p=p,
        **matrices,
        measured=tuple(int(flag) for flag in bank.measured.ravel()),
        probability_to_from=flat(system.chain.probability_to_from),
        x=flat(system.x),
        P=flat(system.P),
        mu=flat(system.mu),
        powers=tuple(number(2.0 ** (2**i)) for i in range(_POWERS[real])),
        least=limits[0],
        largest=limits[1],
        limits=() if gate is None else (number(0.0), *(number(limit) for limit in gate_limits(p, gate)[1:].tolist())),
        patience=PATIENCE,
    )


def new_filter(c: Constants, kind: FilterKind) -> tuple[State, Room, Out]:
    """Return a started state, room to work in, and the place for what is told.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> new_filter(flat_constants(calm_and_wild(), "imm", "double"), "imm")[0].P
    [1.0, 1.0]
    """
    sizes = array_sizes(c, kind)
    state, room, out = State(*_zeros(sizes[State])), Room(*_zeros(sizes[Room])), Out(*_zeros(sizes[Out]))
    stepwise.start(c, state)
    return state, room, out


def _zeros(sizes: dict[str, int]) -> list[list[float]]:
    return [[0.0] * size for size in sizes.values()]


def array_sizes(c: Constants, kind: FilterKind) -> dict[type, dict[str, int]]:
    """Return the number of entries of every array of `State`, `Room` and `Out`.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> array_sizes(flat_constants(calm_and_wild(), "skf", "double"), "skf")[Out]
    {'x': 1, 'P': 1, 'told': 2}
    """
    n, p, slots = c.n, c.p, 1 if kind == "skf" else c.modes
    gaussians = {"x": slots * n, "P": slots * n * n}
    work = {"FP": n * n, "spread": n, "seen": p, "residual": slots * p, "S": slots * p * p}
    work |= {"L": p * p, "W": p * n, "e": p, "before": c.m}
    work |= {"distance": slots, "fit": slots, "weight": c.modes, "predicted": c.modes}
    return {
        State: {**gaussians, "mu": c.modes, "held": c.m, "started": 1, "count": 1},
        Room: {**gaussians, **work},
        Out: {"x": n, "P": n * n, "told": 2},
    }


@dataclass(frozen=True, slots=True)
class Row:
    """A row, whether the filter was reset before it, and what the reference step made of it."""

    u: tuple[float, ...]
    z: tuple[float, ...]
    mode: int
    reset: bool
    status: int
    x: tuple[float, ...]
    P: tuple[float, ...]
    mu: tuple[float, ...]
    told: tuple[float, ...]


def record_rows(
    system: StochasticSystem,
    kind: FilterKind,
    *,
    seed: int,
    count: int,
    real: Real = "double",
    reset_every: int = 0,
    gate: float | None = None,
) -> tuple[Row, ...]:
    """Return `count` rows with the results of the reference step, from its start on.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> len(record_rows(calm_and_wild(), "imm", seed=1, count=20))
    20
    """
    c = flat_constants(system, kind, real, gate=gate)
    number = float if real == "double" else np.float32
    state, room, out = new_filter(c, kind)
    rows = []
    with np.errstate(all="ignore"):
        for index, (u, z, mode) in enumerate(_drawn(system, seed, count)):
            reset = reset_every > 0 and index > 0 and index % reset_every == 0
            if reset:
                stepwise.start(c, state)
            given, measured = [number(value) for value in u], [number(value) for value in z]
            if kind == "skf":
                status = stepwise.known(c, state, room, out, given, measured, mode)
                mu = tuple(float(j == mode) for j in range(c.modes))
            else:
                status = _STEPS[kind](c, state, room, out, given, measured)
                mu = _floats(state.mu)
            told = (_floats(out.x), _floats(out.P), mu, _floats(out.told))
            rows.append(Row(_floats(given), _floats(measured), mode, reset, status, *told))
    return tuple(rows)


def _drawn(system: StochasticSystem, seed: int, count: int) -> list[tuple[list[float], list[float], int]]:
    """Rows of the system itself, in stretches of 40 that begin at the prior, with holes and absurd numbers."""
    rng = np.random.default_rng(seed)
    stretches = [sample(system, 40, seed=seed + first) for first in range(0, count, 40)]
    z = np.concatenate([runs.z for runs in stretches])[:count]
    modes = np.concatenate([runs.modes for runs in stretches])[:count]
    z[rng.random(z.shape) < 0.1] = np.nan
    z[rng.random(z.shape) < 0.02] = np.inf
    z[rng.random(z.shape) < 0.02] *= 1e3
    u = rng.uniform(-1.0, 1.0, (count, system.bank.B.shape[2]))
    u[rng.random(u.shape) < 0.02] = np.nan
    modes = np.where(rng.random(count) < 0.02, len(system.modes), modes)
    return list(zip(u.tolist(), z.tolist(), modes.tolist(), strict=True))


def _floats(values: list[Any]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


__all__ = ["LARGEST", "FilterKind", "Row", "array_sizes", "flat_constants", "new_filter", "record_rows"]
