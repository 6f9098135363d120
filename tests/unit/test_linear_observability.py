"""Observability of one location, against exact ranks over the rational numbers."""

from fractions import Fraction

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from deshybrid.linear.observability import fixed_modes, is_observable, kalman_split, observability_matrix
from deshybrid.linear.sampling import sample_dynamics, sample_gain
from tests.exact_ranks import rank
from tests.switched import driveline, linear


def random_pair(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    n, p = int(rng.integers(1, 6)), int(rng.integers(1, 3))
    A = rng.integers(-3, 4, (n, n)) * (rng.random((n, n)) < rng.choice([0.3, 0.6, 1.0]))
    C = rng.integers(-2, 3, (p, n)) * (rng.random((p, n)) < rng.choice([0.3, 1.0]))
    return A.astype(float), C.astype(float)


def exact_rank_of_observability(A: np.ndarray, C: np.ndarray) -> int:
    return rank([[Fraction(int(value)) for value in row] for row in observability_matrix(A, C)])


def test_the_observable_dimension_is_the_exact_rank_of_the_observability_matrix() -> None:
    rng = np.random.default_rng(1)
    seen = set()
    for _ in range(300):
        A, C = random_pair(rng)
        expected = exact_rank_of_observability(A, C)
        assert kalman_split(A, C).observable_dimension == expected
        assert is_observable(A, C) == (expected == len(A))
        seen.add(expected == len(A))
    assert seen == {True, False}


def test_units_of_states_outputs_and_time_do_not_change_the_verdict() -> None:
    rng = np.random.default_rng(2)
    for _ in range(100):
        A, C = random_pair(rng)
        units, rows = 10.0 ** rng.integers(-6, 7, len(A)), 10.0 ** rng.integers(-4, 5, len(C))
        expected = kalman_split(A, C).observable_dimension
        changed = kalman_split(1e3 * A * units / units[:, None], C * units * rows[:, None])
        assert changed.observable_dimension == expected


def test_the_split_rebuilds_both_matrices_with_nothing_seen_of_the_hidden_part() -> None:
    rng = np.random.default_rng(3)
    for _ in range(50):
        A, C = random_pair(rng)
        split = kalman_split(A, C)
        k = split.observable_dimension
        inside = np.block([[split.A_o, np.zeros((k, len(A) - k))], [split.coupling, split.A_u]])
        np.testing.assert_allclose(split.transform @ inside @ split.inverse, A, atol=1e-9)
        seen = np.hstack([split.C_o, np.zeros((len(C), len(A) - k))])
        np.testing.assert_allclose(seen @ split.inverse, C, atol=1e-9)


def test_fixed_modes_stay_eigenvalues_of_the_closed_loop_for_every_gain() -> None:
    rng = np.random.default_rng(4)
    found = 0
    for _ in range(100):
        A, C = random_pair(rng)
        if np.linalg.matrix_rank(np.linalg.eig(A)[1]) < len(A):
            continue
        gain = rng.normal(size=(len(A), len(C)))
        loop = np.linalg.eigvals(A - gain @ C)
        for mode in fixed_modes(A, C):
            assert np.abs(loop - mode).min() < 1e-4
            found += 1
    assert found > 20


def test_the_torsion_of_an_open_driveline_is_a_fixed_mode_and_that_of_a_closed_one_is_not() -> None:
    system = driveline()
    places = {location.name: location.dynamics for location in system.locations}
    assert fixed_modes(places["qN"].A, places["qN"].C) == pytest.approx([-5.0])
    assert is_observable(places["q1"].A, places["q1"].C)


def test_a_location_without_outputs_keeps_all_its_modes() -> None:
    assert fixed_modes(np.diag([-1.0, -2.0]), np.zeros((0, 2))).tolist() == [-1.0, -2.0]


@pytest.mark.parametrize("A", [[[0.0, 1.0], [0.0, 0.0]], [[0.0, 1.0], [-9.0, -0.5]], [[0.0, 0.0], [0.0, 0.0]]])
def test_sampling_equals_the_integral_of_its_definition(A: list[list[float]]) -> None:
    dynamics = linear(A, [[1, 0]], B=[[0], [2]], E=[[1], [0]], f=[0.5, -1], g=[3])
    h = 0.3
    sampled = sample_dynamics(dynamics, h)
    integral = quad_vec(lambda s: expm(np.array(A) * s), 0, h, epsabs=1e-12)[0]
    np.testing.assert_allclose(sampled.A, expm(np.array(A) * h), atol=1e-12)
    np.testing.assert_allclose(sampled.B, integral @ dynamics.B, atol=1e-12)
    np.testing.assert_allclose(sampled.E, integral @ dynamics.E, atol=1e-12)
    np.testing.assert_allclose(sampled.f, integral @ dynamics.f, atol=1e-12)
    assert sampled.C is dynamics.C
    assert sampled.g is dynamics.g


def test_the_sampled_gain_equals_the_integral_of_its_definition() -> None:
    dynamics = linear([[0, 1], [-4, -1]], [[1, 0]])
    gain = np.array([[3.0], [5000.0]])
    integral = quad_vec(lambda s: expm((dynamics.A - gain @ dynamics.C) * s), 0, 0.02, epsabs=1e-13)[0]
    np.testing.assert_allclose(sample_gain(dynamics, gain, 0.02), integral @ gain, rtol=1e-9)
