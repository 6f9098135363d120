"""What the rest of a model file may refer to: the parameters with their values, and the declared names.

In: the tree.  Out: `Scope`.  Names are gathered before anything is checked, so that a transition may stand before the
location it names; parameters are evaluated in order, each in terms of those before it.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

from deshybrid.diagnostics import Diagnostic, diagnostic
from deshybrid.model.arithmetic import RESERVED, Parameters
from deshybrid.model.kinds import Role
from deshybrid.model.problems import Problems
from deshybrid.model.scalars import number_of
from deshybrid.model.source import SourceModel
from deshybrid.model.tree import MappingNode, Node, ScalarNode, SequenceNode


@dataclass(frozen=True, slots=True, eq=False)
class Scope:
    """Parameters (None: its mistake was reported) and names by role, in order of declaration; the folder of the file.

    >>> from deshybrid.model.source import parse_source
    >>> source = parse_source("{parameters: {k: 2}, locations: {on: {output: [z]}}, output: [y]}")
    >>> scope = build_scope(source, Problems())
    >>> scope.parameters["k"], scope.names["location"], scope.names["output"]
    (2.0, ('on',), ('y', 'z'))
    """

    parameters: Parameters
    names: Mapping[Role, tuple[str, ...]]
    folder: Path | None
    known: Mapping[Role, Mapping[str, None]] = field(init=False, repr=False)  # the same names, quick to look up

    def __post_init__(self) -> None:
        object.__setattr__(self, "known", {role: dict.fromkeys(names) for role, names in self.names.items()})

    @property
    def has_state(self) -> bool:
        """True where the model declares a continuous state."""
        return bool(self.names["state"])


def build_scope(source: SourceModel, problems: Problems) -> Scope:
    """Return the scope of a model; reports mistakes in `parameters` (DH0113, DH0117, DH0121 to DH0123)."""
    tree = source.tree
    bodies = _bodies(tree)
    inputs, outputs = (_union(body.get(kind) for body in bodies) for kind in ("input", "output"))
    names: dict[Role, tuple[str, ...]] = {
        "location": _names(tree.get("locations")),
        "state": _names(tree.get("state")),
        "input": inputs,
        "output": outputs,
        "channel": (*outputs, *inputs),
        "disturbance": _disturbances(tree, bodies),
        "event": _events(tree.get("transitions")),
        "command": _names(tree.get("commands")),
        "parameter": _names(tree.get("parameters")),
    }
    return Scope(_parameters(tree.get("parameters"), problems), names, source.folder)


def _bodies(tree: MappingNode) -> list[MappingNode]:
    """The mappings in which inputs and outputs are declared: the file itself, the defaults, the locations."""
    locations = tree.get("locations")
    nodes: list[Node | None] = [tree, tree.get("defaults")]
    if isinstance(locations, MappingNode):
        nodes += [entry.value for entry in locations.entries.values()]
    return [node for node in nodes if isinstance(node, MappingNode)]


def _names(node: Node | None) -> tuple[str, ...]:
    match node:
        case SequenceNode():
            return tuple(dict.fromkeys(item.text for item in node.items if isinstance(item, ScalarNode)))
        case MappingNode():
            return tuple(node.entries)
        case _:
            return ()


def _disturbances(tree: MappingNode, bodies: list[MappingNode]) -> tuple[str, ...]:
    """The declared names; without E anywhere, none (`w`) or a single one stands for one disturbance per state.

    That is the disturbance of Balluchi et al. (2012), (12), which enters every state.
    """
    states, declared = _names(tree.get("state")), tree.get("disturbance")
    names = ("w",) if declared is None else _names(declared)
    if len(names) != 1 or any(body.get("E") is not None for body in bodies):
        return () if declared is None else names
    return names if len(states) == 1 and declared is not None else tuple(f"{names[0]}_{name}" for name in states)


def _union(nodes: Iterable[Node | None]) -> tuple[str, ...]:
    return tuple(dict.fromkeys(name for node in nodes for name in _names(node)))


def _events(node: Node | None) -> tuple[str, ...]:
    rows = node.items if isinstance(node, SequenceNode) else ()
    events = [row.get("event") for row in rows if isinstance(row, MappingNode)]
    return tuple(dict.fromkeys(event.text for event in events if isinstance(event, ScalarNode)))


def _parameters(node: Node | None, problems: Problems) -> Parameters:
    if not isinstance(node, MappingNode):
        return {}  # whether it should be a mapping is checked with all other keys
    values: dict[str, float | None] = {}
    for name, entry in node.entries.items():
        if not name.isidentifier() or name in RESERVED:
            reason = "has a meaning of its own" if name in RESERVED else "is not a word of letters, digits and `_`"
            label = "a parameter's name stands in expressions"
            problems.add(diagnostic("DH0117", f"`{name}` {reason}", entry.key.span, label))
        if isinstance(entry.value, ScalarNode) and not entry.value.is_null:
            values[name] = _value(name, entry.value, values, node, problems)
        else:
            label = "expected a number or an expression"
            problems.add(diagnostic("DH0113", f"parameter `{name}` is not a number", entry.value.span, label))
            values[name] = None
    return values


def _value(
    name: str, value: ScalarNode, before: Parameters, parameters: MappingNode, problems: Problems
) -> float | None:
    found = Problems()
    number = number_of(value, before, found)
    for problem in found.found:
        problems.add(_with_order(problem, name, parameters))
    return number


def _with_order(problem: Diagnostic, name: str, parameters: MappingNode) -> Diagnostic:
    """An unknown name that is a later parameter (or the parameter itself) gets the better advice."""
    later = problem.message.removeprefix("unknown name `").removesuffix("`")
    if problem.code != "DH0122" or later not in parameters.entries or problem.span is None:
        return problem
    context = ((parameters.entries[later].key.span, "defined here"),) if later != name else ()
    helps = (f"define `{later}` before `{name}`",) if later != name else ("a parameter cannot use itself",)
    return diagnostic("DH0122", problem.message, problem.span, "used here", context=context, helps=helps)


__all__ = ["Scope", "build_scope"]
