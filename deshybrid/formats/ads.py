"""TCT `.ADS`, read only: an automaton in numbers.

A name, then `State size`, `Marker states`, `Vocal states` and `Transitions`, each followed by its rows; `#` begins a
comment.  States are 0 to size - 1, and 0 is the initial state.  A transition is `SOURCE EVENT TARGET`; odd events are
controllable, all are observable.  `*` marks all states.  Vocal states (outputs of states) have no place in a DES and
are refused.  Cost: linear.  Source: W. M. Wonham, TCT user's guide, University of Toronto.
"""

import re

from deshybrid.diagnostics import SourceText, Span
from deshybrid.formats.builder import Builder, Word, mistake, whole_number, words_by_line
from deshybrid.formats.document import Document

_HEADS = ("state size", "marker states", "vocal states", "transitions")
_MOST_STATES = 500_000


def read_ads(source: SourceText) -> Document:
    r"""Return the document of an `.ADS` text.

    Raises `FormatError`: DH1002 (not this form), DH1004 (more than one size), DH1005 (a state beyond the size), DH1009
    (vocal states), DH1011 (too large).

    >>> text = "M1\n\nState size:\n2\n\nMarker states:\n0\n\nVocal states:\n\nTransitions:\n0 1 1\n1 0 0\n"
    >>> str(read_ads(SourceText("M1.ADS", text)).des.transitions[0])
    '0 -1/1-> 1'
    """
    name, rows = _parts(source)
    builder = Builder(source)
    sizes = [word for row in rows["state size"] for word in row]
    if len(sizes) != 1:
        place = sizes[1].span if sizes else Span(source, 1, 1)
        raise mistake("DH1004", "one number of states is expected", place, f"{len(sizes)} are given")
    size = whole_number(sizes[0], "the number of states")
    if size > _MOST_STATES:
        raise mistake("DH1011", f"more than {_MOST_STATES} states", sizes[0].span)
    for index in range(size):
        builder.declare(Word(str(index), sizes[0].span))
    if size:
        builder.initial["0"] = Word("0", sizes[0].span)
    for word in (word for row in rows["marker states"] for word in row):
        chosen = builder.locations if word.text == "*" else (str(whole_number(word, "a state")),)
        builder.marked |= {state: Word(state, word.span) for state in chosen}
    for row in rows["vocal states"]:
        builder.report("DH1009", "a vocal state", row[0].span, "a discrete-event system has no outputs of states")
    for row in rows["transitions"]:
        _read_transition(row, builder)
    return builder.document(name)


def _parts(source: SourceText) -> tuple[str, dict[str, list[list[Word]]]]:
    """Return the automaton's name and the rows below each of the four headings, in their order."""
    name, rows = "", dict[str, list[list[Word]]]()
    for words in words_by_line(source, comment="#"):
        if not words:
            continue
        line = " ".join(word.text for word in words)
        head = re.fullmatch(r"(state size|marker states|vocal states|transitions)\b[^:]*(\(.*\))?\s*:?", line.lower())
        if head is not None:
            if head[1] != _HEADS[min(len(rows), 3)] or len(rows) == 4:
                raise mistake("DH1002", f"`{line[:40]}` is not expected here", words[0].span)
            rows[head[1]] = []
        elif rows:
            rows[next(reversed(rows))].append(words)
        elif name:
            raise mistake("DH1002", "`State size` is expected here", words[0].span)
        else:
            name = line
    if len(rows) < 4:
        last = source.text.count("\n") + 1
        raise mistake("DH1002", f"the heading `{_HEADS[len(rows)].capitalize()}` is missing", Span(source, last, 1))
    return name, rows


def _read_transition(row: list[Word], builder: Builder) -> None:
    if len(row) != 3:
        raise mistake("DH1002", "a transition is three numbers: source, event, target", row[0].span)
    source, event, target = (Word(str(whole_number(word, "a state or event")), word.span) for word in row)
    builder.declare_event(event, controllable=int(event.text) % 2 == 1, observable=True)
    builder.arc(source, event, target, event.text)


__all__ = ["read_ads"]
