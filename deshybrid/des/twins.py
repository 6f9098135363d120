"""Twin plants: two runs of a system that show the same, step by step, silent steps included.

A twin state holds the states of a left and of a right run.  Either run may move silently alone; both move together
where both show the same output.  So a path of the twin plant is two runs with equal outputs, and all such two runs are
paths of it.

In: what each side may do.  Out: a `Graph` with labels that say which side moved, and the runs along a path.
Idea: one worklist over pairs.  Cost: |L| · |R| states, times |δ|² / |Γ| moves at most; never the exponential observer.
Source: Jiang, Huang, Chandra and Kumar (2001); Yoo and Lafortune (2002).
"""

from collections.abc import Callable, Hashable, Iterable, Iterator
from dataclasses import dataclass
from itertools import chain, islice
from typing import NamedTuple, TypeAlias, TypeVar

from deshybrid.des.automaton import Output
from deshybrid.des.runs import HasTransitions, run_along
from deshybrid.des.search import explore_until
from deshybrid.des.witness import Step
from deshybrid.des.worklist import Graph

L = TypeVar("L", bound=Hashable)
R = TypeVar("R", bound=Hashable)
S = TypeVar("S")
Found = TypeVar("Found")
Ways: TypeAlias = Callable[[S], Iterable[tuple[int, Output | None, S]]]


class TwinMove(NamedTuple):
    """The transitions that the left and the right run take, None for a run that stays, and what both show."""

    left: int | None
    right: int | None
    output: Output | None


@dataclass(frozen=True, slots=True)
class TwinWitness:
    """Two runs with equal outputs.  The part of run r between the steps `cycles[r]` can be repeated for ever.

    `outputs[repeated[0]:repeated[1]]` is what both show in that part; a run may stay where it is meanwhile.
    """

    outputs: tuple[str, ...]
    runs: tuple[tuple[Step, ...], tuple[Step, ...]]
    cycles: tuple[tuple[int, int], tuple[int, int]]
    repeated: tuple[int, int]

    def __str__(self) -> str:
        lines = [f"outputs: {' '.join(self.outputs) or 'none'}"]
        for run in self.runs:
            lines.append(run[0].location + "".join(f" -{step.event}-> {step.location}" for step in run[1:]))
        return "\n".join(lines)


def search_twins(
    roots: Iterable[tuple[L, R]],
    left: Ways[L],
    right: Ways[R],
    seek: Callable[[Graph[tuple[L, R], TwinMove]], Found | None],
    *,
    limit: int | None = None,
) -> tuple[Graph[tuple[L, R], TwinMove], Found] | None:
    """Return the first part of the twin plant in which `seek` finds something, and that; None where there is nothing.

    `left` and `right` say what the two runs may do, `roots` where they start; parts grow as in `explore_until`.
    Raises `LimitReached` (DH0901) beyond `limit` pairs.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.runs import moves_from
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("1", "b", "3", "α"), ("3", "c", "4", None)], initial=["1"])
    >>> ways = moves_from(des).__getitem__
    >>> search_twins([("1", "1")], ways, ways, lambda graph: ("2", "4") in graph.nodes)[1]
    True
    """

    def onwards(pair: tuple[L, R]) -> Iterator[tuple[TwinMove, tuple[L, R]]]:
        mine, theirs = list(left(pair[0])), list(right(pair[1]))
        for number, output, target in mine:
            if output is None:
                yield TwinMove(number, None, None), (target, pair[1])
        for number, output, other in theirs:
            if output is None:
                yield TwinMove(None, number, None), (pair[0], other)
        for number, output, target in mine:
            if output is not None:
                for partner, same, other in theirs:
                    if same == output:
                        yield TwinMove(number, partner, output), (target, other)

    starts = islice(roots, None if limit is None else limit + 1)  # more would be over the limit anyway
    return explore_until(starts, onwards, seek, limit=limit, what="pairs of states")


def twin_witness(
    system: HasTransitions,
    starts: tuple[str, str],
    before: Iterable[TwinMove],
    around: Iterable[TwinMove],
    after: Iterable[TwinMove] = (),
) -> TwinWitness:
    """Return the two runs along twin moves that start in the locations `starts`; `around` is the part to repeat.

    >>> from deshybrid.des.automaton import DES
    >>> des = DES.from_transitions([("1", "a", "1", "α"), ("1", "b", "2", None)], initial=["1"])
    >>> print(twin_witness(des, ("1", "1"), [], [TwinMove(0, 0, "α")], [TwinMove(1, None, None)]))
    outputs: α
    1 -a-> 1 -b-> 2
    1 -a-> 1
    """
    parts = [list(part) for part in (before, around, after)]
    runs, cycles = [], []
    for side in (0, 1):
        numbers = [[move.right if side else move.left for move in part] for part in parts]
        taken = [[number for number in part if number is not None] for part in numbers]
        runs.append(run_along(system, starts[side], chain.from_iterable(taken)))
        cycles.append((len(taken[0]), len(taken[0]) + len(taken[1])))
    shown = [[str(move.output) for move in part if move.output is not None] for part in parts]
    return TwinWitness(
        outputs=tuple(output for part in shown for output in part),
        runs=(runs[0], runs[1]),
        cycles=(cycles[0], cycles[1]),
        repeated=(len(shown[0]), len(shown[0]) + len(shown[1])),
    )


__all__ = ["TwinMove", "TwinWitness", "Ways", "search_twins", "twin_witness"]
