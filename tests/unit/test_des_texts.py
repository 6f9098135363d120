"""What the values of the discrete half say of themselves, word by word, and small facts about them."""

from dataclasses import replace

import pytest

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.candidates import Candidate
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.minimum import all_minimum_sets
from deshybrid.des.observability import check_observability
from deshybrid.des.observer import build_location_observer
from deshybrid.des.plan import Constraint, Signature, SignaturePlan
from deshybrid.des.report import C2Failure, ObservabilityReport, Undecided, UndecidedCheck
from deshybrid.des.signatures import recover_observability
from deshybrid.diagnostics import LimitReached, ModelError, Span, diagnostic
from deshybrid.diagnostics.pictured import notebook_picture
from deshybrid.diagnostics.spans import SourceText
from tests.strategies import candidates_everywhere

RING = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")], name="ring")
FORK = DES.from_transitions(
    [("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")], name="fork"
)
PAIR = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")], name="pair")


def report_of(rows: list[tuple[str, str, str, str | None]]) -> ObservabilityReport:
    return check_observability(DES.from_transitions(rows, name="plant"), method="pairs")


class TestReport:
    def test_a_yes_tells_the_bound_and_where_runs_end(self) -> None:
        report = report_of([("1", "a", "1", "α"), ("1", "b", "2", "β"), ("1", "c", "3", "γ")])
        assert str(report).splitlines() == [
            "plant: current-location observable",
            "  persistent locations: 1, 2, 3",
            "  the location is known after 1 output",
            "  not alive, runs end in: 2, 3",
            "  checked by pairs of locations: the method asked for",
        ]

    def test_a_no_names_each_failure_of_each_condition_and_neither_a_bound_nor_a_limit(self) -> None:
        rows = [("1", "a", "1", "α"), ("1", "b", "2", "β"), ("1", "b", "3", "β"), ("2", "c", "4", None)]
        report = report_of([*rows, ("3", "d", "1", "δ"), ("4", "e", "4", None)])
        assert str(report).splitlines() == [
            "plant: not current-location observable",
            "  persistent locations: 1, 2, 3, 4",
            "  C1 fails: 2 -c/ε-> 4",
            "  C1 fails: 4 -e/ε-> 4",
            "  C2 fails: 2 in {2,3}",
            "  C2 fails: 3 in {2,3}",
            "  C2 fails: 4 is never entered visibly",
            "  checked by pairs of locations: the method asked for",
        ]

    def test_states_in_which_a_location_is_not_named_stand_beside_each_other(self) -> None:
        report = replace(check_observability(RING), c2_failures=(C2Failure("1", (("1", "2"), ("1", "3"))),))
        assert "  C2 fails: 1 in {1,2} {1,3}" in str(report).splitlines()

    def test_a_system_where_every_run_ends_has_no_persistent_location(self) -> None:
        report = report_of([("1", "a", "2", "α")])
        assert str(report).splitlines()[1:3] == [
            "  persistent locations: none",
            "  the location is known after 1 output",
        ]

    def test_a_limit_before_the_answer_says_that_one_condition_holds_and_the_other_is_open(self) -> None:
        report = replace(report_of([("1", "a", "1", "α")]), undecided=Undecided("the time limit was reached", 1))
        assert report.current_location_observable is None
        lines = str(report).splitlines()
        assert (lines[0], lines[-3:-1]) == (
            "plant: undecided",
            ["  C1 holds", "  C2 is not decided: the time limit was reached; 1 pair of locations seen"],
        )

    def test_a_limit_after_a_no_leaves_it_a_no_and_says_that_more_may_fail(self) -> None:
        limit = Undecided("the time limit was reached", 20)
        report = replace(report_of([("1", "a", "1", "α")]), undecided=limit, c2_failures=(C2Failure("1", ()),))
        assert report.current_location_observable is False
        assert "  C1 holds" in str(report).splitlines()
        assert "  more may fail: the time limit was reached; 20 pairs of locations seen" in str(report).splitlines()

    def test_where_c1_fails_no_line_says_that_it_holds(self) -> None:
        report = replace(check_observability(PAIR), undecided=Undecided("the time limit was reached", 20))
        assert report.current_location_observable is False
        assert "  C1 fails: 2 -d/ε-> 5" in str(report).splitlines()
        assert "  C1 holds" not in str(report).splitlines()

    def test_one_failure_of_either_condition_is_a_no(self) -> None:
        holds = check_observability(RING)
        assert holds.current_location_observable is True
        assert replace(holds, c1_failures=RING.transitions[:1]).current_location_observable is False
        assert replace(holds, c2_failures=(C2Failure("1", ()),)).current_location_observable is False

    def test_one_line_sums_up_a_report(self) -> None:
        assert repr(check_observability(PAIR)) == (
            "<ObservabilityReport of pair: observable=False, alive=True, C1 failures=1, C2 failures=1, K=None, "
            "method=observer>"
        )

    def test_an_undecided_check_keeps_the_notes_of_the_limit_and_adds_what_is_known(self) -> None:
        report = replace(report_of([("1", "a", "1", "α")]), undecided=Undecided("there are too many", 2))
        problem = diagnostic("DH0901", "there are too many", notes=("at least 7",))
        stopped = UndecidedCheck(report, LimitReached(problem))
        assert stopped.report is report
        assert stopped.diagnostics[0].notes == (
            "at least 7",
            "C1 holds, C2 is not decided: there are too many; 2 pairs of locations seen",
        )


