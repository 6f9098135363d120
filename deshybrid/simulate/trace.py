"""Traces: what a hybrid system showed, sample by sample, and, where it is known, what was true.

In: a CSV text with the header `time`, the model's inputs, outputs and commands, optionally `event`, `true_location` and
`true_<state>`.  Out: a `Trace`, or every mistake of the file with line and column.  A purely discrete model has `time`,
commands and `event` only, at any increasing times.

A missing row is an error, unless a reader asks for what the filters take; a jittering logger is none
(`deshybrid.simulate.spacing`).

One pass.  Source: the trace format of the commands `run` and `simulate`.
"""

import difflib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.diagnostics import Diagnostic, TraceError, diagnostic, raise_all
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem
from deshybrid.simulate.spacing import misplaced
from deshybrid.simulate.table import Row, Table, decode, number, number_mistake, parse_table, read_bytes

_MOST_MESSAGES = 20


@dataclass(frozen=True, slots=True, eq=False)
class Trace:
    """Samples of one run; arrays are copied and read-only.

    time (N,) in s; inputs (N, m) and outputs (N, p) in the order of the model's channels, NaN where an output was not
    measured; `events`: the discrete output seen since the previous row or None; `true_location` and `true_state` (N, n)
    are the truth where it is known, None or NaN where not; `commands`: in each row the value of each command, None
    where it is unknown.  ValueError where the lengths do not fit together.

    >>> from deshybrid.model.system import HybridSystem, Location
    >>> Trace(HybridSystem("toy", (Location("a"),), (), ("a",)), [0.0, 1.0], np.zeros((2, 0)), np.zeros((2, 0)))
    Trace(toy: 2 rows, 0 s to 1 s, 0 events)
    """

    system: HybridSystem
    time: FloatArray
    inputs: FloatArray
    outputs: FloatArray
    events: tuple[str | None, ...] = ()
    true_location: tuple[str | None, ...] | None = None
    true_state: FloatArray | None = None
    commands: tuple[tuple[str | None, ...], ...] = ()

    def __post_init__(self) -> None:
        rows = len(self.time)
        widths = {"time": (rows,), "inputs": (rows, len(self.system.input_names))}
        widths |= {"outputs": (rows, len(self.system.output_names))}
        if self.true_state is not None:
            widths |= {"true_state": (rows, len(self.system.state_names))}
        for name, shape in widths.items():
            object.__setattr__(self, name, _frozen(getattr(self, name), shape, name))
        object.__setattr__(self, "events", tuple(self.events) or (None,) * rows)
        unknown = (None,) * len(self.system.commands)
        object.__setattr__(self, "commands", tuple(self.commands) or (unknown,) * rows)
        if any(len(values) != len(unknown) for values in self.commands):
            raise ValueError(f"`commands` needs {len(unknown)} values in each row")
        named = (self.commands, self.events, self.events if self.true_location is None else self.true_location)
        if any(len(column) != rows for column in named):
            text = "`commands`, `events` and `true_location` need one entry for each of"
            raise ValueError(f"{text} the {rows} rows")

    def __len__(self) -> int:
        return len(self.time)

    def to_table(self) -> dict[str, FloatArray | tuple[str | None, ...]]:
        """Return the columns of the trace's file by their names, which pandas takes as they are.

        >>> from deshybrid.model.system import HybridSystem, Location
        >>> toy = HybridSystem("toy", (Location("a"),), (), ("a",))
        >>> list(Trace(toy, [0.0], np.zeros((1, 0)), np.zeros((1, 0))).to_table())
        ['time', 'event']
        """
        system, truth = self.system, self.true_state
        table: dict[str, FloatArray | tuple[str | None, ...]] = {"time": self.time}
        table |= zip(system.input_names, self.inputs.T, strict=True)
        table |= zip(system.output_names, self.outputs.T, strict=True)
        for place, name in enumerate(system.command_names):
            table[name] = tuple(row[place] for row in self.commands)
        table["event"] = self.events
        if self.true_location is not None:
            table["true_location"] = self.true_location
        if truth is not None:
            table |= {f"true_{name}": truth[:, place] for place, name in enumerate(system.state_names)}
        return table

    def __repr__(self) -> str:
        seen = sum(event is not None for event in self.events)
        span = f", {self.time[0]:g} s to {self.time[-1]:g} s" if len(self) else ""
        return f"Trace({self.system.name}: {len(self)} rows{span}, {seen} events)"


def read_trace(path: str | Path, system: HybridSystem, *, step: float | None = None) -> Trace:
    """Return the trace in a CSV file, or on standard input for "-".

    `step` (s) is the observer's; by default the model's `observer.step` or `time.step`.  Raises `TraceError` with the
    codes DH0310 to DH0325, all mistakes together where the file can be read at all.
    """
    name, data = read_bytes(path)
    return parse_trace(decode(name, data), system, step=step, name=name)


