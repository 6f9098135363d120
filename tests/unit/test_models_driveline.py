"""The driveline of Balluchi et al. (2012), section 5, with numbers: its physics, its verdicts and its drive."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from deshybrid.compiler import compile, design, recover
from deshybrid.model.load import load
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import replay
from deshybrid.simulate.score import score

MODELS = Path(__file__).parents[2] / "models"
DRIVELINE = MODELS / "balluchi2012" / "driveline.yaml"
GEARS = ("q1", "q2", "q3", "q4", "q5", "qR")

MASS_INERTIA = 1390 * 0.307**2 + 4 * 1.0
J_E, B_E, B_W, K_SHAFT, B_SHAFT = 0.25, 0.05, 1.0, 6000.0, 80.0


@pytest.fixture(scope="module")
def system():
    return load(DRIVELINE)


@pytest.fixture(scope="module")
def compilation():
    return compile(DRIVELINE)


@pytest.fixture(scope="module")
def execution(system):
    return simulate(system, seed=1)


@pytest.mark.parametrize("path", sorted(MODELS.rglob("*.yaml")), ids=lambda path: path.stem)
def test_every_model_of_the_project_loads(path):
    assert load(path).locations


@pytest.mark.parametrize("gear", GEARS)
def test_a_gear_loses_energy_only_to_friction_and_the_damper(system, gear):
    """d/dt (j_e ω_e² + j_w ω_w² + k α²)/2 = -b_e ω_e² - b_w ω_w² - b α'²; the entry printed in the paper breaks it."""
    A = system.location(gear).dynamics.A
    tau = -1.0 / A[0, 2]
    k, b = K_SHAFT * tau**2, B_SHAFT * tau**2
    energy = np.diag([k, J_E, MASS_INERTIA])
    twist = A[0]
    friction = np.diag([0.0, B_E, B_W]) + b * np.outer(twist, twist)
    np.testing.assert_allclose((energy @ A + A.T @ energy) / 2, -friction, rtol=1e-9, atol=1e-9 * k)

    printed = A.copy()
    printed[2, 2] = -(tau * B_W + b) / (tau * MASS_INERTIA)
    power = (energy @ printed + printed.T @ energy) / 2
    assert not np.allclose(power, -friction, rtol=1e-3)


def test_reverse_turns_the_wheels_backwards_with_a_positive_spring(system):
    A = system.location("qR").dynamics.A
    assert -1.0 / A[0, 2] == pytest.approx(-1.0 / (3.74 * 3.31))
    assert A[1, 0] < 0.0 < A[0, 1]
    assert A[2, 0] < 0.0


@pytest.mark.parametrize("gear", GEARS)
def test_the_shuffle_of_every_gear_lies_between_two_and_nine_hertz(system, gear):
    poles = np.linalg.eigvals(system.location(gear).dynamics.A)
    assert 2.0 < max(abs(poles)) / (2.0 * np.pi) < 9.0


def test_the_driveline_shows_none_of_its_twelve_transitions(compilation):
    report = compilation.design.recovery.check
    assert not report.current_location_observable
    assert len(report.c1_failures) == 12
    assert report.persistent == ("q1", "q2", "q3", "q4", "q5", "qR", "qN")


def test_seven_signatures_and_six_residual_generators_recover_it():
    plan = recover(DRIVELINE).plan
    assert plan.recoverable
    assert plan.optimal
    assert {signature.location for signature in plan.signatures} == {*GEARS, "qN"}
    assert [signature.location for signature in plan.signatures if signature.by == "negation"] == ["qN"]
    assert plan.generators == GEARS


def test_the_torsion_of_the_open_driveline_is_a_fixed_mode(compilation):
    fixed = compilation.design.gains.fixed_modes
    np.testing.assert_allclose(fixed["qN"], [-K_SHAFT / B_SHAFT], rtol=1e-9)
    assert all(len(fixed[gear]) == 0 for gear in GEARS)


def test_its_certificates_hold_for_the_stated_dwell_time_with_the_delay_of_the_detector(compilation):
    found = compilation.design
    assert found.certified
    assert {certificate.theorem for certificate in found.certificates} >= {"B12-6", "B12-7"}
    assert 0.0 < found.delay < 0.9


def test_the_levels_of_its_relays_are_above_what_the_bounds_allow():
    relays = design("models/balluchi2012/driveline_relay.yaml").detector
    assert relays.decision.kind == "relay"
    assert all(threshold.guaranteed for threshold in relays.thresholds)


def test_the_drive_engages_at_least_ten_gears_and_reverse_and_keeps_every_dwell_time(execution):
    assert execution.stop is None
    assert not execution.pending
    truth = execution.trace.true_location
    entered = [after for before, after in pairwise(truth) if after not in (before, "qN")]
    assert len(entered) >= 12
    assert set(entered) == set(GEARS)
    times = [switch.time for switch in execution.switches]
    assert min(np.diff(times)) >= 0.9 - 1e-9


def test_the_drive_stays_within_the_bounds_that_its_guarantees_assume(system, execution):
    assert np.all(np.abs(execution.trace.true_state) <= system.bounds.state)
    assert np.all(np.abs(execution.trace.inputs) <= system.bounds.input)


@pytest.mark.parametrize("seed", [1, 2])
def test_every_gear_of_the_drive_is_named_within_a_quarter_of_a_second(system, compilation, seed):
    run = simulate(system, seed=seed)
    estimates = replay(compilation.observer, run.trace)
    found = score(run.trace, estimates, only=GEARS).locations
    assert found.total.engagements == 13
    assert found.total.missed == found.total.late == 0
    for true, named in zip(run.trace.true_location, estimates.location, strict=True):
        assert true not in GEARS or named in {true, "qN", None}


@pytest.mark.parametrize("seed", [1, 2])
def test_every_opening_of_the_drive_is_named_within_a_quarter_of_a_second(system, compilation, seed):
    run = simulate(system, seed=seed)
    found = score(run.trace, replay(compilation.observer, run.trace), only=["qN"]).locations
    assert found.total.engagements == 12
    assert found.total.missed == found.total.late == 0
