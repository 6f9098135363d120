"""What a plan and its constraints say of runs, checked on the system as it is written.

In: a `Plan`.  Out: what is wrong, one sentence each.  Idea: a constraint is right if its runs look the same under
everything that is on offer beside it: each single signature counts as a name of its own, which no plan can better, and
every other detector is there.  A plan is right if no silent transition leaves a persistent location and no two
locations look alike for ever, which the pairs of locations decide.
Cost: linear in the runs; |Q|² · branching² for the plan.  Source: Balluchi et al. (2012), Theorem 4.
"""

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise, product
from typing import NamedTuple, TypeAlias, TypeVar

from deshybrid.verify.plan_file import Arc, Claimed, Plan, Step

Seen: TypeAlias = tuple[str | None, frozenset[str | int], str | None]  # output, marks, command
Marks: TypeAlias = Mapping[int, frozenset[str | int]]
Node = TypeVar("Node")
_BARE: frozenset[str | int] = frozenset()


class Choice(NamedTuple):
    """A yes or no of a plan: the candidate's number, the transitions marked, and sets of generators that suffice."""

    offer: int
    transitions: tuple[int, ...]
    ways: tuple[frozenset[str], ...]


def choices(plan: Plan) -> tuple[Choice, ...]:
    """Return everything that a plan can choose."""
    there = {offer.generator for offer in plan.offers if offer.residual}
    leaving: dict[str, list[Arc]] = {}
    for arc in plan.arcs:
        leaving.setdefault(arc.source, []).append(arc)
    found = []
    for number, offer in enumerate(plan.offers):
        own = (frozenset((offer.generator,)),) if offer.residual else ()
        if offer.covering:
            found.append(Choice(number, offer.transitions, own))
            continue
        for taken in offer.transitions:
            source = plan.arcs[taken].source
            beside = {arc.target for arc in leaving[source] if arc.coincides(plan.arcs[taken])}
            others = frozenset(({source} | beside) - {offer.locations[0]})
            deniable = offer.negation and source != offer.locations[0] and others <= there
            ways = (*own, *((others,) if deniable else ()))
            found += [Choice(number, (taken,), ways)] if ways else []
    return tuple(found)


def offer_faults(plan: Plan) -> Iterator[str]:
    """Yield which candidates announce a transition that does not enter their locations."""
    for offer in plan.offers:
        if any(plan.arcs[number].target not in offer.locations for number in offer.transitions):
            yield f"candidate `{offer.name}` is on a transition that leads elsewhere"


def constraint_faults(plan: Plan, open_to: tuple[Choice, ...], claimed: Claimed) -> tuple[str, ...]:
    """Return why the runs of a constraint do not force it; nothing where they do."""
    wanted = {"C1": 1, "C2": 2}.get(claimed.condition)
    if wanted is None or len(claimed.runs) != wanted or len(claimed.cycles) != wanted:
        return ("it is neither a silent exit with one run nor a confusion of two",)
    both = zip(claimed.runs, claimed.cycles, strict=True)
    faults = tuple(fault for run, cycle in both for fault in _faults(plan, run, cycle))
    if faults:
        return faults
    marks = _beside(plan, open_to, claimed)
    return _c1_faults(claimed, marks) if wanted == 1 else _c2_faults(plan, claimed, marks)


def _faults(plan: Plan, run: tuple[Step, ...], cycle: tuple[int, int]) -> Iterator[str]:
    start, stop = cycle
    if not 0 <= start < stop <= len(run):
        yield "a run has no cycle"
        return
    arcs = [plan.arcs[number] for number, _, _ in run]
    if arcs[0].source not in plan.initial:
        yield "a run does not start in an initial location"
    if any(before.target != after.source for before, after in pairwise(arcs)):
        yield "a run does not hang together"
    if any(output not in arc.outputs for arc, (_, output, _) in zip(arcs, run, strict=True)):
        yield "a run shows what its transitions cannot show"
    if arcs[start].source != arcs[stop - 1].target:
        yield "a cycle does not lead back"


def _beside(plan: Plan, open_to: tuple[Choice, ...], claimed: Claimed) -> Marks:
    """Everything on offer but the constraint."""
    marks: dict[int, frozenset[str | int]] = {}
    for choice in open_to:
        offer = plan.offers[choice.offer]
        own: str | int = offer.name if offer.covering else choice.transitions[0]
        if own not in (claimed.detectors if offer.covering else claimed.transitions):
            for number in choice.transitions:
                marks[number] = marks.get(number, _BARE) | {own}
    return marks


def _c1_faults(claimed: Claimed, marks: Marks) -> tuple[str, ...]:
    (run,), ((_, stop),) = claimed.runs, claimed.cycles
    faults = [] if stop < len(run) else ["the silent step is no exit after the cycle"]
    last, output, _ = run[-1]
    return tuple(faults if output is None and not marks.get(last) else [*faults, "the last step shows something"])


