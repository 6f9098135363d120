"""Theorem 4 in its proven form against brute force: its bound is one, also for repeated and complex hidden modes."""

from functools import cache
from itertools import product

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import block_diag, expm
from switched import linear, switched

from deshybrid.continuous.determinability import Determinability
from deshybrid.continuous.determinability_contraction import Box, certify_box
from deshybrid.continuous.determinability_coordinates import hidden_projection
from deshybrid.continuous.determinability_design import theorem_4
from deshybrid.continuous.determinability_solver import solve_inequalities
from deshybrid.continuous.error import ErrorDynamics, ErrorReset, error_dynamics
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.load import load
from deshybrid.model.system import HybridSystem

STAYS = (0.5, 1.5)
HIDDEN = {
    "distinct": np.diag([0.05, -0.02]),
    "repeated": 0.03 * np.eye(2),
    "defective": np.array([[0.02, 0.05], [0.0, 0.02]]),
    "complex": np.array([[0.01, 0.06], [-0.06, 0.01]]),
}
"""Dynamics of the two hidden states of each location."""


def turning_pair(hidden: FloatArray, coupling: FloatArray) -> tuple[HybridSystem, dict[str, FloatArray]]:
    """Two locations of four states: what one hides (the last two), the reset carries to what the other shows."""
    A = block_diag(np.array([[0.0, 1.0], [-2.0, -1.0]]), hidden)
    A[2:, :2] = coupling
    C = [[1, 0, 0, 0], [0, 1, 0, 0]]
    swap = np.eye(4)[[2, 3, 0, 1]]
    system = switched({"p": linear(A, C), "q": linear(A, C)}, [("p", "q", swap), ("q", "p", None)])
    gain = np.vstack([A[:2, :2] + np.diag([30.0, 40.0]), np.zeros((2, 2))])
    return system, {"p": gain, "q": gain}


@pytest.mark.parametrize("kind", HIDDEN)
def test_proven_speed_condition_bounds_the_cycle_map_over_all_stays(kind: str) -> None:
    system, gains = turning_pair(HIDDEN[kind], 0.1 * np.ones((2, 2)))
    found = theorem_4(system, ("p", "q"), gains, {"p": STAYS, "q": STAYS})
    assert found is not None
    assert found.speed is not None
    assert found.start.location == "p"
    assert found.start.condition_16
    assert found.speed.holds
    dynamics = error_dynamics(system, gains)
    jumps = {reset.source: reset.matrix for reset in dynamics.resets}
    grid = np.linspace(*STAYS, 11)
    E = {name: [jumps[name] @ expm(t * dynamics.matrices[name]) for t in grid] for name in ("p", "q")}
    worst = max(np.linalg.norm(second @ first, 2) for first, second in product(E["p"], E["q"]))
    assert worst <= found.speed.cycle_bound


@cache
def example() -> tuple[Determinability, dict[str, FloatArray], dict[str, FloatArray]]:
    """Theorem 4 of the printed example, A and the projection onto what is hidden, by location."""
    system, plants, projections = load("models/balluchi2003/three_locations.yaml"), {}, {}
    found = theorem_4(system, ("q1", "q2", "q3"))
    assert found is not None
    for name in found.cycle:
        dynamics = system.location(name).dynamics
        assert dynamics is not None
        exact = hidden_projection(dynamics.A, dynamics.C)
        plants[name], projections[name] = dynamics.A, np.array([[float(value) for value in row] for row in exact])
    return found, plants, projections


@pytest.mark.parametrize("start", ["q1", "q3"])
@given(st.lists(st.floats(0.01, 1.0), min_size=3, max_size=3))
@settings(max_examples=30)
def test_proven_bound_of_stays_bounds_what_a_round_leaves_unseen(start: str, shares: list[float]) -> None:
    """R_N [(1 + δ)^S - 1] bounds ‖M_{N...N}‖ of (27), and is 1 where every stay is `max_sojourn_proven`."""
    found, plants, projections = example()
    entry = next(entry for entry in found.starts if entry.location == start)
    k = found.cycle.index(start)
    unseen = np.eye(4)
    for name, share in zip(found.cycle[k:] + found.cycle[:k], shares, strict=True):
        unseen = expm(share * entry.max_sojourn_proven * plants[name]) @ projections[name] @ unseen
    drift = np.expm1(0.01 * max(shares) * entry.max_sojourn_proven)
    assert np.linalg.norm(unseen, 2) <= entry.R_N * ((1 + drift) ** 3 - 1)
    assert np.linalg.norm(unseen, 2) <= 1.0


def test_every_theorem_4_that_holds_is_certified_by_the_sharper_test() -> None:
    for kind, matrix in HIDDEN.items():
        system, gains = turning_pair(matrix, 0.1 * np.ones((2, 2)))
        stays = {"p": STAYS, "q": STAYS}
        found = theorem_4(system, ("p", "q"), gains, stays)
        assert found is not None
        assert found.speed is not None
        assert found.speed.holds, kind
        assert certify_box(error_dynamics(system, gains), stays, np.ones(4)).holds, kind


def hard_triangle() -> ErrorDynamics:
    """Three planes with all six switches, for which the sum of images finds no P."""
    rng = np.random.default_rng(14)
    names = ("p", "q", "r")
    matrices = {name: 0.6 * rng.standard_normal((2, 2)) for name in names}
    resets = tuple(
        ErrorReset(a, b, 0.45 * rng.standard_normal((2, 2)), np.zeros(2)) for a in names for b in names if a != b
    )
    return ErrorDynamics(names, matrices, resets)


def test_matrix_inequalities_certify_where_the_sum_of_images_does_not(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("clarabel")
    dynamics, stays = hard_triangle(), dict.fromkeys("pqr", (0.2, 1.5))
    assert certify_box(dynamics, stays, np.ones(2)).holds
    monkeypatch.setattr("deshybrid.continuous.determinability_solver.find_spec", lambda name: None)
    refused = certify_box(dynamics, stays, np.ones(2))
    assert not refused.holds
    assert refused.reason.startswith("no certificate was found")
    box = Box(dynamics, stays)
    assert solve_inequalities(dynamics, {name: [box.flow(name, 0.2)] for name in "pqr"}, np.ones(2)) is None