def parse_trace(
    text: str, system: HybridSystem, *, step: float | None = None, name: str = "<text>", missing_rows: bool = False
) -> Trace:
    """Return the trace in a CSV text; as `read_trace`.  With `missing_rows` a gap may stand for whole rows.

    An event that the model does not know is no mistake of the file: the observer answers it with `inconsistent`.

    >>> from deshybrid.model.system import HybridSystem, Location
    >>> toy = HybridSystem("toy", (Location("a"),), (), ("a",))
    >>> parse_trace("time,event\\n0,\\n2.5,α\\n", toy).events
    (None, 'α')
    """
    table = parse_table(text, name)
    columns = _columns(table, system)
    if not table.rows:
        raise TraceError(diagnostic("DH0313", "the trace has no rows", table.span(table.header, 0), "only a header"))
    rows = tuple(row for row in table.rows if len(row.fields) == len(table.header.fields))
    raise_all(_limited([*_width_mistakes(table), *_field_mistakes(table, columns, rows, system)]), TraceError)
    trace = _assemble(columns, rows, system)
    spacing = None if system.is_discrete else step or system.observer.step or system.time_step
    raise_all(_time_mistakes(table, columns["time"], trace.time, spacing, missing_rows), TraceError)
    return trace


def write_trace(trace: Trace) -> str:
    """Return a trace as CSV; numbers in the shortest form that reads back to the same bits, NaN as an empty field.

    >>> from deshybrid.model.system import HybridSystem, Location
    >>> toy = HybridSystem("toy", (Location("a"),), (), ("a",))
    >>> print(write_trace(Trace(toy, [0.0], np.zeros((1, 0)), np.zeros((1, 0)), ("α",), ("a",))), end="")
    time,event,true_location
    0.0,α,a
    """
    system, truth = trace.system, trace.true_state
    numbers = np.hstack([trace.time[:, None], trace.inputs, trace.outputs])
    header = ["time", *system.input_names, *system.output_names, *system.command_names, "event"]
    texts: list[tuple[str | None, ...]] = [*zip(*trace.commands, strict=True), trace.events]
    if trace.true_location is not None:
        header.append("true_location")
        texts.append(trace.true_location)
    if truth is not None:
        header += [f"true_{name}" for name in system.state_names]
    after = np.empty((len(trace), 0)) if truth is None else truth
    lines = [",".join(map(quoted, header))]
    for before, words, last in zip(numbers.tolist(), zip(*texts, strict=True), after.tolist(), strict=True):
        fields = [*map(shortest, before), *(quoted(word or "") for word in words), *map(shortest, last)]
        lines.append(",".join(fields))
    return "\n".join(lines) + "\n"


def shortest(value: float) -> str:
    """Return the shortest decimal that reads back to `value`; empty for NaN.

    >>> shortest(0.1), shortest(float("nan"))
    ('0.1', '')
    """
    return "" if math.isnan(value) else repr(value)


def quoted(text: str) -> str:
    """Return a field as CSV writes it, in quotes where it holds a comma, a quote, or blanks at its ends.

    >>> quoted('a,b')
    '"a,b"'
    """
    plain = "," not in text and '"' not in text and "\n" not in text
    return text if plain else '"' + text.replace('"', '""') + '"'


