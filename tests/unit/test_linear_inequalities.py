"""Lifted matrices and the exact proofs of inequalities between forms, against their definitions."""

from fractions import Fraction

import numpy as np
from scipy.linalg import expm

from deshybrid.linear.exact import combined, diagonal, is_positive_semidefinite, product, rational, transposed
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_inequalities import Leg, Motion, does_not_contract
from deshybrid.linear.lifting import lifted, lifted_generator, lifted_size, lifting_weights, monomials


def test_lifting_is_what_it_says_on_vectors_and_respects_products_exactly() -> None:
    rng = np.random.default_rng(1)
    for n, degree in ((2, 3), (3, 2), (4, 2)):
        A, B = (rational(rng.integers(-4, 5, size=(n, n)).tolist()) for _ in range(2))
        assert lifted(product(A, B), degree) == product(lifted(A, degree), lifted(B, degree))
        assert len(lifted(A, degree)) == lifted_size(n, degree)
        x = rng.normal(size=n)
        values, moved = ([float(np.prod(v[list(m)])) for m in monomials(n, degree)] for v in (x, _floats(A) @ x))
        np.testing.assert_allclose(_floats(lifted(A, degree)) @ values, moved, atol=1e-9)


def test_the_lifted_generator_generates_the_lifted_flow() -> None:
    F = np.random.default_rng(2).normal(size=(3, 3))
    flow = np.array(lifted(expm(F).tolist(), 3))
    np.testing.assert_allclose(expm(np.array(lifted_generator(F.tolist(), 3))), flow, rtol=1e-9, atol=1e-9)


def test_in_weighted_monomials_a_lifted_vector_has_the_power_of_the_length() -> None:
    x = np.array([0.3, -2.0, 1.1])
    values = lifting_weights(3, 4) * [np.prod(x[list(m)]) for m in monomials(3, 4)]
    assert np.isclose(np.linalg.norm(values), np.linalg.norm(x) ** 4)


def test_a_matrix_is_proved_positive_definite_exactly_where_elimination_says_so() -> None:
    rng, tiny = np.random.default_rng(3), Fraction(1, 10**40)
    found = set()
    for k in range(60):
        n = int(rng.integers(1, 6))
        root = rational((rng.normal(size=(n, n if k % 3 else max(1, n - 1))) * 10.0 ** rng.integers(-6, 7)).tolist())
        square = product(root, transposed(root))
        for shift in (tiny, Fraction(0), -tiny):
            matrix = combined(square, diagonal([shift] * n))
            nearly = combined(matrix, diagonal([tiny / 10**40] * n), -1)
            expected = is_positive_semidefinite(nearly)
            assert is_positive_definite(matrix) == expected
            found.add(expected)
    assert found == {True, False}


def test_a_cycle_is_proved_not_to_contract_exactly_where_its_spectral_radius_is_above_one() -> None:
    rng, verdicts = np.random.default_rng(4), []
    for _ in range(40):
        legs, whole, rate = [], np.eye(3), 0.2
        for _ in range(2):
            F, R, stay = rng.normal(size=(3, 3)) - 1.5 * np.eye(3), 1.5 * rng.normal(size=(3, 3)), rng.uniform(0.2, 1)
            legs.append(Leg(Motion(rational(F.tolist()), None), Fraction(stay), rational(R.tolist())))
            whole = R @ expm((F + rate * np.eye(3)) * stay) @ whole
        verdicts.append(does_not_contract(legs, Fraction(rate)))
        assert verdicts[-1] == (np.abs(np.linalg.eigvals(whole)).max() > 1)
    assert len(set(verdicts)) == 2


def _floats(matrix: tuple[tuple[Fraction, ...], ...]) -> np.ndarray:
    return np.array([[float(value) for value in row] for row in matrix])
