"""Products and factors over trials beside numpy's own, matrix by matrix; and what their order in memory promises."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.stochastic import gaussian
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.lanes import cholesky, product, solve_lower, solve_upper, trials_last
from deshybrid.stochastic.multiple import predict_imm, update
from deshybrid.stochastic.sample import sample
from tests.strategies import random_stochastic_system

sizes = st.integers(1, 5)
trials = st.sampled_from([(), (3,), (40,), (2, 3), (0,)])


@given(
    lead=trials,
    modes=st.sampled_from([(), (2,)]),
    size=st.tuples(sizes, st.integers(0, 5), sizes),
    seed=st.integers(0, 999),
)
@settings(max_examples=60, deadline=None)
def test_product_is_the_product_of_every_trial_whichever_of_the_two_is_shared(lead, modes, size, seed):
    i, k, j = size
    rng = np.random.default_rng(seed)
    A, B = rng.standard_normal((*lead, *modes, i, k)), rng.standard_normal((*lead, *modes, k, j))
    shared_A, shared_B = rng.standard_normal((*modes, i, k)), rng.standard_normal((*modes, k, j))
    for left, right in ((A, B), (shared_A, B), (A, shared_B)):
        for order in (lambda array: array, lambda array: trials_last(array, 2 + len(modes))):
            np.testing.assert_allclose(product(order(left), order(right)), left @ right, atol=1e-13)


@given(lead=trials, p=sizes, j=sizes, seed=st.integers(0, 999))
@settings(max_examples=40, deadline=None)
def test_factor_and_solutions_are_those_of_numpy(lead, p, j, seed):
    rng = np.random.default_rng(seed)
    root, B = rng.standard_normal((*lead, p, p)), rng.standard_normal((*lead, p, j))
    S = root @ root.swapaxes(-1, -2) + np.eye(p)
    L = cholesky(trials_last(S, 2))
    np.testing.assert_allclose(L, np.linalg.cholesky(S), atol=1e-12)
    np.testing.assert_allclose(solve_lower(L, trials_last(B, 2)), np.linalg.solve(L, B), atol=1e-12)
    np.testing.assert_allclose(solve_upper(L, B), np.linalg.solve(L.swapaxes(-1, -2), B), atol=1e-12)


def test_the_factor_of_an_indefinite_matrix_is_not_a_number_and_its_neighbours_are_untouched():
    S = np.array([[[1.0, 2.0], [2.0, 1.0]], [[4.0, 0.0], [0.0, 9.0]]])
    with np.errstate(invalid="ignore"):
        L = cholesky(S)
    assert np.isnan(L[0]).any()
    np.testing.assert_array_equal(L[1], np.diag([2.0, 3.0]))


def test_a_filter_keeps_its_trials_last_in_memory():
    """What makes it fast: a step that lost the order would be right, and slow for good."""
    system = random_stochastic_system(np.random.default_rng(1), plain=True)
    z = trials_last(sample(system, 2, seed=1, trials=(50,)).z[:, 0], 1)
    belief = update(system, predict_imm(system, Belief.prior(system, (50,))), z).belief
    for array in (belief.x, belief.P, belief.log_mu):
        assert array.strides[0] == array.itemsize


@pytest.mark.parametrize("method", ["predict", "update"])
def test_covariances_are_symmetric_to_the_last_bit(method):
    rng = np.random.default_rng(2)
    root, F, H = rng.standard_normal((30, 5, 5)), rng.standard_normal((5, 5)), rng.standard_normal((2, 5))
    P, x = root @ root.swapaxes(-1, -2), np.zeros((30, 5))
    P = 0.5 * (P + P.swapaxes(-1, -2))
    if method == "predict":
        made = gaussian.predict(x, P, F, np.eye(5), np.zeros(5))[1]
    else:
        made = gaussian.update(x, P, rng.standard_normal((30, 2)), H, np.eye(2)).P
    np.testing.assert_array_equal(made, made.swapaxes(-1, -2))
