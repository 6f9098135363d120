"""The tracker on the paper's examples and on small systems in which a signature comes late, or never."""

from pathlib import Path

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.observability import check_observability
from deshybrid.des.signatures import Signature, SignaturePlan, recover_observability
from deshybrid.detector.candidates import discrete_candidates
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import load
from deshybrid.observer.hybrid import HybridObserver, build_observer
from deshybrid.observer.tracker import Tracker, build_tracker

MODELS = Path(__file__).parents[2] / "models" / "balluchi2012"


def plan_with(des: DES, signatures: tuple[Signature, ...], generators: tuple[str, ...] = ()) -> SignaturePlan:
    """A plan as it stands, whether it recovers anything or not."""
    names = {number: signature.name for signature in signatures for number in signature.transitions}
    complementary = des.with_signatures(names)
    report = check_observability(complementary)
    return SignaturePlan(
        des=des,
        candidates=(),
        recoverable=True,
        already_observable=False,
        signatures=signatures,
        generators=generators,
        cost=float(len(generators)),
        lower_bound=None,
        optimal=False,
        fewest=True,
        constraints=(),
        confused=None,
        complementary=complementary,
        report=report,
    )


def observer_of(name: str) -> HybridObserver:
    system = load(MODELS / f"{name}.yaml")
    des = abstract(system)
    plan = recover_observability(des, tuple(entry.candidate for entry in discrete_candidates(des)))
    return build_observer(system, plan, None, None, step=1.0)


def run(observer: HybridObserver, events: list[str | None]) -> list[tuple[tuple[str, ...], str, str | None]]:
    """Entry estimate, status and signature after each row."""
    state, seen = observer.start(), []
    for event in events:
        state, estimate = observer.step(state, (), (), event)
        seen.append((estimate.entry_estimate, estimate.status, estimate.signature))
    return seen


def names(tracker: Tracker, des: DES, state: int) -> tuple[str, ...]:
    return tuple(des.locations[place] for place in tracker.states[state].entry_estimate)


def fork(*, silent: bool = True) -> SignaturePlan:
    """1 -> 2 and 1 -> 3 both show α, only 2 has a signature; 2 -> 1 shows β, 3 -> 1 shows γ."""
    arcs = [("1", "a", "2", "α"), ("1", "b", "3", "α"), ("2", "c", "1", "β"), ("3", "d", "1", "γ")]
    signatures = (Signature("s_2", "2", (0,), "residual"), Signature("s_3", "3", (1,), "residual"))
    return plan_with(DES.from_transitions(arcs), signatures[:1] if silent else signatures, ("2", "3"))


def test_fig9_run_yields_the_location_estimates_printed_in_the_paper() -> None:
    seen = run(observer_of("fig2"), [None, "α", "α", "s_5", "α", "β", "δ"])
    everything = ("0", "1", "2", "3", "4", "5")
    estimates = [estimate for estimate, _, _ in seen]
    assert estimates == [everything, ("0", "2"), ("2",), ("5",), ("2",), ("0",), ("5",)]
    assert [status for _, status, _ in seen] == ["searching"] * 2 + ["identified"] * 5
    assert [signature for _, _, signature in seen] == [None, None, None, "s_5", None, None, None]


def test_fig3_waits_for_s3_where_one_output_has_two_targets() -> None:
    observer = observer_of("fig3")
    assert [signature.name for signature in observer.plan.signatures] == ["s_3"]
    assert run(observer, ["α", "γ", "s_3"]) == [
        (("2",), "identified", None),
        (("3", "4"), "provisional", None),
        (("3",), "identified", "s_3"),
    ]


def test_the_next_output_tells_that_no_signature_was_due() -> None:
    """In `4` the paper's run goes on with η; s_3 never came."""
    assert run(observer_of("fig3"), ["α", "γ", "η"])[-1] == (("3",), "identified", None)


def test_output_and_signature_in_one_row_are_taken_together() -> None:
    assert run(observer_of("fig3"), ["α", "γ,s_3"])[-1] == (("3",), "identified", "s_3")


def test_an_output_that_nothing_explains_restarts_from_the_locations_compatible_with_it() -> None:
    seen = run(observer_of("fig2"), ["β", "β", "δ"])
    assert seen == [(("0",), "identified", None), (("0",), "inconsistent", None), (("5",), "identified", None)]


def test_an_unknown_event_restarts_from_everything() -> None:
    seen = run(observer_of("fig2"), ["β", "never heard of", None])
    assert [status for _, status, _ in seen] == ["identified", "inconsistent", "searching"]
    assert len(seen[1][0]) == 6


