"""From text to tree: YAML 1.2 (and so JSON) read as a stream of events, never as Python objects.

In: a `SourceText`.  Out: the root node.  The events come from ruamel.yaml's parser; tags, merge keys, directives and
several documents are refused, names stay as written, and size, depth and aliases are bounded before anything is
built, so that no file can exhaust memory or the stack.  Cost: one pass over the text.
Source: YAML 1.2.2, sections 3.2.2 (anchors and aliases), 7 (styles), 10.3 (core schema: only null is taken from it).
"""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from deshybrid.diagnostics import Diagnostic, ModelError, SourceText, Span, diagnostic
from deshybrid.model.problems import Problems
from deshybrid.model.tree import Entry, MappingNode, Node, ScalarNode, SequenceNode

MOST_NODES = 500_000
MOST_DEPTH = 64
FORBIDDEN = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u2028\u2029\ud800-\udfff\ufeff\ufffe\uffff]")


def read_tree(source: SourceText) -> Node:
    """Return the tree of a YAML 1.2 or JSON text.

    Raises `ModelError`: DH0101 (syntax), DH0103 (escaped control character), DH0105 (too large or too deep), DH0106
    (duplicate key), DH0107 (tag), DH0108 (alias), DH0109 (key that is no text), DH0110 (not exactly one document).

    >>> read_tree(SourceText("m.yaml", "time: {step: 0.1}")).get("time").get("step").text
    '0.1'
    """
    builder = _Builder(source)
    for event in _events(source):
        builder.take(event)
    builder.problems.raise_all()
    return builder.root()


def _events(source: SourceText) -> Iterator[Any]:
    from ruamel.yaml import YAML
    from ruamel.yaml.error import MarkedYAMLError, YAMLError

    try:
        yield from YAML(typ="safe", pure=True).parse(source.text)
    except MarkedYAMLError as error:
        mark = error.problem_mark or error.context_mark
        place = None if mark is None else Span(source, mark.line + 1, mark.column + 1)
        context = () if error.context is None else (_one_line(error.context),)
        raise ModelError(_syntax_error(_one_line(error.problem or ""), place, context)) from None
    except (YAMLError, ValueError, OverflowError) as error:  # a bad escape such as "\UFFFFFFFF"
        raise ModelError(_syntax_error(_one_line(str(error)), Span(source, 1, 1), ())) from None


def _syntax_error(problem: str, place: Span | None, context: tuple[str, ...]) -> Diagnostic:
    helps: tuple[str, ...] = ()
    if place is not None and place.source.line(place.line)[place.column - 1 : place.column] == "\t":
        helps = ("indent with spaces: YAML takes no tabs there",)
    return diagnostic("DH0101", "the file is not valid YAML", place, problem, notes=context, helps=helps)


def _one_line(text: str) -> str:
    return " ".join(text.split())[:200]


@dataclass(slots=True)
class _Open:
    """A collection whose end has not been read yet."""

    start: Any
    is_mapping: bool
    anchor: str | None
    items: list[Node] = field(default_factory=list)
    entries: dict[str, Entry] = field(default_factory=dict)
    key: ScalarNode | None = None
    awaits_value: bool = False
    size: int = 1


