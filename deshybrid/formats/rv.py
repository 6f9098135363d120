"""Automata of Linux' runtime verification, read only: DOT with a node `__init_X` that leads to the initial state.

The lines of an edge's label are parallel events, which show their own names; a double circle marks.  Guards, resets and
invariants (`event;clk < 5;reset(clk)`) need a clock, which a DES has not, and are refused.  Cost: linear.
Source: Linux kernel documentation, trace/rv/deterministic_automata and hybrid_automata.
"""

from deshybrid.diagnostics import SourceText
from deshybrid.formats.builder import Builder
from deshybrid.formats.document import Document
from deshybrid.formats.dotgraph import label_lines, read_graph

_NO_CLOCK = "a discrete-event system has no clocks"


def read_rv(source: SourceText) -> Document:
    r"""Return the document of a runtime-verification automaton.

    Raises `FormatError`: DH1002 (not this form), DH1006 (no edge from an `__init_` node), DH1009 (guards, resets,
    invariants), DH1011 (size).

    >>> text = 'digraph state_automaton { "__init_on" -> "on"; "on" -> "off" [ label = "stop\\nfail" ]; }'
    >>> [str(transition) for transition in read_rv(SourceText("a.dot", text)).des.transitions]
    ['on -stop/stop-> off', 'on -fail/fail-> off']
    """
    graph, builder = read_graph(source), Builder(source)
    for name, (word, attributes) in graph.nodes.items():
        if name.startswith("__init_"):
            continue
        builder.mention(word)
        if "label" in attributes and len(label_lines(attributes["label"])) > 1:
            builder.report("DH1009", f"an invariant of `{name[:100]}`", attributes["label"].span, _NO_CLOCK)
        if "shape" in attributes and attributes["shape"].text == "doublecircle":
            builder.marked[name] = word
    for edge in graph.edges:
        if edge.source.text.startswith("__init_"):
            builder.initial[edge.target.text] = edge.target
            continue
        if "label" not in edge.attributes:
            builder.report("DH1002", "an edge needs a label", edge.source.span)
            continue
        for event in label_lines(edge.attributes["label"]):
            if ";" in event.text:
                builder.report("DH1009", "a guard or reset", event.span, _NO_CLOCK)
            builder.arc(edge.source, event, edge.target, event.text)
    return builder.document(graph.name)


__all__ = ["read_rv"]
