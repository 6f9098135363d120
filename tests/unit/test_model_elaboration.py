"""From the file to numbers: every key of the language ends where it belongs."""

from pathlib import Path

import numpy as np
import pytest

from deshybrid.diagnostics import ModelError
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import load, loads
from deshybrid.model.predicates import Affine, And, Not, Or
from deshybrid.model.system import (
    Dwell,
    HybridSystem,
    MeasurementModel,
    SignalModel,
    SignatureCandidate,
)

GOOD = Path(__file__).parent / "good_models"
TANK = """\
format: deshybrid/1
state: [h1, h2]
{head}
locations:
  fill: {{A: [[-1, 0], [2, -4]], {body}}}
transitions: [{{from: fill, to: fill, event: a, {arc}}}]
"""


def tank(head: str = "", body: str = "", arc: str = "") -> HybridSystem:
    return loads(TANK.format(head=head, body=body, arc=arc))


def matrix(system: HybridSystem, location: str, key: str) -> list[list[float]]:
    dynamics = system.location(location).dynamics
    assert dynamics is not None
    array: FloatArray = getattr(dynamics, key)
    assert not array.flags.writeable
    result: list[list[float]] = array.tolist()
    return result


@pytest.fixture
def two_tank() -> HybridSystem:
    return load(GOOD / "two_tank.yaml")


@pytest.fixture
def everything() -> HybridSystem:
    return load(GOOD / "everything.yaml")


def test_example_of_the_design_is_read_as_it_says(two_tank: HybridSystem) -> None:
    assert (two_tank.name, two_tank.summary, two_tank.source_note) == (
        "two_tank",
        "One sentence.",
        "where the numbers come from",
    )
    assert (two_tank.state_names, two_tank.input_names, two_tank.output_names) == (("h1", "h2"), ("u",), ("y",))
    assert dict(two_tank.units) == {"h1": "m", "h2": "m"}
    assert two_tank.time_step is None
    assert two_tank.initial == ("fill",)
    assert matrix(two_tank, "fill", "A") == [[-1, 0], [2, -4]]
    assert matrix(two_tank, "drain", "A") == [[-2, 0], [2, -4]]
    assert matrix(two_tank, "drain", "B") == [[1], [0]]
    assert matrix(two_tank, "drain", "f") == [0, 0.1]
    assert two_tank.location("fill").dwell == Dwell(0.4, 5.0)
    assert two_tank.location("drain").dwell == Dwell(None, None)


def test_transitions_of_the_example_carry_outputs_guards_resets_and_places(two_tank: HybridSystem) -> None:
    first, second = two_tank.transitions
    assert (first.source, first.event, first.target, first.outputs) == ("fill", "open", "drain", ("alarm",))
    assert second.outputs == (None,)
    assert second.guard is None
    assert isinstance(first.guard, Affine)
    assert (first.guard.state.tolist(), first.guard.constant, first.guard.relation) == ([-1, 0], 1, "<=")
    assert first.reset is not None
    assert second.reset is not None
    assert second.reset.matrix.tolist() == [[1, 0], [0, 1]]
    assert second.reset.offset.tolist() == [0, 0]
    assert str(first.span).endswith("two_tank.yaml:18:5")
    assert str(second.output_span).endswith("two_tank.yaml:19:50")


def test_wishes_of_the_example_are_read(two_tank: HybridSystem) -> None:
    assert two_tank.signatures.candidates == (SignatureCandidate("fill"), SignatureCandidate("drain", 1.0, "negation"))
    assert two_tank.signatures.forbid == (("drain", "fill"),)
    options = two_tank.observer
    assert (options.rate, options.dwell, options.step) == (0.5, 0.4, 0.01)
    assert dict(options.poles) == {"fill": (-3 + 0j, -4 + 0j)}
    assert two_tank.bounds.measurement is not None
    assert two_tank.bounds.measurement.tolist() == [0.01]


