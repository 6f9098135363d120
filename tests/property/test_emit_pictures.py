"""Pictures and run tables, over all systems: nothing is lost, nothing is invented, nothing breaks the drawing."""

from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import systems

from deshybrid.des.automaton import DES, Transition
from deshybrid.des.observability import check_observability
from deshybrid.emit.condense import condense
from deshybrid.emit.picture import des_picture, dprime_picture, observer_picture
from deshybrid.emit.report_runs import witness_rows

hostile = st.text(st.sampled_from("ab\\\"'<>&;{}[]|#%\n\x00é→\ud800`-"), min_size=1, max_size=6)


@given(systems())
def test_rows_of_a_witness_spell_its_runs_and_its_outputs(des: DES) -> None:
    report = check_observability(des)
    rows = witness_rows(report)
    assert bool(rows) == (report.witness is not None)
    if report.witness is not None:
        for number, run in enumerate(report.witness.runs):
            assert tuple(step for row in rows for step in row.steps[number]) == run
        assert tuple(row.seen for row in rows if row.seen is not None) == report.witness.outputs


@given(systems())
def test_last_entry_estimate_of_a_c2_witness_holds_both_final_locations(des: DES) -> None:
    report = check_observability(des)
    if report.witness is not None and report.witness.condition == "C2":
        assert {run[-1].location for run in report.witness.runs} <= set(witness_rows(report)[-1].estimate)


@given(systems())
def test_every_transition_is_drawn_between_its_locations_and_only_there(des: DES) -> None:
    """An arc exists exactly where a transition does, and its long form names every transition merged into it."""
    picture = des_picture(check_observability(des), title="t")
    drawn = {(picture.nodes[arc.source].full, picture.nodes[arc.target].full) for arc in picture.arcs}
    assert drawn == {(t.source, t.target) for t in des.transitions}
    merged = [text for arc in picture.arcs for text in arc.full.split("; ")]
    assert set(merged) == {str(t) for t in des.transitions}


@given(systems())
def test_observer_and_dprime_pictures_have_the_nodes_of_their_automata(des: DES) -> None:
    report = check_observability(des, method="observer")
    assert report.observer is not None
    assert len(observer_picture(report, title="t").nodes) == len(report.observer.states)
    assert [node.full for node in dprime_picture(report, title="t").nodes] == list(des.locations)


@given(systems(locations=8, transitions=14))
def test_condensed_picture_keeps_persistence_and_has_no_cycle_between_its_nodes(des: DES) -> None:
    picture = des_picture(check_observability(des), title="t")
    small = condense(picture)
    members = sum(1 if node.shape != "component" else int(node.lines[0].split()[0]) for node in small.nodes)
    assert members == len(picture.nodes)
    assert any(node.persistent for node in small.nodes) == any(node.persistent for node in picture.nodes)
    beyond = {i: {arc.target for arc in small.arcs if arc.source == i and arc.target != i} for i in range(members)}
    reached = dict(beyond)
    for _ in range(members):
        reached = {i: set().union(found, *(beyond[j] for j in found)) for i, found in reached.items()}
    assert not [i for i, found in reached.items() if i in found]


@settings(max_examples=30)
@given(st.lists(st.tuples(hostile, hostile, hostile, st.none() | hostile), min_size=1, max_size=5))
def test_any_name_can_be_drawn_and_its_drawing_is_well_formed(rows: list[tuple[str, str, str, str | None]]) -> None:
    from xml.etree import ElementTree

    from deshybrid.emit.drawing import draw

    arcs = {(p, e, q): Transition(p, e, q, (output,)) for p, e, q, output in rows}
    names = dict.fromkeys(name for p, _, q in arcs for name in (p, q))
    picture = des_picture(check_observability(DES(tuple(names), tuple(arcs.values()))), title=rows[0][0])
    for format in ("svg", "graphml"):
        ElementTree.fromstring(draw(picture, format))
    assert draw(picture, "svg").count(b'class="node ') == len(names)
