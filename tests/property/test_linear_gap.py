"""The ν-gap against its definition: chordal distances on a dense grid, and a winding number from unwrapped phases."""

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from deshybrid.linear.gap import Realisation, bilinear, nu_gap

GRID = np.concatenate([[0.0], np.geomspace(1e-4, 1e5, 3000)])


@st.composite
def plants(draw: st.DrawFn, inputs: int, outputs: int) -> Realisation:
    """A random system without poles on or near the imaginary axis."""
    rng, n = np.random.default_rng(draw(st.integers(0, 10**6))), draw(st.integers(0, 3))
    A, B = rng.normal(size=(n, n)) * 2.0, rng.normal(size=(n, inputs)) * draw(st.sampled_from([0.3, 2.0]))
    D = rng.normal(size=(outputs, inputs)) * draw(st.sampled_from([0.0, 0.5]))
    assume((np.abs(np.linalg.eigvals(A).real) > 0.05).all())
    return Realisation(A, B, rng.normal(size=(outputs, n)), D)


@st.composite
def pairs(draw: st.DrawFn) -> tuple[Realisation, Realisation]:
    sizes = draw(st.integers(1, 2)), draw(st.integers(1, 2))
    return draw(plants(*sizes)), draw(plants(*sizes))


def roots(M: np.ndarray) -> np.ndarray:
    """(1 + M)^{-1/2} of Hermitian matrices, by eigenvectors."""
    values, vectors = np.linalg.eigh(np.eye(M.shape[-1]) + M)
    return (vectors / np.sqrt(values)[:, None, :]) @ vectors.conj().transpose(0, 2, 1)


def naive(P: Realisation, Q: Realisation) -> tuple[float, float]:
    """The largest chordal distance on the grid, and how far the winding number is from what it should be."""
    one, other = (
        C @ np.linalg.solve(1j * GRID[:, None, None] * np.eye(len(A)) - A, np.broadcast_to(B, (len(GRID), *B.shape)))
        + D
        for A, B, C, D in (P, Q)
    )
    adjoints = [plant.conj().transpose(0, 2, 1) for plant in (one, other)]
    distance = roots(other @ adjoints[1]) @ (one - other) @ roots(adjoints[0] @ one)
    phase = np.unwrap(np.angle(np.linalg.det(np.eye(P.D.shape[1]) + adjoints[1] @ one)))
    turns = 2.0 * (phase[-1] - phase[0]) / (2.0 * np.pi)  # negative frequencies turn as far
    unstable = [int((np.linalg.eigvals(plant.A).real > 0.0).sum()) for plant in (P, Q)]
    return float(np.linalg.norm(distance, 2, axis=(1, 2)).max()), unstable[0] - unstable[1] - turns


@given(pairs())
def test_the_gap_is_the_largest_chordal_distance_where_the_winding_number_is_right_and_else_one(case) -> None:
    P, Q = case
    largest, surplus = naive(P, Q)
    gap = nu_gap(P, Q)
    if largest > 0.999:
        assert gap > 0.99
    elif abs(surplus) > 0.5:
        assert gap == 1.0
    else:
        assert gap == pytest.approx(largest, rel=2e-3, abs=2e-6)
        assert gap >= largest * (1 - 1e-6) - 1e-6


@given(pairs())
def test_the_gap_is_symmetric_and_does_not_see_coordinates_or_what_is_not_reached(case) -> None:
    P, Q = case
    gap = nu_gap(P, Q)
    assert nu_gap(Q, P) == pytest.approx(gap, abs=1e-5)
    n = len(P.A)
    T = np.eye(n) + 0.3 * np.tri(n, k=-1)
    hidden = np.diag([-1.0, 0.0])  # decays, stays; neither is reached
    A = np.block([[np.linalg.solve(T, P.A @ T), np.ones((n, 2))], [np.zeros((2, n)), hidden]])
    C = np.hstack([P.C @ T, np.ones((len(P.C), 2))])
    again = Realisation(A, np.vstack([np.linalg.solve(T, P.B), np.zeros((2, P.B.shape[1]))]), C, P.D)
    assert nu_gap(again, Q) == pytest.approx(gap, abs=1e-5)
    assert nu_gap(P, P) <= 1e-5


@given(st.data())
def test_the_gap_obeys_the_triangle_inequality(data: st.DataObject) -> None:
    P, Q, R = (data.draw(plants(1, 2)) for _ in range(3))
    assert nu_gap(P, R) <= nu_gap(P, Q) + nu_gap(Q, R) + 1e-5


@given(plants(2, 1), st.floats(0.0, 10.0))
def test_the_bilinear_transform_takes_the_axis_for_the_unit_circle(P: Realisation, omega: float) -> None:
    changed = bilinear(P)
    assume(changed is not None and np.abs(np.linalg.eigvals(P.A) + 1).min(initial=1.0) > 1e-3)
    z = (1 + 1j * omega) / (1 - 1j * omega)
    assume(np.abs(np.linalg.eigvals(P.A) - z).min(initial=1.0) > 1e-3)
    expected = P.C @ np.linalg.solve(z * np.eye(len(P.A)) - P.A, P.B.astype(complex)) + P.D
    np.testing.assert_allclose(changed.at(omega), expected, rtol=1e-6, atol=1e-6)


def single(a: float, b: float = 1.0, d: float = 0.0) -> Realisation:
    return Realisation(*(np.array([[x]]) for x in (a, b, 1.0, d)))


def test_an_integrator_that_leaks_is_close_to_one_that_grows_as_slowly() -> None:
    """1/(s + a) and 1/(s - a): 2 a/(1 + a²) at ω = 0, the largest."""
    for a in (0.001, 0.1, 0.5):
        assert nu_gap(single(-a), single(a)) == pytest.approx(2 * a / (1 + a * a), rel=1e-5)


def test_gains_of_opposite_sign_are_as_far_apart_as_their_angles() -> None:
    """Static gains are lines through zero: the sine of the angle between them; 1 and -1 are perpendicular."""
    none = np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))
    for one, other in ((1.0, -1.0), (0.5, -0.5), (2.0, 3.0)):
        found = nu_gap(*(Realisation(*none, np.array([[gain]])) for gain in (one, other)))
        assert found == pytest.approx(abs(np.sin(np.arctan(one) - np.arctan(other))), rel=1e-5)


def test_a_wrong_sign_of_an_integrator_is_as_far_as_can_be() -> None:
    assert nu_gap(single(0.0), single(0.0, -1.0)) == pytest.approx(1.0, abs=1e-6)


def test_different_shapes_are_refused() -> None:
    with pytest.raises(ValueError, match="cannot be compared"):
        nu_gap(single(-1.0), Realisation(np.zeros((0, 0)), np.zeros((0, 2)), np.zeros((1, 0)), np.ones((1, 2))))
