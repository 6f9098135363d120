"""Faults: whether what is seen shows that one has happened (diagnosability), or that one must come (predictability).

Diagnosable: there is a number n such that n events after a fault every run that shows the same outputs has a fault.
Predictable: before every fault comes a moment from which on every run with the same outputs meets a fault within n
events.  Both ask about runs that go on; a run that ends soon after its fault breaks nothing.

In: a `DES` and its fault events.  Out: a `FaultReport`, with two runs that prove a "no".
Idea: twin plants, a run with a fault beside one without.  Cost: at most 2·|Q|² pairs with |δ|² moves: polynomial.
Source: Sampath et al. (1995), diagnosability; Jiang et al. (2001) and Yoo and Lafortune (2002), verifiers; Genc and
Lafortune (2009), predictability.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeAlias

from deshybrid.des.automaton import DES, Output
from deshybrid.des.composition import Composition, unfold
from deshybrid.des.cycles import persistent_nodes
from deshybrid.des.lassos import Lasso, find_lasso
from deshybrid.des.runs import Move, known_events, moves_from, run_along
from deshybrid.des.search import labels_to
from deshybrid.des.twins import TwinMove, TwinWitness, search_twins, twin_witness
from deshybrid.des.worklist import Graph, explore

Marked: TypeAlias = tuple[str, bool]
Moves: TypeAlias = dict[str, list[Move]]


@dataclass(frozen=True, slots=True)
class FaultReport:
    """The answer to a question about faults; `witness` holds the two runs that prove a "no", else None.

    Diagnosability: the first run has a fault before its cycle and goes on in it, the second never has one.
    Predictability: the first run ends with its only fault; the second shows the same outputs up to the step before that
    fault, has no fault, and then goes on in a cycle without one: its outputs from there on are its own, and not listed.
    """

    holds: bool
    witness: TwinWitness | None = None


def diagnosability(
    system: DES | Composition, *, faults: Iterable[str], max_pairs: int | None = 2_000_000
) -> FaultReport:
    """Return whether every fault shows in the outputs, within a bounded number of events.

    Silent events count as events, so a silent cycle after an unseen fault is a "no".  At most 2·|Q|² pairs, |δ|² moves,
    of which a growing part is looked at until it holds a "no"; a composition is never built.
    Raises `LimitReached` (DH0901) beyond `max_pairs`, `UsageError` (DH0420).
    Source: Jiang et al. (2001); Yoo and Lafortune (2002).

    >>> rows = [("1", "f", "2", None), ("2", "a", "2", "α"), ("1", "b", "3", None), ("3", "a", "3", "α")]
    >>> print(diagnosability(DES.from_transitions(rows, initial=["1"]), faults=["f"]).witness)
    outputs: α
    1 -f-> 2 -a-> 2
    1 -b-> 3 -a-> 3
    >>> diagnosability(DES.from_transitions([*rows, ("3", "a", "3", "β")], initial=["1"]), faults=["b"]).holds
    False
    """
    plant, bad = unfold(system), set(known_events(system, faults, "faults"))

    def left(state: Marked) -> Iterator[tuple[int, Output | None, Marked]]:
        for number, seen, target in plant.ways(state[0]):
            yield number, seen, (target, state[1] or plant.transitions[number].event in bad)

    def right(location: str) -> Iterator[Move]:
        return (move for move in plant.ways(location) if plant.transitions[move.transition].event not in bad)

    roots = (((p, False), q) for p in plant.initial for q in plant.initial)
    found = search_twins(roots, left, right, _unseen_fault, limit=max_pairs)
    if found is None:
        return FaultReport(True)
    twins, lasso = found
    (p, _), q = twins.nodes[twins.arcs[lasso.before[0]][0]]  # no run has a fault at once: there is a way
    before, around, _ = ([twins.arcs[arc][1] for arc in part] for part in lasso)
    return FaultReport(False, twin_witness(plant, (p, q), before, around))


def _unseen_fault(twins: Graph[tuple[Marked, str], TwinMove]) -> Lasso | None:
    """A cycle in which the left run has had a fault and goes on."""
    return find_lasso(
        twins, within=lambda node: twins.nodes[node][0][1], through=lambda arc: twins.arcs[arc][1].left is not None
    )


def predictability(des: DES, *, faults: Iterable[str], max_pairs: int | None = 2_000_000) -> FaultReport:
    """Return whether every fault can be predicted: before it comes, what was seen already means that one must come.

    At most |Q|² pairs, |δ|² moves.  Raises `LimitReached` (DH0901) beyond `max_pairs`, `UsageError` (DH0420).
    Source: Genc and Lafortune (2009), with pairs of runs.

    >>> rows = [("1", "a", "2", "α"), ("2", "f", "1", None), ("1", "b", "3", "β"), ("3", "c", "3", "γ")]
    >>> predictability(DES.from_transitions(rows, initial=["1"]), faults=["f"]).holds
    True
    >>> print(predictability(DES.from_transitions([*rows, ("1", "d", "3", "α")], initial=["1"]), faults=["f"]).witness)
    outputs: α
    1 -a-> 2 -f-> 1
    1 -d-> 3 -c-> 3
    """
    faulty, moves, sound = _moves(des, faults)
    roots = ((p, q) for p in des.initial for q in des.initial)
    lasting = _lasting(sound)
    threatened = {q for q, table in moves.items() if any(faulty[move.transition] for move in table)}

    def unforeseen(twins: Graph[tuple[str, str], TwinMove]) -> int | None:
        return next((n for n, (p, q) in enumerate(twins.nodes) if p in threatened and q in lasting), None)

    found = search_twins(roots, sound.__getitem__, sound.__getitem__, unforeseen, limit=max_pairs)
    if found is None:
        return FaultReport(True)
    twins, pair = found
    fault = next(move.transition for move in moves[twins.nodes[pair][0]] if faulty[move.transition])
    return FaultReport(False, _unforeseen(des, twins, pair, fault, sound))


def _moves(des: DES, faults: Iterable[str]) -> tuple[list[bool], Moves, Moves]:
    """Which transitions are faults, all moves by location, and the moves without a fault."""
    bad = set(known_events(des, faults, "faults"))
    faulty = [transition.event in bad for transition in des.transitions]
    moves = moves_from(des)
    sound = {q: [move for move in table if not faulty[move.transition]] for q, table in moves.items()}
    return faulty, moves, sound


def _lasting(moves: Moves) -> set[str]:
    """The locations from which runs of any length start: those that a cycle leads to, against the arcs."""
    before: dict[str, list[tuple[int, str]]] = {location: [] for location in moves}
    for location, table in moves.items():
        for move in table:
            before[move.target].append((move.transition, location))
    graph = explore(moves, before.__getitem__)
    return {graph.nodes[node] for node in persistent_nodes(graph)}


def _unforeseen(des: DES, twins: Graph[tuple[str, str], TwinMove], pair: int, fault: int, sound: Moves) -> TwinWitness:
    """Two runs to a pair of locations, then the fault in the one, and a cycle without a fault in the other."""
    path = twins.path_to(pair)
    starts = twins.nodes[twins.arcs[path[0]][0] if path else pair]
    both = twin_witness(des, starts, labels_to(twins, pair), ())
    graph = explore([twins.nodes[pair][1]], lambda q: ((move.transition, move.target) for move in sound[q]))
    lasso = find_lasso(graph)
    before, around, _ = lasso if lasso is not None else ((), (), ())
    first = (*both.runs[0], *run_along(des, twins.nodes[pair][0], [fault])[1:])
    way = [graph.arcs[arc][1] for arc in (*before, *around)]
    second = (*both.runs[1], *run_along(des, twins.nodes[pair][1], way)[1:])
    turn = len(both.runs[1]) - 1 + len(before)
    end, shown = len(first) - 1, len(both.outputs)
    return TwinWitness(both.outputs, (first, second), ((end, end), (turn, turn + len(around))), (shown, shown))


__all__ = ["FaultReport", "diagnosability", "predictability"]
