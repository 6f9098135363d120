"""Sets of locations that move on outputs: the steps of the subset construction, without ε-elimination before it.

In: a `DES`.  Out: `SubsetMoves`: from a set of locations, for each output, the set of locations that may be entered
next.  What follows silently is closed under silence for each set when it is needed: doing so for every location first
can take |Q|² time and memory where most transitions are silent.

Two representations, chosen by size alone (measured in `benchmarks/`); where many sets wait, `batches` has a third:
- few locations and outputs: a set is a bit mask, and the moves of the 256 sets of eight neighbouring locations are
  remembered, the masks of all outputs side by side in one integer; a step joins one such integer for every eight;
- else: a set is a sorted tuple of location numbers, and a step is one union of (output, target) numbers.
Cost of a step: linear in the members and their moves, divided by eight or more for bit masks.
"""

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Iterable, Iterator
from typing import Any, Generic, TypeVar

from deshybrid.des.automaton import DES, Output
from deshybrid.des.bitsets import members, union
from deshybrid.des.cycles import persistent_nodes
from deshybrid.des.worklist import Graph

_WIDE = 2048  # bits for all outputs side by side; longer integers cost more than they save
_BYTE = 8

Subset = TypeVar("Subset", int, tuple[int, ...])


class SubsetMoves(ABC, Generic[Subset]):
    """Moves between sets of locations; outputs are numbered as in `outputs`, in the order of first appearance.

    `visible[p]` are the moves of location p as output · |Q| + target, `silent[p]` its silent successors.  `closed` says
    whether a set is closed under silence after an output (the current estimates), or before it (the entry estimates).
    """

    def __init__(self, des: DES, outputs: tuple[Output, ...], *, closed: bool = False) -> None:
        self.size, self.outputs, self.closed = len(des.locations), outputs, closed
        self.visible: list[list[int]] = [[] for _ in des.locations]
        self.silent: list[list[int]] = [[] for _ in des.locations]
        for source, output, target in numbered_moves(des, outputs):
            if output < 0:
                self.silent[source].append(target)
            else:
                self.visible[source].append(output * self.size + target)
        self.is_silent = any(self.silent)

    @abstractmethod
    def subset(self, locations: Iterable[int]) -> Subset:
        """Return the set of `locations`, given as numbers in ascending order."""

    def start(self, locations: Iterable[int]) -> Subset:
        """Return the set to start from, given its `locations` before any silence."""
        return self.subset(sorted(self.closure(locations)) if self.closed else locations)

    @abstractmethod
    def members(self, subset: Subset) -> Iterable[int]:
        """Return the numbers of the locations in a set, in ascending order."""

    @abstractmethod
    def successors(self, subset: Subset) -> list[tuple[Output, Subset]]:
        """Return the (output, set entered) moves of a set, in the order of `outputs`, no set empty."""

    def ready(self, locations: Iterable[int]) -> Iterable[int]:
        """Return the locations that may move on an output next: silence before it is followed here."""
        return self.closure(locations) if self.is_silent and not self.closed else locations

    def settled(self, moves: Iterable[int]) -> Iterable[int]:
        """Return `moves` with the silence after them, where that belongs to the set entered."""
        return self.closure(moves) if self.is_silent and self.closed else moves

    def closure(self, numbers: Iterable[int]) -> set[int]:
        """Return `numbers`, each k · |Q| + location for any k, and all that they lead to silently."""
        closed = set(numbers)
        waiting = [number for number in closed if self.silent[number % self.size]]
        while waiting:
            number = waiting.pop()
            location = number % self.size
            for target in self.silent[location]:
                follows = number - location + target
                if follows not in closed:
                    closed.add(follows)
                    if self.silent[target]:
                        waiting.append(follows)
        return closed


