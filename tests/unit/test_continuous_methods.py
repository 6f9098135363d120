"""Ways to gains beside placed poles: filters and co-design, what is kept, and what is refused with a reason."""

import warnings
from functools import cache

import control
import numpy as np
import pytest

from deshybrid.continuous import conic, lqe
from deshybrid.continuous.certified import paper_certificates
from deshybrid.continuous.dwell import required_dwell
from deshybrid.continuous.error import error_dynamics
from deshybrid.continuous.gains import Method, ObserverGains, design_gains
from deshybrid.continuous.lqe import Noise, error_variance, filter_gain, location_noise
from deshybrid.continuous.methods import gains_by_method
from deshybrid.diagnostics import GainError, UsageError
from deshybrid.linear.observability import kalman_split
from deshybrid.model.system import Bounds, HybridSystem, ObserverOptions
from tests.certificates import certified, certified_forms
from tests.switched import driveline, linear, switched, twin, vector

BOTH = ("p", "q")


def random_system(seed: int, n: int = 3, *, step: float | None = None) -> HybridSystem:
    """Two random locations, one output each, with mild resets; slow in sampled time."""
    rng = np.random.default_rng(seed)
    places = {}
    for name in BOTH:
        A = rng.normal(size=(n, n))
        places[name] = linear(A if step is None else np.eye(n) + step * A, rng.normal(size=(1, n)))
    arcs = [(a, b, np.eye(n) + 0.3 * rng.normal(size=(n, n))) for a, b in (BOTH, BOTH[::-1])]
    return switched(places, arcs, step=step, observer=ObserverOptions(rate=0.5))


def sizes(gains: ObserverGains, placed: ObserverGains, system: HybridSystem) -> list[tuple[float, float]]:
    """‖G‖₂ of both by location, every state in its own size and every output in that of its row."""
    found = []
    for name in gains.locations:
        rows = np.linalg.norm(system.location(name).dynamics.C * placed.scale, axis=1)
        both = (entry.gains[name] * rows / placed.scale[:, None] for entry in (gains, placed))
        found.append(tuple(float(np.linalg.norm(gain, 2)) for gain in both))
    return found


def test_the_filter_gain_is_the_one_of_python_control() -> None:
    rng = np.random.default_rng(3)
    for n, p in ((1, 1), (3, 1), (4, 2), (2, 3)):
        A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
        E, V = rng.normal(size=(n, n)), np.diag(rng.uniform(0.1, 1, p))
        noise = Noise(E @ E.T, V)
        expected = control.lqe(A, np.eye(n), C, E @ E.T, V)[0]
        np.testing.assert_allclose(filter_gain(kalman_split(A, C), noise, 0.0), expected, rtol=1e-6, atol=1e-9)
        shifted = control.lqe(A + 0.7 * np.eye(n), np.eye(n), C, E @ E.T, V)[0]
        np.testing.assert_allclose(filter_gain(kalman_split(A, C), noise, 0.7), shifted, rtol=1e-6, atol=1e-9)


def test_the_sampled_filter_gain_is_the_predictor_of_python_control() -> None:
    rng = np.random.default_rng(4)
    for n, p in ((1, 1), (3, 1), (4, 2)):
        A, C = rng.normal(size=(n, n)), rng.normal(size=(p, n))
        noise = Noise(np.eye(n) + 0.1, 0.2 * np.eye(p))
        found = filter_gain(kalman_split(A, C), noise, 0.0, step=0.1)
        expected = control.dlqe(A, np.eye(n), C, noise.process, noise.measurement)[0]
        np.testing.assert_allclose(found, expected, rtol=1e-6, atol=1e-9)
        fast = filter_gain(kalman_split(A, C), noise, 2.0, step=0.1)
        assert np.abs(np.linalg.eigvals(A - fast @ C)).max() < np.exp(-0.2)


def test_no_gain_near_a_filter_leaves_less_error_variance() -> None:
    """The variance is also that of a simulation's covariance recursion, written out."""
    rng = np.random.default_rng(5)
    A, C, noise = rng.normal(size=(3, 3)), rng.normal(size=(2, 3)), Noise(np.diag([1.0, 0.1, 2.0]), np.diag([0.2, 0.5]))
    best = filter_gain(kalman_split(A, C), noise, 0.0)
    assert best is not None
    least = error_variance(A - best @ C, best, noise, np.ones(3), None)
    P, h = np.zeros((3, 3)), 1e-3
    for _ in range(30_000):
        P = P + h * (A @ P + P @ A.T - P @ C.T @ np.linalg.inv(noise.measurement) @ C @ P + noise.process)
    assert least == pytest.approx(np.trace(P), rel=1e-3)
    for _ in range(20):
        other = best + 0.05 * rng.normal(size=best.shape)
        assert error_variance(A - other @ C, other, noise, np.ones(3), None) > least


