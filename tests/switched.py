"""Small hybrid systems for the tests of the continuous half, built from matrices."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import (
    AffineReset,
    Bounds,
    HybridSystem,
    HybridTransition,
    Location,
    ObserverOptions,
)

Arc = tuple[str, str, ArrayLike | None]
"""From, to, reset matrix (None = identity without offset)."""


def linear(
    A: ArrayLike,
    C: ArrayLike,
    *,
    B: ArrayLike | None = None,
    D: ArrayLike | None = None,
    E: ArrayLike | None = None,
    f: ArrayLike | None = None,
    g: ArrayLike | None = None,
) -> LinearDynamics:
    """Linear dynamics with everything not given empty or zero."""
    A, C = np.array(A, dtype=float), np.array(C, dtype=float)
    n, p = len(A), len(C)
    B = np.zeros((n, 0)) if B is None else np.array(B, dtype=float)
    E = np.zeros((n, 0)) if E is None else np.array(E, dtype=float)
    m = B.shape[1]
    D = np.zeros((p, m)) if D is None else np.array(D, dtype=float)
    return LinearDynamics(
        frozen_array(A, (n, n)),
        frozen_array(B, (n, m)),
        frozen_array(C, (p, n)),
        frozen_array(D, (p, m)),
        frozen_array(E, E.shape),
        frozen_array(np.zeros(n) if f is None else f, (n,)),
        frozen_array(np.zeros(p) if g is None else g, (p,)),
    )


def switched(
    locations: dict[str, LinearDynamics],
    arcs: Sequence[Arc],
    *,
    offsets: dict[tuple[str, str], ArrayLike] | None = None,
    step: float | None = None,
    bounds: Bounds | None = None,
    observer: ObserverOptions | None = None,
) -> HybridSystem:
    """A hybrid system of these locations; every transition is observable."""
    first = next(iter(locations.values()))
    n, m, r = len(first.A), first.B.shape[1], first.E.shape[1]
    p = max(len(dynamics.C) for dynamics in locations.values())
    places = tuple(
        Location(name, d, input_index=tuple(range(m)), output_index=tuple(range(len(d.C))))
        for name, d in locations.items()
    )
    moved = offsets or {}
    transitions = tuple(
        HybridTransition(
            source,
            f"{source}{target}",
            target,
            (f"{source}{target}",),
            reset=AffineReset(
                frozen_array(np.eye(n) if matrix is None else matrix, (n, n)),
                frozen_array(moved.get((source, target), np.zeros(n)), (n,)),
            ),
        )
        for source, target, matrix in arcs
    )
    return HybridSystem(
        "switched",
        places,
        transitions,
        tuple(locations),
        tuple(f"x{k}" for k in range(n)),
        tuple(f"u{k}" for k in range(m)),
        tuple(f"y{k}" for k in range(p)),
        tuple(f"w{k}" for k in range(r)),
        time_step=step,
        bounds=bounds or Bounds(),
        observer=observer or ObserverOptions(),
    )


def vector(*values: float) -> FloatArray:
    """A read-only vector."""
    return frozen_array(values, (len(values),))


def twin(*, observer: ObserverOptions | None = None, bounds: Bounds | None = None) -> HybridSystem:
    """Two oscillators of one position measurement each, with a reset that stretches the velocity."""
    return switched(
        {
            "p": linear([[0, 1], [-4, -1]], [[1, 0]], B=[[0], [1]], E=[[0], [1]]),
            "q": linear([[0, 1], [-9, -1]], [[1, 0]], B=[[0], [1]], E=[[0], [1]]),
        },
        [("p", "q", [[1, 0], [0, 1.5]]), ("q", "p", None)],
        observer=observer,
        bounds=bounds,
    )


def driveline(*, observer: ObserverOptions | None = None, bounds: Bounds | None = None) -> HybridSystem:
    """Balluchi et al. (2012), section 5, with two gears and an open clutch: torsion (rad) beside speeds (rad/s)."""
    je, jw, be, bw = 0.2, 8.0, 0.02, 0.2
    places = {}
    for name, tau in (("q1", 0.075), ("q4", 0.26)):
        k, b = 9000 * tau**2, 20 * tau**2
        A = [
            [0, 1, -1 / tau],
            [-k / je, -(be + b) / je, b / tau / je],
            [k / tau / jw, b / tau / jw, -(bw + b / tau**2) / jw],
        ]
        places[name] = linear(A, [[0, 1, 0], [0, 0, 1]], B=[[0], [1 / je], [0]], E=[[0], [0], [1 / jw]])
    open_clutch = [[-5, 0, 0], [0, -be / je, 0], [0, 0, -bw / jw]]
    places["qN"] = linear(open_clutch, [[0, 1, 0], [0, 0, 1]], B=[[0], [1 / je], [0]], E=[[0], [0], [1 / jw]])
    arcs: list[Arc] = [("q1", "qN", None), ("q4", "qN", None), ("qN", "q1", None), ("qN", "q4", None)]
    limits = bounds or Bounds(state=vector(0.5, 600, 100))
    return switched(places, arcs, observer=observer, bounds=limits)
