"""Witnesses of 2,000 random systems and what random damage makes of them: the replay believes just what proves."""

import random
from collections import Counter
from dataclasses import replace

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.observability import check_observability
from deshybrid.des.replay import replay_witness, witness_faults
from deshybrid.des.witness import Step, Witness
from tests import naive_des as naive
from tests.strategies import random_des

BATCH = 500


def damaged(rng: random.Random, des: DES, witness: Witness) -> Witness:
    """One thing changed, often into something else that exists."""
    side = rng.randrange(len(witness.runs))
    run, cycle = witness.runs[side], witness.cycles[side]
    place, outputs = rng.randrange(len(run)), [*witness.outputs]
    arc = rng.choice(des.transitions)
    steps = {
        "another step": [*run[:place], Step(arc.event, arc.target), *run[place + 1 :]],
        "another location": [*run[:place], Step(run[place].event, rng.choice(des.locations)), *run[place + 1 :]],
        "no such step": run[:place] + run[place + 1 :],
        "one step more": [*run, Step(arc.event, arc.target)],
    }
    moved = [cycle[0] + rng.randint(-1, 1), cycle[1] + rng.randint(-1, 1)]
    repeated = [witness.repeated[0] + rng.randint(-1, 1), witness.repeated[1] + rng.randint(-1, 1)]
    word = rng.choice([outputs[:-1], outputs[1:], [*outputs, rng.choice("αβγ")], [rng.choice("αβγ") for _ in outputs]])
    kind = rng.choice([*steps, "cycle", "repeated", "word", "condition", "order", "one run", "twice", "lost cycle"])
    if steps.get(kind):
        both = rng.random() < 0.5  # the second run of C1 is the first one without its last step
        changed = tuple(steps[kind])
        runs = [changed if number == side else other for number, other in enumerate(witness.runs)]
        return replace(witness, runs=(changed, changed[:-1]) if both and len(changed) > 1 else tuple(runs))
    if kind == "cycle":
        cycles = [tuple(moved) if number == side else other for number, other in enumerate(witness.cycles)]
        return replace(witness, cycles=tuple(cycles))
    return {
        "repeated": lambda: replace(witness, repeated=tuple(repeated)),
        "word": lambda: replace(witness, outputs=tuple(word)),
        "condition": lambda: replace(witness, condition="C2" if witness.condition == "C1" else "C1"),
        "order": lambda: replace(witness, runs=witness.runs[::-1], cycles=witness.cycles[::-1]),
        "one run": lambda: replace(witness, runs=witness.runs[:1], cycles=witness.cycles[:1]),
        "twice": lambda: replace(witness, runs=(run, run), cycles=(cycle, cycle)),
        "lost cycle": lambda: replace(witness, cycles=witness.cycles[:-1]),
    }.get(kind, lambda: witness)()


@pytest.mark.parametrize("first", range(0, 2000, BATCH))
def test_the_replay_believes_a_witness_where_it_is_what_its_documentation_says(first: int) -> None:
    kinds: Counter[tuple[str, bool]] = Counter()
    for seed in range(first, first + BATCH):
        rng = random.Random(seed)
        des = random_des(rng)
        for method in ("observer", "pairs"):
            witness = check_observability(des, method=method).witness
            if witness is None:
                continue
            assert naive.proves(des, witness), seed
            assert replay_witness(des, witness)
            for _ in range(8):
                broken = damaged(rng, des, witness)
                if len(broken.cycles) == len(broken.runs) and rng.random() < 0.3:
                    broken = damaged(rng, des, broken)
                assert (witness_faults(des, broken) == ()) == naive.proves(des, broken), (seed, broken)
                kinds[broken.condition, broken != witness and naive.proves(des, broken)] += 1
    assert len(kinds) == 4
    assert min(kinds.values()) > 25, kinds


@pytest.mark.parametrize("condition", ["C1", "C2"])
def test_a_witness_without_runs_or_with_empty_ones_proves_nothing(condition: str) -> None:
    des = random_des(random.Random(0))
    assert witness_faults(des, Witness(condition, (), (), (), (0, 0))) != ()
    assert witness_faults(des, Witness(condition, (), ((), ()), ((0, 0), (0, 1)), (0, 0))) != ()
