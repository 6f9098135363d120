"""A generated filter as files: C, Python, and the manifest that says what they were made from.

In: a stochastic model and the user's wishes.  Out: the bytes of every file by its name; nothing is written here.
"""

from importlib.metadata import version
from pathlib import Path

from deshybrid.bundle import Wishes
from deshybrid.compiler import Source, to_hybrid
from deshybrid.emit.filter_vectors import FilterKind
from deshybrid.emit.filters import FilterModel, emit_filter_c, emit_filter_python
from deshybrid.emit.identifiers import check_prefix, identifier
from deshybrid.emit.provenance import Provenance
from deshybrid.emit.records import to_json
from deshybrid.model.system import HybridSystem
from deshybrid.stochastic.from_model import stochastic_system


def files(source: Source, kind: FilterKind, wishes: Wishes, *, step: float | None = None) -> dict[str, bytes]:
    """Return the files of a filter: name, with `/`, and bytes; `step` (s) is needed in continuous time only.

    Raises `ModelError` (DH1101) and `UsageError` (DH0306, DH0601, DH0811 to DH0813, DH1103).

    >>> sorted(files("models/hwang2006/turn.yaml", "imm", Wishes()))[:2]
    ['MANIFEST.json', 'c/CMakeLists.txt']
    """
    system = to_hybrid(source)
    model = FilterModel(
        stochastic_system(system, step=step), kind, system.state_names, system.input_names, system.output_names
    )
    prefix = identifier(system.name) if wishes.prefix is None else wishes.prefix
    check_prefix(prefix)
    origin = _provenance(system)
    texts: dict[str, str] = {}
    if "c" in wishes.targets:
        code = emit_filter_c(model, prefix=prefix, real=wishes.real, provenance=origin)
        texts |= {f"c/{name}": text for name, text in code.items()}
    if "python" in wishes.targets:
        code = emit_filter_python(model, prefix=prefix, provenance=origin)
        texts |= {f"python/{name}": text for name, text in code.items()}
    options = {
        "filter": kind,
        "targets": list(wishes.targets),
        "real": wishes.real,
        "prefix": wishes.prefix,
        "step": step,
    }
    texts["MANIFEST.json"] = to_json(
        {
            "format": "deshybrid-manifest/1",
            "tool": "deshybrid",
            "version": origin.tool_version,
            "model": {"name": origin.model, "file": origin.file, "sha256": origin.sha256},
            "options": {**options, "step": step},
            "files": [*texts, "MANIFEST.json"],
        }
    )
    return {name: text.encode() for name, text in texts.items()}


def _provenance(system: HybridSystem) -> Provenance:
    source, first = system.source, system.locations[0].span
    file = "a system built in Python" if first is None else Path(first.source.name).name
    sha256 = "none" if source is None else source.sha256
    return Provenance(system.name, file, sha256, version("deshybrid"))
