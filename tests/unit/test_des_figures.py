"""The facts that Balluchi et al. (2012) print about Figures 2, 3, 7, 9 and 12 to 14, and the message about Figure 2."""

from dataclasses import replace

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.observability import check_observability, verdict_diagnostics
from deshybrid.des.observer import build_location_observer, entry_estimates
from deshybrid.des.replay import witness_faults
from deshybrid.des.signatures import SignaturePlan, recover_observability
from deshybrid.diagnostics import SourceText, Span, render
from tests.strategies import candidates_everywhere

GEARS = ("q1", "q2", "q3", "q4", "q5", "qR")
FIG2 = DES.from_transitions(
    [
        ("1", "c", "3", None),
        ("3", "a", "0", "α"),
        ("0", "a", "2", "α"),
        ("2", "d", "5", None),
        ("5", "a", "2", "α"),
        ("2", "b", "0", "β"),
        ("0", "d", "5", "δ"),
        ("4", "b", "0", "β"),
    ],
    name="fig2",
)
FIG7 = FIG2.with_signatures({3: "s_5"})
FIG3 = DES.from_transitions(
    [
        ("1", "a", "2", "α"),
        ("2", "b", "1", "β"),
        ("2", "c", "3", "γ"),
        ("2", "d", "4", "γ"),
        ("3", "a", "4", "δ"),
        ("4", "b", "3", "η"),
    ],
    name="fig3",
)


def driveline(order: tuple[str, ...] = (*GEARS, "qN")) -> DES:
    opened = [(gear, "b", "qN", None) for gear in GEARS]
    closed = [("qN", f"a{gear[1]}", gear, None) for gear in GEARS]
    return replace(DES.from_transitions(opened + closed, name="driveline"), locations=order, initial=())


def sets(states: object) -> set[frozenset[str]]:
    return {frozenset(state) for state in states}  # type: ignore[attr-defined]


def plan_for(des: DES, **changes: object) -> SignaturePlan:
    return recover_observability(des, tuple(replace(c, **changes) for c in candidates_everywhere(des)))


def test_fig2_has_the_persistent_locations_0_2_5_in_the_plant_and_in_the_observer() -> None:
    report = check_observability(FIG2, method="observer")
    assert set(report.persistent) == {"0", "2", "5"}
    assert report.observer is not None
    assert sets(report.observer.states) == {frozenset("013245"), *map(frozenset, ("02", "0", "2", "5"))}
    lasting = [report.observer.states[number] for number in report.observer.persistent]
    assert sets(lasting) == {frozenset("0"), frozenset("2"), frozenset("5")}


def test_fig2_fails_c1_on_the_transition_from_2_to_5_and_c2_nowhere() -> None:
    for method in ("observer", "pairs", "auto"):
        report = check_observability(FIG2, method=method)  # type: ignore[arg-type]
        assert [str(transition) for transition in report.c1_failures] == ["2 -d/ε-> 5"]
        assert report.c2_failures == ()
        assert not report.current_location_observable
        assert report.alive


def test_fig2_folds_the_silent_transition_into_the_next_visible_one() -> None:
    edges = eliminate_epsilon(FIG2).edges
    assert [(str(edge), edge.path) for edge in edges if edge.source in ("1", "2")] == [
        ("1 -α-> 0", (0, 1)),
        ("2 -β-> 0", (5,)),
        ("2 -α-> 2", (3, 4)),
    ]


def test_fig7_is_observable_and_knows_the_location_after_two_outputs() -> None:
    report = check_observability(FIG7)
    assert report.current_location_observable
    assert report.transient_bound == 2
    assert report.witness is None
    assert verdict_diagnostics(report) == ()


def test_fig9_run_yields_the_location_estimates_printed_in_the_paper() -> None:
    run = ["c", "a", "a", "d", "a", "b", "d"]
    location, shown = "1", []
    for event in run:
        taken = next(t for t in FIG7.transitions if (t.source, t.event) == (location, event))
        shown += [output for output in taken.seen if output is not None]
        location = taken.target
    estimates = entry_estimates(eliminate_epsilon(FIG7), shown)
    assert [frozenset(estimate) for estimate in estimates] == [
        frozenset(names) for names in ("012345", "02", "2", "5", "2", "0", "5")
    ]


def test_fig3_fails_c2_for_3_and_4_which_share_a_persistent_observer_state() -> None:
    report = check_observability(FIG3, method="observer")
    assert report.persistent == ("1", "2", "3", "4")
    assert report.c1_failures == ()
    assert [(f.location, f.observer_states) for f in report.c2_failures] == [("3", (("3", "4"),)), ("4", (("3", "4"),))]
    assert report.observer is not None
    lasting = [report.observer.states[number] for number in report.observer.persistent]
    assert sets(lasting) == {*map(frozenset, "1234"), frozenset("34")}


def test_fig3_witness_repeats_the_cycle_of_1_and_2_and_parts_into_3_and_4() -> None:
    for method in ("observer", "pairs"):
        witness = check_observability(FIG3, method=method).witness  # type: ignore[arg-type]
        assert witness is not None
        assert str(witness) == "outputs: β α γ\n2 -b-> 1 -a-> 2 -c-> 3\n2 -b-> 1 -a-> 2 -d-> 4"
        assert (witness.cycles, witness.repeated) == (((0, 2), (0, 2)), (0, 2))
        assert witness_faults(FIG3, witness) == ()


