"""Drawings: SVG by ids and counts, hostile names in every format, the fallback, the same bytes every time."""

import os
import random
import subprocess
import sys
import time
from pathlib import Path
from xml.etree import ElementTree

import pytest
from test_emit_dot import driveline, fig2, report

from deshybrid.des.automaton import DES
from deshybrid.des.observability import check_observability
from deshybrid.diagnostics import DeshybridError, UsageError, catalogue
from deshybrid.emit import drawing
from deshybrid.emit.dot import des_dot, observer_dot
from deshybrid.emit.drawing import draw, render_drawing
from deshybrid.emit.picture import Picture, des_picture, observer_picture

SVG = "{http://www.w3.org/2000/svg}"
HOSTILE = ("</svg><script>alert(1)</script>", '"]; evil [', "<b>bold</b>", "\\N", "a\nb\x00c", "&lt;", "--- %%{init}%%")


def hostile_picture() -> Picture:
    ring = [(p, q, q, p) for p, q in zip(HOSTILE, HOSTILE[1:] + HOSTILE[:1], strict=True)]
    return des_picture(report(DES.from_transitions(ring)), title="</svg><script>")


def groups(svg: bytes, kind: str) -> dict[str, ElementTree.Element]:
    root = ElementTree.fromstring(svg)
    return {g.get("id", ""): g for g in root.iter(f"{SVG}g") if (g.get("class") or "").split()[0:1] == [kind]}


def test_every_location_and_arc_is_found_in_the_svg_by_its_id() -> None:
    svg = render_drawing(des_dot(report(fig2()), title="fig2"), "svg")
    assert sorted(groups(svg, "node")) == [f"q{i}" for i in range(6)]
    assert sorted(groups(svg, "edge")) == [f"e{i}" for i in range(8)]


def test_svg_tells_persistent_transient_and_failing_apart_by_class() -> None:
    svg = render_drawing(des_dot(report(fig2()), title="fig2"), "svg")
    nodes = groups(svg, "node")
    kinds = {"".join(node.itertext()).split()[-1]: (node.get("class") or "").split()[1] for node in nodes.values()}
    assert {name for name, kind in kinds.items() if kind == "persistent"} == {"0", "2", "5"}
    failing = [arc for arc in groups(svg, "edge").values() if "failing" in (arc.get("class") or "")]
    assert ["d / ε" in "".join(arc.itertext()) for arc in failing] == [True]


def test_driveline_observer_has_eight_states_and_a_start_arrow() -> None:
    """Seven singletons and the full set, as the paper draws them."""
    svg = render_drawing(observer_dot(report(driveline(complementary=True)), title="driveline"), "svg")
    assert sorted(set(groups(svg, "node")) - {"start_q0"}) == [f"q{i}" for i in range(8)]
    assert "start_arrow_q0" in groups(svg, "edge")


def test_hostile_names_are_plain_text_in_the_svg() -> None:
    svg = draw(hostile_picture(), "svg")
    root = ElementTree.fromstring(svg)
    assert {element.tag.removeprefix(SVG) for element in root.iter()} <= {
        "svg", "g", "a", "title", "text", "polygon", "ellipse", "path", "polyline",
    }  # fmt: skip
    assert sorted(groups(svg, "node")) == [f"q{i}" for i in range(len(HOSTILE))]
    texts = {(text.text or "").strip() for text in root.iter(f"{SVG}text")}
    assert {"</svg><script>alert(1)</script>", "<b>bold</b>", "\\N", "&lt;"} <= texts


def test_svg_holds_no_script_no_link_and_no_generator_version() -> None:
    svg = draw(observer_picture(report(fig2()), title="fig2"), "svg")
    assert not [word for word in (b"<script", b"href", b"enerated by") if word in svg]


def test_hostile_names_are_character_codes_in_mermaid() -> None:
    text = draw(hostile_picture(), "mmd").decode()
    body = text.split("flowchart LR\n")[1]
    labels = [piece for line in body.splitlines() if "classDef" not in line for piece in line.split('"')[1::2]]
    assert len(labels) == 2 * len(HOSTILE)
    assert not [label for label in labels if set(label.replace("<br/>", "")) & set("<>\"'`\\[]{}()%&")]


def test_hostile_names_come_back_from_graphml_as_they_were_shown() -> None:
    root = ElementTree.fromstring(draw(hostile_picture(), "graphml"))
    space = "{http://graphml.graphdrawing.org/xmlns}"
    nodes = [node.findtext(f"{space}data") for node in root.iter(f"{space}node")]
    assert nodes == [node.full for node in hostile_picture().nodes]
    assert len(list(root.iter(f"{space}edge"))) == len(HOSTILE)


