"""DOT texts and pictures: what stands out, what is merged, what is escaped, and the same bytes every time."""

import os
import subprocess
import sys
from collections.abc import Callable

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.observability import check_observability
from deshybrid.des.report import ObservabilityReport
from deshybrid.emit.condense import condense, fit_for_drawing
from deshybrid.emit.dot import des_dot, dprime_dot, escape, observer_dot, picture_dot
from deshybrid.emit.picture import Arc, Picture, des_picture, dprime_picture, observer_picture

Golden = Callable[[str, str], None]

FIG2 = [
    ("1", "c", "3", None), ("3", "a", "0", "α"), ("0", "a", "2", "α"), ("2", "d", "5", None), ("5", "a", "2", "α"),
    ("2", "b", "0", "β"), ("0", "d", "5", "δ"), ("4", "b", "0", "β"),
]  # fmt: skip
FIG3 = [
    ("1", "a", "2", "α"), ("2", "b", "1", "β"), ("2", "c", "3", "γ"),
    ("2", "d", "4", "γ"), ("3", "a", "4", "δ"), ("4", "b", "3", "η"),
]  # fmt: skip
GEARS = ("1", "2", "3", "4", "5", "R")


def fig2() -> DES:
    return DES.from_transitions(FIG2, name="fig2")


def fig3() -> DES:
    return DES.from_transitions(FIG3, name="fig3")


def driveline(*, complementary: bool = False) -> DES:
    rows = [(f"q{g}", "b", "qN", None) for g in GEARS] + [("qN", f"a_{g}", f"q{g}", None) for g in GEARS]
    des = DES.from_transitions(rows, name="driveline")
    marks = {i: f"s_{arc.target[1:]}" for i, arc in enumerate(des.transitions)}
    return des.with_signatures(marks) if complementary else des


def report(des: DES) -> ObservabilityReport:
    return check_observability(des, method="observer")


def arc_between(picture: Picture, source: str, target: str) -> Arc:
    """Return the only arc between two nodes, which are given by their full names."""
    number = {node.full: i for i, node in enumerate(picture.nodes)}
    (arc,) = (a for a in picture.arcs if (a.source, a.target) == (number[source], number[target]))
    return arc


@pytest.mark.parametrize(
    ("name", "des"),
    [
        ("fig2", fig2()),
        ("fig2_s5", fig2().with_signatures({3: "s_5"})),
        ("fig3", fig3()),
        ("driveline", driveline()),
        ("driveline_complementary", driveline(complementary=True)),
    ],
)
def test_dot_texts_of_the_published_systems_are_the_golden_ones(name: str, des: DES, golden: Golden) -> None:
    checked = report(des)
    golden(f"dot/{name}.des.dot", des_dot(checked, title=name))
    golden(f"dot/{name}.dprime.dot", dprime_dot(checked, title=name))
    golden(f"dot/{name}.observer.dot", observer_dot(checked, title=name))


def test_silent_exit_of_a_persistent_location_is_drawn_as_failing_and_that_of_a_transient_one_is_not() -> None:
    picture = des_picture(report(fig2()), title="fig2")
    assert arc_between(picture, "2", "5").style == "failing"
    assert arc_between(picture, "1", "3").style == "silent"
    assert arc_between(picture, "0", "2").style == "plain"


def test_transition_with_a_signature_stands_out_and_shows_event_output_and_signature() -> None:
    picture = des_picture(report(fig2().with_signatures({3: "s_5", 4: "s_2"})), title="fig2")
    assert arc_between(picture, "2", "5").lines == ("d / s_5",)
    assert arc_between(picture, "5", "2").lines == ("a / (α, s_2)",)
    assert arc_between(picture, "2", "5").style == "signed"


def test_persistent_locations_are_marked_in_both_automata() -> None:
    for picture in (des_picture(report(fig2()), title="D"), dprime_picture(report(fig2()), title="D'")):
        assert [node.full for node in picture.nodes if node.persistent] == ["0", "2", "5"]


