"""What the messages of a negative verdict tell about cycles, runs and estimates is so, on random systems."""

import random
import re
from collections import Counter
from itertools import pairwise, product

from deshybrid.des.automaton import DES
from deshybrid.des.observability import check_observability
from deshybrid.des.verdicts import verdict_diagnostics
from deshybrid.diagnostics import Diagnostic, render
from tests import naive_des as naive
from tests.strategies import random_des

CYCLE = re.compile(r"`(\w+)` is persistent: (it lies on|it is reached from) the cycle (.*)")
RUN = re.compile(r"after the run (.*) from `(\w+)` the plant is in `(\w+)`, the observer still says \{(.*)\}")


def facts(pattern: re.Pattern[str], message: Diagnostic) -> list[re.Match[str]]:
    return [found for note in message.notes if (found := pattern.fullmatch(note))]


def assert_cycle(des: DES, location: str, lies_on: bool, told: str) -> None:
    places, events = re.split(r" -\w+-> ", told), re.findall(r" -(\w+)-> ", told)
    arcs = {(t.source, t.event, t.target) for t in des.transitions}
    assert {(p, event, q) for (p, q), event in zip(pairwise(places), events, strict=True)} <= arcs
    assert places[0] == places[-1]
    assert (places[0] == location) == (location in places) == lies_on


def estimates_after(des: DES, start: str, events: list[str], end: str) -> set[frozenset[str]]:
    """What an observer can say after runs of these events, whose last one was silent."""
    said: set[frozenset[str]] = set()
    runs = [(start, [frozenset(des.initial)])]
    for place, event in enumerate(events):
        onwards = []
        for (here, estimates), t in product(runs, des.transitions):
            if (t.source, t.event) == (here, event):
                last = place == len(events) - 1
                after = [
                    e if seen is None else naive.entered(des, e, seen)
                    for e in estimates
                    for seen in t.seen
                    if seen is None or not last
                ]
                onwards.append((t.target, after))
        runs = onwards
    for here, estimates in runs:
        if here == end:
            said.update(estimates)
    return said


def test_cycles_and_runs_in_messages_are_those_of_the_system() -> None:
    kinds: Counter[str] = Counter()
    for seed in range(1500):
        des = random_des(random.Random(seed), transitions=8)
        for message in verdict_diagnostics(check_observability(des)):
            assert message.code in render(message)
            for location, how, told in (fact.groups() for fact in facts(CYCLE, message)):
                assert_cycle(des, location, how == "it lies on", told)
                kinds[how] += 1
                kinds["longer cycles"] += told.count("->") > 2
            for events, start, end, estimate in (fact.groups() for fact in facts(RUN, message)):
                assert frozenset(estimate.split(",")) in estimates_after(des, start, events.split(), end)
                kinds["runs"] += 1
    assert len(kinds) == 4
    assert min(kinds.values()) >= 10, kinds
