"""The tables of a step as C arrays, with what they cost: bytes of state and tables, operations per step.

In: `StepTables`.  Out: flat `const` arrays in the layout that `templates/c/source.c.j2` reads, row by row in the order
of the reference's sums.  Indices take 16 bits where they fit.  Linear in the size of the tables.
"""

import textwrap
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate
from typing import Any, Literal

from deshybrid.emit.conline import layout, memberships, online_rows
from deshybrid.emit.identifiers import c_real
from deshybrid.observer.tables import StepTables, evidence_size, plain_tables

Real = Literal["double", "float"]
_SIZES = {"double": 8, "float": 4, "uint32_t": 4, "int32_t": 4, "uint16_t": 2, "int16_t": 2, "uint8_t": 1}
_LINE = 110
_TESTS = ("sprt", "glr", "imm")


@dataclass(frozen=True, slots=True)
class Table:
    """A `static const` array: `lines` are its initialiser, `length` its number of entries (0: a filler is printed)."""

    name: str
    type: str
    meaning: str
    length: int
    lines: tuple[str, ...]

    @property
    def bytes(self) -> int:
        """Memory that the array takes, its filler included."""
        return _SIZES[self.type] * max(self.length, 1)


@dataclass(frozen=True, slots=True)
class Cost:
    """What one observer costs on a target with natural alignment; the operations are the worst case of one step.

    `memberships`: looks into the sets of an on-line tracker; a table takes none.
    """

    state_bytes: int
    table_bytes: int
    multiplications: int
    additions: int
    memberships: int = 0


def index_type(tables: StepTables) -> str:
    """Return the narrowest of int16_t and int32_t that holds every index into the tables."""
    entries = sum(len(state.entry_estimate) for state in tables.tracker)
    candidates = [candidate for state in tables.tracker for candidate in state.candidates]
    quiet = sum(len(candidate.quiet) for candidate in candidates)
    largest = max(entries, len(candidates), quiet, len(tables.tracker), len(tables.signature_names))
    return "int16_t" if max(largest, len(tables.reset_matrix)) < 2**15 else "int32_t"


def c_tables(tables: StepTables, real: Real) -> tuple[Table, ...]:
    """Return all tables of the step in the order in which they are printed.

    UsageError DH0813 where a number is not finite or does not fit `real`.

    >>> from deshybrid.compiler import compile
    >>> from deshybrid.model.load import loads
    >>> turns = "[{from: off, to: on, event: press}, {from: on, to: off, event: release}]"
    >>> lamp = compile(loads(f"{{format: deshybrid/1, name: lamp, locations: [off, on], transitions: {turns}}}"))
    >>> c_tables(lamp.observer.tables, "double")[0]
    Table(name='x_start', type='double', meaning='continuous estimate before the first sample', length=0, lines=('0',))
    """
    plain: dict[str, Any] = plain_tables(tables)
    numbers = (*_flow_numbers(plain), *_generator_numbers(plain), *_decision_numbers(plain))
    index = index_type(tables)
    common = (
        *(_table(name, real, meaning, _written(rows, real)) for name, meaning, rows in numbers),
        *(_table(name, "int32_t", meaning, _integers(rows)) for name, meaning, rows in _ticks(plain)),
        *(_table(name, "uint8_t", meaning, _integers(rows)) for name, meaning, rows in _flags(tables)),
        *(_table(name, index, meaning, _integers(rows)) for name, meaning, rows in _resets(tables)),
    )
    if tables.online is not None:
        rows = online_rows(tables.online, tables.initial, tables.restart)
        return *common, *(_table(name, type_, meaning, entries) for name, type_, meaning, entries in rows)
    return (
        *common,
        *(_table(name, "uint8_t", meaning, _integers(rows)) for name, meaning, rows in _marks(tables)),
        *(_table(name, index, meaning, _integers(rows)) for name, meaning, rows in _tracker(tables)),
        *(_table(name, index, meaning, _integers(rows)) for name, meaning, rows in _candidates(tables)),
    )


