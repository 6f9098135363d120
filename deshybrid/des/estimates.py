"""Closed estimates, as in the textbooks: what is possible now, or was at the start, silent moves included.

The *current estimate* after an output word holds every location in which the system can be: those entered when the last
output was seen (`entry_estimates`), and what follows them silently.  The *initial estimate* holds every initial
location from which the word can be shown.  Both are empty after a word that the system cannot show.

In: a `DES`.  Out: estimates along a word, or the moves of the observer of closed estimates.
Idea: bit masks; silent reach is searched once a location.  Cost: |Q| · |δ| once, then |Q|² / 64 an output at most.
Source: Cassandras and Lafortune (2021); Saboori and Hadjicostis (2013) for initial-state estimates.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

from deshybrid.des.automaton import DES, Output
from deshybrid.des.bitsets import mask_of, members, names_of, union
from deshybrid.des.runs import Move, moves_from
from deshybrid.des.worklist import explore


@dataclass(frozen=True, slots=True)
class ClosedSets:
    """The observer of closed estimates, unfolded on demand: `initial` and `successors` over bit masks of locations.

    `closures[q]` is location number q with all that follows it silently; `moves[q]` says which closed set each output
    leads to from location number q, in the order of `outputs`.
    """

    des: DES
    outputs: tuple[Output, ...]
    initial: int
    closures: tuple[int, ...]
    moves: tuple[dict[int, int], ...]

    def successors(self, mask: int) -> list[tuple[Output, int]]:
        """Return what may be seen in a closed set and the closed set it leads to, in the order of `outputs`."""
        found: dict[int, int] = {}
        for location in members(mask):
            for output, targets in self.moves[location].items():
                found[output] = found.get(output, 0) | targets
        return [(self.outputs[output], targets) for output, targets in sorted(found.items())]

    def after(self, mask: int, output: Output | str) -> int:
        """Return the closed set that an output leads to, as value or as text; the empty set where it cannot be seen."""
        return next((found for seen, found in self.successors(mask) if str(seen) == str(output)), 0)

    def names(self, mask: int) -> tuple[str, ...]:
        """Return the names in a set, in order of declaration."""
        return names_of(self.des.locations, mask)


def closed_sets(des: DES) -> ClosedSets:
    """Return the observer of closed estimates, unfolded on demand, from the closed initial set.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", None)], initial=["1"])
    >>> sets = closed_sets(des)
    >>> [(str(output), sets.names(mask)) for output, mask in sets.successors(sets.initial)]
    [('α', ('1', '2'))]
    """
    moves = moves_from(des)
    seen = (output for transition in des.transitions for output in transition.seen)
    outputs = tuple(dict.fromkeys(output for output in seen if output is not None))
    number = {output: index for index, output in enumerate(outputs)}
    reach = {location: _silent_reach(des, moves, location) for location in des.locations}
    tables = []
    for location in des.locations:
        table: dict[int, int] = {}
        for _, output, target in moves[location]:
            if output is not None:
                table[number[output]] = table.get(number[output], 0) | reach[target]
        tables.append(table)
    initial = union(reach[location] for location in des.initial)
    return ClosedSets(des, outputs, initial, tuple(reach.values()), tuple(tables))


def _silent_reach(des: DES, moves: dict[str, list[Move]], start: str) -> int:
    def silent(location: str) -> Iterator[tuple[int, str]]:
        return ((number, target) for number, output, target in moves[location] if output is None)

    return mask_of(des.locations, explore([start], silent).nodes)


def current_estimates(des: DES, outputs: Iterable[Output | str]) -> tuple[tuple[str, ...], ...]:
    """Return the current estimates along a word: the one before any output, then one after each.

    An output may be given as text, as `str(Output)` writes it.  |Q|² / 64 an output at most.
    Source: Cassandras and Lafortune (2021).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "3", None), ("3", "c", "3", "γ")], initial=["1"])
    >>> current_estimates(des, ["α", "γ", "α"])
    (('1',), ('2', '3'), ('3',), ())
    """
    sets = closed_sets(des)
    return tuple(sets.names(mask) for mask in _along(sets, sets.initial, outputs))


def initial_estimates(des: DES, outputs: Iterable[Output | str]) -> tuple[tuple[str, ...], ...]:
    """Return the initial estimates along a word: which initial locations can show it, before any output, after each.

    An output may be given as text.  One current estimate for each initial location.
    Source: Saboori and Hadjicostis (2013).

    >>> des = DES.from_transitions([("1", "a", "1", "α"), ("2", "a", "3", "α"), ("3", "b", "1", "β")])
    >>> initial_estimates(des, ["α", "β"])
    (('1', '2', '3'), ('1', '2'), ('2',))
    """
    sets, word = closed_sets(des), list(outputs)
    starts = [number for number, name in enumerate(des.locations) if name in set(des.initial)]
    runs = [_along(sets, sets.closures[start], word) for start in starts]
    return tuple(
        tuple(des.locations[start] for start, run in zip(starts, runs, strict=True) if run[position])
        for position in range(len(word) + 1)
    )


def _along(sets: ClosedSets, mask: int, outputs: Iterable[Output | str]) -> list[int]:
    masks = [mask]
    for output in outputs:
        masks.append(sets.after(masks[-1], output))
    return masks


__all__ = ["ClosedSets", "closed_sets", "current_estimates", "initial_estimates"]
