"""Dwell-time certificates: the closed form, its meaning, and how far it is from the truth."""

from dataclasses import replace
from math import exp, inf, log

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.continuous.cycles import dwell_lower_limit
from deshybrid.continuous.dwell import certify_dwell, certify_sampled, required_dwell
from deshybrid.continuous.entrywise import Stay, entrywise_bound
from deshybrid.continuous.error import sampled_error_dynamics
from deshybrid.continuous.gains import design_gains
from deshybrid.continuous.mismatch import Mismatch, in_time
from deshybrid.continuous.modes import best_columns, condition, modal_basis
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.diagnostics import UsageError
from deshybrid.linear.sampling import flow_and_integral
from deshybrid.model.system import Bounds, HybridSystem, ObserverOptions
from tests.switched import driveline, linear, switched, twin

BOTH = ("p", "q")
NAMES = ("q1", "q4", "qN")


def diagonal_pair(*, step: float | None = None) -> HybridSystem:
    """Nothing is measured of two decoupled, stable locations; a reset stretches everything by e."""
    slow, fast = np.diag([-3.0, -4.0]), np.diag([-5.0, -6.0])
    if step is not None:
        slow, fast = expm(slow * step), expm(fast * step)
    places = {"p": linear(slow, np.zeros((1, 2))), "q": linear(fast, np.zeros((1, 2)))}
    return switched(places, [("p", "q", np.e * np.eye(2)), ("q", "p", None)], step=step)


def test_the_required_dwell_time_is_the_closed_form_of_condition_20() -> None:
    system = diagonal_pair()
    found = certify_dwell(system, design_gains(system, BOTH, rate=1.0))
    assert found.terms["p"].required == pytest.approx(1 / (3 - 1), rel=1e-6)  # log(e · 1)/(3 - μ)
    assert found.terms["q"].required == pytest.approx(0.0, abs=1e-8)
    assert found.required_dwell == pytest.approx(0.5, rel=1e-6)
    assert (found.theorem, found.holds, found.P) == ("B12-6", True, None)


def test_a_shorter_dwell_time_than_required_is_not_certified_and_the_reason_names_the_location() -> None:
    system = diagonal_pair()
    gains = design_gains(system, BOTH, rate=1.0)
    assert certify_dwell(system, gains, dwell=0.50001).holds
    refused = certify_dwell(system, gains, dwell=0.4999)
    assert not refused.holds
    assert "`p` needs 0.5 s" in refused.reason


def test_theorem_7_asks_for_the_detection_delay_on_top() -> None:
    system = twin()
    gains = design_gains(system, BOTH, rate=1.0, dwell=1.0)
    plain, late = (certify_dwell(system, gains, dwell=1.0, delay=delay) for delay in (0.0, 0.125))
    assert late.theorem == "B12-7"
    assert late.required_dwell == pytest.approx(plain.required_dwell + 0.125)
    assert not certify_dwell(system, gains, dwell=0.1, delay=0.125).holds


def test_the_error_contracts_at_the_certified_rate_over_every_permitted_stay() -> None:
    """By expm, independent of eig: the norm of reset after flow, for stays from the shortest on."""
    for system, names in ((twin(), BOTH), (driveline(), NAMES)):
        gains = design_gains(system, names, rate=1.0, dwell=1.0)
        found = certify_dwell(system, gains, dwell=required_dwell(system, gains))
        assert found.holds
        S = found.scale
        for t in system.transitions:
            assert t.reset is not None
            for stay in found.dwell * np.array([1.0, 1.1, 1.7, 3.0, 10.0]):
                over = t.reset.matrix @ expm(gains.closed_loop[t.source] * stay)
                assert np.linalg.norm(over * S / S[:, None], 2) <= exp(-found.rate * stay) * (1 + 1e-9)


def test_stored_bases_are_eigenvectors_with_the_stored_condition() -> None:
    system = driveline()
    gains = design_gains(system, NAMES, rate=1.0, dwell=1.0)
    found = certify_dwell(system, gains)
    for name in NAMES:
        T, F = found.T[name], gains.closed_loop[name]
        inside = np.linalg.solve(T, F @ T)
        np.testing.assert_allclose(inside, np.diag(np.diag(inside)), atol=1e-7 * np.abs(F).max())
        kappa = np.linalg.cond(T / found.scale[:, None])
        assert kappa <= found.terms[name].kappa <= kappa * (1 + 1e-6)


def test_rescaling_the_columns_never_makes_the_condition_worse_and_sometimes_much_better() -> None:
    rng = np.random.default_rng(1)
    gained = 0
    for _ in range(30):
        values, vectors = np.linalg.eig(rng.normal(size=(4, 4)))
        order = np.lexsort((-values.imag, -values.real))
        values, vectors = values[order].astype(complex), vectors[:, order].astype(complex)
        before = condition(vectors)
        after, kappa = best_columns(vectors, values)
        assert kappa == pytest.approx(condition(after))
        assert kappa <= before * (1 + 1e-12)
        gained += kappa < 0.99 * before
    assert gained > 3


