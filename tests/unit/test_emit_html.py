"""The report: what it says in each case, that no name becomes markup, that drawings do not collide, the same bytes."""

import os
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from html.parser import HTMLParser
from pathlib import Path

import pytest
from test_emit_dot import driveline, fig2, fig3, report

from deshybrid.continuous.dwell import certify_dwell
from deshybrid.continuous.gains import design_gains
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.des.automaton import DES
from deshybrid.des.observability import check_observability
from deshybrid.des.signatures import Candidate, recover_observability
from deshybrid.detector.candidates import discrete_candidates, signature_candidates
from deshybrid.detector.detector import build_detector
from deshybrid.diagnostics import diagnostic
from deshybrid.emit.charts import delay_chart, eigenvalue_chart
from deshybrid.emit.html import ReportContent, emit_report
from deshybrid.emit.provenance import Provenance
from deshybrid.emit.report_numbers import number, roots
from deshybrid.emit.report_runs import witness_rows
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import loads

ORIGIN = Provenance("model", "model.yaml", "3f9c" * 16, "0.1.0")
HOSTILE = '</style></svg><script>alert("1")</script>'
VOID = {"meta", "br"}

TWIN = """
format: deshybrid/1
name: twin
summary: Two springs of different stiffness.
state: {a: m, v: m/s}
input: [u]
output: {y: m}
disturbance: [w]
bounds: {state: 1, input: 1, disturbance: 0.01, measurement: 0.001}
defaults: {B: [[0], [1]], C: [[1, 0]], E: [[0], [1]]}
locations:
  soft: {A: [[0, 1], [-4, -1]]}
  stiff: {A: [[0, 1], [-90, -1]]}
transitions:
  - {from: soft, to: stiff, event: up, emits: null}
  - {from: stiff, to: soft, event: down, emits: null}
observer: {rate: 0.2, dwell: 20, step: 0.01}
"""


