"""Distinguishing two locations, against ranks of the window's matrices over the rational numbers."""

from fractions import Fraction

import numpy as np
import pytest

from deshybrid.linear.distinguish import distinguish
from deshybrid.linear.dynamics import LinearDynamics
from tests.exact_ranks import rank
from tests.switched import driveline, linear

Rows = list[list[Fraction]]


def _columns(matrix: np.ndarray) -> Rows:
    return [[Fraction(int(value)) for value in row] for row in matrix]


def _window(d: LinearDynamics, rows: int, *, discrete: bool) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The free response O, that to the offsets and that to the inputs, over so many samples or derivatives."""
    n, m, p = len(d.A), d.B.shape[1], len(d.C)
    free, forced = np.zeros((rows * p, n), dtype=object), np.zeros((rows * p, 1), dtype=object)
    T = np.zeros((rows * p, rows * m), dtype=object)
    A, B, C, D = (matrix.astype(int).astype(object) for matrix in (d.A, d.B, d.C, d.D))
    power, offset = np.eye(n, dtype=int).astype(object), np.zeros((n, 1), dtype=object)
    f, g = d.f.astype(int).astype(object)[:, None], d.g.astype(int).astype(object)[:, None]
    markov = [D]
    for k in range(rows):
        free[k * p : (k + 1) * p] = C @ power
        forced[k * p : (k + 1) * p] = C @ offset + (g if k == 0 or discrete else 0 * g)
        for j in range(k + 1):
            T[k * p : (k + 1) * p, j * m : (j + 1) * m] = markov[k - j]
        markov.append(C @ power @ B)
        offset = offset + power @ f if discrete else power @ f
        power = A @ power
    return free, forced, T


def naive(first: LinearDynamics, second: LinearDynamics, *, discrete: bool) -> tuple[str, int]:
    """The verdict and the dimension of the agreeing pairs, written from the definition."""
    rows = len(first.A) + len(second.A) + 3
    O_p, o_p, T_p = _window(first, rows, discrete=discrete)
    O_q, o_q, T_q = _window(second, rows, discrete=discrete)
    pairs, offset, inputs = np.hstack([O_p, -O_q]), o_p - o_q, T_p - T_q
    without, whole = _columns(np.hstack([pairs, inputs])), _columns(np.hstack([pairs, inputs, offset]))
    if rank(without) < rank(whole):
        return "always", -1
    dimension = pairs.shape[1] - (rank(without) - rank(_columns(inputs)) if inputs.size else rank(without))
    explained = rank(_columns(np.hstack([O_q, O_p, offset]))) == rank(_columns(O_q))
    if not inputs.any() and explained:
        return "never", dimension
    return ("always" if dimension == 0 else "generic"), dimension


def random_location(rng: np.random.Generator, n: int, m: int, p: int) -> LinearDynamics:
    def draw(*shape: int) -> np.ndarray:
        return rng.integers(-2, 3, shape) * (rng.random(shape) < rng.choice([0.3, 0.7, 1.0]))

    offsets = rng.random() < 0.4
    return linear(
        draw(n, n),
        draw(p, n),
        B=draw(n, m),
        D=draw(p, m) * (rng.random() < 0.2),
        f=draw(n) * offsets,
        g=draw(p) * offsets,
    )


def relative(rng: np.random.Generator, first: LinearDynamics) -> LinearDynamics:
    """A location that has something in common with the first, so that all three verdicts come up."""
    changed = {"A": first.A.copy(), "B": first.B.copy(), "f": first.f.copy(), "g": first.g.copy()}
    kind = rng.choice(["same", "A", "B", "f", "g", "similar"])
    if kind == "similar":
        order = rng.permutation(len(first.A))
        P = np.eye(len(first.A))[order]
        return linear(P @ first.A @ P.T, first.C @ P.T, B=P @ first.B, D=first.D, f=P @ first.f, g=first.g)
    if kind != "same" and changed[str(kind)].size:
        flat = changed[str(kind)].reshape(-1)
        flat[rng.integers(len(flat))] += 1.0
        changed[str(kind)] = flat.reshape(changed[str(kind)].shape)
    return linear(changed["A"], first.C, B=changed["B"], D=first.D, f=changed["f"], g=changed["g"])


@pytest.mark.parametrize("discrete", [False, True])
def test_the_verdict_is_that_of_the_exact_ranks_over_a_window(discrete: bool) -> None:
    rng = np.random.default_rng(5 + discrete)
    seen: dict[str, int] = {}
    for number in range(250):
        n, m, p = int(rng.integers(1, 4)), int(rng.integers(0, 3)), int(rng.integers(1, 3))
        first = random_location(rng, n, m, p)
        second = relative(rng, first) if number % 2 else random_location(rng, n, m, p)
        found = distinguish(first, second, discrete=discrete)
        assert (found.verdict, found.equal_dimension) == naive(first, second, discrete=discrete), (first, second)
        seen[found.verdict] = seen.get(found.verdict, 0) + 1
    assert min(seen[verdict] for verdict in ("always", "generic", "never")) >= 10


def test_without_inputs_and_offsets_the_rank_is_that_of_the_joint_observability_matrix() -> None:
    rng = np.random.default_rng(7)
    for _ in range(100):
        first, second = (linear(rng.integers(-2, 3, (2, 2)), rng.integers(-1, 2, (1, 2))) for _ in range(2))
        O_p, _, _ = _window(first, 6, discrete=False)
        O_q, _, _ = _window(second, 6, discrete=False)
        assert distinguish(first, second).rank == rank(_columns(np.hstack([O_p, O_q])))


def test_a_self_loop_changes_nothing_that_a_residual_could_see() -> None:
    for location in driveline().locations:
        assert location.dynamics is not None
        assert distinguish(location.dynamics, location.dynamics).verdict == "never"


def test_two_gears_of_the_driveline_are_told_apart_unless_the_shaft_carries_no_torque() -> None:
    """The one direction left: T_c = 0 with ω_w = 0, where ω_e runs out at the rate k/b, common to the gears here."""
    first, second, _ = (location.dynamics for location in driveline().locations)
    assert first is not None
    assert second is not None
    found = distinguish(first, second)
    assert (found.verdict, found.rank) == ("generic", 5)


def test_units_do_not_change_a_verdict() -> None:
    first, second, third = (location.dynamics for location in driveline().locations)
    S, V = np.array([1e3, 1e-2, 1e2]), np.array([1e-3, 1e3])
    assert first is not None
    assert second is not None
    assert third is not None

    def other_units(d: LinearDynamics) -> LinearDynamics:
        return linear(d.A * S / S[:, None], V[:, None] * d.C * S, B=d.B / S[:, None], D=V[:, None] * d.D)

    for a, b in ((first, second), (first, third), (third, third)):
        assert distinguish(other_units(a), other_units(b)).verdict == distinguish(a, b).verdict


def test_a_difference_that_only_an_input_shows_is_generic() -> None:
    """From x = 0 both stand still until the input moves them; the feedback u = x even hides the difference."""
    first, second = linear([[-1]], [[1]], B=[[1]]), linear([[-2]], [[1]], B=[[2]])
    assert distinguish(first, second).verdict == "generic"
    assert distinguish(first, linear([[-1]], [[1]], B=[[2]])).verdict == "generic"


def test_offsets_that_differ_tell_locations_apart_even_at_standstill() -> None:
    for other in (linear([[-2]], [[0]], g=[1]), linear([[-1]], [[1]], g=[1])):
        found = distinguish(linear([[-1]], [[1]], g=[0]), other)
        assert (found.verdict, found.equal_dimension) == ("always", -1)
    assert distinguish(linear([[0]], [[1]], g=[0]), linear([[0]], [[1]], g=[1])).verdict == "never"


def test_a_location_that_explains_more_is_never_excluded_by_its_poorer_neighbour() -> None:
    poor, rich = linear([[-1]], [[1]]), linear([[-1, 0], [0, -2]], [[1, 1]])
    assert distinguish(poor, rich).verdict == "never"
    assert distinguish(rich, poor).verdict == "generic"


def test_only_channels_that_both_locations_measure_are_compared() -> None:
    first = linear([[-1, 0], [0, -2]], [[1, 0], [0, 1]])
    second = linear([[-1, 0], [0, -3]], [[1, 0]])
    assert distinguish(first, second, outputs=((0, 1), (0,))).verdict == "never"
    assert distinguish(first, linear([[-1, 0], [0, -3]], [[0, 1]]), outputs=((0, 1), (1,))).verdict == "generic"
    with pytest.raises(ValueError, match="do not fit"):
        distinguish(first, second, outputs=((0,), (0,)))


def test_rounding_in_equal_numbers_is_no_difference() -> None:
    first = linear([[-0.3]], [[1.0]], g=[0.3], B=[[1]], D=[[0.3]])
    second = linear([[-(0.1 + 0.2)]], [[1.0]], g=[0.1 + 0.2], B=[[1]], D=[[0.1 + 0.2]])
    assert distinguish(first, second).verdict == "never"
