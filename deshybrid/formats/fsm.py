"""UMDES `.fsm`: the number of states, then a block per state; the first block is the initial state.

A block is `STATE MARKED COUNT` and COUNT lines `EVENT TARGET [c|uc] [o|uo]` (left out: c, o); blank lines separate
blocks.  A line `EVENTS` may follow with lines `EVENT [c|uc] [o|uo]`.  Observable events show their own name.  Names
have no space.  A word that is none of these is refused: a reader that takes `u0` for nothing makes a silent event
visible.
Cost: linear.  Source: UMDES library, University of Michigan, file format of `.fsm`.
"""

from itertools import groupby

from deshybrid.diagnostics import SourceText, Span
from deshybrid.formats.builder import Builder, Word, mistake, whole_number, words_by_line
from deshybrid.formats.document import (
    Document,
    Event,
    Written,
    labelled,
    refuse_labels,
    refuse_names,
    single_initial,
)

_FLAGS = {"c": ("control", True), "uc": ("control", False), "o": ("sight", True), "uo": ("sight", False)}


def read_fsm(source: SourceText) -> Document:
    r"""Return the document of an `.fsm` text.

    Raises `FormatError`: DH1002 (not this form), DH1003 (unknown flag), DH1004 (a count is wrong), DH1005 (unknown
    target), DH1007 (state twice), DH1008 (an event is observable here and unobservable there).

    >>> document = read_fsm(SourceText("a.fsm", "1\n\nA 1 1\nb A uc uo\n"))
    >>> str(document.des.transitions[0]), document.events
    ('A -b/ε-> A', (Event(name='b', controllable=False, observable=False),))
    """
    builder = Builder(source)
    lines = [words for words in words_by_line(source) if words]
    if not lines:
        raise mistake("DH1002", "the file is empty", Span(source, 1, 1), "the number of states is expected")
    if len(lines[0]) != 1:
        raise mistake("DH1002", "the first line is the number of states", lines[0][-1].span, "too many words")
    count = whole_number(lines[0][0], "the number of states")
    at, blocks = 1, 0
    while at < len(lines) and [word.text for word in lines[at]] != ["EVENTS"]:
        at, blocks = _read_block(lines, at, builder), blocks + 1
    for words in lines[at + 1 :]:
        _declare(builder, words[0], words[1:])
    if blocks != count:
        found = f"{blocks} are here"
        builder.report("DH1004", f"the file announces {count} states", lines[0][0].span, found)
    return builder.document()


def _read_block(lines: list[list[Word]], at: int, builder: Builder) -> int:
    """Read the block that begins at line `at`; return the line after it."""
    head = lines[at]
    if len(head) != 3 or head[1].text not in ("0", "1"):
        raise mistake("DH1002", "a block begins with `STATE MARKED COUNT`, MARKED is 0 or 1", head[-1].span)
    state, marked, announced = head
    count = whole_number(announced, "the number of transitions")
    if not builder.initial:
        builder.initial[state.text] = state
    builder.declare(state)
    if marked.text == "1":
        builder.marked[state.text] = state
    rows = lines[at + 1 : at + 1 + count]
    if len(rows) < count:
        raise mistake(
            "DH1004", f"state `{state.text}` announces {count} transitions", announced.span, f"{len(rows)} follow"
        )
    for number, words in enumerate(rows, start=rows[0][0].span.line if rows else 0):
        if len(words) < 2 or words[0].span.line != number:
            raise mistake(
                "DH1004", f"{count} lines `EVENT TARGET` are announced", words[0].span, "this is none of them"
            )
        event, target, *flags = words
        builder.arc(state, event, target, event.text if _declare(builder, event, flags) else None)
    return at + 1 + count


def _declare(builder: Builder, event: Word, flags: list[Word]) -> bool:
    """Declare an event with its flags, and return whether it is observable."""
    found = {"control": True, "sight": True}
    said: set[str] = set()
    for flag in flags:
        kind, value = _FLAGS.get(flag.text, ("", True))
        if not kind:
            builder.report("DH1003", f"unknown flag `{flag.text[:40]}`", flag.span, "", "known: `c`, `uc`, `o`, `uo`")
        elif kind in said:
            builder.report("DH1002", f"event `{event.text}` has two flags of one kind", flag.span)
        else:
            said.add(kind)
            found[kind] = value
    builder.usable(event, "an event")
    builder.declare_event(event, found["control"], found["sight"])
    return found["sight"]


def write_fsm(document: Document) -> Written:
    """Return a document as `.fsm`.

    Raises `FormatError`: DH1012 (a name with a space), DH1013 (several initial locations; a label that is both visible
    and silent; a signature).

    >>> from deshybrid.des.automaton import DES
    >>> print(write_fsm(Document(DES.from_transitions([("A", "b", "A", None)]))).text)
    1
    <BLANKLINE>
    A 0 1
    b A c uo
    <BLANKLINE>
    """
    des = document.des
    refuse_labels(des.transitions, "fsm")
    first = single_initial(des, "fsm")
    labels = labelled(document, "fsm")
    refuse_names([*des.locations, *(event.name for event in labels.events)], "fsm", _against)
    flags = {event.name: _flags(event) for event in labels.events}
    order = [first, *(name for name in des.locations if name != first)]
    rank = {name: number for number, name in enumerate(order)}
    exits: dict[str, dict[str, None]] = {name: {} for name in order}
    for source, arcs in groupby(sorted(labels.arcs, key=lambda arc: rank[arc.source]), key=lambda arc: arc.source):
        exits[source] = dict.fromkeys(f"{arc.label} {arc.target} {flags[arc.label]}" for arc in arcs)
    marked = set(document.marked)
    blocks = ["\n".join([f"{name} {int(name in marked)} {len(rows)}", *rows]) for name, rows in exits.items()]
    if {event.name for event in labels.events} - {arc.label for arc in labels.arcs}:
        blocks.append("\n".join(["EVENTS", *(f"{name} {text}" for name, text in flags.items())]))
    return Written("\n\n".join([str(len(order)), *blocks]) + "\n", labels.warnings)


def _flags(event: Event) -> str:
    return f"{'c' if event.controllable else 'uc'} {'o' if event.observable else 'uo'}"


def _against(name: str) -> str:
    return "it holds a space" if len(name.split()) > 1 else ""


__all__ = ["read_fsm", "write_fsm"]
