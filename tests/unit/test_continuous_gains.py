"""Observer gains: what is placed, what stays, what is refused."""

import control
import numpy as np
import pytest

from deshybrid.continuous.dwell import certify_dwell
from deshybrid.continuous.gains import design_gains, place_gain, stated_dwell
from deshybrid.diagnostics import GainError, UsageError
from deshybrid.linear.arrays import frozen_array
from deshybrid.model.system import Bounds, ObserverOptions
from tests.switched import driveline, linear, switched, twin

BOTH = ("p", "q")


def test_a_single_output_gain_is_the_one_of_ackermann() -> None:
    rng = np.random.default_rng(1)
    for n in (1, 2, 3, 4):
        A, C = rng.normal(size=(n, n)), rng.normal(size=(1, n))
        poles = -np.arange(1.0, n + 1)
        expected = np.asarray(control.acker(A.T, C.T, poles)).reshape(1, n).T
        np.testing.assert_allclose(place_gain(A, C, poles), expected, rtol=1e-6, atol=1e-9)


def test_poles_are_reached_with_several_outputs_whatever_the_units() -> None:
    rng = np.random.default_rng(2)
    wanted = np.array([-2.0, -3.0, -1 + 4j, -1 - 4j])
    for _ in range(20):
        A, C = rng.normal(size=(4, 4)), rng.normal(size=(2, 4))
        units = 10.0 ** rng.integers(-4, 5, 4)
        scaled_A, scaled_C = A * units / units[:, None], C * units
        found = np.linalg.eigvals(scaled_A - place_gain(scaled_A, scaled_C, wanted) @ scaled_C)
        np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(wanted), rtol=1e-4)


def test_redundant_outputs_do_not_disturb_the_placement() -> None:
    A, C = np.array([[0.0, 1], [-4, -1]]), np.array([[1.0, 0], [2, 0], [0, 0]])
    found = np.linalg.eigvals(A - place_gain(A, C, (-2, -3)) @ C)
    assert np.sort(found.real) == pytest.approx([-3, -2])


def test_a_pole_repeated_more_often_than_the_rank_of_c_is_spread_and_the_warning_says_so() -> None:
    system = twin(observer=ObserverOptions(rate=1.0, poles={"p": (-3, -3)}))
    made = design_gains(system, BOTH)
    assert np.sort(made.eigenvalues["p"].real) == pytest.approx([-3.03, -3.0])
    assert [warning.code for warning in made.warnings] == ["DH0506"]
    assert "-3.03" in made.warnings[0].message
    two_outputs = switched({"p": linear([[0, 1], [-4, -1]], np.eye(2))}, [("p", "p", None)])
    plain = design_gains(two_outputs, ("p",), rate=1.0)
    assert plain.warnings == ()


def test_complex_poles_of_the_model_are_placed_as_they_are() -> None:
    made = design_gains(twin(observer=ObserverOptions(rate=1.0, poles={"p": (-3 + 2j, -3 - 2j)})), BOTH)
    assert made.eigenvalues["p"] == pytest.approx([-3 + 2j, -3 - 2j])
    assert (made.sources["p"], made.sources["q"]) == ("model poles", "search")


@pytest.mark.parametrize(
    "poles", [(-1,), (-1, -2, -3), (-1 + 1j, -2), (-1 + 1j, -1 - 2j), (1, -2), (0, -1), (float("nan"), -1)]
)
def test_poles_that_do_not_fit_are_refused(poles: tuple[complex, ...]) -> None:
    with pytest.raises(GainError, match="DH0505"):
        design_gains(twin(observer=ObserverOptions(rate=1.0, poles={"p": poles})), BOTH)


def test_the_search_meets_the_dwell_time_that_is_asked_where_it_can() -> None:
    from deshybrid.continuous.dwell import certify_dwell

    for dwell in (2.0, 1.0, 0.5):
        made = design_gains(twin(), BOTH, rate=1.0, dwell=dwell)
        assert certify_dwell(twin(), made).holds
        assert all(values.real.max() < -1.0 for values in made.eigenvalues.values())


def test_a_longer_dwell_time_is_met_with_smaller_gains() -> None:
    short, long = (design_gains(driveline(), ("q1", "q4", "qN"), rate=1.0, dwell=dwell) for dwell in (0.1, 2.0))
    assert np.abs(long.gains["q1"]).max() < np.abs(short.gains["q1"]).max()


def test_other_units_of_the_states_give_the_same_gains_in_those_units() -> None:
    system, names, units = driveline(), ("q1", "q4", "qN"), np.array([2.0**7, 2.0**-5, 2.0])
    places = {}
    for location in system.locations:
        d = location.dynamics
        assert d is not None
        places[location.name] = linear(d.A * units / units[:, None], d.C * units)
    arcs = [(t.source, t.target, None) for t in system.transitions]
    limit = system.bounds.state
    assert limit is not None
    other = switched(places, arcs, bounds=Bounds(state=frozen_array(limit / units, (3,))))
    made, changed = (design_gains(s, names, rate=1.0, dwell=0.5) for s in (system, other))
    for name in names:
        np.testing.assert_allclose(units[:, None] * changed.gains[name], made.gains[name], rtol=1e-6, atol=1e-6)
    assert max(made.condition.values()) < 5  # in physical units it would be some hundreds


def test_the_fixed_mode_of_a_detectable_location_caps_the_rate_and_is_named() -> None:
    made = design_gains(driveline(), ("q1", "q4", "qN"), rate=6.0, dwell=0.5)
    assert (made.requested_rate, made.rate) == (6.0, 2.5)
    (warning,) = made.warnings
    assert (warning.code, warning.severity) == ("DH0502", "warning")
    assert "`qN`" in warning.message
    assert warning.notes == ("`qN`: mode -5 in `x0`, which no output shows",)
    assert made.fixed_modes["qN"] == pytest.approx([-5.0])
    assert made.fixed_modes["q1"].size == 0
    assert np.abs(made.eigenvalues["qN"] + 5).min() < 1e-9


