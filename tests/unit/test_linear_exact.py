"""Exact linear algebra: verdicts and lower bounds, against floating point and decimal arithmetic of 80 digits."""

from decimal import Decimal, getcontext
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.linear.exact import (
    combined,
    diagonal,
    exponential_below,
    is_positive_semidefinite,
    matrix_exponential,
    product,
    rational,
    scaled,
    transposed,
)


def as_floats(matrix: tuple[tuple[Fraction, ...], ...]) -> np.ndarray:
    return np.array([[float(value) for value in row] for row in matrix])


def test_matrix_operations_equal_those_of_numpy_on_small_integers() -> None:
    rng = np.random.default_rng(1)
    A, B = rng.integers(-5, 6, (3, 4)), rng.integers(-5, 6, (4, 3))
    first, second = rational(A.tolist()), rational(B.tolist())
    assert (as_floats(product(first, second)) == A @ B).all()
    assert (as_floats(combined(first, transposed(second), -2)) == A - 2 * B.T).all()
    assert (as_floats(scaled(first, Fraction(1, 2))) == A / 2).all()
    assert (as_floats(diagonal([Fraction(1), Fraction(2)])) == np.diag([1, 2])).all()


def test_positive_semidefinite_matrices_are_told_from_others_at_the_very_border() -> None:
    rng = np.random.default_rng(2)
    seen = {True: 0, False: 0}
    for _ in range(200):
        n = int(rng.integers(1, 5))
        root = rational(rng.integers(-2, 3, (n, int(rng.integers(1, n + 1)))).tolist())
        gram = product(root, transposed(root))
        below = combined(gram, diagonal([1] * n), -Fraction(1, 2**60))
        assert is_positive_semidefinite(gram)
        singular = np.linalg.matrix_rank(as_floats(gram)) < n
        assert is_positive_semidefinite(below) == (not singular)
        seen[bool(singular)] += 1
    assert min(seen.values()) > 20


@pytest.mark.parametrize("exponent", [0.0, 1e-12, 0.5, 1.0, 3.7, 20.25, 100.0, 690.0, -1e-9, -0.5, -3.0, -80.0])
def test_the_lower_bound_of_the_exponential_is_below_by_a_part_in_ten_to_the_sixty_at_most(exponent: float) -> None:
    getcontext().prec = 90
    low = exponential_below(Fraction(exponent))
    value, true = Decimal(low.numerator) / Decimal(low.denominator), Decimal(exponent).exp()
    margin = true * Decimal(10) ** -60 if exponent > -50 else true * Decimal(10) ** -30
    assert true - margin <= value <= true + true * Decimal(10) ** -85


def test_hostile_exponents_end_at_once() -> None:
    assert exponential_below(Fraction(-(10**300))) == 0
    assert float(exponential_below(Fraction(10**300))) == pytest.approx(float(exponential_below(Fraction(700))))
    with pytest.raises(ValueError, match="too large"):
        matrix_exponential(rational([[1e300]]))


def test_the_matrix_exponential_agrees_with_scipy() -> None:
    rng = np.random.default_rng(3)
    for size in (1.0, 30.0):
        matrix = size * (rng.normal(size=(4, 4)) - 2 * np.eye(4))
        np.testing.assert_allclose(as_floats(matrix_exponential(rational(matrix.tolist()))), expm(matrix), rtol=1e-9)
