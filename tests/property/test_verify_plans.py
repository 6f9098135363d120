"""The verifier of plans: it proves what `recover` writes, and refuses every plan that is not right."""

import copy
import json
import random
from collections.abc import Callable
from fractions import Fraction
from itertools import chain, combinations
from typing import Any

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate
from deshybrid.des.signatures import recover_observability
from deshybrid.diagnostics import UsageError
from deshybrid.emit.records import plan_parts, recover_record
from deshybrid.verify import verify_plan
from deshybrid.verify.hitting import costs_at_least
from tests.strategies import commanded, random_candidates, random_des, random_detectors

Tree = dict[str, Any]


def written(des: DES, candidates: tuple[Candidate, ...], *, rounds: int = 10_000) -> Tree:
    """What `recover --json` writes, as a reader sees it."""
    plan = recover_observability(des, candidates, max_rounds=rounds)
    record = recover_record(plan, {signature.name: "unknown" for signature in plan.signatures})
    tree: Tree = json.loads(json.dumps(record))
    return tree


def plans(count: int, *, commands: bool = False) -> list[Tree]:
    """Plans of random systems that need something, some with initial locations and detectors."""
    found, seed = list[Tree](), 0
    while len(found) < count:
        rng = random.Random(seed)
        des = random_des(rng, locations=rng.randint(3, 6), transitions=8)
        des = commanded(rng, des) if commands else des
        tree = written(des, (*random_candidates(rng, des), *random_detectors(rng, des)))
        found += [tree] if tree["recoverable"] and tree["constraints"] else []
        seed += 1
    return found


def test_every_plan_of_random_systems_is_proved() -> None:
    for tree in plans(60):
        report = verify_plan(tree)
        assert report.holds, report


def test_every_plan_with_known_commands_is_proved_and_needs_them() -> None:
    """Without the commands in the file, many a plan that relies on them is refused."""
    refused = 0
    for tree in plans(60, commands=True):
        report = verify_plan(tree)
        assert report.holds, report
        for arc in tree["system"]["transitions"]:
            del arc[4:]
        refused += not verify_plan(tree).holds
    assert refused > 10


def test_a_run_under_a_command_that_does_not_permit_it_forces_nothing() -> None:
    changed = 0
    for tree in plans(20, commands=True):
        for constraint in tree["constraints"]:
            if constraint["condition"] == "C2" and all(len(run[-1]) > 2 for run in constraint["runs"]):
                for run in constraint["runs"]:
                    run[-1][2] = "never"
                changed += 1
                assert "its runs force it" in str(verify_plan(tree))
                break
    assert changed > 5


def test_a_plan_that_a_limit_has_left_open_is_proved_with_its_gap() -> None:
    for seed in range(40):
        rng = random.Random(seed)
        des = random_des(rng, transitions=8)
        tree = written(des, random_candidates(rng, des), rounds=0)
        if tree["recoverable"]:
            assert verify_plan(tree).holds


def cheaper(tree: Tree) -> None:
    tree["cost"] += 0.25


def higher_bound(tree: Tree) -> None:
    tree["lower_bound"] += 0.25


def no_proof(tree: Tree) -> None:
    tree["constraints"] = []


def one_signature_less(tree: Tree) -> None:
    gone = tree["signatures"].pop()
    del tree["instrumented"][gone["name"]]


def a_narrower_constraint(tree: Tree) -> None:
    widest = max(tree["constraints"], key=lambda c: len(c["transitions"]) + len(c["detectors"]))
    (widest["transitions"] or widest["detectors"]).pop()


def another_output(tree: Tree) -> None:
    tree["constraints"][0]["runs"][0][0][1] = "never"