def _c2_faults(plan: Plan, claimed: Claimed, marks: Marks) -> tuple[str, ...]:
    first, second = claimed.runs
    faults = []
    if plan.arcs[first[-1][0]].target == plan.arcs[second[-1][0]].target:
        faults.append("the runs end in the same location")
    one, other = (_parts(run, cycle) for run, cycle in zip(claimed.runs, claimed.cycles, strict=True))
    if [_word(steps, marks) for steps in one] != [_word(steps, marks) for steps in other]:
        faults.append("the runs do not show the same")
    shows = (step for step in (*first, *second) if step[1] is not None or marks.get(step[0]))
    if any(command not in plan.arcs[number].commands for number, _, command in shows):
        faults.append("a step shows something under a command that does not permit it")
    return tuple(faults)


def _parts(run: tuple[Step, ...], cycle: tuple[int, int]) -> tuple[tuple[Step, ...], ...]:
    start, stop = cycle
    return run[:start], run[start:stop], run[stop:]


def _word(steps: Iterable[Step], marks: Marks) -> list[Seen]:
    seen = ((output, marks.get(number, _BARE), command) for number, output, command in steps)
    return [shown for shown in seen if shown[:2] != (None, _BARE)]


def plan_faults(plan: Plan, open_to: tuple[Choice, ...]) -> tuple[str, ...]:
    """Return why the signatures of a plan cannot be emitted, or leave the location unknown; else nothing."""
    faults, marks = list[str](), dict[int, frozenset[str | int]]()
    generators = frozenset(plan.generators)
    for number, by, transitions in plan.instrumented:
        offer = plan.offers[number]
        own = [choice for choice in open_to if choice.offer == number]
        possible = {
            t for choice in own if _emitted(choice, by, offer.generator, generators) for t in choice.transitions
        }
        if not transitions or not set(transitions) <= possible or (offer.covering and transitions != offer.transitions):
            faults.append(f"`{offer.name}` cannot be emitted like that")
        for taken in transitions:
            marks[taken] = marks.get(taken, _BARE) | {offer.name}
    return tuple(faults) or (*_silent_exits(plan, marks), *_confused(plan, marks))


def _emitted(choice: Choice, by: str, own: str, generators: frozenset[str]) -> bool:
    ways = [way for way in choice.ways if (way == {own}) == (by == "residual")]
    return by in ("residual", "negation") and any(way <= generators for way in ways)


def _silent_exits(plan: Plan, marks: Marks) -> Iterator[str]:
    following: dict[str, list[str]] = {name: [] for name in plan.locations}
    for arc in plan.arcs:
        following[arc.source].append(arc.target)
    lasting = _after_cycles(_reached(plan.initial, following), following)
    for number, arc in enumerate(plan.arcs):
        if arc.source in lasting and None in arc.outputs and not marks.get(number):
            yield f"the exit {arc.source} -{arc.event}-> {arc.target} of a persistent location is silent"


def _confused(plan: Plan, marks: Marks) -> Iterator[str]:
    """Yield the first pair of locations that equal words of any length lead to."""
    moves = {name: _moves(plan, name, marks) for name in plan.locations}
    starts = [(p, q) for p in plan.initial for q in plan.initial if p <= q]
    following: dict[tuple[str, str], list[tuple[str, str]]] = {}
    waiting = list(starts)
    while waiting:
        pair = waiting.pop()
        if pair not in following:
            following[pair] = _together(moves[pair[0]], moves[pair[1]])
            waiting += following[pair]
    for p, q in sorted(_after_cycles(set(following), following)):
        if p != q:
            yield f"`{p}` and `{q}` look alike for ever"
            return


def _moves(plan: Plan, location: str, marks: Marks) -> dict[Seen, set[str]]:
    """Where each thing seen leads to, after any number of silent transitions."""
    silent: dict[str, list[str]] = {name: [] for name in plan.locations}
    for number, arc in enumerate(plan.arcs):
        if None in arc.outputs and not marks.get(number):
            silent[arc.source].append(arc.target)
    ready = _reached([location], silent)
    found: dict[Seen, set[str]] = {}
    for number, arc in enumerate(plan.arcs):
        if arc.source in ready:
            for seen in product(arc.outputs, (marks.get(number, _BARE),), arc.commands):
                if seen[:2] != (None, _BARE):
                    found.setdefault(seen, set()).add(arc.target)
    return found


def _together(one: Mapping[Seen, set[str]], other: Mapping[Seen, set[str]]) -> list[tuple[str, str]]:
    pairs = {(min(p, q), max(p, q)) for seen in one if seen in other for p in one[seen] for q in other[seen]}
    return list(pairs)


def _reached(starts: Iterable[Node], following: Mapping[Node, Iterable[Node]]) -> set[Node]:
    found = set(starts)
    waiting = list(found)
    while waiting:
        for node in following[waiting.pop()]:
            if node not in found:
                found.add(node)
                waiting.append(node)
    return found


def _after_cycles(nodes: set[Node], following: Mapping[Node, Iterable[Node]]) -> set[Node]:
    """The nodes that a cycle leads to: what is left when nodes without predecessor are taken away."""
    before = dict.fromkeys(nodes, 0)
    for node in nodes:
        for after in following[node]:
            before[after] += 1
    waiting = [node for node, count in before.items() if count == 0]
    left = set(nodes)
    while waiting:
        node = waiting.pop()
        left.discard(node)
        for after in following[node]:
            before[after] -= 1
            if before[after] == 0:
                waiting.append(after)
    return left


__all__ = ["Choice", "choices", "constraint_faults", "offer_faults", "plan_faults"]