class Page(HTMLParser):
    """Collects what the tests ask about; tags that do not match raise."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.open: list[str] = []
        self.ids: list[str] = []
        self.links: list[str] = []
        self.tags: set[str] = set()
        self.attributes: set[str] = set()
        self.pieces: list[str] = []
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.add(tag)
        self.attributes |= {name for name, _ in attrs}
        self.ids += [value or "" for name, value in attrs if name == "id"]
        self.links += [value or "" for name, value in attrs if name in ("href", "src", "xlink:href")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        self.handle_endtag(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        self.pieces.append(data)

    @property
    def text(self) -> str:
        """The visible words, in reading order, separated by single spaces."""
        return " ".join("".join(self.pieces).split())


def discrete(des: DES) -> ReportContent:
    candidates = discrete_candidates(des)
    plan = recover_observability(des, tuple(entry.candidate for entry in candidates))
    return ReportContent(report(des), ORIGIN, plan=plan, candidates=candidates)


@cache
def twin(delay: float = 0.0) -> ReportContent:
    system = loads(TWIN)
    des = abstract(system)
    candidates = signature_candidates(system, des)
    plan = recover_observability(des, tuple(entry.candidate for entry in candidates if entry.candidate.transitions))
    gains = design_gains(system, plan.report.persistent)
    certificates = (certify_dwell(system, gains), certify_dwell(system, gains, delay=delay))[: 2 if delay else 1]
    return ReportContent(
        check_observability(des),
        ORIGIN,
        system=system,
        plan=plan,
        candidates=candidates,
        detector=build_detector(system, plan, rate=gains.rate, step=0.01),
        gains=gains,
        certificates=certificates,
        ultimate=ultimate_bound(system, gains, delay=delay),
    )


def without_drawings(page: str) -> str:
    """Drawings depend on the fonts of the machine; the golden texts are about ours."""
    return re.sub(r'<svg role="img".*?</svg>', "<svg/>", page, flags=re.DOTALL)


@pytest.mark.parametrize(("name", "des"), [("fig2", fig2()), ("fig3", fig3()), ("driveline", driveline())])
def test_reports_of_the_published_systems_are_the_golden_ones(
    name: str, des: DES, golden: Callable[[str, str], None]
) -> None:
    golden(f"html/{name}.html", without_drawings(emit_report(discrete(des))))


def observable() -> ReportContent:
    return discrete(DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")]))


def hopeless() -> ReportContent:
    return ReportContent(report(fig2()), ORIGIN, plan=recover_observability(fig2(), ()))


CASES: dict[str, Callable[[], ReportContent]] = {
    "report only": lambda: ReportContent(report(fig2()), ORIGIN),
    "observable": observable,
    "repaired": lambda: discrete(fig2()),
    "not recoverable": hopeless,
    "by pairs": lambda: ReportContent(check_observability(fig3(), method="pairs"), ORIGIN),
    "continuous": twin,
    "continuous with delay": lambda: twin(0.5),
}


@pytest.mark.parametrize("case", CASES)
def test_page_is_well_formed_self_contained_and_free_of_scripts(case: str) -> None:
    page = Page(emit_report(CASES[case]()))
    assert page.open == []
    assert len(page.ids) == len(set(page.ids))
    assert {link.removeprefix("#") for link in page.links} <= set(page.ids)
    assert all(link.startswith("#") for link in page.links)
    assert not page.tags & {"script", "link", "iframe", "img", "object", "form"}
    assert not [name for name in page.attributes if name.startswith("on")]


def test_page_names_no_address() -> None:
    text = emit_report(twin())
    addresses = set(re.findall(r"[a-z]+://[^\s\"'<>]+", text))
    assert addresses <= {"http://www.w3.org/2000/svg", "http://www.w3.org/1999/xlink"}


def test_hostile_names_are_text_everywhere_on_the_page() -> None:
    ring = [(HOSTILE, HOSTILE, "q", None), ("q", "{{ 7*7 }}", HOSTILE, "`")]
    des = DES.from_transitions(ring, name=HOSTILE)
    origin = Provenance(HOSTILE, HOSTILE, HOSTILE, HOSTILE, notes=(HOSTILE, "a `b"))
    warning = diagnostic("DH0502", f"`{HOSTILE}` and {HOSTILE}", notes=(HOSTILE,), helps=(HOSTILE,), severity="warning")
    parts = discrete(des)
    content = ReportContent(
        parts.report, origin, plan=parts.plan, candidates=parts.candidates, files=(HOSTILE,), prefix=HOSTILE,
        options=((HOSTILE, HOSTILE),), warnings=(warning,),
    )  # fmt: skip
    page = Page(emit_report(content))
    assert "script" not in page.tags
    assert page.open == []
    assert page.text.count('<script>alert("1")</script>') >= 10
    assert "49" not in page.text


def test_hostile_names_are_text_in_the_charts() -> None:
    for chart in (
        eigenvalue_chart({"<b>'\"": [-1 + 0j]}, rate=1.0, step=None),
        delay_chart({"<b>'\"": 0.5}, dwell=None),
    ):
        assert "<b>" not in chart
        assert "&lt;b&gt;&#x27;&quot;" in chart


def test_drawings_in_one_page_have_different_ids() -> None:
    ids = Page(emit_report(discrete(fig2()))).ids
    assert {"des-q0", "obs-q0", "cdes-q0", "cobs-q0", "des-e0", "obs-e0"} <= set(ids)


@pytest.mark.parametrize(
    ("case", "sentence"),
    [
        ("report only", "cannot be known from its discrete outputs alone."),
        ("repaired", "cannot be known from its discrete outputs alone, but it can with one added signal."),
        ("observable", "can be known from its discrete outputs alone, after one output."),
        ("not recoverable", "outputs alone, and no admissible added signal changes that."),
        (
            "continuous",
            "but it can with two added signals; its continuous state is then estimated with an error that provably "
            "shrinks, as long as every stay in a location lasts at least 20 s and every transition is recognised at "
            "once.",
        ),
        ("continuous with delay", "every transition is recognised within 0.5 s."),
    ],
)
def test_verdict_is_one_sentence_that_fits_the_case(case: str, sentence: str) -> None:
    assert sentence in Page(emit_report(CASES[case]())).text


def test_certificate_that_does_not_hold_is_said_in_the_verdict() -> None:
    base = twin()
    assert base.system is not None
    assert base.gains is not None
    short = certify_dwell(base.system, base.gains, dwell=1e-3)
    assert not short.holds
    content = ReportContent(
        base.report, ORIGIN, system=base.system, plan=base.plan, gains=base.gains, certificates=(short,)
    )
    text = Page(emit_report(content)).text
    assert "convergence is not proven for stays of 1 ms (the proof needs" in text
    assert "✗ convergence not certified" in text


def test_location_without_a_gain_is_said_in_the_verdict() -> None:
    base = twin()
    content = ReportContent(base.report, ORIGIN, system=base.system, plan=base.plan)
    assert "no observer gain makes the estimate of its continuous state converge" in Page(emit_report(content)).text


def test_every_symbol_is_explained_where_it_is_first_used() -> None:
    text = Page(emit_report(twin(0.5))).text
    for word, meaning in [
        ("Persistent", "can still be visited after arbitrarily many transitions"),
        ("C1", "every transition that leaves a persistent location shows an output"),
        ("C2", "sooner or later the entry estimate is a single location"),
        ("signature", "an added output that says"),
        ("dwell time", "a lower bound of all stays"),
    ]:
        assert meaning in text
        assert text.index(meaning) - text.lower().index(word.lower(), text.index(meaning) - 120) < 120


def test_gains_eigenvalues_thresholds_and_cost_of_a_continuous_model_are_on_the_page() -> None:
    content = twin()
    gains, detector = content.gains, content.detector
    assert gains is not None
    assert detector is not None
    text = Page(emit_report(content)).text
    for location in gains.locations:
        assert roots(gains.eigenvalues[location]) in text
        assert number(float(gains.gains[location][0, 0])) in text
    assert all(number(float(threshold.level[0])) + " m" in text for threshold in detector.thresholds)
    assert "Theorem 6 of Balluchi et al. (2012)" in text


@pytest.mark.parametrize(
    ("kind", "residual", "decision"),
    [
        ("relay", "Luenberger observer, poles placed", "relay: below the threshold in every output for"),
        ("exclusion", "Luenberger observer, poles placed", "exclusion: every alternative beyond its bound for"),
        ("sprt", "Kalman predictor, white residual", "probability ratio test (sprt, 10⁻⁵ false alarms a second)"),
        ("glr", "Kalman predictor, white residual", "likelihood ratio test (glr, 10⁻⁵ false alarms a second)"),
    ],
)
def test_the_page_names_residual_and_decision_of_each_signature(kind: str, residual: str, decision: str) -> None:
    content, system = twin(), loads(TWIN.replace("step: 0.01}", f"step: 0.01, detector: {{decision: {kind}}}}}"))
    assert content.plan is not None
    assert content.gains is not None
    detector = build_detector(system, content.plan, rate=content.gains.rate, step=0.01)
    text = Page(emit_report(replace(content, system=system, detector=detector))).text
    rows = text[text.index("signatureresidualdecision") : text.index("How each signature is made")]
    assert f"s_soft{residual}{decision}" in rows
    assert "s_stiffnone of its own: a negation of the residuals of the alternatives" in rows


def test_page_without_graphviz_says_so_in_place_of_the_drawings(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    monkeypatch.setitem(sys.modules, "pygraphviz", None)
    monkeypatch.setenv("PATH", str(tmp_path))
    page = Page(emit_report(discrete(fig2())))
    assert "svg" not in page.tags
    assert page.text.count("no Graphviz") == 4


def test_proof_of_optimality_lists_what_every_solution_must_contain() -> None:
    text = Page(emit_report(discrete(driveline()))).text
    assert "at a cost of 6. Nothing cheaper works: every solution costs at least 6." in text
    assert "qN –a_1→ q1" in text


def test_excluded_transitions_are_listed_with_their_reason() -> None:
    system = loads(TWIN.replace("[-90, -1]", "[-4, -1]"))
    des = abstract(system)
    candidates = signature_candidates(system, des)
    plan = recover_observability(des, tuple(entry.candidate for entry in candidates if entry.candidate.transitions))
    content = ReportContent(check_observability(des), ORIGIN, system=system, plan=plan, candidates=candidates)
    text = Page(emit_report(content)).text
    assert "two transitions that no residual can show" in text
    assert "✗ cannot be repaired" in text


def test_fig2_witness_reads_as_in_the_paper() -> None:
    """The run c a a d a d from 1 leaves location 2 unseen while the observer says {2}."""
    rows = witness_rows(report(fig2()))
    assert [row.seen for row in rows] == [None, "α", "α", "α", None]
    assert [row.estimate for row in rows[1:]] == [("0", "2"), ("2",), ("2",), ("2",)]
    assert [[step.location for step in steps] for steps in rows[-1].steps] == [["5"], []]
    assert [row.repeatable for row in rows] == [False, False, False, True, False]


def test_c2_witness_shows_two_runs_side_by_side_with_equal_outputs() -> None:
    rows = witness_rows(report(fig3()))
    assert [row.seen for row in rows] == [None, "β", "α", "γ"]
    assert [steps[-1].location for steps in rows[-1].steps] == ["3", "4"]


def test_confused_pair_of_an_unrecoverable_system_is_shown() -> None:
    plan = recover_observability(fig3(), (Candidate("s_1", "1", (1,)),))
    text = Page(emit_report(ReportContent(report(fig3()), ORIGIN, plan=plan))).text
    assert "Two runs that no admissible signature tells apart." in text


def test_eigenvalues_of_a_sampled_system_are_drawn_with_the_unit_circle() -> None:
    chart = eigenvalue_chart({"q": [0.5 + 0.1j, 0.5 - 0.1j]}, rate=1.0, step=0.1)
    assert chart.count("<ellipse class='circle") == 2
    assert chart.count("<path class='mark") == 3


@pytest.mark.parametrize("spectra", [{}, {"q": []}, {"q": [complex("inf")]}, {f"q{i}": [-1 + 0j] for i in range(13)}])
def test_chart_is_left_out_where_it_would_say_nothing(spectra: dict[str, list[complex]]) -> None:
    assert eigenvalue_chart(spectra, rate=1.0, step=None) == ""


def test_delays_without_any_bound_give_no_chart() -> None:
    assert delay_chart({"q": None}, dwell=None) == ""


_SCRIPT = """
import sys
sys.path.insert(0, "tests/unit")
from test_emit_html import *
for case in ("repaired", "continuous"):
    sys.stdout.buffer.write(emit_report(CASES[case]()).encode())
"""


def test_same_page_under_three_hash_seeds() -> None:
    outputs = {
        subprocess.run(
            [sys.executable, "-c", _SCRIPT], env={**os.environ, "PYTHONHASHSEED": seed}, capture_output=True, check=True
        ).stdout
        for seed in ("0", "1", "2")
    }
    assert len(outputs) == 1
    assert outputs.pop().count(b"<!DOCTYPE html>") == 2
