"""A picture of an automaton as a value: what is drawn, before it is known in which format.

In: an `ObservabilityReport`.  Out: a `Picture` of D_H, of D'_H or of D_O with nodes, merged arcs and what stands out:
persistent and transient states, C1-failing transitions, C2-failing states, silent and signed transitions.  The DOT,
Mermaid and GraphML printers read this value and decide nothing about meaning.

Idea: transitions between the same two nodes are one arc when they stand out in the same way, so a failing transition is
never hidden among harmless ones.  Cost: linear in states and transitions.
Source: Balluchi et al. (2012), sections 3.1 and 4.1, figures 2, 3, 8 and 9.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, TypeAlias, TypeVar

from deshybrid.des.automaton import DES, Output, Transition

if TYPE_CHECKING:
    from deshybrid.des.observability import ObservabilityReport
    from deshybrid.des.observer import LocationObserver

Key = TypeVar("Key")
ArcStyle: TypeAlias = Literal["plain", "folded", "signed", "silent", "failing"]
NodeShape: TypeAlias = Literal["location", "set", "component"]

LONGEST_NAME = 32
_MOST_LINES = 5
_MOST_MEMBERS = 12
_LINE_WIDTH = 22


@dataclass(frozen=True, slots=True)
class Node:
    """One state: `lines` are written into it, `full` is its whole name; `failing` means that it breaks C2."""

    id: str
    lines: tuple[str, ...]
    full: str
    persistent: bool
    failing: bool = False
    shape: NodeShape = "location"


@dataclass(frozen=True, slots=True)
class Arc:
    """All transitions from node number `source` to node number `target` that stand out in the same way."""

    id: str
    source: int
    target: int
    lines: tuple[str, ...]
    full: str
    style: ArcStyle


@dataclass(frozen=True, slots=True)
class Picture:
    """Nodes and arcs in order of declaration; `initial` numbers the nodes with a start arrow (none: all may start)."""

    title: str
    nodes: tuple[Node, ...]
    arcs: tuple[Arc, ...]
    initial: tuple[int, ...] = ()
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class Link:
    """One transition before merging: a label, its long form, and how it stands out."""

    source: int
    target: int
    label: str
    full: str
    style: ArcStyle


def printable(text: str, limit: int | None = None) -> str:
    """Return `text` with every unprintable character replaced, cut to `limit` characters.

    >>> printable("a\\nb"), printable("long name", 5)
    ('a\\ufffdb', 'long…')
    """
    clean = "".join(char if char.isprintable() else "\N{REPLACEMENT CHARACTER}" for char in text)
    return clean if limit is None or len(clean) <= limit else clean[: limit - 1] + "…"


def des_picture(report: "ObservabilityReport", *, title: str) -> Picture:
    """Return D_H: locations, transitions `event / output`, C1-failing exits and C2-failing locations."""
    des = report.des
    number = {name: i for i, name in enumerate(des.locations)}
    failing = frozenset(report.c1_failures)
    links = [
        Link(number[t.source], number[t.target], _transition_label(t, des), str(t), _transition_style(t, failing))
        for t in des.transitions
    ]
    arcs = merge_links(links, width=0)
    return _assemble(title, _location_nodes(report), arcs, _initial_numbers(des.initial, des.locations))


def dprime_picture(report: "ObservabilityReport", *, title: str) -> Picture:
    """Return D'_H: locations, and edges that carry outputs only; an edge that hides invisible transitions is dashed."""
    des = report.des
    number = {name: i for i, name in enumerate(des.locations)}
    edges = [((edge.source, edge.target, edge.path), edge.output) for edge in report.automaton.edges]
    links = [_edge_link(edge, output, des.transitions, number) for edge, output in _under_commands(edges, des)]
    return _assemble(title, _location_nodes(report), merge_links(links), _initial_numbers(des.initial, des.locations))


def observer_picture(report: "ObservabilityReport", *, title: str) -> Picture:
    """Return D_O: its states are entry estimates; singletons are round, sets are boxes.

    ValueError where the report was made by the pair method and so holds no observer.
    """
    if report.observer is None:
        raise ValueError("the report holds no observer")
    return location_observer_picture(report.observer, title=title)


def location_observer_picture(observer: "LocationObserver", *, title: str) -> Picture:
    """Return D_O alone: C2 fails in its persistent states of several locations, which are all persistent themselves."""
    persistent = frozenset(observer.persistent)
    nodes = [
        _set_node(i, state, observer.automaton.des.locations, i in persistent, i in persistent and len(state) > 1)
        for i, state in enumerate(observer.states)
    ]
    arcs = _under_commands((((i, j), out) for i, out, j in observer.transitions), observer.automaton.des)
    links = [Link(i, j, _output_label(out), str(out), _output_style(out)) for (i, j), out in arcs]
    return _assemble(title, nodes, merge_links(links), (observer.initial,))


def _location_nodes(report: "ObservabilityReport") -> list[Node]:
    persistent = frozenset(report.persistent)
    failing = frozenset(failure.location for failure in report.c2_failures)
    return [
        Node(f"q{i}", (printable(name, LONGEST_NAME),), printable(name), name in persistent, name in failing)
        for i, name in enumerate(report.des.locations)
    ]


