"""Generated filters: IMM, MMAE and the switching Kalman filter of a model as C and as Python.

In: a `StochasticSystem`, the names of its channels, where it came from.  Out: the texts of the files by their names.
Idea: the matrices become `const` tables, the step is one fixed text that does what `deshybrid.stochastic.stepwise`
does, operation by operation; Python gets that very text.  C99 that is also C11 and C++, without heap and library; in
both types of numbers equal to the reference bit for bit.

Linear in the size of the matrices.  Source: the reference step; ISO C99.
"""

import re
import textwrap
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib import resources
from typing import Any

from deshybrid.emit.csource import C_FILES, braced, named, template_environment
from deshybrid.emit.ctables import Real, Table
from deshybrid.emit.filter_vectors import FilterKind, Row, array_sizes, flat_constants, record_rows
from deshybrid.emit.identifiers import c_real, check_names, check_prefix
from deshybrid.emit.provenance import Provenance, banner
from deshybrid.stochastic import stepwise_numbers
from deshybrid.stochastic.stepwise_values import Constants, Room, State
from deshybrid.stochastic.system import StochasticSystem

_ROWS, _SEED, _WIDTH = 120, 1, 110
_BYTES = {"double": 8, "float": 4}
_TITLES = {
    "imm": "IMM filter, location unknown",
    "mmae": "MMAE filter, location unknown",
    "skf": "switching Kalman filter, location known",
}
_REFERENCE = ("stepwise_values", "stepwise_numbers", "stepwise_gaussians", "stepwise")
_IMPORT = re.compile(r"^from deshybrid\S* import (\([^)]*\)|.*)\n", re.MULTILINE)
_TABLES = {
    "F": ("F", "by location: F, row by row"),
    "Q": ("Q", "by location: covariance of the process noise"),
    "B": ("B", "by location: B"),
    "f": ("f", "by location: offset of the state"),
    "H": ("H", "by location: H"),
    "R": ("covariance_R", "by location: covariance of the measurement noise"),
    "D": ("D", "by location: D"),
    "g": ("g", "by location: offset of the outputs"),
    "probability_to_from": ("probability_to_from", "[to][from]"),
    "x": ("prior_x", "one step before the first row"),
    "P": ("prior_P", "one step before the first row"),
    "mu": ("prior_mu", "one step before the first row"),
    "powers": ("powers_of_two", "2, 2^2, 2^4, ..."),
    "limits": ("gate_limits", "of the squared distance, by number of measured outputs"),
}
_UNKNOWN_MODE = ("probability_to_from", "mu")
_C_NAMES = {"x": "x0", "P": "P0"}  # of the room, beside those of the state


@dataclass(frozen=True, slots=True)
class FilterModel:
    """A system to be generated, which filter, and the names of its channels."""

    system: StochasticSystem
    kind: FilterKind
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    gate: float | None = None


def emit_filter_c(model: FilterModel, *, prefix: str, real: Real, provenance: Provenance) -> dict[str, str]:
    """Return the C code of a filter: the text of each file by its name; the same arguments give the same bytes.

    Raises `UsageError`: DH0811 for an unusable prefix, DH0812 for a name that no C string holds, DH0813 for a constant
    that does not fit `real`, DH1103 where the modes of an IMM or MMAE measure different outputs, DH1111.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> walk = FilterModel(calm_and_wild(), "imm", ("x",), (), ("y",))
    >>> list(emit_filter_c(walk, prefix="walk", real="double", provenance=Provenance("walk", "walk.yaml", "3f9c", "0")))
    ['walk.h', 'walk.c', 'walk_selftest.c', 'Makefile', 'CMakeLists.txt', 'README.md']
    """
    check_prefix(prefix)
    check_names("location", model.system.names)
    environment = template_environment("filter", "c")
    environment.filters["number"] = lambda value: c_real(value, real)
    context = _c_context(model, prefix, real, provenance)
    return {name.format(prefix): environment.get_template(file).render(context) for name, file in C_FILES.items()}