class TestPlan:
    def test_signatures_by_residual_and_by_detectors_are_told_with_what_they_cost(self) -> None:
        plan = recover_observability(FORK, (Candidate("s_2", "2", (0,), cost=1.5, negation=False),))
        assert str(plan).splitlines() == [
            "fork: current-location observable with signatures {s_2}",
            "  s_2 by residual on 1 -a-> 2",
            "  residual generators: 2; cost 1.5, proven least",
        ]
        detector = Candidate.covering("any", ["2", "1"], (0, 2, 3), cost=2.0)
        plan = recover_observability(FORK, (detector,))
        assert str(plan).splitlines()[1:] == [
            "  any by one detector of 2|1 on 1 -a-> 2, 2 -b-> 1, 3 -b-> 1",
            "  generators and detectors: any; cost 2, proven least",
        ]

    def test_one_detector_among_residual_generators_is_enough_to_speak_of_detectors(self) -> None:
        plan = recover_observability(FORK, candidates_everywhere(FORK))
        mixed = (*plan.signatures, Signature("any", "2|3", (0, 1), "residual", ("2", "3")))
        assert "  generators and detectors: " in str(replace(plan, signatures=mixed))

    def test_a_plan_without_generators_says_none(self) -> None:
        plan = recover_observability(FORK, candidates_everywhere(FORK))
        assert str(replace(plan, generators=())).splitlines()[-1] == (
            "  residual generators: none; cost 1, proven least"
        )

    def test_a_system_that_cannot_be_recovered_is_told_in_one_line(self) -> None:
        plan = recover_observability(FORK, ())
        assert str(plan) == "fork: no set of the candidate signatures makes it current-location observable"
        assert (plan.names, plan.gap, plan.undecided) == ("{}", None, ())

    def test_one_line_sums_up_a_plan(self) -> None:
        plan = recover_observability(FORK, candidates_everywhere(FORK))
        assert repr(plan) == "<SignaturePlan of fork: recoverable=True, signatures={s_2}, generators=1, cost=1.0>"

    def test_the_gap_is_the_share_of_the_cost_that_a_cheaper_plan_could_save(self) -> None:
        plan = unproven(cost=4.0, bound=3.0)
        assert plan.gap == 0.25
        assert replace(plan, optimal=True).gap == 0.0
        assert replace(plan, lower_bound=None).gap is None
        assert replace(plan, cost=None).gap is None
        assert str(plan).splitlines()[-1].endswith("cost 4, at least 3 is needed")

    def test_what_is_undecided_says_how_far_the_cost_may_fall(self) -> None:
        (message,) = unproven(cost=4.0, bound=3.0).undecided
        assert message.message == "whether cheaper signatures exist is undecided: a limit was reached"
        assert message.notes == ("every plan costs at least 3, this one costs 4",)
        assert message.helps == ("allow more time with `--timeout`",)
        (weaker,) = replace(unproven(cost=4.0, bound=4.0), optimal=True).undecided
        assert weaker.message == (
            "these signatures cost least, but whether fewer transitions could carry them is undecided"
        )
        assert recover_observability(FORK, candidates_everywhere(FORK)).undecided == ()

    def test_a_constraint_counts_transitions_and_detectors(self) -> None:
        assert len(Constraint("C2", (0, 1), ("any",), (), ())) == 3

    def test_a_signature_is_called_by_its_name(self) -> None:
        assert str(Signature("s_2", "2", (0,), "residual")) == "s_2"

    def test_notebooks_draw_the_report_of_a_plan(self) -> None:
        import deshybrid.emit.notebook  # noqa: F401  (registers the pictures)

        plan = recover_observability(FORK, candidates_everywhere(FORK))
        shown = plan._repr_mimebundle_()
        assert shown.get("image/svg+xml") == notebook_picture(plan.report)
        assert notebook_picture(plan.report) is not None


