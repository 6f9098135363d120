"""The driveline with a real clutch: its friction, its file, and how a campaign observes it by the coarser model."""

import subprocess
import sys
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

import deshybrid as dh
from deshybrid import campaigns
from deshybrid.diagnostics import UsageError
from deshybrid.simulate.campaign_drives import vary
from deshybrid.simulate.campaign_executor import Here
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.observed import as_observed
from deshybrid.simulate.replay import replay

MODELS = Path(__file__).parents[2] / "models" / "balluchi2012"
J_E, J_P, B_E, STATIC, FINAL = 0.235, 0.015, 0.05, 1.15, 3.74
TEETH = {"1": 3.58, "2": 2.02, "3": 1.35, "4": 0.98, "5": 0.81, "R": -3.31}


@pytest.fixture(scope="module")
def plant():
    return dh.load(MODELS / "clutch.yaml")


@pytest.fixture(scope="module")
def drive(plant):
    """The first gears of the drive, without what the states do not tell: pulsation and torque error."""
    quiet = replace(plant.simulation, unmeasured={}, disturbance={"T_w": plant.simulation.disturbance["T_w"]})
    bounds = replace(plant.bounds, disturbance=None)
    return simulate(replace(plant, simulation=quiet, bounds=bounds), seed=1, duration=7.0, step=0.012)


def rows(drive, kind):
    """Rows of the trace in locations of one kind: gear, state, engine torque."""
    trace = drive.trace
    for name, x, u in zip(trace.true_location, trace.true_state, trace.inputs, strict=True):
        if name.startswith(kind):
            yield name.partition("_")[2], dict(zip(trace.system.state_names, x.tolist(), strict=True)), float(u[0])


def shaft_torque(gear, x):
    """What the shafts take from the primary shaft, from the numbers of the car."""
    tau = 1.0 / (FINAL * TEETH[gear])
    return 6000.0 * tau**2 * x["alpha"] + 80.0 * tau**2 * (x["omega_p"] - x["omega_w"] / tau)


def test_the_model_is_what_its_script_writes():
    call = [sys.executable, str(MODELS / "clutch_model.py")]
    written = subprocess.run(call, capture_output=True, check=True).stdout
    assert written == (MODELS / "clutch.yaml").read_bytes()


def test_a_drive_locks_slips_both_ways_and_opens(drive):
    assert drive.stop is None
    kinds = {switch.target.partition("_")[0] for switch in drive.switches}
    assert kinds >= {"locked", "ahead", "behind", "open"}


def test_a_locked_clutch_turns_as_one_and_carries_no_more_than_static_friction_holds(drive):
    found = list(rows(drive, "locked"))
    assert len(found) > 100
    for gear, x, torque in found:
        assert x["omega_e"] == pytest.approx(x["omega_p"], abs=1e-6)
        through = J_P / (J_E + J_P) * (torque - B_E * x["omega_e"]) + J_E / (J_E + J_P) * shaft_torque(gear, x)
        assert abs(through) <= STATIC * x["c"] + 0.5  # a location is not left within its first millisecond


def test_the_slip_has_the_sign_of_its_location(drive):
    for kind, sign in (("ahead", 1.0), ("behind", -1.0)):
        slips = [sign * (x["omega_e"] - x["omega_p"]) for _, x, _ in rows(drive, kind)]
        assert slips
        assert min(slips) > -1.0  # what a millisecond of the wrong sign makes


def test_a_slipping_clutch_passes_its_capacity_in_the_direction_of_the_slip(plant):
    for gear in TEETH:
        for kind, sign in (("ahead", 1.0), ("behind", -1.0)):
            A = plant.location(f"{kind}_{gear}").dynamics.A
            np.testing.assert_allclose(A[1, 4] * J_E, -sign)
            np.testing.assert_allclose(A[2, 4] * J_P, sign)


def test_locking_keeps_the_angular_momentum_of_engine_and_primary_shaft(plant):
    inertia = np.array([0.0, J_E, J_P, 0.0, 0.0])
    resets = [t.reset.matrix for t in plant.transitions if t.event == "lock"]
    assert len(resets) == 12
    for matrix in resets:
        np.testing.assert_allclose(inertia @ matrix, inertia, rtol=1e-12)


def test_with_the_clutch_locked_it_is_the_driveline_of_the_observer(plant):
    coarse = dh.load(MODELS / "driveline.yaml")
    together = np.array([[1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 0, 1], [0, 0, 0]], dtype=float)
    chosen = together.copy()
    chosen[2] = 0.0
    for gear in TEETH:
        fine = plant.location(f"locked_{gear}").dynamics.A @ together
        same = coarse.location(f"q{gear}").dynamics.A
        np.testing.assert_allclose(chosen.T @ fine, same, rtol=1e-9)
        np.testing.assert_allclose(fine[2], fine[1], rtol=1e-12)


