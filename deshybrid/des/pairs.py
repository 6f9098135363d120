"""The pair automaton of D'_H: which two locations arbitrarily long output words lead to.

Two runs with equal outputs move as a pair: {p, q} —γ→ {p', q'} where p —γ→ p' and q —γ→ q' in D'_H.  The start is every
pair of initial locations, equal ones included, since two runs may separate late.  Two locations share a persistent
state of D_O exactly where their pair is reachable from a cycle of the pair automaton: either says that arbitrarily long
words lead to both.

There are |Q|² pairs at the start, and few of them last.  So the search starts from the pairs that some word of k
outputs leads to, with k as large as pays: every cycle is reachable from these too, and a path to a pair is k outputs
longer than its part after them.  From there on, pairs without predecessor are removed wave by wave; what is left is
persistent, and the number of the wave is the length of the longest path to a pair.

In: an `OutputAutomaton`.  Out: `PersistentPairs`.  Cost: at most |Q|² · branching² moves of pairs, in batches of packed
numbers, never the exponential observer; about 50 bytes for each pair that two equal words of k outputs lead to.
Where a limit ends the search, cycles among some pairs that were reached are cycles all the same: they prove a "no".
Source: Balluchi et al. (2012), section 3.1, Theorem 4; Özveren and Willsky (1990).
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.moves import PairMoves, Pairs, ascending, distinct, member_of, ranges
from deshybrid.diagnostics import LimitReached, check_limits, diagnostic, within

_BYTES = 50  # for each pair that is known
_SOME = 1 << 18  # pairs of a last look around, a fraction of a second
_FEW = 10_000  # so few pairs are not worth a shorter list of them
_MOST_MEMBERS = 4_000_000


@dataclass(frozen=True, slots=True, eq=False)
class PersistentPairs:
    """The pairs of location numbers that are reachable from a cycle of the pair automaton.

    `codes` ascend; the pair (p, q), p <= q, is p · `size` + q.  (q, q) is among them where q is entered visibly, for
    ever.  `longest_confusion` is the most outputs after which two locations are possible, None where that never
    happens; it has a meaning only where no pair of different locations is persistent.
    """

    size: int
    codes: Pairs
    longest_confusion: int | None

    def __iter__(self) -> Iterator[tuple[int, int]]:
        return zip((self.codes // self.size).tolist(), (self.codes % self.size).tolist(), strict=True)

    def holds(self, p: int, q: int) -> bool:
        """Return whether the pair of p <= q is persistent."""
        code = p * self.size + q
        place = int(np.searchsorted(self.codes, code))
        return place < len(self.codes) and int(self.codes[place]) == code

    def first_confused(self) -> tuple[int, int] | None:
        """Return the first persistent pair of different locations by declaration, None where there is none."""
        different = self.codes // self.size != self.codes % self.size
        if not different.any():
            return None
        p, q = divmod(int(self.codes[different.argmax()]), self.size)
        return p, q


def persistent_pairs(automaton: OutputAutomaton, *, limit: int | None = None) -> PersistentPairs:
    """Return the pairs of locations that look alike for ever.

    Raises `LimitReached` (DH0901) where more than `limit` pairs have to be looked at; `OutOfResources`.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> rows = [("1", "a", "1", "α"), ("1", "b", "2", "β"), ("1", "b", "3", "β")]
    >>> pairs = persistent_pairs(eliminate_epsilon(DES.from_transitions(rows)))
    >>> list(pairs), pairs.first_confused()
    ([(0, 0), (1, 1), (1, 2), (2, 2)], (1, 2))
    """
    with within():
        return PairSearch(automaton, limit=limit).all()


class PairSearch:
    """The search for persistent pairs; where a limit ended it, it tells how far it came and what a part of it shows.

    `seen` counts the pairs that were looked at.
    """

    def __init__(self, automaton: OutputAutomaton, *, limit: int | None = None) -> None:
        self.automaton, self.limit, self.seen = automaton, limit, 0

    @cached_property
    def _moves(self) -> PairMoves:
        return PairMoves.of(self.automaton)

    def all(self) -> PersistentPairs:
        """Return all persistent pairs; raises `LimitReached` (DH0901), `OutOfResources`."""
        words = self._words(_MOST_MEMBERS)
        self._see(words.pairs)
        roots = distinct(words.all_pairs(self._moves.size))
        reached = self._reach(roots, None)
        lasting, wave = _wear_down(self._moves, reached)
        longest = words.doubtful if wave is None else words.depth + wave
        return PersistentPairs(self._moves.size, lasting, longest)

    def some(self, most: int = _SOME) -> PersistentPairs:
        """Return pairs that are persistent whatever else there is: those that cycles among about `most` pairs lead to.

        `longest_confusion` says nothing here.

        >>> from deshybrid.des.automaton import DES
        >>> from deshybrid.des.epsilon import eliminate_epsilon
        >>> des = DES.from_transitions([("1", "a", "1", "α"), ("2", "a", "2", "α")])
        >>> list(PairSearch(eliminate_epsilon(des)).some())
        [(0, 0), (0, 1), (1, 1)]
        """
        words, size = self._words(most), self._moves.size
        roots = distinct(words.all_pairs(size) if words.pairs <= most else words.some_pairs(size)[:most])
        lasting, _ = _wear_down(self._moves, self._reach(roots, most))
        return PersistentPairs(self._moves.size, lasting, None)

    def _words(self, most_members: int) -> "_Words":
        """Return the words of k outputs, with k as large as pays."""
        moves = self._moves
        initial = set(self.automaton.des.initial)
        places = [number for number, name in enumerate(self.automaton.des.locations) if name in initial]
        place = np.array(places, dtype=np.int64)
        words = _Words(np.zeros_like(place), place, 0, 0 if len(place) > 1 else None)
        while words.pairs > _FEW and len(words.word) * moves.branching <= most_members:
            check_limits()
            longer = words.after_one_more_output(moves)
            if longer.pairs > 0.75 * words.pairs:
                break
            words = longer
        return words

    def _reach(self, roots: Pairs, most: int | None) -> Pairs:
        """Return all pairs that can be reached from `roots`, or the first of them, about `most`.

        What is known is kept as a few sorted arrays, each at least twice as long as the next: adding is cheap.
        """
        known, frontier = [roots], roots
        while len(frontier):
            found = ascending(self._moves.batches(frontier if most is None else frontier[:most]))
            for part in known:
                found = found[~member_of(found, part)]
            frontier = found
            known.append(found)
            while len(known) > 1 and len(known[-2]) < 2 * len(known[-1]):
                known[-2:] = [np.sort(np.concatenate(known[-2:]))]
            count = sum(map(len, known))
            if most is not None and count > most:
                break
            self._see(count)
        return np.sort(np.concatenate(known))

    def _see(self, count: int) -> None:
        """Raise where `count` pairs are too many to look at."""
        if self.limit is not None and count > self.limit:
            facts = f"{count} pairs of locations would have to be looked at"
            raise LimitReached(
                diagnostic("DH0901", f"there are more than {self.limit} pairs of locations", notes=(facts,))
            )
        check_limits(_BYTES * (count - self.seen))
        self.seen = max(self.seen, count)


@dataclass(frozen=True, slots=True, eq=False)
class _Words:
    """Words of `depth` outputs: `word` numbers them, in ascending order, `place` the locations that they lead to.

    `doubtful` is the last number of outputs so far that leaves a doubt, None where none does.
    """

    word: Pairs
    place: Pairs
    depth: int
    doubtful: int | None

    @property
    def pairs(self) -> int:
        """How many pairs of locations equal words lead to, counted for each word."""
        members = np.bincount(self.word) if len(self.word) else np.zeros(0, dtype=np.int64)
        return int((members * (members + 1) // 2).sum())

    def after_one_more_output(self, moves: PairMoves) -> "_Words":
        word, place = moves.after_one_more_output(self.word, self.place)
        longer = _Words(word, place, self.depth + 1, self.doubtful)
        return replace(longer, doubtful=longer.depth) if longer.pairs > len(word) else longer

    def all_pairs(self, size: int) -> Pairs:
        """The packed pairs that equal words lead to, with repetitions."""
        last = np.searchsorted(self.word, self.word, side="right")
        here = np.arange(len(self.word))
        first, second = np.repeat(self.place, last - here), self.place[ranges(here, last - here)]
        first *= size
        first += second
        return first

    def some_pairs(self, size: int) -> Pairs:
        """Neighbours of the same word first, then each location with itself: two runs may part later."""
        alike = self.word[1:] == self.word[:-1]
        neighbours: Pairs = (self.place[:-1] * size + self.place[1:])[alike]
        return np.concatenate((neighbours, self.place * size + self.place))


def _wear_down(moves: PairMoves, codes: Pairs) -> tuple[Pairs, int | None]:
    """Remove pairs without predecessor, wave by wave; return what is left, and the last wave with a doubt in it.

    Moves to pairs that are not among the ascending `codes` do not count.
    """
    waiting_for = np.zeros(len(codes), dtype=np.int64)
    for successors in moves.batches(codes):
        slots, times = _slots(codes, successors)
        waiting_for[slots] += times
    lasting = np.ones(len(codes), dtype=bool)
    front, wave, doubtful = np.flatnonzero(waiting_for == 0), 0, None
    while len(front):
        lasting[front] = False
        worn = codes[front]
        doubtful = wave if (worn // moves.size != worn % moves.size).any() else doubtful
        after = [np.zeros(0, dtype=np.int64)]
        for successors in moves.batches(worn):
            slots, times = _slots(codes, successors)
            waiting_for[slots] -= times
            after.append(slots[waiting_for[slots] == 0])
        front, wave = np.concatenate(after), wave + 1
    return codes[lasting], doubtful


def _slots(codes: Pairs, successors: Pairs) -> tuple[Pairs, Pairs]:
    """The places in `codes` of those successors that are there, and how often each occurs."""
    found, times = np.unique(successors, return_counts=True)
    slots = np.minimum(np.searchsorted(codes, found), len(codes) - 1)
    here = codes[slots] == found
    return slots[here], times[here]


__all__ = ["PairSearch", "PersistentPairs", "persistent_pairs"]
