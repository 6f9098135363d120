"""Ultimate bounds are proved by the verifier, and a changed number is refused with the inequality that it breaks."""

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm
from scipy.optimize import linprog

from deshybrid.continuous.document import design_document
from deshybrid.continuous.dwell import certify_dwell
from deshybrid.continuous.gains import ObserverGains, design_gains
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.linear.exact import rational
from deshybrid.linear.exact_inequalities import Motion
from deshybrid.model.load import load
from deshybrid.model.system import Bounds, HybridSystem
from deshybrid.verify import bound, verify_design
from deshybrid.verify.bound_stay import EntrySet, StayBound
from tests.property.test_continuous_bounds import designed, dynamics, random_system
from tests.property.test_continuous_reach import disturbed
from tests.switched import linear, switched

Tree = dict[str, Any]


def document(system: HybridSystem, gains: ObserverGains, delay: float = 0.0) -> Tree:
    certificate = certify_dwell(system, gains, delay=delay)
    tree = design_document(system, gains, [certificate], ultimate_bound(system, gains, delay=delay))
    found: Tree = json.loads(json.dumps(tree))
    return found


@pytest.fixture(scope="module")
def tank() -> Tree:
    system = load("models/two_tank.yaml")
    return document(system, design_gains(system, tuple(place.name for place in system.locations)))


def test_the_bound_of_an_example_is_proved_and_no_longer_among_what_is_not_checked(tank: Tree) -> None:
    report = verify_design(tank)
    assert report.holds, str(report)
    assert "ultimate bound" in {check.certificate for check in report.checks}
    assert not {"`ultimate_bound`", "`ultimate_bound_by_state`"} & set(report.unchecked)


@pytest.mark.parametrize("seed", [0, 1, 6])
def test_every_bound_of_a_random_system_is_proved(seed: int) -> None:
    tree = document(*disturbed(seed))
    assert tree["ultimate_certificate"] is not None
    report = verify_design(tree)
    assert report.holds, str(report)


@pytest.mark.parametrize("seed", [0, 1])
def test_bounds_in_discrete_time_are_proved(seed: int) -> None:
    system = replace(random_system(np.random.default_rng(seed)), time_step=0.1)
    places = tuple(
        replace(place, dynamics=replace(dynamics(system, place.name), A=expm(0.1 * dynamics(system, place.name).A)))
        for place in system.locations
    )
    system = replace(system, locations=places, bounds=Bounds(disturbance=np.array([0.7])))
    tree = document(system, designed(system, 1.0))
    assert tree["ultimate_certificate"] is not None
    report = verify_design(tree)
    assert report.holds, str(report)


def test_the_bound_of_five_states_is_left_unchecked_and_the_rest_is_proved() -> None:
    rng = np.random.default_rng(1)
    A = rng.normal(size=(5, 5)) - 5 * np.eye(5)
    place = linear(A, rng.normal(size=(2, 5)), E=rng.normal(size=(5, 1)))
    loop = [("p", "p", np.eye(5) + 0.1 * rng.normal(size=(5, 5)))]
    system = switched({"p": place}, loop, bounds=Bounds(disturbance=np.array([0.7])))
    tree = document(system, designed(system, 1.0))
    assert tree["ultimate_bound"] > 0
    assert tree["ultimate_certificate"] is None
    report = verify_design(tree)
    assert report.holds, str(report)
    assert "`ultimate_bound`" in report.unchecked


def smaller_bound(tree: Tree) -> None:
    tree["ultimate_bound_by_state"]["h1"] *= 0.5


def smaller_norm(tree: Tree) -> None:
    tree["ultimate_bound"] *= 0.999


def smaller_set(tree: Tree) -> None:
    place = tree["ultimate_certificate"]["locations"]["fill"]
    place["levels"] = [0.9 * level for level in place["levels"]]


