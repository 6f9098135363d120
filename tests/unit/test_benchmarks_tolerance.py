"""The curve of wrong parameters: what is drawn is what is kept, and each plant differs in the one thing it says."""

import json

import numpy as np
import pytest

from benchmarks import tolerance
from deshybrid.model.elaborate import elaborate
from deshybrid.model.source import read_source


@pytest.fixture(scope="module")
def source():
    return read_source(tolerance.MODEL)


def test_the_kept_points_cover_every_case_and_the_model_itself_is_in_time():
    points = json.loads(tolerance.POINTS.read_text(encoding="utf-8"))
    assert list(points) == [case.name for case in tolerance.CASES]
    for case in tolerance.CASES:
        rows = points[case.name]
        assert [amount for amount, *_ in rows] == list(case.amounts)
        (right,) = [row for row in rows if row[0] == 0.0]
        assert right[2] == right[1]


def test_a_plant_with_another_inertia_answers_the_torque_accordingly(source):
    (case,) = [case for case in tolerance.CASES if case.parameter == "j_e"]
    mine, wrong = elaborate(source), tolerance.plant_with(source, case, 0.25)
    for gear in tolerance.GEARS:
        B = [system.location(gear).dynamics.B for system in (mine, wrong)]
        np.testing.assert_allclose(B[0], 1.25 * B[1], rtol=1e-12)


def test_a_biased_torque_is_told_and_does_not_act(source):
    case = tolerance.CASES[-1]
    mine, wrong = elaborate(source), tolerance.plant_with(source, case, 20.0)
    assert wrong.simulation.measurement["T_e"].bias == 20.0
    assert (
        wrong.simulation.input is mine.simulation.input or wrong.simulation.input.keys() == mine.simulation.input.keys()
    )
    assert wrong.simulation.measurement["omega_e"] == mine.simulation.measurement["omega_e"]
