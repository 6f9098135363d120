"""Curves of wrong numbers: what is drawn is what is kept, an observer is wrong in the one thing that is said, and the
search finds the first error that is late."""

import json
import shutil

import numpy as np
import pytest

from benchmarks import tolerance
from benchmarks.compiled import namer
from benchmarks.tolerance import CASES, FEW, GEARS, Late, Point, curve, first_late
from deshybrid import compiler
from deshybrid.model.elaborate import elaborate
from deshybrid.model.source import read_source
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import replay


@pytest.fixture(scope="module")
def source():
    return read_source(tolerance.DETECTORS["relay"])


@pytest.fixture(scope="module")
def right(source):
    return compiler.design(elaborate(source))


def test_the_kept_points_cover_every_plant_detector_and_case_and_the_right_model() -> None:
    points = json.loads(tolerance.POINTS.read_text(encoding="utf-8"))
    assert set(points) == set(tolerance.PLANTS)
    for plant in points.values():
        assert set(plant) == set(tolerance.DETECTORS)
        for cases in plant.values():
            assert list(cases) == [case.name for case in CASES]
            zeros = [[row for row in rows if row[0] == 0.0] for rows in cases.values()]
            assert all(found == zeros[0] and len(found) == 1 for found in zeros)
            assert all(row[1][0] == tolerance.ENGAGEMENTS for rows in cases.values() for row in rows)


def test_an_observer_of_a_wrong_inertia_takes_the_torque_accordingly(source, right) -> None:
    (case,) = [case for case in CASES if case.parameter == "j_e"]
    mine, wrong = right.system, tolerance.observer_with(source, right, case, 0.25).system
    for gear in GEARS:
        B = [system.location(gear).dynamics.B for system in (mine, wrong)]
        np.testing.assert_allclose(B[0], 1.25 * B[1], rtol=1e-12)


@pytest.mark.skipif(not shutil.which("gcc"), reason="the observers of the benchmark run as C")
def test_the_right_observer_as_c_names_what_the_reference_names_and_a_bias_is_added_to_the_torque(
    source, right
) -> None:
    case = CASES[-1]
    observer = tolerance.observer_with(source, right, case, 0.0)
    trace = simulate(right.system, duration=8.0, step=right.step, seed=2).trace
    drive = tolerance.drive_of(trace)
    assert tuple(namer(observer)(drive.samples)) == replay(observer, trace).location
    biased = tolerance.Drive(drive.samples + np.array([20.0, 0.0, 0.0]), drive.time, drive.truth)
    with_bias = tolerance.prober(source, right, case, [drive])(20.0)
    assert with_bias[1:] == tolerance.prober(source, right, case, [biased])(0.0)[1:]


@pytest.mark.parametrize(("some", "many"), [(0.013, 0.05), (0.04, 0.041), (0.9, 0.95)])
def test_the_search_finds_the_first_error_that_is_late_to_a_thirtieth(some: float, many: float) -> None:
    tried = []

    def probe(amount: float) -> Point:
        tried.append(amount)
        late = 0 if -some < amount < some else 1 if -many < amount < many else FEW + 5
        return Point(amount, Late(250, late, None), Late(250, 0, None), 0.0)

    points = curve(probe, CASES[0])
    assert len(tried) == len(set(tried))
    assert [point.amount for point in points] == sorted(tried)
    for sign, most in ((-1, CASES[0].below), (1, CASES[0].above)):
        for expected, few in ((some, 0), (many, FEW)):
            found = first_late(points, sign, few)
            if expected > most:
                assert found is None
            else:
                assert expected <= sign * found <= max(expected * (1 + 1 / 16), expected + CASES[0].least / 16)


def test_where_the_right_model_is_late_already_the_doublings_are_tried_all_the_same() -> None:
    points = curve(lambda amount: Point(amount, Late(250, 9, None), Late(250, 0, None), 0.0), CASES[2])
    assert [point.amount for point in points] == sorted([*CASES[2].amounts(-1), 0.0, *CASES[2].amounts(1)])
    assert first_late(points, 1, FEW) == 0.0


def test_the_drive_does_not_engage_a_gear_where_the_plant_has_a_final_drive_six_percent_smaller() -> None:
    assert set(tolerance.other_plant(-0.06).trace.true_location) == {"qN"}
