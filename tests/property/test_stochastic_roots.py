"""The filter on square roots beside the one on covariances, and beside exact arithmetic where digits run out."""

from fractions import Fraction

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.diagnostics import UsageError
from deshybrid.stochastic.examples import calm_and_wild
from deshybrid.stochastic.record import estimate
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from tests.strategies import drawn_record, random_stochastic_system


@given(seed=st.integers(0, 2**32 - 1), gate=st.sampled_from([None, 0.9]))
@settings(max_examples=12, deadline=None)
def test_roots_give_the_estimates_of_covariances(seed, gate):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    z, u = drawn_record(rng, system, (2,), rows=10)
    ours, theirs = (estimate(system, z, u, gate=gate, engine=engine) for engine in ("roots", "numpy"))
    np.testing.assert_array_equal(ours.gated, theirs.gated)
    for name in ("x", "P", "mu", "log_likelihood", "nis"):
        wanted = getattr(theirs, name)
        scale = max(1.0, np.abs(wanted).max())
        np.testing.assert_allclose(getattr(ours, name), wanted, rtol=0, atol=1e-8 * scale, err_msg=name)


def exact_covariances(P, F, H, R, rows):
    """The covariance of a Kalman filter without process noise after each row, two states, in fractions."""
    P, F = ([[Fraction(value) for value in row] for row in matrix] for matrix in (P, F))
    H, R = [Fraction(value) for value in H], Fraction(R)
    found, two = [], range(2)
    for _ in range(rows):
        P = [[sum(F[a][k] * P[k][m] * F[b][m] for k in two for m in two) for b in two] for a in two]
        HP = [sum(H[k] * P[k][b] for k in two) for b in two]
        S = sum(HP[k] * H[k] for k in two) + R
        P = [[P[a][b] - HP[a] * HP[b] / S for b in two] for a in two]
        found.append([[float(value) for value in row] for row in P])
    return np.array(found)


def test_roots_keep_their_digits_where_covariances_lose_them():
    """Position and speed known to 10⁸, measured to 10⁻⁴: roots spread over 12 of 16 digits, variances over 24."""
    F, H, P, R = [[1.0, 0.125], [0.0, 1.0]], [1.0, 0.0], [[1e16, 0.0], [0.0, 1e16]], 1e-8
    mode = Mode("m", F=F, H=[H], Q=np.zeros((2, 2)), R=[[R]])
    system = StochasticSystem([mode], ModeTransition(("m",), [[1.0]]), x=[0.0, 0.0], P=P, mu=[1.0])
    exact = exact_covariances(P, F, H, R, 6)[1:]  # after one row the speed is unknown still
    errors = {}
    for engine in ("roots", "numpy"):
        made = estimate(system, np.zeros((6, 1)), engine=engine).P[1:]
        errors[engine] = np.abs(made / exact - 1.0).max()
    assert errors["roots"] < 1e-4
    assert errors["numpy"] > 0.5  # no digit of some variance is right


@pytest.mark.parametrize("method", ["mmae", "rmimm"])
def test_only_the_imm_runs_on_roots(method):
    with pytest.raises(UsageError) as caught:
        estimate(calm_and_wild(), [[1.0]], method=method, engine="roots")
    assert caught.value.diagnostics[0].code == "DH1109"


def test_a_measurement_without_any_noise_is_refused_on_roots_too():
    blind = Mode("blind", F=[[1.0]], H=[[0.0]], Q=[[1.0]], R=[[0.0]])
    system = StochasticSystem([blind], ModeTransition(["blind"], [[1.0]]), x=[0.0], P=[[1.0]], mu=[1.0])
    with pytest.raises(UsageError) as caught:
        estimate(system, [[1.0]], engine="roots")
    assert caught.value.diagnostics[0].code == "DH1105"