def test_the_optimised_condition_is_within_a_few_percent_of_a_fine_grid_search() -> None:
    rng = np.random.default_rng(2)
    lengths = np.exp(np.linspace(-2, 2, 41))
    for _ in range(5):
        vectors = rng.normal(size=(3, 3)).astype(complex)
        vectors /= np.linalg.norm(vectors, axis=0)
        _, kappa = best_columns(vectors, np.array([-1.0, -2, -3], dtype=complex))
        grid = min(condition(vectors * np.array([a, b, 1.0])) for a in lengths for b in lengths)
        assert kappa <= 1.01 * grid


def test_a_defective_closed_loop_has_an_infinite_condition_and_is_not_certified() -> None:
    assert modal_basis(np.array([[-1.0, 1.0], [0.0, -1.0]]), np.ones(2)).kappa == inf
    gain = np.array([[1.0], [-1.75]])
    A = np.array([[0.0, 1.0], [-2.0, -2.0]])  # A - G C = [-1 1; -0.25 -2]: one Jordan block for -1.5
    system = switched({"p": linear(A, [[1, 0]])}, [("p", "p", None)], observer=ObserverOptions(gains={"p": gain}))
    gains = design_gains(system, ("p",), rate=0.5)
    values = gains.eigenvalues["p"]
    assert values == pytest.approx([-1.5, -1.5], abs=1e-6)
    assert [warning.code for warning in gains.warnings] == ["DH0510"]
    found = certify_dwell(system, gains, dwell=100.0)
    assert not found.holds
    assert found.required_dwell == inf
    assert "distinct poles" in found.reason


def test_a_rate_beyond_the_closed_loop_is_not_certified_for_any_dwell_time() -> None:
    gains = design_gains(twin(), BOTH, rate=1.0)
    found = certify_dwell(twin(), gains, rate=1000.0, dwell=5.0)
    assert not found.holds
    assert found.required_dwell == inf
    assert "contracts at" in found.reason


def test_discrete_time_gives_the_same_certificate_in_whole_steps() -> None:
    h = 0.03
    system = diagonal_pair(step=h)
    found = certify_dwell(system, design_gains(system, BOTH, rate=1.0))
    assert found.terms["p"].required == pytest.approx(17 * h)  # 0.5 s is 16.7 steps
    assert found.terms["p"].alpha == pytest.approx(-3.0)
    assert found.holds


def test_the_sampled_certificate_is_about_the_matrices_that_generated_code_runs() -> None:
    system = driveline()
    gains = design_gains(system, NAMES, rate=1.0, dwell=0.5)
    found = certify_sampled(system, gains, step=0.01, dwell=0.5)
    assert (found.theorem, found.holds, found.step) == ("B12-6-sampled", True, 0.01)
    assert certify_sampled(system, gains, step=0.01, dwell=0.5, delay=0.02).theorem == "B12-7-sampled"
    steps = round(found.required_dwell / 0.01)
    S, matrices = found.scale, sampled_error_dynamics(system, gains.gains, 0.01).matrices
    for name in NAMES:
        for k in (steps, steps + 1, 3 * steps):
            over = np.linalg.matrix_power(matrices[name], k)
            assert np.linalg.norm(over * S / S[:, None], 2) <= exp(-found.rate * k * 0.01) * (1 + 1e-9)


def test_a_step_that_is_too_long_for_the_gains_is_not_certified() -> None:
    """A gear turns the shaft's oscillation of 37 rad/s into real poles; correcting it every 60 ms is too seldom."""
    system = driveline()
    gains = design_gains(system, NAMES, rate=1.0, dwell=1.0)
    assert certify_dwell(system, gains).holds
    found = certify_sampled(system, gains, step=0.06)
    radius = max(np.abs(np.linalg.eigvals(matrix)).max() for matrix in found.matrices.values())
    assert (found.holds, bool(radius < 1)) == (False, False)


def test_the_stated_rate_defaults_to_what_the_gains_were_made_for() -> None:
    gains = design_gains(driveline(), NAMES, rate=6.0, dwell=0.5)
    assert certify_dwell(driveline(), gains).rate == gains.rate == 2.5


@pytest.mark.parametrize(("key", "value"), [("rate", 0.0), ("dwell", -1.0), ("delay", -0.1), ("delay", float("nan"))])
def test_senseless_wishes_are_refused(key: str, value: float) -> None:
    gains = design_gains(twin(), BOTH, rate=1.0)
    wishes = {"rate": 1.0, "dwell": 1.0, "delay": 0.0} | {key: value}
    with pytest.raises(UsageError, match="DH0508"):
        certify_dwell(twin(), gains, rate=wishes["rate"], dwell=wishes["dwell"], delay=wishes["delay"])


