"""IMM and the Kalman filter beside FilterPy, an independent library, on 200 random systems.

FilterPy keeps rows [from, to] where we keep columns [to, from]: it is given the transpose.  Its prior is mixed with the
probabilities of the row before, so that only posteriors are compared.
"""

import numpy as np
import pytest

from deshybrid.stochastic.record import estimate
from tests.strategies import random_stochastic_system

kalman = pytest.importorskip("filterpy.kalman", reason="FilterPy is not installed")
ROWS = 30


def filterpy_imm(system, z):
    """FilterPy's µ, x, P after every row."""
    filters = []
    for mode in system.modes:
        one = kalman.KalmanFilter(dim_x=len(system.x), dim_z=len(mode.g))
        one.F, one.H, one.Q, one.R = mode.F, mode.H, mode.Q, mode.R
        one.x, one.P = system.x[:, None].copy(), system.P.copy()
        filters.append(one)
    imm = kalman.IMMEstimator(filters, system.mu, system.chain.probability_to_from.T)
    found = []
    for row in z:
        imm.predict()
        imm.update(row)
        found.append((imm.mu.copy(), imm.x[:, 0].copy(), imm.P.copy()))
    return [np.stack(column) for column in zip(*found, strict=True)]


def test_imm_agrees_with_filterpy_on_200_random_systems_with_asymmetric_chains():
    for seed in range(200):
        rng = np.random.default_rng(seed)
        system = random_stochastic_system(rng, plain=True)
        Pi = system.chain.probability_to_from
        assert np.abs(Pi - Pi.T).max() > 1e-3
        z = 3.0 * rng.standard_normal((ROWS, len(system.modes[0].g)))
        ours, (mu, x, P) = estimate(system, z), filterpy_imm(system, z)
        scale = max(1.0, np.abs(P).max(), np.abs(x).max())
        np.testing.assert_allclose(ours.mu, mu, rtol=0.0, atol=1e-10)
        np.testing.assert_allclose(ours.x, x, rtol=0.0, atol=1e-10 * scale)
        np.testing.assert_allclose(ours.P, P, rtol=0.0, atol=1e-10 * scale)


def test_filterpy_given_the_matrix_as_it_is_disagrees():
    """The comparison above would notice a mistaken orientation."""
    rng = np.random.default_rng(5)
    system = random_stochastic_system(rng, plain=True)
    z = 3.0 * rng.standard_normal((ROWS, len(system.modes[0].g)))
    mu = filterpy_imm(system, z)[0]
    rows = system.chain.probability_to_from
    flipped = type(system.chain)(system.names, (rows / rows.sum(axis=1, keepdims=True)).T)
    other = type(system)(system.modes, flipped, x=system.x, P=system.P, mu=system.mu)
    assert np.abs(estimate(other, z).mu - mu).max() > 1e-3
