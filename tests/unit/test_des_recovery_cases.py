"""Single facts of the recovery: detectors that do not fit, bounds that are rounded, limits, and what is chosen."""

from dataclasses import replace
from fractions import Fraction

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate, generator_costs, options
from deshybrid.des.minimum import MOST_SETS, all_minimum_sets, minimum_sets_of
from deshybrid.des.program import build_program, solve
from deshybrid.des.separation import separation
from deshybrid.des.signatures import _exactly, _float_below, _lower_bound, recover_observability
from deshybrid.diagnostics import LimitReached, OutOfResources, UsageError, within
from tests.strategies import candidates_everywhere

FORK = DES.from_transitions(
    [("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")], name="fork"
)
ANY = Candidate.covering("any", ["2", "3"], [0, 1])


def problems(*candidates: Candidate) -> list[str]:
    with pytest.raises(UsageError) as caught:
        recover_observability(FORK, candidates)
    assert {problem.code for problem in caught.value.diagnostics} == {"DH0406"}
    return [problem.message for problem in caught.value.diagnostics]


class TestDetectorsThatDoNotFit:
    def test_a_location_or_a_transition_that_is_given_twice_is_refused(self) -> None:
        assert problems(Candidate.covering("any", ["2", "2"], [0])) == ["candidate `any` covers a location twice"]
        assert problems(Candidate.covering("any", ["2", "3"], [0, 0])) == ["candidate `any` names a transition twice"]

    def test_its_location_is_the_names_that_it_covers(self) -> None:
        expected = "candidate `any` has the location `2`, expected the covered ones joined by `|`"
        assert problems(replace(ANY, location="2")) == [expected]

    def test_it_is_never_a_negation_and_always_a_detector(self) -> None:
        expected = ["candidate `any` covers several locations, which a detector of its own does, not a negation"]
        assert problems(replace(ANY, negation=True)) == expected
        assert problems(replace(ANY, residual=False)) == expected

    def test_it_has_a_name_that_no_location_has(self) -> None:
        expected = ["candidate `1` has the name of a location, which a residual generator goes by"]
        assert problems(replace(ANY, name="1")) == expected

    def test_every_unknown_location_and_every_transition_elsewhere_is_named(self) -> None:
        assert problems(Candidate.covering("any", ["2", "9"], [0, 2])) == [
            "candidate `any` names the unknown location `9`",
            "candidate `any` is for location `2|9`, but 2 -b/β-> 1 leads elsewhere",
        ]

    def test_names_with_the_sign_that_joins_names_are_refused_where_names_are_joined(self) -> None:
        single = Candidate("s+2", "2", (0,))
        text = "candidate `s+2` has a `+` in its name, which joins signatures that come together"
        assert problems(single, ANY) == [text]
        assert recover_observability(FORK, (single,)).recoverable

    def test_one_that_fits_beside_single_candidates_is_accepted_and_shares_their_transitions(self) -> None:
        plan = recover_observability(FORK, (Candidate("s_2", "2", (0,)), replace(ANY, cost=0.0)))
        assert plan.names == "{s_2}"


class TestCandidates:
    def test_a_generator_may_cost_nothing_but_not_less(self) -> None:
        free = Candidate("s_2", "2", (0,), cost=0.0, negation=False)
        assert recover_observability(FORK, (free,)).cost == 0.0
        assert problems(replace(free, cost=-0.5)) == [
            "candidate `s_2` costs -0.5, expected a finite number that is not negative"
        ]
        assert problems(replace(free, cost=float("inf"))) == [
            "candidate `s_2` costs inf, expected a finite number that is not negative"
        ]

    def test_numbers_of_transitions_go_from_none_to_the_last(self) -> None:
        assert problems(Candidate("s_2", "2", (4,))) == ["candidate `s_2` names transition number 4, the system has 4"]
        assert problems(Candidate("s_2", "2", (-1,))) == [
            "candidate `s_2` names transition number -1, the system has 4"
        ]

    def test_a_candidate_costs_one_and_is_by_residual_or_negation_where_nothing_else_is_said(self) -> None:
        plain = Candidate("s_2", "2", (0,))
        assert (plain.cost, plain.residual, plain.negation, plain.covers) == (1.0, True, True, ())
        assert (plain.generator, plain.entered) == ("2", ("2",))
        assert (ANY.generator, ANY.entered, ANY.negation) == ("any", ("2", "3"), False)

    def test_the_cheapest_of_several_offers_is_what_a_generator_costs(self) -> None:
        offers = (Candidate("s", "2", (0,), cost=3.0), Candidate("t", "2", (), cost=2.0), replace(ANY, cost=4.0))
        assert generator_costs(FORK, offers) == {"2": 2.0, "any": 4.0}

    def test_options_come_by_transition_and_detectors_last_in_the_order_of_the_candidates(self) -> None:
        nowhere = Candidate.covering("none", ["2"], [])
        found = options(FORK, (ANY, nowhere, Candidate("s_3", "3", (1,)), Candidate("s_2", "2", (0,))))
        assert [(o.transitions, o.candidate, o.residual, o.negation, o.covering) for o in found] == [
            ((0,), 3, True, None, False),
            ((1,), 2, True, None, False),
            ((0, 1), 0, True, None, True),
        ]