def cost(tables: StepTables, printed: Iterable[Table], real: Real) -> Cost:
    """Return bytes and operations of one observer; `printed` are its `c_tables`.

    The worst step restarts every generator and the estimate after a runaway and applies two resets.

    >>> from deshybrid.compiler import compile
    >>> from deshybrid.model.load import loads
    >>> turns = "[{from: off, to: on, event: press}, {from: on, to: off, event: release}]"
    >>> lamp = compile(loads(f"{{format: deshybrid/1, name: lamp, locations: [off, on], transitions: {turns}}}"))
    >>> cost(lamp.observer.tables, c_tables(lamp.observer.tables, "float"), "float").multiplications
    0
    """
    n, m, p = len(tables.state_names), len(tables.input_names), len(tables.output_names)
    online = tables.online
    members = 1 if online is None else layout(online).members
    generators, k = len(tables.generators.locations), tables.generators.order
    resets = 2 if len(tables.reset_matrix) else 0
    squares, sums = _decision_cost(tables, p)
    of_generators = generators * ((k + p) * (k + m + p) + k * p)
    products = n * (n + m + p) + of_generators + resets * n * n
    return Cost(
        state_bytes=_state_bytes(tables, _SIZES[real], members),
        table_bytes=sum(table.bytes for table in printed),
        multiplications=products + generators * squares,
        additions=products + generators * sums,
        memberships=0 if online is None else memberships(online),
    )


def _decision_cost(tables: StepTables, p: int) -> tuple[int, int]:
    """Multiplications and additions that the decision takes per generator, the residual's subtractions included."""
    samples, bank = len(tables.decision.limits), tables.decision.bank
    if bank is not None:  # divisions count as multiplications
        filters, k = len(bank.owner), tables.generators.order
        return p * p + p + bank.power + 3 + filters * (2 + k), p * p + p + 2 + filters * (2 + k)
    return {"sprt": (p * p + p + 1, p * p + 2 * p + 1), "glr": (p * p + samples * p, p * p + (2 * samples) * p)}.get(
        tables.decision.kind, (p, p)
    )


