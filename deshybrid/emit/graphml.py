"""GraphML of a picture, for graph editors (yEd, Gephi, Cytoscape) and for networkx.

In: a `Picture`.  Out: GraphML text with the full names and what stands out as attributes: `label`, `persistent`,
`breaks_c2`, `initial` of nodes; `label`, `style` of arcs (`plain`, `folded`, `signed`, `silent`, `failing`).
Cost: linear.
"""

from deshybrid.emit.condense import fit_for_drawing
from deshybrid.emit.picture import Picture


def emit_graphml(picture: Picture) -> str:
    """Return GraphML text; above 300 nodes that of the condensed picture, whose `notes` say so.

    >>> from deshybrid.emit.picture import Node
    >>> '<data key="d2">1</data>' in emit_graphml(Picture("t", (Node("q0", ("1",), "1", True),), ()))
    True
    """
    import networkx

    drawn = fit_for_drawing(picture)
    graph: networkx.MultiDiGraph[str] = networkx.MultiDiGraph(title=drawn.title, notes=" ".join(drawn.notes))
    for number, node in enumerate(drawn.nodes):
        initial = number in drawn.initial or not drawn.initial
        graph.add_node(node.id, label=node.full, persistent=node.persistent, breaks_c2=node.failing, initial=initial)
    for arc in drawn.arcs:
        ends = drawn.nodes[arc.source].id, drawn.nodes[arc.target].id
        graph.add_edge(*ends, key=arc.id, label=arc.full, style=arc.style)
    return "\n".join(networkx.generate_graphml(graph)) + "\n"
