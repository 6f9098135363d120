"""libFAUDES `.gen`: a generator as sections of words.

`<Generator>` holds an optional name and the sections `<Alphabet>`, `<States>`, `<TransRel>`, `<InitStates>`,
`<MarkedStates>`, or A, S, T, I, M for short.  After an event, `+C+` means controllable and `+o+` unobservable; the same
as hexadecimal bits: 1 controllable, 2 observable, 4 forcible.  `<Consecutive> a b </Consecutive>` stands for the states
a to b.  `%` and `<!-- -->` are comments; `<`, `>`, `&` and `"` in names are written as XML entities.  Observable events
show their own name.  Cost: linear.  Source: libFAUDES, University of Erlangen-Nürnberg, reference of its token format.
"""

import re
from collections.abc import Iterator
from html import escape
from itertools import zip_longest

from deshybrid.diagnostics import SourceText, Span, diagnostic
from deshybrid.formats.builder import MOST_WORDS, Builder, Word, mistake, whole_number
from deshybrid.formats.document import Document, Event, Written, labelled, refuse_labels, refuse_names
from deshybrid.model.problems import did_you_mean

_TOKEN = re.compile(r'<!--.*?(?:-->|\Z)|<[^<>"\n]*(?:"[^"\n]*"[^<>"\n]*)*>|"[^"\n]*"|%[^\n]*|[^\s<>"%]+|\S', re.DOTALL)
_ENTITY = re.compile(r"&(?:amp|lt|gt|quot|apos);|&")
_MEANING = {"&amp;": "&", "&lt;": "<", "&gt;": ">", "&quot;": '"', "&apos;": "'"}
_SHORT = {"A": "Alphabet", "S": "States", "T": "TransRel", "I": "InitStates", "M": "MarkedStates"}
_SECTIONS = tuple(_SHORT.values())
_MOST_STATES = 500_000


def read_gen(source: SourceText) -> Document:
    """Return the document of a `.gen` text.

    Raises `FormatError`: DH1002 (not this form), DH1003 (unknown section or option), DH1005 (unknown name), DH1006 (no
    initial state), DH1007 (declared twice), DH1011 (too many consecutive states).

    >>> text = "<Generator> <A> a b +o+ </A> <S> 1 2 </S> <T> 1 a 2  2 b 1 </T> <I> 1 </I> <M> </M> </Generator>"
    >>> [str(transition) for transition in read_gen(SourceText("a.gen", text)).des.transitions]
    ['1 -a/a-> 2', '2 -b/ε-> 1']
    """
    tokens = _tokens(source)
    head = next(tokens, None)
    if head is None or not re.fullmatch(r'<Generator(\s+name="[^"]*")?\s*>', head.text):
        place = head.span if head else Span(source, 1, 1)
        raise mistake("DH1002", "the file begins with `<Generator>`", place)
    name, sections = _sections(tokens, head)
    builder = Builder(source)
    _read_alphabet(sections.get("Alphabet", []), builder)
    for word in _states(sections.get("States", [])):
        builder.declare(word)
    _read_transitions(sections, builder)
    builder.initial |= {word.text: word for word in map(_plain, sections.get("InitStates", []))}
    builder.marked |= {word.text: word for word in map(_plain, sections.get("MarkedStates", []))}
    return builder.document(name)


def _tokens(source: SourceText) -> Iterator[Word]:
    """Yield tags, quoted and bare words with their places; comments are left out."""
    line, start = 1, 0
    for count, found in enumerate(_TOKEN.finditer(source.text)):
        line += source.text.count("\n", start, found.start())
        start = found.start()
        column = start - source.text.rfind("\n", 0, start)
        span = Span(source, line, column, len(found.group().split("\n")[0]))
        if count > MOST_WORDS:
            raise mistake("DH1011", f"the file has more than {MOST_WORDS} words", span)
        if found.group().startswith("<!--") and not found.group().endswith("-->"):
            raise mistake("DH1002", "`-->` is missing", span, "opened here")
        if not found.group().startswith(("<!--", "%")):
            yield Word(found.group(), span)


def _sections(tokens: Iterator[Word], head: Word) -> tuple[str, dict[str, list[Word]]]:
    """Return the generator's name, and the words of each section with the tags inside it."""
    given = re.search(r'name="([^"]*)"', head.text)
    name, sections = _plain(Word(given[1], head.span)).text if given else "", dict[str, list[Word]]()
    for token in tokens:
        if token.text == "</Generator>":
            for extra in tokens:
                raise mistake("DH1002", "nothing follows `</Generator>`", extra.span)
            return name, sections
        if not token.text.startswith("<"):
            if name or sections:
                raise mistake(
                    "DH1002", "a section is expected here", token.span, "", "a name of several words is quoted"
                )
            name = _plain(token).text
            continue
        tag = token.text[1:-1]
        title = _SHORT.get(tag, tag)
        if title not in _SECTIONS:
            raise mistake(
                "DH1003", f"unknown section `{token.text[:60]}`", token.span, "", *did_you_mean(tag, _SECTIONS)
            )
        if title in sections:
            raise mistake("DH1007", f"section `{title}` is written twice", token.span)
        sections[title] = _section(tokens, token)
    raise mistake("DH1002", "`</Generator>` is missing", head.span, "opened here")


def _section(tokens: Iterator[Word], opened: Word) -> list[Word]:
    words: list[Word] = []
    for token in tokens:
        if token.text == f"</{opened.text[1:]}":
            return words
        if token.text.startswith("<") and token.text not in ("<Consecutive>", "</Consecutive>"):
            raise mistake("DH1003", f"unknown tag `{token.text[:60]}` in `{opened.text}`", token.span)
        words.append(token)
    raise mistake("DH1002", f"`</{opened.text[1:]}` is missing", opened.span, "opened here")


