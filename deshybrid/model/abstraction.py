"""Stage 2: from the hybrid system H to its discrete-event system D_H.

In: a `HybridSystem`.  Out: the `DES` with the same locations, events and outputs; what is continuous is forgotten, and
transition number i of the one is transition number i of the other, so that a verdict leads back to the file.
The way back makes a model without continuous state of an automaton, so that its observer can be compiled.
Of a single command a transition lists the values that permit it; of several commands it lists combinations, such as
`lever=1|2,clutch=open`, in which values that no transition tells apart are one.
Cost: linear, times the combinations of commands.  Source: Balluchi et al. (2012), section 3.1.
"""

from collections.abc import Mapping
from itertools import product
from types import MappingProxyType

from deshybrid.des.automaton import DES, Transition
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.model.system import Command, HybridSystem, HybridTransition, Location

COMMAND = "command"  # what the values are called on which the transitions of an automaton depend


def abstract(system: HybridSystem) -> DES:
    """Return D_H of a hybrid system.

    >>> from deshybrid.model.load import load
    >>> str(abstract(load("models/balluchi2012/fig2.yaml")).transitions[3])
    '2 -d/ε-> 5'
    """
    combinations = _combinations(system)
    arcs = tuple(
        Transition(
            t.source, t.event, t.target, t.outputs, None, t.span, t.output_span, commands=_permitting(t, combinations)
        )
        for t in system.transitions
    )
    spans = {location.name: location.span for location in system.locations if location.span is not None}
    names = tuple(location.name for location in system.locations)
    return DES(names, arcs, system.initial, system.name, MappingProxyType(spans))


def _combinations(system: HybridSystem) -> tuple[tuple[str, dict[str, str]], ...]:
    """What the commands may be, as far as some transition depends on it: a text, and one value for each command."""
    found = []
    several = len(system.commands) > 1
    for command in system.commands:
        kinds: dict[tuple[bool, ...], list[str]] = {}
        for value in command.values:
            kind = tuple(value in t.when.get(command.name, (value,)) for t in system.transitions)
            kinds.setdefault(kind, []).append(value)
        if len(kinds) > 1:
            classes = kinds.values() if several else [[value] for value in command.values]
            found.append([(command.name, values) for values in classes])
    return tuple(
        (
            ",".join(f"{name}={'|'.join(values)}" if several else values[0] for name, values in choice),
            {name: values[0] for name, values in choice},
        )
        for choice in product(*found)
        if choice
    )


def _permitting(transition: HybridTransition, combinations: tuple[tuple[str, dict[str, str]], ...]) -> tuple[str, ...]:
    when = transition.when
    return tuple(text for text, values in combinations if all(v in when.get(c, (v,)) for c, v in values.items()))


def discrete_model(des: DES) -> HybridSystem:
    """Return the model without continuous state whose D_H is `des`; what transitions depend on is one command.

    Raises `UsageError` (DH0308) where a transition has a signature: a model gets its signatures from `recover`.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)], initial=["1"])
    >>> abstract(discrete_model(des)) == des
    True
    """
    signed = next((t for t in des.transitions if t.signature is not None), None)
    if signed is not None:
        fault = f"`{signed}` has a signature already, and a model gets its signatures from `recover`"
        raise UsageError(diagnostic("DH0308", fault, signed.span))
    values = tuple(dict.fromkeys(value for t in des.transitions for value in t.commands))
    arcs = tuple(
        HybridTransition(
            t.source, t.event, t.target, t.outputs, span=t.span, output_span=t.output_span, when=_needed(t.commands)
        )
        for t in des.transitions
    )
    locations = tuple(Location(name, span=des.location_spans.get(name)) for name in des.locations)
    commands = (Command(COMMAND, values),) if values else ()
    return HybridSystem(des.name, locations, arcs, des.initial, commands=commands)


def _needed(values: tuple[str, ...]) -> Mapping[str, tuple[str, ...]]:
    return MappingProxyType({COMMAND: values} if values else {})


__all__ = ["COMMAND", "abstract", "discrete_model"]