def test_fig2_is_recovered_by_the_one_signature_s_5() -> None:
    plan = plan_for(FIG2)
    assert [(s.name, s.transitions, s.by) for s in plan.signatures] == [("s_5", (3,), "residual")]
    assert plan.generators == ("5",)
    assert (plan.cost, plan.lower_bound, plan.optimal) == (1.0, 1.0, True)
    assert plan.complementary == FIG7


def test_fig3_is_recovered_by_one_signature_where_the_paper_takes_two() -> None:
    plan = plan_for(FIG3)
    assert [(s.name, s.transitions, s.by) for s in plan.signatures] == [("s_3", (2,), "residual")]
    both = FIG3.with_signatures({2: "s_3", 3: "s_4"})
    assert check_observability(both).current_location_observable


@pytest.mark.parametrize("order", [(*GEARS, "qN"), ("qN", *GEARS), ("q1", "qN", "q2", "q3", "q4", "q5", "qR")])
def test_driveline_needs_all_seven_signatures_and_six_generators(order: tuple[str, ...]) -> None:
    plan = plan_for(driveline(order))
    assert {s.name: s.by for s in plan.signatures} == {
        **{f"s_{gear}": "residual" for gear in GEARS},
        "s_qN": "negation",
    }
    assert sorted(t for s in plan.signatures for t in s.transitions) == list(range(12))
    assert set(plan.generators) == set(GEARS)
    assert plan.cost == plan.lower_bound == 6.0
    assert plan.report.transient_bound == 1


def test_driveline_without_negation_needs_seven_generators() -> None:
    plan = plan_for(driveline(), negation=False)
    assert plan.cost == 7.0
    assert all(signature.by == "residual" for signature in plan.signatures)


def test_driveline_with_one_forbidden_transition_cannot_be_recovered() -> None:
    des = driveline()
    plan = recover_observability(des, candidates_everywhere(des, forbid=(8,)))
    assert not plan.recoverable
    assert plan.confused is not None
    assert witness_faults(plan.report.des, plan.confused) == ()
    assert [str(transition) for transition in plan.report.c1_failures] == ["qN -a3/ε-> q3"]
    assert (plan.signatures, plan.cost, plan.complementary) == ((), None, None)


def test_driveline_observer_cannot_leave_its_initial_state() -> None:
    observer = build_location_observer(eliminate_epsilon(driveline()))
    assert observer.states == ((*GEARS, "qN"),)
    assert (observer.transitions, observer.persistent) == ((), ())


def test_message_about_fig2_names_the_condition_the_place_the_cycle_and_a_run() -> None:
    line = "  - {from: 2, to: 5, event: d, emits: null}"
    source = SourceText("models/balluchi2012/fig2.yaml", "\n" * 6 + line)
    placed = tuple(
        replace(t, output_span=Span(source, 7, 39, 4)) if number == 3 else t
        for number, t in enumerate(FIG2.transitions)
    )
    for order in (("0", "1", "2", "3", "4", "5"), ("1", "3", "0", "2", "5", "4")):
        report = check_observability(DES(order, placed, name="fig2"))
        (message,) = verdict_diagnostics(report, proposal=("s_5",))
        assert render(message) == "\n".join(
            [
                "error[DH0401]: not current-location observable: an exit transition of persistent location `2` "
                "is unobservable (C1)",
                " --> models/balluchi2012/fig2.yaml:7:39",
                "  |",
                "7 |   - {from: 2, to: 5, event: d, emits: null}",
                "  |                                       ^^^^ emits the null output",
                "  |",
                "  = note: `2` is persistent: it lies on the cycle 2 -d-> 5 -a-> 2",
                "  = note: after the run c a a d from `1` the plant is in `5`, the observer still says {2}",
                "  = help: complement this transition with a signature; `deshybrid recover` proposes {s_5}",
            ]
        )


def test_further_silent_exits_are_labels_where_they_are_written_and_named_where_they_are_not() -> None:
    source = SourceText("plant.yaml", "\n".join(f"line {number}" for number in range(9)))
    rows = [("1", "a", "2", None), ("2", "b", "3", None), ("3", "c", "1", None)]
    first, second, third = DES.from_transitions(rows).transitions
    placed = (
        replace(first, span=Span(source, 1, 1, 4), output_span=Span(source, 2, 1, 4)),
        replace(second, span=Span(source, 3, 1, 4)),
        third,
    )
    (message,) = verdict_diagnostics(check_observability(DES(("1", "2", "3"), placed)))
    assert [(label.span and label.span.line, label.text) for label in message.labels] == [
        (2, "emits the null output"),
        (3, "emits the null output"),
    ]
    assert "3 -c-> 1 emits the null output" in message.notes


def test_message_about_fig3_gives_both_runs_and_what_can_be_repeated() -> None:
    (message,) = verdict_diagnostics(check_observability(FIG3))
    assert message.code == "DH0402"
    assert message.notes == (
        "`3` is in the persistent observer state {3,4}",
        "`4` is in the persistent observer state {3,4}",
        "the run b a c from `2` ends in `3`, the run b a d from `2` in `4`; both show β α γ",
        "the part that shows β α can be repeated in both runs for ever",
    )