class TestBounds:
    def test_a_bound_between_two_sums_of_costs_is_rounded_up_to_the_next(self) -> None:
        assert _lower_bound([Fraction(1), Fraction(2)], 0.4) == 1
        assert _lower_bound([Fraction(1, 2), Fraction(3, 2)], 0.5) == 1
        assert _lower_bound([Fraction(2), Fraction(4)], 0.51) == 4

    def test_a_bound_that_is_a_sum_but_for_the_solvers_error_is_that_sum(self) -> None:
        assert _lower_bound([Fraction(1), Fraction(2)], 0.5 + 1e-9) == 1
        assert _lower_bound([Fraction(1), Fraction(2)], 0.5 - 1e-9) == 1

    def test_without_a_common_unit_the_bound_is_believed_a_little_less_and_never_below_nothing(self) -> None:
        costs = [Fraction(1), Fraction(1, 10**7)]
        assert 0.5 - 3e-6 < _lower_bound(costs, 0.5) < 0.5
        assert _lower_bound(costs, 0.0) == 0
        assert _lower_bound([Fraction()], 0.0) == 0
        assert _lower_bound([], 0.0) == 0

    def test_a_double_is_never_above_the_number_that_it_stands_for(self) -> None:
        for value in (Fraction(1, 3), Fraction(2, 3), Fraction(1, 10), Fraction(5), Fraction(7, 10**9)):
            near = _float_below(value)
            assert _exactly(near) <= value
            assert value - _exactly(near) < Fraction(1, 10**15)
        assert _float_below(Fraction(1, 10)) == 0.1
        assert _exactly(0.1) == Fraction(1, 10)


class TestLimits:
    def test_without_time_a_plan_is_told_that_recovers_and_whose_cost_is_open(self) -> None:
        plan = recover_observability(FORK, candidates_everywhere(FORK), seconds=0.0)
        assert plan.report.current_location_observable
        assert (plan.recoverable, plan.optimal, plan.fewest, plan.lower_bound) == (True, False, False, 0.0)

    def test_with_time_enough_the_plan_is_proven(self) -> None:
        plan = recover_observability(FORK, candidates_everywhere(FORK), seconds=600.0)
        assert (plan.optimal, plan.fewest, plan.already_observable, plan.confused) == (True, True, False, None)

    def test_where_the_process_has_no_time_a_recovery_ends_before_there_is_a_plan(self) -> None:
        with within(timeout=0.0), pytest.raises(OutOfResources, match="DH0903"):
            recover_observability(FORK, candidates_everywhere(FORK))

    def test_a_plan_without_proof_has_no_list_of_cheapest_sets(self) -> None:
        open_plan = recover_observability(FORK, candidates_everywhere(FORK), max_rounds=0)
        assert (minimum_sets_of(open_plan).sets, minimum_sets_of(open_plan).complete) == ((), False)
        proven = recover_observability(FORK, candidates_everywhere(FORK))
        stopped = minimum_sets_of(proven, seconds=0.0)
        assert (stopped.sets, stopped.complete) == ((), False)
        assert minimum_sets_of(proven, seconds=600.0).complete

    def test_a_hundred_sets_are_listed_where_no_other_number_is_asked_for(self) -> None:
        assert MOST_SETS == 100

    def test_sets_stand_in_the_order_of_generators_and_transitions(self) -> None:
        found = all_minimum_sets(FORK, tuple(replace(c, negation=False) for c in candidates_everywhere(FORK)))
        assert [one.generators for one in found.sets] == [("2",), ("3",)]
        assert (found.complete, found.undecided) == (True, ())
        without = all_minimum_sets(FORK, ())
        assert (without.sets, without.complete) == ((), True)

    def test_tens_of_millions_of_pairs_of_transitions_that_look_alike_are_too_many(self) -> None:
        alike = DES.from_transitions([("1", str(number), "1", "α") for number in range(4473)])
        with pytest.raises(LimitReached) as caught:
            separation(alike, ())
        (problem,) = caught.value.diagnostics
        assert problem.code == "DH0901"
        assert problem.message == "there are more than 20000000 pairs of transitions with a common output"
        assert problem.notes == (f"there are {4473**2}",)


class TestChoice:
    def test_of_equal_plans_the_one_that_is_declared_first_is_chosen(self) -> None:
        both = tuple(replace(c, negation=False) for c in candidates_everywhere(FORK))
        assert recover_observability(FORK, both).generators == ("2",)
        assert recover_observability(FORK, tuple(reversed(both))).generators == ("2",)

    def test_a_solution_is_proven_up_to_the_tolerance_of_the_solver(self) -> None:
        program = build_program(FORK, candidates_everywhere(FORK))
        found = solve(program, [frozenset({0, 1})], [])
        assert found is not None
        assert (found.objective, found.proven, len(found.generators)) == (1.0, True, 1)
        assert not replace(found, bound=found.objective - 1e-3).proven
        assert replace(found, bound=found.objective - 5e-7).proven

    def test_what_is_forbidden_and_what_is_demanded_can_leave_no_solution(self) -> None:
        program = build_program(FORK, candidates_everywhere(FORK))
        nothing = [(dict.fromkeys(range(program.size), 1.0), 0.0)]
        assert solve(program, [frozenset({0})], [], forbidden=nothing) is None
        none = solve(program, [], [], forbidden=nothing)
        assert none is not None
        assert (none.options, none.generators, none.objective) == (frozenset(), frozenset(), 0)
