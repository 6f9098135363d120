"""Sets of locations that move on outputs: the steps of the subset construction, without ε-elimination before it.

In: a `DES`.  Out: `SubsetMoves`: from a set of locations, for each output, the set of locations that may be entered
next.  What follows silently is closed under silence for each set when it is needed: doing so for every location first
can take |Q|² time and memory where most transitions are silent.

Two representations, chosen by size alone (measured in `benchmarks/`):
- few locations and outputs: a set is a bit mask, and the moves of the 256 sets of eight neighbouring locations are
  remembered, the masks of all outputs side by side in one integer; a step joins one such integer for every eight;
- else: a set is a sorted tuple of location numbers, and a step is one union of (output, target) numbers.
Cost of a step: linear in the members and their moves, divided by eight or more for bit masks.
"""

from abc import ABC, abstractmethod
from bisect import bisect_left
from collections.abc import Iterable
from typing import Any, Generic, TypeVar

from deshybrid.des.automaton import DES, Output
from deshybrid.des.bitsets import members, union

_WIDE = 2048  # bits for all outputs side by side; longer integers cost more than they save
_BYTE = 8

Subset = TypeVar("Subset", int, tuple[int, ...])


class SubsetMoves(ABC, Generic[Subset]):
    """Moves between sets of locations; outputs are numbered as in `outputs`, in the order of first appearance.

    `visible[p]` are the moves of location p as output · |Q| + target, `silent[p]` its silent successors.
    """

    def __init__(self, des: DES, outputs: tuple[Output, ...]) -> None:
        place = {name: number for number, name in enumerate(des.locations)}
        number = {output: index * len(place) for index, output in enumerate(outputs)}
        self.size, self.outputs = len(place), outputs
        self.visible: list[list[int]] = [[] for _ in place]
        self.silent: list[list[int]] = [[] for _ in place]
        for transition in des.transitions:
            source, target = place[transition.source], place[transition.target]
            for output in transition.seen:
                if output is None:
                    self.silent[source].append(target)
                else:
                    self.visible[source].append(number[output] + target)
        self.is_silent = any(self.silent)

    @abstractmethod
    def subset(self, locations: Iterable[int]) -> Subset:
        """Return the set of `locations`, given as numbers in ascending order."""

    @abstractmethod
    def members(self, subset: Subset) -> Iterable[int]:
        """Return the numbers of the locations in a set, in ascending order."""

    @abstractmethod
    def successors(self, subset: Subset) -> list[tuple[Output, Subset]]:
        """Return the (output, set entered) moves of a set, in the order of `outputs`, no set empty."""

    def closure(self, locations: Iterable[int]) -> Iterable[int]:
        """Return `locations` and all that they lead to silently."""
        if not self.is_silent:
            return locations
        closed = set(locations)
        waiting = [location for location in closed if self.silent[location]]
        while waiting:
            for location in self.silent[waiting.pop()]:
                if location not in closed:
                    closed.add(location)
                    if self.silent[location]:
                        waiting.append(location)
        return closed


class _Masks(SubsetMoves[int]):
    """Bit masks; `known[i][b]` are the moves of the locations 8i + k for the bits k of b, all outputs side by side."""

    def __init__(self, des: DES, outputs: tuple[Output, ...]) -> None:
        super().__init__(des, outputs)
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
        closed = self.closure([_BYTE * index + bit for bit in members(byte)])
        joined = union(1 << move for location in closed for move in self.visible[location])
        self.known[index][byte] = joined
        return joined


class _Tuples(SubsetMoves[tuple[int, ...]]):
    """Sorted tuples of location numbers."""

    def subset(self, locations: Iterable[int]) -> tuple[int, ...]:
        return tuple(locations)

    def members(self, subset: tuple[int, ...]) -> Iterable[int]:
        return subset

    def successors(self, subset: tuple[int, ...]) -> list[tuple[Output, tuple[int, ...]]]:
        moves: list[int] = sorted(set[int]().union(*map(self.visible.__getitem__, self.closure(subset))))
        arcs, start = [], 0
        while start < len(moves):
            output = moves[start] // self.size
            base = output * self.size
            stop = bisect_left(moves, base + self.size, start)
            arcs.append((self.outputs[output], tuple([move - base for move in moves[start:stop]])))
            start = stop
        return arcs


def subset_moves(des: DES, outputs: tuple[Output, ...]) -> SubsetMoves[Any]:
    """Return the moves between sets of locations of `des`; `outputs` are all that may be seen, as they are numbered.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None), ("1", "b", "1", "β")])
    >>> moves = subset_moves(des, (Output("α"), Output("β")))
    >>> [(str(output), list(moves.members(entered))) for output, entered in moves.successors(moves.subset([1]))]
    [('α', [1]), ('β', [0])]
    """
    wide = len(des.locations) * len(outputs)
    return _Masks(des, outputs) if wide <= _WIDE else _Tuples(des, outputs)


__all__ = ["Subset", "SubsetMoves", "subset_moves"]