def emit_filter_python(model: FilterModel, *, prefix: str, provenance: Provenance) -> dict[str, str]:
    """Return one Python file that needs nothing, not even numpy, with the text of the reference step in it.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> walk = FilterModel(calm_and_wild(), "imm", ("x",), (), ("y",))
    >>> list(emit_filter_python(walk, prefix="walk", provenance=Provenance("walk", "walk.yaml", "3f9c", "0")))
    ['walk.py']
    """
    check_prefix(prefix)
    c = flat_constants(model.system, model.kind, "double", gate=model.gate)
    sizes = array_sizes(c, model.kind)
    rows = record_rows(model.system, model.kind, seed=_SEED, count=_ROWS, reset_every=_ROWS // 2, gate=model.gate)
    context = {
        "p": prefix,
        "known": model.kind == "skf",
        "kind": model.kind,
        "banner": banner(provenance, filter_facts(model, "double", provenance)),
        "source": "\n\n\n".join(_reference(name) for name in _REFERENCE),
        "constants": [f"{name}={_wrapped(value)}" for name, value in c._asdict().items()],
        "sizes": {made.__name__: list(entries.values()) for made, entries in sizes.items()},
        "states": ascii(model.state_names),
        "inputs": ascii(model.input_names),
        "outputs": ascii(model.output_names),
        "locations": ascii(model.system.names),
        "rows": [(r.u, r.z, r.mode, r.reset, r.status, r.x, r.P, r.mu, r.told) for r in rows],
    }
    return {f"{prefix}.py": template_environment("filter", "c").get_template("filter.py.j2").render(context)}


def _reference(module: str) -> str:
    """The text of a module of the reference step, without its imports of the others."""
    text = (resources.files("deshybrid.stochastic") / f"{module}.py").read_text(encoding="utf-8")
    return _IMPORT.sub("", text).rstrip("\n")


def _c_context(model: FilterModel, prefix: str, real: Real, origin: Provenance) -> Mapping[str, Any]:
    c = flat_constants(model.system, model.kind, real, gate=model.gate)
    rows = record_rows(
        model.system, model.kind, seed=_SEED, count=_ROWS, real=real, reset_every=_ROWS // 2, gate=model.gate
    )
    facts = filter_facts(model, real, origin)
    names = model.system.names
    known = model.kind == "skf"
    return {
        "p": prefix,
        "P": prefix.upper(),
        "real": real,
        "known": known,
        "mixing": model.kind == "imm",
        "gated": model.gate is not None,
        "patience": c.patience,
        "origin": origin,
        "facts": facts,
        "banner": banner(origin, facts),
        "n": c.n,
        "m": c.m,
        "r": c.p,
        "slots": 1 if known else c.modes,
        "powers": len(c.powers),
        "least": float(c.least),
        "largest": float(c.largest),
        "log2_e": stepwise_numbers.LOG2_E,
        "ln2_high": stepwise_numbers.LN2_HIGH,
        "ln2_low": stepwise_numbers.LN2_LOW,
        "root_2": stepwise_numbers.ROOT_2,
        "half_log_2pi": stepwise_numbers.HALF_LOG_2PI,
        "exp_terms": len(stepwise_numbers.EXP),
        "log_terms": len(stepwise_numbers.LOG),
        "tables": _tables(c, real, known=known),
        "members": _members(c, model.kind, real),
        "locations": named(names, "UNKNOWN"),
        "location_names": names,
        "state_names": model.state_names,
        "input_names": model.input_names,
        "output_names": model.output_names,
        "vectors": [_vector(row, c.n, real, known=known) for row in rows],
    }


def _tables(c: Constants, real: Real, *, known: bool) -> list[Table]:
    unused = {*(_UNKNOWN_MODE if known else ()), *(() if c.limits else ("limits",))}
    numbers = {name: getattr(c, key) for key, (name, _) in _TABLES.items() if key not in unused}
    meanings = dict(_TABLES.values())
    if not known:
        numbers["exp_series"], meanings["exp_series"] = stepwise_numbers.EXP, "1/13!, 1/12!, ..."
    numbers["log_series"], meanings["log_series"] = stepwise_numbers.LOG, "1/21, 1/19, ..."
    tables = [
        _table(name, real, meanings[name], [c_real(float(value), real) for value in values])
        for name, values in numbers.items()
    ]
    flags = [str(flag) for flag in c.measured]
    return [*tables, _table("measured", "uint8_t", "by location: 1 where an output is measured", flags)]


def _table(name: str, c_type: str, meaning: str, entries: Sequence[str]) -> Table:
    lines = textwrap.wrap(", ".join(entries) or "0", _WIDTH)
    return Table(name, c_type, meaning, len(entries), tuple(lines))


def _members(c: Constants, kind: FilterKind, real: Real) -> list[tuple[str, str, int, str]]:
    """The arrays of the state structure, the largest type first: name, type, length, meaning."""
    sizes = array_sizes(c, kind)
    kept = [(name, size, "") for name, size in sizes[State].items()]
    room = [(_C_NAMES.get(name, name), size, "room") for name, size in sizes[Room].items()]
    unused = {"spread", "weight", "predicted", "mu"} if kind == "skf" else set()
    if not c.limits:
        unused |= {"count"} if kind == "skf" else {"count", "distance"}
    arrays = [(name, max(size, 1), note) for name, size, note in (*kept, *room) if name not in unused]
    flags = ("seen", "started", "count")
    typed = [(name, "uint8_t" if name in flags else real, size, note) for name, size, note in arrays]
    return [
        (name, kind_of if kind_of == "uint8_t" else "{}", size, note)
        for name, kind_of, size, note in sorted(typed, key=lambda entry: entry[1] == "uint8_t")
    ]


def filter_facts(model: FilterModel, real: Real, origin: Provenance) -> list[str]:
    """Return what header, README and report say of a filter: its size, its cost, its gate, and what holds.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> walk = FilterModel(calm_and_wild(), "imm", ("x",), (), ("y",))
    >>> filter_facts(walk, "double", Provenance("walk", "walk.yaml", "3f9c", "0"))[0]
    'IMM filter, location unknown: 2 locations, n = 1, m = 0, p = 1, double.  No heap.'
    """
    c = flat_constants(model.system, model.kind, real, gate=model.gate)
    n, m, p = c.n, c.m, c.p
    each = n * (n + m) + n**3 + n * n * (n + 1) // 2 + p * (m + n + n * n) + p * (p + 1) // 2 * n
    each += p * (p - 1) // 2 * (n + 2 * p + 1) + p * (n + n * (n + 1) // 2)
    blends = {"imm": c.modes + 1, "mmae": 1, "skf": 0}[model.kind] * c.modes * (n + n * (n + 1))
    bytes_of_state = sum(
        size * (1 if kind == "uint8_t" else _BYTES[real]) for _, kind, size, _ in _members(c, model.kind, real)
    )
    whole = -(-bytes_of_state // _BYTES[real]) * _BYTES[real]
    tables = sum(table.bytes for table in _tables(c, real, known=model.kind == "skf"))
    return [
        f"{_TITLES[model.kind]}: {c.modes} locations, n = {n}, m = {m}, p = {p}, {real}.  No heap.",
        f"One row: about {(1 if model.kind == 'skf' else c.modes) * each + blends} multiplications.",
        f"Memory: {whole} bytes of state, {tables} bytes of tables.",
        "Nothing is certified: a filter is as good as its model.  With a fitting one the mean of nis is the number of "
        "outputs.",
        *([] if model.gate is None else [_gate_fact(model.gate, c.patience)]),
        *origin.notes,
    ]


def _gate_fact(gate: float, patience: int) -> str:
    until = f"it opens after {patience} in a row, and closes after {patience} rows in a row within it"
    return f"Gate of {gate:g}: a row that no location expects with that probability is left out; {until}."


def _vector(row: Row, n: int, real: Real, *, known: bool) -> str:
    """One initialiser of the self-test's `vector_t`."""
    where = f", {row.mode}" if known else ""
    variance = row.P[:: n + 1]
    numbers = ", ".join(braced(values, real) for values in (row.x, variance, row.mu, row.told))
    return f"{{{{{braced(row.u, real)}, {braced(row.z, real)}{where}}}, {numbers}, {row.status}, {int(row.reset)}}}"


def _wrapped(value: Any) -> str:
    if not isinstance(value, tuple):
        return repr(value)
    return "(" + "\n        ".join(textwrap.wrap(", ".join(map(repr, value)) + ",", _WIDTH)) + ")" if value else "()"


__all__ = ["FilterModel", "emit_filter_c", "emit_filter_python", "filter_facts"]
