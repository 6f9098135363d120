"""AT&T text, the form that OpenFst, foma and HFST exchange: one line an arc, one line a final state.

`SOURCE TARGET LABEL` is an arc of an acceptor, whose event shows its own name; `SOURCE TARGET EVENT OUTPUT` is one of a
transducer.  The label 0 is ε.  `STATE` is final, that is marked.  A weight may follow as last word (fifth on an arc,
second on a final state) and must be 0: a DES has no weights.  The source of the first line is the initial state.
With a symbol table (`SYMBOL NUMBER` a line) the labels are numbers; without one they are names.
Cost: linear.  Source: AT&T FSM library and OpenFst, manual page of `fstcompile`.
"""

from deshybrid.diagnostics import FormatError, SourceText, diagnostic
from deshybrid.formats.builder import Builder, Word, mistake, words_by_line
from deshybrid.formats.document import (
    EPSILON,
    Document,
    Written,
    control_losses,
    refuse_labels,
    refuse_names,
    single_initial,
)

_ZERO = "0"


def read_att(source: SourceText, symbols: SourceText | None = None) -> Document:
    r"""Return the document of an AT&T text; the event of an arc that consumes ε is called `ε`.

    Raises `FormatError`: DH1002 (not this form), DH1003 (a label that the symbol table does not have), DH1007 (a number
    twice in the table), DH1009 (a weight that is not zero).

    >>> document = read_att(SourceText("a.att", "1\t2\ta\tx\n2\t1\t0\n2\n"))
    >>> [str(transition) for transition in document.des.transitions], document.marked
    (['1 -a/x-> 2', '2 -ε/ε-> 1'], ('2',))
    """
    builder = Builder(source)
    table = None if symbols is None else _symbols(symbols)
    for words in words_by_line(source):
        if not words:
            continue
        builder.initial = builder.initial or {words[0].text: words[0]}
        if len(words) > 5:
            raise mistake("DH1002", "a line has at most five words", words[5].span)
        if len(words) in (2, 5):
            _check_weight(words[-1], builder)
        builder.mention(words[0])
        if len(words) <= 2:
            builder.marked.setdefault(words[0].text, words[0])
            continue
        builder.mention(words[1])
        event, output = (_label(word, table, builder) for word in (words[2], words[min(3, len(words) - 1)]))
        shown = None if output is None else output.text
        builder.arc(words[0], event or Word(EPSILON, words[2].span), words[1], shown)
    return builder.document()


def _check_weight(word: Word, builder: Builder) -> None:
    try:
        weight = float(word.text)
    except ValueError:
        raise mistake("DH1002", "a weight is a number", word.span) from None
    if weight != 0:
        builder.report("DH1009", f"a weight of {word.text[:40]}", word.span, "a discrete-event system has no weights")


def _label(word: Word, table: dict[str, Word] | None, builder: Builder) -> Word | None:
    """Return the name of a label, None for ε."""
    if word.text == _ZERO:
        return None
    if table is None:
        return word
    if word.text not in table:
        builder.report("DH1003", f"label `{word.text[:40]}` is no number of the symbol table", word.span)
        return word
    return Word(table[word.text].text, word.span)


def _symbols(symbols: SourceText) -> dict[str, Word]:
    """Return the symbol of each number."""
    table: dict[str, Word] = {}
    for words in words_by_line(symbols):
        if not words:
            continue
        if len(words) != 2 or not (words[1].text.isascii() and words[1].text.isdigit()):
            raise mistake("DH1002", "a line of a symbol table is `SYMBOL NUMBER`", words[0].span)
        number = words[1].text.lstrip("0") or _ZERO
        if number in table:
            raise mistake("DH1007", f"the number {number[:40]} is in the symbol table twice", words[1].span)
        table[number] = words[0]
    return table


def write_att(document: Document) -> Written:
    r"""Return a document as AT&T text with names as labels: arcs of the initial location first, then the marked ones.

    Raises `FormatError`: DH1012 (a name with a space, a label `0`), DH1013 (several initial locations, or a location
    that no line mentions).

    >>> from deshybrid.des.automaton import DES
    >>> write_att(Document(DES.from_transitions([("1", "a", "1", None)]))).text
    '1\t1\ta\t0\n'
    """
    des = document.des
    refuse_labels(des.transitions, "att")
    first = single_initial(des, "att")
    refuse_names(des.locations, "att", _against_space)
    labels = (name for t in des.transitions for name in (t.event, *t.outputs) if name is not None)
    refuse_names(labels, "att", _against)
    ordered = sorted(des.transitions, key=lambda t: t.source != first)
    lines = dict.fromkeys(
        f"{t.source}\t{t.target}\t{_written(t.event)}\t{output or _ZERO}" for t in ordered for output in t.outputs
    )
    begins = bool(ordered) and ordered[0].source == first
    marked = sorted(document.marked, key=lambda name: name != first)
    if not begins and first in document.marked:
        lines = dict.fromkeys([first, *lines])
        begins = True
    text = "".join(f"{line}\n" for line in dict.fromkeys([*lines, *marked]))
    seen = {name for t in des.transitions for name in (t.source, t.target)} | set(document.marked)
    missing = [name for name in des.locations if name not in seen or (name == first and not begins)]
    if missing:
        message = "`att` cannot hold location `{}`: no line begins with it"
        raise FormatError(*(diagnostic("DH1013", message.format(name[:100])) for name in missing))
    return Written(text, control_losses(document, "att"))


def _written(event: str) -> str:
    return _ZERO if event == EPSILON else event


def _against_space(name: str) -> str:
    return "it holds a space" if len(name.split()) > 1 else ""


def _against(name: str) -> str:
    return "it means ε there" if name == _ZERO else _against_space(name)


__all__ = ["read_att", "write_att"]