def larger_disturbance(tree: Tree) -> None:
    place = tree["ultimate_certificate"]["locations"]["fill"]
    place["disturbance"] = [[1.1 * value for value in row] for row in place["disturbance"]]


def shorter_stay(tree: Tree) -> None:
    tree["ultimate_certificate"]["stay"] *= 0.5


def longer_stay(tree: Tree) -> None:
    tree["ultimate_certificate"]["stay"] *= 1.5


def turned_direction(tree: Tree) -> None:
    tree["ultimate_certificate"]["locations"]["fill"]["directions"][0][1] = 0.5


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (smaller_bound, "no error during a stay exceeds"),
        (smaller_norm, "no less than the norm"),
        (smaller_set, "set of `fill`"),
        (larger_disturbance, "s(d R e^{F t})"),
        (shorter_stay, "set of `drain`"),
        (longer_stay, "no longer than the dwell time"),
        (turned_direction, "its first directions are the states"),
    ],
)
def test_a_changed_number_is_refused_with_the_inequality_that_fails(
    tank: Tree, change: Callable[[Tree], None], said: str
) -> None:
    tree = copy.deepcopy(tank)
    change(tree)
    report = verify_design(tree)
    assert not report.holds
    assert any(said in check.inequality for check in report.refused), str(report)


def test_with_a_detection_delay_the_bound_stays_unchecked() -> None:
    system, gains = disturbed(1)
    wide = replace(system.bounds, state=np.ones(len(system.state_names)), input=np.ones(len(system.input_names)))
    tree = document(replace(system, bounds=wide), gains, delay=1e-3)
    assert tree["ultimate_bound"] is not None
    assert tree["ultimate_certificate"] is None
    assert "`ultimate_bound`" in verify_design(tree).unchecked


def test_what_is_too_large_is_said_to_be_unchecked(tank: Tree, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bound, "LARGEST_WORK", 1000)
    assert any("`ultimate_bound` (too large)" in what for what in verify_design(tank).unchecked)


@pytest.mark.parametrize("seed", range(4))
def test_the_level_of_a_row_is_proved_just_above_the_truth_and_never_below(seed: int) -> None:
    """φ over a fine grid, the support by linear programs: 1 % above is proved, 1 % below is not."""
    rng = np.random.default_rng(seed)
    F = rng.normal(size=(2, 2)) - 2.5 * np.eye(2)
    N, row = rng.normal(size=(2, 1)), rng.normal(size=(1, 2))
    directions, levels = np.vstack([np.eye(2), [[1.0, 1.0]]]), np.array([1.0, 0.7, 1.1])
    entered = EntrySet(rational(directions.tolist()), tuple(map(Fraction, levels)), ((0, 1), (0, 2), (1, 2)))
    stay = StayBound(Motion(rational(F.tolist()), None), rational(N.tolist()), entered)
    start, width, pushed, largest = 0.25, 1 / 1024, 0.0, 0.0
    both = np.vstack([directions, -directions])
    step, middle, moved = expm(F * width), expm(F * width / 2), row
    for k in range(8 * 1024):
        if k * width >= start and k % 32 == 0:
            reach = float(linprog(-moved[0], A_ub=both, b_ub=np.tile(levels, 2), bounds=(None, None)).x @ moved[0])
            largest = max(largest, reach + pushed)
        pushed += float(np.abs(moved @ middle @ N).sum()) * width
        moved = moved @ step
    largest = max(largest, pushed)
    begin = Fraction(start)
    for share, proved in ((1.01, True), (0.99, False)):
        level = [Fraction(largest * share)]
        assert stay.stays_below(rational(row.tolist()), level, [begin], begin) == [proved]


def test_no_norm_is_proved_where_the_error_does_not_decay() -> None:
    entered = EntrySet(rational([[1.0]]), (Fraction(1),), ((0,),))
    assert not StayBound(Motion(rational([[0.0]]), None), rational([[1.0]]), entered).decays()