def _plain(token: Word) -> Word:
    """Return the name that a quoted or bare word stands for."""
    text = token.text
    if text.startswith("<") or text == '"':
        raise mistake("DH1002", "a name is expected here", token.span)
    for entity in _ENTITY.findall(text):
        if entity == "&":
            raise mistake("DH1002", "`&` is written `&amp;` in a name", token.span)
    bare = text[1:-1] if text.startswith('"') else text
    return Word(_ENTITY.sub(lambda found: _MEANING[found.group()], bare), token.span)


def _read_alphabet(words: list[Word], builder: Builder) -> None:
    """Each event, and its option where one follows."""
    for word, after in zip_longest(words, words[1:]):
        if _is_option(word):
            continue
        name = _plain(word)
        builder.usable(name, "an event")
        if name.text in builder.events:
            context = ((builder.events[name.text][1], "here first"),)
            builder.problems.add(
                diagnostic("DH1007", f"event `{name.text}` is declared twice", name.span, context=context)
            )
            continue
        controllable, observable = _option(after, builder) if after and _is_option(after) else (False, True)
        builder.declare_event(name, controllable, observable)
    for first, second in zip([None, *words], words, strict=False):
        if _is_option(second) and (first is None or _is_option(first)):
            builder.report("DH1002", "an option follows the event that it belongs to", second.span)


def _is_option(word: Word) -> bool:
    return re.fullmatch(r"\+.*\+|0x.*", word.text) is not None


def _option(word: Word, builder: Builder) -> tuple[bool, bool]:
    """Return whether the event is controllable and observable."""
    if re.fullmatch(r"\+[CcOoFfAa]+\+", word.text):
        flags = word.text[1:-1]
        controllable, observable, forcible = "C" in flags, "o" not in flags, "F" in flags
    elif re.fullmatch(r"0x[0-9A-Fa-f]{1,8}", word.text) and int(word.text, 16) < 16:
        bits = int(word.text, 16)
        controllable, observable, forcible = bits & 1 != 0, bits & 2 != 0, bits & 4 != 0
    else:
        builder.report("DH1003", f"unknown option `{word.text[:40]}`", word.span, "", "known: `+C+`, `+o+`, `+Co+`")
        return False, True
    if forcible:
        message = "that an event is forcible is passed over"
        builder.warnings.append(diagnostic("DH1016", message, word.span, severity="warning"))
    return controllable, observable


def _states(words: list[Word]) -> Iterator[Word]:
    """Yield the declared states, with those of `<Consecutive>` one by one."""
    left = iter(words)
    total = 0
    for word in left:
        if word.text != "<Consecutive>":
            yield _plain(word)
            continue
        inner = [next(left, word) for _ in range(3)]
        if inner[2].text != "</Consecutive>":
            raise mistake("DH1002", "`<Consecutive>` holds the first and the last index", word.span)
        first, last = (whole_number(end, "an index") for end in inner[:2])
        total += max(0, last - first + 1)
        if total > _MOST_STATES:
            raise mistake("DH1011", f"more than {_MOST_STATES} consecutive states", inner[1].span)
        yield from (Word(str(index), inner[0].span) for index in range(first, last + 1))


def _read_transitions(sections: dict[str, list[Word]], builder: Builder) -> None:
    words = [_plain(word) for word in sections.get("TransRel", [])]
    if len(words) % 3:
        raise mistake(
            "DH1002", "a transition is three words: source, event, target", words[-1].span, "the last is incomplete"
        )
    for source, event, target in zip(words[::3], words[1::3], words[2::3], strict=True):
        if "States" not in sections:
            builder.mention(source)
            builder.mention(target)
        if event.text not in builder.events:
            builder.unknown("event", event, builder.events)
            continue
        visible = builder.events[event.text][0].observable
        builder.arc(source, event, target, event.text if visible else None)


def write_gen(document: Document) -> Written:
    """Return a document as `.gen`, every name in quotes.

    Raises `FormatError`: DH1012 (a name that no format holds), DH1013 (a label that is both visible and silent).

    >>> from deshybrid.des.automaton import DES
    >>> print(write_gen(Document(DES.from_transitions([("1", "a", "2", None)]))).text.split("</Alphabet>")[0])
    <Generator>
    "des"
    <Alphabet>
    "a" +Co+
    """
    des = document.des
    refuse_labels(des.transitions, "gen")
    labels = labelled(document, "gen")
    refuse_names([des.name, *des.locations, *(event.name for event in labels.events)], "gen")
    rows = dict.fromkeys(f"{_quoted(a.source)} {_quoted(a.label)} {_quoted(a.target)}" for a in labels.arcs)
    parts = {
        "Alphabet": [f"{_quoted(event.name)}{_flags(event)}" for event in labels.events],
        "States": map(_quoted, des.locations),
        "TransRel": rows,
        "InitStates": map(_quoted, des.initial),
        "MarkedStates": map(_quoted, document.marked),
    }
    lines = [line for tag, body in parts.items() for line in (f"<{tag}>", *body, f"</{tag}>")]
    return Written("\n".join(["<Generator>", _quoted(des.name), *lines, "</Generator>", ""]), labels.warnings)


def _quoted(name: str) -> str:
    return f'"{escape(name, quote=False).replace(chr(34), "&quot;")}"'


def _flags(event: Event) -> str:
    flags = "C" * event.controllable + "o" * (not event.observable)
    return f" +{flags}+" if flags else ""


__all__ = ["read_gen", "write_gen"]
