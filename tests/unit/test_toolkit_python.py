"""A system in Python: counted, iterated, indexed, and taken to networkx and back."""

import random
import subprocess
import sys

import networkx as nx
import pytest

import deshybrid as dh
from deshybrid.des.automaton import DES
from deshybrid.diagnostics import ModelError, UsageError
from tests.strategies import candidates_everywhere, random_des

DEMO = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None), ("1", "a", "2", "β")], initial=["2"])


def test_a_system_is_counted_and_iterated_by_its_transitions() -> None:
    assert len(DEMO) == 2
    assert tuple(DEMO) == DEMO.transitions
    assert DEMO.transitions[0] in DEMO


def test_a_location_in_brackets_gives_what_leaves_it() -> None:
    assert [str(transition) for transition in DEMO["1"]] == ["1 -a/α|β-> 2"]
    with pytest.raises(UsageError, match="DH0404: unknown location `9`"):
        DEMO["9"]


def test_a_system_without_transitions_is_still_true() -> None:
    empty = DES(("1",), ())
    assert len(empty) == 0
    assert empty


def test_the_representation_is_one_short_line_however_large_the_system() -> None:
    large = DES(tuple(str(number) for number in range(5000)), (), ("0",), "large")
    assert repr(large) == "<DES large: 5000 locations, 0 transitions, 1 initial>"


def test_networkx_and_back_is_the_same_system_in_the_same_order() -> None:
    for seed in range(500):
        des = random_des(random.Random(seed))
        signed = des.with_signatures({i: c.name for c in candidates_everywhere(des) for i in c.transitions[:1]})
        for system in (des, signed):
            assert DES.from_networkx(system.to_networkx()) == system


def test_a_graph_of_someone_else_needs_events_and_outputs_only() -> None:
    graph = nx.DiGraph()
    graph.add_edge(1, 2, event="a", outputs="α")
    graph.add_edge(2, 1, event="b", outputs=["β", None])
    des = DES.from_networkx(graph, initial=["2"])
    assert [str(transition) for transition in des] == ["1 -a/α-> 2", "2 -b/β|ε-> 1"]
    assert (des.name, des.initial) == ("des", ("2",))
    assert DES.from_networkx(graph).initial == ("1", "2")


def test_edges_are_ordered_by_their_number_only_where_all_have_one() -> None:
    graph = nx.DiGraph()
    graph.add_edge(1, 2, event="a", outputs="α", number=7)
    graph.add_edge(2, 1, event="b", outputs="β")
    graph.add_edge(2, 3, event="c", outputs="γ", number=3)
    assert [transition.event for transition in DES.from_networkx(graph)] == ["a", "b", "c"]
    graph.edges[2, 1]["number"] = 5
    assert [transition.event for transition in DES.from_networkx(graph)] == ["c", "b", "a"]


def test_a_graph_that_does_not_say_enough_is_refused_with_each_edge() -> None:
    graph = nx.Graph()
    graph.add_edge("1", "2", event="a")
    with pytest.raises(UsageError) as caught:
        DES.from_networkx(graph)
    assert [message.message for message in caught.value.diagnostics] == [
        "the edge from `1` to `2` lacks `event` or `outputs`",
        "the graph is not directed",
    ]
    same = nx.DiGraph()
    same.add_nodes_from([1, "1"])
    with pytest.raises(ModelError, match="DH0404: a location is declared twice"):
        DES.from_networkx(same)


def test_networkx_is_not_loaded_before_it_is_asked_for() -> None:
    code = "import sys, deshybrid.des.opacity, deshybrid.des.composition; print('networkx' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "False"


def test_a_table_has_a_row_for_each_output_and_makes_the_same_system_again() -> None:
    for seed in range(200):
        des = random_des(random.Random(seed))
        table = des.to_table()
        rows = list(zip(table["source"], table["event"], table["target"], table["output"], strict=True))
        assert len(rows) == sum(len(transition.outputs) for transition in des)
        again = DES.from_transitions(rows)
        assert {(t.source, t.event, t.target): set(t.outputs) for t in again} == joined(des)


def joined(des: DES) -> dict[tuple[str, str, str], set[str | None]]:
    found: dict[tuple[str, str, str], set[str | None]] = {}
    for t in des:
        found.setdefault((t.source, t.event, t.target), set()).update(t.outputs)
    return found


def test_a_table_of_a_complementary_system_names_its_signatures() -> None:
    assert DEMO.with_signatures({1: "s_1"}).to_table()["signature"] == (None, None, "s_1")


def test_a_table_of_an_observer_has_a_row_for_each_transition() -> None:
    observer = dh.check(DEMO, method="observer").observer
    assert observer is not None
    assert observer.to_table() == {
        "source": tuple(observer.states[i] for i, _, _ in observer.transitions),
        "output": tuple(str(output) for _, output, _ in observer.transitions),
        "target": tuple(observer.states[j] for _, _, j in observer.transitions),
    }
