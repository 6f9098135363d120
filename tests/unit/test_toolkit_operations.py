"""Operations and compositions: errors, limits, and a plant far too large to build."""

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.composition import Composition, parallel, product
from deshybrid.des.languages import determinise, equivalent, included, minimise
from deshybrid.des.operations import coaccessible, hide, project, reverse, trim
from deshybrid.des.runs import shortest_run
from deshybrid.diagnostics import LimitReached, UsageError

LINE = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "3", "β")], initial=["1"])


def ring(number: int, size: int = 6) -> DES:
    """A component that goes round by private events and takes part in `all` in its last location only."""
    steps: list[tuple[str, str, str, str | None]] = [
        (str(k), f"step{number}", str(k + 1), f"o{number}") for k in range(size - 1)
    ]
    return DES.from_transitions([*steps, (str(size - 1), "all", "0", None)], initial=["0"])


@pytest.mark.parametrize(
    "ask",
    [
        lambda: trim(LINE, marked=["9"]),
        lambda: coaccessible(LINE, marked=["9"]),
        lambda: reverse(LINE, initial=["9"]),
        lambda: determinise(LINE, marked=["9"]),
        lambda: included(LINE, LINE, second_marked=["9"]),
        lambda: shortest_run(LINE, [], end=["9"]),
    ],
)
def test_a_location_that_does_not_exist_is_refused_by_name(ask) -> None:  # type: ignore[no-untyped-def]
    with pytest.raises(UsageError, match="DH0404: unknown location `9`"):
        ask()


def test_an_event_that_no_transition_has_is_refused_by_name() -> None:
    for ask in (hide, project):
        with pytest.raises(UsageError, match="DH0420: unknown event `z` in `events`"):
            ask(LINE, ["z"])


def test_one_name_in_place_of_a_list_is_that_name_and_not_its_letters() -> None:
    des = DES.from_transitions([("start", "go", "stop", "α")], initial=["start"])
    assert trim(des, marked="stop") == des
    assert str(hide(des, "go").transitions[0]) == "start -go/ε-> stop"
    assert equivalent(des, des, first_marked="stop", second_marked="stop").holds


def test_trim_towards_nothing_is_empty_and_its_language_too() -> None:
    empty = trim(LINE, marked=[])
    assert (empty.locations, empty.transitions, empty.initial) == ((), (), ())
    assert determinise(empty).accepting == ()
    assert minimise(determinise(empty)).states == ((),)
    assert included(empty, LINE).holds
    assert included(LINE, empty).word == ()


def test_minimal_automata_of_equal_languages_are_equal_where_signatures_alone_tell_outputs_apart() -> None:
    rows = [
        ("1", "a", "2", "α"),
        ("1", "b", "3", "α"),
        ("1", "c", "4", "α"),
        ("2", "d", "2", "β"),
        ("3", "e", "4", "γ"),
    ]
    des = DES.from_transitions(rows, initial=["1"]).with_signatures({0: "t", 1: "s"})
    turned = DES(des.locations, des.transitions[::-1], des.initial)
    smallest = minimise(determinise(des))
    assert smallest.transitions == minimise(determinise(turned)).transitions
    assert [str(output) for source, output, _ in smallest.transitions if source == 0] == ["α", "α,s", "α,t"]


def test_joint_outputs_are_named_by_all_parts_that_show_something() -> None:
    one = DES.from_transitions([("1", "e", "1", "α"), ("1", "e", "1", None)])
    two = DES.from_transitions([("x", "e", "x", "β"), ("x", "e", "x", "α")]).with_signatures({0: "s"})
    joint = product(one, two).transitions[0]
    assert joint.outputs == ("α+β", "α", "β")
    assert joint.signature == "s"


def test_a_joint_transition_leads_nowhere_from_a_state_of_another_composition() -> None:
    joint, _ = next(Composition((LINE, LINE)).successors()(("1", "1")))
    assert joint.after(("1", "1")) == ("2", "2")
    with pytest.raises(ValueError, match="zip"):
        joint.after(("1",))


def test_an_event_that_one_component_lacks_is_private_in_parallel_and_impossible_in_the_product() -> None:
    other = DES.from_transitions([("x", "a", "y", None)], initial=["x"])
    assert [str(t) for t in parallel(LINE, other).transitions] == ["1.x -a/α-> 2.y", "2.y -b/β-> 3.y"]
    assert [str(t) for t in product(LINE, other).transitions] == ["1.x -a/α-> 2.y"]


def test_states_that_would_be_named_alike_are_refused() -> None:
    one = DES.from_transitions([("a", "u", "a.b", "α")])
    two = DES.from_transitions([("b.c", "v", "c", "β")])
    with pytest.raises(UsageError, match=r"DH0421: two states of the composition would be named `a\.b\.c`"):
        parallel(one, two)


def test_a_goal_in_a_plant_of_two_billion_states_is_found_without_building_it() -> None:
    plant = Composition(tuple(ring(number) for number in range(12)))
    run = plant.find(lambda state: state[:3] == ("1", "2", "1"), max_states=20_000)
    assert run is not None
    assert len(run.steps) == 4
    assert run.start == ("0",) * 12
    assert run.end[:3] == ("1", "2", "1")


def test_a_search_beyond_its_limit_ends_with_what_was_found() -> None:
    plant = Composition(tuple(ring(number) for number in range(12)))
    with pytest.raises(LimitReached, match="DH0901: there are more than 500 states of the composition"):
        plant.find(lambda state: False, max_states=500)
    with pytest.raises(LimitReached, match="DH0901"):
        plant.build(max_states=500)
    kth = [("s", "a", "s", "α"), ("s", "b", "s", "β"), ("s", "a", "0", "α")]
    kth += [(str(k), event, str(k + 1), output) for k in range(9) for event, output in (("a", "α"), ("b", "β"))]
    with pytest.raises(LimitReached, match="DH0901: there are more than 100 observer states"):
        determinise(DES.from_transitions(kth, initial=["s"]), max_states=100)
