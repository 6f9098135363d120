"""Many sets of locations at once: the subset construction where hundreds of sets wait for their moves.

In: the moves of a `DES` as arrays, and the part of the graph that is known.  Out: the whole graph as arrays, numbered
as the worklist numbers: the sets that wait move in their order, new ones are numbered in the order of the arcs.

Idea: a set is a run in one long array of members.  A batch moves all its members, sorts the moves by set, output and
target, and cuts them into sets.  A set has a code of 64 bits, the sum of the codes of its members; sets with the same
code are found by sorting and then compared member by member, so that a coincidence is noticed: then all is done again
with other codes.
Cost: linear in members and their moves, times the logarithm of the size of a batch.
Source: Balluchi et al. (2012), section 3.1; Zobrist (1970) for the codes.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, count, pairwise
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.des.automaton import DES, Output
from deshybrid.des.cycles import persistent_among
from deshybrid.des.moves import distinct
from deshybrid.des.subsets import SetGraph, numbered_moves
from deshybrid.des.worklist import too_many
from deshybrid.diagnostics import LimitReached, check_limits

Numbers: TypeAlias = NDArray[Any]
_BATCH = 1 << 18  # members that move at once
_BYTES = 200  # that a member takes while it moves, where few transitions leave a location and little is silent
_FLAGS = 1 << 23  # (set, location) pairs that are closed under silence at once
_FEW = 64  # members that are closed one by one: a round of array operations costs more
_SHORT = 1 << 32  # shorter numbers are sorted in half the time


@dataclass(frozen=True, slots=True, eq=False)
class Runs:
    """Rows of numbers one after the other: row i is `item[bound[i]:bound[i + 1]]`."""

    bound: Numbers
    item: Numbers

    @classmethod
    def by_row(cls, row: Numbers, item: Numbers, rows: int) -> "Runs":
        """Return the rows of `item`, given which row each belongs to."""
        size = np.bincount(row, minlength=rows)
        return cls(np.concatenate(([0], np.cumsum(size))), item[np.argsort(row, kind="stable")])

    @classmethod
    def of(cls, rows: Iterable[Iterable[int]]) -> "Runs":
        """Return `rows`, for example two of them: {3, 4} and {1}.

        >>> Runs.of([[3, 4], [1]]).bound.tolist()
        [0, 2, 3]
        """
        lists = [list(row) for row in rows]
        size = np.array([len(row) for row in lists], dtype=np.int64)
        return cls(np.concatenate(([0], np.cumsum(size))), np.array([*chain.from_iterable(lists)], dtype=np.int64))

    def __len__(self) -> int:
        return len(self.bound) - 1

    def size(self) -> Numbers:
        """Return how many items each row has."""
        return np.diff(self.bound)

    def take(self, rows: Numbers) -> tuple[Numbers, Numbers]:
        """Return how many items each of `rows` has, and these items, row after row.

        >>> [part.tolist() for part in Runs.of([[3, 4], [1]]).take(np.array([1, 0]))]
        [[1, 2], [1, 3, 4]]
        """
        first = self.bound[:-1][rows]
        size = self.bound[1:][rows] - first
        place = np.repeat(first - np.cumsum(size) + size, size)
        place += np.arange(len(place))
        return size, self.item[place]

    def lists(self) -> Iterator[list[int]]:
        """Yield the rows."""
        item, bound = self.item.tolist(), self.bound.tolist()
        return (item[start:stop] for start, stop in pairwise(bound))


@dataclass(frozen=True, slots=True, eq=False)
class ArrayMoves:
    """The moves of locations: `visible` as output · |Q| + target, `silent` as targets; None: nothing is silent.

    `closed` says whether sets are closed under silence after an output, or before it.
    """

    size: int
    outputs: int
    closed: bool
    visible: Runs
    silent: Runs | None

    @classmethod
    def of(cls, des: DES, outputs: tuple[Output, ...], *, closed: bool) -> "ArrayMoves":
        """Return the moves of `des`; `outputs` are all that may be seen, as they are numbered."""
        size = len(des.locations)
        flat = np.fromiter(chain.from_iterable(numbered_moves(des, outputs)), dtype=np.int64)
        source, output, target = flat.reshape(-1, 3).T
        seen = output >= 0
        visible = Runs.by_row(source[seen], output[seen] * size + target[seen], size)
        silent = None if seen.all() else Runs.by_row(source[~seen], target[~seen], size)
        return cls(size, max(len(outputs), 1), closed, visible, silent)

    def start(self, locations: list[int]) -> list[int]:
        """Return the set to start from, given its `locations` before any silence."""
        keys = np.array(locations, dtype=np.int64)
        found: list[int] = np.sort(self.after_silence(keys) if self.closed else keys).tolist()
        return found

    def sets_at_once(self) -> int:
        """Return how many sets may move at once: those that silence may fill with all locations need much memory."""
        return _BATCH if self.silent is None else max(1, _FLAGS // self.size)

    def move(self, sets: Runs) -> tuple[Numbers, Runs]:
        """Return the arcs that leave each of `sets`: (row of the set) · `outputs` + output, ascending, and where to."""
        row = np.repeat(np.arange(len(sets)), sets.size())
        keys = row * self.size + sets.item
        if not self.closed:
            keys = self.after_silence(keys)
            row = keys // self.size
        size, moves = self.visible.take(keys - row * self.size)
        moves += np.repeat(row * (self.size * self.outputs), size)
        if len(sets) * self.size * self.outputs < _SHORT:
            moves = moves.astype(np.uint32)
        arc, entered = self._cut(distinct(moves))
        if self.closed and self.silent is not None:
            row = np.repeat(np.arange(len(entered)), entered.size())
            place, entered = self._cut(distinct(self.after_silence(row * self.size + entered.item)))
            arc = arc[place]
        return arc, entered

    def _cut(self, keys: Numbers) -> tuple[Numbers, Runs]:
        """Ascending keys row · |Q| + location as the rows that occur, and their locations."""
        size = keys.dtype.type(self.size)
        row = keys // size
        head = np.flatnonzero(np.concatenate(([True], row[1:] != row[:-1]))) if len(row) else row
        return row[head].astype(np.int64), Runs(np.append(head, len(keys)).astype(np.int64), keys - row * size)

    def after_silence(self, keys: Numbers) -> Numbers:
        """Return `keys`, row · |Q| + location in the order of rows, and what they lead to silently, in some order."""
        if self.silent is None or not len(keys):
            return keys
        if len(keys) <= _FEW:
            return np.array(self._one_by_one(keys.tolist()), dtype=np.int64)
        step = self.sets_at_once() * self.size
        parts = []
        for start in range(0, int(keys[-1]) + 1, step):
            first, last = np.searchsorted(keys, (start, start + step))
            parts.append(self._in_rounds(keys[first:last] - start) + start)
        return np.concatenate(parts)

    def _one_by_one(self, keys: list[int]) -> list[int]:
        found = dict.fromkeys(keys)
        for key in keys:  # the list grows while it is read
            for follows in self._silently(key):
                if follows not in found:
                    found[follows] = None
                    keys.append(follows)
        return keys

    def _silently(self, key: int) -> list[int]:
        if self.silent is None:
            return []
        location = key % self.size
        start, stop = self.silent.bound[location : location + 2].tolist()
        return [key - location + int(target) for target in self.silent.item[start:stop]]

    def _in_rounds(self, front: Numbers) -> Numbers:
        if self.silent is None or not len(front):
            return front
        flags = np.zeros((int(front.max()) // self.size + 1) * self.size, dtype=bool)
        found = []
        while len(front):
            flags[front] = True
            found.append(front)
            location = front % self.size
            size, targets = self.silent.take(location)
            targets += np.repeat(front - location, size)
            front = distinct(targets[~flags[targets]])
        return np.concatenate(found)


class _SameCodeError(Exception):
    """Two different sets have the same code."""


class KnownSets:
    """Sets of locations that are numbered as they come; the members of set i are a run of one array that grows."""

    def __init__(self, size: int, salt: int) -> None:
        self._code_of = _codes(size, salt)
        self._bound, self._member = np.zeros(1024, np.int64), np.zeros(1024, np.min_scalar_type(size))
        self._codes, self._numbers = np.zeros(0, np.uint64), np.zeros(0, np.int64)
        self.count = 0

    def sets(self, start: int, stop: int) -> Runs:
        """Return the sets number `start` to `stop` - 1."""
        bound = self._bound[start : stop + 1]
        return Runs(bound - bound[0], self._member[bound[0] : bound[-1]])

    def end_of_batch(self, start: int, most: int) -> int:
        """Return where a batch of at most `most` sets ends that begins with set `start`; one set always fits."""
        stop = int(np.searchsorted(self._bound[: self.count + 1], self._bound[start] + _BATCH, side="right")) - 1
        return min(max(stop, start + 1), start + most)

    def number(self, sets: Runs) -> Numbers:
        """Return the number of each of `sets`; sets not known before are numbered in their order."""
        if not len(sets):
            return np.zeros(0, np.int64)
        sums = np.concatenate((np.zeros(1, np.uint64), np.cumsum(self._code_of[sets.item])))
        code = sums[sets.bound[1:]] - sums[sets.bound[:-1]]
        order = np.argsort(code)
        ordered = code[order]
        head = np.flatnonzero(np.concatenate(([True], ordered[1:] != ordered[:-1])))
        number = np.empty(len(code), np.int64)
        found = self._look_up(sets, ordered[head], np.minimum.reduceat(order, head))
        number[order] = np.repeat(found, np.diff(np.append(head, len(order))))
        self._compare(sets, number)
        return number

    def _look_up(self, sets: Runs, codes: Numbers, first: Numbers) -> Numbers:
        """The number of each of the ascending `codes`, where set `first[i]` is the first with the code i."""
        place = np.searchsorted(self._codes, codes)
        known = np.zeros(len(codes), dtype=bool)
        inside = place < len(self._codes)
        known[inside] = self._codes[place[inside]] == codes[inside]
        number = np.zeros(len(codes), np.int64)
        number[known] = self._numbers[place[known]]
        new = np.flatnonzero(~known)
        by_arc = new[np.argsort(first[new])]
        number[by_arc] = np.arange(self.count, self.count + len(new))
        self._codes = np.insert(self._codes, place[new], codes[new])
        self._numbers = np.insert(self._numbers, place[new], number[new])
        self._keep(*sets.take(first[by_arc]))
        return number

    def _keep(self, size: Numbers, member: Numbers) -> None:
        used = self._bound[self.count]
        self._member = _with_room(self._member, used + len(member))
        self._bound = _with_room(self._bound, self.count + len(size) + 1)
        self._member[used : used + len(member)] = member
        self._bound[self.count + 1 : self.count + 1 + len(size)] = used + np.cumsum(size)
        self.count += len(size)

    def _compare(self, sets: Runs, number: Numbers) -> None:
        size, member = self.sets(0, self.count).take(number)
        if not np.array_equal(size, sets.size()) or not np.array_equal(member, sets.item):
            raise _SameCodeError


def _codes(size: int, salt: int) -> Numbers:
    """Codes of the locations that look like chance: the mixing of Steele, Lea and Flood (2014)."""
    mixed = np.arange(salt * size + 1, (salt + 1) * size + 1, dtype=np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    mixed = (mixed ^ (mixed >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    mixed = (mixed ^ (mixed >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return mixed ^ (mixed >> np.uint64(31))


def _with_room(array: Numbers, needed: int) -> Numbers:
    if needed <= len(array):
        return array
    larger = np.zeros(max(needed, 2 * len(array)), array.dtype)
    larger[: len(array)] = array
    return larger


@dataclass(frozen=True, slots=True, eq=False)
class ArrayGraph(SetGraph):
    """A graph of sets: arc i goes from set `source[i]` with output number `output[i]` to set `target[i]`."""

    sets: Runs
    source: Numbers
    output: Numbers
    target: Numbers

    @classmethod
    def of(cls, graph: SetGraph | None, outputs: tuple[Output, ...]) -> "ArrayGraph":
        """Return a graph as arrays; None stands for the one without any set."""
        members, arcs = ([], ()) if graph is None else (graph.members(), graph.arcs(outputs))
        number = {output: index for index, output in enumerate(outputs)}
        numbers = [(source, number[output], target) for source, output, target in arcs]
        return cls(Runs.of(members), *np.array(numbers, dtype=np.int32).reshape(-1, 3).T)

    def with_sets(self, sets: list[list[int]]) -> "ArrayGraph":
        """Return the graph with more sets, which have no arcs."""
        more = Runs.of(sets)
        joined = Runs(
            np.concatenate((self.sets.bound, self.sets.bound[-1] + more.bound[1:])),
            np.concatenate((self.sets.item, more.item)),
        )
        return ArrayGraph(joined, self.source, self.output, self.target)

    def __len__(self) -> int:
        return len(self.sets)

    @property
    def arc_count(self) -> int:
        """The number of arcs."""
        return len(self.source)

    def members(self) -> Iterator[Iterable[int]]:
        """Yield the locations of each set, in ascending order."""
        return self.sets.lists()

    def arcs(self, outputs: tuple[Output, ...]) -> tuple[tuple[int, Output, int], ...]:
        """Return (set number, output, set number), grouped by the first."""
        seen = map(outputs.__getitem__, self.output.tolist())
        return tuple(zip(self.source.tolist(), seen, self.target.tolist(), strict=True))

    def persistent(self, count: int) -> list[int]:
        """Return the persistent ones of the first `count` sets."""
        among = self.source < count
        return persistent_among(count, self.source[among], self.target[among])


def explore_in_batches(moves: ArrayMoves, part: ArrayGraph, expanded: int, *, limit: int, what: str) -> ArrayGraph:
    """Return the graph of all sets that can be reached from those of `part`, of which `expanded` have their arcs.

    Sets given twice count once, if only sets without arcs are.  Raises `LimitReached` (DH0901) where the worklist does,
    and `OutOfResources` beyond the limits of `within`.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> moves = ArrayMoves.of(des, (Output("α"), Output("β")), closed=False)
    >>> start = ArrayGraph.of(None, ()).with_sets([[0, 1]])
    >>> graph = explore_in_batches(moves, start, 0, limit=10, what="states")
    >>> [*graph.sets.lists()], graph.source.tolist(), graph.output.tolist(), graph.target.tolist()
    ([[0, 1], [1], [0]], [0, 0, 1, 2], [0, 1, 1, 0], [1, 2, 2, 1])
    """
    for salt in count():
        try:
            return _explore(moves, part, KnownSets(moves.size, salt), expanded=expanded, limit=limit, what=what)
        except _SameCodeError:
            continue
    raise AssertionError("unreachable")


def _explore(
    moves: ArrayMoves, part: ArrayGraph, known: KnownSets, *, expanded: int, limit: int, what: str
) -> ArrayGraph:
    known.number(part.sets)
    arcs = [(part.source, part.output, part.target)]
    while expanded < known.count:
        before, stop = known.count, known.end_of_batch(expanded, moves.sets_at_once())
        batch = known.sets(expanded, stop)
        check_limits(_BYTES * len(batch.item))
        arc, entered = moves.move(batch)
        source = arc // moves.outputs + expanded
        target = known.number(entered)
        if known.count > limit:
            raise _limit_reached(source, target, (before, expanded, stop), limit, what)
        arcs.append((source.astype(np.int32), (arc % moves.outputs).astype(np.int32), target.astype(np.int32)))
        expanded = stop
    return ArrayGraph(known.sets(0, known.count), *(np.concatenate(column) for column in zip(*arcs, strict=True)))


def _limit_reached(
    source: Numbers, target: Numbers, batch: tuple[int, int, int], limit: int, what: str
) -> LimitReached:
    """What the worklist would have said: it counts after each set."""
    before, start, stop = batch
    highest = np.maximum.accumulate(np.concatenate(([before - 1], target)))
    found = highest[np.searchsorted(source, np.arange(start, stop), side="right")] + 1
    row = int(np.argmax(found > limit))
    return LimitReached(too_many(int(found[row]), int(found[row]) - start - row - 1, limit, what))


__all__ = ["ArrayGraph", "ArrayMoves", "KnownSets", "Runs", "explore_in_batches"]