def unproven(*, cost: float, bound: float) -> SignaturePlan:
    plan = recover_observability(FORK, candidates_everywhere(FORK))
    return replace(plan, cost=cost, lower_bound=bound, optimal=False, fewest=False)


def test_cheapest_sets_are_listed_with_what_they_take() -> None:
    sets = all_minimum_sets(FORK, candidates_everywhere(FORK), most=1)
    assert str(sets).splitlines() == ["1 cheapest sets, and perhaps more", f"  {sets.sets[0]}"]
    (message,) = sets.undecided
    assert message.message == "there may be more cheapest sets than the 1 that are listed: a limit was reached"
    assert message.helps == ("raise `--most`, or allow more time",)
    nothing = all_minimum_sets(RING, ())
    assert str(nothing).splitlines() == ["1 cheapest sets", "  {} with no generator"]


def test_automata_and_observers_sum_themselves_up() -> None:
    automaton = eliminate_epsilon(RING)
    assert repr(automaton) == "<OutputAutomaton of ring: 2 locations, 2 outputs>"
    observer = build_location_observer(automaton)
    assert str(observer) == "location observer of ring: 3 states {1,2} {2} {1}"
    assert repr(observer) == "<LocationObserver of ring: 3 states, 4 transitions, 2 persistent>"


class TestTransitions:
    def test_where_it_stands_in_a_file_is_no_part_of_a_transition_nor_of_a_system(self) -> None:
        place = Span(SourceText("plant.yaml", "1 a 2"), 1, 1)
        bare = Transition("1", "a", "2")
        placed = replace(bare, span=place, output_span=place)
        assert (placed == bare, repr(placed)) == (True, repr(bare))
        assert "plant.yaml" not in repr(DES(("1", "2"), (placed,)))
        assert DES(("1", "2"), (bare,), location_spans={"1": place}) == DES(("1", "2"), (bare,))

    def test_an_unknown_location_is_told_at_the_place_of_its_transition(self) -> None:
        place = Span(SourceText("plant.yaml", "1 a 2"), 1, 1)
        with pytest.raises(ModelError) as caught:
            DES(("1",), (Transition("1", "a", "2", span=place),))
        assert [str(label.span) for label in caught.value.diagnostics[0].labels] == ["plant.yaml:1:1"]

    def test_a_signature_alone_and_an_output_alone_are_both_seen(self) -> None:
        assert Transition("1", "a", "2", (None, "α"), "s").seen == (Output(None, "s"), Output("α", "s"))
        assert Transition("1", "a", "2", ("α",)).seen == (Output("α"),)
        assert Transition("1", "a", "2", (None,)).seen == (None,)

    def test_every_unknown_location_of_a_system_is_named(self) -> None:
        with pytest.raises(ModelError) as caught:
            DES(("1",), (Transition("1", "a", "2"),), ("3",))
        assert [problem.message for problem in caught.value.diagnostics] == [
            "unknown location `2`",
            "unknown location `3`",
        ]
