"""The DOT language as far as automata use it: nodes and directed edges with their attributes.

In: DOT text.  Out: a `Graph` with nodes in the order in which they are created, each with the attributes that it had
then, as Graphviz does it.  Subgraphs only scope defaults.  Ports, edges between subgraphs, HTML-like labels and
undirected graphs are refused.  Cost: linear.  Source: Graphviz, "The DOT language".
"""

import re
from dataclasses import dataclass, field
from itertools import pairwise
from typing import NamedTuple

from deshybrid.diagnostics import FormatError, SourceText, Span
from deshybrid.formats.builder import MOST_WORDS, Word, mistake

_MOST_DEPTH = 64
_TOKEN = re.compile(
    r"""(?P<skip>\s+|//[^\n]*|(?<![^\n])\#[^\n]*|/\*.*?\*/)"""
    r"""|(?P<quoted>"[^"\\]*(?:\\.[^"\\]*)*")"""
    r"""|(?P<word>[^\W\d]\w*|-?(?:\.\d+|\d+(?:\.\d*)?))"""
    r"""|(?P<sign>->|--|[{}\[\];,=:+<])""",
    re.DOTALL,
)
_KEYWORDS = ("graph", "node", "edge", "subgraph")


class Token(NamedTuple):
    """A sign, word or quoted text; `text` of a quoted one is without its quotes."""

    kind: str
    text: str
    span: Span


class Edge(NamedTuple):
    """A directed edge with its attributes."""

    source: Word
    target: Word
    attributes: dict[str, Word]


@dataclass(slots=True)
class Graph:
    """What a DOT text draws."""

    name: str = ""
    nodes: dict[str, tuple[Word, dict[str, Word]]] = field(default_factory=dict)
    edges: list[Edge] = field(default_factory=list)


def read_graph(source: SourceText) -> Graph:
    """Return the graph of a DOT text.

    Raises `FormatError`: DH1002 (not DOT as far as it is read here), DH1009 (undirected), DH1011 (too large, too deep).

    >>> graph = read_graph(SourceText("a.dot", 'digraph g { a [shape=box]; a -> "b c" [label=x] }'))
    >>> list(graph.nodes), graph.edges[0].attributes["label"].text
    (['a', 'b c'], 'x')
    """
    return _Parser(_tokens(source)).graph()


def _tokens(source: SourceText) -> list[Token]:
    text, tokens = source.text, list[Token]()
    at, line, start = 0, 1, 0
    while at < len(text):
        found = _TOKEN.match(text, at)
        span = Span(source, line, at - start + 1, 1)
        if found is None:
            raise mistake("DH1002", "this is not DOT", span, "", "a name with other characters than letters is quoted")
        kind, content = found.lastgroup or "", found.group()
        if kind != "skip":
            plain = _without_quote_escapes(content[1:-1]) if kind == "quoted" else content
            tokens.append(Token(kind, plain, Span(source, line, at - start + 1, len(content.split("\n")[0]))))
        if len(tokens) > MOST_WORDS:
            raise mistake("DH1011", f"the file has more than {MOST_WORDS} words", span)
        at = found.end()
        if "\n" in content:
            line += content.count("\n")
            start = text.rfind("\n", 0, at) + 1
    tokens.append(Token("end", "the end of the file", Span(source, line, at - start + 1)))
    return tokens


def _without_quote_escapes(text: str) -> str:
    r"""Inside quotes only `\"` and a backslash at the end of a line are escapes; other pairs mean something in labels.

    >>> _without_quote_escapes(r'a\"b\\n')
    'a"b\\\\n'
    """
    return re.sub(r"\\(.)", lambda pair: {'"': '"', "\n": ""}.get(pair[1], pair[0]), text, flags=re.DOTALL)


def label_lines(label: Word) -> list[Word]:
    r"""Return the lines of a label, without escapes; DH1002 for an escape that stands for another name (`\N`).

    >>> label_lines(Word(r"a\nb", Span(SourceText("a", ""), 1, 1)))[1].text
    'b'
    """
    lines = [""]
    for part in re.findall(r"\\.|\n|[^\\\n]+|\\", label.text, flags=re.DOTALL):
        if part in ("\\n", "\\l", "\\r", "\n"):
            lines.append("")
        elif part == "\\\\":
            lines[-1] += "\\"
        elif part.startswith("\\"):
            raise mistake("DH1002", f"`{part}` stands for another text", label.span, "", "write the text itself")
        else:
            lines[-1] += part
    return [Word(line.strip(), label.span) for line in lines]


