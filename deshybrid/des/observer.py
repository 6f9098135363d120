"""The location observer D_O: which locations may have been entered when the last output was seen.

Subset construction on D'_H from the set of all initial locations.  There is no ε-closure after the output: a state of
D_O is an *entry estimate*, the current estimate of the textbooks is larger by what can follow silently.  The observer
of these *closed* estimates is built on request.

In: an `OutputAutomaton`.  Out: a `LocationObserver`.  Idea: the worklist over sets of locations, closed under
silence as they come (`subsets`), set by set as long as few of them wait, then in batches (`batches`).
Cost: up to 2^|Q| states, hence `max_states`.  Source: Balluchi et al. (2012), section 3.1, construction step 2;
Cassandras and Lafortune (2021), section 2.3.4, for closed estimates.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

from deshybrid.des.automaton import DES, Output
from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.subsets import PlainGraph, SetGraph, Subset, SubsetMoves, subset_moves
from deshybrid.des.worklist import explore_while_few
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.diagnostics.pictured import Pictured

_FEW_WAITING = 128  # sets; one by one they are as fast as in a batch of this many
_LARGE = 2048  # members of the first set; one such set is a batch
_WHAT = "observer states"


@dataclass(frozen=True, eq=False, repr=False)
class LocationObserver(Pictured):
    """D_O: `states` are entry estimates (closed ones where `closed` says so); `initial` is the number of the first.

    The long tuples are made when they are first asked for; `len(observer)` and `arc_count` need none of them.
    `graph` has the sets as numbers; the first `rooted` of them can be reached from `initial`.
    """

    automaton: OutputAutomaton
    graph: SetGraph
    rooted: int
    closed: bool = False
    initial: int = 0

    @cached_property
    def states(self) -> tuple[tuple[str, ...], ...]:
        """The locations of each state, in order of declaration."""
        name = self.automaton.des.locations.__getitem__
        return tuple(tuple(map(name, members)) for members in self.graph.members())

    @cached_property
    def transitions(self) -> tuple[tuple[int, Output, int], ...]:
        """(state number, output, state number), grouped by the first."""
        return self.graph.arcs(self.automaton.outputs)

    @cached_property
    def persistent(self) -> tuple[int, ...]:
        """The numbers of the states that are reachable from a cycle, itself reachable from `initial`.

        What only an extra root of `build_location_observer` reaches is not among them.
        """
        return tuple(self.graph.persistent(self.rooted))

    @property
    def arc_count(self) -> int:
        """The number of transitions."""
        return self.graph.arc_count

    def __len__(self) -> int:
        return len(self.graph)

    def to_table(self) -> dict[str, tuple[object, ...]]:
        """Return columns of equal length, one row per transition, which pandas takes as they are.

        The columns are `source` and `target`, entry estimates as tuples of names, and between them `output`, as text.
        """
        rows = [(self.states[source], str(output), self.states[target]) for source, output, target in self.transitions]
        return {name: tuple(row[place] for row in rows) for place, name in enumerate(("source", "output", "target"))}

    def __str__(self) -> str:
        shown = " ".join("{" + ",".join(state) + "}" for state in self.states)
        return f"location observer of {self.automaton.des.name}: {len(self.states)} states {shown}"

    def __repr__(self) -> str:
        sizes = f"{len(self)} states, {self.arc_count} transitions, {len(self.persistent)} persistent"
        return f"<LocationObserver of {self.automaton.des.name}: {sizes}>"


def build_location_observer(
    automaton: OutputAutomaton,
    *,
    max_states: int = 100_000,
    starts: tuple[tuple[str, ...], ...] = (),
    closed: bool = False,
) -> LocationObserver:
    """Return D_O, built from the set of all initial locations (all locations where the model names none).

    Its states are entry estimates ("arrival sets": silence is followed before an output).  With `closed` they are the
    current estimates of the textbooks: silence is followed after an output, and from the initial set.  Both observers
    accept the same words; the closed one never has more states.
    Each of `starts` is one more root, a set of locations to restart from; roots that the initial state does not reach,
    and what only they reach, are numbered after all the rest.

    Up to 2^|Q| states.
    Raises `LimitReached` (DH0901) beyond `max_states` states, `UsageError` (DH0404) on an unknown location in `starts`.
    Source: Balluchi et al. (2012), section 3.1; Cassandras and Lafortune (2021), section 2.3.4, for closed sets.

    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β"), ("1", "c", "3", None)])
    >>> observer = build_location_observer(eliminate_epsilon(des))
    >>> observer.states, observer.persistent
    ((('1', '2', '3'), ('2',), ('1',)), (1, 2))
    >>> build_location_observer(eliminate_epsilon(des), closed=True).states
    (('1', '2', '3'), ('2',), ('1', '3'))
    """
    des = automaton.des
    more = [_numbers(des, _known(des, start, "starts")) for start in starts]
    graph = _first_graph(automaton, _numbers(des, des.initial), closed, max_states)
    rooted = len(graph)
    if more:
        graph = _with_roots(automaton, graph, more, closed, max_states)
    return LocationObserver(automaton, graph, rooted, closed)


def _first_graph(automaton: OutputAutomaton, root: list[int], closed: bool, limit: int) -> SetGraph:
    if len(root) > _LARGE:
        return _in_batches(automaton, None, 0, [root], closed=closed, limit=limit)
    moves = automaton.subsets
    if closed:
        moves = subset_moves(automaton.des, automaton.outputs, closed=True)
    return _one_by_one(automaton, moves, [moves.start(root)], limit)


def _with_roots(
    automaton: OutputAutomaton, graph: SetGraph, roots: list[list[int]], closed: bool, limit: int
) -> SetGraph:
    if not isinstance(graph, PlainGraph):
        return _in_batches(automaton, graph, len(graph), roots, closed=closed, limit=limit)
    sets = [*graph.graph.nodes, *map(graph.moves.start, roots)]  # those known so far keep their numbers
    return _one_by_one(automaton, graph.moves, sets, limit)


def _one_by_one(automaton: OutputAutomaton, moves: SubsetMoves[Any], roots: list[Any], limit: int) -> SetGraph:
    """One by one while few sets wait, in batches from then on."""
    graph, expanded = explore_while_few(roots, moves.successors, waiting=_FEW_WAITING, limit=limit, what=_WHAT)
    plain = PlainGraph(moves, graph)
    if expanded == len(plain):
        return plain
    return _in_batches(automaton, plain, expanded, [], closed=moves.closed, limit=limit)


def _in_batches(
    automaton: OutputAutomaton,
    part: SetGraph | None,
    expanded: int,
    roots: list[list[int]],
    *,
    closed: bool,
    limit: int,
) -> SetGraph:
    from deshybrid.des.batches import ArrayGraph, ArrayMoves, explore_in_batches

    moves = ArrayMoves.of(automaton.des, automaton.outputs, closed=closed)
    known = part if isinstance(part, ArrayGraph) else ArrayGraph.of(part, automaton.outputs)
    known = known.with_sets([moves.start(root) for root in roots])
    return explore_in_batches(moves, known, expanded, limit=limit, what=_WHAT)


def entry_estimates(automaton: OutputAutomaton, outputs: Iterable[Output | str]) -> tuple[tuple[str, ...], ...]:
    """Return the entry estimates along a run: the initial one, then one after each output seen.

    An output may be given as text, as `str(Output)` writes it.  An estimate is empty from the first output on that no
    location explains.

    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> entry_estimates(eliminate_epsilon(des), ["α", "β", "β"])
    (('1', '2'), ('2',), ('1',), ())
    """
    des, moves = automaton.des, automaton.subsets
    subsets = [moves.subset(_numbers(des, des.initial))]
    for output in outputs:
        subsets.append(_after(moves, subsets[-1], output))
    return tuple(_names(moves, des, subset) for subset in subsets)


def entry_estimate_after(automaton: OutputAutomaton, estimate: Iterable[str], output: Output | str) -> tuple[str, ...]:
    """Return the entry estimate after one more output: the observer on line, for systems that no D_O fits.

    `estimate` is the one before, at first the initial set; the result is empty where no location explains the output.
    Nothing of D_O is built: a step costs the moves of the locations in the estimate.  Raises `UsageError` (DH0404) on
    an unknown location.

    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> automaton = eliminate_epsilon(DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")]))
    >>> estimate = automaton.des.initial
    >>> for output in "αβ":
    ...     estimate = entry_estimate_after(automaton, estimate, output)
    ...     print(estimate)
    ('2',)
    ('1',)
    """
    des, moves = automaton.des, automaton.subsets
    before = moves.subset(_numbers(des, _known(des, tuple(estimate), "estimate")))
    return _names(moves, des, _after(moves, before, output))


def _after(moves: SubsetMoves[Subset], subset: Subset, output: Output | str) -> Subset:
    text = str(output)
    return next((after for seen, after in moves.successors(subset) if str(seen) == text), moves.subset(()))


def _numbers(des: DES, names: Iterable[str]) -> list[int]:
    wanted = set(names)
    return [number for number, name in enumerate(des.locations) if name in wanted]


def _names(moves: SubsetMoves[Subset], des: DES, subset: Subset) -> tuple[str, ...]:
    return tuple(des.locations[number] for number in moves.members(subset))


def _known(des: DES, names: tuple[str, ...], what: str) -> set[str]:
    unknown = set(names).difference(des.locations)
    if unknown:
        listed = (name for name in names if name in unknown)
        raise UsageError(*(diagnostic("DH0404", f"unknown location `{name}` in `{what}`") for name in listed))
    return set(names)


__all__ = ["LocationObserver", "build_location_observer", "entry_estimate_after", "entry_estimates"]
