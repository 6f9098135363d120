"""Single facts of the discrete half: borders, limits, malformed calls, and a witness checker that says no."""

import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace

import pytest

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.candidates import Candidate, options
from deshybrid.des.cycles import cycle_before, nodes_on_cycles, strong_components
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.observability import check_observability, verdict_diagnostics
from deshybrid.des.observer import build_location_observer, entry_estimates
from deshybrid.des.persistence import blocked_locations, persistent_locations, require_living
from deshybrid.des.replay import replay_witness, witness_faults
from deshybrid.des.signatures import recover_observability
from deshybrid.des.verdicts import unrecoverable
from deshybrid.des.witness import Step, Witness
from deshybrid.des.worklist import explore
from deshybrid.diagnostics import LimitReached, ModelError, UsageError, catalogue
from tests.strategies import candidates_everywhere

RING = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")], name="ring")
SPLIT = DES.from_transitions([("1", "a", "1", "α"), ("1", "b", "2", "β"), ("1", "b", "3", "β")], name="split")


def exponential(bits: int) -> DES:
    """The classic: the observer must remember the last `bits` choices, 2^bits states."""
    rows = [("s0", "a", "s0", "0"), ("s0", "b", "s0", "1"), ("s0", "c", "s1", "1")]
    for number in range(1, bits):
        rows += [(f"s{number}", event, f"s{number + 1}", event) for event in "01"]
    return DES.from_transitions(rows, initial=["s0"])


class TestPersistence:
    def test_a_location_between_two_cycles_is_persistent_although_visited_once(self) -> None:
        des = DES.from_transitions(
            [("1", "a", "1", "α"), ("1", "b", "2", "β"), ("2", "c", "3", "γ"), ("3", "d", "3", "δ")]
        )
        assert persistent_locations(des) == ("1", "2", "3")

    def test_a_cycle_that_no_initial_location_reaches_makes_nothing_persistent(self) -> None:
        rows = [("1", "a", "2", "α"), ("2", "b", "2", "β"), ("3", "c", "3", "γ")]
        assert persistent_locations(DES.from_transitions(rows, initial=["3"])) == ("3",)

    def test_a_silent_self_loop_is_a_cycle(self) -> None:
        assert persistent_locations(DES.from_transitions([("1", "a", "1", None)])) == ("1",)

    def test_dead_ends_are_reported_where_they_can_be_reached(self) -> None:
        rows = [("1", "a", "2", "α"), ("3", "b", "4", "β")]
        assert blocked_locations(DES.from_transitions(rows, initial=["1"])) == ("2",)

    def test_require_living_names_every_dead_end(self) -> None:
        with pytest.raises(ModelError) as caught:
            require_living(DES.from_transitions([("1", "a", "2", "α"), ("1", "b", "3", "α")]))
        assert [(d.code, d.message) for d in caught.value.diagnostics] == [
            ("DH0405", "location `2` has no exit transition"),
            ("DH0405", "location `3` has no exit transition"),
        ]