def test_stochastic_keys_of_the_example_are_read(two_tank: HybridSystem) -> None:
    chain = two_tank.probability_from_to
    assert chain is not None
    assert {name: dict(row) for name, row in chain.items()} == {
        "fill": {"fill": 0.95, "drain": 0.05},
        "drain": {"fill": 0.1, "drain": 0.9},
    }
    noise = two_tank.location("fill").process_noise
    assert noise is not None
    assert noise.tolist() == [[0.1, 0], [0, 0.2]]
    assert two_tank.prior is not None
    assert dict(two_tank.prior.probability) == {"fill": 1, "drain": 0}


def test_disturbance_without_a_map_enters_every_state(two_tank: HybridSystem) -> None:
    """Balluchi et al. (2012), (12): one disturbance per state, whatever the one name is."""
    assert two_tank.disturbance_names == ("w_h1", "w_h2")
    assert matrix(two_tank, "fill", "E") == [[1, 0], [0, 1]]
    assert two_tank.bounds.disturbance is not None
    assert two_tank.bounds.disturbance.tolist() == [0.1, 0.1]


@pytest.mark.parametrize(
    ("head", "body", "names", "shape"),
    [
        ("", "", ("w_h1", "w_h2"), (2, 2)),
        ("disturbance: [d1, d2]", "", ("d1", "d2"), (2, 2)),
        ("disturbance: []", "", (), (2, 0)),
        ("disturbance: [d]", "E: [[1], [0]]", ("d",), (2, 1)),
        ("disturbance: {d1: N, d2: N, d3: N}", "E: [[1, 0, 0], [0, 1, 1]]", ("d1", "d2", "d3"), (2, 3)),
    ],
)
def test_disturbances_are_named_and_mapped(
    head: str, body: str, names: tuple[str, ...], shape: tuple[int, int]
) -> None:
    system = tank(head, body)
    assert system.disturbance_names == names
    assert np.shape(matrix(system, "fill", "E")) == shape or shape == (2, 0)


def test_matrices_that_are_not_written_are_zero_and_resets_the_identity() -> None:
    system = tank("input: [u]\noutput: [y]", "B: [[1], [2]], C: [[1, 0]]")
    assert [matrix(system, "fill", key) for key in "Dfg"] == [[[0]], [0, 0], [0]]
    reset = system.transitions[0].reset
    assert reset is not None
    assert (reset.matrix.tolist(), reset.offset.tolist()) == ([[1, 0], [0, 1]], [0, 0])


def test_model_without_inputs_and_outputs_needs_neither_map() -> None:
    dynamics = tank().location("fill").dynamics
    assert dynamics is not None
    assert (dynamics.B.shape, dynamics.C.shape, dynamics.D.shape, dynamics.g.shape) == ((2, 0), (0, 2), (0, 0), (0,))


def test_location_may_list_its_own_channels(everything: HybridSystem) -> None:
    assert everything.output_names == ("y", "z")
    fill, other = everything.locations
    assert (fill.output_index, fill.input_index) == ((0,), (0, 1))
    assert (other.output_index, other.input_index) == ((1, 0), (1,))
    assert matrix(everything, "012", "C") == [[0, 1], [1, 0]]


def test_arrays_beside_the_model_are_read(everything: HybridSystem) -> None:
    assert matrix(everything, "012", "A") == [[-2, 1], [0, -3]]
    assert matrix(everything, "012", "f") == [0.5, -1]


def test_noise_of_a_location_goes_before_that_of_the_defaults_and_of_the_head(everything: HybridSystem) -> None:
    fill, other = everything.locations
    assert fill.measurement_noise is not None
    assert other.measurement_noise is not None
    assert fill.measurement_noise.tolist() == [[0.01]]
    assert other.measurement_noise.tolist() == [[0.04, 0.01], [0.01, 0.02]]
    for location in (fill, other):
        assert location.process_noise is not None
        assert location.process_noise.tolist() == [[0.1, 0], [0, 0.1]]


def test_parameters_are_arithmetic_in_those_before_them(everything: HybridSystem) -> None:
    assert matrix(everything, "fill", "A") == [[-1, 0], [2, -4]]
    assert everything.time_step == 0.25
    assert everything.observer.rate == 0.5