def test_a_signature_that_tells_nothing_is_not_waited_for() -> None:
    des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)])
    plan = plan_with(
        des, (Signature("s_1", "1", (1,), "residual"), Signature("s_2", "2", (0,), "residual")), ("1", "2")
    )
    tracker = build_tracker(plan)
    after = tracker.states[tracker.states[tracker.initial].on_event[0]]
    assert after.entry_estimate == (1,)
    assert not after.provisional
    assert [candidate.signature for candidate in after.candidates] == [0]


def test_silence_for_the_window_means_the_alternative_without_a_signature() -> None:
    plan = fork()
    tracker = build_tracker(plan)
    waiting = tracker.states[tracker.states[tracker.initial].on_event[0]]
    assert waiting.provisional
    assert waiting.entry_estimate == (1, 2)
    assert names(tracker, plan.des, waiting.timeout_target) == ("3",)
    assert [names(tracker, plan.des, candidate.target) for candidate in waiting.candidates] == [("2",)]


def test_silence_is_inconsistent_only_where_every_signature_due_is_guaranteed() -> None:
    for guaranteed, expected in ((frozenset({"2", "3"}), -2), (frozenset({"2"}), -1), (frozenset[str](), -1)):
        tracker = build_tracker(fork(silent=False), guaranteed=guaranteed)
        waiting = tracker.states[tracker.states[tracker.initial].on_event[0]]
        assert waiting.timeout_target == expected


def test_an_output_in_a_provisional_state_settles_it_first() -> None:
    """After α comes γ: only the alternative without a signature can show it; β shows that the signature was missed."""
    plan = fork()
    tracker = build_tracker(plan)
    waiting = tracker.states[tracker.states[tracker.initial].on_event[0]]
    by_name = dict(zip(tracker.event_names, waiting.on_event, strict=True))
    assert names(tracker, plan.des, by_name["γ"]) == ("1",)
    assert names(tracker, plan.des, by_name["β"]) == ("1",)
    assert by_name["α"] == -1


def test_a_residual_waits_until_the_generators_of_all_alternatives_are_quiet() -> None:
    """In `hub`, s_a needs the residual of `a`, and those of `hub` and `b` out of the way."""
    des = DES.from_transitions(
        [("hub", "x", "a", None), ("hub", "y", "b", None), ("a", "z", "hub", "α"), ("b", "z", "hub", "α")]
    )
    signatures = (Signature("s_a", "a", (0,), "residual"), Signature("s_b", "b", (1,), "residual"))
    tracker = build_tracker(plan_with(des, signatures, ("hub", "a", "b")))
    hub = tracker.states[tracker.states[tracker.initial].on_event[0]]
    assert [(candidate.active, candidate.quiet) for candidate in hub.candidates] == [(1, (0, 2)), (2, (0, 1))]


def test_a_negation_needs_a_generator_for_every_alternative() -> None:
    """From `hub`, b is what remains when `hub` and `a` are quiet; in the state of all locations, c could be the one."""
    des = DES.from_transitions(
        [
            ("hub", "x", "a", None),
            ("hub", "y", "b", None),
            ("a", "z", "hub", "α"),
            ("b", "z", "hub", "α"),
            ("c", "w", "hub", "α"),
        ]
    )
    signatures = (Signature("s_a", "a", (0,), "residual"), Signature("s_b", "b", (1,), "negation"))
    tracker = build_tracker(plan_with(des, signatures, ("hub", "a")))
    start = tracker.states[tracker.initial]
    hub = tracker.states[start.on_event[0]]
    assert [(candidate.active, candidate.quiet) for candidate in hub.candidates] == [(1, (0,)), (-1, (0, 1))]
    assert [candidate.active for candidate in start.candidates] == [1]


def test_a_location_that_is_not_persistent_is_not_identified() -> None:
    """B12 (21): the continuous observer runs only in persistent locations."""
    des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "3", "β"), ("3", "c", "3", "γ")], initial=["1"])
    tracker = build_tracker(recover_observability(des, ()))
    assert [(state.entry_estimate, state.location) for state in tracker.states[:3]] == [
        ((0,), -1),
        ((0, 1, 2), -1),
        ((1,), -1),
    ]
    assert 2 in {state.location for state in tracker.states}


def test_restart_knows_all_locations_although_the_initial_set_is_smaller() -> None:
    des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")], initial=["1"])
    tracker = build_tracker(recover_observability(des, ()))
    assert tracker.states[tracker.initial].entry_estimate == (0,)
    assert tracker.states[tracker.restart].entry_estimate == (0, 1)
    assert [tracker.states[state].entry_estimate for state in tracker.restart_on_event] == [(1,), (0,)]


def test_events_and_states_are_numbered_by_declaration() -> None:
    arcs = (Transition("1", "a", "2", ("β", "α")), Transition("2", "b", "1", ("α",)))
    tracker = build_tracker(recover_observability(DES(("1", "2"), arcs), ()))
    assert tracker.event_names == ("β", "α")
    assert [state.entry_estimate for state in tracker.states] == [(0, 1), (1,), (0,)]
