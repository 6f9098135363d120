"""The toolkit's notions as the textbooks define them, by brute force on explicit sets and bounded words: the oracle."""

from collections.abc import Callable, Iterable, Iterator
from itertools import product

from deshybrid.des.automaton import DES, Output, Transition
from tests.naive_des import after_silence, all_outputs, entered, reachable

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
