"""DOT text of an automaton: a small printer of our own, so that no name can break out of its quotes.

In: an `ObservabilityReport` (of a DES or of its complementary DES).  Out: DOT text for D_H, D'_H or D_O.
Colours are those of Okabe and Ito; each meaning has a shape or a line style beside its colour, so that the drawing
reads in black and white: persistent = filled with a solid border, transient = dashed grey border, breaks C2 = octagon,
breaks C1 = bold dashed arc with an open tip, signature = bold arc.  Nodes are `q0`, `q1` …, arcs `e0`, `e1`
…, as ids that survive into the SVG.  Cost: linear.  Source: Balluchi et al. (2012), figures 2, 3, 8 and 9.
"""

from typing import TYPE_CHECKING

from deshybrid.emit.condense import fit_for_drawing
from deshybrid.emit.picture import (
    Arc,
    ArcStyle,
    Node,
    Picture,
    des_picture,
    dprime_picture,
    observer_picture,
    printable,
)

if TYPE_CHECKING:
    from deshybrid.des.observability import ObservabilityReport

_FONT = "Helvetica,Arial,sans-serif"
_INK, _GREY, _BLUE, _RED, _GREEN = "#1f2933", "#7b8794", "#0072b2", "#c8102e", "#00755a"
_PALE_BLUE, _PALE_ORANGE = "#d6e8f7", "#ffd9a0"

_HUB_ARCS, _STAR_ARCS, _MANY_ARCS, _CROWD_ARCS = 6, 10, 30, 120

_ARC_STYLES: dict[ArcStyle, dict[str, str]] = {
    "plain": {},
    "folded": {"style": "dashed"},
    "signed": {"color": _GREEN, "fontcolor": _GREEN, "penwidth": "1.8"},
    "silent": {"color": _GREY, "fontcolor": _GREY, "style": "dashed"},
    "failing": {"color": _RED, "fontcolor": _RED, "penwidth": "2.4", "style": "dashed", "arrowhead": "empty"},
}
_ARC_MEANING: dict[ArcStyle, str] = {
    "folded": "passes through unseen transitions",
    "signed": "shows a signature s",
    "silent": "unseen (ε), harmless: its source is transient",
    "failing": "breaks C1: leaves a persistent location unseen (ε)",
}
_ARC_SAMPLE: dict[ArcStyle, str] = {"folded": "- - ▸", "signed": "━━▸", "silent": "- - ▸", "failing": "━ ━ ▷"}


def des_dot(report: "ObservabilityReport", *, title: str) -> str:
    """Return DOT text of D_H: locations, `event / output` on the arcs, C1 and C2 failures marked."""
    return picture_dot(des_picture(report, title=title))


def dprime_dot(report: "ObservabilityReport", *, title: str) -> str:
    """Return DOT text of D'_H, where every edge shows an output."""
    return picture_dot(dprime_picture(report, title=title))


def observer_dot(report: "ObservabilityReport", *, title: str) -> str:
    """Return DOT text of the location observer D_O; ValueError where the report holds none."""
    return picture_dot(observer_picture(report, title=title))


def picture_dot(picture: Picture) -> str:
    """Return DOT text of a picture; above 300 nodes the condensed picture is drawn and says so.

    >>> print(picture_dot(Picture("t", (), ())).splitlines()[0])
    digraph {
    """
    drawn = fit_for_drawing(picture)
    lines = ["digraph {", '  charset="utf-8"', *_defaults(drawn)]
    lines += [f"  {node.id} [{_attributes(_node_attributes(node))}]" for node in _hubs_first(drawn)]
    lines += _start_arrows(drawn)
    for arc in drawn.arcs:
        ends = f"{drawn.nodes[arc.source].id} -> {drawn.nodes[arc.target].id}"
        lines.append(f"  {ends} [{_attributes(_arc_attributes(arc, drawn.nodes[arc.source]))}]")
    return "\n".join([*lines, "}", ""])


def escape(text: str) -> str:
    r"""Return `text` as it must stand between the quotes of a DOT string that Graphviz expands (`label`, `tooltip`).

    Backslashes would start an escape sequence and `&` an entity, so both are doubled or spelt out.

    >>> print(escape('a"b\\N&lt;'))
    a\"b\\N&amp;lt;
    """
    return printable(text).replace("\\", "\\\\").replace('"', '\\"').replace("&", "&amp;")


def escape_html(text: str) -> str:
    """Return `text` as it must stand in a Graphviz HTML-like label.

    >>> escape_html('<b> & "c"')
    '&lt;b&gt; &amp; &quot;c&quot;'
    """
    clean = printable(text).replace("&", "&amp;").replace("\\", "&#92;")
    return clean.replace("<", "&lt;").replace(">", "&gt;").replace('"', "&quot;")


def _defaults(picture: Picture) -> list[str]:
    """Attributes of the whole drawing: chains run from left to right, stars downwards, a crowd has no order.

    Many arcs make a wide drawing that is looked at in small: it is set closer, in larger letters.
    """
    star, many = _is_star(picture), len(picture.arcs) > _MANY_ARCS
    graph = {
        "id": "drawing",
        "rankdir": "TB" if star else "LR",
        "bgcolor": "white",
        "pad": "0.15",
        "nodesep": "0.18" if many and not star else "0.35",
        "ranksep": "1.3" if star else "0.3" if many else "0.55",
        "fontname": _FONT,
        "fontsize": "14" if many else "11",
        "fontcolor": _INK,
        "labelloc": "b",
    }
    if _is_crowded(picture):  # levels would take minutes, and nobody could follow the arcs
        graph |= {"layout": "sfdp", "overlap": "prism", "splines": "line", "K": "1.2"}
    node = {"fontname": _FONT, "fontsize": "16" if many else "13", "height": "0.5", "margin": "0.1,0.05"}
    edge = {"fontname": _FONT, "fontsize": "14" if many else "11", "fontcolor": _INK, "arrowsize": "0.75"}
    return [
        f"  graph [{_attributes(graph)}, label=<{_caption(picture)}>]",
        f"  node [{_attributes(node | {'color': _INK})}]",
        f"  edge [{_attributes(edge | {'color': _INK})}]",
    ]