class TestVerdicts:
    def test_a_silent_self_loop_breaks_c1_and_has_a_witness_of_one_run(self) -> None:
        des = DES.from_transitions([("1", "a", "1", "α"), ("1", "b", "1", None)])
        report = check_observability(des)
        assert [str(t) for t in report.c1_failures] == ["1 -b/ε-> 1"]
        assert report.c2_failures == ()
        assert report.witness is not None
        assert len(report.witness.runs) == 1
        assert replay_witness(des, report.witness)
        assert "does not see the last step" in verdict_diagnostics(report)[0].notes[-1]

    def test_the_run_of_c1_starts_where_the_observer_would_know_better_after_starts_that_lead_nowhere(
        self,
    ) -> None:
        rows = [("0", "z", "9", "ζ"), ("2", "d", "5", None), ("5", "a", "2", "α")]
        witness = check_observability(DES.from_transitions(rows, initial=["0", "2", "5"])).witness
        assert witness is not None
        assert [step.location for step in witness.runs[0]] == ["5", "2", "5", "2", "5"]

    def test_a_transition_that_may_be_silent_breaks_c1(self) -> None:
        des = DES.from_transitions([("1", "a", "2", "α"), ("1", "a", "2", None), ("2", "b", "1", "β")])
        report = check_observability(des)
        assert [str(t) for t in report.c1_failures] == ["1 -a/α|ε-> 2"]
        assert verdict_diagnostics(report)[0].notes[0] == "1 -a-> 2 may emit the null output"

    def test_a_silent_exit_of_a_transient_location_does_no_harm(self) -> None:
        report = check_observability(DES.from_transitions([("1", "a", "2", None), ("2", "b", "2", "β")]))
        assert report.current_location_observable
        assert report.transient_bound == 1

    def test_a_location_that_is_only_entered_silently_fails_c2_without_observer_states(self) -> None:
        des = DES.from_transitions([("1", "a", "1", "α"), ("1", "b", "2", None), ("2", "c", "2", None)])
        for method in ("observer", "pairs"):
            report = check_observability(des, method=method)  # type: ignore[arg-type]
            assert [(f.location, f.observer_states) for f in report.c2_failures] == [("2", ())]
            assert [message.code for message in verdict_diagnostics(report)] == ["DH0401"]

    def test_a_system_where_every_run_ends_is_observable_and_not_alive(self) -> None:
        report = check_observability(DES.from_transitions([("1", "a", "2", None)]))
        assert report.current_location_observable
        assert (report.alive, report.blocked, report.persistent) == (False, ("2",), ())

    def test_a_system_with_one_location_and_no_transition_is_observable(self) -> None:
        report = check_observability(DES(("1",), ()))
        assert (report.current_location_observable, report.transient_bound) == (True, 0)

    def test_outputs_without_doubt_from_one_start_give_the_bound_zero(self) -> None:
        assert check_observability(replace(RING, initial=("1",))).transient_bound == 0
        assert check_observability(RING).transient_bound == 1

    def test_the_bound_counts_a_doubt_that_arises_late(self) -> None:
        rows = [("1", "a", "2", "a"), ("2", "b", "3", "b"), ("3", "c", "4", "c"), ("3", "c", "5", "c")]
        rows += [("4", "d", "6", "d"), ("5", "d", "6", "d"), ("6", "e", "6", "e")]
        des = DES.from_transitions(rows, initial=["1"])
        for method in ("observer", "pairs"):
            assert check_observability(des, method=method).transient_bound == 4  # type: ignore[arg-type]

    def test_a_doubt_that_only_runs_which_end_can_have_is_no_failure(self) -> None:
        des = DES.from_transitions([("1", "a", "2", "α"), ("1", "a", "3", "α")], initial=["1"])
        report = check_observability(des)
        assert (report.current_location_observable, report.transient_bound) == (True, 2)

    def test_signatures_and_outputs_of_the_same_name_are_different_things(self) -> None:
        des = DES.from_transitions([("1", "a", "1", "s"), ("1", "b", "2", None), ("2", "c", "1", "β")])
        complementary = des.with_signatures({1: "s"})
        assert check_observability(complementary).current_location_observable
        assert eliminate_epsilon(complementary).outputs == (Output("s"), Output(None, "s"), Output("β"))

    def test_runs_that_change_places_on_their_cycle_are_brought_home(self) -> None:
        des = DES.from_transitions([("1", "a", "2", "α"), ("2", "a", "1", "α")])
        witness = check_observability(des).witness
        assert witness is not None
        assert witness_faults(des, witness) == ()

    def test_a_witness_about_a_location_after_the_cycle_says_so(self) -> None:
        des = DES.from_transitions(
            [("1", "a", "1", "α"), ("1", "b", "2", "β"), ("2", "c", "3", None), ("3", "d", "3", "δ")]
        )
        notes = verdict_diagnostics(check_observability(des))[0].notes
        assert "`2` is persistent: it is reached from the cycle 1 -a-> 1" in notes

    def test_an_unknown_method_is_refused(self) -> None:
        with pytest.raises(UsageError, match="unknown method `quick`"):
            check_observability(RING, method="quick")  # type: ignore[arg-type]

    def test_report_reads_well(self) -> None:
        report = check_observability(RING)
        assert str(report).splitlines() == [
            "ring: current-location observable",
            "  persistent locations: 1, 2",
            "  the location is known after 1 output",
            "  checked by the location observer, 3 states: the automatic choice up to 2000",
        ]
        assert repr(report).startswith("<ObservabilityReport of ring: observable=True")