def _frozen(values: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    array = np.array(values, dtype=np.float64, order="C")
    if array.shape != shape:
        raise ValueError(f"`{name}` has shape {array.shape}, expected {shape}")
    array.flags.writeable = False
    return array


def _columns(table: Table, system: HybridSystem) -> dict[str, int]:
    """Place of each column by name; all mistakes of the header at once."""
    needed = ["time", *system.input_names, *system.output_names, *system.command_names]
    allowed = [*needed, "event", "true_location", *(f"true_{name}" for name in system.state_names)]
    mistakes: list[Diagnostic] = []
    places: dict[str, int] = {}
    for place, name in enumerate(table.header.fields):
        span = table.span(table.header, place)
        if name in places:
            first = table.span(table.header, places[name])
            text = f"the column `{name}` appears twice"
            mistakes.append(diagnostic("DH0315", text, span, "again here", context=((first, "first here"),)))
        elif name not in allowed:
            helps = (*_suggestion(name, allowed), f"the columns of this model are {_listing(allowed)}")
            mistakes.append(diagnostic("DH0314", f"unknown column `{name}`", span, "not a column", helps=helps))
        places.setdefault(name, place)
    missing = [name for name in needed if name not in places]
    if missing:
        end = table.span(table.header, len(table.header.fields))
        text = f"missing column{'s' * (len(missing) > 1)} {_listing(missing)}"
        mistakes.append(diagnostic("DH0316", text, end, "the header ends here"))
    raise_all(_limited(mistakes), TraceError)
    return places


def _suggestion(word: str, known: Sequence[str]) -> tuple[str, ...]:
    close = difflib.get_close_matches(word[:100], known, n=1)
    return (f"did you mean `{close[0]}`?",) if close else ()


def _listing(names: Sequence[str]) -> str:
    shown = ", ".join(f"`{name}`" for name in names[:30])
    return shown + (f" and {len(names) - 30} more" if len(names) > 30 else "")


def _limited(mistakes: Sequence[Diagnostic]) -> list[Diagnostic]:
    """In order of place.  A file of the wrong kind has a mistake in every field; the first ones say enough."""
    places = [(m.span.line, m.span.column) if m.span else (0, 0) for m in mistakes]
    shown = [mistakes[i] for i in sorted(range(len(mistakes)), key=places.__getitem__)][:_MOST_MESSAGES]
    if len(mistakes) > _MOST_MESSAGES:
        shown[-1] = replace(shown[-1], notes=(*shown[-1].notes, "further mistakes are not shown"))
    return shown


def _width_mistakes(table: Table) -> list[Diagnostic]:
    expected = len(table.header.fields)
    mistakes = []
    for row in table.rows:
        count = len(row.fields)
        if count != expected:
            span = table.span(row, min(count, expected))
            text = f"the row has {count} fields, expected {expected}"
            mistakes.append(diagnostic("DH0317", text, span, "the header has one name per field"))
        if len(mistakes) > _MOST_MESSAGES:
            break
    return mistakes


def _field_mistakes(
    table: Table, columns: Mapping[str, int], rows: Sequence[Row], system: HybridSystem
) -> list[Diagnostic]:
    """Fields that hold no number where one is needed, and words that the model does not have."""
    may_be_empty = {*system.output_names, *(f"true_{name}" for name in system.state_names)}
    words = {"true_location": ("true location", [location.name for location in system.locations])}
    words |= {command.name: (f"value of command `{command.name}`", [*command.values]) for command in system.commands}
    mistakes: list[Diagnostic] = []
    for name, place in columns.items():
        found: Iterator[Diagnostic]
        if name in words:
            what, known = words[name]
            wrong = (row for row in rows if row.fields[place] not in {"", *known})
            found = (_unknown_word(table, row, place, what, known) for row in wrong)
        elif name == "event":
            continue
        else:
            optional = name in may_be_empty
            found = (
                mistake
                for row in rows
                if not (optional and not row.fields[place])
                if (mistake := _number_mistake(table, row, place, name)) is not None
            )
        mistakes += [mistake for mistake, _ in zip(found, range(_MOST_MESSAGES + 1), strict=False)]
    return mistakes


def _number_mistake(table: Table, row: Row, place: int, name: str) -> Diagnostic | None:
    """The place of a field is looked for only where the field is wrong: most are right."""
    value = number(row.fields[place])
    if value is not None and math.isfinite(value):
        return None
    return number_mistake(row.fields[place], f"the field of `{name}`", table.span(row, place))


def _unknown_word(table: Table, row: Row, place: int, what: str, known: Sequence[str]) -> Diagnostic:
    word, code = row.fields[place], "DH0323" if what == "true location" else "DH0325"
    listing = (
        f"the locations of this model are {_listing(known)}" if code == "DH0323" else f"it may be {_listing(known)}"
    )
    message = f"unknown {what} `{word[:80]}`" if code == "DH0323" else f"unknown {what}: `{word[:80]}`"
    return diagnostic(code, message, table.span(row, place), helps=(*_suggestion(word, known), listing))


def _assemble(columns: Mapping[str, int], rows: Sequence[Row], system: HybridSystem) -> Trace:
    def numbers(names: Sequence[str]) -> FloatArray:
        places = [columns.get(name) for name in names]
        values = [[_value(row, place) for place in places] for row in rows]
        return np.array(values, dtype=np.float64).reshape(len(rows), len(names))

    def words(name: str) -> tuple[str | None, ...] | None:
        place = columns.get(name)
        return None if place is None else tuple(row.fields[place] or None for row in rows)

    truth = [f"true_{name}" for name in system.state_names]
    commands = [words(name) or () for name in system.command_names]
    return Trace(
        system,
        numbers(["time"])[:, 0],
        numbers(system.input_names),
        numbers(system.output_names),
        words("event") or (),
        words("true_location"),
        numbers(truth) if any(name in columns for name in truth) else None,
        tuple(zip(*commands, strict=True)),
    )


def _value(row: Row, place: int | None) -> float:
    text = "" if place is None else row.fields[place]
    return float(text) if text else math.nan


def _time_mistakes(
    table: Table, column: int, time: FloatArray, step: float | None, missing_rows: bool
) -> list[Diagnostic]:
    """The first row out of place."""
    backward = np.flatnonzero(np.diff(time) <= 0.0)
    if backward.size:
        index = int(backward[0]) + 1
        text = f"time does not increase: {time[index]:g} s follows {time[index - 1]:g} s"
        place = table.span(table.rows[index], column)
        return [diagnostic("DH0321", text, place, "each row must be later than the one before")]
    wrong = None if step is None else misplaced(time, step, missing_rows=missing_rows)
    if wrong is None:
        return []
    helps = ("resample the trace, or state its step: in the model, or to `run` by `--step`",)
    place = table.span(table.rows[wrong.row], column)
    return [diagnostic("DH0322", wrong.text, place, "out of place by more than jitter", helps=helps)]
