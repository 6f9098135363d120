"""The tracker against the definition, on random systems with signatures that come late or with their output."""

import random
from collections.abc import Iterable, Iterator

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.des.automaton import DES
from deshybrid.observer.online import RESTART
from deshybrid.observer.tracker import Tracker, build_tracker
from tests.strategies import random_plan

Belief = frozenset[tuple[str, str | None]]  # (location entered, signature still due)


def silent_closure(des: DES, locations: Iterable[str]) -> set[str]:
    """All locations that invisible transitions lead to, by the definition of ⇒ε*."""
    closed = set(locations)
    while True:
        more = {t.target for t in des.transitions if t.source in closed and None in t.seen} - closed
        if not more:
            return closed
        closed |= more


def believe_output(des: DES, belief: Belief, gamma: str | None) -> Belief:
    """Every visible transition with this γ, after any invisible ones; its signature, if any, is due from now."""
    sources = silent_closure(des, (location for location, due in belief if due is None))
    return frozenset(
        (t.target, t.signature)
        for t in des.transitions
        if t.source in sources and gamma in t.outputs and (gamma is not None or t.signature is not None)
    )


def believe_signature(des: DES, belief: Belief, signature: str) -> Belief:
    """The signature was due, or an unmarked γ came with it at the same moment."""
    silent = believe_output(des, belief, None)
    due = {(location, None) for location, wait in belief if wait == signature}
    return frozenset(due | {(location, None) for location, wait in silent if wait == signature})


def random_run(rng: random.Random, des: DES, length: int) -> Iterator[tuple[str | None, str | None, str]]:
    """What is seen, transition by transition: γ, s, and the location that is entered."""
    location = rng.choice(des.initial)
    for _ in range(length):
        taken = rng.choice([t for t in des.transitions if t.source == location])
        location = taken.target
        yield rng.choice(taken.outputs), taken.signature, location


class Follower:
    """The tracker as the reference step uses it, without residuals: a signature is heard where it is listened for."""

    def __init__(self, tracker: Tracker, des: DES) -> None:
        self.tracker, self.des, self.state = tracker, des, tracker.initial

    def event(self, name: str) -> bool:
        target = self.tracker.states[self.state].on_event[self.tracker.event_names.index(name)]
        self.state = target if target >= 0 else self.tracker.restart_on_event[self.tracker.event_names.index(name)]
        return target >= 0

    def signature(self, name: str) -> bool:
        number = self.tracker.signature_names.index(name)
        heard = [c.target for c in self.tracker.states[self.state].candidates if c.signature == number]
        self.state = heard[0] if heard else self.state
        return bool(heard)

    def silence(self) -> None:
        target = self.tracker.states[self.state].timeout_target
        assert target != RESTART
        self.state = target if target >= 0 else self.state

    @property
    def estimate(self) -> set[str]:
        return {self.des.locations[place] for place in self.tracker.states[self.state].entry_estimate}


def assert_follows(rng: random.Random) -> None:
    """After every output, late signature and window of silence, the estimate is what the definition says."""
    plan = random_plan(rng)
    des = plan.complementary
    assert des is not None
    follower = Follower(build_tracker(plan), des)
    belief: Belief = frozenset((location, None) for location in des.initial)
    entered = None
    for gamma, signature, location in random_run(rng, des, 12):
        if gamma is None and signature is None:
            continue
        entered = location
        if gamma is not None:
            assert follower.event(gamma)
            belief = believe_output(des, belief, gamma)
            assert follower.estimate == {place for place, _ in belief}
            assert entered in follower.estimate
        if signature is not None:
            follower.signature(signature)
            belief = believe_signature(des, belief, signature)
        elif rng.random() < 0.5:
            follower.silence()
            belief = frozenset(pair for pair in belief if pair[1] is None)
        else:
            continue
        assert entered in follower.estimate
        assert follower.estimate == {place for place, due in belief if due is None}


@pytest.mark.parametrize("start", range(0, 2000, 500))
def test_tracker_equals_the_set_of_locations_that_explain_outputs_and_late_signatures(start: int) -> None:
    for seed in range(start, start + 500):
        assert_follows(random.Random(seed))


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**9))
def test_entry_estimate_contains_the_plant_location_after_every_output_and_signature(seed: int) -> None:
    assert_follows(random.Random(seed))


def assert_events_follow(rng: random.Random) -> None:
    """The same where signatures come as events, alone or together with their output."""
    plan = random_plan(rng)
    des = plan.complementary
    assert des is not None
    follower = Follower(build_tracker(plan, signatures_are_events=True), des)
    belief: Belief = frozenset((location, None) for location in des.initial)
    for gamma, signature, entered in random_run(rng, des, 12):
        together = gamma is not None and signature is not None and rng.random() < 0.5
        tokens = [f"{gamma},{signature}"] if together else [name for name in (gamma, signature) if name is not None]
        for token in tokens:
            assert follower.event(token)
        if gamma is not None:
            belief = believe_output(des, belief, gamma)
        if signature is not None:
            belief = believe_signature(des, belief, signature)
        if tokens:
            assert entered in follower.estimate
            assert follower.estimate == {place for place, _ in belief}


@pytest.mark.parametrize("start", range(0, 1000, 500))
def test_signatures_that_come_as_events_are_followed_just_as_well(start: int) -> None:
    for seed in range(start, start + 500):
        assert_events_follow(random.Random(seed))
