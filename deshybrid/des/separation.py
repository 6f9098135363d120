"""Which pairs of runs look alike under which signatures, and what would separate them: the constraints of a recovery.

A pair of locations moves by two transitions that may show the same.  Under signatures such moves only disappear: each
has a fixed set of options that separate it, and is gone as soon as one of these is taken.  So the moves of the bare
system are found once, and a choice of options is a mask over them.

Options separate as finely as can be: a signature on p -> q leaves no doubt of q, so the one on p' -> q may count as
another.  A covering detector leaves a doubt where it announces both transitions of a move, so labels are compared.

Constraints (each a set of options, of which one is needed):
- C1: a persistent location is left in silence, so one of the options on that transition;
- a split: from a persistent location, transitions with a common output lead to different locations;
- a joint cycle: two runs go round in different locations and show the same.
Where a choice meets every constraint of the first two kinds, a system that is not observable has a joint cycle, since
from then on every move of a persistent location shows something (`des.pairs`).

In: a `DES` and its options.  Out: a `Separation`, from which `confusions` finds `Demand`s.
Cost: moves = pairs of transitions with a common output; each test is linear in them (strong components).
Source: Balluchi et al. (2012), Theorem 4; Davies and Bacchus (2011) for making constraints minimal.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.des.automaton import DES, Output
from deshybrid.des.candidates import Option
from deshybrid.diagnostics import LimitReached, diagnostic

MOST_MOVES = 20_000_000
Numbers: TypeAlias = NDArray[np.int64]
Mask: TypeAlias = NDArray[np.bool_]
STAYS = -1  # in place of a transition: this run does not move


class Shown(NamedTuple):
    """One step of a run: the number of the transition, and what it shows (without new signatures).

    An output that is nothing but a command stands for silence under it, None for silence under whichever.
    """

    transition: int
    output: Output | None


@dataclass(frozen=True, slots=True)
class Demand:
    """A constraint on the plan: one of `options` (numbers) is needed, and the runs that force it.

    C2: two runs that show the same under all options but these, each run part by part: up to its cycle, on the
    cycle (`cycles[r]` are positions in run r), and after it; they end in different locations.
    C1: one run, with a cycle, whose last step is silent under all options but these.
    """

    condition: Literal["C1", "C2"]
    options: frozenset[int]
    runs: tuple[tuple[Shown, ...], ...]
    cycles: tuple[tuple[int, int], ...]


@dataclass(frozen=True, slots=True, eq=False)
class Moves:
    """Joint moves: `source`, `target` are packed pairs p · |Q| + q; run 1 takes `first`, run 2 `second`, or STAYS.

    `weight`: how many options separate the move.
    """

    source: Numbers
    target: Numbers
    first: Numbers
    second: Numbers
    weight: Numbers

    def where(self, mask: Mask | Numbers) -> "Moves":
        """Return some of the moves."""
        return Moves(*(column[mask] for column in (self.source, self.target, self.first, self.second, self.weight)))


@dataclass(frozen=True, slots=True, eq=False)
class Separation:
    """The moves of a system, and which options separate them; `separation` makes it.

    `own[t]`: the option that is on transition t alone, -1 for none; `covering[c, t]`: whether covering option number
    `first_covering` + c is on t; the last column stands for STAYS.  `around`: the moves on joint cycles of the bare
    system.  `toward`: all moves, for ways from the `initial` pairs; None where every pair is initial.
    """

    des: DES
    options: tuple[Option, ...]
    own: Numbers
    covering: Mask
    around: Moves
    toward: Moves | None
    initial: Numbers

    @property
    def first_covering(self) -> int:
        """The number of the first covering option; they come last."""
        return len(self.options) - len(self.covering)

    def mask(self, chosen: Iterable[int]) -> Mask:
        """Return a choice of options as a mask."""
        mask = np.zeros(len(self.options), dtype=bool)
        mask[list(chosen)] = True
        return mask

    def open(self, moves: Moves, chosen: Mask) -> Mask:
        """Return which moves still look alike under the chosen options."""
        carried = np.append(chosen, False)[self.own]
        alike: Mask = ~(carried[moves.first] | carried[moves.second])
        covering = self.covering[chosen[self.first_covering :]]
        if len(covering):
            label = np.unique(covering, axis=1, return_inverse=True)[1].reshape(-1)
            alike &= label[moves.first] == label[moves.second]
        alike |= moves.first == moves.second
        return alike

    def separating(self, first: int, second: int) -> frozenset[int]:
        """Return the options each of which separates a move; none where both runs take the same transition."""
        if first == second:
            return frozenset()
        own = {int(self.own[first]), int(self.own[second])} - {-1}
        differing = np.flatnonzero(self.covering[:, first] ^ self.covering[:, second])
        return frozenset(own | {self.first_covering + int(c) for c in differing})


def separation(des: DES, options: tuple[Option, ...]) -> Separation:
    """Return how `options` separate the moves of `des`.

    Raises `LimitReached` (DH0901) beyond 20 million pairs of transitions with a common output.

    >>> from deshybrid.des.candidates import Candidate, options
    >>> des = DES.from_transitions([("1", "a", "1", "α"), ("2", "b", "2", "α")])
    >>> choices = options(des, (Candidate("s_1", "1", (0,)), Candidate.covering("s_any", "12", (0, 1))))
    >>> found = separation(des, choices)
    >>> [sorted(found.separating(0, 1)), sorted(found.separating(1, STAYS))]
    [[0], [1]]
    """
    own = np.full(len(des.transitions) + 1, -1, dtype=np.int64)
    covers = [option for option in options if option.covering]
    covering = np.zeros((len(covers), len(des.transitions) + 1), dtype=bool)
    for number, option in enumerate(options):
        if not option.covering:
            own[option.transitions[0]] = number
    for row, option in zip(covering, covers, strict=True):
        row[list(option.transitions)] = True
    first, second = _alike(des)
    together = _moves(des, own, covering, first, second)
    size = len(des.locations)
    initial = np.array([des.locations.index(name) for name in des.initial], dtype=np.int64)
    pairs = (initial[:, None] * size + initial[None, :]).reshape(-1)
    toward = None if len(initial) == size else _joined(together, _silent(des, own, covering))
    around = together.where(together.source // size != together.source % size)
    around = around.where(around.target // size != around.target % size)
    return Separation(des, options, own, covering, around.where(_inner(around.source, around.target)), toward, pairs)


def _alike(des: DES) -> tuple[Numbers, Numbers]:
    """All pairs of transitions that may show the same, or both nothing, under one command; in both orders."""
    groups: dict[Output, list[int]] = {}
    for number, transition in enumerate(des.transitions):
        for output in dict.fromkeys(transition.occurrences):
            groups.setdefault(output, []).append(number)
    found = sum(len(group) ** 2 for group in groups.values())
    if found > MOST_MOVES:
        text = f"there are more than {MOST_MOVES} pairs of transitions with a common output"
        raise LimitReached(diagnostic("DH0901", text, notes=(f"there are {found}",)))
    count = len(des.transitions)
    codes = [
        (np.array(group, dtype=np.int64)[:, None] * count + np.array(group, dtype=np.int64)).reshape(-1)
        for group in groups.values()
    ]
    code = np.unique(np.concatenate(codes)) if codes else np.zeros(0, dtype=np.int64)
    return code // max(count, 1), code % max(count, 1)


def _ends(des: DES) -> tuple[Numbers, Numbers]:
    number = {name: index for index, name in enumerate(des.locations)}
    source = [number[transition.source] for transition in des.transitions]
    target = [number[transition.target] for transition in des.transitions]
    return np.array(source, dtype=np.int64), np.array(target, dtype=np.int64)


def _moves(des: DES, own: Numbers, covering: Mask, first: Numbers, second: Numbers) -> Moves:
    source, target = _ends(des)
    size = len(des.locations)
    weight = (own[first] >= 0).astype(np.int64) + (own[second] >= 0)
    weight += sum((row[first] ^ row[second] for row in covering), np.zeros(len(first), dtype=np.int64))
    return Moves(source[first] * size + source[second], target[first] * size + target[second], first, second, weight)


def _silent(des: DES, own: Numbers, covering: Mask) -> Moves:
    """The moves in which one run takes a silent transition and the other one stays where it is."""
    source, target = _ends(des)
    size = len(des.locations)
    silent = np.array([n for n, t in enumerate(des.transitions) if None in t.seen], dtype=np.int64)
    taken, other = np.repeat(silent, size), np.tile(np.arange(size), len(silent))
    stays = np.full(len(taken), STAYS, dtype=np.int64)
    weight = (own[taken] >= 0) + covering[:, taken].sum(axis=0, dtype=np.int64)
    ahead = Moves(source[taken] * size + other, target[taken] * size + other, taken, stays, weight)
    behind = Moves(other * size + source[taken], other * size + target[taken], stays, taken, weight)
    return _joined(ahead, behind)


def _joined(one: Moves, other: Moves) -> Moves:
    columns = [(getattr(one, name), getattr(other, name)) for name in Moves.__slots__]
    return Moves(*(np.concatenate(column) for column in columns))


def _inner(source: Numbers, target: Numbers) -> Mask:
    """Which moves lie on a cycle."""
    from scipy.sparse import coo_array
    from scipy.sparse.csgraph import connected_components

    nodes, place = np.unique(np.concatenate((source, target)), return_inverse=True)
    start, end = place[: len(source)], place[len(source) :]
    graph = coo_array((np.ones(len(start)), (start, end)), shape=(len(nodes), len(nodes))).tocsr()
    component = connected_components(graph, directed=True, connection="strong")[1]
    inner: Mask = component[start] == component[end]
    return inner


__all__ = ["STAYS", "Demand", "Mask", "Moves", "Numbers", "Separation", "Shown", "separation"]