def _set_node(number: int, state: tuple[str, ...], everything: tuple[str, ...], persistent: bool, bad: bool) -> Node:
    """A singleton shows the location's name, a set its members in braces, a big set only the first of them."""
    full = "{" + ", ".join(printable(name) for name in state) + "}"
    if len(state) == 1:
        return Node(f"q{number}", (printable(state[0], LONGEST_NAME),), full, persistent, bad)
    if len(state) == len(everything):
        return Node(f"q{number}", ("Q", f"(all {len(everything)} locations)"), full, persistent, bad, "set")
    members = [printable(name, LONGEST_NAME) for name in state[:_MOST_MEMBERS]]
    if len(state) > _MOST_MEMBERS:
        members.append(f"+{len(state) - _MOST_MEMBERS} more")
    rows = [", ".join(row) for row in _wrap(members, _LINE_WIDTH)]
    text = "{" + ",\n".join(rows) + "}"
    return Node(f"q{number}", tuple(text.split("\n")), full, persistent, bad, "set")


def _transition_label(transition: Transition, des: DES) -> str:
    shown = [output for _, output in _under_commands(((None, output) for output in transition.occurrences), des)]
    plain = "|".join("ε" if output.is_nothing else _output_label(output._replace(command=None)) for output in shown)
    command = f"@{printable(shown[0].command, LONGEST_NAME)}" if shown[0].command else ""
    return f"{printable(transition.event, LONGEST_NAME)} / {plain}{command}"


def _under_commands(arcs: Iterable[tuple[Key, Output]], des: DES) -> Iterator[tuple[Key, Output]]:
    """Join what is shown under several commands: `α@1|2`, or `α` where any command permits it."""
    known = {command for transition in des.transitions for command in transition.commands}
    groups: dict[tuple[Key, Output], dict[str, None]] = {}
    for key, output in arcs:
        group = groups.setdefault((key, output._replace(command=None)), {})
        group |= {} if output.command is None else {output.command: None}
    for (key, output), commands in groups.items():
        yield key, output._replace(command="|".join(commands) if 0 < len(commands) < len(known) else None)


def _output_label(output: Output) -> str:
    """Return γ, s, or the pair (γ, s) that the observer of a complementary DES sees; and the command, if known."""
    parts = [printable(part, LONGEST_NAME) for part in output[:2] if part is not None]
    label = parts[0] if len(parts) == 1 else "(" + ", ".join(parts) + ")"
    return label if output.command is None else f"{label}@{printable(output.command, LONGEST_NAME)}"


def _transition_style(transition: Transition, failing: frozenset[Transition]) -> ArcStyle:
    if transition in failing:
        return "failing"
    if not transition.is_observable:
        return "silent"
    return "plain" if transition.signature is None else "signed"


def _output_style(output: Output) -> ArcStyle:
    return "plain" if output.signature is None else "signed"


def _edge_link(
    edge: tuple[str, str, tuple[int, ...]], output: Output, transitions: tuple[Transition, ...], number: dict[str, int]
) -> Link:
    """An edge of D'_H (source, target, path); its long form lists the transitions that are folded into it."""
    source, target, path = edge
    style: ArcStyle = "folded" if len(path) > 1 else _output_style(output)
    full = " then ".join(str(transitions[i]) for i in path)
    return Link(number[source], number[target], _output_label(output), full, style)


def _initial_numbers(initial: tuple[str, ...], locations: tuple[str, ...]) -> tuple[int, ...]:
    """No start arrows where every location may be the first: thirty arrows would say nothing."""
    chosen = frozenset(initial)
    return () if len(chosen) == len(locations) else tuple(i for i, q in enumerate(locations) if q in chosen)


def _assemble(title: str, nodes: list[Node], arcs: tuple[Arc, ...], initial: tuple[int, ...]) -> Picture:
    notes = () if initial else ("Every location may be the first one.",)
    return Picture(printable(title), tuple(nodes), arcs, initial, notes)


def merge_links(links: Iterable[Link], *, width: int = _LINE_WIDTH) -> tuple[Arc, ...]:
    """Join the links with equal ends and equal style into one arc each, in order of first appearance.

    Labels share a line of up to `width` characters; with width 0 each has its own.

    >>> merge_links([Link(0, 1, "a", "a", "plain"), Link(0, 1, "b", "b", "plain")])[0].lines
    ('a, b',)
    """
    groups: dict[tuple[int, int, ArcStyle], list[Link]] = {}
    for link in links:
        groups.setdefault((link.source, link.target, link.style), []).append(link)
    return tuple(
        Arc(f"e{i}", source, target, _arc_lines(group, width), _arc_full(group), style)
        for i, ((source, target, style), group) in enumerate(groups.items())
    )


def _arc_full(group: list[Link]) -> str:
    return printable("; ".join(dict.fromkeys(link.full for link in group)))


def _arc_lines(group: list[Link], width: int) -> tuple[str, ...]:
    """The different labels of a group, the first few lines of them, and how many are left out."""
    labels = list(dict.fromkeys(link.label for link in group))
    rows = _wrap(labels, width)
    if len(rows) <= _MOST_LINES:
        return tuple(", ".join(row) for row in rows)
    kept = rows[: _MOST_LINES - 1]
    hidden = len(labels) - sum(len(row) for row in kept)
    return (*(", ".join(row) for row in kept), f"+{hidden} more")


def _wrap(texts: Iterable[str], width: int) -> list[list[str]]:
    """Fill rows of about `width` characters with the texts."""
    rows: list[list[str]] = []
    for text in texts:
        if rows and sum(len(part) + 2 for part in rows[-1]) + len(text) <= width:
            rows[-1].append(text)
        else:
            rows.append([text])
    return rows
