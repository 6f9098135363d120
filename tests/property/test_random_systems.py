"""What the seeded random systems are like: comparisons on trivial systems only would say little."""

import random
from collections import Counter

from deshybrid.des.automaton import DES
from tests import naive_des as naive
from tests.strategies import random_des

SYSTEMS = 2000


def traits(des: DES) -> dict[str, bool]:
    arcs = des.transitions
    silent = [t for t in arcs if None in t.seen]
    ends = [(t.source, t.target) for t in arcs]
    reached = naive.reachable(des.initial, ends)
    shown = Counter((t.source, seen) for t in arcs for seen in t.seen if seen is not None)
    return {
        "one location may be initial": len(des.initial) == 1,
        "several locations may be initial": len(des.initial) > 1,
        "not all locations are initial": len(des.initial) < len(des.locations),
        "a location cannot be reached": reached < set(des.locations),
        "a run ends": bool(reached - {t.source for t in arcs}),
        "a location follows itself": any(t.source == t.target for t in arcs),
        "a location follows itself in silence": any(t.source == t.target for t in silent),
        "a third of the transitions may be silent": len(silent) * 3 >= len(arcs) > 0,
        "silence can go round": bool(
            naive.reachable_from_cycles(des.locations, [(t.source, t.target) for t in silent])
        ),
        "a transition shows one of several things": any(len(set(t.outputs)) > 1 for t in arcs),
        "a transition shows something or nothing": any(None in t.seen and set(t.seen) != {None} for t in arcs),
        "an output does not tell where it leads": max(shown.values(), default=0) > 1,
        "two transitions join the same locations": len(set(ends)) < len(ends),
        "nothing moves": not arcs,
    }


def test_the_random_systems_have_silence_dead_ends_self_loops_and_several_initial_locations() -> None:
    counts: Counter[str] = Counter()
    for seed in range(SYSTEMS):
        counts.update(trait for trait, there in traits(random_des(random.Random(seed))).items() if there)
    assert len(counts) == len(traits(random_des(random.Random(0))))
    print(counts)
    assert min(counts.values()) >= SYSTEMS // 100, counts
