"""The location observer D_O: which locations may have been entered when the last output was seen.

Subset construction on D'_H from the set of all initial locations.  There is no ε-closure after the output: a state of
D_O is an *entry estimate*, the current estimate of the textbooks is larger by what can follow silently.

In: an `OutputAutomaton`.  Out: a `LocationObserver`.  Idea: the worklist over sets of locations, closed under
silence as they come (`subsets`).
Cost: up to 2^|Q| states, hence `max_states`.  Source: Balluchi et al. (2012), section 3.1, construction step 2.
"""

from collections.abc import Iterable
from dataclasses import dataclass

from deshybrid.des.automaton import DES, Output
from deshybrid.des.cycles import persistent_nodes
from deshybrid.des.epsilon import OutputAutomaton
from deshybrid.des.subsets import Subset, SubsetMoves
from deshybrid.des.worklist import explore
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.diagnostics.pictured import Pictured


@dataclass(frozen=True, slots=True, repr=False)
class LocationObserver(Pictured):
    """D_O: `states` are entry estimates, `transitions` are (state number, output, state number).

    `persistent` are the numbers of the states that are reachable from a cycle, itself reachable from `initial`; what
    only an extra root of `build_location_observer` reaches is not among them.
    """

    states: tuple[tuple[str, ...], ...]
    initial: int
    transitions: tuple[tuple[int, Output, int], ...]
    persistent: tuple[int, ...]
    automaton: OutputAutomaton

    def to_table(self) -> dict[str, tuple[object, ...]]:
        """Return columns of equal length, one row per transition, which pandas takes as they are.

        The columns are `source` and `target`, entry estimates as tuples of names, and between them `output`, as text.
        """
        rows = [(self.states[source], str(output), self.states[target]) for source, output, target in self.transitions]
        return {name: tuple(row[place] for row in rows) for place, name in enumerate(("source", "output", "target"))}

    def __repr__(self) -> str:
        sizes = f"{len(self.states)} states, {len(self.transitions)} transitions, {len(self.persistent)} persistent"
        return f"<LocationObserver of {self.automaton.des.name}: {sizes}>"

    def __str__(self) -> str:
        shown = " ".join("{" + ",".join(state) + "}" for state in self.states)
        return f"location observer of {self.automaton.des.name}: {len(self.states)} states {shown}"


def build_location_observer(
    automaton: OutputAutomaton, *, max_states: int = 100_000, starts: tuple[tuple[str, ...], ...] = ()
) -> LocationObserver:
    """Return D_O, built from the set of all initial locations (all locations where the model names none).

    Each of `starts` is one more root, a set of locations to restart from; roots that the initial state does not reach,
    and what only they reach, are numbered after all the rest.

    Raises `LimitReached` (DH0901) beyond `max_states` states, `UsageError` (DH0404) on an unknown location in `starts`.

    >>> from deshybrid.des.epsilon import eliminate_epsilon
    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> observer = build_location_observer(eliminate_epsilon(des))
    >>> observer.states, observer.persistent
    ((('1', '2'), ('2',), ('1',)), (1, 2))
    """
    des, moves = automaton.des, automaton.subsets
    extra = [_subset(moves, des, _known(des, start, "starts")) for start in starts]
    graph = explore([_subset(moves, des, des.initial)], moves.successors, limit=max_states, what="observer states")
    persistent = persistent_nodes(graph)
    if extra:  # the states known so far go first and keep their numbers
        graph = explore([*graph.nodes, *extra], moves.successors, limit=max_states, what="observer states")
    return LocationObserver(
        states=tuple(_names(moves, des, subset) for subset in graph.nodes),
        initial=0,
        transitions=graph.arcs,
        persistent=tuple(persistent),
        automaton=automaton,
    )


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
    subsets = [_subset(moves, des, des.initial)]
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
    before = _subset(moves, des, _known(des, tuple(estimate), "estimate"))
    return _names(moves, des, _after(moves, before, output))


def _after(moves: SubsetMoves[Subset], subset: Subset, output: Output | str) -> Subset:
    text = str(output)
    return next((after for seen, after in moves.successors(subset) if str(seen) == text), moves.subset(()))


def _subset(moves: SubsetMoves[Subset], des: DES, names: Iterable[str]) -> Subset:
    wanted = set(names)
    return moves.subset([number for number, name in enumerate(des.locations) if name in wanted])


def _names(moves: SubsetMoves[Subset], des: DES, subset: Subset) -> tuple[str, ...]:
    return tuple(des.locations[number] for number in moves.members(subset))


def _known(des: DES, names: tuple[str, ...], what: str) -> set[str]:
    wanted = set(names)
    unknown = wanted.difference(des.locations)
    if unknown:
        listed = (name for name in names if name in unknown)
        raise UsageError(*(diagnostic("DH0404", f"unknown location `{name}` in `{what}`") for name in listed))
    return wanted


__all__ = ["LocationObserver", "build_location_observer", "entry_estimate_after", "entry_estimates"]
