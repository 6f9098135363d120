"""A hybrid observer as one Python file: `StepTables` in, a text out that needs nothing but Python's standard library.

Idea: the source text of the reference step goes in word for word, with the tables as literals, a thin class around it
and recorded samples for a self-test.  Linear in the size of the tables.
Source: the reference step (`deshybrid.observer.reference`).
"""

from collections.abc import Mapping
from importlib import resources
from typing import Any

from deshybrid.emit.identifiers import check_prefix
from deshybrid.emit.provenance import Provenance, banner, certificate_lines
from deshybrid.emit.vectors import Vector, record_vectors
from deshybrid.observer.tables import STATUS_NAMES, StepTables, plain_tables

_SAMPLES, _SEED, _WIDTH = 400, 1, 112


def emit_python(tables: StepTables, *, prefix: str, provenance: Provenance) -> dict[str, str]:
    """Return the Python code of an observer: one text under the name `<prefix>.py`.

    The file has a class `Observer` with `step(u, y, event=None)`, and tests itself when it is run.  Write it in UTF-8;
    every number and every name reads back as it was.  The same arguments give the same bytes.

    Raises UsageError DH0811 where `prefix` is no name of a module.
    """
    from jinja2 import Environment, PackageLoader, StrictUndefined

    check_prefix(prefix)
    loader = PackageLoader("deshybrid.emit", "templates/python")
    environment = Environment(
        loader=loader,
        undefined=StrictUndefined,
        autoescape=False,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return {f"{prefix}.py": environment.get_template("observer.py.j2").render(_context(tables, prefix, provenance))}


def _context(tables: StepTables, prefix: str, origin: Provenance) -> Mapping[str, Any]:
    """All that the template prints: every value of the model as a literal in ASCII."""
    vectors = record_vectors(tables, seed=_SEED, count=_SAMPLES, reset_every=_SAMPLES // 2)
    kinds = ("state", "input", "output", "location", "event", "signature")
    return {
        "p": prefix,
        "banner": banner(origin, _facts(tables, origin)),
        "reference": (resources.files("deshybrid.observer") / "reference.py").read_text(encoding="utf-8").rstrip("\n"),
        "step": repr(tables.step),
        **{f"{kind}_names": ascii(getattr(tables, f"{kind}_names")) for kind in kinds},
        "status_names": ascii(STATUS_NAMES),
        "entry_estimates": _literal(tuple(state.entry_estimate for state in tables.tracker)),
        "tables": _literal(plain_tables(tables)),
        "vectors": [_vector(vector) for vector in vectors],
    }


def _facts(tables: StepTables, origin: Provenance) -> list[str]:
    n, m, p = len(tables.state_names), len(tables.input_names), len(tables.output_names)
    return [
        f"Location observer: {len(tables.tracker)} states.  Continuous observer: n = {n}, m = {m}, p = {p}, "
        f"step {tables.step!r} s.",
        *certificate_lines(origin, n),
        *origin.notes,
    ]


def _literal(value: Any, indent: int = 0) -> str:
    """Return a nested value as source text that fits the line, one entry a line where it does not."""
    short = repr(value)
    if not isinstance(value, dict | tuple) or indent + len(short) <= _WIDTH:
        return short
    inner, pad = indent + 4, " " * indent
    if isinstance(value, dict):
        entries = [f"{key!r}: {_literal(entry, inner)}" for key, entry in value.items()]
    else:
        entries = [_literal(entry, inner) for entry in value]
    opening, closing = ("{", "}") if isinstance(value, dict) else ("(", ")")
    return "\n".join((opening, *(f"{pad}    {entry}," for entry in entries), pad + closing))


def _vector(vector: Vector) -> str:
    estimate = (vector.location, vector.tracker, vector.signature, vector.status, vector.x)
    return repr((vector.reset, vector.input, vector.output, vector.event, estimate))