@dataclass(slots=True)
class _Parser:
    """Reads statements; `scopes` holds the default attributes of nodes and edges, innermost last."""

    tokens: list[Token]
    at: int = 0
    found: Graph = field(default_factory=Graph)
    scopes: list[dict[str, dict[str, Word]]] = field(default_factory=list)

    @property
    def here(self) -> Token:
        return self.tokens[self.at]

    def graph(self) -> Graph:
        if self.here.text.lower() == "strict":
            self.at += 1
        if self.here.text.lower() == "graph":
            raise mistake("DH1009", "an undirected graph", self.here.span, "transitions have a direction")
        if self.here.text.lower() != "digraph":
            raise self.expected("`digraph`")
        self.at += 1
        if self.here.kind in ("word", "quoted"):
            self.found.name = self.here.text
            self.at += 1
        self.open()
        while self.scopes:
            self.statement()
        if self.here.kind != "end":
            raise self.expected("the end of the file")
        return self.found

    def expected(self, what: str) -> FormatError:
        return mistake("DH1002", f"{what} is expected here", self.here.span, f"this is `{self.here.text[:40]}`")

    def is_sign(self, *signs: str) -> bool:
        return self.here.kind == "sign" and self.here.text in signs

    def open(self) -> None:
        if not self.is_sign("{"):
            raise self.expected("`{`")
        if len(self.scopes) >= _MOST_DEPTH:
            raise mistake("DH1011", f"subgraphs are nested more than {_MOST_DEPTH} deep", self.here.span)
        self.scopes.append(
            {kind: dict(self.scopes[-1][kind]) if self.scopes else {} for kind in ("graph", "node", "edge")}
        )
        self.at += 1

    def statement(self) -> None:
        if self.is_sign(";"):
            self.at += 1
        elif self.is_sign("}"):
            self.scopes.pop()
            self.at += 1
            self.no_edge_of_subgraph()
        elif self.is_sign("{"):
            self.open()
        elif self.here.kind == "word" and self.here.text.lower() in _KEYWORDS:
            self.keyword(self.here.text.lower())
        else:
            self.nodes_or_edges()

    def no_edge_of_subgraph(self) -> None:
        if self.is_sign("->"):
            raise mistake("DH1002", "an edge from a subgraph", self.here.span, "", "write one edge per node")

    def keyword(self, word: str) -> None:
        self.at += 1
        if word == "subgraph":
            if self.here.kind in ("word", "quoted"):
                self.at += 1
            self.open()
        else:
            self.scopes[-1][word] |= self.attributes()

    def identifier(self) -> Word:
        """Return a name and go on; keywords have to be quoted."""
        token = self.here
        if token.kind not in ("word", "quoted") or (token.kind == "word" and token.text.lower() in _KEYWORDS):
            raise self.expected("a name")
        self.at += 1
        if self.is_sign(":", "+"):
            raise mistake("DH1002", f"`{self.here.text}` after a name is not read here", self.here.span)
        return Word(token.text, token.span)

    def nodes_or_edges(self) -> None:
        chain = [self.identifier()]
        if self.is_sign("="):  # an attribute of the graph
            self.at += 1
            self.identifier()
            return
        while self.is_sign("->", "--"):
            if self.here.text == "--":
                raise mistake("DH1009", "an undirected edge", self.here.span, "transitions have a direction")
            self.at += 1
            chain.append(self.identifier())
        attributes = self.attributes() if self.is_sign("[") else {}
        for word in chain:
            self.found.nodes.setdefault(word.text, (word, dict(self.scopes[-1]["node"])))
        if len(chain) == 1:
            self.found.nodes[chain[0].text][1].update(attributes)
        for source, target in pairwise(chain):
            self.found.edges.append(Edge(source, target, self.scopes[-1]["edge"] | attributes))

    def attributes(self) -> dict[str, Word]:
        """Read `[name = value, ...]`, any number of such lists."""
        found: dict[str, Word] = {}
        while self.is_sign("["):
            self.at += 1
            while not self.is_sign("]"):
                name = self.identifier()
                if not self.is_sign("="):
                    raise self.expected("`=`")
                self.at += 1
                if self.is_sign("<"):
                    raise mistake("DH1002", "an HTML-like label is not read here", self.here.span)
                found[name.text] = self.identifier()
                if self.is_sign(",", ";"):
                    self.at += 1
            self.at += 1
        return found


__all__ = ["Edge", "Graph", "Token", "label_lines", "read_graph"]
