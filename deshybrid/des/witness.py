"""Runs that prove a negative verdict: they can be read, replayed on the model, and repeated for ever.

In: D'_H with a silent exit of a persistent location, or with a persistent pair of different locations.
Out: a `Witness`.  Idea: a shortest way from a cycle to the failure, and a shortest way from the start to that cycle;
for pairs both are looked for from the failure backwards, so that the rest of the pair automaton is never built.
Cost: linear in what is searched.  Source: Balluchi et al. (2012), section 3.1 (why C1 and C2 are necessary).
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from itertools import count
from typing import Literal, NamedTuple, TypeAlias

from deshybrid.des.automaton import Output
from deshybrid.des.cycles import cycle_before, nodes_on_cycles, shortest_walk
from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.observer import entry_estimates
from deshybrid.des.persistence import location_graph
from deshybrid.des.worklist import Graph, explore

_STARTS_TRIED = 64
_ENOUGH = 2_000  # pairs before a failure among which a cycle is looked for first
Pair: TypeAlias = tuple[int, int]
Moves: TypeAlias = list[Pair]  # edge numbers of the first and of the second run
JointMoves: TypeAlias = list[tuple[Pair, Pair]]  # an unordered pair of locations, the edges of its lower and higher one
Arrivals: TypeAlias = dict[Output, list[Pair]]


class Step(NamedTuple):
    """One step of a run; the first step of a run has the event "" and the start location."""

    event: str
    location: str


@dataclass(frozen=True, slots=True)
class Witness:
    """Runs that prove a negative verdict; `deshybrid.des.replay` checks them without the code that found them.

    C2: two runs with the same `outputs` that end in different locations, each by a visible transition.  The part of run
    number r between the steps `cycles[r]` (indices into the run) leads back to the location it starts from and shows
    `outputs[repeated[0]:repeated[1]]`, so it can be repeated in both runs alike, and the confusion never ends.
    C1: the first run passes a cycle, comes to a persistent location and leaves it silently; the second run stops before
    that last step, has the same outputs and is elsewhere.  (A silent self-loop is shown by the first run alone.)
    """

    condition: Literal["C1", "C2"]
    outputs: tuple[str, ...]
    runs: tuple[tuple[Step, ...], ...]
    cycles: tuple[tuple[int, int], ...]
    repeated: tuple[int, int]

    def __str__(self) -> str:
        lines = [f"outputs: {' '.join(self.outputs) or 'none'}"]
        for run in self.runs:
            lines.append(run[0].location + "".join(f" -{step.event}-> {step.location}" for step in run[1:]))
        return "\n".join(lines)


@dataclass(frozen=True, slots=True)
class Confusion:
    """Two runs of D'_H with equal outputs, as (edge number of run 1, edge number of run 2) moves.

    They start in the locations `start`; `around` leads both back to where they were and can be repeated; after `after`
    they are in different locations.
    """

    start: tuple[str, str]
    before: Moves
    around: Moves
    after: Moves


def c1_witness(automaton: OutputAutomaton, silent_exit: int) -> Witness:
    """Return a run through a cycle to the persistent source of transition number `silent_exit`, which is then taken.

    The run starts, if there is one, from the first initial location from which the observer would know better: without
    the cycle and the silent exit, its entry estimate is exactly that source.  Else it starts from a nearest one.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> print(c1_witness(eliminate_epsilon(des), 0))
    outputs: α α
    5 -a-> 2 -d-> 5 -a-> 2 -d-> 5
    5 -a-> 2 -d-> 5 -a-> 2
    """
    des = automaton.des
    graph = location_graph(des)
    source = graph.nodes.index(des.transitions[silent_exit].source)
    cycle, tail = ([graph.arcs[arc][1] for arc in arcs] for arcs in cycle_before(graph, source))
    prefix = _convincing_prefix(automaton, cycle[0], tail)
    taken = [*prefix, *cycle, *tail]
    transitions = [des.transitions[number] for number in taken]
    shown = [str(transition.seen[0]) if transition.is_observable else None for transition in transitions]
    run = _run(automaton, des.transitions[taken[0]].source, [*taken, silent_exit])
    marks = (len(prefix), len(prefix) + len(cycle))
    before, within = (sum(output is not None for output in shown[:mark]) for mark in marks)
    return Witness(
        condition="C1",
        outputs=tuple(output for output in shown if output is not None),
        runs=(run,) if run[-1].location == run[-2].location else (run, run[:-1]),
        cycles=(marks,) if run[-1].location == run[-2].location else (marks, marks),
        repeated=(before, within),
    )


def _convincing_prefix(automaton: OutputAutomaton, first_of_cycle: int, tail: list[int]) -> list[int]:
    """Return transitions from an initial location to the cycle, after which (and `tail`) the observer knows most."""
    des = automaton.des
    graph = location_graph(des)
    entry = graph.nodes.index(des.transitions[first_of_cycle].source)
    goal = des.transitions[tail[-1]].target if tail else des.transitions[first_of_cycle].source
    for start in des.initial[:_STARTS_TRIED]:
        walk = shortest_walk(graph, graph.nodes.index(start), lambda node: node == entry)
        if walk is None:
            continue
        prefix = [graph.arcs[arc][1] for arc in walk]
        if entry_estimates(automaton, _shown(automaton, [*prefix, *tail]))[-1] == (goal,):
            return prefix
    return [graph.arcs[arc][1] for arc in graph.path_to(entry)]


def _shown(automaton: OutputAutomaton, transitions: Iterable[int]) -> list[Output]:
    """What a run shows if every transition that may be silent is: such runs are as confusing as the model permits."""
    seen = (automaton.des.transitions[number].seen for number in transitions)
    return [outputs[0] for outputs in seen if None not in outputs and outputs[0] is not None]


def find_confusion(automaton: OutputAutomaton, target: Pair, lasts: Callable[[int, int], bool]) -> Confusion:
    """Return two runs that look alike for ever and then part, in the persistent pair `target` of location numbers.

    `lasts(p, q)` says of p <= q whether the pair is persistent.  The cycle is as near to `target` as can be, unless
    thousands of pairs lead to `target` within as many steps: then the first cycle that is found there.
    """
    entering = _entering(automaton)
    near = _cyclic_surroundings(entering, target, lasts)
    cycle, tail = cycle_before(near, 0)
    entry = near.nodes[near.arcs[cycle[0]][0]]
    start, prefix = _way_from_start(automaton, entering, entry)
    before, there = _lift(automaton, start, prefix)
    around, back = _lift(automaton, there, _joint_moves(near, cycle))
    if back != there:
        around = _brought_home(automaton, around)
    after, _ = _lift(automaton, there, _joint_moves(near, tail))
    first, second = (automaton.des.locations[number] for number in start)
    return Confusion((first, second), before, around, after)


def _entering(automaton: OutputAutomaton) -> list[Arrivals]:
    """For each location number, the (source number, edge number) of the edges that enter it, by output."""
    number = {name: index for index, name in enumerate(automaton.des.locations)}
    entering: list[Arrivals] = [{} for _ in number]
    for index, edge in enumerate(automaton.edges):
        entering[number[edge.target]].setdefault(edge.output, []).append((number[edge.source], index))
    return entering


def _before(entering: list[Arrivals], pair: Pair) -> Iterator[tuple[Pair, Pair]]:
    """Yield each pair that moves to `pair`, with the edges that move its lower and its higher location."""
    known = set()
    for output, arrivals in entering[pair[0]].items():
        for p, edge_p in arrivals:
            for q, edge_q in entering[pair[1]].get(output, ()):
                earlier, edges = ((p, q), (edge_p, edge_q)) if p <= q else ((q, p), (edge_q, edge_p))
                if earlier not in known:
                    known.add(earlier)
                    yield edges, earlier


def _cyclic_surroundings(
    entering: list[Arrivals], target: Pair, lasts: Callable[[int, int], bool]
) -> Graph[Pair, Pair]:
    """Return enough of the persistent pairs that lead to `target` (node 0) to have a cycle among them."""
    enough = _ENOUGH
    while True:
        against = explore([target], _budget(lambda pair: [b for b in _before(entering, pair) if lasts(*b[1])], enough))
        forward = tuple((later, label, earlier) for earlier, label, later in against.arcs)
        graph = Graph(against.nodes, forward, (-1,) * len(against.nodes))
        if any(nodes_on_cycles(graph)):
            return graph
        enough *= 4


def _budget(
    successors: Callable[[Pair], list[tuple[Pair, Pair]]], enough: int
) -> Callable[[Pair], list[tuple[Pair, Pair]]]:
    """Return `successors` for the first `enough` calls, nothing from then on."""
    calls = count()
    return lambda pair: successors(pair) if next(calls) < enough else []


def _way_from_start(automaton: OutputAutomaton, entering: list[Arrivals], entry: Pair) -> tuple[Pair, JointMoves]:
    """Return a nearest pair of initial locations, and the moves from there to `entry`."""
    names, initial = automaton.des.locations, set(automaton.des.initial)
    starts: list[Pair] = []

    def successors(pair: Pair) -> Iterator[tuple[Pair, Pair]]:
        if not starts and names[pair[0]] in initial and names[pair[1]] in initial:
            starts.append(pair)
        return iter(()) if starts else _before(entering, pair)

    against = explore([entry], successors)
    path = against.path_to(against.nodes.index(starts[0]))
    return starts[0], [(against.nodes[against.arcs[arc][2]], against.arcs[arc][1]) for arc in path[::-1]]


def _joint_moves(graph: Graph[Pair, Pair], arcs: list[int]) -> JointMoves:
    return [(graph.nodes[graph.arcs[arc][0]], graph.arcs[arc][1]) for arc in arcs]


def _lift(automaton: OutputAutomaton, start: Pair, joint_moves: JointMoves) -> tuple[Moves, Pair]:
    """Turn moves of unordered pairs into moves of two runs, and the pair they end in."""
    place = {name: index for index, name in enumerate(automaton.des.locations)}
    moves, pair = [], start
    for source, (low, high) in joint_moves:
        first, second = (low, high) if pair == source else (high, low)
        moves.append((first, second))
        pair = (place[automaton.edges[first].target], place[automaton.edges[second].target])
    return moves, pair


def _brought_home(automaton: OutputAutomaton, around: Moves) -> Moves:
    """Repair a round after which the two runs have changed places.

    Where they meet on the way, they part the other way round; else a second, mirrored round undoes the exchange.
    """
    for position, (first, second) in enumerate(around):
        if automaton.edges[first].source == automaton.edges[second].source:
            return around[:position] + _mirrored(around[position:])
    return around + _mirrored(around)


def _mirrored(moves: Moves) -> Moves:
    return [(second, first) for first, second in moves]


def c2_witness(automaton: OutputAutomaton, confusion: Confusion) -> Witness:
    """Return the two runs of a confusion as steps of D_H, silent ones included.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> des = DES.from_transitions([("1", "a", "1", "α"), ("1", "b", "2", "β"), ("1", "b", "3", "β")])
    >>> automaton = eliminate_epsilon(des)
    >>> print(c2_witness(automaton, find_confusion(automaton, (1, 2), lambda p, q: True)))
    outputs: α β
    1 -a-> 1 -b-> 2
    1 -a-> 1 -b-> 3
    """
    parts = (confusion.before, confusion.around, confusion.after)
    runs, cycles = [], []
    for side in (0, 1):
        before, around, after = ([t for move in part for t in automaton.edges[move[side]].path] for part in parts)
        runs.append(_run(automaton, confusion.start[side], [*before, *around, *after]))
        cycles.append((len(before), len(before) + len(around)))
    outputs = tuple(str(automaton.edges[first].output) for part in parts for first, _ in part)
    repeated = (len(confusion.before), len(confusion.before) + len(confusion.around))
    return Witness("C2", outputs, tuple(runs), tuple(cycles), repeated)


def _run(automaton: OutputAutomaton, start: str, transitions: list[int]) -> tuple[Step, ...]:
    taken = (automaton.des.transitions[number] for number in transitions)
    return (Step("", start), *(Step(transition.event, transition.target) for transition in taken))


__all__ = ["Confusion", "Step", "Witness", "c1_witness", "c2_witness", "find_confusion"]
