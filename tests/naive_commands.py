"""Known commands by their definition: who observes sees the commands all the time, and outputs when they are shown.

A run moves in two ways: the controller sets its commands as it likes, or a transition is taken that they permit.  Two
runs look alike where the same commands and outputs, in the same order, are possible in both.
"""

from itertools import product

from deshybrid.model.system import HybridSystem, HybridTransition

Values = dict[str, str]
Pair = tuple[str, str]


def permitted(system: HybridSystem, location: str, values: Values) -> list[HybridTransition]:
    """The transitions out of a location that the commands permit."""
    leaving = [t for t in system.transitions if t.source == location]
    return [t for t in leaving if all(values[name] in wanted for name, wanted in t.when.items())]


def settings(system: HybridSystem) -> list[Values]:
    """All that the commands may be set to."""
    names = [command.name for command in system.commands]
    return [dict(zip(names, choice, strict=True)) for choice in product(*(c.values for c in system.commands))]


def observable(system: HybridSystem) -> bool:
    """Is there a K such that after K transitions of a run the location is known, whatever the controller does?

    Run 1 is counted, run 2 is any other one that looks like it; between two transitions the commands may change to
    anything, so each move is tried under every setting.  As in the definition without commands, a silent self-loop of a
    location that lasts counts as a failure.
    """
    steps = len(system.locations) ** 2 + 1
    layer = {(p, q) for p in system.initial for q in system.initial}
    for _ in range(steps):
        layer = _counted(system, _waited(system, layer))
    seen = set(layer)
    while new := _counted(system, _waited(system, seen)) - seen:
        seen |= new
    seen = _waited(system, seen)
    loops = {p for p, _ in seen if any(t.target == p and None in t.outputs for t in _leaving(system, p))}
    return not loops and all(p == q for p, q in seen)


def _leaving(system: HybridSystem, location: str) -> list[HybridTransition]:
    return [t for values in settings(system) for t in permitted(system, location, values)]


def _counted(system: HybridSystem, pairs: set[Pair]) -> set[Pair]:
    """Run 1 takes a transition; run 2 shows the same under the same commands, or waits where nothing is shown."""
    after = set()
    for (p, q), values in product(pairs, settings(system)):
        for first in permitted(system, p, values):
            after |= {(first.target, q)} if None in first.outputs else set()
            shown = set(first.outputs) - {None}
            after |= {(first.target, t.target) for t in permitted(system, q, values) if shown & set(t.outputs)}
    return after


def _waited(system: HybridSystem, pairs: set[Pair]) -> set[Pair]:
    """Run 2 takes any number of transitions that show nothing."""
    found = set(pairs)
    while True:
        moved = {
            (p, t.target)
            for (p, q), values in product(found, settings(system))
            for t in permitted(system, q, values)
            if None in t.outputs
        }
        if moved <= found:
            return found
        found |= moved


def entered(system: HybridSystem, locations: set[str], output: str, values: Values) -> set[str]:
    """What may have been entered with an output under these commands, after silence under any."""
    ready = {q for _, q in _waited(system, {(p, p) for p in locations})}
    return {t.target for q in ready for t in permitted(system, q, values) if output in t.outputs}
