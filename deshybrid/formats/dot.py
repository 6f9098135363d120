"""Automata as DOT, in two forms: plain, and Mealy machines as the automata-learning world draws them.

Both: an edge from a node `__start…` leads to an initial location, `shape=doublecircle` marks a location, a location is
named by its node.  Plain: the label is the event; the attribute `output` is what it shows, `output=""` is nothing; an
event without it shows its own name, and an edge without a label is silent.  Mealy: the label is `input/output`, split
at the first `/`; an empty output is ε; lines of one label are parallel transitions.  Cost: linear.
Source: Graphviz, "The DOT language"; LearnLib; automata.cs.ru.nl, Mealy machine syntax.
"""

import re
from collections.abc import Callable

from deshybrid.diagnostics import SourceText
from deshybrid.formats.builder import Builder, Word, mistake
from deshybrid.formats.document import (
    EPSILON,
    Document,
    Written,
    control_losses,
    names_of,
    refuse_labels,
    refuse_names,
)
from deshybrid.formats.dotgraph import Edge, label_lines, read_graph


def read_dot(source: SourceText) -> Document:
    """Return the document of a plain DOT text.

    Raises `FormatError`: DH1002 (not this form), DH1006 (no edge from `__start0`), DH1009 (undirected), DH1011 (size).

    >>> text = 'digraph g { __start0 -> 1; 1 -> 2 [label=a]; 2 -> 1 [label=b, output=""] }'
    >>> [str(transition) for transition in read_dot(SourceText("g.dot", text)).des.transitions]
    ['1 -a/a-> 2', '2 -b/ε-> 1']
    """
    return _read(source, _plain_edge)


def read_mealy(source: SourceText) -> Document:
    """Return the document of a Mealy machine in DOT; errors as in `read_dot`, and DH1002 for a label without `/`.

    >>> text = 'digraph g { __start0 -> 1; 1 -> 1 [label="a / x"]; 1 -> 1 [label="b/"] }'
    >>> [str(transition) for transition in read_mealy(SourceText("g.dot", text)).des.transitions]
    ['1 -a/x-> 1', '1 -b/ε-> 1']
    """
    return _read(source, _mealy_edge)


def _read(source: SourceText, read_edge: Callable[[Builder, Edge], None]) -> Document:
    graph, builder = read_graph(source), Builder(source)
    for name, (word, attributes) in graph.nodes.items():
        if name.startswith("__start"):
            continue
        if name.startswith("__init_"):
            builder.report("DH1003", f"unknown start node `{name[:40]}`", word.span, "", "read it with `--from rv`")
        builder.mention(word)
        if "shape" in attributes and attributes["shape"].text == "doublecircle":
            builder.marked[name] = word
    for edge in graph.edges:
        if edge.source.text.startswith("__start"):
            builder.initial[edge.target.text] = edge.target
        else:
            read_edge(builder, edge)
    return builder.document(graph.name)


def _plain_edge(builder: Builder, edge: Edge) -> None:
    label = edge.attributes.get("label", Word("", edge.source.span))
    output = edge.attributes.get("output", label)
    event, shown = _line(label, builder), _line(output, builder)
    if not event.text:
        builder.arc(edge.source, Word(EPSILON, label.span), edge.target, None)
        return
    builder.arc(edge.source, event, edge.target, shown.text or None)


def _line(label: Word, builder: Builder) -> Word:
    first, *more = label_lines(label)
    if more:
        builder.report("DH1002", "a label of several lines", label.span, "", "draw one edge per event")
    return first


def _mealy_edge(builder: Builder, edge: Edge) -> None:
    if "label" not in edge.attributes:
        raise mistake("DH1002", "an edge needs a label `input/output`", edge.source.span)
    for line in label_lines(edge.attributes["label"]):
        event, slash, output = line.text.partition("/")
        if slash:
            builder.arc(edge.source, Word(event.strip(), line.span), edge.target, output.strip() or None)
        elif line.text:
            builder.report("DH1002", f"`{line.text[:40]}` is no `input/output`", line.span)


def write_dot(document: Document) -> Written:
    """Return a document as plain DOT.

    Raises `FormatError`: DH1012 (a name that begins with `__start`, a backslash before a quote), DH1013 (a signature).

    >>> from deshybrid.des.automaton import DES
    >>> write_dot(Document(DES.from_transitions([("1", "a", "1", None)]))).text.splitlines()[-2]
    '  "1" -> "1" [label="a" output=""];'
    """
    return _write(document, "dot", _plain_label)


def write_mealy(document: Document) -> Written:
    """Return a document as a Mealy machine in DOT; errors as in `write_dot`, and DH1012 for `/` in an event.

    >>> from deshybrid.des.automaton import DES
    >>> write_mealy(Document(DES.from_transitions([("1", "a", "1", "x")]))).text.splitlines()[-2]
    '  "1" -> "1" [label="a/x"];'
    """
    events = (t.event for t in document.des.transitions)
    refuse_names(events, "mealy", lambda name: "`/` ends an input there" if "/" in name else "")
    return _write(document, "mealy", lambda event, output: f'[label="{_label(event)}/{_label(output or "")}"]')


def _plain_label(event: str, output: str | None) -> str:
    shown = "" if output == event else f' output="{_label(output or "")}"'
    return f'[label="{_label(event)}"{shown}]'


def _write(document: Document, format_name: str, label: Callable[[str, str | None], str]) -> Written:
    des = document.des
    refuse_labels(des.transitions, format_name)
    refuse_names(names_of(des), format_name)
    refuse_names([des.name, *des.locations], format_name, _against)
    marked = set(document.marked)
    lines = [f"digraph {_node(des.name)} {{"]
    lines += [f'  __start{number} [label="" shape="none"];' for number in range(len(des.initial))]
    for name in des.locations:
        lines.append(f'  {_node(name)} [shape="{"doublecircle" if name in marked else "circle"}"];')
    lines += [f"  __start{number} -> {_node(name)};" for number, name in enumerate(des.initial)]
    for t in des.transitions:
        ends = f"{_node(t.source)} -> {_node(t.target)}"
        lines += [f"  {ends} {label(t.event, output)};" for output in t.outputs]
    return Written("\n".join([*lines, "}", ""]), control_losses(document, format_name))


def _node(name: str) -> str:
    quoted = name.replace('"', '\\"')
    return f'"{quoted}"'


def _label(text: str) -> str:
    return text.replace("\\", "\\\\").replace('"', '\\"')


def _against(name: str) -> str:
    if name.startswith(("__start", "__init_")):
        return "it is the name of a start arrow there"
    return "" if re.fullmatch(r'(?:[^\\]|\\[^"])*', name) else "it has a backslash at its end or before a quote"


__all__ = ["read_dot", "read_mealy", "write_dot", "write_mealy"]
