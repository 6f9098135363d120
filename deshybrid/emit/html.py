"""The report of one compilation: a single page that is read from top to bottom without another document.

In: the values of the stages, as far as they exist.  Out: HTML with its style and drawings inside: no network, no
script.  The prose lives in the templates, the numbers' form in `report_numbers`, the runs in `report_runs`.
Every name is escaped by the template engine or, inside drawings, by the printer of DOT.  Cost: that of the drawings.
"""

import math
import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Literal

from deshybrid.diagnostics import Diagnostic, UsageError
from deshybrid.emit.charts import delay_chart, eigenvalue_chart
from deshybrid.emit.dot import des_dot, observer_dot
from deshybrid.emit.drawing import render_drawing
from deshybrid.emit.picture import printable
from deshybrid.emit.provenance import Provenance
from deshybrid.emit.report_detector import signature_designs
from deshybrid.emit.report_numbers import count, number, quantity, roots, seconds
from deshybrid.emit.report_runs import run_text, witness_rows

if TYPE_CHECKING:
    from collections.abc import Mapping

    from jinja2 import Environment
    from markupsafe import Markup

    from deshybrid.continuous.certified import Certificate
    from deshybrid.continuous.cycles import DwellLowerLimit
    from deshybrid.continuous.determinability_design import Determined
    from deshybrid.continuous.gains import ObserverGains
    from deshybrid.continuous.ultimate import UltimateBound
    from deshybrid.des.report import ObservabilityReport
    from deshybrid.des.signatures import SignaturePlan
    from deshybrid.detector.candidates import FeasibleCandidate
    from deshybrid.detector.detector import TransitionDetector
    from deshybrid.model.system import HybridSystem
    from deshybrid.observer.tables import StepTables

_SVG_HEAD = re.compile(r".*?(?=<svg\b)", re.DOTALL)
_SVG_ID = re.compile(r'(<[^<>]*?\sid=")')
_THEOREMS = {
    "B12-6": "Theorem 6 of Balluchi et al. (2012)",
    "B12-7": "Theorem 7 of Balluchi et al. (2012)",
    "LMI": "linear matrix inequalities",
    "B03-box": "contraction over all stays within their bounds",
}


@dataclass(frozen=True, slots=True, eq=False)
class ReportContent:
    """All that a report tells; a part that does not exist is None or empty, and the page says so or leaves it out.

    `report` is the check of the model as it is; `plan` holds the check of the complementary DES.  `real` is the type of
    numbers that the memory figures count; `files` are the names of everything written; `prefix` that of generated code.
    """

    report: "ObservabilityReport"
    provenance: Provenance
    system: "HybridSystem | None" = None
    plan: "SignaturePlan | None" = None
    candidates: "tuple[FeasibleCandidate, ...]" = ()
    detector: "TransitionDetector | None" = None
    gains: "ObserverGains | None" = None
    certificates: "tuple[Certificate, ...]" = ()
    ultimate: "UltimateBound | None" = None
    lower_limit: "DwellLowerLimit | None" = None
    determined: "Determined | None" = None
    tables: "StepTables | None" = None
    real: Literal["double", "float"] = "double"
    files: tuple[str, ...] = ()
    prefix: str = ""
    options: tuple[tuple[str, str], ...] = ()
    warnings: tuple[Diagnostic, ...] = ()


def emit_report(content: ReportContent) -> str:
    """Return the page.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.observability import check_observability
    >>> report = check_observability(DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")]))
    >>> page = emit_report(ReportContent(report, Provenance("toy", "toy.yaml", "3f9c", "0.1.0")))
    >>> page.startswith("<!DOCTYPE html>"), "<script" in page
    (True, False)
    """
    return page_environment().get_template("report.html.j2").render(_context(content))


def page_environment() -> "Environment":
    """Return the templates of all reports, with the filters that their texts and numbers pass.

    >>> page_environment().get_template("report.html.j2").name
    'report.html.j2'
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("deshybrid.emit", "templates/html"),
        undefined=StrictUndefined,
        autoescape=True,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(
        number=number,
        seconds=seconds,
        quantity=quantity,
        roots=roots,
        run=run_text,
        count=count,
        shown=printable,
        prose=_prose,
    )
    return environment


def _context(content: ReportContent) -> "Mapping[str, Any]":
    """What the templates read: the stages' own values, and the few things that are computed for the page."""
    from deshybrid.continuous.certified import deciding, dwell_gap

    plan, report = content.plan, content.report
    repaired = plan is not None and plan.recoverable and not plan.already_observable
    return {
        "content": content,
        "report": report,
        "plan": plan,
        "system": content.system,
        "repaired": repaired,
        "continuous": content.system is not None and not content.system.is_discrete,
        "rows": witness_rows(report),
        "confused_rows": witness_rows(plan.report) if plan is not None and not plan.recoverable else (),
        "figures": _figures(content, repaired=repaired),
        "charts": _charts(content),
        "feasibility": _feasibility(content),
        "signature_designs": () if content.detector is None else signature_designs(content.detector),
        "theorem": _theorem,
        "persistent": frozenset(report.persistent),
        "confusions": _confusions(report),
        "certified": _certified(content),
        "deciding": deciding(content.certificates),
        "gap": dwell_gap(content.certificates, content.lower_limit),
        "unproven": _unproven(content),
        "infinity": math.inf,
        "cost": _cost(content),
        "units": {} if content.system is None else content.system.units,
    }


