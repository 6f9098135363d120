"""Rows without any measurement: every engine beside a naive filter that skips the update, row by row."""

import importlib.util

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.emit.filter_vectors import flat_constants, new_filter
from deshybrid.stochastic import stepwise
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.multiple import predict_imm, update
from deshybrid.stochastic.record import estimate, estimate_known, rows_of
from tests.naive_filters import kalman_predict, kalman_update, skipping_imm
from tests.strategies import random_stochastic_system

needs_numba = pytest.mark.skipif(importlib.util.find_spec("numba") is None, reason="numba is not installed")


def streamed(system, z, u):
    belief, found = Belief.prior(system), []
    for row, before, now in rows_of(system, z, u):
        posterior = update(system, predict_imm(system, belief, before), row, now)
        belief = posterior.belief
        found.append((belief.mean, belief.covariance, belief.mu, posterior.log_likelihood))
    return [np.array(column) for column in zip(*found, strict=True)]


def generated(system, z, u):
    """The reference step of generated code, which C and Python equal bit for bit."""
    c = flat_constants(system, "imm", "double")
    state, room, out = new_filter(c, "imm")
    found, n = [], len(system.x)
    for row, pushed in zip(z, u, strict=True):
        stepwise.imm(c, state, room, out, pushed.tolist(), row.tolist())
        found.append((np.array(out.x), np.reshape(out.P, (n, n)), np.array(state.mu), out.told[0]))
    return [np.array(column) for column in zip(*found, strict=True)]


def batched(engine):
    def work(system, z, u):
        """Two trials at once, of which the other has no holes."""
        full = np.where(np.isnan(z), 0.5, z)
        made = estimate(system, np.stack([full, z]), np.stack([u, u]), engine=engine)
        return [getattr(made, name)[1] for name in ("x", "P", "mu", "log_likelihood")]

    return work


@pytest.mark.parametrize(
    "engine",
    [
        pytest.param(batched("numpy"), id="numpy"),
        pytest.param(batched("roots"), id="roots"),
        pytest.param(batched("numba"), id="numba", marks=needs_numba),
        pytest.param(streamed, id="streaming"),
        pytest.param(generated, id="generated"),
    ],
)
@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_a_missing_row_is_a_time_update_and_nothing_else(engine, seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    z = 3.0 * rng.standard_normal((12, system.bank.H.shape[1]))
    missing = rng.random(12) < 0.5
    z[missing] = np.nan
    u = rng.standard_normal((12, system.bank.B.shape[2]))
    expected = skipping_imm(system, [None if gone else row for gone, row in zip(missing, z, strict=True)], u)[:4]
    for name, ours, wanted in zip(("x", "P", "mu", "log_likelihood"), engine(system, z, u), expected, strict=True):
        np.testing.assert_allclose(ours, wanted, rtol=0, atol=1e-8 * max(1.0, np.abs(wanted).max()), err_msg=name)


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=12, deadline=None)
def test_a_missing_row_of_a_known_mode_is_a_time_update_and_nothing_else(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    z = 3.0 * rng.standard_normal((12, system.bank.H.shape[1]))
    z[rng.random(12) < 0.5] = np.nan
    u, modes = rng.standard_normal((12, system.bank.B.shape[2])), rng.integers(0, len(system.modes), 12)
    made = estimate_known(system, z, modes, u)
    x, P = system.x, system.P
    for k, number in enumerate(modes):
        x, P = kalman_predict(system.modes[number], x, P, u[max(k - 1, 0)])
        if not np.isnan(z[k]).any():
            x, P, _ = kalman_update(system.modes[number], x, P, z[k], u[k])
        np.testing.assert_allclose(made.x[k], x, rtol=0, atol=1e-8 * max(1.0, np.abs(x).max()))
        np.testing.assert_allclose(made.P[k], P, rtol=0, atol=1e-8 * max(1.0, np.abs(P).max()))
