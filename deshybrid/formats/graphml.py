"""GraphML of an automaton: a node per location, an edge per transition and output.

Data of nodes: `initial`, `marked` (true, false).  Data of edges: `event`, and `output`, without which nothing is seen.
Where the file declares no `output` at all, every event shows its own name.  Nodes are named by their id.  Keys of other
names (colours, coordinates) are passed over.  Cost: linear.  Source: GraphML primer, graphdrawing.org.
"""

from deshybrid.diagnostics import SourceText
from deshybrid.formats.builder import Builder, Word, mistake
from deshybrid.formats.document import Document, Written, control_losses, names_of, refuse_labels, refuse_names
from deshybrid.formats.xml import Element, quoted, read_xml, truth

_KEYS = (("initial", "node", "boolean"), ("marked", "node", "boolean"), ("event", "edge", "string"))
_OUTPUT = ("output", "edge", "string")
_HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n<graphml xmlns="http://graphml.graphdrawing.org/xmlns">'


def read_graphml(source: SourceText) -> Document:
    '''Return the document of a GraphML text.

    Raises `FormatError`: DH1002 (not this form), DH1003 (unknown element), DH1005 (unknown node), DH1006 (no initial
    node), DH1007 (a node twice), DH1009 (undirected, or several graphs), and those of XML (DH1010, DH1011).

    >>> text = """<graphml><key id="i" for="node" attr.name="initial"/><key id="e" for="edge" attr.name="event"/>
    ... <graph edgedefault="directed"><node id="1"><data key="i">true</data></node>
    ... <edge source="1" target="1"><data key="e">a</data></edge></graph></graphml>"""
    >>> str(read_graphml(SourceText("a.graphml", text)).des.transitions[0])
    '1 -a/a-> 1'
    '''
    root = read_xml(source)
    graphs = list(root.all("graph"))
    if root.tag != "graphml" or not graphs:
        raise mistake("DH1002", "a GraphML file is `<graphml>` with a `<graph>` inside", root.span)
    for extra in graphs[1:]:
        raise mistake("DH1009", "a second graph", extra.span, "one automaton is read from a file")
    keys = _keys(root)
    shows_outputs = ("edge", "output") in keys.values()
    builder = Builder(source)
    for child in graphs[0].children:
        match child.tag:
            case "node":
                _read_node(child, keys, builder)
            case "edge":
                _read_edge(child, keys, builder, shows_outputs)
            case "data" | "desc":
                pass
            case _:
                builder.report("DH1003", f"unknown element `<{child.tag[:40]}>`", child.span)
    if graphs[0].attributes.get("edgedefault") == "undirected":
        builder.report("DH1009", "an undirected graph", graphs[0].span, "transitions have a direction")
    return builder.document(graphs[0].attributes.get("id", ""))


def _keys(root: Element) -> dict[str, tuple[str, str]]:
    """Return what each key is for and means: (`node` or `edge`, name)."""
    keys: dict[str, tuple[str, str]] = {}
    for key in root.all("key"):
        name = key.required("id")
        if name.text in keys:
            raise mistake("DH1007", f"key `{name.text[:40]}` is declared twice", name.span)
        keys[name.text] = (key.attributes.get("for", "all"), key.attributes.get("attr.name", name.text))
    return keys


def _data(element: Element, keys: dict[str, tuple[str, str]], builder: Builder) -> dict[str, str]:
    """Return the data of a node or edge by name."""
    found: dict[str, str] = {}
    for part in element.all("data"):
        key = part.required("key")
        if key.text not in keys:
            builder.report("DH1005", f"unknown key `{key.text[:40]}`", key.span)
            continue
        domain, name = keys[key.text]
        if domain in (element.tag, "all"):
            if name in found:
                builder.report("DH1007", f"`{name[:40]}` is given twice", key.span)
            found[name] = part.text
    return found


def _read_node(node: Element, keys: dict[str, tuple[str, str]], builder: Builder) -> None:
    name, data = node.required("id"), _data(node, keys, builder)
    builder.declare(name)
    if truth(node, data.get("initial", "false")):
        builder.initial[name.text] = name
    if truth(node, data.get("marked", "false")):
        builder.marked[name.text] = name
    for nested in node.all("graph"):
        builder.report("DH1009", "a graph inside a node", nested.span, "a location has no parts")


def _read_edge(edge: Element, keys: dict[str, tuple[str, str]], builder: Builder, shows_outputs: bool) -> None:
    data = _data(edge, keys, builder)
    if edge.attributes.get("directed") == "false":
        builder.report("DH1009", "an undirected edge", edge.span, "transitions have a direction")
    if "event" not in data:
        builder.report("DH1002", "an edge needs the data `event`", edge.span)
        return
    output = data.get("output") if shows_outputs else data["event"]
    builder.arc(edge.required("source"), Word(data["event"], edge.span), edge.required("target"), output)


def write_graphml(document: Document) -> Written:
    """Return a document as GraphML.

    Raises `FormatError`: DH1012 (a name that no format holds), DH1013 (a signature).

    >>> from deshybrid.des.automaton import DES
    >>> write_graphml(Document(DES.from_transitions([("1", "a", "1", None)]))).text.splitlines()[-3]
    '<edge source="1" target="1"><data key="event">a</data></edge>'
    """
    des = document.des
    refuse_labels(des.transitions, "graphml")
    refuse_names([des.name, *names_of(des)], "graphml")
    lines = [_HEAD]
    for name, domain, kind in (*_KEYS, _OUTPUT):
        lines.append(f'<key id="{name}" for="{domain}" attr.name="{name}" attr.type="{kind}"/>')
    lines.append(f'<graph id={quoted(des.name)} edgedefault="directed">')
    initial, marked = set(des.initial), set(document.marked)
    for name in des.locations:
        data = _written("initial", "true") * (name in initial) + _written("marked", "true") * (name in marked)
        lines.append(f"<node id={quoted(name)}>{data}</node>")
    for t in des.transitions:
        for output in t.outputs:
            data = _written("event", t.event) + ("" if output is None else _written("output", output))
            lines.append(f"<edge source={quoted(t.source)} target={quoted(t.target)}>{data}</edge>")
    text = "\n".join([*lines, "</graph>", "</graphml>", ""])
    return Written(text, control_losses(document, "graphml"))


def _written(key: str, text: str) -> str:
    return f'<data key="{key}">{quoted(text)[1:-1]}</data>'


__all__ = ["read_graphml", "write_graphml"]
