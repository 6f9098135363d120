"""The on-line tracker against the text of its rules, and against the table that it makes of itself."""

import random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.des.signatures import SignaturePlan
from deshybrid.emit.vectors import record_vectors
from deshybrid.model.abstraction import discrete_model
from deshybrid.observer.hybrid import command_needs
from deshybrid.observer.online import ANY, NONE, RESTART, OnlineTracker
from deshybrid.observer.tracker import choose_tracker
from tests.lockstep.random_tables import tables_of_plan
from tests.naive_tracker import NaiveTracker, State, event_names
from tests.strategies import random_plan


class Both:
    """The on-line tracker and the naive one, side by side, in the same state."""

    def __init__(self, rng: random.Random, *, as_events: bool, commands: bool = False) -> None:
        self.plan: SignaturePlan = random_plan(rng, negations=True, commands=commands)
        guaranteed = frozenset(name for name in self.plan.des.locations if rng.random() < 0.5)
        self.naive = NaiveTracker(self.plan, as_events=as_events, guaranteed=guaranteed)
        system = discrete_model(self.plan.des)
        self.values = tuple(value for command in system.commands for value in command.values)
        self.allowed = ANY
        made = choose_tracker(
            self.plan,
            signatures_are_events=as_events,
            guaranteed=guaranteed,
            needs=command_needs(system),
            max_states=0,
        )
        self.events, self.signatures = made.event_names, made.signature_names
        assert made.online is not None
        self.online: OnlineTracker = made.online
        self.locations = self.plan.des.locations
        self.due = [signature.name for signature in self.plan.signatures]
        self.mask, self.state = made.initial, self.naive.initial()

    def named(self, mask: int) -> State:
        """A bit mask as the pairs that it stands for."""
        online = self.online
        settled = {(name, None) for q, name in enumerate(self.locations) if mask >> q & 1}
        waiting = {
            (self.locations[q], self.due[s])
            for i, (q, s) in enumerate(online.waiting)
            if mask >> (online.locations + i) & 1
        }
        return frozenset(settled | waiting)

    def allow(self, rng: random.Random) -> None:
        """Choose which commands may have been on."""
        self.allowed = rng.randrange(1, 1 << len(self.values))
        self.naive.allowed = frozenset(value for bit, value in enumerate(self.values) if self.allowed >> bit & 1)

    def compare(self) -> None:
        """Everything that the step may ask of a state."""
        assert self.named(self.mask) == self.state
        location, provisional = self.online.known(self.mask)
        assert (self.locations[location] if location >= 0 else None) == self.naive.location(self.state)
        assert provisional == self.naive.is_provisional(self.state)
        entered = [self.locations[q] for q in self.online.entry_estimate(self.mask)]
        assert set(entered) == self.naive.places(self.state)
        timeout, silence = self.online.timeout(self.mask), self.naive.after_silence(self.state)
        assert {NONE: "wait", RESTART: "inconsistent"}.get(timeout, self.named(max(timeout, 0))) == silence
        names = self.plan.generators
        heard = [
            (self.signatures[s], names[own] if own >= 0 else None, frozenset(names[g] for g in quiet), self.named(to))
            for s, own, quiet, to in self.online.candidates(self.mask, self.allowed)
        ]
        assert heard == [(c.signature, c.active, c.quiet, c.target) for c in self.naive.candidates(self.state)]

    def event(self, number: int) -> bool:
        """Move by an event; where nothing explains it, begin again from what it allows."""
        name = self.events[number]
        target = self.online.after_event(self.mask, number, self.allowed)
        expected = self.naive.after_event(self.state, name)
        assert (target < 0) == (not expected)
        self.mask, self.state = target, expected
        if target < 0:
            self.mask = self.online.restart_on(number, self.allowed)
            self.state = self.naive.after_event(self.naive.everything(), name) or self.naive.everything()
        return target >= 0

    def other(self, rng: random.Random) -> None:
        """Move by a signature that is listened for, or by silence."""
        heard = zip(self.online.candidates(self.mask, self.allowed), self.naive.candidates(self.state), strict=True)
        moves = [(target, candidate.target) for (_, _, _, target), candidate in heard]
        timeout, silence = self.online.timeout(self.mask), self.naive.after_silence(self.state)
        if timeout >= 0 and not isinstance(silence, str):
            moves.append((timeout, silence))
        if moves:
            self.mask, self.state = rng.choice(moves)


def assert_means_the_same(seed: int, *, as_events: bool) -> tuple[int, int]:
    """Return how many events were explained, and how many were not."""
    rng = random.Random(seed)
    both = Both(rng, as_events=as_events)
    assert set(both.events) == event_names(both.naive)
    both.compare()
    explained = [0, 0]
    for _ in range(15):
        if both.events and rng.random() < 0.6:
            explained[not both.event(rng.randrange(len(both.events)))] += 1
        else:
            both.other(rng)
        both.compare()
    return explained[0], explained[1]


@pytest.mark.parametrize("as_events", [False, True])
def test_online_tracker_means_what_its_text_says_on_every_kind_of_token(as_events: bool) -> None:
    explained, unexplained = zip(
        *(assert_means_the_same(seed, as_events=as_events) for seed in range(1000)), strict=True
    )
    assert min(sum(explained), sum(unexplained)) > 1000


@settings(max_examples=100, deadline=None)
@given(st.integers(0, 10**9), st.booleans())
def test_online_tracker_means_what_its_text_says_on_any_system(seed: int, as_events: bool) -> None:
    assert_means_the_same(seed, as_events=as_events)


def estimates(seed: int, *, as_events: bool, max_states: int) -> list[tuple[object, ...]]:
    """All that the step says, and the samples it was given, but not how the tracker numbers its states."""
    tables = tables_of_plan(seed, as_events=as_events, max_states=max_states)
    assert (tables.online is None) == (max_states > 0)
    vectors = record_vectors(tables, seed=seed, count=300, reset_every=120)
    return [
        (repr((v.input, v.output, v.x)), v.event, v.reset, v.location, v.entry_estimate, v.signature, v.status)
        for v in vectors
    ]


@pytest.mark.parametrize("as_events", [False, True])
def test_the_step_says_the_same_with_a_table_and_on_line(as_events: bool) -> None:
    statuses, signatures = set(), set()
    for seed in range(60):
        on_line = estimates(seed, as_events=as_events, max_states=0)
        assert on_line == estimates(seed, as_events=as_events, max_states=100_000)
        statuses |= {estimate[-1] for estimate in on_line}
        signatures |= {estimate[-2] for estimate in on_line}
    assert statuses == set(range(4 if as_events else 5))  # no number, none that is invalid
    assert (len(signatures) > 1) == (not as_events)


def test_a_table_is_made_up_to_the_limit_and_not_beyond() -> None:
    plan = random_plan(random.Random(3))
    made = choose_tracker(plan)
    assert made.online is None
    assert choose_tracker(plan, max_states=len(made.states)).states == made.states
    assert choose_tracker(plan, max_states=len(made.states) - 1).online is not None