class TestObserver:
    def test_extra_roots_are_numbered_last_and_do_not_count_as_persistent(self) -> None:
        automaton = eliminate_epsilon(SPLIT)
        plain = build_location_observer(automaton)
        more = build_location_observer(automaton, starts=(("2", "3"), ("1",), ("1", "3")))
        assert more.states[: len(plain.states)] == plain.states
        assert more.states[len(plain.states) :] == (("1", "3"),)
        assert more.persistent == plain.persistent

    def test_an_unknown_restart_location_is_refused(self) -> None:
        with pytest.raises(UsageError) as caught:
            build_location_observer(eliminate_epsilon(RING), starts=(("9",),))
        assert caught.value.diagnostics[0].code == "DH0404"

    def test_too_many_states_are_a_limit_that_says_how_many_were_found(self) -> None:
        with pytest.raises(LimitReached) as caught:
            build_location_observer(eliminate_epsilon(exponential(12)), max_states=100)
        (problem,) = caught.value.diagnostics
        assert problem.code == "DH0901"
        assert problem.message == "there are more than 100 observer states"
        assert "were found" in problem.notes[0]

    def test_auto_goes_over_to_pairs_where_the_observer_is_too_large(self) -> None:
        des = exponential(14)
        assert check_observability(des).method == "pairs"

    def test_a_no_that_is_certain_at_the_limit_is_a_no_and_the_observer_is_left_out(self) -> None:
        report = check_observability(exponential(14), method="observer", max_states=500)
        assert not report.current_location_observable
        assert (report.observer, report.method_reason) == (None, "a limit was reached")

    def test_an_output_that_nothing_explains_leaves_an_empty_estimate(self) -> None:
        assert entry_estimates(eliminate_epsilon(RING), ["α", "α", "β"]) == (("1", "2"), ("2",), (), ())

    def test_the_entry_estimate_is_not_closed_under_silence(self) -> None:
        des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "3", None), ("3", "c", "1", "γ")])
        assert entry_estimates(eliminate_epsilon(des), ["α"])[-1] == ("2",)


class TestSearch:
    def test_nodes_are_numbered_breadth_first_and_know_the_arc_that_found_them(self) -> None:
        graph = explore([0], lambda n: [("left", 2 * n + 1), ("right", 2 * n + 2)] if n < 3 else [])
        assert graph.nodes == (0, 1, 2, 3, 4, 5, 6)
        assert [graph.arcs[arc][1] for arc in graph.path_to(4)] == ["left", "right"]

    def test_strong_components_come_successors_first(self) -> None:
        follow = {0: [1], 1: [2, 3], 2: [0], 3: [4], 4: [3, 5], 5: []}
        graph = explore([0], lambda n: [(None, m) for m in follow[n]])
        assert [[graph.nodes[n] for n in part] for part in strong_components(graph)] == [[5], [3, 4], [0, 1, 2]]
        assert nodes_on_cycles(graph) == [graph.nodes[n] != 5 for n in range(6)]

    def test_a_long_chain_needs_no_recursion(self) -> None:
        graph = explore([0], lambda n: [("next", min(n + 1, 20_000))])
        assert sum(nodes_on_cycles(graph)) == 1
        assert cycle_before(graph, 20_000) == ([20_000], [])

    def test_a_node_without_a_cycle_before_it_has_no_lasso(self) -> None:
        graph = explore([0], lambda n: [("next", n + 1)] if n < 2 else [])
        with pytest.raises(ValueError, match="no cycle leads to node 2"):
            cycle_before(graph, 2)


def c1_case() -> tuple[DES, Witness]:
    des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α"), ("2", "e", "2", "ε?")])
    witness = check_observability(des).witness
    assert witness is not None
    return des, witness


def c2_case() -> tuple[DES, Witness]:
    witness = check_observability(SPLIT).witness
    assert witness is not None
    return SPLIT, witness


def with_runs(witness: Witness, change: Callable[[tuple[Step, ...]], tuple[Step, ...]]) -> Witness:
    return replace(witness, runs=tuple(change(run) for run in witness.runs))


