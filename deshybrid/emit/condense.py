"""The condensed picture of an automaton that is too big to be looked at state by state.

In: a `Picture` with any number of nodes.  Out: a `Picture` with one node per strongly connected component, which says
how many states it stands for and whether they are persistent; where there are still too many components, those of equal
depth and equal persistence share a node.  Nothing is hidden silently: the notes say what was merged.
Cost: linear in nodes and arcs.
"""

from dataclasses import dataclass

from deshybrid.des.cycles import strong_components
from deshybrid.des.worklist import Graph
from deshybrid.emit.picture import Arc, Link, Node, Picture, merge_links

MOST_NODES = 300
MOST_ARCS = 1500
_MOST_LAYERS = 40
_NAMES_IN_TITLE = 40


@dataclass(frozen=True, slots=True)
class _Group:
    """Node numbers that one node of the condensed picture stands for."""

    members: tuple[int, ...]
    is_component: bool


def fit_for_drawing(picture: Picture) -> Picture:
    """Return the picture itself where it has at most 300 nodes and 1500 arcs, else its condensed picture.

    >>> fit_for_drawing(Picture("empty", (), ())).title
    'empty'
    """
    small = len(picture.nodes) <= MOST_NODES and len(picture.arcs) <= MOST_ARCS
    return picture if small else condense(picture)


def condense(picture: Picture) -> Picture:
    """Return the picture of the strongly connected components.

    >>> nodes = tuple(Node(f"q{i}", (str(i),), str(i), True) for i in range(2))
    >>> arcs = (Arc("e0", 0, 1, ("a",), "a", "plain"), Arc("e1", 1, 0, ("b",), "b", "plain"))
    >>> condense(Picture("two", nodes, arcs)).nodes[0].lines
    ('2 states', 'persistent')
    """
    groups = _groups(picture)
    of = {member: i for i, group in enumerate(groups) for member in group.members}
    nodes = tuple(_group_node(picture, i, group) for i, group in enumerate(groups))
    initial = tuple(dict.fromkeys(of[i] for i in picture.initial))
    return Picture(picture.title, nodes, _arcs(picture, of), initial, (_note(picture, groups), *picture.notes))


def _groups(picture: Picture) -> list[_Group]:
    """Components in order of their first node; lumped by depth and persistence where there are too many."""
    components, depth = _components(picture)
    if len(components) <= MOST_NODES:
        return [_Group(tuple(members), True) for members in sorted(components)]
    deepest = max(depth) + 1
    lumps: dict[tuple[bool, int], list[int]] = {}
    for members, level in zip(components, depth, strict=True):
        layer = level * min(_MOST_LAYERS, deepest) // deepest
        lumps.setdefault((picture.nodes[members[0]].persistent, layer), []).extend(members)
    return [_Group(tuple(sorted(members)), False) for members in lumps.values()]


def _components(picture: Picture) -> tuple[list[list[int]], list[int]]:
    """The strongly connected components, and for each the length of the longest path to it between components."""
    size = len(picture.nodes)
    graph = Graph(tuple(range(size)), tuple((arc.source, None, arc.target) for arc in picture.arcs), (-1,) * size)
    components = strong_components(graph)[::-1]  # now every component comes before its successors
    of = {member: i for i, members in enumerate(components) for member in members}
    depth = [0] * len(components)
    for i, j in sorted((of[arc.source], of[arc.target]) for arc in picture.arcs):
        if i != j:
            depth[j] = max(depth[j], depth[i] + 1)
    return components, depth


def _group_node(picture: Picture, number: int, group: _Group) -> Node:
    nodes = [picture.nodes[i] for i in group.members]
    persistent = any(node.persistent for node in nodes)
    failing = sum(node.failing for node in nodes)
    if len(nodes) == 1:
        lines: tuple[str, ...] = nodes[0].lines
    else:
        lines = (f"{len(nodes)} states", "persistent" if persistent else "transient")
        lines += (f"{failing} break C2",) if failing else ()
    names = [node.full for node in nodes[:_NAMES_IN_TITLE]]
    if len(nodes) > _NAMES_IN_TITLE:
        names.append(f"+{len(nodes) - _NAMES_IN_TITLE} more")
    shape = nodes[0].shape if len(nodes) == 1 else "component"
    return Node(f"q{number}", lines, ", ".join(names), persistent, failing > 0, shape)


def _arcs(picture: Picture, of: dict[int, int]) -> tuple[Arc, ...]:
    """Arcs between different groups, counted; inside a group only the failing ones stay visible, as a loop."""
    counted: dict[tuple[int, int, bool], int] = {}
    for arc in picture.arcs:
        key = (of[arc.source], of[arc.target], arc.style == "failing")
        if key[0] != key[1] or key[2]:
            counted[key] = counted.get(key, 0) + 1
    links = []
    for (source, target, failing), count in counted.items():
        label = f"{count} {'arc' if count == 1 else 'arcs'}"
        links.append(Link(source, target, label, label, "failing" if failing else "plain"))
    return merge_links(links)


def _note(picture: Picture, groups: list[_Group]) -> str:
    what = "strongly connected component" if groups[0].is_component else "group of components of equal depth"
    return f"Condensed from {len(picture.nodes)} states: one node per {what}, {len(groups)} in all."
