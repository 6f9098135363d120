"""Determinability beyond the printed example: Theorem 2 corrected, several cycles, refusals, a run of the observer."""

import copy
import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm
from switched import linear, switched, twin
from typer.testing import CliRunner

from deshybrid import compiler
from deshybrid.cli import app
from deshybrid.continuous.determinability_contraction import certify_box
from deshybrid.continuous.determinability_coordinates import kalman_coordinates, simplest_rational
from deshybrid.continuous.determinability_design import theorem_4
from deshybrid.continuous.determinability_theorem2 import theorem_2
from deshybrid.continuous.error import ErrorDynamics, ErrorReset, error_dynamics
from deshybrid.diagnostics import UsageError
from deshybrid.model.load import loads
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import replay
from deshybrid.verify import verify_design

PERMUTATION = "models/balluchi2003/permutation.yaml"

RING = """
format: deshybrid/1
name: several_cycles
state: [a, b, c]
output: [y]
locations:
  p: {A: [[1/20, 0, 0], [0, -1, 0], [0, 0, -1/50]], C: [[0, 1, 1]], dwell: {min: 1, max: MAX}}
  q: {A: [[-1, 0, 0], [0, 1/20, 0], [0, 0, -1/50]], C: [[1, 0, 1]], dwell: {min: 1, max: MAX}}
  r: {A: [[-1, 0, 0], [0, -1/50, 0], [0, 0, 1/20]], C: [[1, 1, 0]], dwell: {min: 1, max: MAX}}
transitions:
  - {from: p, to: q, event: pq, emits: pq}
  - {from: q, to: r, event: qr, emits: qr}
  - {from: r, to: p, event: rp, emits: rp}
  - {from: q, to: p, event: qp, emits: qp}
  - {from: r, to: q, event: rq, emits: rq}
"""
"""Each location hides one axis, which grows there; five switches, so three cycles."""


def diverging_pair() -> ErrorDynamics:
    """R¹_12 = T_2 and R¹_21 = T_2⁻¹, T_1 = I: the printed norms are 1, so printed Theorem 2 holds for every D."""
    decay = np.diag([-0.5, -20.0])
    columns = np.array([[0.6, 0.8], [0.8, 0.6]])
    T = np.linalg.inv(columns)
    resets = (ErrorReset("one", "two", 0.99 * T, np.zeros(2)), ErrorReset("two", "one", 0.99 * columns, np.zeros(2)))
    return ErrorDynamics(("one", "two"), {"one": decay, "two": columns @ decay @ T}, resets)


def test_pair_that_meets_printed_theorem_2_for_every_dwell_time_diverges_and_is_refused() -> None:
    pair = diverging_pair()
    first, second = (pair.matrices[name] for name in pair.locations)
    for dwell in (1e-3, 0.1, 0.3, 1.0, 10.0):
        assert theorem_2(pair, dwell).holds_printed
    found = theorem_2(pair, 0.3)
    whole = pair.resets[1].matrix @ expm(0.3 * second) @ pair.resets[0].matrix @ expm(0.3 * first)
    assert np.abs(np.linalg.eigvals(whole)).max() > 9.0
    assert found.required_dwell_printed == 0.0
    assert not found.holds
    assert found.corollary_3
    assert not certify_box(pair, {"one": (0.3, 0.3), "two": (0.3, 0.3)}, np.ones(2)).holds


def test_corrected_theorem_2_bounds_every_round_at_the_dwell_time_it_asks_for() -> None:
    pair = diverging_pair()
    needed = theorem_2(pair).required_dwell
    first, second = (pair.matrices[name] for name in pair.locations)
    for one in np.linspace(needed, 3 * needed, 7):
        for two in np.linspace(needed, 3 * needed, 7):
            whole = pair.resets[1].matrix @ expm(two * second) @ pair.resets[0].matrix @ expm(one * first)
            assert np.abs(np.linalg.eigvals(whole)).max() <= 1 + 1e-6
    assert theorem_2(pair, needed * 1.001).holds
    assert not theorem_2(pair, needed).holds


def test_design_command_refuses_the_diverging_pair_and_says_what_the_printed_theorem_would_claim() -> None:
    pair = diverging_pair()
    system = switched(
        {name: linear(pair.matrices[name], np.eye(2)) for name in pair.locations},
        [(reset.source, reset.target, reset.matrix) for reset in pair.resets],
    )
    gains = {name: np.zeros((2, 2)) for name in pair.locations}
    made = compiler.design(replace(system, observer=replace(system.observer, gains=gains, rate=0.01)), dwell=0.3)
    said = made.document()["theorem_2"]
    assert isinstance(said, dict)
    assert said["holds"] is False
    assert said["holds_printed"] is True
    assert not made.certified


def test_theorem_2_asks_for_no_dwell_time_where_a_location_does_not_decay() -> None:
    jump = ErrorReset("p", "p", 0.1 * np.eye(1), np.zeros(1))
    found = theorem_2(ErrorDynamics(("p",), {"p": np.array([[0.1]])}, (jump,)), 5.0)
    assert not found.holds
    assert not found.corollary_3


def test_reset_that_carries_what_is_hidden_to_where_it_is_seen_determines_the_state() -> None:
    made = compiler.design(PERMUTATION)
    assert made.certified
    record = made.document()["determinability"]
    assert isinstance(record, dict)
    assert (record["start"], record["condition_16"], record["contracts"]) == ("q1", True, True)
    assert [start["condition_16"] for start in record["starts"]] == [True, False]


