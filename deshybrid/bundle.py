"""A compilation as files: report, drawings, design, code, and the manifest that says what they were made from.

In: a `Compilation` and the user's wishes.  Out: the bytes of every file by its name; nothing is written here, so that
a failure leaves no half of a folder.  Where no observer exists, there is only the report with its drawings.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from importlib.metadata import version
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from deshybrid.compiler import MAX_STATES, Compilation, Source, check, recover
from deshybrid.des.observability import ObservabilityReport
from deshybrid.des.observer import build_location_observer
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.emit.drawing import draw
from deshybrid.emit.picture import des_picture, dprime_picture, observer_picture
from deshybrid.emit.provenance import Provenance
from deshybrid.emit.records import check_record, recover_record, to_json
from deshybrid.model.system import HybridSystem
from deshybrid.observer.tables import StepTables

if TYPE_CHECKING:
    from deshybrid.emit.html import ReportContent

FORMATS = ("svg", "png", "pdf", "dot", "mmd", "graphml")


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the user asks of the generated code; `prefix` None takes the model's name."""

    targets: tuple[str, ...] = ("c", "python")
    real: Literal["double", "float"] = "double"
    prefix: str | None = None


def files(made: Compilation, wishes: Wishes = Wishes()) -> dict[str, bytes]:
    """Return every file of a compilation: name, with `/`, and bytes.

    Raises `UsageError` (DH0811) for a prefix that is no identifier.
    """
    from deshybrid.emit.html import emit_report
    from deshybrid.emit.identifiers import check_prefix, identifier

    origin = provenance(made)
    prefix = identifier(made.design.system.name) if wishes.prefix is None else wishes.prefix
    check_prefix(prefix)
    texts: dict[str, str | bytes] = {**_drawings(made)}
    if made.design.gains is not None:
        texts["design.json"] = to_json(made.design.document())
    if made.observer is not None:
        texts |= _observer_code(made.observer.tables, wishes, prefix, origin)
    names = (*texts, "report.html", "report.json", "MANIFEST.json")
    texts["report.html"] = emit_report(_content(made, wishes, prefix, origin, names))
    texts["report.json"] = to_json(record(made, wishes))
    texts["MANIFEST.json"] = manifest(origin, _options(made, wishes), names)
    return {name: text if isinstance(text, bytes) else text.encode() for name, text in texts.items()}


def drawing(source: Source, what: str, kind: str, *, max_states: int = MAX_STATES) -> bytes:
    """Return one drawing of a model: `what` as the command names it, `kind` one of FORMATS.

    Raises `UsageError` (DH0309) for a complementary drawing of a system that no signatures repair, and `LimitReached`
    where an observer is to be drawn that a limit cut short.
    """
    report = check(source, method="observer" if what == "observer" else "auto", max_states=max_states)
    if what.startswith("complementary"):
        plan = recover(source, max_states=max_states).plan
        if not plan.recoverable:
            raise UsageError(
                diagnostic("DH0309", f"`{report.des.name}` has no complementary DES: it is not recoverable")
            )
        report = plan.report
    if _KINDS.get(what, what) == "observer" and report.observer is None:  # the verdict did not need it
        report = replace(report, observer=build_location_observer(report.automaton, max_states=max_states))
    title = f"{report.des.name}: {_TITLES[what]}"
    picture = {"des": des_picture, "dprime": dprime_picture, "observer": observer_picture}[_KINDS.get(what, what)]
    return draw(picture(report, title=title), kind)


_KINDS = {"complementary": "des", "complementary-observer": "observer"}
_TITLES = {
    "des": "the DES",
    "dprime": "the DES without silent transitions",
    "observer": "the location observer",
    "complementary": "the complementary DES",
    "complementary-observer": "the location observer with signatures",
}


def format_of(output: Path | None) -> str:
    """Return the drawing format that a file's suffix names, svg where there is none.

    Raises `UsageError` (DH0801) for a suffix that is no drawing format.

    >>> format_of(Path("observer.pdf")), format_of(None)
    ('pdf', 'svg')
    """
    suffix = "" if output is None else output.suffix.removeprefix(".").lower()
    if suffix and suffix not in FORMATS:
        helps = ("choose one of " + ", ".join(f"`.{name}`" for name in FORMATS) + ", or name a `--format`",)
        raise UsageError(diagnostic("DH0801", f"unknown drawing format `{suffix}`", helps=helps))
    return suffix or "svg"


def provenance(made: Compilation) -> Provenance:
    """Return where the code of a compilation comes from and what is proven of it."""
    system = made.design.system
    together = made.design.determined
    claims = [f"{c.theorem}: {c.reason}" for c in made.design.certificates]
    claims += [] if together is None else [f"{c.theorem}: {c.reason}" for c in together.certificates]
    return replace(origin_of(system), certificate=tuple(claims), notes=_tracker_notes(made))


def origin_of(system: HybridSystem) -> Provenance:
    """Return from which model code comes, with nothing proven.

    >>> from deshybrid.model.load import load
    >>> origin_of(load("models/hwang2006/turn.yaml")).file
    'turn.yaml'
    """
    source, first = system.source, system.locations[0].span
    file = "a system built in Python" if first is None else Path(first.source.name).name
    sha256 = "none" if source is None else source.sha256
    return Provenance(system.name, file, sha256, version("deshybrid"))


def _tracker_notes(made: Compilation) -> tuple[str, ...]:
    if made.observer is None or made.observer.tables.online is None:
        return ()
    return (f"On line, as a table of the location observer has more than {made.observer.max_states} states.",)


