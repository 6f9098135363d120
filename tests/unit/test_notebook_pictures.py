"""What a notebook shows when a cell ends with a value: the hooks that Jupyter calls, called here."""

import re
import subprocess
import sys
from xml.etree import ElementTree

import pytest
from hypothesis import given, settings

import deshybrid as dh
from deshybrid.des.automaton import DES
from deshybrid.diagnostics.pictured import Pictured
from deshybrid.emit import drawing
from deshybrid.emit.notebook import MOST_DECIDED
from deshybrid.emit.picture import location_observer_picture, observer_picture
from tests.strategies import systems

PUMP = DES.from_transitions(
    [("idle", "start", "run", "hum"), ("run", "stop", "idle", "click"), ("run", "leak", "idle", None)],
    initial=["idle"],
    name="pump",
)
HOSTILE = '<script>alert("1")</script>]]>&'
SVG, HTML = "image/svg+xml", "text/html"


def shown(value: Pictured) -> dict[str, str]:
    """What Jupyter gets: it passes what it wants and does not want by name."""
    return value._repr_mimebundle_(include=None, exclude=None)


def texts(svg: str) -> set[str]:
    return {part.strip() for part in ElementTree.fromstring(svg).itertext() if part.strip()}


def ring(size: int) -> DES:
    return DES.from_transitions([(f"q{i}", "a", f"q{(i + 1) % size}", "α") for i in range(size)], name="ring")


@pytest.mark.parametrize("what", ["system", "without silence", "observer", "model"])
def test_a_value_that_is_a_graph_is_shown_as_its_drawing(what: str) -> None:
    report = dh.check(PUMP, method="observer")
    assert report.observer is not None
    model = dh.loads("{format: deshybrid/1, locations: [run], transitions: [{from: run, to: run, event: a, emits: b}]}")
    value = {"system": PUMP, "without silence": report.automaton, "observer": report.observer, "model": model}[what]
    assert set(shown(value)) == {SVG}
    assert "run" in texts(shown(value)[SVG])


def test_an_answer_is_shown_as_its_text_above_its_drawing() -> None:
    made = dh.compile(PUMP)
    answers = (dh.check(PUMP), dh.recover(PUMP), dh.recover(PUMP).plan, made.design, made)
    for answer in answers:
        bundle = shown(answer)
        assert set(bundle) == {SVG, HTML}
        assert bundle[HTML].index("pump:") < bundle[HTML].index("<svg")
        assert bundle[HTML].endswith(bundle[SVG])
    assert "not current-location observable" in shown(answers[0])[HTML]
    assert "with signatures {s_idle}" in shown(answers[1])[HTML]


def test_a_compilation_shows_the_observer_that_runs() -> None:
    made = dh.compile(PUMP)
    assert made.design.recovery.plan.report.observer is not None
    assert shown(made)[SVG] == shown(made.design.recovery.plan.report.observer)[SVG]
    assert "s_idle" in texts(shown(made)[SVG])


def test_names_cannot_break_out_of_their_place() -> None:
    des = DES.from_transitions([(HOSTILE, HOSTILE, "2", HOSTILE), ("2", "b", HOSTILE, None)], name=HOSTILE)
    for value in (des, dh.check(des), dh.recover(des)):
        for text in shown(value).values():
            assert "<script" not in text
        assert any("<script>" in part for part in texts(shown(value)[SVG]))  # it is there, as text
        ElementTree.fromstring(f"<div>{shown(value).get(HTML, '')}</div>")


def test_two_drawings_on_one_page_share_no_id() -> None:
    first, second = (set(re.findall(r'\bid="([^"]+)"', shown(value)[SVG])) for value in (PUMP, ring(3)))
    assert first
    assert first.isdisjoint(second)
    assert shown(PUMP) == shown(PUMP)


def test_a_large_system_is_text_and_its_verdict_the_condensed_drawing() -> None:
    large = ring(MOST_DECIDED + 1)
    assert shown(large) == {}
    assert repr(large) == "<DES ring: 301 locations, 301 transitions, 301 initial>"
    assert any("301" in part for part in texts(shown(dh.check(large))[SVG]))
    assert "q0" in texts(shown(ring(20))[SVG])


def test_a_verdict_with_thousands_of_names_is_cut_to_a_page() -> None:
    size = 300
    blind = DES.from_transitions([(f"q{i}", "a", f"q{(i + 1) % size}", None) for i in range(size)])
    text = shown(dh.check(blind, method="pairs"))[HTML].split("</pre>")[0]
    assert len(text) < 20_000
    assert "more lines: print() shows them" in text


def test_an_empty_system_is_shown_as_text() -> None:
    assert shown(DES((), ())) == {}


def test_without_graphviz_a_notebook_goes_on_with_text(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(drawing, "_by_library", lambda _dot, _format: None)
    monkeypatch.setenv("PATH", "")
    assert shown(PUMP) == {}
    assert set(shown(dh.check(PUMP))) == {HTML}


@given(systems())
@settings(max_examples=200)
def test_an_observer_alone_is_drawn_as_its_report_draws_it(des: DES) -> None:
    report = dh.check(des, method="observer")
    assert report.observer is not None
    failing = {state for failure in report.c2_failures for state in failure.observer_states}
    picture = location_observer_picture(report.observer, title="t")
    assert picture == observer_picture(report, title="t")
    marked = {report.observer.states[number] for number, node in enumerate(picture.nodes) if node.failing}
    assert marked == failing


def test_drawing_is_not_loaded_before_something_is_drawn() -> None:
    code = "import sys, deshybrid; print([m for m in ('deshybrid.emit.drawing', 'html') if m in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"


def test_values_with_a_picture_have_short_texts() -> None:
    report = dh.check(ring(200), method="observer")
    for value in (ring(200), report, report.observer, report.automaton):
        assert len(repr(value)) < 200