def _state_bytes(tables: StepTables, real: int, tracker: int) -> int:
    """The size of the state structure of `templates/c/header.h.j2`: (size, number) of its members in their order."""
    n, channels = len(tables.state_names), len(tables.input_names) + len(tables.output_names)
    generators, k = len(tables.generators.locations), tables.generators.order
    one = max(generators, 1)
    away = 0 if tables.decision.kind == "relay" else one
    members = [
        (real, max(n, 1) + max(generators * k, 1) + max(channels, 1) + generators * evidence_size(tables)),
        (8, 1),
        (4, tracker + 3 + one + away),
        (1, 5 * one + 1),
    ]
    end = 0
    for size, number in members:
        end = -(-end // size) * size + size * number
    return -(-end // 8) * 8


_Rows = Iterator[tuple[str, str, Sequence[Sequence[Any]]]]


def _flow_numbers(plain: dict[str, Any]) -> _Rows:
    yield "x_start", "continuous estimate before the first sample", [plain["start"]]
    yield "flow_rows", "by location, by state: coefficients of state, input, output", _joined(plain["flow_rows"])
    yield "flow_offset", "by location, by state", plain["flow_offset"]
    yield "reset_rows", "by reset, by state: coefficients of the state", _joined(plain["reset_rows"])
    yield "reset_offset", "by reset, by state", plain["reset_offset"]


def _generator_numbers(plain: dict[str, Any]) -> _Rows:
    generators = plain["generators"]

    def each(name: str) -> list[Any]:
        return [generator[name] for generator in generators]

    yield "generator_rows", "by generator, by state: coefficients of state, input, output", _joined(each("rows"))
    yield "generator_offset", "by generator, by state", each("offset")
    yield "generator_start", "by generator, by state: coefficients of the first output", _joined(each("start"))
    yield "generator_start_offset", "by generator, by state", each("start_offset")
    yield "residual_rows", "by generator, by output: of state, input, output", _joined(each("residual_rows"))
    yield "residual_offset", "by generator, by output", each("residual_offset")
    if plain["decision"] not in _TESTS:
        yield "residual_weight", "by generator, by output: 1/threshold, 0 = no residual", each("weight")
        yield "generator_release", "by generator: level above which its relay switches off", [each("release")]


def _decision_numbers(plain: dict[str, Any]) -> _Rows:
    """What tests and interacting filters add."""
    kind, generators = plain["decision"], plain["generators"]
    if kind in _TESTS:
        rows = _joined(generator["whitening"] for generator in generators)
        yield "generator_whitening", "by generator, by output: coefficients of the residual", rows
        yield "unbiased", "by output", [generators[0]["unbiased"]]
    if kind == "sprt":
        rows = [generator["test"] for generator in generators]
        yield "generator_test", "by generator: slope, offset, lower and upper level", rows
    if kind == "imm":
        yield "filter_chain", "to filter, from filter: the chance of a step", plain["chain"]
        yield "filter_share", "by filter: height of its density", [plain["share"]]
    if kind == "glr":
        yield "test_limits", "by number of samples less one: limit of the square of their sum", [plain["limits"]]


def _ticks(plain: dict[str, Any]) -> _Rows:
    generators = plain["generators"]
    yield "generator_on_ticks", "by generator: steps until it becomes active", [[g["on_ticks"] for g in generators]]
    yield "generator_off_ticks", "by generator: steps until it becomes inactive", [[g["off_ticks"] for g in generators]]
    if plain["decision"] == "imm":
        yield "filter_owner", "by filter: the generator of its location", [plain["owner"]]
    if plain["decision"] != "relay":
        yield "location_own", "by location: its generator, -1 = none", [plain["own"]]


def _flags(tables: StepTables) -> _Rows:
    yield "flow_defined", "by location: it has a continuous observer", [tables.flow.defined]


def _resets(tables: StepTables) -> _Rows:
    yield "reset_index", "from location, to location: reset, -1 = keep the estimate", tables.reset_index


def _marks(tables: StepTables) -> _Rows:
    yield "tracker_provisional", "by state: a signature is due", [[s.provisional for s in tables.tracker]]


def _tracker(tables: StepTables) -> _Rows:
    states = tables.tracker
    entries = [state.entry_estimate for state in states]
    yield "restart_on_event", "by event: state after an event that nothing explains", [tables.restart_on_event]
    yield "tracker_location", "by state: the location where it is known, else -1", [[s.location for s in states]]
    yield "tracker_on_event", "by state, by event: state, -1 = nothing explains it", [s.on_event for s in states]
    yield "tracker_timeout", "by state: state after silence", [[s.timeout_target for s in states]]
    yield "tracker_entry_end", "entry estimate of state s: tracker_entry from [s] to [s + 1]", [_ends(entries)]
    yield "tracker_entry", "locations", entries
    yield "tracker_candidate_end", "candidates of state s: from [s] to [s + 1]", [_ends(s.candidates for s in states)]


def _candidates(tables: StepTables) -> _Rows:
    candidates = [candidate for state in tables.tracker for candidate in state.candidates]
    quiet = [candidate.quiet for candidate in candidates]
    yield "candidate_signature", "by candidate", [[c.signature for c in candidates]]
    yield "candidate_active", "by candidate: generator that must be active, -1 = none", [[c.active for c in candidates]]
    yield "candidate_target", "by candidate: state it leads to", [[c.target for c in candidates]]
    yield "candidate_quiet_end", "quiet generators of candidate c: from [c] to [c + 1]", [_ends(quiet)]
    yield "candidate_quiet", "generators that must not be active", quiet


def _joined(blocks: Iterable[Iterable[Any]]) -> list[Any]:
    return [row for block in blocks for row in block]


def _ends(groups: Iterable[Sequence[object]]) -> list[int]:
    return list(accumulate((len(group) for group in groups), initial=0))


def _written(rows: Iterable[Iterable[float]], real: Real) -> list[list[str]]:
    return [[c_real(value, real) for value in row] for row in rows]


def _integers(rows: Iterable[Iterable[int]]) -> list[list[str]]:
    return [[str(int(value)) for value in row] for row in rows]


def _table(name: str, c_type: str, meaning: str, rows: list[list[str]]) -> Table:
    """Lay out one row of the table per line, longer ones on several."""
    filled = [", ".join(row) for row in rows if row] or ["0"]
    lines = [part for line in ",\n".join(filled).split("\n") for part in textwrap.wrap(line, _LINE)]
    return Table(name, c_type, meaning, sum(map(len, rows)), tuple(lines))