def test_the_noises_are_those_of_the_bounds_with_a_floor() -> None:
    bounds = Bounds(disturbance=vector(0.3), measurement=vector(0.02))
    noise = location_noise(twin(bounds=bounds), "p", np.array([2.0, 4.0]), 0.5)
    np.testing.assert_allclose(noise.process, [[(1e-3 * 1.0) ** 2, 0], [0, 0.09 + (1e-3 * 2.0) ** 2]])
    np.testing.assert_allclose(noise.measurement, [[4e-4 + (1e-3 * 0.02) ** 2]])
    silent = location_noise(twin(), "p", np.array([2.0, 4.0]), 0.5)
    np.testing.assert_allclose(silent.process, np.diag([1.0, 4.0]))
    np.testing.assert_allclose(silent.measurement, [[0.02**2]])


@pytest.mark.parametrize("method", ["place", "lqe", "lmi"])
@pytest.mark.parametrize("system", [twin(), driveline(), random_system(1), random_system(2, step=0.1)])
def test_verify_accepts_the_certificates_of_every_method(system: HybridSystem, method: Method) -> None:
    names = tuple(place.name for place in system.locations)
    gains = gains_by_method(system, names, rate=0.5, method=method)
    papers = paper_certificates(system, gains, step=0.01, delay=0.0)
    assert any(entry.holds for entry in (*papers, *certified_forms(system, gains, papers)))


@cache
def placed_and_together(seed: int) -> tuple[HybridSystem, ObserverGains, ObserverGains, float, float]:
    """A random system, both designs, and the dwell times certified for them by forms."""
    system = random_system(seed, n=2 + seed % 2, step=0.1 if seed == 4 else None)
    placed, made = (gains_by_method(system, BOTH, method=method) for method in ("place", "lmi"))
    needs = [certified(error_dynamics(system, g.gains), rate=placed.rate) for g in (placed, made)]
    return system, placed, made, needs[0].required_dwell, needs[1].required_dwell


@pytest.mark.parametrize("seed", range(5))
def test_the_co_design_is_never_worse_than_placed_poles_at_no_larger_gain(seed: int) -> None:
    system, placed, made, old, new = placed_and_together(seed)
    assert new <= old
    assert made.rate == placed.rate
    assert all(size <= cap * (1 + 1e-9) for size, cap in sizes(made, placed, system))
    kept = [warning.code for warning in made.warnings] == ["DH0519"]
    assert kept == (new == old) == (set(made.sources.values()) == {"search"})


@pytest.mark.parametrize("dwell", [None, 0.4, 2.0])
@pytest.mark.parametrize("seed", range(4))
def test_a_filter_is_kept_only_where_placed_poles_are_no_better(seed: int, dwell: float | None) -> None:
    system = random_system(seed)
    placed, made = (gains_by_method(system, BOTH, dwell=dwell, method=method) for method in ("place", "lqe"))
    filtered = design_gains(system, BOTH, dwell=dwell, method="lqe")
    needs = {entry: required_dwell(system, gains) for entry, gains in (("placed", placed), ("filtered", filtered))}
    meets = {entry: need <= (dwell or np.inf) and np.isfinite(need) for entry, need in needs.items()}
    if set(made.sources.values()) == {"lqe"}:
        np.testing.assert_array_equal(made.gains["p"], filtered.gains["p"])
        assert meets["filtered"] or not meets["placed"]
        assert [warning.code for warning in made.warnings] == []
    else:
        assert meets["placed"] >= meets["filtered"]
        np.testing.assert_array_equal(made.gains["p"], placed.gains["p"])
        assert [warning.code for warning in made.warnings] == ["DH0519"]


@pytest.mark.parametrize("method", ["lqe", "lmi"])
def test_gains_and_poles_of_the_model_stay_with_every_method(method: Method) -> None:
    given = np.array([[4.0], [3.0]])
    system = twin(observer=ObserverOptions(rate=0.5, gains={"p": given}, poles={"q": (-3, -4)}))
    made = gains_by_method(system, BOTH, method=method)
    np.testing.assert_array_equal(made.gains["p"], given)
    assert dict(made.sources) == {"p": "model gains", "q": "model poles"}
    partly = gains_by_method(twin(observer=ObserverOptions(rate=0.5, gains={"p": given})), BOTH, method=method)
    np.testing.assert_array_equal(partly.gains["p"], given)


