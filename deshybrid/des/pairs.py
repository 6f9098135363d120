"""The pair automaton of D'_H: which two locations are compatible with the same outputs.

Two runs with equal outputs move as a pair: {p, q} —γ→ {p', q'} where p —γ→ p' and q —γ→ q' in D'_H.  The start is every
pair of initial locations, equal ones included, since two runs may separate late.  Two locations share a persistent
state of D_O exactly where their pair is reachable from a cycle of the pair automaton: either says that arbitrarily long
words lead to both.

In: an `OutputAutomaton`.  Out: a `PairAutomaton`.  Idea: unordered pairs, one worklist.  Cost: |Q|² · branching², never
the exponential observer.  Source: Balluchi et al. (2012), section 3.1, Theorem 4; Özveren and Willsky (1990).
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations_with_replacement

from deshybrid.des.cycles import longest_path_to, persistent_nodes
from deshybrid.des.epsilon import Moves, OutputAutomaton, moves_by_location
from deshybrid.des.worklist import Graph, explore


@dataclass(frozen=True, slots=True)
class PairAutomaton:
    """Pairs (p, q) of location numbers, p <= q; an arc's label holds the edge numbers that move p and q."""

    automaton: OutputAutomaton
    graph: Graph[tuple[int, int], tuple[int, int]]

    def persistent(self) -> tuple[int, ...]:
        """Return the numbers of the pairs that are reachable from a cycle; (q, q) among them: q is entered visibly."""
        return tuple(persistent_nodes(self.graph))

    def longest_confusion(self) -> int | None:
        """Return the most outputs after which two locations are possible, None where that never happens.

        Only for automata without a persistent pair of different locations.
        """
        return longest_path_to(self.graph, [node for node, (p, q) in enumerate(self.graph.nodes) if p != q])


def build_pair_automaton(automaton: OutputAutomaton) -> PairAutomaton:
    """Return the pair automaton, from all pairs of initial locations.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("1", "b", "3", "α")], initial=["1"])
    >>> build_pair_automaton(eliminate_epsilon(des)).graph.nodes
    ((0, 0), (1, 1), (1, 2), (2, 2))
    """
    moves = moves_by_location(automaton)
    initial = set(automaton.des.initial)
    start = [number for number, name in enumerate(automaton.des.locations) if name in initial]
    roots = combinations_with_replacement(start, 2)
    return PairAutomaton(automaton, explore(roots, lambda pair: _joint_moves(moves, *pair)))


def _joint_moves(moves: list[Moves], p: int, q: int) -> Iterator[tuple[tuple[int, int], tuple[int, int]]]:
    """The first way to each next pair; which of several equal outputs leads there makes no difference."""
    known = set()
    for output, arrivals in moves[p].items():
        for to_p, edge_p in arrivals:
            for to_q, edge_q in moves[q].get(output, ()):
                pair = (to_p, to_q) if to_p <= to_q else (to_q, to_p)
                if pair not in known:
                    known.add(pair)
                    yield (edge_p, edge_q), pair


__all__ = ["PairAutomaton", "build_pair_automaton"]
