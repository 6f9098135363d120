"""Tables of numbers from strangers: a CSV text in, its fields with their places out, or every mistake with its place.

The standard library's `csv` module reads the lines; this module keeps where each field stands, so that a message can
point at it, and bounds everything a hostile file could grow: bytes, lines, line length, fields.  Nothing is guessed: a
byte-order mark, Windows line ends and blank lines are accepted, a field across two lines or a NUL byte is not.

One pass over the text.  Source: RFC 4180 (comma, double quotes, one record per line, a header).
"""

import csv
import math
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from deshybrid.diagnostics import Diagnostic, SourceText, Span, TraceError, diagnostic

MAX_BYTES = 256_000_000
MAX_ROWS = 5_000_000
MAX_LINE = 65_536
MAX_FIELDS = 4_096


@dataclass(frozen=True, slots=True, eq=False)
class Row:
    """The fields of one line, without surrounding blanks, and the line's number."""

    line: int
    fields: tuple[str, ...]


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """Header and rows of one CSV text; rows may still have the wrong number of fields."""

    source: SourceText
    header: Row
    rows: tuple[Row, ...]

    def span(self, row: Row, column: int) -> Span:
        """Return the place of field number `column` (from 0) of a row; the line's end where it has fewer fields.

        >>> table = parse_table("time,u\\n0, 1.5\\n")
        >>> str(table.span(table.rows[0], 1))
        '<text>:2:4'
        """
        return field_span(self.source, row.line, column)


def read_bytes(path: str | Path) -> tuple[str, bytes]:
    """Return the name to report and the bytes of a file, or of standard input for "-".

    Raises `TraceError`: DH0310 where it cannot be read, DH0311 beyond MAX_BYTES.
    """
    name = "<stdin>" if str(path) == "-" else str(path)
    try:
        if str(path) == "-":
            data = sys.stdin.buffer.read(MAX_BYTES + 1)
        else:
            with Path(path).open("rb") as file:
                data = file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise TraceError(diagnostic("DH0310", f"cannot read the trace `{name}`: {reason.lower()}")) from None
    if len(data) > MAX_BYTES:
        text = f"the trace `{name}` is larger than {MAX_BYTES} bytes"
        raise TraceError(diagnostic("DH0311", text, helps=("cut it into several traces",)))
    return name, data


def decode(name: str, data: bytes) -> str:
    """Return the text of UTF-8 bytes; `TraceError` DH0310 with line and column of the first byte that is none."""
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        before = data[: error.start].decode("utf-8")
        line = before.count("\n") + 1
        column = len(before) - (before.rfind("\n") + 1) + 1
        source = SourceText(name, data.decode("utf-8", errors="replace"))
        raise TraceError(
            diagnostic("DH0310", "the trace is not UTF-8 text", Span(source, line, column), "this byte is not UTF-8")
        ) from None


def parse_table(text: str, name: str = "<text>") -> Table:
    """Return the fields of a CSV text.

    Raises `TraceError`: DH0311 (a limit), DH0312 (a NUL or another control character), DH0313 (no header), DH0324
    (quotes that do not close on their line).

    >>> [row.fields for row in parse_table("time,u\\r\\n0,1\\r\\n").rows]
    [('0', '1')]
    """
    source = SourceText(name, text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n"))
    lines = source.text.split("\n")
    _check_lines(source, lines)
    rows = tuple(_records(source, lines))
    if not rows:
        raise TraceError(diagnostic("DH0313", "the trace is empty", Span(source, 1, 1), "a header is expected here"))
    return Table(source, rows[0], rows[1:])


def number(text: str) -> float | None:
    """Return the decimal number a field holds, or None; infinities and NaN are returned as such.

    >>> number("1e-3"), number("1_000"), number("٣"), number("nan")
    (0.001, None, None, nan)
    """
    if not text.isascii() or "_" in text:
        return None
    try:
        return float(text)
    except ValueError:
        return None


def number_mistake(text: str, what: str, span: Span) -> Diagnostic | None:
    """Return what is wrong with a field that should hold a finite number, or None.

    >>> number_mistake("0.5", "`u`", Span(SourceText("t.csv", "0.5"), 1, 1)) is None
    True
    """
    value = number(text)
    if value is None:
        message = f"{what} is not a number" if text else f"{what} is empty"
        return diagnostic("DH0318", message, span, "a decimal number is expected")
    if not math.isfinite(value):
        return diagnostic("DH0319", f"{what} is not finite", span, "a finite number is expected")
    return None


def field_span(source: SourceText, line: int, column: int) -> Span:
    """Return the place of field number `column` of a line; commas inside quotes do not separate."""
    text = source.line(line)
    start, quoted, seen = 0, False, 0
    for place, char in enumerate(text):
        if char == '"':
            quoted = not quoted
        elif char == "," and not quoted:
            if seen == column:
                return _trimmed(source, line, start, place)
            seen, start = seen + 1, place + 1
    if seen == column:
        return _trimmed(source, line, start, len(text))
    return Span(source, line, len(text) + 1)


def _trimmed(source: SourceText, line: int, start: int, end: int) -> Span:
    """The field without surrounding blanks; an empty field keeps one column to point at."""
    field = source.line(line)[start:end]
    lead = len(field) - len(field.lstrip())
    return Span(source, line, start + lead + 1, max(1, len(field.strip())))


def _check_lines(source: SourceText, lines: list[str]) -> None:
    if len(lines) > MAX_ROWS:
        place = Span(source, MAX_ROWS, 1)
        raise TraceError(diagnostic("DH0311", f"the trace has more than {MAX_ROWS} lines", place))
    for index, line in enumerate(lines):
        if len(line) > MAX_LINE or line.count(",") >= MAX_FIELDS:
            text = f"the line has more than {MAX_LINE} characters or {MAX_FIELDS} fields"
            raise TraceError(diagnostic("DH0311", text, Span(source, index + 1, 1)))
        if not line.isprintable() and (bad := _control(line)) is not None:
            place = Span(source, index + 1, bad + 1)
            text = f"the trace holds the control character U+{ord(line[bad]):04X}"
            raise TraceError(diagnostic("DH0312", text, place, "this is no text"))


def _control(line: str) -> int | None:
    return next((i for i, char in enumerate(line) if char != "\t" and (char < " " or char == "\x7f")), None)


def _records(source: SourceText, lines: list[str]) -> Iterator[Row]:
    """Records without the blank lines; a record that runs over its line's end has an unclosed quote."""
    reader = csv.reader((line + "\n" for line in lines), strict=True)
    begin = 0
    try:
        for fields in reader:
            begin += 1
            if reader.line_num != begin:
                raise TraceError(_unclosed(source, begin))
            if fields and (len(fields) > 1 or fields[0].strip()):
                yield Row(begin, tuple(field.strip() for field in fields))
    except csv.Error:
        raise TraceError(_unclosed(source, begin + 1)) from None


def _unclosed(source: SourceText, line: int) -> Diagnostic:
    place = Span(source, line, source.line(line).find('"') + 1 or 1)
    return diagnostic("DH0324", "a quoted field does not end properly on its line", place, "the quote opens here")