def record(made: Compilation, wishes: Wishes = Wishes()) -> dict[str, object]:
    """Return what `report.json` holds and `compile --json` prints: verdict, recovery, design, the observer."""
    recovery = made.design.recovery
    return {
        "format": "deshybrid-report/1",
        "check": check_record(recovery.check),
        "recover": recover_record(recovery.plan, recovery.feasibility),
        "design": None if made.design.gains is None else made.design.document(),
        "observer": _observer_record(made, wishes),
        "problems": [{"code": d.code, "severity": d.severity, "message": d.message} for d in made.diagnostics],
    }


def _observer_record(made: Compilation, wishes: Wishes) -> dict[str, object] | None:
    """How the observer runs and what one step of the generated C costs; `states` is null where it runs on line."""
    from deshybrid.emit.ctables import c_tables, cost

    if made.observer is None:
        return None
    tables = made.observer.tables
    price = cost(tables, c_tables(tables, wishes.real), wishes.real)
    return {
        "states": len(tables.tracker) if tables.online is None else None,
        "step": tables.step,
        "certified": made.design.certified,
        "tracker": "table" if tables.online is None else "online",
        "tracker_reason": made.observer.tracker_reason,
        "cost": asdict(price),
    }


def _drawings(made: Compilation) -> dict[str, bytes]:
    """The plant as it is and, where signatures are needed, with them; an observer too large to build is not drawn."""
    recovery = made.design.recovery
    reports: list[tuple[str, ObservabilityReport]] = [("", recovery.check)]
    if recovery.plan.signatures:
        reports.append(("complementary-", recovery.plan.report))
    pictures = {}
    for prefix, report in reports:
        for what, picture in (("des", des_picture), ("observer", observer_picture)):
            name = {"complementary-des": "complementary"}.get(prefix + what, prefix + what)
            if what == "des" or report.observer is not None:
                pictures[name] = picture(report, title=f"{report.des.name}: {_TITLES[name]}")
    return {f"{name}.{kind}": draw(picture, kind) for name, picture in pictures.items() for kind in ("svg", "dot")}


def _observer_code(tables: StepTables, wishes: Wishes, prefix: str, origin: Provenance) -> dict[str, str]:
    from deshybrid.emit.c import emit_c
    from deshybrid.emit.python import emit_python

    return code(
        wishes,
        c=lambda: emit_c(tables, prefix=prefix, real=wishes.real, provenance=origin),
        python=lambda: emit_python(tables, prefix=prefix, provenance=origin),
    )


def code(
    wishes: Wishes, *, c: Callable[[], Mapping[str, str]], python: Callable[[], Mapping[str, str]]
) -> dict[str, str]:
    """Return the files of the languages that are wished for, each in the folder of its language.

    >>> code(Wishes(targets=("c",)), c=lambda: {"a.c": ""}, python=lambda: {"a.py": ""})
    {'c/a.c': ''}
    """
    makers = {"c": c, "python": python}
    wished = [target for target in makers if target in wishes.targets]
    return {f"{target}/{name}": text for target in wished for name, text in makers[target]().items()}


def _content(
    made: Compilation, wishes: Wishes, prefix: str, origin: Provenance, names: tuple[str, ...]
) -> "ReportContent":
    from deshybrid.emit.html import ReportContent

    design, observer = made.design, made.observer
    return ReportContent(
        report=design.recovery.check,
        provenance=origin,
        system=design.system,
        plan=design.recovery.plan,
        candidates=design.recovery.candidates,
        detector=design.detector,
        gains=design.gains,
        certificates=design.certificates,
        ultimate=design.ultimate,
        lower_limit=design.lower_limit,
        determined=design.determined,
        tables=None if observer is None else observer.tables,
        real=wishes.real,
        files=names,
        prefix=prefix,
        options=tuple((key, shown(value)) for key, value in _options(made, wishes).items()),
        warnings=made.diagnostics,
    )


def shown(option: object) -> str:
    """Return an option as the report names it.

    >>> shown(["c", "python"]), shown(None)
    ('c, python', 'default')
    """
    if isinstance(option, list):
        return ", ".join(map(str, option))
    return "default" if option is None else str(option)


def _options(made: Compilation, wishes: Wishes) -> dict[str, object]:
    gains = made.design.gains
    return {
        "targets": list(wishes.targets),
        "real": wishes.real,
        "prefix": wishes.prefix,
        "step": made.design.step,
        "rate": None if gains is None else gains.rate,
        "dwell": None if gains is None else gains.dwell,
        **({} if gains is None or gains.method == "place" else {"method": gains.method}),
        "max_states": None if made.observer is None else made.observer.max_states,
    }


def manifest(origin: Provenance, options: Mapping[str, object], names: Sequence[str]) -> str:
    """Return the text of MANIFEST.json: which tool made which files from which model, with which options.

    >>> '"files": [' in manifest(Provenance("gearbox", "gearbox.yaml", "3f9c", "0.1.0"), {}, ["MANIFEST.json"])
    True
    """
    return to_json(
        {
            "format": "deshybrid-manifest/1",
            "tool": "deshybrid",
            "version": origin.tool_version,
            "model": {"name": origin.model, "file": origin.file, "sha256": origin.sha256},
            "options": dict(options),
            "files": list(names),
        }
    )


def listing(folder: Path, files: Iterable[str]) -> str:
    """Return a line for each file that was written into a folder.

    >>> listing(Path("build"), ["des.svg"])
    '  wrote build/des.svg\\n'
    """
    return "".join(f"  wrote {folder / name}\n" for name in files)
