"""XML of a stranger, read without trust: elements with their places, and nothing else.

A document type, entities, processing instructions, more than 64 levels or 500,000 elements are refused, so that a few
lines can neither expand into gigabytes nor name another file.  Cost: linear.  Parser: expat, of Python's own library.
"""

from collections.abc import Iterator
from dataclasses import dataclass, field
from html import escape
from xml.parsers import expat

from deshybrid.diagnostics import FormatError, SourceText, Span
from deshybrid.formats.builder import Word, mistake

MOST_DEPTH = 64
MOST_ELEMENTS = 500_000


@dataclass(slots=True, eq=False)
class Element:
    """One element: its tag without namespace, its attributes, its own text, its children, its place."""

    tag: str
    attributes: dict[str, str]
    span: Span
    text: str = ""
    children: list["Element"] = field(default_factory=list)

    def all(self, tag: str) -> Iterator["Element"]:
        """Yield the children of a tag, in order."""
        return (child for child in self.children if child.tag == tag)

    def required(self, name: str) -> Word:
        """Return an attribute with the element's place; DH1002 where it is not written."""
        if name not in self.attributes:
            raise mistake("DH1002", f"`<{self.tag}>` needs the attribute `{name}`", self.span)
        return Word(self.attributes[name], self.span)


def read_xml(source: SourceText) -> Element:
    """Return the root element of an XML text.

    Raises `FormatError`: DH1002 (not XML), DH1010 (document type, entity, processing instruction), DH1011 (too deep or
    too large).

    >>> root = read_xml(SourceText("a.xml", "<a x='1'><b/><b>t</b></a>"))
    >>> root.attributes, [child.text for child in root.all("b")]
    ({'x': '1'}, ['', 't'])
    """
    parser = expat.ParserCreate(encoding="utf-8", namespace_separator=None)
    parser.buffer_text = True
    tree = _Tree(source, parser)
    parser.StartElementHandler = tree.open
    parser.EndElementHandler = tree.close
    parser.CharacterDataHandler = tree.add_text
    parser.StartDoctypeDeclHandler = tree.refuse_doctype
    parser.ProcessingInstructionHandler = tree.refuse_instruction
    try:
        parser.Parse(source.text.encode("utf-8"), True)
    except expat.ExpatError as error:
        place = Span(source, error.lineno, error.offset + 1)
        raise mistake("DH1002", f"the file is not XML: {expat.errors.messages[error.code]}", place) from None
    return tree.root


@dataclass(slots=True)
class _Tree:
    """What expat reports, as a tree."""

    source: SourceText
    parser: expat.XMLParserType
    stack: list[Element] = field(default_factory=list)
    found: list[Element] = field(default_factory=list)
    count: int = 0

    @property
    def root(self) -> Element:
        return self.found[0]

    def _here(self) -> Span:
        line, column = self.parser.CurrentLineNumber, self.parser.CurrentColumnNumber
        rest = self.source.line(line)[column:]
        return Span(self.source, line, column + 1, max(1, rest.find(">") + 1 or len(rest)))

    def open(self, tag: str, attributes: dict[str, str]) -> None:
        self.count += 1
        if self.count > MOST_ELEMENTS:
            raise mistake("DH1011", f"the file has more than {MOST_ELEMENTS} elements", self._here())
        if len(self.stack) >= MOST_DEPTH:
            raise mistake("DH1011", f"elements are nested more than {MOST_DEPTH} deep", self._here())
        plain = {name: text for name, text in attributes.items() if not name.startswith("xml")}
        element = Element(tag.rpartition(":")[2], plain, self._here())
        (self.stack[-1].children if self.stack else self.found).append(element)
        self.stack.append(element)

    def close(self, _tag: str) -> None:
        self.stack.pop()

    def add_text(self, text: str) -> None:
        self.stack[-1].text += text

    def refuse_doctype(self, *_declaration: object) -> None:
        raise self._refused("a document type")

    def refuse_instruction(self, *_instruction: object) -> None:
        raise self._refused("a processing instruction")

    def _refused(self, what: str) -> FormatError:
        return mistake("DH1010", f"{what} is not accepted", self._here(), "", "delete it; no model needs one")


def truth(element: Element, text: str) -> bool:
    """Return what `true` or `false` means; DH1002 for another text.

    >>> truth(read_xml(SourceText("a.xml", "<a/>")), " true ")
    True
    """
    value = text.strip().lower()
    if value not in ("true", "false", "1", "0"):
        raise mistake("DH1002", f"`true` or `false` is expected, not `{value[:40]}`", element.span)
    return value in ("true", "1")


def quoted(text: str) -> str:
    """Return a text as an XML attribute value with its quotes.

    >>> quoted('a"<b')
    '"a&quot;&lt;b"'
    """
    return f'"{escape(text, quote=False).replace(chr(34), "&quot;")}"'


__all__ = ["Element", "quoted", "read_xml", "truth"]