def _certified(content: ReportContent) -> bool:
    """Every location is certified alone, or all of them together where that is needed."""
    from deshybrid.continuous.certified import is_certified

    if content.determined is not None and content.determined.required:
        return content.determined.holds
    return bool(content.certificates) and is_certified(content.certificates)


def _unproven(content: ReportContent) -> tuple[str, ...]:
    """Locations whose detection delay has no bound."""
    delays = {} if content.detector is None else content.detector.detection_delay
    return tuple(name for name, bound in delays.items() if bound is None)


def _confusions(report: "ObservabilityReport") -> list[tuple[list[str], tuple[tuple[str, ...], ...]]]:
    """C2 failures with equal observer states, joined: the locations, and the entry estimates they are confused in."""
    groups: dict[tuple[tuple[str, ...], ...], list[str]] = {}
    for failure in report.c2_failures:
        groups.setdefault(failure.observer_states, []).append(failure.location)
    return [(locations, states) for states, locations in groups.items()]


def _prose(text: str) -> "Markup":
    """A sentence of another stage: what stands between backticks is a name."""
    from markupsafe import Markup, escape

    pieces = [escape(piece) for piece in printable(text).split("`")]
    if len(pieces) % 2 == 0:  # a name with a backtick in it: leave the sentence as it is
        return escape(printable(text))
    marked = (Markup('<span class="name">{}</span>').format(p) if i % 2 else p for i, p in enumerate(pieces))
    return Markup("").join(marked)


def _theorem(name: str) -> str:
    """A certificate's theorem in words.

    >>> _theorem("B12-7-sampled")
    'Theorem 7 of Balluchi et al. (2012), sampled'
    """
    base = name.removesuffix("-sampled")
    return _THEOREMS.get(base, base) + (", sampled" if base != name else "")


def _figures(content: ReportContent, *, repaired: bool) -> "dict[str, Markup]":
    """Drawings by name; where there is no Graphviz, its message in their place."""
    report, name = content.report, content.report.des.name
    figures = {"des": _figure("des", lambda: des_dot(report, title=f"{name}: the plant as the observer may see it"))}
    if report.observer is not None:
        figures["observer"] = _figure("obs", lambda: observer_dot(report, title=f"{name}: location observer"))
    if content.plan is not None and repaired:
        better = content.plan.report
        figures["complementary"] = _figure("cdes", lambda: des_dot(better, title=f"{name}: with the signatures"))
        if better.observer is not None:
            title = f"{name}: location observer with the signatures"
            figures["complementary_observer"] = _figure("cobs", lambda: observer_dot(better, title=title))
    return figures


def _figure(prefix: str, dot: Callable[[], str]) -> "Markup":
    from markupsafe import Markup

    try:
        return Markup(inline_svg(render_drawing(dot(), "svg"), prefix))
    except UsageError as error:
        return Markup("<p class='missing'>{}</p>").format(error.diagnostics[0].message)


def inline_svg(svg: bytes, prefix: str) -> str:
    """Return an SVG file's drawing as it may stand in a page beside others: no prologue, ids with a prefix.

    >>> inline_svg(b'<?xml version="1.0"?><svg><g id="q0"><text>id="q0"</text></g></svg>', "des")
    '<svg role="img"><g id="des-q0"><text>id="q0"</text></g></svg>'
    """
    body = _SVG_HEAD.sub("", svg.decode("utf-8"), count=1)
    return _SVG_ID.sub(rf"\1{prefix}-", body).replace("<svg", '<svg role="img"', 1).rstrip("\n")


def _charts(content: ReportContent) -> "dict[str, Markup]":
    from markupsafe import Markup

    charts = {}
    if content.gains is not None and content.system is not None:
        spectra = {name: list(values) for name, values in content.gains.eigenvalues.items()}
        step = content.system.time_step
        charts["eigenvalues"] = Markup(eigenvalue_chart(spectra, rate=content.gains.rate, step=step))
    if content.detector is not None:
        dwell = content.certificates[-1].dwell if content.certificates else None
        charts["delays"] = Markup(delay_chart(content.detector.detection_delay, dwell=dwell))
    return charts


def _feasibility(content: ReportContent) -> dict[str, str]:
    """By signature name: always, generic, never or unknown; nothing where no candidates are given."""
    from deshybrid.detector.candidates import feasibility

    if content.plan is None or not content.candidates:
        return {}
    return {s.name: feasibility(content.candidates, s.location, s.by, s.transitions) for s in content.plan.signatures}


def _cost(content: ReportContent) -> Any:
    from deshybrid.emit.ctables import c_tables, cost

    tables = content.tables
    return None if tables is None else cost(tables, c_tables(tables, content.real), content.real)