def a_jump(tree: Tree) -> None:
    run = next(c["runs"][0] for c in tree["constraints"] if len(c["runs"][0]) > 1)
    arcs = tree["system"]["transitions"]
    leading = [n for n, arc in enumerate(arcs) if arc[2] != arcs[run[1][0]][0]]
    run[0][0] = leading[0] if leading else len(arcs) - 1
    run[0][1] = arcs[run[0][0]][3][0]
    if not leading:
        no_cycle(tree)


def no_cycle(tree: Tree) -> None:
    tree["constraints"][0]["cycles"][0] = [0, 0]


def another_generator(tree: Tree) -> None:
    tree["generator_names"] = []


def a_cheaper_candidate(tree: Tree) -> None:
    for candidate in tree["candidates"]:
        candidate["cost"] /= 2


TAMPERED: dict[Callable[[Tree], None], str] = {
    cheaper: "`cost` is what they cost",
    higher_bound: "`optimal`",
    no_proof: "every plan costs",
    one_signature_less: "the location becomes known",
    a_narrower_constraint: "its runs force it",
    another_output: "shows what its transitions cannot show",
    a_jump: "its runs force it",
    no_cycle: "a run has no cycle",
    another_generator: "cannot be emitted",
    a_cheaper_candidate: "`cost` is what they cost",
}


@pytest.mark.parametrize("tamper", TAMPERED, ids=lambda tamper: tamper.__name__)
def test_a_tampered_plan_is_refused_with_the_reason(tamper: Callable[[Tree], None]) -> None:
    refused = 0
    for tree in plans(12):
        if tree["cost"] == 0 or not tree["signatures"]:
            continue
        changed = copy.deepcopy(tree)
        tamper(changed)
        report = verify_plan(changed)
        if any(TAMPERED[tamper] in check.inequality for check in report.refused):
            refused += 1
        else:
            assert not report.holds
    assert refused > 0


def test_a_plan_for_another_model_is_refused() -> None:
    rng = random.Random(3)
    des = random_des(rng, transitions=8)
    tree = plans(1)[0]
    refused = verify_plan(tree, plan_parts(des, random_candidates(rng, des))).refused
    assert {check.location for check in refused} == {"system", "candidates"}
    assert verify_plan(tree, {"system": tree["system"], "candidates": tree["candidates"]}).holds


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("recoverable",), False),
        (("cost",), None),
        (("cost",), True),
        (("generators",), -1),
        (("system",), []),
        (("system", "transitions", 0, 0), "nowhere"),
        (("candidates", 0, "cost"), -1.0),
        (("candidates", 0, "transitions"), [1000]),
        (("signatures", 0, "name"), "unknown"),
        (("constraints", 0, "runs", 0, 0), [0]),
        (("constraints", 0, "cycles", 0), [1, 2, 3]),
    ],
)
def test_a_malformed_plan_is_a_coded_message(path: tuple[str | int, ...], value: object) -> None:
    tree = copy.deepcopy(plans(1)[0])
    place: Any = tree
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    with pytest.raises(UsageError) as caught:
        verify_plan(tree)
    assert caught.value.diagnostics[0].code == "DH0408"


def test_the_lower_bound_is_that_of_brute_force() -> None:
    """Random prices, demands with ways of one or two generators: the least cost over all subsets."""
    for seed in range(60):
        rng = random.Random(seed)
        names = "abcdef"[: rng.randint(2, 6)]
        prices = {name: Fraction(rng.choice([0, 1, 1, 2, 3]), rng.choice([1, 2])) for name in names}
        demands = [
            frozenset(frozenset(rng.sample(names, rng.randint(1, 2))) for _ in range(rng.randint(1, 3)))
            for _ in range(rng.randint(1, 6))
        ]
        subsets = chain.from_iterable(combinations(names, size) for size in range(len(names) + 1))
        least = min(
            sum((prices[name] for name in chosen), Fraction())
            for chosen in subsets
            if all(any(way <= set(chosen) for way in demand) for demand in demands)
        )
        assert costs_at_least(prices, demands, least)
        assert not costs_at_least(prices, demands, least + Fraction(1, 7))
