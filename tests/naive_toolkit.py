"""The toolkit's notions as the textbooks define them, by brute force on explicit sets and bounded words: the oracle."""

from collections.abc import Callable, Hashable, Iterable, Iterator
from itertools import pairwise, product

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.twins import TwinWitness
from tests.naive_des import after_silence, all_outputs, entered, reachable, reachable_from_cycles

Names = frozenset[str]


def current(des: DES, locations: Iterable[str], output: Output) -> Names:
    """The closed estimate after one more output."""
    return after_silence(des, entered(des, locations, output))


def after_word(des: DES, start: Iterable[str], word: Iterable[Output]) -> Names:
    estimate = after_silence(des, start)
    for output in word:
        estimate = current(des, estimate, output)
    return estimate


def words(outputs: list[Output], longest: int) -> Iterator[tuple[Output, ...]]:
    """All words, shortest first."""
    for length in range(longest + 1):
        yield from product(outputs, repeat=length)


def closed_arcs(des: DES) -> set[tuple[Names, Output, Names]]:
    """The observer of closed estimates, as arcs between sets."""
    arcs: set[tuple[Names, Output, Names]] = set()
    waiting, known = [after_silence(des, des.initial)], {after_silence(des, des.initial)}
    while waiting:
        state = waiting.pop()
        for output in all_outputs(des):
            target = current(des, state, output)
            if target:
                arcs.add((state, output, target))
                if target not in known:
                    known.add(target)
                    waiting.append(target)
    return arcs


def trimmed(des: DES, marked: Iterable[str]) -> set[object]:
    arcs = [(t.source, t.target) for t in des.transitions]
    back = [(target, source) for source, target in arcs]
    return reachable(des.initial, arcs) & reachable(marked, back)


def first_difference(
    first: DES, second: DES, differ: Callable[[bool, bool], bool], marks: tuple[set[str], set[str]]
) -> int | None:
    """Length of a shortest word whose membership in the two languages differs as asked; both sides by subsets."""
    layer = {(after_silence(first, first.initial), after_silence(second, second.initial))}
    known, length = set(layer), 0
    outputs = list(dict.fromkeys(all_outputs(first) + all_outputs(second)))
    while layer:
        if any(differ(bool(one & marks[0]), bool(two & marks[1])) for one, two in layer):
            return length
        layer = {(current(first, a, o), current(second, b, o)) for a, b in layer for o in outputs} - known
        known |= layer
        length += 1
    return None


def fewest_states(des: DES, marked: set[str]) -> int:
    """Residual languages that accept something, told apart by table filling; one state where the language is empty."""
    arcs = closed_arcs(des)
    root = after_silence(des, des.initial)
    states = [*dict.fromkeys([root, *(target for _, _, target in arcs)]), frozenset[str]()]
    step = {(source, output): target for source, output, target in arcs}
    apart = {(p, q) for p in states for q in states if bool(p & marked) != bool(q & marked)}
    while (
        more := {
            (p, q)
            for p in states
            for q in states
            if any((step.get((p, o), states[-1]), step.get((q, o), states[-1])) in apart for o in all_outputs(des))
        }
        - apart
    ):
        apart |= more
    alive = [state for state in states if (state, states[-1]) in apart]
    return max(1, len({tuple((state, other) in apart for other in states) for state in alive}))


def joint_arcs(
    components: tuple[DES, ...], only_common: bool
) -> Iterator[tuple[tuple[str, ...], str, tuple[str, ...]]]:
    """All arcs of the full Cartesian product, reachable or not."""
    alphabets = [{t.event for t in component.transitions} for component in components]
    for event in dict.fromkeys(t.event for component in components for t in component.transitions):
        inside = [event in alphabet for alphabet in alphabets]
        if only_common and not all(inside):
            continue
        sides: list[list[tuple[str, str]]] = [
            [(t.source, t.target) for t in component.transitions if t.event == event]
            if here
            else [(location, location) for location in component.locations]
            for component, here in zip(components, inside, strict=True)
        ]
        for choice in product(*sides):
            yield tuple(source for source, _ in choice), event, tuple(target for _, target in choice)


def shows(des: DES, run: Iterable[tuple[str, str]], word: list[str]) -> bool:
    """Whether the run, as (event, location) steps from its start, can show exactly this word."""
    (_, here), *steps = run
    places = {0}
    for event, location in steps:
        arcs: list[Transition] = [
            t for t in des.transitions if (t.source, t.event, t.target) == (here, event, location)
        ]
        seen = {None if output is None else str(output) for t in arcs for output in t.seen}
        places = {p for p in places if None in seen} | {p + 1 for p in places if p < len(word) and word[p] in seen}
        here = location
    return len(word) in places


def distance(start: Iterable[Hashable], arcs: list[tuple[Hashable, Hashable]], goals: set[Hashable]) -> int | None:
    """The fewest arcs to one of the goals."""
    layer, known, length = set(start), set(), 0
    while layer:
        if layer & goals:
            return length
        known |= layer
        layer = {target for source, target in arcs if source in layer} - known
        length += 1
    return None


def shortest_run(des: DES, word: list[Output], starts: Iterable[str], ends: set[str]) -> int | None:
    """The fewest transitions that show a word between two sets: a walk over locations and places in the word."""
    arcs: list[tuple[Hashable, Hashable]] = [
        ((t.source, place), (t.target, place + (seen is not None)))
        for place in range(len(word) + 1)
        for t in des.transitions
        for seen in t.seen
        if seen is None or word[place : place + 1] == [seen]
    ]
    return distance([(start, 0) for start in starts], arcs, {(end, len(word)) for end in ends})


