"""Diagnostics as text: the code, the place, the line with carets, facts and help."""

from collections.abc import Iterable

from deshybrid.diagnostics.messages import Diagnostic, Label
from deshybrid.diagnostics.spans import Span

_LONGEST_LINE = 160
_LEAD = 60


def render(diagnostic: Diagnostic) -> str:
    """Return the message as plain text in several lines, without a last newline.

    >>> from deshybrid.diagnostics.spans import SourceText
    >>> from deshybrid.diagnostics.messages import diagnostic
    >>> place = Span(SourceText("m.yaml", "name: a\\nstat: [x]"), 2, 1, 4)
    >>> print(render(diagnostic("DH0111", "unknown key `stat`", place, "not a key", helps=("write `state`",))))
    error[DH0111]: unknown key `stat`
     --> m.yaml:2:1
      |
    2 | stat: [x]
      | ^^^^ not a key
      |
      = help: write `state`
    """
    lines = [f"{diagnostic.severity}[{diagnostic.code}]: {_printable(diagnostic.message)}"]
    width = max((len(str(label.span.line)) for label in diagnostic.labels), default=1)
    margin = " " * width + " |"
    if diagnostic.span is not None:
        place = diagnostic.span
        lines.append(f"{' ' * width}--> {_printable(place.source.name)}:{place.line}:{place.column}")
        lines.append(margin)
        lines += _excerpt(diagnostic.labels, width, margin)
        lines.append(margin)
    remarks = [("note", text) for text in diagnostic.notes] + [("help", text) for text in diagnostic.helps]
    lines += [f"{' ' * width} = {kind}: {_printable(text)}" for kind, text in remarks]
    return "\n".join(lines)


def render_all(diagnostics: Iterable[Diagnostic]) -> str:
    """Return all messages, separated by empty lines."""
    return "\n\n".join(render(diagnostic) for diagnostic in diagnostics)


def _excerpt(labels: tuple[Label, ...], width: int, margin: str) -> list[str]:
    """Every source line that carries a label, once, with its underlines below; labels of other files name them."""
    primary = next(label.span for label in labels if label.primary)
    here = [label for label in labels if label.span.source is primary.source]
    lines = []
    for number in sorted({label.span.line for label in here}):
        marked = [label for label in here if label.span.line == number]
        marked.sort(key=lambda label: (label.primary, label.span.column))
        text, shift = _window(primary.source.line(number), min(lab.span.column for lab in marked))
        lines.append(f"{number:>{width}} | {text}".rstrip())
        lines += [f"{margin} {_underline(label, shift, len(text))}".rstrip() for label in marked]
    elsewhere = [label for label in labels if label.span.source is not primary.source]
    return lines + [f"{margin} {label.span}: {_printable(label.text)}" for label in elsewhere]


def _window(line: str, column: int) -> tuple[str, int]:
    """A long line is shown around its first label, so that a hostile file cannot flood the terminal."""
    if len(line) <= _LONGEST_LINE:
        return _printable(line), 0
    shift = max(0, column - 1 - _LEAD)
    return _printable(line[shift : shift + _LONGEST_LINE]), shift


def _underline(label: Label, shift: int, room: int) -> str:
    start = max(0, label.span.column - 1 - shift)
    length = max(1, min(label.span.length, room - start))
    return " " * start + ("^" if label.primary else "-") * length + f" {_printable(label.text)}"


def _printable(text: str) -> str:
    """Control characters of a stranger's file never reach the terminal; a tab becomes one space, so that carets fit."""
    return "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in text.replace("\t", " "))


__all__ = ["Span", "render", "render_all"]
