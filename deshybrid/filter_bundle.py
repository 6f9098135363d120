"""A generated filter as files: report, C, Python, and the manifest that says what they were made from.

In: a stochastic model and the user's wishes.  Out: the bytes of every file by its name; nothing is written here.
"""

from typing import Literal

from deshybrid import bundle
from deshybrid.compiler import Source, to_hybrid
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.emit.filter_report import FilterReport, emit_filter_report
from deshybrid.emit.filters import FilterModel, emit_filter_c, emit_filter_python, filter_facts
from deshybrid.emit.identifiers import check_prefix, identifier
from deshybrid.stochastic.from_model import stochastic_system


def files(
    source: Source,
    kind: Literal["imm", "mmae", "rmimm", "skf"] | None,
    wishes: bundle.Wishes,
    *,
    step: float | None = None,
    gate: float | None = None,
) -> dict[str, bytes]:
    """Return the files of a filter: name, with `/`, and bytes; `step` (s) is needed in continuous time only.

    With a `gate` (a probability) the filter leaves outliers out, as `estimate` does.

    Raises `ModelError` (DH1101) and `UsageError` (DH0306, DH0601, DH0811 to DH0813, DH1103, DH1111; DH1113 for a filter
    that is not generated, or a gate without a filter).

    >>> sorted(files("models/hwang2006/turn.yaml", "imm", bundle.Wishes()))[:2]
    ['MANIFEST.json', 'c/CMakeLists.txt']
    """
    if kind is None:
        helps = ("name the filter: `--filter imm`, `mmae` or `skf`",)
        raise UsageError(diagnostic("DH1113", "`--gate` is that of a generated filter, and none is", helps=helps))
    if kind == "rmimm":
        helps = ("generate `imm`: in no comparison here did `rmimm` make fewer errors",)
        raise UsageError(diagnostic("DH1113", "`rmimm` is for comparison with the paper; no code is made", helps=helps))
    system = to_hybrid(source)
    channels = (system.state_names, system.input_names, system.output_names)
    model = FilterModel(stochastic_system(system, step=step), kind, *channels, gate)
    prefix = identifier(system.name) if wishes.prefix is None else wishes.prefix
    check_prefix(prefix)
    origin = bundle.origin_of(system)
    texts = bundle.code(
        wishes,
        c=lambda: emit_filter_c(model, prefix=prefix, real=wishes.real, provenance=origin),
        python=lambda: emit_filter_python(model, prefix=prefix, provenance=origin),
    )
    options: dict[str, object] = {
        "filter": kind,
        "targets": list(wishes.targets),
        "real": wishes.real,
        "prefix": wishes.prefix,
        "step": step,
        "gate": gate,
    }
    names = (*texts, "report.html", "MANIFEST.json")
    texts["report.html"] = emit_filter_report(
        FilterReport(
            model,
            origin,
            tuple(filter_facts(model, wishes.real, origin)),
            system.summary or "",
            system.units,
            system.time_step or step,
            names,
            prefix,
            tuple((key, bundle.shown(value)) for key, value in options.items()),
        )
    )
    texts["MANIFEST.json"] = bundle.manifest(origin, options, names)
    return {name: text.encode() for name, text in texts.items()}