def lasting_path(nodes: Iterable[Hashable], arcs: Iterable[tuple[Hashable, Hashable]]) -> set[Hashable]:
    """Where a path of as many steps as there are nodes, or more, can end, if it stays within `nodes` all the time."""
    inside = set(nodes)
    arcs = [(source, target) for source, target in arcs if source in inside and target in inside]
    layer = set(inside)
    for _ in range(len(inside) + 1):
        layer = {target for source, target in arcs if source in layer}
    return layer


def detectable(des: DES) -> dict[str, bool]:
    """The four forms of detectability, read off the observer of closed estimates."""
    root = after_silence(des, des.initial)
    arcs = [(source, target) for source, _, target in closed_arcs(des)]
    states = {root, *(target for _, target in arcs)}
    single = {state for state in states if len(state) == 1}
    lasting = reachable_from_cycles([root], arcs)
    return {
        "strong": lasting <= set(single),
        "weak": bool(lasting_path(single, arcs)),
        "strong periodic": not lasting_path(states - single, arcs),
        "weak periodic": any(s in reachable([t for p, t in arcs if p == s], arcs) for s in single),
    }


def estimates_on_lasso(des: DES, before: list[str], around: list[str], after: list[str]) -> Iterator[list[Names]]:
    """Round after round until they repeat: the estimates from the start of the round on, then the one after `after`."""
    output = {str(o): o for o in all_outputs(des)}
    start = after_word(des, des.initial, [output[o] for o in before])
    known: set[Names] = set()
    while start not in known:
        known.add(start)
        estimates = [start]
        for o in around:
            estimates.append(current(des, estimates[-1], output[o]))
        start = estimates[-1]
        yield [*estimates, after_word(des, start, [output[o] for o in after])]


def twin_faults(des: DES, witness: TwinWitness) -> list[str]:
    """What is wrong with two runs that claim equal outputs, part by part, and parts that can be repeated."""
    arcs = {(t.source, t.event, t.target) for t in des.transitions}
    faults = []
    for run, (start, stop) in zip(witness.runs, witness.cycles, strict=True):
        if run[0].location not in des.initial:
            faults.append("start")
        if any((a.location, b.event, b.location) not in arcs for a, b in pairwise(run)):
            faults.append("arc")
        if run[start].location != run[stop].location:
            faults.append("cycle")
        first, last = witness.repeated
        parts = [(run[: start + 1], witness.outputs[:first]), (run[start : stop + 1], witness.outputs[first:last])]
        parts.append((run[stop:], witness.outputs[last:]))
        faults += ["outputs" for part, word in parts if not shows(des, part, list(word))]
    return faults


def sound_part(des: DES, faults: set[str]) -> DES:
    return DES(des.locations, tuple(t for t in des.transitions if t.event not in faults), des.initial)


def diagnosable(des: DES, faults: set[str]) -> bool:
    """By the definition: follow all runs beside the set of locations in which a run without a fault can be."""
    sound = sound_part(des, faults)
    arcs: list[tuple[Hashable, Hashable]] = []
    waiting = [(q, False, after_silence(sound, sound.initial)) for q in des.initial]
    known = set(waiting)
    while waiting:
        here, faulty, others = node = waiting.pop()
        for t in des.transitions:
            for seen in t.seen if t.source == here else ():
                left = others if seen is None else current(sound, others, seen)
                after = (t.target, faulty or t.event in faults, left)
                arcs.append((node, after))
                if after not in known:
                    known.add(after)
                    waiting.append(after)
    return not lasting_path([node for node in known if node[1] and node[2]], arcs)


def predictable(des: DES, faults: set[str]) -> bool:
    """By the definition, with the last moment before the fault, which is the best one to predict it."""
    sound = sound_part(des, faults)
    arcs: list[tuple[Hashable, Hashable]] = [(t.source, t.target) for t in sound.transitions]
    goes_on = {q for q in des.locations if can_go_on(q, arcs, len(des.locations))}
    threatened = {t.source for t in des.transitions if t.event in faults}
    estimates = {after_silence(sound, sound.initial), *(target for _, _, target in closed_arcs(sound))}
    return not any(estimate & threatened and estimate & goes_on for estimate in estimates)


def can_go_on(start: Hashable, arcs: list[tuple[Hashable, Hashable]], steps: int) -> bool:
    layer = {start}
    for _ in range(steps):
        layer = {target for source, target in arcs if source in layer}
    return bool(layer)


def shortest_betrayal(des: DES, secret: set[str], *, at_start: bool) -> int | None:
    """Length of a shortest word after which only secret locations are possible, now or as those it all began in."""
    layer = {tuple((q, after_silence(des, [q])) for q in des.initial)}
    known, length = set(layer), 0
    while layer:
        for runs in layer:
            now = {name for _, estimate in runs for name in estimate}
            start = {q for q, estimate in runs if estimate}
            if now and (start if at_start else now) <= secret:
                return length
        layer = {tuple((q, current(des, e, o)) for q, e in runs) for runs in layer for o in all_outputs(des)} - known
        known |= layer
        length += 1
    return None
