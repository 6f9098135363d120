"""Detectability, faults and secrets on systems small enough to check by hand, and at their limits."""

from collections.abc import Callable

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.detectability import (
    strong_detectability,
    strong_periodic_detectability,
    weak_detectability,
    weak_periodic_detectability,
)
from deshybrid.des.faults import diagnosability, predictability
from deshybrid.des.opacity import current_state_opacity, initial_state_opacity
from deshybrid.diagnostics import LimitReached, UsageError

Rows = list[tuple[str, str, str, str | None]]
ROUND: Rows = [("1", "a", "2", "α"), ("2", "b", "1", "β")]


def kth_from_the_end(k: int) -> DES:
    """Its observer has a state for every set of the last k outputs: 2^k."""
    rows: Rows = [("s", "a", "s", "α"), ("s", "b", "s", "β"), ("s", "a", "0", "α")]
    rows += [(str(i), event, str(i + 1), output) for i in range(k) for event, output in (("a", "α"), ("b", "β"))]
    return DES.from_transitions([*rows, (str(k), "r", "s", "γ")], initial=["s"])


def test_a_round_with_its_own_output_at_each_step_is_detectable_in_every_sense() -> None:
    des = DES.from_transitions(ROUND)
    assert strong_detectability(des).holds
    assert weak_detectability(des).holds
    assert strong_periodic_detectability(des).holds
    assert weak_periodic_detectability(des).holds


def test_a_system_without_endless_words_is_strongly_but_not_weakly_detectable() -> None:
    des = DES.from_transitions([("1", "a", "2", "α")])
    assert strong_detectability(des).holds
    assert strong_periodic_detectability(des).holds
    assert not weak_detectability(des).holds
    assert not weak_periodic_detectability(des).holds


def test_a_silent_exit_makes_an_estimate_of_two_although_the_entry_is_known() -> None:
    des = DES.from_transitions([("1", "a", "2", "α"), ("2", "s", "3", None), ("3", "b", "1", "β")], initial=["1"])
    assert not strong_detectability(des).holds
    assert not weak_detectability(des).holds
    report = weak_periodic_detectability(des)
    assert str(report.word) == "(α β)*"
    assert strong_periodic_detectability(des).holds


def test_the_strong_forms_never_need_the_observer() -> None:
    des = kth_from_the_end(40)
    assert not strong_detectability(des).holds
    assert not strong_periodic_detectability(des).holds
    with pytest.raises(LimitReached, match="DH0901: there are more than 1000 observer states"):
        weak_detectability(kth_from_the_end(12), max_states=1000)
    with pytest.raises(LimitReached, match="DH0901: there are more than 100 pairs of states"):
        strong_detectability(des, max_pairs=100)


def test_a_fault_that_shows_late_is_diagnosable_and_one_that_never_shows_is_not() -> None:
    rows: Rows = [("1", "f", "2", None), ("2", "a", "3", "α"), ("3", "a", "4", "α"), ("4", "c", "4", "γ")]
    rows += [("1", "a", "1", "α")]
    assert diagnosability(DES.from_transitions(rows, initial=["1"]), faults=["f"]).holds
    report = diagnosability(DES.from_transitions([*rows, ("4", "a", "4", "α")], initial=["1"]), faults=["f"])
    assert report.witness is not None
    assert report.witness.repeated == (2, 3)


def test_a_fault_before_a_silent_cycle_is_never_diagnosed() -> None:
    rows: Rows = [("1", "f", "2", None), ("2", "s", "2", None), ("1", "a", "1", "α")]
    report = diagnosability(DES.from_transitions(rows, initial=["1"]), faults="f")
    assert report.witness is not None
    assert [step.event for step in report.witness.runs[0]] == ["", "f", "s"]
    assert [step.event for step in report.witness.runs[1]] == [""]


def test_a_fault_that_ends_every_run_is_diagnosable_and_one_without_warning_is_not_predictable() -> None:
    des = DES.from_transitions([("1", "f", "2", None), ("1", "a", "1", "α")], initial=["1"])
    assert diagnosability(des, faults=["f"]).holds
    report = predictability(des, faults=["f"])
    assert str(report.witness) == "outputs: none\n1 -f-> 2\n1 -a-> 1"


def test_a_fault_after_a_warning_is_predictable_also_where_other_runs_end_soon() -> None:
    rows: Rows = [("1", "warn", "2", "ω"), ("2", "f", "3", None), ("1", "a", "1", "α"), ("1", "warn", "4", "ω")]
    assert predictability(DES.from_transitions(rows, initial=["1"]), faults=["f"]).holds
    assert not predictability(DES.from_transitions([*rows, ("4", "b", "4", "β")], initial=["1"]), faults=["f"]).holds


def test_a_fault_that_no_transition_has_is_refused_by_name() -> None:
    for ask in (diagnosability, predictability):
        with pytest.raises(UsageError, match="DH0420: unknown event `f` in `faults`"):
            ask(DES.from_transitions(ROUND), faults=["f"])
        assert ask(DES.from_transitions(ROUND), faults=[]).holds


def test_a_secret_is_betrayed_at_once_where_every_run_starts_in_it() -> None:
    des = DES.from_transitions(ROUND, initial=["1"])
    assert current_state_opacity(des, secret=["1"]).outputs == ()
    assert initial_state_opacity(des, secret=["1"]).outputs == ()
    assert initial_state_opacity(des, secret=["2"]).opaque
    assert current_state_opacity(des, secret=["2"]).outputs == ("α",)


def test_the_start_stays_secret_while_a_public_one_explains_every_word() -> None:
    rows: Rows = [("s", "a", "1", "α"), ("p", "a", "1", "α"), ("1", "b", "1", "β")]
    assert initial_state_opacity(DES.from_transitions(rows, initial=["s", "p"]), secret=["s"]).opaque
    told = DES.from_transitions([*rows, ("s", "c", "2", "α"), ("2", "d", "2", "δ")], initial=["s", "p"])
    report = initial_state_opacity(told, secret=["s"])
    assert report.outputs == ("α", "δ")
    assert [step.location for step in report.run] == ["s", "2", "2"]


@pytest.mark.parametrize("ask", [current_state_opacity, initial_state_opacity])
def test_a_secret_that_does_not_exist_is_refused_and_a_limit_ends_the_search(ask: Callable[..., object]) -> None:
    with pytest.raises(UsageError, match="DH0404: unknown location `9` in `secret`"):
        ask(DES.from_transitions(ROUND), secret=["9"])
    with pytest.raises(LimitReached, match="DH0901"):
        ask(kth_from_the_end(12), secret=[], max_states=10)
