"""The distance of two locations, against simulations of both from every start and a search over the sphere."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.optimize import minimize

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.distance import Distance, Units, distance, least_on_sphere
from deshybrid.linear.dynamics import LinearDynamics
from tests.strategies import pairs_of_dynamics

STEP, SAMPLES = 0.1, 12


def simulated(dynamics: LinearDynamics, x: FloatArray, u: FloatArray, *, step: float | None) -> FloatArray:
    """The outputs over the window, by one matrix exponential per sample, or step by step in discrete time."""
    n, m = dynamics.B.shape
    block = np.zeros((n + m + 1, n + m + 1))
    block[:n] = np.hstack([dynamics.A, dynamics.B, dynamics.f[:, None]])
    moved = expm(block * step)[:n] if step is not None else block[:n]
    shown = []
    for _ in range(SAMPLES):
        shown.append(dynamics.C @ x + dynamics.D @ u + dynamics.g)
        x = moved @ np.concatenate([x, u, [1.0]])
    return np.array(shown)


def left(pair: tuple[LinearDynamics, LinearDynamics], z: FloatArray, units: Units, *, step: float | None) -> float:
    """What the second location cannot explain of the first from (x, u) = z, its start found by least squares."""
    first, second = pair
    n, k = len(first.A), len(second.A)
    x, u = z[:n] * units.state[:n], z[n:] * units.input
    wanted = simulated(first, x, u, step=step)
    base = simulated(second, np.zeros(k), u, step=step)
    rows = [(simulated(second, np.eye(k)[i], u, step=step) - base) / units.output for i in range(k)]
    responses = np.array([row.ravel() for row in rows]).T
    rest = ((wanted - base) / units.output).ravel()
    best = np.linalg.lstsq(responses, rest, rcond=None)[0]
    return float(np.linalg.norm(rest - responses @ best) / np.sqrt(len(rest)))


def found(pair: tuple[LinearDynamics, LinearDynamics], units: Units, *, step: float | None) -> Distance:
    m, p = pair[0].B.shape[1], pair[0].C.shape[0]
    channels = {"inputs": (tuple(range(m)),) * 2, "outputs": (tuple(range(p)),) * 2}
    return distance(*pair, samples=SAMPLES, step=step, units=units, **channels)


def units_of(pair: tuple[LinearDynamics, LinearDynamics]) -> Units:
    n, (p, m) = len(pair[0].A), pair[0].D.shape
    return Units(np.linspace(1.0, 2.0, n), np.full(m, 0.5), np.linspace(0.5, 1.0, p))


@settings(max_examples=8, deadline=None)
@given(pairs_of_dynamics(), st.booleans(), st.integers(0, 2**32 - 1))
def test_no_state_of_length_one_is_nearer_than_the_worst_and_a_search_reaches_it(
    pair: tuple[LinearDynamics, LinearDynamics], discrete: bool, seed: int
) -> None:
    units, step = units_of(pair), None if discrete else STEP
    near, rng = found(pair, units, step=step), np.random.default_rng(seed)
    size = len(near.state)

    def of_direction(z: FloatArray) -> float:
        return left(pair, z / np.linalg.norm(z), units, step=step)

    directions = rng.normal(size=(10, size))
    assert all(of_direction(z) >= near.worst - 1e-7 for z in directions)
    assert of_direction(near.state) == pytest.approx(near.worst, abs=1e-7)
    reached = min(
        minimize(of_direction, z, method="Nelder-Mead", options={"maxfev": 60}).fun
        for z in (*directions[:2], near.state)
    )
    assert reached >= near.worst - 1e-7


@settings(max_examples=40, deadline=None)
@given(pairs_of_dynamics(), st.integers(0, 2**32 - 1))
def test_the_typical_distance_is_the_mean_square_over_both_ends_of_any_orthonormal_basis(
    pair: tuple[LinearDynamics, LinearDynamics], seed: int
) -> None:
    """Of a quadratic form plus linear terms the mean over the sphere is the mean over these ends."""
    units = units_of(pair)
    near = found(pair, units, step=STEP)
    basis = np.linalg.qr(np.random.default_rng(seed).normal(size=(len(near.state),) * 2))[0]
    squares = [left(pair, sign * z, units, step=STEP) ** 2 for z in basis for sign in (1.0, -1.0)]
    assert near.typical == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-6, abs=1e-9)


@settings(max_examples=60, deadline=None)
@given(st.integers(1, 4), st.integers(0, 2**32 - 1), st.booleans())
def test_least_on_sphere_is_beaten_by_no_direction(size: int, seed: int, even: bool) -> None:
    rng = np.random.default_rng(seed)
    matrix, constant = rng.normal(size=(5, size)), rng.normal(size=5)
    constant = 0.0 * constant if even else constant
    z = least_on_sphere(matrix, constant)
    least = np.linalg.norm(matrix @ z + constant)
    assert np.linalg.norm(z) == pytest.approx(1.0)
    directions = rng.normal(size=(2000, size))
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    assert (np.linalg.norm(directions @ matrix.T + constant, axis=1) >= least - 1e-9).all()


def test_least_on_sphere_makes_up_the_length_where_nothing_pulls_along_the_lowest_direction() -> None:
    """The hard case: minimise (2 a + 1)² + b² with a² + b² = 1; b² = 1 - a² gives 3 a² + 4 a + 2, least at a = -2/3."""
    z = least_on_sphere(np.diag([2.0, 1.0]), np.array([1.0, 0.0]))
    assert z[0] == pytest.approx(-2 / 3)
    assert abs(z[1]) == pytest.approx(np.sqrt(5) / 3)
