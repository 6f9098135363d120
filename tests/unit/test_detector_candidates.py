"""Which signatures the dynamics allow."""

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.signatures import recover_observability
from deshybrid.detector.candidates import (
    FeasibleCandidate,
    alternatives,
    discrete_candidates,
    feasibility,
    signature_candidates,
    signature_name,
)
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import loads

HEAD = """\
format: deshybrid/1
name: small
time: continuous
state: [x1, x2]
output: [y]
defaults: {C: [[1, 0]]}
"""
SLOW, FAST = "[[0, 1], [-1, -1]]", "[[0, 1], [-9, -1]]"


def model(locations: str, transitions: str, rest: str = "") -> str:
    return f"{HEAD}locations: {{{locations}}}\ntransitions: [{transitions}]\n{rest}"


def candidates_of(text: str) -> dict[str, FeasibleCandidate]:
    system = loads(text)
    return {entry.location: entry for entry in signature_candidates(system, abstract(system))}


BOTH = "{from: p, to: q, event: a, emits: null}, {from: q, to: p, event: b, emits: null}"


def test_locations_without_a_common_mode_always_show_against_each_other() -> None:
    found = candidates_of(model(f"p: {{A: {SLOW}}}, q: {{A: {FAST}}}", BOTH))
    assert [entry.candidate.transitions for entry in found.values()] == [(1,), (0,)]
    assert {verdict.residual for entry in found.values() for verdict in entry.verdicts} == {"always"}


def test_locations_with_a_common_mode_show_unless_only_that_one_moves() -> None:
    """Modes -1, -2 against -1, -3: the outputs agree where both decay like e^-t."""
    found = candidates_of(model("p: {A: [[0, 1], [-2, -3]]}, q: {A: [[0, 1], [-3, -4]]}", BOTH))
    assert found["q"].feasibility("residual", (0,)) == "generic"


def test_equal_dynamics_are_never_told_apart_and_the_transition_is_left_out_with_a_reason() -> None:
    found = candidates_of(model(f"p: {{A: {SLOW}}}, q: {{A: {SLOW}}}", BOTH))
    for entry in found.values():
        assert entry.candidate.transitions == ()
        assert [verdict.residual for verdict in entry.excluded] == ["never"]
        assert "partner" in entry.excluded[0].reason


def test_only_rivals_with_a_common_output_count() -> None:
    """q and r have equal dynamics; from p they are told apart by their outputs, so both are feasible there."""
    locations = f"p: {{A: {SLOW}}}, q: {{A: {FAST}}}, r: {{A: {FAST}}}"
    back = "{from: q, to: p, event: c, emits: γ}, {from: r, to: p, event: c, emits: γ}"
    apart = "{from: p, to: q, event: a, emits: α}, {from: p, to: r, event: b, emits: β}, "
    alike = "{from: p, to: q, event: a, emits: α}, {from: p, to: r, event: b, emits: [α, β]}, "
    assert candidates_of(model(locations, apart + back))["q"].candidate.transitions == (0,)
    assert candidates_of(model(locations, alike + back))["q"].candidate.transitions == ()


def test_alternatives_are_to_stay_and_to_go_elsewhere_with_the_same_output() -> None:
    des = DES.from_transitions([("1", "a", "2", None), ("1", "b", "3", None), ("1", "c", "3", "α")])
    assert alternatives(des, des.transitions[0]) == ("1", "3")
    assert alternatives(des, des.transitions[2]) == ("1",)


@pytest.mark.parametrize(
    ("reset", "verdict"),
    [
        ("", "never"),
        (", reset: {matrix: [[1, 0], [0, 1]], offset: [0, 0]}", "never"),
        (", reset: {matrix: [[1, 0], [0, 1]], offset: [0, 2]}", "always"),
        (", reset: {matrix: [[0.5, 0], [0, 1]], offset: [0, 0]}", "generic"),
    ],
)
def test_a_self_loop_shows_only_by_a_reset_that_the_outputs_see(reset: str, verdict: str) -> None:
    found = candidates_of(model(f"p: {{A: {SLOW}}}", f"{{from: p, to: p, event: a, emits: null{reset}}}"))
    (only,) = found["p"].verdicts
    assert (only.residual, only.negation) == (verdict, "never")
    assert found["p"].candidate.transitions == (() if verdict == "never" else (0,))


def test_a_reset_of_a_state_that_no_output_shows_is_not_seen() -> None:
    hidden = "[[-1, 0], [0, -2]]"
    loop = "{from: p, to: p, event: a, emits: null, reset: {matrix: [[1, 0], [0, 1]], offset: [0, 5]}}"
    assert candidates_of(model(f"p: {{A: {hidden}}}", loop))["p"].verdicts[0].residual == "never"


def test_negation_needs_only_that_the_others_are_large_in_the_location() -> None:
    """q stands still, as p does where x2 = 0: p explains all that q does, but not the other way round."""
    text = model("p: {A: [[0, 1], [0, -1]]}, q: {A: [[0, 0], [0, -1]]}", BOTH)
    p_entered, q_entered = candidates_of(text)["p"].verdicts[0], candidates_of(text)["q"].verdicts[0]
    assert (q_entered.residual, q_entered.negation) == ("never", "never")
    assert (p_entered.residual, p_entered.negation) == ("never", "generic")
    entry = candidates_of(text)["p"].candidate
    assert (entry.transitions, entry.residual, entry.negation) == ((1,), False, True)


def test_the_model_restricts_prices_and_forbids() -> None:
    rest = "signatures: {candidates: {q: {cost: 3, by: negation}, p: {by: residual}}, forbid: [[p, q]]}"
    found = candidates_of(model(f"p: {{A: {SLOW}}}, q: {{A: {FAST}}}", BOTH, rest))
    q, p = found["q"].candidate, found["p"].candidate
    assert (q.transitions, q.cost, q.residual, q.negation) == ((), 3.0, False, True)
    assert (p.transitions, p.cost, p.residual, p.negation) == ((1,), 1.0, True, False)
    assert found["q"].verdicts == ()


def test_a_discrete_model_knows_nothing_and_leaves_nothing_out() -> None:
    des = DES.from_transitions([("1", "a", "1", None), ("1", "b", "2", None), ("2", "c", "1", "α")])
    found = discrete_candidates(des)
    assert [entry.candidate.transitions for entry in found] == [(0, 2), (1,)]
    assert {verdict.residual for entry in found for verdict in entry.verdicts} == {"unknown"}


def test_a_signature_never_has_the_name_of_an_output() -> None:
    des = DES.from_transitions([("1", "a", "2", "s_2"), ("2", "b", "1", "s_2'")])
    assert signature_name(des, "2") == "s_2''"
    assert signature_name(des, "1") == "s_1"


def test_the_verdict_on_a_signature_is_the_worst_over_its_transitions() -> None:
    des = DES.from_transitions([("1", "a", "2", None), ("2", "b", "1", None)])
    assert feasibility(discrete_candidates(des), "2", "residual", (0,)) == "unknown"
    assert feasibility((), "2", "residual", (0,)) == "never"


def test_candidates_go_straight_into_recovery() -> None:
    system = loads(model(f"p: {{A: {SLOW}}}, q: {{A: {FAST}}}", BOTH))
    des = abstract(system)
    plan = recover_observability(des, tuple(entry.candidate for entry in signature_candidates(system, des)))
    assert plan.recoverable
    assert [signature.name for signature in plan.signatures] == ["s_p", "s_q"]