def test_a_co_design_without_the_solver_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conic, "has_solver", lambda: False)
    with pytest.raises(UsageError, match="DH0518"):
        gains_by_method(twin(), BOTH, method="lmi")


def test_a_method_that_does_not_exist_is_refused() -> None:
    with pytest.raises(UsageError, match="DH0508"):
        gains_by_method(twin(), BOTH, method="best")  # type: ignore[arg-type]


@pytest.mark.parametrize("method", ["lqe", "lmi"])
def test_placed_poles_are_kept_where_no_filter_is_found(method: Method, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(lqe, "filter_gain", lambda *arguments, **options: None)
    made = gains_by_method(twin(), BOTH, rate=0.5, method=method)
    assert made.sources["p"] == ("search" if method == "lqe" else "lmi")
    assert [warning.code for warning in made.warnings] == (["DH0519"] if method == "lqe" else [])


def test_the_co_design_is_the_same_every_time() -> None:
    system, _, first, _, _ = placed_and_together(0)
    second = gains_by_method(system, BOTH, method="lmi")
    for name in BOTH:
        np.testing.assert_array_equal(first.gains[name], second.gains[name])


BAD_PAIRS = {
    "repeated poles": ([[-1, 0], [0, -1]], [[1, 1]]),
    "a Jordan block": ([[-1, 1], [0, -1]], [[1, 0]]),
    "two integrators": ([[0, 1], [0, 0]], [[1, 0]]),
    "an undamped oscillation": ([[0, 1], [-4, 0]], [[1, 0]]),
    "nearly unobservable": ([[-1, 0], [0, -2]], [[1, 1e-7]]),
    "an unstable mode that barely shows": ([[-1, 0], [0, 0.5]], [[1, 1e-9]]),
    "an unstable mode that does not show": ([[-1, 0], [0, 0.5]], [[1, 0]]),
    "more outputs than states": ([[0, 1], [-4, -1]], [[1, 0], [0, 1], [1, 1]]),
    "an output that shows nothing": ([[0, 1], [-4, -1]], [[1, 0], [0, 0]]),
    "no output at all": ([[-1, 0], [0, -2]], [[0, 0]]),
    "units far apart": ([[0, 1e6], [-4e-6, -1]], [[1e-5, 0]]),
    "a fixed mode": ([[-1, 0], [2, -3]], [[1, 0]]),
}


@pytest.mark.parametrize("step", [None, 0.1])
@pytest.mark.parametrize("method", ["place", "lqe", "lmi"])
@pytest.mark.parametrize("pair", list(BAD_PAIRS))
def test_bad_pairs_end_with_decaying_errors_or_a_coded_reason(pair: str, method: Method, step: float | None) -> None:
    A, C = (np.array(matrix, dtype=float) for matrix in BAD_PAIRS[pair])
    A = A if step is None else np.eye(2) + step * A
    system = switched({"p": linear(A, C)}, [("p", "p", [[1, 0.2], [0, 1]])], step=step)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        if pair.startswith("an unstable mode"):
            with pytest.raises(GainError, match=r"DH0503|DH0504|DH0509"):
                gains_by_method(system, ("p",), rate=0.5, method=method)
            return
        values = gains_by_method(system, ("p",), rate=0.5, method=method).eigenvalues["p"]
    assert values.real.max() < 0 if step is None else np.abs(values).max() < 1


def test_a_mode_that_outputs_barely_show_is_named() -> None:
    system = switched({"p": linear([[-1, 0], [0, -2]], [[1, 1e-7]])}, [("p", "p", None)])
    made = gains_by_method(system, ("p",), rate=0.5)
    assert [(warning.code, "mode -2" in warning.message) for warning in made.warnings] == [("DH0515", True)]


def test_units_far_apart_are_no_reason_to_say_that_a_mode_barely_shows() -> None:
    units = np.array([1e-5, 1e4])
    A, C = np.array([[0, 1], [-2, -3]]) * units / units[:, None], np.array([[1, 0]]) * units
    made = gains_by_method(switched({"p": linear(A, C)}, [("p", "p", None)]), ("p",), rate=0.5)
    assert made.warnings == ()


def test_a_gain_that_fails_for_a_mode_that_barely_shows_says_so() -> None:
    system = switched({"p": linear([[-1, 0], [0, 0.5]], [[1, 1e-9]])}, [("p", "p", None)])
    with pytest.raises(GainError) as error:
        gains_by_method(system, ("p",), rate=0.5)
    assert error.value.diagnostics[0].code == "DH0504"
    assert any("barely show the mode 0.5" in note for note in error.value.diagnostics[0].notes)