class _Masks(SubsetMoves[int]):
    """Bit masks; `known[i][b]` are the moves of the locations 8i + k for the bits k of b, all outputs side by side."""

    def __init__(self, des: DES, outputs: tuple[Output, ...], *, closed: bool = False) -> None:
        super().__init__(des, outputs, closed=closed)
        self.known: list[dict[int, int]] = [{} for _ in range(self.size // _BYTE + 1)]

    def subset(self, locations: Iterable[int]) -> int:
        return union(1 << location for location in locations)

    def members(self, subset: int) -> Iterable[int]:
        return members(subset)

    def successors(self, subset: int) -> list[tuple[Output, int]]:
        joined = 0
        for index, byte in enumerate(subset.to_bytes(len(self.known), "little")):
            if byte:
                joined |= self.known[index].get(byte) or self._moves_of(index, byte)
        arcs, full = [], (1 << self.size) - 1
        for output in self.outputs:
            if entered := joined & full:
                arcs.append((output, entered))
            joined >>= self.size
        return arcs

    def _moves_of(self, index: int, byte: int) -> int:
        ready = self.ready([_BYTE * index + bit for bit in members(byte)])
        moves = [move for location in ready for move in self.visible[location]]
        joined = union([1 << move for move in self.settled(moves)])
        self.known[index][byte] = joined
        return joined


class _Tuples(SubsetMoves[tuple[int, ...]]):
    """Sorted tuples of location numbers."""

    def subset(self, locations: Iterable[int]) -> tuple[int, ...]:
        return tuple(locations)

    def members(self, subset: tuple[int, ...]) -> Iterable[int]:
        return subset

    def successors(self, subset: tuple[int, ...]) -> list[tuple[Output, tuple[int, ...]]]:
        moves = sorted(self.settled(set[int]().union(*map(self.visible.__getitem__, self.ready(subset)))))
        arcs, start = [], 0
        while start < len(moves):
            output = moves[start] // self.size
            base = output * self.size
            stop = bisect_left(moves, base + self.size, start)
            arcs.append((self.outputs[output], tuple([move - base for move in moves[start:stop]])))
            start = stop
        return arcs


class SetGraph(ABC):
    """Sets of locations and the arcs between them, numbered in the order in which a breadth-first search finds them."""

    @abstractmethod
    def __len__(self) -> int:
        """Return the number of sets."""

    @property
    @abstractmethod
    def arc_count(self) -> int:
        """The number of arcs."""

    @abstractmethod
    def members(self) -> Iterator[Iterable[int]]:
        """Yield the locations of each set, in ascending order."""

    @abstractmethod
    def arcs(self, outputs: tuple[Output, ...]) -> tuple[tuple[int, Output, int], ...]:
        """Return (set number, output, set number), grouped by the first; `outputs` as they are numbered."""

    @abstractmethod
    def persistent(self, count: int) -> list[int]:
        """Return the numbers, ascending, of those of the first `count` sets that are reachable from a cycle.

        No arc may lead from them to one of the others.
        """


class PlainGraph(SetGraph):
    """The graph that the worklist found with some `moves`."""

    def __init__(self, moves: SubsetMoves[Any], graph: Graph[Any, Output]) -> None:
        self.moves, self.graph = moves, graph

    def __len__(self) -> int:
        return len(self.graph.nodes)

    @property
    def arc_count(self) -> int:
        """The number of arcs."""
        return len(self.graph.arcs)

    def members(self) -> Iterator[Iterable[int]]:
        """Yield the locations of each set, in ascending order."""
        return map(self.moves.members, self.graph.nodes)

    def arcs(self, outputs: tuple[Output, ...]) -> tuple[tuple[int, Output, int], ...]:
        """Return (set number, output, set number), grouped by the first."""
        return self.graph.arcs

    def persistent(self, count: int) -> list[int]:
        """Return the persistent ones of the first `count` sets."""
        if count == len(self):
            return persistent_nodes(self.graph)
        arcs = tuple(arc for arc in self.graph.arcs if arc[0] < count)
        return persistent_nodes(Graph(self.graph.nodes[:count], arcs, self.graph.found_by[:count]))


def numbered_moves(des: DES, outputs: tuple[Output, ...]) -> Iterator[tuple[int, int, int]]:
    """Yield the moves of locations as (source, output, target), all numbers; output -1 is the silent one.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)])
    >>> list(numbered_moves(des, (Output("α"),)))
    [(0, 0, 1), (1, -1, 0)]
    """
    place = {name: number for number, name in enumerate(des.locations)}
    number: dict[Output | None, int] = {None: -1, **{output: index for index, output in enumerate(outputs)}}
    numbers: dict[tuple[object, ...], list[int]] = {}
    for transition in des.transitions:
        kind = (transition.outputs, transition.signature, transition.commands)
        seen = numbers.get(kind)
        if seen is None:
            seen = numbers[kind] = [number[output] for output in transition.seen]
        source, target = place[transition.source], place[transition.target]
        for output in seen:
            yield source, output, target


def subset_moves(des: DES, outputs: tuple[Output, ...], *, closed: bool = False) -> SubsetMoves[Any]:
    """Return the moves between sets of locations of `des`; `outputs` are all that may be seen, as they are numbered.

    `closed`: sets are closed under silence after an output, not before it.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None), ("1", "b", "1", "β")])
    >>> moves = subset_moves(des, (Output("α"), Output("β")))
    >>> [(str(output), list(moves.members(entered))) for output, entered in moves.successors(moves.subset([1]))]
    [('α', [1]), ('β', [0])]
    """
    wide = len(des.locations) * len(outputs)
    return (_Masks if wide <= _WIDE else _Tuples)(des, outputs, closed=closed)


__all__ = ["PlainGraph", "SetGraph", "Subset", "SubsetMoves", "numbered_moves", "subset_moves"]