def _attributes(values: dict[str, str]) -> str:
    """Attribute values are either constants of this module or already escaped."""
    return ", ".join(f'{key}="{value}"' for key, value in values.items())


def _node_attributes(node: Node) -> dict[str, str]:
    style = "filled" if node.persistent else "filled,dashed"
    shape = {"location": "ellipse", "set": "box", "component": "box3d"}[node.shape]
    attributes = {"id": node.id, "label": "\\n".join(escape(line) for line in node.lines)}
    attributes |= {"tooltip": escape(node.full), "class": "persistent" if node.persistent else "transient"}
    if node.failing:
        attributes |= {"shape": "octagon", "style": style, "fillcolor": _PALE_ORANGE, "color": _RED, "penwidth": "2.2"}
        attributes["class"] += " c2"
    elif node.persistent:
        attributes |= {"shape": shape, "style": _rounded(style, shape), "fillcolor": _PALE_BLUE}
        attributes |= {"color": _BLUE, "penwidth": "1.6"}
    else:
        attributes |= {"shape": shape, "style": _rounded(style, shape), "fillcolor": "white"}
        attributes |= {"color": _GREY, "fontcolor": "#52606d"}
    return attributes


def _rounded(style: str, shape: str) -> str:
    return f"{style},rounded" if shape == "box" else style


def _arc_attributes(arc: Arc, source: Node) -> dict[str, str]:
    """Arcs out of a transient node are thin: they are taken at most a few times."""
    label = "\\n".join(escape(f" {line} ") for line in arc.lines)
    attributes = {"id": arc.id, "label": label, "tooltip": escape(arc.full), "labeltooltip": escape(arc.full)}
    attributes |= {"class": arc.style} | _ARC_STYLES[arc.style]
    return attributes if source.persistent else attributes | {"penwidth": "0.7"}


def _degrees(picture: Picture) -> list[int]:
    degree = [0] * len(picture.nodes)
    for arc in picture.arcs:
        degree[arc.source] += 1
        degree[arc.target] += 1
    return degree


def _is_star(picture: Picture) -> bool:
    """One node meets at least half of the arcs: its spokes then stand side by side below it."""
    return max(_degrees(picture), default=0) >= max(_STAR_ARCS, len(picture.arcs) / 2)


def _is_crowded(picture: Picture) -> bool:
    """So many arcs between so few nodes that a layout in levels does not help."""
    return len(picture.arcs) > max(_CROWD_ARCS, 1.5 * len(picture.nodes))


def _hubs_first(picture: Picture) -> list[Node]:
    """Nodes in the order Graphviz meets them: it starts its levels at the first, and spokes belong on one level."""
    degree = _degrees(picture)
    busy = max(_HUB_ARCS, 2 * sum(degree) / max(1, len(degree)))
    numbers = sorted(range(len(degree)), key=lambda i: degree[i] < busy)
    return [picture.nodes[i] for i in numbers]


def _start_arrows(picture: Picture) -> list[str]:
    lines = []
    for number in picture.initial:
        node = picture.nodes[number].id
        lines.append(f'  start_{node} [id="start_{node}", shape="point", width="0.08", label="", tooltip="start"]')
        length = ', minlen="0"' if _is_star(picture) else ""
        lines.append(f'  start_{node} -> {node} [id="start_arrow_{node}", tooltip="start"{length}]')
    return lines


def _caption(picture: Picture) -> str:
    """Title, notes and a legend of what occurs in the drawing, as an HTML-like table of Graphviz."""
    rows = ['<TR><TD HEIGHT="6"></TD></TR>']
    rows += [f'<TR><TD COLSPAN="2" ALIGN="LEFT"><B>{escape_html(picture.title)}</B></TD></TR>']
    rows += [f'<TR><TD COLSPAN="2" ALIGN="LEFT">{escape_html(note)}</TD></TR>' for note in picture.notes]
    rows += [f'<TR>{sample}<TD ALIGN="LEFT">{meaning}</TD></TR>' for sample, meaning in _legend(picture)]
    return f'<TABLE BORDER="0" CELLBORDER="0" CELLSPACING="3" CELLPADDING="2">{"".join(rows)}</TABLE>'


def _legend(picture: Picture) -> list[tuple[str, str]]:
    """Only what occurs is explained."""
    entries = []
    if any(node.persistent and not node.failing for node in picture.nodes):
        entries.append((_cell(_BLUE, _PALE_BLUE, "solid"), "persistent: can be visited again and again"))
    if any(not node.persistent for node in picture.nodes):
        entries.append((_cell(_GREY, "white", "dashed"), "transient: left for good after a while"))
    if any(node.failing for node in picture.nodes):
        text = "octagon: persistent, and breaks C2: stays ambiguous"
        entries.append((_cell(_RED, _PALE_ORANGE, "solid"), text))
    present = {arc.style for arc in picture.arcs}
    for style, meaning in _ARC_MEANING.items():
        if style in present:
            colour = _ARC_STYLES[style].get("color", _INK)
            entries.append((f'<TD><FONT COLOR="{colour}">{_ARC_SAMPLE[style]}</FONT></TD>', meaning))
    return entries


def _cell(border: str, fill: str, style: str) -> str:
    return f'<TD BORDER="1" WIDTH="34" COLOR="{border}" BGCOLOR="{fill}" STYLE="{style}"></TD>'
