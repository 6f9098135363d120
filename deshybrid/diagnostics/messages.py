"""Coded messages: a diagnostic is a value that is rendered late, for a terminal or a page.

Message: lower case, no full stop, identifiers in backticks.  `note` = facts, `help` = what to change.
"""

from dataclasses import dataclass
from typing import Literal

from deshybrid.diagnostics.spans import Span


@dataclass(frozen=True, slots=True)
class Label:
    """A text beside an underlined span; `primary` is drawn with carets, the others with dashes."""

    span: Span
    text: str = ""
    primary: bool = True


@dataclass(frozen=True, slots=True)
class Diagnostic:
    """One mistake, one message: a code of the catalogue, the fact, where it is, and what helps.

    >>> Diagnostic("DH0101", "the file is not YAML").code
    'DH0101'
    """

    code: str
    message: str
    labels: tuple[Label, ...] = ()
    notes: tuple[str, ...] = ()
    helps: tuple[str, ...] = ()
    severity: Literal["error", "warning"] = "error"

    @property
    def span(self) -> Span | None:
        """The primary span, which the position in the message's second line is taken from."""
        return next((label.span for label in self.labels if label.primary), None)


def diagnostic(
    code: str,
    message: str,
    span: Span | None = None,
    label: str = "",
    *,
    context: tuple[tuple[Span | None, str], ...] = (),
    notes: tuple[str, ...] = (),
    helps: tuple[str, ...] = (),
    severity: Literal["error", "warning"] = "error",
) -> Diagnostic:
    """Return a diagnostic with one primary label at `span` and secondary labels at the `context` spans.

    Spans may be None, where a value was built in Python and has no file behind it; such labels become notes.

    >>> diagnostic("DH0203", "`C` has 3 columns", context=((None, "`A` is (2, 2)"),)).notes
    ('`A` is (2, 2)',)
    """
    primary = () if span is None else (Label(span, label),)
    secondary = tuple(Label(place, text, primary=False) for place, text in context if place is not None)
    homeless = tuple(text for place, text in context if place is None)
    if span is None and label:
        homeless = (label, *homeless)
    return Diagnostic(code, message, primary + secondary, homeless + notes, helps, severity)