@pytest.mark.parametrize(
    ("case", "broken"),
    [
        (c1_case, lambda w: with_runs(w, lambda run: (Step("", "9"), *run[1:]))),
        (c1_case, lambda w: with_runs(w, lambda run: run[:1] + tuple(Step("z", s.location) for s in run[1:]))),
        (c1_case, lambda w: replace(w, outputs=(*w.outputs, "α"))),
        (c1_case, lambda w: replace(w, cycles=((0, 1), (0, 1)))),
        (c1_case, lambda w: replace(w, runs=w.runs[:1], cycles=w.cycles[:1])),
        (c1_case, lambda w: replace(w, runs=(w.runs[0], w.runs[0]))),
        (c1_case, lambda w: replace(w, runs=tuple(run[:-1] for run in w.runs))),
        (c1_case, lambda w: replace(w, condition="C2")),
        (c2_case, lambda w: replace(w, runs=(w.runs[0], w.runs[0]))),
        (c2_case, lambda w: replace(w, outputs=w.outputs[:-1])),
        (c2_case, lambda w: replace(w, outputs=("β", *w.outputs[1:]))),
        (c2_case, lambda w: replace(w, repeated=(0, 0))),
        (c2_case, lambda w: replace(w, repeated=(1, 2))),
        (c2_case, lambda w: replace(w, cycles=((0, 2), (0, 2)))),
        (c2_case, lambda w: replace(w, cycles=w.cycles[:1])),
        (c2_case, lambda w: replace(w, runs=w.runs[:1], cycles=w.cycles[:1])),
        (c2_case, lambda w: replace(w, condition="C1")),
    ],
)
def test_a_broken_witness_is_refused(
    case: Callable[[], tuple[DES, Witness]], broken: Callable[[Witness], Witness]
) -> None:
    des, witness = case()
    assert witness_faults(des, witness) == ()
    assert witness_faults(des, broken(witness)) != ()


