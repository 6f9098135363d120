"""Supremica `.wmod`, read only: a module with one automaton.

Events have a kind (controllable or not) and may be unobservable; observable events show their own name.  Marking is the
proposition `:accepting`; without that proposition nothing is marked.  Guards, actions, variables, parameters, aliases,
group nodes, and a second automaton have no place in a DES and are refused by name.  Cost: linear.
Source: Supremica and WATERS, module format, waters.sourceforge.net.
"""

from collections.abc import Iterator

from deshybrid.diagnostics import FormatError, SourceText
from deshybrid.formats.builder import Builder, Word, mistake
from deshybrid.formats.document import Document
from deshybrid.formats.xml import Element, read_xml, truth
from deshybrid.model.problems import did_you_mean

_KINDS = ("CONTROLLABLE", "UNCONTROLLABLE", "PROPOSITION")
_PLAIN = ("Comment", "PointGeometry", "LabelGeometry", "SplineGeometry", "ColorGeometry", "ArrowGeometry")
_ACCEPTING = ":accepting"


def read_wmod(source: SourceText) -> Document:
    '''Return the document of a module with one automaton.

    Raises `FormatError`: DH1002 (not this form), DH1003 (unknown element or kind), DH1005 (unknown name), DH1006 (no
    initial node), DH1007 (declared twice), DH1009 (guards, variables, several automata), and those of XML.

    >>> text = """<Module Name="m"><EventDeclList><EventDecl Kind="CONTROLLABLE" Name="a"/></EventDeclList>
    ... <ComponentList><SimpleComponent Kind="PLANT" Name="P"><Graph>
    ... <NodeList><SimpleNode Initial="true" Name="S"/></NodeList>
    ... <EdgeList><Edge Source="S" Target="S"><LabelBlock><SimpleIdentifier Name="a"/></LabelBlock></Edge></EdgeList>
    ... </Graph></SimpleComponent></ComponentList></Module>"""
    >>> str(read_wmod(SourceText("m.wmod", text)).des.transitions[0])
    'S -a/a-> S'
    '''
    root = read_xml(source)
    if root.tag != "Module":
        raise mistake("DH1002", "a Supremica file is a `<Module>`", root.span)
    builder = Builder(source)
    known = _children(root, ("EventDeclList", "ComponentList"), builder)
    propositions = {name for part in known if part.tag == "EventDeclList" for name in _read_events(part, builder)}
    component = _component(root, [part for part in known if part.tag == "ComponentList"], builder)
    graphs = _children(component, ("Graph",), builder)
    if len(graphs) != 1:
        raise mistake("DH1002", "an automaton has one `<Graph>`", component.span)
    for part in _children(graphs[0], ("NodeList", "EdgeList", "LabelBlock"), builder):
        if part.tag == "NodeList":
            for node in _children(part, ("SimpleNode",), builder):
                _read_node(node, propositions, builder)
        elif part.tag == "EdgeList":
            for edge in _children(part, ("Edge",), builder):
                _read_edge(edge, builder)
        else:
            list(_identifiers(part, builder))  # events that are blocked everywhere: on no transition, but they exist
    return builder.document(component.required("Name").text)


def _children(element: Element, tags: tuple[str, ...], builder: Builder) -> list[Element]:
    """Return the children with those tags; geometry is passed over, everything else is refused."""
    kept = []
    for child in element.children:
        if child.tag in tags:
            kept.append(child)
        elif child.tag not in _PLAIN:
            message = f"`<{child.tag[:60]}>` in `<{element.tag}>`"
            builder.report("DH1009", message, child.span, "a discrete-event system has no such part")
    return kept


def _component(root: Element, lists: list[Element], builder: Builder) -> Element:
    """Return the only automaton, or raise everything that was found instead."""
    found = [component for part in lists for component in _children(part, ("SimpleComponent",), builder)]
    if len(found) > 1:
        names = ", ".join(f"`{component.attributes.get('Name', '')[:40]}`" for component in found[:10])
        helps = (f"save one of {names}, or their synchronous product, as a module of its own",)
        builder.report("DH1009", f"{len(found)} automata", found[1].span, "a second one begins here", *helps)
    if not found:
        builder.report("DH1002", "the module has no automaton", root.span)
    builder.problems.raise_all(FormatError)
    return found[0]


def _read_events(part: Element, builder: Builder) -> Iterator[str]:
    """Declare the events, and yield the names of propositions."""
    for event in _children(part, ("EventDecl",), builder):
        name, kind = event.required("Name"), event.required("Kind")
        _children(event, (), builder)
        if kind.text not in _KINDS:
            builder.report(
                "DH1003", f"unknown kind `{kind.text[:40]}`", kind.span, "", *did_you_mean(kind.text, _KINDS)
            )
        elif name.text in builder.events:
            builder.report("DH1007", f"event `{name.text[:100]}` is declared twice", name.span)
        elif kind.text == "PROPOSITION":
            yield name.text
        else:
            observable = truth(event, event.attributes.get("Observable", "true"))
            builder.declare_event(name, kind.text == "CONTROLLABLE", observable)


def _identifiers(block: Element, builder: Builder) -> Iterator[Word]:
    for part in _children(block, ("SimpleIdentifier",), builder):
        yield part.required("Name")


def _read_node(node: Element, propositions: set[str], builder: Builder) -> None:
    name = node.required("Name")
    builder.declare(name)
    if truth(node, node.attributes.get("Initial", "false")):
        builder.initial[name.text] = name
    for part in _children(node, ("EventList",), builder):
        for proposition in _identifiers(part, builder):
            if proposition.text not in propositions | {_ACCEPTING}:
                builder.unknown("proposition", proposition, propositions)
            elif proposition.text == _ACCEPTING:
                builder.marked[name.text] = name


def _read_edge(edge: Element, builder: Builder) -> None:
    for block in _children(edge, ("LabelBlock",), builder):
        for event in _identifiers(block, builder):
            if event.text not in builder.events:
                builder.unknown("event", event, builder.events)
                continue
            visible = builder.events[event.text][0].observable
            builder.arc(edge.required("Source"), event, edge.required("Target"), event.text if visible else None)


__all__ = ["read_wmod"]