def test_the_truth_of_the_plant_is_told_in_the_words_of_the_observer(plant, drive):
    coarse = dh.load(MODELS / "driveline.yaml")
    trace = as_observed(drive.trace, coarse)
    for fine, said in zip(drive.trace.true_location, trace.true_location, strict=True):
        assert said == ("q" + fine.removeprefix("locked_") if fine.startswith("locked") else "qN")
    assert trace.inputs[:, 0].tolist() == drive.trace.inputs[:, 0].tolist()
    columns = [plant.state_names.index(name) for name in coarse.state_names]
    assert trace.true_state.tolist() == drive.trace.true_state[:, columns].tolist()


def test_a_plant_that_lacks_a_channel_or_names_an_unknown_location_is_refused(plant):
    tank = dh.load("models/two_tank.yaml")
    with pytest.raises(UsageError, match="DH0725") as missing:
        campaigns.prepare(tank, campaigns.Wishes(), plant=plant)
    assert {d.code for d in missing.value.diagnostics} == {"DH0725", "DH0726"}


def finer_tank():
    """The tank with a second way to fill, which counts as filling."""
    tank = dh.load("models/two_tank.yaml")
    again = replace(tank.location("fill"), name="refill", observed_as="fill")
    moves = [replace(t, target="refill") if t.target == "fill" else t for t in tank.transitions]
    moves += [replace(t, source="refill") for t in tank.transitions if t.source == "fill"]
    return replace(tank, name="finer", locations=(*tank.locations, again), transitions=tuple(moves))


def test_a_campaign_on_a_finer_plant_scores_by_the_locations_of_the_model():
    wishes = campaigns.Wishes(engagements=4, seed=2, duration=6.0)
    prepared = campaigns.prepare("models/two_tank.yaml", wishes, plant=finer_tank())
    done = campaigns.carry_out(prepared, prepared.task, Here())
    assert {e.location for _, e in done.engagements} == {"fill", "drain"}
    assert prepared.header["plant"] != campaigns.prepare("models/two_tank.yaml", wishes).header["plant"]


def test_the_observer_of_another_model_is_scored_on_the_same_drives():
    tank = dh.load("models/two_tank.yaml")
    slow = replace(tank, name="slow", observer=replace(tank.observer, poles={"fill": (-2.0, -2.5)}))
    wishes = campaigns.Wishes(engagements=4, seed=2, duration=6.0)
    prepared = campaigns.prepare(tank, wishes, against=[slow, replace(tank, name="twin")])
    done = campaigns.carry_out(prepared, prepared.task, Here())
    assert [name for name, _ in done.task.detectors] == ["observer", "slow", "twin"]
    assert done.drives[0].namings[0] == done.drives[0].namings[2]
    turned = replace(tank, locations=tank.locations[::-1])
    with pytest.raises(UsageError, match="DH0727"):
        campaigns.prepare(tank, wishes, against=[turned])


def test_the_pace_of_a_drive_stretches_all_its_times_alike(plant):
    paced = vary(plant, np.random.default_rng(5)).simulation
    factor = paced.duration / plant.simulation.duration
    assert 0.9 <= factor <= 1.1
    for (time, event), (before, asked) in zip(paced.requests, plant.simulation.requests, strict=True):
        assert (time, event) == (pytest.approx(before * factor), asked)
    for name in ("T_e", "clutch"):
        times = [time for time, _ in paced.input[name].points]
        np.testing.assert_allclose(times, [time * factor for time, _ in plant.simulation.input[name].points])
    assert all(before <= after for (before, _), (after, _) in pairwise(paced.requests))


def test_an_observer_that_is_told_the_lever_names_no_gear_in_which_it_is_not(plant):
    made = dh.compile(MODELS / "driveline_lever.yaml")
    trace = as_observed(simulate(plant, seed=2, duration=12, step=0.012).trace, made.observer.system)
    assert set(trace.commands) == {("1",), ("2",), ("3",)}
    named, window = replay(made.observer, trace).location, made.observer.tables.window_ticks
    entered = [k for k in range(1, len(trace)) if named[k] not in (named[k - 1], None, "qN")]
    assert len(entered) >= 2
    for k in entered:
        assert named[k] in {f"q{lever}" for (lever,) in trace.commands[max(k - window, 0) : k + 1]}
