"""The definitions of the discrete half as they stand in the papers, by brute force on explicit sets: the oracle."""

from collections.abc import Iterable

from deshybrid.des.automaton import DES, Output, Transition


def after_silence(des: DES, locations: Iterable[str]) -> frozenset[str]:
    """Everything that silent transitions lead to, the start included."""
    closed = set(locations)
    while new := {t.target for t in des.transitions if t.source in closed and None in t.seen} - closed:
        closed |= new
    return frozenset(closed)


def entered(des: DES, locations: Iterable[str], output: Output) -> frozenset[str]:
    """The locations that may be entered while `output` is shown, after any number of silent transitions."""
    ready = after_silence(des, locations)
    return frozenset(t.target for t in des.transitions if t.source in ready and output in t.seen)


def all_outputs(des: DES) -> list[Output]:
    return list(dict.fromkeys(seen for t in des.transitions for seen in t.seen if seen is not None))


def observer_arcs(des: DES) -> set[tuple[frozenset[str], Output, frozenset[str]]]:
    """D_O as a set of arcs between sets of locations, from the initial set."""
    arcs: set[tuple[frozenset[str], Output, frozenset[str]]] = set()
    waiting, known = [frozenset(des.initial)], {frozenset(des.initial)}
    while waiting:
        state = waiting.pop()
        for output in all_outputs(des):
            target = entered(des, state, output)
            if target:
                arcs.add((state, output, target))
                if target not in known:
                    known.add(target)
                    waiting.append(target)
    return arcs


def reachable(start: Iterable[object], arcs: Iterable[tuple[object, object]]) -> set[object]:
    """What any number of arcs leads to, the start included."""
    arcs = list(arcs)
    found = set(start)
    while new := {target for source, target in arcs if source in found} - found:
        found |= new
    return found


def reachable_from_cycles(start: Iterable[object], arcs: Iterable[tuple[object, object]]) -> set[object]:
    """ "May be visited after an arbitrarily long sequence": after exactly as many steps as there are nodes, or more."""
    arcs = list(arcs)
    layer = set(start)
    for _ in range(len({node for arc in arcs for node in arc}) + 1):
        layer = {target for source, target in arcs if source in layer}
    return reachable(layer, arcs)


def persistent(des: DES) -> set[object]:
    return reachable_from_cycles(des.initial, [(t.source, t.target) for t in des.transitions])


def c1_failures(des: DES) -> list[Transition]:
    alive_in = persistent(des)
    return [t for t in des.transitions if t.source in alive_in and None in t.seen]


def c2_failures(des: DES) -> dict[str, set[frozenset[str]]]:
    """Persistent locations for which {q} is not the only persistent state of D_O with q: the others by location."""
    arcs = [(source, target) for source, _, target in observer_arcs(des)]
    lasting = reachable_from_cycles([frozenset(des.initial)], arcs)
    failures = {}
    for location in sorted(str(name) for name in persistent(des)):
        containing = {state for state in lasting if isinstance(state, frozenset) and location in state}
        if containing != {frozenset([location])}:
            failures[location] = containing - {frozenset([location])}
    return failures


def observable_by_runs(des: DES) -> bool:
    """Definition 3: is there a K such that after every run of at least K transitions the location is determined?

    Two runs with equal outputs are followed together, step by step; run 1 is counted.  Configurations are (location of
    run 1, location of run 2).  After |Q|² steps of run 1 a configuration has repeated, so "for some K" can be read off:
    it fails exactly where two different locations are still possible after that many steps.  The definition speaks of
    locations only; the theorem also refuses a silent self-loop, which changes none, so that is asked for here as well.
    """
    if any(t.source == t.target for t in c1_failures(des)):
        return False
    pairs = {(p, q) for p in des.initial for q in des.initial}
    layer = _silent_second(des, pairs)
    for _ in range(len(des.locations) ** 2 + 1):
        layer = _silent_second(des, _step_of_first(des, layer))
    seen = set(layer)
    while new := _silent_second(des, _step_of_first(des, seen)) - seen:
        seen |= new
    return all(p == q for p, q in seen)


def _step_of_first(des: DES, pairs: set[tuple[str, str]]) -> set[tuple[str, str]]:
    """One transition of run 1; run 2 shows the same output, or waits where run 1 is silent."""
    after = set()
    for p, q in pairs:
        for first in (t for t in des.transitions if t.source == p):
            if None in first.seen:
                after.add((first.target, q))
            for second in (t for t in des.transitions if t.source == q):
                if any(output is not None and output in second.seen for output in first.seen):
                    after.add((first.target, second.target))
    return after


def _silent_second(des: DES, pairs: set[tuple[str, str]]) -> set[tuple[str, str]]:
    return {(p, r) for p, q in pairs for r in after_silence(des, [q])}


def transient_bound(des: DES) -> int:
    """The fewest outputs after which every entry estimate is one location; only for observable systems."""
    layer, bound = {frozenset(des.initial)}, 0
    for outputs_seen in range(2 ** len(des.locations) + 2):
        if any(len(state) > 1 for state in layer):
            bound = outputs_seen + 1
        layer = {entered(des, state, output) for state in layer for output in all_outputs(des)} - {frozenset()}
    return bound
