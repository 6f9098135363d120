"""The definitions of the discrete half as they stand in the papers, by brute force on explicit sets: the oracle."""

from collections.abc import Iterable
from itertools import pairwise

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.witness import Step, Witness


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


def can_show(des: DES, run: tuple[Step, ...], word: tuple[str, ...], *, visible_end: bool = False) -> bool:
    """Whether the run can show exactly this word, by trying everything that its last transition may show."""
    if len(run) < 2:
        return not word and not visible_end
    arcs = [t for t in des.transitions if (t.source, t.event, t.target) == (run[-2].location, *run[-1])]
    last = {seen for t in arcs for seen in t.seen}
    silent = None in last and not visible_end and can_show(des, run[:-1], word)
    visible = word and any(str(seen) == word[-1] for seen in last if seen is not None)
    return silent or bool(visible and can_show(des, run[:-1], word[:-1]))


def proves(des: DES, witness: Witness) -> bool:
    """Whether a witness is what its documentation says, read sentence by sentence."""
    arcs = {(t.source, t.event, t.target) for t in des.transitions}
    (a, b), outputs = witness.repeated, witness.outputs
    if not witness.runs or len(witness.runs) != len(witness.cycles) or not 0 <= a <= b <= len(outputs):
        return False
    for run, (start, stop) in zip(witness.runs, witness.cycles, strict=True):
        if run[0].location not in des.initial or not 0 <= start < stop < len(run):
            return False
        if any((before.location, *step) not in arcs for before, step in pairwise(run)):
            return False
        if run[start].location != run[stop].location:
            return False
    if witness.condition == "C2":
        apart = len(witness.runs) == 2 and witness.runs[0][-1].location != witness.runs[1][-1].location
        each = zip(witness.runs, witness.cycles, strict=True)
        return apart and a < b and all(_shows_in_parts(des, run, cycle, witness, True) for run, cycle in each)
    first, (_, stop) = witness.runs[0], witness.cycles[0]
    silent = any(None in t.seen for t in des.transitions if (t.source, t.event, t.target) == (first[-2][1], *first[-1]))
    alone = first[-1].location == first[-2].location
    seconds = () if alone else (first[:-1],)
    shown = stop < len(first) - 1 and _shows_in_parts(des, first[:-1], witness.cycles[0], witness, False)
    return silent and witness.runs[1:] == seconds and shown


def _shows_in_parts(des: DES, run: tuple[Step, ...], cycle: tuple[int, int], witness: Witness, visible: bool) -> bool:
    """What is shown before the cycle, on it, and after it; where asked for, the last transition is visible."""
    (start, stop), (a, b), outputs = cycle, witness.repeated, witness.outputs
    last = len(run) - 1
    return (
        can_show(des, run[: start + 1], outputs[:a])
        and can_show(des, run[start : stop + 1], outputs[a:b], visible_end=visible and stop == last)
        and can_show(des, run[stop:], outputs[b:], visible_end=visible and stop < last)
    )