def test_locations_and_observer_states_that_break_c2_are_marked() -> None:
    des, observer = des_picture(report(fig3()), title="D"), observer_picture(report(fig3()), title="O")
    assert [node.full for node in des.nodes if node.failing] == ["3", "4"]
    assert [node.full for node in observer.nodes if node.failing] == ["{3, 4}"]
    assert picture_dot(observer).count('shape="octagon"') == 1


def test_edge_of_dprime_that_hides_a_silent_transition_is_dashed_and_tells_the_way() -> None:
    arc = arc_between(dprime_picture(report(fig2()), title="D'"), "1", "0")
    assert arc.style == "folded"
    assert arc.full == "1 -c/ε-> 3 then 3 -a/α-> 0"


def test_singletons_are_round_sets_are_boxes_and_the_full_set_is_called_q() -> None:
    picture = observer_picture(report(fig2()), title="O")
    shapes = {node.full: (node.shape, node.lines) for node in picture.nodes}
    assert shapes["{2}"] == ("location", ("2",))
    assert shapes["{0, 2}"] == ("set", ("{0, 2}",))
    assert picture.nodes[0].lines == ("Q", "(all 6 locations)")


def test_start_arrows_are_drawn_where_the_model_names_initial_locations_only() -> None:
    named = DES.from_transitions(FIG2, initial=["1"], name="fig2")
    assert "start_q0 -> q0" in des_dot(report(named), title="t")
    assert "start_" not in des_dot(report(fig2()), title="t")
    assert "Every location may be the first one." in des_dot(report(fig2()), title="t")


def test_parallel_transitions_become_one_arc_with_all_labels() -> None:
    des = DES.from_transitions([("p", "a", "q", "α"), ("p", "b", "q", "β"), ("q", "c", "p", "γ")])
    picture = des_picture(report(des), title="t")
    assert arc_between(picture, "p", "q").lines == ("a / α", "b / β")


def test_more_labels_than_fit_are_counted() -> None:
    des = DES.from_transitions([("p", f"e{i}", "q", "α") for i in range(9)] + [("q", "c", "p", "γ")])
    arc = arc_between(des_picture(report(des), title="t"), "p", "q")
    assert arc.lines == ("e0 / α", "e1 / α", "e2 / α", "e3 / α", "+5 more")
    assert arc.full.count("-> q") == 9


def test_failing_transition_is_not_merged_with_a_harmless_one_between_the_same_locations() -> None:
    des = DES.from_transitions([("p", "a", "q", "α"), ("p", "b", "q", None), ("q", "c", "p", "γ")])
    styles = [arc.style for arc in des_picture(report(des), title="t").arcs]
    assert styles == ["plain", "failing", "plain"]


@pytest.mark.parametrize("name", ['"]; evil [', "\\N", "\\", '\\"', "a\\", "&lt;", "a\nb", "a\x00b", "\ud800", "}"])
def test_no_name_leaves_its_quotes(name: str) -> None:
    """What remains of the text after all quoted strings are taken out must not depend on the name."""

    def bare(text: str) -> str:
        kept, quoted, position = [], False, 0
        while position < len(text):
            char = text[position]
            position += 1 + (quoted and char == "\\")
            if char == '"':
                quoted = not quoted
            elif not quoted:
                kept.append(char)
        assert not quoted
        return "".join(kept)

    def dot(location: str) -> str:
        return des_dot(report(DES.from_transitions([(location, location, "q", location)])), title="t")

    hostile, plain = dot(name).splitlines(), dot("p").splitlines()
    assert len(hostile) == len(plain)
    assert [bare(line) for line in hostile if "<TABLE" not in line] == [bare(ln) for ln in plain if "<TABLE" not in ln]