def test_mermaid_marks_failing_arcs_by_their_number() -> None:
    text = draw(des_picture(report(fig2()), title="fig2"), "mmd").decode()
    arcs = [line for line in text.splitlines() if " --> " in line]
    assert "linkStyle 3 stroke:#c8102e" in text
    assert arcs[3] == '  q4 -- "d / ε" --> q4'.replace("q4 --", "q3 --", 1)


@pytest.mark.parametrize(("format", "magic"), [("png", b"\x89PNG"), ("pdf", b"%PDF"), ("dot", b"digraph {")])
def test_each_format_is_what_its_name_says(format: str, magic: bytes) -> None:
    assert draw(des_picture(report(fig2()), title="fig2"), format).startswith(magic)


def test_pdf_carries_no_date_of_its_making() -> None:
    pdf = draw(des_picture(report(fig2()), title="fig2"), "pdf")
    assert b"/CreationDate (D:19700101000000Z" in pdf


def test_unknown_format_is_refused_with_the_known_ones() -> None:
    with pytest.raises(UsageError) as caught:
        draw(Picture("t", (), ()), "gif")
    assert caught.value.diagnostics[0].code == "DH0801"
    assert "`graphml`" in caught.value.diagnostics[0].helps[0]


def test_graphviz_own_words_are_in_the_message_when_it_fails() -> None:
    with pytest.raises(DeshybridError) as caught:
        render_drawing("digraph { a -> ", "svg")
    assert caught.value.diagnostics[0].code == "DH0803"


def test_program_dot_is_used_where_pygraphviz_is_missing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "dot"
    program.write_text('#!/bin/sh\nprintf "drawn by %s" "$1"; cat > "$0.in"\n')
    program.chmod(0o755)
    monkeypatch.setitem(sys.modules, "pygraphviz", None)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    assert render_drawing("digraph { ä }", "png") == b"drawn by -Tpng"
    assert (tmp_path / "dot.in").read_text(encoding="utf-8") == "digraph { ä }"


def test_failing_program_is_reported_with_its_words(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    program = tmp_path / "dot"
    program.write_text("#!/bin/sh\ncat > /dev/null; echo no such font >&2; exit 3\n")
    program.chmod(0o755)
    monkeypatch.setitem(sys.modules, "pygraphviz", None)
    monkeypatch.setenv("PATH", f"{tmp_path}{os.pathsep}{os.environ['PATH']}")
    with pytest.raises(DeshybridError) as caught:
        render_drawing("digraph {}", "svg")
    assert caught.value.diagnostics[0].notes == ("no such font",)


def test_without_graphviz_the_message_says_what_to_install(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setitem(sys.modules, "pygraphviz", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(UsageError) as caught:
        render_drawing("digraph {}", "svg")
    assert caught.value.diagnostics[0].code == "DH0802"
    assert "pygraphviz" in caught.value.diagnostics[0].helps[0]


def test_every_code_of_this_part_is_explained() -> None:
    source = Path(drawing.__file__).read_text(encoding="utf-8")
    assert [code for code in ("DH0801", "DH0802", "DH0803") if code in source and code in catalogue()] == [
        "DH0801",
        "DH0802",
        "DH0803",
    ]


def crowd(locations: int, arcs: int) -> Picture:
    chance = random.Random(1)
    names = [f"L{i}" for i in range(locations)]
    rows = [(chance.choice(names), "e", chance.choice(names), chance.choice("αβγ")) for _ in range(arcs)]
    return des_picture(check_observability(DES.from_transitions(rows), method="pairs"), title="crowd")


def test_crowded_graph_is_drawn_without_levels_within_seconds() -> None:
    """In levels this one takes two minutes."""
    picture = crowd(100, 300)
    before = time.process_time()
    svg = draw(picture, "svg")
    assert time.process_time() - before < 20
    assert b"sfdp" in draw(picture, "dot")
    assert len(groups(svg, "node")) == len(picture.nodes)
    assert b"sfdp" not in draw(crowd(30, 60), "dot")


_SCRIPT = """
import sys
sys.path.insert(0, "tests/unit")
from test_emit_drawing import *
for format in ("svg", "png", "pdf", "mmd", "graphml"):
    sys.stdout.buffer.write(draw(hostile_picture(), format))
    sys.stdout.buffer.write(draw(observer_picture(report(driveline(complementary=True)), title="t"), format))
sys.stdout.buffer.write(draw(crowd(60, 200), "svg"))
"""


def test_same_bytes_in_every_format_under_three_hash_seeds() -> None:
    outputs = {
        subprocess.run(
            [sys.executable, "-c", _SCRIPT], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(outputs) == 1
    assert len(outputs.pop()) > 50_000


def test_nothing_is_printed_while_drawing(capfd: pytest.CaptureFixture[str]) -> None:
    draw(observer_picture(report(fig2()), title="fig2"), "png")
    assert capfd.readouterr() == ("", "")
