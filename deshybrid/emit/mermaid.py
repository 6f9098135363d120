"""Mermaid text of a picture, for pages that draw it themselves (GitHub, GitLab, MyST).

In: a `Picture`.  Out: a `flowchart` with the meanings of the DOT drawing as classes and link styles.  Every character
of a name that could mean something to Mermaid, Markdown or HTML is written as a character code.  Cost: linear.
"""

import json

from deshybrid.emit.condense import fit_for_drawing
from deshybrid.emit.picture import Arc, ArcStyle, Node, Picture, printable

_CLASSES = (
    "  classDef persistent fill:#d6e8f7,stroke:#0072b2,color:#1f2933,stroke-width:2px",
    "  classDef transient fill:#ffffff,stroke:#7b8794,color:#52606d,stroke-dasharray:5 4",
    "  classDef c2 fill:#ffd9a0,stroke:#c8102e,color:#1f2933,stroke-width:3px",
    "  classDef start fill:#1f2933,stroke:#1f2933",
)
_LINKS: dict[ArcStyle, str] = {
    "folded": "stroke-dasharray:4 4",
    "signed": "stroke:#00755a,stroke-width:2.5px,color:#00755a",
    "silent": "stroke:#7b8794,stroke-dasharray:4 4,color:#52606d",
    "failing": "stroke:#c8102e,stroke-width:3px,stroke-dasharray:6 4,color:#c8102e",
}


def emit_mermaid(picture: Picture) -> str:
    """Return Mermaid text; above 300 nodes that of the condensed picture.

    >>> nodes = (Node("q0", ("1",), "1", True), Node("q1", ("2",), "2", False))
    >>> print(emit_mermaid(Picture("t", nodes, (Arc("e0", 0, 1, ("a",), "a", "plain"),))).splitlines()[-1])
      q0 -- "a" --> q1
    """
    drawn = fit_for_drawing(picture)
    lines = ["---", f"title: {json.dumps(picture.title, ensure_ascii=False)}", "---"]
    lines += [f"%% {note}" for note in drawn.notes]
    lines += ["flowchart LR", *(_CLASSES if drawn.nodes else ())]
    lines += [_node(node) for node in drawn.nodes]
    lines += [_arc(arc, drawn) for arc in drawn.arcs]
    for number in drawn.initial:
        node = drawn.nodes[number].id
        lines.append(f'  start_{node}((" ")):::start --> {node}')
    lines += [f"  linkStyle {i} {_LINKS[arc.style]}" for i, arc in enumerate(drawn.arcs) if arc.style in _LINKS]
    return "\n".join([*lines, ""])


def escape_mermaid(text: str) -> str:
    """Return `text` with everything but letters, digits and harmless signs as Mermaid character codes.

    >>> escape_mermaid('a"<b>')
    'a#34;#60;b#62;'
    """
    return "".join(char if char.isalnum() or char in " _,/" else f"#{ord(char)};" for char in printable(text))


def _node(node: Node) -> str:
    label = "<br/>".join(escape_mermaid(line) for line in node.lines)
    opening, closing = {"location": ("((", "))"), "set": ("(", ")"), "component": ("[[", "]]")}[node.shape]
    if node.failing:
        opening, closing = "{{", "}}"
    kind = "c2" if node.failing else "persistent" if node.persistent else "transient"
    return f'  {node.id}{opening}"{label}"{closing}:::{kind}'


def _arc(arc: Arc, picture: Picture) -> str:
    label = "<br/>".join(escape_mermaid(line) for line in arc.lines)
    return f'  {picture.nodes[arc.source].id} -- "{label}" --> {picture.nodes[arc.target].id}'
