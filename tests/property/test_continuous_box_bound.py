"""Ultimate bounds of designs whose locations determine the state only together: never left, and near the worst runs."""

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from deshybrid.continuous.determinability_design import determined, gains_alone_or_together
from deshybrid.continuous.error import error_dynamics
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.ultimate import UltimateBound, drive_of
from deshybrid.continuous.ultimate_box import ultimate_bound_in_box
from deshybrid.linear.sampling import flow_and_integral, sample_dynamics
from deshybrid.model.load import load
from deshybrid.model.system import HybridSystem

NAMES = ("q1", "q2", "q3")
Case = tuple[HybridSystem, ObserverGains, UltimateBound]


def bounded(system: HybridSystem, step: float = 0.05) -> Case:
    gains, stays = gains_alone_or_together(system, NAMES, rate=None, dwell=None, method="place")
    together = determined(system, gains, stays, step=step)
    assert together is not None
    return system, gains, ultimate_bound_in_box(system, gains, together.certificates[0])


@pytest.fixture(scope="module")
def ring() -> Case:
    return bounded(load("models/balluchi2003/three_locations.yaml"))


def reached(case: Case, width: float, stays: tuple[int, ...], last: int) -> np.ndarray:
    """The worst errors at the end of a run with these stays, in cells, round and round; signals held over each cell."""
    system, gains, _ = case
    matrices, drives = error_dynamics(system, gains.gains).matrices, {n: drive_of(system, gains, n) for n in NAMES}
    steps = {n: (matrices[n], drives[n]) for n in NAMES}
    if system.time_step is None:
        steps = {n: flow_and_integral(matrices[n], drives[n], width) for n in NAMES}
    largest = np.zeros(4)
    for end in range(3):
        rows, total = np.eye(4), np.zeros(4)
        for back in range(12):
            flow, push = steps[NAMES[(end - back) % 3]]
            for _ in range(stays[back % len(stays)] if back else last):
                total, rows = total + np.abs(rows @ push).sum(axis=1), rows @ flow
        largest = np.maximum(largest, total)
    return largest


def worst_runs(case: Case, width: float, choices: tuple[float, ...]) -> np.ndarray:
    cells = [round(choice / width) for choice in choices]
    ends = [round(end / width) for end in (0.0, 0.4, 1.5, 7.0)]
    return np.asarray(
        np.max([reached(case, width, stays, end) for stays in product(cells, repeat=3) for end in ends], axis=0)
    )


def test_no_worst_run_of_the_ring_leaves_its_bound_and_the_bound_is_near(ring: Case) -> None:
    worst = worst_runs(ring, 0.1, (1.5, 7.0))
    assert ring[2].by_state is not None
    assert (worst <= ring[2].by_state).all()
    assert np.median(ring[2].by_state / worst) <= 2.0


def test_in_discrete_time_no_worst_run_leaves_the_bound() -> None:
    system = load("models/balluchi2003/three_locations.yaml")
    places = []
    for place in system.locations:
        assert place.dynamics is not None
        places.append(replace(place, dynamics=sample_dynamics(place.dynamics, 0.25)))
    case = bounded(replace(system, locations=tuple(places), time_step=0.25), 0.25)
    assert case[2].by_state is not None, case[2].reason
    worst = worst_runs(case, 0.25, (1.5, 7.0))
    assert (worst <= case[2].by_state).all()
    assert np.median(case[2].by_state / worst) <= 2.0


def test_without_a_bound_of_what_disturbs_there_is_none_and_with_zeros_it_is_zero() -> None:
    system = load("models/balluchi2003/three_locations.yaml")
    gains, stays = gains_alone_or_together(system, NAMES, rate=None, dwell=None, method="place")
    together = determined(system, gains, stays, step=0.05)
    assert together is not None
    silent = replace(system.bounds, disturbance=np.zeros(4), measurement=np.zeros(1))
    bounds = (silent, replace(system.bounds, disturbance=None))
    quiet, unknown = (
        ultimate_bound_in_box(replace(system, bounds=each), gains, together.certificates[0]) for each in bounds
    )
    assert quiet.value == 0.0
    assert unknown.value is None
    assert "disturbance" in unknown.reason
