"""Moves of D'_H as arrays, so that a batch of words or of pairs of locations moves at once.

In: an `OutputAutomaton`.  Out: `PairMoves`, and a few functions on sorted arrays of whole numbers.
Idea: edges sorted by source and output; what leaves a location, or a location with a given output, is one run of them.
Cost: linear in the moves that are made, times the logarithm of the number of edges.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.des.epsilon import OutputAutomaton, moves_by_location
from deshybrid.diagnostics import check_limits

Pairs: TypeAlias = NDArray[np.int64]
_BATCH = 1 << 20
_TABLE = 1 << 22  # entries of 8 bytes
_BATCH_BYTES = 64 * _BATCH


@dataclass(frozen=True, eq=False)
class PairMoves:
    """Edges by source and output; a pair (p, q), p <= q, of location numbers is packed as p · `size` + q.

    `output[e]`, `target[e]` of edge e; the edges of location p are `count[p]` from `first[p]`; a group has one source
    and one output, `group` = source · `outputs` + output, and holds `group_count` edges from `group_first`.
    """

    size: int
    outputs: int
    output: Pairs
    target: Pairs
    first: Pairs
    count: Pairs
    group: Pairs
    group_first: Pairs
    group_count: Pairs

    @classmethod
    def of(cls, automaton: OutputAutomaton) -> "PairMoves":
        """Return the moves of `automaton`."""
        size, outputs = len(automaton.des.locations), max(len(automaton.outputs), 1)
        rows = [
            (source * outputs + output, target)
            for source, table in enumerate(moves_by_location(automaton))
            for output, arrivals in table.items()
            for target, _ in arrivals
        ]
        key, target = np.array(rows, dtype=np.int64).reshape(-1, 2).T  # ascending: by source, then by output
        group, group_first, group_count = np.unique(key, return_index=True, return_counts=True)
        count = np.bincount(key // outputs, minlength=size)
        first = np.cumsum(count) - count
        return cls(size, outputs, key % outputs, target.copy(), first, count, group, group_first, group_count)

    @property
    def branching(self) -> float:
        """Moves per location, on average."""
        return len(self.target) / max(self.size, 1)

    def after_one_more_output(self, word: Pairs, place: Pairs) -> tuple[Pairs, Pairs]:
        """Return words one output longer, numbered anew, with the locations they lead to; sorted, without repetition.

        `word[i]` leads to the location `place[i]`.
        """
        count = self.count[place]
        edges = ranges(self.first[place], count)
        longer = np.repeat(word, count) * self.outputs + self.output[edges]
        number = np.unique(longer, return_inverse=True)[1]
        found = distinct(number * self.size + self.target[edges])
        return found // self.size, found % self.size

    def batches(self, codes: Pairs) -> Iterator[Pairs]:
        """Yield the pairs that `codes` move to, with repetitions, in batches of bounded work."""
        work = np.cumsum(self.count[codes // self.size])
        start = 0
        while start < len(codes):
            check_limits(_BATCH_BYTES)
            done = work[start - 1] if start else 0
            stop = max(int(np.searchsorted(work, done + _BATCH, side="right")), start + 1)
            yield self._successors(codes[start:stop])
            start = stop

    def _group_of(self, wanted: Pairs) -> Pairs:
        """Return the numbers of the groups, any number where there is none: by a table where that is small enough."""
        if self.size * self.outputs > _TABLE:
            return np.minimum(np.searchsorted(self.group, wanted), len(self.group) - 1)
        return self._table[wanted]

    @cached_property
    def _table(self) -> Pairs:
        table = np.zeros(self.size * self.outputs, dtype=np.int64)
        table[self.group] = np.arange(len(self.group))
        return table

    def _successors(self, codes: Pairs) -> Pairs:
        """For each edge of p, the edges of q with the same output."""
        if not len(self.group):
            return codes[:0]
        p, q = codes // self.size, codes % self.size
        count = self.count[p]
        edges = ranges(self.first[p], count)
        wanted = np.repeat(q, count) * self.outputs + self.output[edges]
        place = self._group_of(wanted)
        alike = self.group[place] == wanted
        place, to_p = place[alike], self.target[edges[alike]]
        times = self.group_count[place]
        to_p, to_q = np.repeat(to_p, times), self.target[ranges(self.group_first[place], times)]
        found: Pairs = np.minimum(to_p, to_q) * self.size + np.maximum(to_p, to_q)
        return found


def ranges(first: Pairs, count: Pairs) -> Pairs:
    """Return first[0], first[0] + 1, ... (`count[0]` numbers), then those of first[1], and so on.

    >>> ranges(np.array([5, 0]), np.array([2, 3])).tolist()
    [5, 6, 0, 1, 2]
    """
    before = np.cumsum(count) - count
    numbers: Pairs = np.arange(int(count.sum())) + np.repeat(first - before, count)
    return numbers


def distinct(numbers: Pairs) -> Pairs:
    """Return the numbers in ascending order, each once; faster than a hash table where they are many.

    >>> distinct(np.array([3, 1, 3])).tolist()
    [1, 3]
    """
    ordered: Pairs = np.sort(numbers)
    if len(ordered):
        ordered = ordered[np.concatenate(([True], ordered[1:] != ordered[:-1]))]
    return ordered


def ascending(batches: Iterable[Pairs]) -> Pairs:
    """Return what is in the batches in ascending order, each once."""
    parts = [distinct(batch) for batch in batches]
    return distinct(np.concatenate(parts)) if parts else np.zeros(0, dtype=np.int64)


def member_of(numbers: Pairs, ordered: Pairs) -> NDArray[np.bool_]:
    """Return which of `numbers` are in the ascending array `ordered`.

    >>> member_of(np.array([1, 4]), np.array([3, 4])).tolist()
    [False, True]
    """
    if not len(ordered):
        return np.zeros(len(numbers), dtype=bool)
    place = np.minimum(np.searchsorted(ordered, numbers), len(ordered) - 1)
    found: NDArray[np.bool_] = ordered[place] == numbers
    return found


__all__ = ["PairMoves", "Pairs", "ascending", "distinct", "member_of", "ranges"]