def test_same_pair_without_the_permutation_is_refused_with_the_round_that_grows() -> None:
    text = Path(PERMUTATION).read_text(encoding="utf-8").replace("[[0, 1], [1, 0]]", "[[1, 0], [0, 1]]")
    made = compiler.design(loads(text))
    assert not made.certified
    record = made.document()["determinability"]
    assert isinstance(record, dict)
    assert record["condition_16"] is False
    assert record["contracts"] is False
    assert {problem.code for problem in made.problems} == {"DH0521"}
    assert "multiplies an error by" in made.problems[0].message


def test_locations_on_several_cycles_are_certified_together_and_verified() -> None:
    made = compiler.design(loads(RING.replace("MAX", "4")))
    assert made.certified
    assert made.determined is not None
    assert made.determined.theorem is None
    tree = json.loads(json.dumps(made.document()))
    assert tree["determinability"] is None
    assert verify_design(tree).holds


def test_longest_stay_that_is_not_stated_is_asked_for() -> None:
    runner = CliRunner()
    text = Path(PERMUTATION).read_text(encoding="utf-8").replace(", max: 4", "")
    answer = runner.invoke(app, ["design", "-", "--json"], input=text)
    made = compiler.design(loads(text))
    assert [problem.code for problem in made.problems] == ["DH0503", "DH0503"]
    assert any("dwell: {min: …, max: …}" in line for line in made.problems[0].helps)
    record = json.loads(answer.stdout)["determinability"]
    assert answer.exit_code == 1
    assert (record["condition_16"], record["contracts"], record["alpha_F"]) == (True, False, None)


@pytest.mark.parametrize(
    ("rows", "part"),
    [
        ([[1, 0], [1, 1]], "not orthogonal"),
        ([[0, 1], [1, 0]], "do not span"),
        ([[1, 0], [2, 0]], "singular"),
    ],
)
def test_coordinates_that_do_not_split_the_location_are_refused(rows: list[list[float]], part: str) -> None:
    with pytest.raises(UsageError, match=part) as caught:
        kalman_coordinates(np.diag([-1.0, 0.1]), np.array([[1.0, 0.0]]), np.array(rows, dtype=float))
    assert caught.value.diagnostics[0].code == "DH0520"


def test_double_of_a_simple_fraction_is_read_as_the_fraction_and_others_as_they_are() -> None:
    assert simplest_rational(1 / 3).denominator == 3
    assert float(simplest_rational(np.pi)) == np.pi
    assert simplest_rational(np.pi).denominator > 1_000_000


def test_theorem_4_is_silent_where_every_location_is_observable_or_there_is_no_single_cycle() -> None:
    assert theorem_4(twin(), ("p", "q")) is None
    assert theorem_4(loads(RING.replace("MAX", "4")), ("p", "q", "r")) is None


def test_proven_speed_condition_holds_for_a_cycle_that_hides_nothing_for_long() -> None:
    """Two axes, hidden in turn without growth: R_N = 0 up to rounding, fast gains, so that (18) can hold."""
    system = switched(
        {"p": linear(np.zeros((2, 2)), [[1, 0]]), "q": linear(np.zeros((2, 2)), [[0, 1]])},
        [("p", "q", None), ("q", "p", None)],
    )
    gains = {"p": np.array([[20.0], [0.0]]), "q": np.array([[0.0], [20.0]])}
    found = theorem_4(system, ("p", "q"), gains, {"p": (1.0, 2.0), "q": (1.0, 2.0)})
    assert found is not None
    assert found.speed is not None
    assert found.speed.holds
    dynamics = error_dynamics(system, gains)
    for one in np.linspace(1, 2, 5):
        for two in np.linspace(1, 2, 5):
            whole = expm(two * dynamics.matrices["q"]) @ expm(one * dynamics.matrices["p"])
            assert np.linalg.norm(whole, 2) <= found.speed.cycle_bound


@pytest.mark.parametrize(("step", "share"), [(0.03, 0.03), (0.003, 0.003)])
def test_error_of_the_compiled_observer_dies_out_down_to_what_switches_between_samples_leave(
    step: float, share: float
) -> None:
    """The plant switches between two samples, the observer at the second: an error of some step · ‖x'‖ is left."""
    made = compiler.compile(PERMUTATION, step=step)
    assert made.observer is not None
    trace = simulate(made.observer.system, seed=1, duration=30.0, step=step).trace
    assert trace.true_state is not None
    errors = np.linalg.norm(trace.true_state - replay(made.observer, trace).state, axis=1)
    assert errors[-1] < share * errors.max()


@pytest.mark.parametrize("field", ["gamma", "rate", "stays", "cells", "P"])
def test_tampered_contraction_is_refused(field: str) -> None:
    tree = json.loads(json.dumps(compiler.design(PERMUTATION).document()))
    assert verify_design(tree).holds
    changed = copy.deepcopy(tree)
    claim = changed["certificates"][0]
    if field in ("gamma", "rate"):
        claim[field] *= 0.9 if field == "gamma" else 1.1
    elif field == "stays":
        claim["stays"]["q1"][1] *= 1.5
    elif field == "cells":
        claim["cells"]["q1"] = [claim["cells"]["q1"][0], claim["cells"]["q1"][-1]]
    else:
        claim["P"]["q1"][1][1] *= 0.5
    assert not verify_design(changed).holds
