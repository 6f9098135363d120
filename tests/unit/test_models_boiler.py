"""A plant whose hidden slow state mimics a location: what the relay makes of it, and what exclusion does."""

from dataclasses import replace
from functools import cache
from pathlib import Path

import pytest

from deshybrid.compiler import compile
from deshybrid.linear.arrays import frozen_array
from deshybrid.model.load import load
from deshybrid.model.system import Decision, Dwell, HybridSystem, Location
from deshybrid.observer.hybrid import HybridObserver
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import EstimateTrace, replay
from deshybrid.simulate.score import score

BOILER = Path(__file__).parents[2] / "models" / "boiler.yaml"


def boiler(decision: Decision, *, shortest_stay: float = 400.0) -> HybridSystem:
    """Shorter stays ask for faster residuals, which the heat store mimics the sooner."""
    system = load(BOILER)
    detector = replace(system.observer.detector, decision=decision)
    stays = Dwell(min=shortest_stay)
    locations = tuple(replace(location, dwell=stays) for location in system.locations)
    return replace(system, locations=locations, observer=replace(system.observer, detector=detector))


@cache
def observer_of(system: HybridSystem) -> HybridObserver:
    made = compile(system)
    assert made.observer is not None
    return made.observer


@cache
def told(decision: Decision, shortest_stay: float) -> EstimateTrace:
    system = boiler(decision, shortest_stay=shortest_stay)
    return replay(observer_of(system), simulate(system, seed=1).trace)


def wrong_share(estimates: EstimateTrace) -> float:
    locations = score(estimates.trace, estimates).locations
    assert locations is not None
    return locations.total.wrong / locations.total.samples


def test_the_relay_stays_with_a_false_name_for_half_of_the_run() -> None:
    assert wrong_share(told("relay", 120.0)) > 0.45


@pytest.mark.parametrize("shortest_stay", [120.0, 400.0])
def test_exclusion_is_wrong_only_in_the_sample_of_a_departure(shortest_stay: float) -> None:
    estimates = told("exclusion", shortest_stay)
    truth = estimates.trace.true_location
    assert truth is not None
    for k, name in enumerate(estimates.location):
        assert name in (None, truth[k], truth[max(0, k - 1)])


def test_exclusion_names_every_stay_with_residuals_that_are_slow_enough() -> None:
    estimates = told("exclusion", 400.0)
    locations = score(estimates.trace, estimates).locations
    assert locations is not None
    assert (locations.total.missed, locations.total.engagements) == (0, 5)
    assert locations.total.right / locations.total.samples > 0.8


def test_exclusion_is_the_default_of_the_model() -> None:
    assert observer_of(load(BOILER)).tables.decision.kind == "exclusion"


def after_leaving(target: Location) -> EstimateTrace:
    """The observer of the boiler on a plant that leaves `off` for a location that the model does not expect there."""
    system = boiler("exclusion")
    jump = replace(system.transitions[0], event="jump", target=target.name)
    known = [location.name for location in system.locations]
    extra = () if target.name in known else (target,)
    options = replace(system.simulation, location="off", requests=((800.0, "jump"),), duration=2000.0)
    plant = replace(
        system,
        locations=(*system.locations, *extra),
        transitions=(*system.transitions, jump),
        simulation=options,
    )
    return replay(observer_of(system), simulate(plant, seed=1).trace)


def test_a_false_name_is_corrected_once_another_location_is_the_only_one_left() -> None:
    """`off` can be left for `low` only, so `low` is named; the plant is in `high`."""
    estimates = after_leaving(boiler("exclusion").location("high"))
    assert estimates.location[799] == "off"
    assert "low" in estimates.location
    assert estimates.location[-1] == "high"


def test_a_name_that_explains_nothing_is_given_up_and_no_other_is_invented() -> None:
    off = boiler("exclusion").location("off")
    assert off.dynamics is not None
    leak = replace(off, name="leak", dynamics=replace(off.dynamics, f=frozen_array([8.0, 0.0], (2,))))
    estimates = after_leaving(leak)
    back = estimates.status.index("inconsistent")
    assert estimates.location[back - 1] == "low"
    assert back - estimates.location.index("low") <= observer_of(boiler("exclusion")).tables.window_ticks
    assert set(estimates.location[back:]) == {None}
    assert set(estimates.status[back + 1 :]) == {"searching"}
