"""The values of `deshybrid.stochastic`: what is refused at birth, and numbers that are known by heart."""

import numpy as np
import pytest
from scipy.integrate import quad_vec
from scipy.linalg import expm

from deshybrid.diagnostics import UsageError
from deshybrid.linear.sampling import sample_covariance
from deshybrid.stochastic.examples import calm_and_wild
from deshybrid.stochastic.record import estimate, estimate_known
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.score import Consistency, Switch, nees, switches
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem

SCALAR = {"F": [[1.0]], "H": [[1.0]], "Q": [[0.1]], "R": [[1.0]]}


def code(caught) -> str:
    (diagnostic,) = caught.value.diagnostics
    return diagnostic.code


def test_row_stochastic_mode_matrix_is_refused_with_a_hint_about_transposition():
    with pytest.raises(UsageError) as caught:
        ModeTransition(("a", "b"), [[0.9, 0.1], [0.2, 0.8]])
    assert code(caught) == "DH1102"
    assert "transpose" in caught.value.diagnostics[0].helps[0]


def test_a_matrix_that_is_stochastic_in_neither_direction_gets_no_such_hint():
    with pytest.raises(UsageError) as caught:
        ModeTransition(("a", "b"), [[0.9, 0.3], [0.2, 0.8]])
    assert "transpose" not in caught.value.diagnostics[0].helps[0]


def test_a_negative_probability_is_refused():
    with pytest.raises(UsageError) as caught:
        ModeTransition(("a", "b"), [[1.5, 0.5], [-0.5, 0.5]])
    assert code(caught) == "DH1102"


@pytest.mark.parametrize(
    ("key", "value"),
    [("F", [[1.0, 2.0]]), ("H", [[1.0, 0.0]]), ("Q", [[-1.0]]), ("R", [[np.nan]]), ("B", [[1.0], [1.0]]),
     ("f", [1.0, 2.0]), ("F", [[1.0], [1.0, 2.0]]), ("B", 1.0), ("output_index", (0, 1)), ("Q", "noise")],
)  # fmt: skip
def test_a_matrix_that_does_not_fit_its_mode_is_refused(key, value):
    with pytest.raises(UsageError) as caught:
        Mode("m", **(SCALAR | {key: value}))
    assert code(caught) == "DH1104"


def test_modes_with_different_numbers_of_states_are_refused():
    two = Mode("two", F=np.eye(2), H=[[1.0, 0.0]], Q=np.eye(2), R=[[1.0]])
    chain = ModeTransition(("one", "two"), np.eye(2))
    with pytest.raises(UsageError) as caught:
        StochasticSystem([Mode("one", **SCALAR), two], chain, x=[0.0], P=[[1.0]], mu=[1.0, 0.0])
    assert code(caught) == "DH1104"


def test_a_chain_over_other_modes_is_refused():
    with pytest.raises(UsageError) as caught:
        StochasticSystem([Mode("a", **SCALAR)], ModeTransition(("b",), [[1.0]]), x=[0.0], P=[[1.0]], mu=[1.0])
    assert code(caught) == "DH1104"


def test_a_prior_probability_that_does_not_sum_to_one_is_refused():
    system = calm_and_wild()
    with pytest.raises(UsageError) as caught:
        StochasticSystem(system.modes, system.chain, x=[0.0], P=[[1.0]], mu=[0.5, 0.6])
    assert code(caught) == "DH1102"


@pytest.mark.parametrize("z", [np.zeros(3), np.zeros((3, 2)), np.full((3, 1), np.inf)])
def test_measurements_of_another_shape_or_without_bound_are_refused(z):
    with pytest.raises(UsageError) as caught:
        estimate(calm_and_wild(), z)
    assert code(caught) == "DH1107"


@pytest.mark.parametrize("modes", [[0, 1], [0, 1, 2], [0.0, 1.0, 1.0], [0, -1, 0]])
def test_known_modes_that_do_not_fit_are_refused(modes):
    with pytest.raises(UsageError) as caught:
        estimate_known(calm_and_wild(), np.zeros((3, 1)), modes)
    assert code(caught) == "DH1107"


def test_inputs_that_are_missing_are_refused():
    mode = Mode("m", **SCALAR, B=[[1.0]])
    system = StochasticSystem([mode], ModeTransition(("m",), [[1.0]]), x=[0.0], P=[[1.0]], mu=[1.0])
    with pytest.raises(UsageError) as caught:
        estimate(system, np.zeros((3, 1)))
    assert code(caught) == "DH1107"


def test_arrays_of_values_are_copies_that_cannot_be_written():
    F = np.eye(1)
    mode = Mode("m", **(SCALAR | {"F": F}))
    F[0, 0] = 7.0
    assert mode.F[0, 0] == 1.0
    made = estimate(calm_and_wild(), np.zeros((3, 1)))
    for array in (mode.F, calm_and_wild().bank.F, made.x, made.mu, sample(calm_and_wild(), 3, seed=0).z):
        with pytest.raises(ValueError, match="read-only"):
            array[...] = 0


def test_the_same_seed_draws_the_same_numbers():
    first, second = (sample(calm_and_wild(), 20, seed=9, trials=(3,)) for _ in range(2))
    np.testing.assert_array_equal(first.z, second.z)


@pytest.mark.parametrize(
    "A", [np.zeros((2, 2)), [[0.0, 1.0], [0.0, 0.0]], [[-500.0, 3.0], [1.0, -0.1]], [[1.0, 2.0], [-2.0, 1.0]]]
)
def test_sampled_noise_is_the_integral_that_defines_it(A):
    A, W, step = np.asarray(A), np.array([[2.0, 0.3], [0.3, 0.5]]), 0.7
    integral = quad_vec(lambda s: expm(A * s) @ W @ expm(A.T * s), 0.0, step, epsabs=1e-12, epsrel=1e-11)[0]
    np.testing.assert_allclose(sample_covariance(A, W, step), integral, rtol=1e-8, atol=1e-10)


def test_noise_of_a_very_fast_mode_over_a_long_step_settles_at_its_stationary_value():
    """e^{-A h} overflows here: 1e5 times 10 s."""
    assert sample_covariance(np.array([[-1e5]]), np.ones((1, 1)), 10.0)[0, 0] == pytest.approx(0.5e-5, rel=1e-12)


def test_delays_count_the_row_of_the_switch_as_one():
    assert switches("aabbb", "aabbb") == (Switch(2, "b", 1),)
    assert switches("aabba", "aaaab") == (Switch(2, "b", None), Switch(4, "a", None))
    assert switches(["a", None, "b"], "aab") == ()


def test_band_of_a_sum_of_squares_is_that_of_the_chi_square_table():
    low, high = Consistency(10.0, 10).band
    assert (round(low, 3), round(high, 3)) == (3.247, 20.483)
    assert not Consistency(20.5, 10).holds


def test_nees_of_a_singular_covariance_is_not_a_number():
    assert np.isnan(nees([1.0, 1.0], [[1.0, 0.0], [0.0, 0.0]]))
    assert nees([1.0, 2.0], np.diag([1.0, 4.0])) == pytest.approx(2.0)


def test_noise_that_an_unstable_mode_blows_up_beyond_all_numbers_is_refused():
    """e^{500} has a number, its square has none."""
    with pytest.raises(UsageError) as caught:
        sample_covariance(np.array([[500.0]]), np.ones((1, 1)), 1.0)
    assert code(caught) == "DH0514"
