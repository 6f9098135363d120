"""The tree of a model file: texts, lists and mappings with their places, and nothing else.

In: what the reader of YAML events found.  Out: frozen nodes.  A scalar keeps its text as written (`on`, `012`, `1e-3`),
so that names stay names; what a text means is decided by whoever reads the key.  No Python object is ever made from the
file's wishes.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from deshybrid.diagnostics import Span

_NULLS = frozenset({"", "~", "null", "Null", "NULL"})


@dataclass(frozen=True, slots=True, eq=False)
class ScalarNode:
    """One value as written; `offset` counts characters from the span's start to the text, None if not verbatim there.

    >>> from deshybrid.diagnostics import SourceText
    >>> node = ScalarNode("k/0", True, Span(SourceText("m.yaml", "rate: k/0"), 1, 7, 3), 0)
    >>> node.part(2, 3).column, node.is_null
    (9, False)
    """

    text: str
    plain: bool
    span: Span
    offset: int | None

    @property
    def is_null(self) -> bool:
        """True for an unquoted `null`, `~` or nothing at all; a quoted "null" is a text."""
        return self.plain and self.text in _NULLS

    def part(self, start: int, end: int) -> Span:
        """Return the place of `text[start:end]`, or of the whole scalar where that cannot be told."""
        if self.offset is None:
            return self.span
        return Span(self.span.source, self.span.line, self.span.column + self.offset + start, max(1, end - start))


@dataclass(frozen=True, slots=True, eq=False)
class SequenceNode:
    """A list."""

    items: tuple["Node", ...]
    span: Span


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """One key of a mapping with its value."""

    key: ScalarNode
    value: "Node"


@dataclass(frozen=True, slots=True, eq=False)
class MappingNode:
    """A mapping from texts to nodes, in the order written, each key once."""

    entries: Mapping[str, Entry]
    span: Span

    def get(self, key: str) -> "Node | None":
        """Return the value of `key`, or None where it is not written.

        >>> from deshybrid.diagnostics import SourceText
        >>> MappingNode({}, Span(SourceText("m.yaml", "{}"), 1, 1, 2)).get("state") is None
        True
        """
        entry = self.entries.get(key)
        return None if entry is None else entry.value


Node: TypeAlias = ScalarNode | SequenceNode | MappingNode


def form_of(node: Node) -> str:
    """Return what a node is, in the words of a message.

    >>> from deshybrid.diagnostics import SourceText
    >>> form_of(SequenceNode((), Span(SourceText("m.yaml", "[]"), 1, 1, 2)))
    'a list'
    """
    match node:
        case ScalarNode():
            return "null" if node.is_null else "a single value"
        case SequenceNode():
            return "a list"
        case MappingNode():
            return "a mapping"


__all__ = ["Entry", "MappingNode", "Node", "ScalarNode", "SequenceNode", "form_of"]