def test_bounds_follow_the_order_of_the_channels_not_of_the_mapping(everything: HybridSystem) -> None:
    bounds = everything.bounds
    shown = [None if part is None else part.tolist() for part in (bounds.state, bounds.input, bounds.measurement)]
    assert shown == [[10, 5], [1, 1], [0.01, 0.02]]
    assert bounds.disturbance is not None
    assert bounds.disturbance.tolist() == [0.1]


def test_conditions_become_predicates_over_all_states_and_inputs(everything: HybridSystem) -> None:
    invariant = everything.locations[0].invariant
    assert isinstance(invariant, And)
    below, neither = invariant.parts
    assert isinstance(below, Affine)
    assert isinstance(neither, Not)
    assert isinstance(neither.part, Or)
    above, zero = neither.part.parts
    assert isinstance(above, Affine)
    assert isinstance(zero, Affine)
    assert (below.state.tolist(), below.input.tolist(), below.constant, below.relation) == ([1, 0], [0, 0], -3, "<=")
    assert (above.state.tolist(), above.constant, above.relation) == ([0, -1], 2, "<")
    assert (zero.input.tolist(), zero.constant, zero.relation) == ([1, 0], 0, "==")


def test_chain_of_comparisons_holds_where_all_its_links_hold(everything: HybridSystem) -> None:
    guard = everything.transitions[0].guard
    assert isinstance(guard, And)
    inside, outside = np.array([3.9, 0]), np.array([4.1, 0])
    assert guard.margin(inside, np.zeros(2)) > 0 > guard.margin(outside, np.zeros(2))


def test_outputs_may_be_a_set_with_silence_in_it(everything: HybridSystem) -> None:
    assert [transition.outputs for transition in everything.transitions] == [("low", None), (None,), ("high",)]


def test_wishes_for_observer_and_detector_are_read(everything: HybridSystem) -> None:
    options, detector = everything.observer, everything.observer.detector
    assert dict(options.poles) == {"fill": (-0.1 + 0.2j, -0.1 - 0.2j)}
    assert options.gains["012"].tolist() == [[1, 0], [0, 1]]
    assert options.initial_state is not None
    assert options.initial_state.tolist() == [1, 2]
    assert dict(detector.poles) == {"fill": (-5 + 0j, -6 + 0j)}
    assert {name: level.tolist() for name, level in detector.threshold.items()} == {"fill": [0.1], "012": [0.2, 0.1]}
    assert (detector.release, detector.debounce, detector.window) == (1.5, 0.02, 0.2)


def test_candidates_may_be_listed_without_saying_more(everything: HybridSystem) -> None:
    fill, other = everything.signatures.candidates or ()
    assert (fill.location, fill.cost, fill.by) == ("fill", 1.0, None)
    assert (other.location, other.cost, other.by) == ("012", 2.5, "residual")
    assert everything.signatures.forbid == (("012", "012"),)


def test_simulation_is_read(everything: HybridSystem) -> None:
    drive = everything.simulation
    assert (drive.duration, drive.location, drive.requests) == (10, "012", ((0.5, "on"), (2, "off")))
    assert drive.state is not None
    assert drive.state.tolist() == [1, 1]
    assert drive.input["u"] == SignalModel(((0.0, 0.5),))
    assert drive.input["v"] == SignalModel(((0, 0), (1, 2)), False, 0.1, 50, 0.2, 0.5)
    assert drive.unmeasured["u"] == SignalModel((), True, 0.3, 2)
    assert drive.disturbance["w"] == SignalModel(random=0.1)
    assert drive.measurement["y"] == MeasurementModel(quantum=0.5, delay=0.02, noise=0.1)
    assert drive.measurement["u"] == MeasurementModel(lag=0.1, period=0.05, bias=-0.2)


def test_prior_probabilities_that_are_not_written_are_zero(everything: HybridSystem) -> None:
    assert everything.prior is not None
    assert dict(everything.prior.probability) == {"fill": 0, "012": 1}


def test_one_threshold_serves_all_locations() -> None:
    system = tank("output: [y]\nobserver: {detector: {threshold: 0.5}}", "C: [[1, 0]]")
    assert {name: level.tolist() for name, level in system.observer.detector.threshold.items()} == {"fill": [0.5]}