class TestCandidates:
    def test_negation_needs_a_generator_for_every_other_alternative(self) -> None:
        des = DES.from_transitions(
            [("1", "a", "2", None), ("1", "b", "3", None), ("2", "c", "1", None), ("3", "d", "1", None)]
        )
        found = options(des, candidates_everywhere(des))
        assert [option.negation for option in found] == [("1", "3"), ("1", "2"), ("2",), ("3",)]

    def test_a_location_without_a_generator_cannot_be_denied(self) -> None:
        des = DES.from_transitions([("1", "a", "2", None), ("2", "b", "1", None)])
        no_generators = tuple(replace(c, residual=False) for c in candidates_everywhere(des))
        assert options(des, no_generators) == ()

    def test_a_self_loop_is_never_shown_by_negation(self) -> None:
        des = DES.from_transitions([("1", "a", "1", None), ("1", "b", "2", "β"), ("2", "c", "1", "γ")])
        assert options(des, candidates_everywhere(des))[0].negation is None

    def test_a_candidate_without_transitions_offers_its_generator_to_negations(self) -> None:
        des = DES.from_transitions([("1", "a", "2", None), ("2", "b", "2", "β")], initial=["1"])
        looped = DES.from_transitions([("1", "a", "2", None), ("2", "b", "1", "β")])
        assert check_observability(des).current_location_observable
        plan = recover_observability(
            looped, (Candidate("s_2", "2", (0,), residual=False), Candidate("s_1", "1", (), cost=3.0))
        )
        assert [(s.name, s.by) for s in plan.signatures] == [("s_2", "negation")]
        assert (plan.generators, plan.cost) == (("1",), 3.0)

    def test_a_dearer_generator_is_avoided(self) -> None:
        costs = {"2": 5.0, "3": 1.0}
        candidates = tuple(
            replace(c, cost=costs.get(c.location, 1.0), negation=False) for c in candidates_everywhere(SPLIT)
        )
        assert recover_observability(SPLIT, candidates).generators == ("3",)

    def test_nothing_is_proposed_where_nothing_is_missing(self) -> None:
        plan = recover_observability(RING, candidates_everywhere(RING))
        assert (plan.already_observable, plan.signatures, plan.cost, plan.constraints) == (True, (), 0.0, ())
        assert str(plan) == "ring: current-location observable without signatures"

    def test_no_candidates_recover_nothing(self) -> None:
        plan = recover_observability(SPLIT, ())
        assert (plan.recoverable, plan.optimal) == (False, False)
        assert plan.confused == check_observability(SPLIT).witness
        (message,) = unrecoverable(plan.report)
        assert message.code == "DH0403"
        assert (
            message.notes[0] == "with all of them, persistent location `2` is still confused with another for ever (C2)"
        )

    def test_all_that_does_not_fit_is_reported_together(self) -> None:
        bad = (
            Candidate("s", "9", ()),
            Candidate("s", "2", (0,), cost=-1.0),
            Candidate("t", "3", (7, 1), cost=float("nan")),
            Candidate("u", "2", (1, 1)),
        )
        with pytest.raises(UsageError) as caught:
            recover_observability(SPLIT, bad)
        messages = [problem.message for problem in caught.value.diagnostics]
        assert {problem.code for problem in caught.value.diagnostics} == {"DH0406"}
        assert messages == [
            "candidate `s` names the unknown location `9`",
            "candidate `s` costs -1.0, expected a finite number that is not negative",
            "candidate `s` is for location `2`, but 1 -a/α-> 1 leads elsewhere",
            "candidate `t` costs nan, expected a finite number that is not negative",
            "candidate `t` names transition number 7, the system has 3",
            "candidate `t` is for location `3`, but 1 -b/β-> 2 leads elsewhere",
            "candidate `s` is given 2 times",
            "transition number 1 is given 3 times among the candidates",
        ]

    def test_a_transition_that_carries_a_signature_takes_no_second_one(self) -> None:
        with pytest.raises(UsageError, match="carries a signature already"):
            recover_observability(SPLIT.with_signatures({1: "s"}), (Candidate("t", "2", (1,)),))

    def test_too_few_rounds_still_give_a_plan_and_say_what_is_undecided(self) -> None:
        plan = recover_observability(SPLIT, candidates_everywhere(SPLIT), max_rounds=0)
        assert plan.report.current_location_observable
        assert (plan.optimal, plan.fewest, plan.lower_bound, plan.gap) == (False, False, 0.0, 1.0)
        (message,) = plan.undecided
        assert (message.code, message.severity) == ("DH0902", "error")

    def test_a_proven_cost_with_an_open_number_of_transitions_is_a_warning(self) -> None:
        plan = recover_observability(SPLIT, candidates_everywhere(SPLIT), max_rounds=1)
        assert (plan.optimal, plan.fewest, plan.gap) == (True, False, 0.0)
        (message,) = plan.undecided
        assert (message.code, message.severity) == ("DH0902", "warning")


def test_every_code_of_the_discrete_half_is_explained() -> None:
    for code in ("DH0401", "DH0402", "DH0403", "DH0404", "DH0405", "DH0406", "DH0407", "DH0901", "DH0902"):
        assert len(catalogue()[code].text) > 100


def test_unknown_and_repeated_locations_are_refused() -> None:
    with pytest.raises(ModelError, match="unknown location `2`"):
        DES(("1",), (Transition("1", "a", "2"),))
    with pytest.raises(ModelError, match="declared twice"):
        DES(("1", "1"), ())


SCRIPT = """
import random
from tests.strategies import candidates_everywhere, random_des
from deshybrid.des.observability import check_observability
from deshybrid.des.signatures import recover_observability
from deshybrid.des.verdicts import unrecoverable
for seed in range(12):
    des = random_des(random.Random(seed))
    report = check_observability(des)
    print(report, report.witness, report.observer, report.automaton.edges)
    plan = recover_observability(des, candidates_everywhere(des))
    print(plan, plan.constraints, plan.confused)
"""


def test_the_same_system_gives_the_same_text_under_any_hash_seed() -> None:
    texts = {
        subprocess.run(
            [sys.executable, "-c", SCRIPT], env={"PYTHONHASHSEED": seed}, capture_output=True, check=True, text=True
        ).stdout
        for seed in ("0", "1", "4242")
    }
    assert len(texts) == 1
    assert len(texts.pop()) > 1000
