"""Null-output elimination: from D_H to D'_H, an automaton that moves only on what the observer sees.

A transition with output ε is invisible to the observer.  Every path of invisible transitions is folded into the visible
transition that ends it; the path is kept on the edge, so that a diagnosis can point into the model file.
Silent cycles need no care: a shortest path never runs through one.

In: a `DES`.  Out: an `OutputAutomaton`.  Idea: one breadth-first search over silent transitions from each location.
Cost: |Q| searches; at most |Q|² · |Γ| edges.  Source: Balluchi et al. (2012), section 3.1, construction step 1.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

from deshybrid.des.automaton import DES, Output
from deshybrid.des.subsets import SubsetMoves, subset_moves
from deshybrid.des.worklist import explore
from deshybrid.diagnostics.pictured import Pictured

Moves: TypeAlias = dict[int, list[tuple[int, int]]]


class Edge(NamedTuple):
    """p —γ→ q of D'_H; `path` holds the numbers of the DES transitions folded in, the last one is the visible one."""

    source: str
    output: Output
    target: str
    path: tuple[int, ...]

    def __str__(self) -> str:
        return f"{self.source} -{self.output}-> {self.target}"


@dataclass(frozen=True, repr=False)
class OutputAutomaton(Pictured):
    """D'_H: p —γ→ q exists once where p ⇒ε* p' —γ→ q in D_H, with a shortest path, first by declaration among equals.

    Edges are found when they are first asked for: D_O needs none of them.
    """

    des: DES

    def __repr__(self) -> str:
        return f"<OutputAutomaton of {self.des.name}: {len(self.des.locations)} locations, {len(self.outputs)} outputs>"

    @cached_property
    def edges(self) -> tuple[Edge, ...]:
        """Ordered by source, then by length of their path, then by declaration."""
        leaving: dict[str, list[int]] = {location: [] for location in self.des.locations}
        for number, transition in enumerate(self.des.transitions):
            leaving[transition.source].append(number)
        return tuple(edge for source in self.des.locations for edge in _edges_from(self.des, leaving, source))

    @cached_property
    def subsets(self) -> SubsetMoves[Any]:
        """How sets of locations move, without any edge of D'_H."""
        return subset_moves(self.des, self.outputs)

    @cached_property
    def outputs(self) -> tuple[Output, ...]:
        """Everything that may be seen, in the order of first appearance in the transitions of the DES.

        >>> des = DES.from_transitions([("1", "a", "2", "β"), ("2", "b", "1", "α"), ("2", "c", "1", "β")])
        >>> [str(output) for output in eliminate_epsilon(des).outputs]
        ['β', 'α']
        """
        alike = {
            (transition.outputs, transition.signature, transition.commands): transition
            for transition in self.des.transitions
        }
        seen = (output for transition in alike.values() for output in transition.seen)
        return tuple(dict.fromkeys(output for output in seen if output is not None))


def eliminate_epsilon(des: DES) -> OutputAutomaton:
    """Return D'_H, the automaton with the observable moves of `des` (Balluchi et al., 2012, section 3.1, step 1).

    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> for edge in eliminate_epsilon(des).edges:
    ...     print(edge, edge.path)
    2 -α-> 2 (0, 1)
    5 -α-> 2 (1,)
    """
    return OutputAutomaton(des)


def _edges_from(des: DES, leaving: dict[str, list[int]], source: str) -> Iterator[Edge]:
    def silent_moves(location: str) -> Iterator[tuple[int, str]]:
        for number in leaving[location]:
            if not des.transitions[number].is_observable:
                yield number, des.transitions[number].target

    closure = explore([source], silent_moves)
    known = set()
    for position, location in enumerate(closure.nodes):
        for number in leaving[location]:
            for output in des.transitions[number].seen:
                target = des.transitions[number].target
                if output is not None and (output, target) not in known:
                    known.add((output, target))
                    path = (*(closure.arcs[arc][1] for arc in closure.path_to(position)), number)
                    yield Edge(source, output, target, path)


def moves_by_location(automaton: OutputAutomaton) -> list[Moves]:
    """Return the moves of D'_H as numbers: for each location {output number: [(target number, edge number)]}.

    Outputs are numbered as in `automaton.outputs`, and the keys of each mapping ascend.
    """
    location_number = {name: number for number, name in enumerate(automaton.des.locations)}
    output_number = {output: number for number, output in enumerate(automaton.outputs)}
    moves: list[Moves] = [{} for _ in location_number]
    for number, edge in enumerate(automaton.edges):
        arrivals = moves[location_number[edge.source]].setdefault(output_number[edge.output], [])
        arrivals.append((location_number[edge.target], number))
    return [dict(sorted(table.items())) for table in moves]


__all__ = ["Edge", "Moves", "OutputAutomaton", "eliminate_epsilon", "moves_by_location"]