def test_discrete_model_has_no_matrices_and_every_location_is_initial() -> None:
    system = load("models/balluchi2012/fig2.yaml")
    assert system.is_discrete
    assert system.initial == tuple("012345")
    assert all(location.dynamics is None for location in system.locations)
    assert all(transition.reset is None for transition in system.transitions)


def test_discrete_model_may_be_a_mapping_with_stays() -> None:
    system = loads(
        "{format: deshybrid/1, locations: {on: {dwell: {min: 1}}, off: }, transitions: ["
        "{from: on, to: off, event: a}, {from: off, to: on, event: b}]}"
    )
    assert [location.dwell.min for location in system.locations] == [1.0, None]


def test_locations_may_be_a_list_when_the_defaults_say_everything() -> None:
    system = loads(
        "{format: deshybrid/1, state: [x], defaults: {A: [[-1]]}, locations: [a, b], transitions: ["
        "{from: a, to: b, event: s}, {from: b, to: a, event: s}]}"
    )
    assert [matrix(system, name, "A") for name in "ab"] == [[[-1]], [[-1]]]


def test_model_with_probabilities_needs_no_transitions() -> None:
    system = loads("{format: deshybrid/1, locations: [a], transition_probability: {a: {a: 1}}}")
    assert system.transitions == ()


def test_abstraction_keeps_numbers_names_and_places_of_the_transitions(two_tank: HybridSystem) -> None:
    des = abstract(two_tank)
    assert (des.name, des.locations, des.initial) == ("two_tank", ("fill", "drain"), ("fill",))
    for arc, transition in zip(des.transitions, two_tank.transitions, strict=True):
        assert (arc.source, arc.event, arc.target, arc.outputs) == (
            transition.source,
            transition.event,
            transition.target,
            transition.outputs,
        )
        assert arc.span is transition.span
        assert arc.output_span is transition.output_span
    assert str(des.location_spans["drain"]).endswith("two_tank.yaml:15:3")


def test_every_value_leads_back_to_the_line_it_was_made_from(two_tank: HybridSystem) -> None:
    fill, drain = two_tank.locations
    assert str(fill.spans["A"]).endswith(":14:14")
    assert str(drain.spans["B"]).endswith(":12:15")
    assert two_tank.source is not None
    assert two_tank.source.text.line(14).startswith("  fill:")


def test_system_is_the_same_whenever_it_is_loaded() -> None:
    assert repr(load(GOOD / "everything.yaml")) == repr(load(GOOD / "everything.yaml"))


@pytest.mark.parametrize(
    ("poles", "good"),
    [
        ("-1, -2", True),
        ("-1+2j, -1-2j", True),
        ("-sqrt(2) + 1j, -sqrt(2) - 1j", True),
        ("-1+2j, -1+2j", False),
        ("-1+2j, -2-2j", False),
        ("-1", False),
    ],
)
def test_poles_are_closed_under_conjugation(poles: str, good: bool) -> None:
    text = f"observer: {{poles: {{fill: [{poles}]}}}}"
    if good:
        assert len(tank(text).observer.poles["fill"]) == 2
    else:
        with pytest.raises(ModelError, match="DH0211"):
            tank(text)


@pytest.mark.parametrize(
    "matrix_", ["[[1, 0], [0, 0]]", "[[1, 1], [1, 1]]", "[[0, 0], [0, 0]]", "[[0.1, 0.3], [0.3, 0.9]]"]
)
def test_singular_covariance_is_a_covariance(matrix_: str) -> None:
    assert tank(f"noise: {{process: {matrix_}}}").locations[0].process_noise is not None


@pytest.mark.parametrize(
    "matrix_", ["[[-1, 0], [0, 1]]", "[[1, 2], [2, 1]]", "[[1, 0.1], [0, 1]]", "[[1e-20, 2e-20], [2e-20, 1e-20]]"]
)
def test_matrix_that_is_no_covariance_is_refused_at_any_scale(matrix_: str) -> None:
    with pytest.raises(ModelError, match="DH0210"):
        tank(f"noise: {{process: {matrix_}}}")