def test_title_is_escaped_in_the_legend() -> None:
    text = des_dot(report(fig2()), title="</TABLE><b>\\N&")
    assert "&lt;/TABLE&gt;&lt;b&gt;&#92;N&amp;" in text
    assert text.count("</TABLE>") == 1


def test_escape_doubles_backslashes_and_spells_ampersands() -> None:
    assert escape('\\n"&') == '\\\\n\\"&amp;'


def test_long_names_are_cut_on_the_node_and_whole_in_the_tooltip() -> None:
    name = "x" * 200
    node = des_picture(report(DES.from_transitions([(name, "a", name, "α")])), title="t").nodes[0]
    assert len(node.lines[0]) == 32
    assert node.full == name


def test_big_sets_show_their_first_members_and_count_the_rest() -> None:
    rows = [("hub", "go", f"p{i}", "α") for i in range(30)] + [(f"p{i}", "back", "hub", "β") for i in range(30)]
    picture = observer_picture(report(DES.from_transitions(rows)), title="t")
    lines = next(node.lines for node in picture.nodes if node.shape == "set" and node.lines[0] != "Q")
    assert lines[-1] == "p11, +18 more}"


def chain_of_loops(loops: int) -> DES:
    """Loops of three locations one after the other: `loops` components of size 3, all persistent."""
    rows = []
    for i in range(loops):
        rows += [(f"{i}a", "x", f"{i}b", "α"), (f"{i}b", "x", f"{i}c", "β"), (f"{i}c", "x", f"{i}a", "γ")]
        rows += [(f"{i}c", "on", f"{i + 1}a", None)] if i + 1 < loops else []
    return DES.from_transitions(rows)


def test_more_than_300_states_are_drawn_as_components_and_the_drawing_says_so() -> None:
    picture = des_picture(check_observability(chain_of_loops(110), method="pairs"), title="t")
    drawn = fit_for_drawing(picture)
    assert len(picture.nodes) == 330
    assert len(drawn.nodes) == 110
    assert drawn.nodes[0].lines[:2] == ("3 states", "persistent")
    assert drawn.nodes[0].shape == "component"
    assert "Condensed from 330 states" in picture_dot(picture)


def test_300_states_are_drawn_one_by_one() -> None:
    picture = des_picture(check_observability(chain_of_loops(100), method="pairs"), title="t")
    assert fit_for_drawing(picture) is picture


def test_failing_transitions_stay_visible_in_the_condensed_drawing() -> None:
    picture = condense(des_picture(check_observability(chain_of_loops(3), method="pairs"), title="t"))
    assert [(arc.source, arc.target, arc.style) for arc in picture.arcs] == [(0, 1, "failing"), (1, 2, "failing")]


def test_thousands_of_components_are_lumped_by_depth_into_a_drawable_number() -> None:
    rows = [(f"n{i}", "a", f"n{i + 1}", "α") for i in range(500)] + [("n500", "a", "n499", "β")]
    picture = condense(des_picture(check_observability(DES.from_transitions(rows), method="pairs"), title="t"))
    assert len(picture.nodes) <= 80
    assert sum(int(node.lines[0].split()[0]) for node in picture.nodes if node.shape == "component") == 501
    assert all(arc.source <= arc.target for arc in picture.arcs)


_SCRIPT = """
import sys
sys.path.insert(0, "tests/unit")
from test_emit_dot import *
checked = report(driveline(complementary=True))
print(des_dot(checked, title="t"), dprime_dot(checked, title="t"), observer_dot(report(fig3()), title="t"))
print(picture_dot(des_picture(check_observability(chain_of_loops(110), method="pairs"), title="t")))
"""


def test_same_bytes_under_three_hash_seeds() -> None:
    outputs = {
        subprocess.run(
            [sys.executable, "-c", _SCRIPT],
            env={**os.environ, "PYTHONHASHSEED": seed, "PYTHONIOENCODING": "utf-8"},
            capture_output=True,
            check=True,
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(outputs) == 1
    assert b"digraph" in outputs.pop()
