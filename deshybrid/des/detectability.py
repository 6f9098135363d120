"""Detectability: whether what is seen tells the current location, always or for some words, for good or now and then.

All four are about current estimates (closed ones) along output words without end:
strong: along every word, from some number of outputs on, each estimate is one location;
weak: along some word;  periodic: of every so many estimates in a row, one is a single location.
For systems that are alive and have no silent cycle these are the definitions of Shu and Lin.  Elsewhere, words that can
go on for ever count, and for the strong form every estimate after arbitrarily many outputs, also where runs end soon.

In: a `DES`.  Out: a `DetectabilityReport`, with a word that proves the answer where a word can prove it.
Idea: the strong forms by pairs of locations, the weak forms, which are PSPACE-complete, by the observer.
Source: Shu, Lin and Ying (2007); Shu and Lin (2011), the detector; Zhang (2017), hardness.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations, islice
from typing import Any, Literal, TypeAlias

from deshybrid.des.automaton import DES, Output
from deshybrid.des.bitsets import is_single, members
from deshybrid.des.composition import Composition, unfold
from deshybrid.des.estimates import ClosedSets, closed_sets
from deshybrid.des.lassos import Lasso, find_lasso
from deshybrid.des.twins import TwinMove, TwinWitness, search_twins, twin_witness
from deshybrid.des.worklist import Graph, explore

Kind: TypeAlias = Literal["strong", "weak", "strong periodic", "weak periodic"]


@dataclass(frozen=True, slots=True)
class WordLasso:
    """An output word: `around` can be repeated for ever after `before`; what `after` adds can follow any round."""

    before: tuple[str, ...]
    around: tuple[str, ...]
    after: tuple[str, ...] = ()

    def __str__(self) -> str:
        return " ".join((*self.before, f"({' '.join(self.around)})*", *self.after))


@dataclass(frozen=True, slots=True)
class DetectabilityReport:
    """Whether a system is detectable; `word` proves a "no" of the strong forms and a "yes" of the weak forms.

    strong, no: each estimate after `before around* after` has several locations, as the two `runs` show.
    strong periodic, no: no estimate from the end of `before` on, while `around` is repeated, is a single location.
    weak, yes: all of these are single locations.  weak periodic, yes: the estimate is one location after each round.
    A "yes" of the strong forms and a "no" of the weak forms is proved by the whole search only; `word` is then None.
    """

    kind: Kind
    holds: bool
    word: WordLasso | None = None
    runs: TwinWitness | None = None


def strong_detectability(system: DES | Composition, *, max_pairs: int | None = 2_000_000) -> DetectabilityReport:
    """Return whether, from some number of outputs on, every current estimate is one location, along every word.

    Estimates after words that can have any length count, also where runs end soon after.  At most |Q|² pairs, |δ|²
    moves, of which a growing part is looked at until it holds a "no"; a composition is never built.
    Raises `LimitReached` (DH0901) beyond `max_pairs`.  Source: Shu, Lin and Ying (2007); Shu and Lin (2011).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> strong_detectability(des).holds
    True
    >>> report = strong_detectability(DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)]))
    >>> print(report.word)
    (α)*
    >>> print(report.runs)
    outputs: α
    1 -a-> 2 -b-> 1
    2 -b-> 1 -a-> 2
    """
    plant = unfold(system)
    roots = ((p, q) for i, p in enumerate(plant.initial) for q in islice(plant.initial, i, None))
    found = search_twins(roots, plant.ways, plant.ways, _lasting_doubt, limit=max_pairs)
    if found is None:
        return DetectabilityReport("strong", True)
    twins, lasso = found
    before, around, after = ([twins.arcs[arc][1] for arc in part] for part in lasso)
    first = (lasso.before or lasso.around)[0]
    runs = twin_witness(plant, twins.nodes[twins.arcs[first][0]], before, around, after)
    start, stop = runs.repeated
    word = WordLasso(runs.outputs[:start], runs.outputs[start:stop], runs.outputs[stop:])
    return DetectabilityReport("strong", False, word, runs)


def _lasting_doubt(twins: Graph[tuple[str, str], TwinMove]) -> Lasso | None:
    return find_lasso(
        twins,
        through=lambda arc: twins.arcs[arc][1].output is not None,
        goal=lambda node: twins.nodes[node][0] != twins.nodes[node][1],
    )


def weak_detectability(des: DES, *, max_states: int | None = 100_000) -> DetectabilityReport:
    """Return whether, along some word without end, every current estimate is one location from some output on.

    Up to 2^|Q| states; the problem is PSPACE-complete.  Raises `LimitReached` (DH0901) beyond `max_states`.
    Source: Shu, Lin and Ying (2007); Zhang (2017).

    >>> des = DES.from_transitions([("1", "a", "1", "α"), ("2", "a", "2", "α"), ("1", "b", "1", "β")])
    >>> print(weak_detectability(des).word)
    β (α)*
    """
    graph = _observer(closed_sets(des), max_states)
    lasso = find_lasso(graph, within=lambda node: is_single(graph.nodes[node]))
    return DetectabilityReport("weak", lasso is not None, _word(graph, lasso))


def strong_periodic_detectability(des: DES, *, max_pairs: int | None = 2_000_000) -> DetectabilityReport:
    """Return whether, along every word without end, the current estimate is one location again and again.

    That is: no word can be continued for ever with only estimates of several locations.  At most |Q|² sets of two, by
    the detector, which follows any two locations of an estimate.  Raises `LimitReached` (DH0901) beyond `max_pairs`.
    Source: Shu, Lin and Ying (2007); Shu and Lin (2011).

    >>> rows = [("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")]
    >>> des = DES.from_transitions(rows)
    >>> strong_detectability(des).holds, strong_periodic_detectability(des).holds
    (False, True)
    """
    sets = closed_sets(des)
    detector = explore(_parts(sets.initial), lambda mask: _detected(sets, mask), limit=max_pairs, what="sets of two")
    lasso = find_lasso(detector, within=lambda node: not is_single(detector.nodes[node]))
    return DetectabilityReport("strong periodic", lasso is None, _word(detector, lasso))


def weak_periodic_detectability(des: DES, *, max_states: int | None = 100_000) -> DetectabilityReport:
    """Return whether, along some word without end, the current estimate is one location again and again.

    Up to 2^|Q| states; the problem is PSPACE-complete.  Raises `LimitReached` (DH0901) beyond `max_states`.
    Source: Shu, Lin and Ying (2007); Zhang (2017).

    >>> rows = [("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")]
    >>> des = DES.from_transitions(rows, initial=["1"])
    >>> weak_detectability(des).holds
    False
    >>> print(weak_periodic_detectability(des).word)
    (α β)*
    """
    graph = _observer(closed_sets(des), max_states)
    single = [is_single(mask) for mask in graph.nodes]
    lasso = find_lasso(graph, through=lambda arc: single[graph.arcs[arc][0]], goal=single.__getitem__)
    return DetectabilityReport("weak periodic", lasso is not None, _word(graph, lasso))


def _observer(sets: ClosedSets, max_states: int | None) -> Graph[int, Output]:
    return explore([sets.initial], sets.successors, limit=max_states, what="observer states")


def _parts(mask: int) -> Iterator[int]:
    """The sets of two within a set; the set itself where it has one member."""
    if is_single(mask):
        yield mask
    for first, second in combinations(members(mask), 2):
        yield 1 << first | 1 << second


def _detected(sets: ClosedSets, mask: int) -> Iterator[tuple[Output, int]]:
    return ((output, part) for output, targets in sets.successors(mask) for part in _parts(targets))


def _word(graph: Graph[int, Any], lasso: Lasso | None) -> WordLasso | None:
    if lasso is None:
        return None
    before, around, _ = (tuple(str(graph.arcs[arc][1]) for arc in part) for part in lasso)
    return WordLasso(before, around)


__all__ = [
    "DetectabilityReport",
    "WordLasso",
    "strong_detectability",
    "strong_periodic_detectability",
    "weak_detectability",
    "weak_periodic_detectability",
]