class _Builder:
    """Takes the events in order and keeps a stack of open collections."""

    def __init__(self, source: SourceText) -> None:
        self.source = source
        self.problems = Problems()
        self._stack: list[_Open] = []
        self._anchors: dict[str, tuple[Node, int]] = {}
        self._documents: list[Node] = []
        self._size = 0

    def root(self) -> Node:
        """Return the document, once all events are taken."""
        if not self._documents:
            start = Span(self.source, 1, 1)
            raise ModelError(diagnostic("DH0110", "the file is empty", start, "expected a model here"))
        return self._documents[0]

    def take(self, event: Any) -> None:
        """Events are told apart by the names of their classes, so that ruamel.yaml is imported only to read."""
        match type(event).__name__:
            case "DocumentStartEvent":
                self._start_document(event)
            case "ScalarEvent":
                self._check_tag(event)
                scalar = self._scalar(event)
                self._place(scalar, 1, event.anchor, scalar.span)
            case "AliasEvent":
                self._alias(event)
            case "SequenceStartEvent" | "MappingStartEvent":
                self._open(event)
            case "SequenceEndEvent" | "MappingEndEvent":
                self._close(event)

    def _start_document(self, event: Any) -> None:
        place = self._span(event.start_mark, event.end_mark)
        if self._documents:
            label = "a second document starts here"
            raise ModelError(diagnostic("DH0110", "the file holds more than one document", place, label))
        if event.version is not None or event.tags:
            self.problems.add(
                diagnostic("DH0110", "YAML directives are not accepted", place, helps=("leave out the lines with `%`",))
            )

    def _open(self, event: Any) -> None:
        self._check_tag(event)
        if len(self._stack) >= MOST_DEPTH:
            self._refuse_size(event, f"lists and mappings are nested more than {MOST_DEPTH} deep")
        self._stack.append(_Open(event.start_mark, type(event).__name__ == "MappingStartEvent", event.anchor))

    def _close(self, event: Any) -> None:
        done = self._stack.pop()
        place = self._span(done.start, event.end_mark)
        node: Node
        if done.is_mapping:
            node = MappingNode(MappingProxyType(done.entries), place)
        else:
            node = SequenceNode(tuple(done.items), place)
        self._place(node, done.size, done.anchor, place)

    def _place(self, node: Node, size: int, anchor: str | None, place: Span) -> None:
        """Put a complete node where it belongs: into the innermost open collection, or as the document."""
        if anchor is not None:
            self._anchors[anchor] = (node, size)
        if not self._stack:
            self._documents.append(node)
            return
        top = self._stack[-1]
        top.size += size
        if top.size > MOST_NODES:
            text = f"the file holds more than {MOST_NODES:,} values (aliases count as often as they are used)"
            raise ModelError(diagnostic("DH0105", text, place, helps=("keep big matrices in a .npz file",)))
        if not top.is_mapping:
            top.items.append(node)
        elif top.awaits_value:
            self._add_entry(top, node)
        else:
            top.key, top.awaits_value = self._key(node), True

    def _key(self, node: Node) -> ScalarNode | None:
        if not isinstance(node, ScalarNode) or node.is_null:
            self.problems.add(
                diagnostic("DH0109", "a key must be a text", node.span, "not a text", helps=("quote the key",))
            )
            return None
        if node.plain and node.text == "<<":
            helps = ("write common matrices once under `defaults`, or repeat them",)
            self.problems.add(diagnostic("DH0109", "merge keys are not accepted", node.span, helps=helps))
            return None
        return node

    def _add_entry(self, top: _Open, value: Node) -> None:
        key, top.key, top.awaits_value = top.key, None, False
        if key is None:
            return
        first = top.entries.get(key.text)
        if first is None:
            top.entries[key.text] = Entry(key, value)
            return
        context = ((first.key.span, "first written here"),)
        text = f"key `{key.text}` is written twice"
        self.problems.add(diagnostic("DH0106", text, key.span, "and again here", context=context))

    def _alias(self, event: Any) -> None:
        place = self._span(event.start_mark, event.end_mark)
        name = event.anchor
        if any(name == open_.anchor for open_ in self._stack):
            raise ModelError(diagnostic("DH0108", f"alias `*{name}` contains itself", place))
        if name not in self._anchors:
            raise ModelError(diagnostic("DH0108", f"alias `*{name}` has no anchor `&{name}` before it", place))
        node, size = self._anchors[name]
        self._place(node, size, None, place)

    def _scalar(self, event: Any) -> ScalarNode:
        place = self._span(event.start_mark, event.end_mark)
        text = _joined_surrogates(event.value)
        if FORBIDDEN.search(text):
            self.problems.add(diagnostic("DH0103", "a text holds a control character", place, "written as an escape"))
        quote = 0 if event.style is None else 1
        there = place.source.line(place.line).startswith(text, place.column - 1 + quote)
        verbatim = there and event.style in (None, "'", '"') and event.anchor is None
        return ScalarNode(text, event.style is None, place, quote if verbatim else None)

    def _check_tag(self, event: Any) -> None:
        tag = event.tag
        if tag is None:
            return
        place = Span(self.source, event.start_mark.line + 1, event.start_mark.column + 1)
        helps = ("leave the tag out: every value is taken as written",)
        self.problems.add(diagnostic("DH0107", f"tag `{tag}` is not accepted", place, helps=helps))

    def _refuse_size(self, event: Any, text: str) -> None:
        raise ModelError(diagnostic("DH0105", text, self._span(event.start_mark, event.end_mark)))

    def _span(self, start: Any, end: Any) -> Span:
        """The part of a node that lies in its first line."""
        line, column = start.line + 1, start.column + 1
        last = end.column if end.line == start.line else len(self.source.line(line).rstrip())
        return Span(self.source, line, column, max(1, last - start.column))


def _joined_surrogates(text: str) -> str:
    r"""JSON writes characters beyond 16 bits as two escapes, such as \ud83d\ude00."""
    if not any("\ud800" <= char <= "\udfff" for char in text):
        return text
    return text.encode("utf-16", "surrogatepass").decode("utf-16", "surrogatepass")


__all__ = ["FORBIDDEN", "MOST_DEPTH", "MOST_NODES", "read_tree"]
