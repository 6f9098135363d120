"""The C code of a hybrid observer: `StepTables` in, the texts of six files out.

Idea: the tables become `const` arrays, the step is one fixed text that walks them in the order of the reference step;
both are printed by the templates in `templates/c`.  The code is C99 that is also C11 and C++, and in double precision
equal to the reference bit for bit.  Linear in the size of the tables.
Source: the reference step (`deshybrid.observer.reference`); ISO C99.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.emit.conline import layout, words
from deshybrid.emit.csource import C_FILES, Named, braced, named, template_environment
from deshybrid.emit.ctables import Cost, Real, c_tables, cost
from deshybrid.emit.identifiers import (
    c_real,
    check_names,
    check_prefix,
    unique_identifiers,
)
from deshybrid.emit.provenance import Provenance, banner, certificate_lines, decision_facts, tracker_fact
from deshybrid.emit.vectors import Vector, record_vectors
from deshybrid.observer import reference
from deshybrid.observer.tables import STATUS_NAMES, StepTables, evidence_size, evidence_start

if TYPE_CHECKING:
    pass

_SAMPLES, _SEED = 400, 1


def emit_c(tables: StepTables, *, prefix: str, real: Real = "double", provenance: Provenance) -> dict[str, str]:
    """Return the C code of an observer: the text of each file by its name.

    Parameters
    ----------
    tables : StepTables
        All constants of the observer.
    prefix : str
        Begins every public name and every file's name.
    real : "double" or "float"
        The type of every number; `float` code has no double in it.
    provenance : Provenance
        What the header says about the origin.

    Raises
    ------
    UsageError
        DH0811 for an unusable prefix, DH0812 for a name that no C string holds, DH0813 for a constant that does not fit
        `real`, DH0814 for another `real`.

    Notes
    -----
    The files are `<prefix>.h`, `<prefix>.c`, `<prefix>_selftest.c`, `Makefile`, `CMakeLists.txt` and `README.md`; all
    are ASCII.  The same arguments give the same bytes.

    >>> from deshybrid.compiler import compile
    >>> from deshybrid.model.load import loads
    >>> turns = "[{from: off, to: on, event: press}, {from: on, to: off, event: release}]"
    >>> lamp = compile(loads(f"{{format: deshybrid/1, name: lamp, locations: [off, on], transitions: {turns}}}"))
    >>> list(emit_c(lamp.observer.tables, prefix="lamp", provenance=Provenance("lamp", "lamp.yaml", "3f9c", "0.1.0")))
    ['lamp.h', 'lamp.c', 'lamp_selftest.c', 'Makefile', 'CMakeLists.txt', 'README.md']
    """
    check_prefix(prefix)
    if real not in ("double", "float"):
        raise UsageError(diagnostic("DH0814", f"real type `{real}`, expected `double` or `float`"))
    for kind, names in _spoken_names(tables).items():
        check_names(kind, names)
    environment = template_environment("c")
    context = _context(tables, prefix, real, provenance)
    return {
        name.format(prefix): environment.get_template(template).render(context) for name, template in C_FILES.items()
    }


def _spoken_names(tables: StepTables) -> dict[str, Sequence[str]]:
    """The names that become C strings."""
    return {"location": tables.location_names, "event": tables.event_names, "signature": tables.signature_names}


def _context(tables: StepTables, prefix: str, real: Real, origin: Provenance) -> Mapping[str, Any]:
    """All that the templates print."""
    printed = c_tables(tables, real)
    vectors = record_vectors(tables, seed=_SEED, count=_SAMPLES, real=real, reset_every=_SAMPLES // 2)
    rows = {entered: row for row, entered in enumerate(dict.fromkeys(vector.entry_estimate for vector in vectors))}
    facts = _facts(tables, origin, real, cost(tables, printed, real))
    spoken = _spoken_names(tables)
    return {
        "p": prefix,
        "P": prefix.upper(),
        "real": real,
        "origin": origin,
        "facts": facts,
        "banner": banner(origin, facts),
        "seconds": repr(tables.step),
        "step": c_real(tables.step, real),
        "n": len(tables.state_names),
        "m": len(tables.input_names),
        "r": len(tables.output_names),
        "k": tables.generators.order,
        "state_names": tables.state_names,
        "input_names": tables.input_names,
        "output_names": tables.output_names,
        "locations": named(tables.location_names, "UNKNOWN"),
        "events": named(tables.event_names, "NONE"),
        "signatures": named(tables.signature_names, "NONE"),
        "commands": _commands(tables),
        "strings": {**{f"{kind}_names": names for kind, names in spoken.items()}, "status_names": STATUS_NAMES},
        "longest_name": max(len(name.encode("utf-8", "surrogatepass")) for name in ("", *tables.event_names)),
        "generator_count": len(tables.generators.locations),
        "reset_count": len(tables.reset_matrix),
        "tables": printed,
        "initial": tables.initial,
        "restart": tables.restart,
        "online": None if tables.online is None else layout(tables.online),
        "window_ticks": tables.window_ticks,
        "command_slack": tables.command_slack,
        **_decision(tables, real),
        "largest": c_real(reference.LARGEST, real),
        "entry_rows": [_entry_row(entered, len(tables.location_names)) for entered in rows],
        "vectors": [_vector(vector, rows[vector.entry_estimate], real) for vector in vectors],
    }


def _decision(tables: StepTables, real: Real) -> dict[str, object]:
    """How residuals become decisions."""
    return {
        "decision": tables.decision.kind,
        "supervised": tables.decision.kind != "relay",
        "evidence": evidence_size(tables),
        "evidence_start": c_real(evidence_start(tables), real),
        "bank": _bank(tables, real),
        "exclude_ticks": tables.decision.exclude_ticks,
        "patience_ticks": tables.decision.patience_ticks,
    }


def _bank(tables: StepTables, real: Real) -> dict[str, object]:
    bank = tables.decision.bank
    if bank is None:
        return {}
    return {
        "power": bank.power,
        "freedom": c_real(bank.freedom, real),
        "confidence": c_real(bank.confidence, real),
    }


@dataclass(frozen=True, slots=True)
class _Command:
    """A command with the name of its value 0, `unknown`, and those of its values."""

    name: str
    unknown: str
    values: list[Named]


def _commands(tables: StepTables) -> list[_Command]:
    words = [(name, value) for name, values in tables.commands for value in ("unknown", *values)]
    made = iter(unique_identifiers(f"{name} {value}".upper() for name, value in words))
    return [
        _Command(name, next(made), [Named(value, next(made)) for value in values]) for name, values in tables.commands
    ]


def _facts(tables: StepTables, origin: Provenance, real: Real, price: Cost) -> list[str]:
    """The lines of the header comment after the origin."""
    n, m, p = len(tables.state_names), len(tables.input_names), len(tables.output_names)
    named = (*tables.location_names, *tables.event_names, *tables.signature_names)
    text = sum(len(name.encode("utf-8", "surrogatepass")) + 1 for name in named)
    return [
        f"Location observer: {tracker_fact(tables)}, {len(tables.location_names)} locations, "
        f"{len(tables.event_names)} events, {len(tables.signature_names)} signatures, "
        f"{len(tables.generators.locations)} residual generators.",
        f"Continuous observer: n = {n}, m = {m}, p = {p}, step {tables.step!r} s, {real}.  No heap.",
        *certificate_lines(origin, n),
        *decision_facts(tables),
        f"One step: at most {price.multiplications} multiplications and {price.additions} additions"
        f"{f', {price.memberships} looks into the set of pairs' if price.memberships else ''}.",
        f"Memory: {price.state_bytes} bytes of state, {price.table_bytes} bytes of tables, {text} bytes of names.",
        *origin.notes,
    ]


def _entry_row(locations: Sequence[int], count: int) -> str:
    return ", ".join(words(sum(1 << location for location in locations), -(-count // 32)))


def _vector(vector: Vector, entry: int, real: Real) -> str:
    """One initialiser of the self-test's `vector_t`."""
    numbers = (vector.location, vector.signature, vector.status, entry, int(vector.reset))
    command = f", {{{', '.join(map(str, vector.command))}}}" if vector.command else ""
    head = f"{{{braced(vector.input, real)}, {braced(vector.output, real)}, {vector.event}{command}}}"
    return f"{{{head}, {braced(vector.x, real)}, {', '.join(map(str, numbers))}}}"
