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
Source: Balluchi et al. (2012), section 3.1, Theorem 4; Özveren and Willsky (1990).
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.moves import PairMoves, Pairs, ascending, distinct, member_of, ranges
from deshybrid.diagnostics import LimitReached, diagnostic

MOST_PAIRS = 40_000_000
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


def persistent_pairs(automaton: OutputAutomaton, *, limit: int = MOST_PAIRS) -> PersistentPairs:
    """Return the pairs of locations that look alike for ever.

    Raises `LimitReached` (DH0901) where more than `limit` pairs have to be looked at.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> rows = [("1", "a", "1", "α"), ("1", "b", "2", "β"), ("1", "b", "3", "β")]
    >>> pairs = persistent_pairs(eliminate_epsilon(DES.from_transitions(rows)))
    >>> list(pairs), pairs.first_confused()
    ([(0, 0), (1, 1), (1, 2), (2, 2)], (1, 2))
    """
    moves = PairMoves.of(automaton)
    depth, doubtful, roots = _roots(moves, _initial(automaton), limit)
    reached = _reach(moves, roots, limit)
    lasting, wave = _wear_down(moves, reached)
    longest = doubtful if wave is None else depth + wave
    return PersistentPairs(moves.size, lasting, longest)


def _initial(automaton: OutputAutomaton) -> Pairs:
    initial = set(automaton.des.initial)
    return np.array([n for n, name in enumerate(automaton.des.locations) if name in initial], dtype=np.int64)


def _roots(moves: PairMoves, initial: Pairs, limit: int) -> tuple[int, int | None, Pairs]:
    """Return k, the last number of outputs up to k that leaves a doubt, and the pairs that equal words of k lead to.

    `word` numbers the words of k outputs, `place` the locations that they lead to.
    """
    word, place = np.zeros_like(initial), initial
    depth, doubtful = 0, 0 if len(initial) > 1 else None
    waiting = _pairs_of(word)
    while waiting > _FEW and len(word) * moves.branching <= _MOST_MEMBERS:
        next_word, next_place = moves.after_one_more_output(word, place)
        if _pairs_of(next_word) > 0.75 * waiting:
            break
        word, place, depth = next_word, next_place, depth + 1
        waiting = _pairs_of(word)
        doubtful = depth if waiting > len(word) else doubtful
    if waiting > limit:
        raise _too_many(waiting, limit)
    last = np.searchsorted(word, word, side="right")
    here = np.arange(len(word))
    first, second = np.repeat(place, last - here), place[ranges(here, last - here)]
    roots = distinct(first * moves.size + second)
    return depth, doubtful, roots


def _pairs_of(word: Pairs) -> int:
    members = np.bincount(word) if len(word) else np.zeros(0, dtype=np.int64)
    return int((members * (members + 1) // 2).sum())


def _reach(moves: PairMoves, roots: Pairs, limit: int) -> Pairs:
    """Return all pairs that can be reached from `roots`.

    What is known is kept as a few sorted arrays, each at least twice as long as the next: adding to them is cheap.
    """
    known, frontier = [roots], roots
    while len(frontier):
        found = ascending(moves.batches(frontier))
        for part in known:
            found = found[~member_of(found, part)]
        frontier = found
        known.append(found)
        while len(known) > 1 and len(known[-2]) < 2 * len(known[-1]):
            known[-2:] = [np.sort(np.concatenate(known[-2:]))]
        if sum(map(len, known)) > limit:
            raise _too_many(sum(map(len, known)), limit)
    return np.sort(np.concatenate(known))


def _wear_down(moves: PairMoves, codes: Pairs) -> tuple[Pairs, int | None]:
    """Remove pairs without predecessor, wave by wave; return what is left, and the last wave with a doubt in it."""
    waiting_for = np.zeros(len(codes), dtype=np.int64)
    for successors in moves.batches(codes):
        found, times = np.unique(successors, return_counts=True)
        waiting_for[np.searchsorted(codes, found)] += times
    lasting = np.ones(len(codes), dtype=bool)
    front, wave, doubtful = np.flatnonzero(waiting_for == 0), 0, None
    while len(front):
        lasting[front] = False
        worn = codes[front]
        doubtful = wave if (worn // moves.size != worn % moves.size).any() else doubtful
        after = [np.zeros(0, dtype=np.int64)]
        for successors in moves.batches(worn):
            found, times = np.unique(successors, return_counts=True)
            slots = np.searchsorted(codes, found)
            waiting_for[slots] -= times
            after.append(slots[waiting_for[slots] == 0])
        front, wave = np.concatenate(after), wave + 1
    return codes[lasting], doubtful


def _too_many(found: int, limit: int) -> LimitReached:
    facts = f"{found} pairs of locations would have to be looked at"
    return LimitReached(diagnostic("DH0901", f"there are more than {limit} pairs of locations", notes=(facts,)))


__all__ = ["PersistentPairs", "persistent_pairs"]
