"""What a reader has found so far, with places, until it becomes a `Document`.

In: words with their places, in the order of the file.  Out: a document, or one `FormatError` with every mistake: names
that nobody declared (DH1005), names declared twice (DH1007), contradictions (DH1008), unusable names (DH1015), no
initial location (DH1006).  Cost: linear.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import PurePath
from types import MappingProxyType
from typing import NamedTuple

from deshybrid.des.automaton import DES, Transition
from deshybrid.diagnostics import Diagnostic, FormatError, SourceText, Span, diagnostic
from deshybrid.formats.document import Document, Event, reason_against
from deshybrid.model.problems import MOST_MESSAGES, Problems, did_you_mean

MOST_WORDS = 2_000_000


class Word(NamedTuple):
    """A text with its place in the file."""

    text: str
    span: Span


class _Row(NamedTuple):
    source: Word
    event: str
    target: Word
    output: str | None
    span: Span


def words_by_line(source: SourceText, comment: str = "") -> Iterator[list[Word]]:
    """Yield the words of each line, which whitespace separates; a line without words is an empty list.

    Raises `FormatError` (DH1011) beyond two million words.

    >>> [[word.text for word in line] for line in words_by_line(SourceText("a.fsm", "2\\n\\nA 1  0"))]
    [['2'], [], ['A', '1', '0']]
    """
    if len(source.text.split()) > MOST_WORDS:
        raise mistake("DH1011", f"the file has more than {MOST_WORDS} words", Span(source, 1, 1))
    for number, line in enumerate(source.text.split("\n"), start=1):
        text, words, column = line.split(comment, 1)[0] if comment else line, [], 0
        for part in text.split():
            column = text.index(part, column)
            words.append(Word(part, Span(source, number, column + 1, len(part))))
            column += len(part)
        yield words


def mistake(code: str, message: str, span: Span, label: str = "", *helps: str) -> FormatError:
    """Return the error of a place from which reading cannot go on.

    >>> str(mistake("DH1002", "a name is expected", Span(SourceText("a", "?"), 1, 1)))
    'DH1002: a name is expected'
    """
    return FormatError(diagnostic(code, message, span, label, helps=helps))


def whole_number(word: Word, what: str) -> int:
    """Return a count; DH1002 where the word is none.

    >>> whole_number(Word("12", Span(SourceText("a", "12"), 1, 1)), "the number of states")
    12
    """
    if not (word.text.isascii() and word.text.isdigit() and len(word.text) <= 9):
        raise mistake("DH1002", f"{what} is a whole number", word.span, f"`{word.text[:40]}` is here")
    return int(word.text)


@dataclass(slots=True)
class Builder:
    """The system of a file while it is read; it changes, and never leaves its reader."""

    source: SourceText
    problems: Problems = field(default_factory=Problems)
    locations: dict[str, Span] = field(default_factory=dict)
    initial: dict[str, Word] = field(default_factory=dict)
    marked: dict[str, Word] = field(default_factory=dict)
    events: dict[str, tuple[Event, Span]] = field(default_factory=dict)
    warnings: list[Diagnostic] = field(default_factory=list)
    rows: list[_Row] = field(default_factory=list)
    _usable: set[str] = field(default_factory=set)

    def report(self, code: str, message: str, span: Span, label: str = "", *helps: str) -> None:
        """Keep a mistake that does not end the reading."""
        self.problems.add(diagnostic(code, message, span, label, helps=helps))

    def unknown(self, what: str, word: Word, known: Iterable[str]) -> None:
        """Report DH1005 with the nearest known name; beyond what is listed, nearness is not computed."""
        helps = did_you_mean(word.text, known) if len(self.problems.found) < MOST_MESSAGES else ()
        self.report("DH1005", f"unknown {what} `{word.text[:100]}`", word.span, "", *helps)

    def usable(self, word: Word, what: str) -> None:
        """Report DH1015 where a word cannot be a name."""
        if word.text in self._usable:
            return
        reason = reason_against(word.text)
        if reason:
            self.report("DH1015", f"`{word.text[:100]}` cannot name {what}", word.span, reason)
        self._usable.add(word.text)

    def declare(self, word: Word) -> None:
        """Add a location; DH1007 where it is there already."""
        if word.text in self.locations:
            before = ((self.locations[word.text], "here first"),)
            message = f"location `{word.text}` is declared twice"
            self.problems.add(diagnostic("DH1007", message, word.span, context=before))
            return
        self.mention(word)

    def mention(self, word: Word) -> None:
        """Add a location of a format in which the transitions declare them."""
        if word.text not in self.locations:
            self.usable(word, "a location")
            self.locations[word.text] = word.span

    def declare_event(self, word: Word, controllable: bool, observable: bool) -> None:
        """Add an event, or check that it is still what it was; DH1008 where it is not."""
        event = Event(word.text, controllable, observable)
        known, place = self.events.setdefault(word.text, (event, word.span))
        if known != event:
            part = "controllable" if known.controllable != controllable else "observable"
            fact = f"{'' if getattr(known, part) else 'not '}{part} here"
            message = f"event `{word.text}` is once {part} and once not"
            self.problems.add(diagnostic("DH1008", message, word.span, context=((place, fact),)))

    def arc(self, source: Word, event: Word, target: Word, output: str | None) -> None:
        """Add a transition that shows `output`, None for nothing."""
        self.usable(event, "an event")
        if output is not None and output != event.text:
            self.usable(Word(output, event.span), "an output")
        self.rows.append(_Row(source, event.text, target, output, event.span))

    def document(self, name: str = "") -> Document:
        """Return what was read, or raise all mistakes; rows with equal source, event and target join their outputs."""
        ends = (word for row in self.rows for word in (row.source, row.target))
        self._check_known([*self.initial.values(), *self.marked.values(), *ends])
        place = Span(self.source, 1, 1, max(1, len(self.source.line(1))))
        if name and reason_against(name):
            self.report("DH1015", "the name of the system cannot be used", place, reason_against(name))
        if not self.initial and not self.problems.found:
            self.report("DH1006", "no initial location is given", place)
        self.problems.raise_all(FormatError)
        outputs: dict[tuple[str, str, str], dict[str | None, Span]] = {}
        for row in self.rows:
            outputs.setdefault((row.source.text, row.event, row.target.text), {}).setdefault(row.output, row.span)
        arcs = tuple(
            Transition(*ends, tuple(seen), span=next(iter(seen.values())), output_span=next(iter(seen.values())))
            for ends, seen in outputs.items()
        )
        spans = MappingProxyType(dict(self.locations))
        des = DES(tuple(self.locations), arcs, tuple(self.initial), name or stem(self.source), spans)
        events = tuple(event for event, _ in self.events.values())
        return Document(des, tuple(self.marked), events, tuple(self.warnings))

    def _check_known(self, words: Iterable[Word]) -> None:
        for word in words:
            if word.text not in self.locations:
                self.unknown("location", word, self.locations)


def stem(source: SourceText) -> str:
    """Return the name of a system whose file has none: the file's name without its suffix.

    >>> stem(SourceText("plants/press.fsm", ""))
    'press'
    """
    name = "" if source.name.startswith("<") else PurePath(source.name).stem
    return "des" if reason_against(name) else name


__all__ = ["MOST_WORDS", "Builder", "Word", "mistake", "stem", "whole_number", "words_by_line"]