def rotating(axis: float) -> np.ndarray:
    """A slowly decaying rotation on an ellipse with the given ratio of its axes."""
    return np.array([[-0.1, axis], [-1 / axis, -0.1]])


def test_a_pair_that_is_stable_alone_and_unstable_when_switched_has_a_witness_cycle() -> None:
    places = {"p": linear(rotating(4.0), np.zeros((1, 2))), "q": linear(rotating(0.25), np.zeros((1, 2)))}
    system = switched(places, [("p", "q", None), ("q", "p", None)])
    gains = design_gains(system, BOTH, rate=0.01)
    certificate = certify_dwell(system, gains)
    limit = dwell_lower_limit(system, gains, longest=certificate.required_dwell)
    assert limit.cycle is not None
    assert 0 < limit.value <= certificate.required_dwell
    whole = np.eye(2)
    for name, stay in zip(limit.cycle.locations, limit.cycle.stays, strict=True):
        whole = expm((gains.closed_loop[name] + 0.01 * np.eye(2)) * stay) @ whole
    assert np.abs(np.linalg.eigvals(whole)).max() == pytest.approx(limit.cycle.growth, rel=1e-6)
    assert limit.cycle.growth >= 1.0
    assert min(limit.cycle.stays) == limit.value
    # The quarter turns that the textbook takes grow as well, so the limit is at least theirs.
    assert limit.value >= np.pi / 2


def test_where_every_cycle_contracts_the_lower_limit_is_zero() -> None:
    system = switched({"p": linear([[-1]], [[0]]), "q": linear([[-2]], [[0]])}, [("p", "q", None), ("q", "p", None)])
    limit = dwell_lower_limit(system, design_gains(system, BOTH, rate=0.5))
    assert (limit.value, limit.cycle) == (0.0, None)


def test_resets_that_stretch_put_the_lower_limit_at_the_exact_border_of_scalar_systems() -> None:
    """One state, one self-loop: the error contracts at μ = 0.5 if and only if 4 e^{(0.5 - 1) T} < 1."""
    system = switched({"p": linear([[-1]], [[0]])}, [("p", "p", [[4]])])
    gains = design_gains(system, ("p",), rate=0.5)
    border = log(4) / 0.5
    assert certify_dwell(system, gains).required_dwell == pytest.approx(border, rel=1e-6)
    limit = dwell_lower_limit(system, gains, longest=1.01 * border)
    assert limit.value == pytest.approx(border, rel=1e-6)
    assert limit.value <= border * (1 + 1e-12)


def test_the_certificate_is_a_value_that_can_be_compared_and_changed() -> None:
    found = certify_dwell(twin(), design_gains(twin(), BOTH, rate=1.0))
    assert replace(found, dwell=2.0).dwell == 2.0
    assert not found.T["p"].flags.writeable


@pytest.mark.parametrize("rate", [1e-300, 1e300])
def test_a_rate_of_a_size_that_no_plant_has_is_refused(rate: float) -> None:
    with pytest.raises(UsageError, match="DH0508"):
        design_gains(twin(), BOTH, rate=rate)


def test_a_rate_that_is_slow_beyond_measure_still_has_a_bound() -> None:
    """1 - e^{-x} is x there, not zero."""
    system = replace(diagonal_pair(), bounds=Bounds(measurement=np.array([0.1])))
    found = ultimate_bound(system, design_gains(system, BOTH, rate=1e-30), dwell=2.0)
    assert found.value is not None
    assert np.isfinite(found.value)


def test_an_iteration_that_grows_for_ever_ends_without_a_bound_and_without_a_warning() -> None:
    system = switched({"p": linear([[-1]], [[0]])}, [("p", "p", [[1e40]])])
    stay = Stay(np.ones(1), modal_basis(np.array([[-1.0]]), np.ones(1)), mismatches_of(system))
    assert entrywise_bound({"p": stay}, 0.1, None) is None


def mismatches_of(system: HybridSystem) -> tuple[Mismatch, ...]:
    return tuple(in_time(t.target, t.reset.matrix) for t in system.transitions if t.reset)


@pytest.mark.parametrize(("A", "step"), [([[1.0]], 1e20), ([[-1e30, 1e30], [-2e30, -3e30]], 0.01)])
def test_a_step_out_of_proportion_to_the_dynamics_is_refused(A: list[list[float]], step: float) -> None:
    with pytest.raises(UsageError, match="DH0514"):
        flow_and_integral(np.array(A), np.eye(len(A)), step)


def test_a_need_below_a_microsecond_is_said_to_be_none() -> None:
    system = switched({"p": linear(np.diag([-3.0, -4.0]), [[1, 0]])}, [("p", "p", None)])
    gains = design_gains(system, ("p",), rate=0.5)
    found = certify_dwell(system, gains)
    assert (found.holds, found.reason) == (True, "any stay is long enough")
    assert 0 < found.required_dwell < 1e-6
    assert certify_dwell(system, gains, delay=0.25).reason.endswith("that is longer than the detection delay 0.25 s")