def test_a_fixed_mode_that_is_fast_enough_caps_nothing() -> None:
    made = design_gains(driveline(), ("q1", "q4", "qN"), rate=2.0)
    assert (made.rate, made.warnings) == (2.0, ())


def test_a_pole_for_every_state_of_an_unobservable_location_is_taken_where_it_can_be() -> None:
    observer = ObserverOptions(rate=1.0, poles={"qN": (-8, -6, -5.5)})
    made = design_gains(driveline(observer=observer), ("q1", "q4", "qN"))
    assert np.sort(made.eigenvalues["qN"].real) == pytest.approx([-8, -6, -5])
    assert [warning.code for warning in made.warnings] == ["DH0513"]


def test_an_undetectable_persistent_location_is_refused_with_a_pointer_to_the_paper_that_may_help() -> None:
    integrator = linear([[-1, 0], [0, 0]], [[1, 0]])
    growing = linear([[-1, 0], [0, 0.5]], [[1, 0]])
    system = switched({"p": integrator, "q": growing}, [("p", "q", None), ("q", "p", None)])
    with pytest.raises(GainError) as caught:
        design_gains(system, BOTH, rate=1.0)
    assert [d.code for d in caught.value.diagnostics] == ["DH0503", "DH0503"]
    text = caught.value.diagnostics[1]
    assert text.notes == ("`q`: mode 0.5 in `x1`, which no output shows",)
    assert any("Balluchi et al. (2003)" in line for line in text.helps)


def test_a_transient_undetectable_location_needs_no_gain() -> None:
    system = switched({"p": linear([[-1]], [[1]]), "t": linear([[1]], [[0]])}, [("t", "p", None), ("p", "p", None)])
    assert design_gains(system, ("p",), rate=0.5).locations == ("p",)


def test_given_gains_are_analysed_as_they_are() -> None:
    gain = np.array([[3.0], [1.0]])
    made = design_gains(twin(observer=ObserverOptions(rate=1.0, gains={"p": gain})), BOTH)
    assert (made.gains["p"] == gain).all()
    assert (made.closed_loop["p"] == np.array([[-3.0, 1.0], [-5.0, -1.0]])).all()


def test_a_given_gain_that_is_unstable_or_of_the_wrong_shape_is_refused() -> None:
    with pytest.raises(GainError, match="DH0504"):
        design_gains(twin(observer=ObserverOptions(gains={"p": np.array([[-5.0], [0.0]])})), BOTH)
    with pytest.raises(GainError, match="DH0507"):
        design_gains(twin(observer=ObserverOptions(gains={"p": np.zeros((2, 2))})), BOTH)


def test_poles_of_a_system_in_discrete_time_are_written_in_reciprocal_seconds() -> None:
    A = np.array([[1.0, 0.1], [-0.4, 0.9]])
    observer = ObserverOptions(rate=1.0, poles={"p": (-2, -3)})
    system = switched({"p": linear(A, [[1, 0]])}, [("p", "p", None)], step=0.1, observer=observer)
    made = design_gains(system, ("p",))
    assert np.sort(made.eigenvalues["p"].real) == pytest.approx(np.exp([-0.3, -0.2]))


def test_an_unstable_system_in_discrete_time_gets_a_contracting_observer() -> None:
    rng = np.random.default_rng(3)
    A = rng.normal(size=(3, 3))
    system = switched({"p": linear(A, rng.normal(size=(1, 3)))}, [("p", "p", None)], step=0.05)
    made = design_gains(system, ("p",), rate=1.0)
    assert np.abs(made.eigenvalues["p"]).max() < np.exp(-0.05)


def test_default_rate_and_dwell_come_from_the_model_then_from_each_other_then_from_the_plant() -> None:
    assert design_gains(twin(observer=ObserverOptions(rate=0.7, dwell=2.0)), BOTH).rate == 0.7
    assert design_gains(twin(observer=ObserverOptions(dwell=2.0)), BOTH).rate == 0.5
    assert design_gains(twin(), BOTH).rate == pytest.approx(np.sqrt(6.0))  # |eigenvalues| 2, 2, 3, 3
    assert stated_dwell(twin(), BOTH) is None


@pytest.mark.parametrize("value", [0.0, -1.0, float("inf"), float("nan")])
def test_rates_and_dwell_times_are_positive_and_finite(value: float) -> None:
    with pytest.raises(UsageError, match="DH0508"):
        design_gains(twin(), BOTH, rate=value)
    with pytest.raises(UsageError, match="DH0508"):
        design_gains(twin(), BOTH, dwell=value)


def test_a_location_that_is_none_or_has_no_dynamics_is_refused() -> None:
    with pytest.raises(UsageError, match="DH0501"):
        design_gains(twin(), ("p", "r"), rate=1.0)


def test_equal_calls_give_equal_bits() -> None:
    first, second = (design_gains(driveline(), ("q1", "q4", "qN"), rate=1.0) for _ in range(2))
    assert all((first.gains[name] == second.gains[name]).all() for name in first.locations)


def test_sixty_states_are_designed_without_a_search_for_the_norm() -> None:
    """The search grows like n⁵; beyond twenty states the norm is taken as the states' sizes give it."""
    A = np.diag(-1.0 - np.arange(60.0)) + np.eye(60, k=1)
    C = np.eye(1, 60)
    system = switched({"p": linear(A, C)}, [("p", "p", None)])
    gains = design_gains(system, ("p",), rate=0.5, dwell=3.0)
    assert certify_dwell(system, gains).terms["p"].kappa < 1e7
