"""The location observer D_O: which locations may have been entered when the last output was seen.

Subset construction on D'_H from the set of all initial locations.  There is no ε-closure after the output: a state of
D_O is an *entry estimate*, the current estimate of the textbooks is larger by what can follow silently.

In: an `OutputAutomaton`.  Out: a `LocationObserver`.  Idea: sets of locations are bit masks, found by the worklist.
Cost: up to 2^|Q| states, hence `max_states`.  Source: Balluchi et al. (2012), section 3.1, construction step 2.
"""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass

from deshybrid.des.automaton import DES, Output
from deshybrid.des.cycles import persistent_nodes
from deshybrid.des.epsilon import OutputAutomaton, moves_by_location
from deshybrid.des.worklist import explore
from deshybrid.diagnostics import UsageError, diagnostic


@dataclass(frozen=True, slots=True)
class LocationObserver:
    """D_O: `states` are entry estimates, `transitions` are (state number, output, state number).

    `persistent` are the numbers of the states that are reachable from a cycle, itself reachable from `initial`; what
    only an extra root of `build_location_observer` reaches is not among them.
    """

    states: tuple[tuple[str, ...], ...]
    initial: int
    transitions: tuple[tuple[int, Output, int], ...]
    persistent: tuple[int, ...]
    automaton: OutputAutomaton

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
    des = automaton.des
    successors = _subset_moves(automaton)
    extra = [_mask(des, _known(des, start)) for start in starts]
    graph = explore([_mask(des, set(des.initial))], successors, limit=max_states, what="observer states")
    persistent = persistent_nodes(graph)
    if extra:  # the states known so far go first and keep their numbers
        graph = explore([*graph.nodes, *extra], successors, limit=max_states, what="observer states")
    outputs = automaton.outputs
    return LocationObserver(
        states=tuple(_names(des, mask) for mask in graph.nodes),
        initial=0,
        transitions=tuple((source, outputs[output], target) for source, output, target in graph.arcs),
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
    successors = _subset_moves(automaton)
    number = {str(output): index for index, output in enumerate(automaton.outputs)}
    mask = _mask(automaton.des, set(automaton.des.initial))
    masks = [mask]
    for output in outputs:
        mask = dict(successors(mask)).get(number.get(str(output), -1), 0)
        masks.append(mask)
    return tuple(_names(automaton.des, mask) for mask in masks)


def _subset_moves(automaton: OutputAutomaton) -> Callable[[int], list[tuple[int, int]]]:
    """Return the function from a bit mask of locations to its (output number, bit mask) moves, outputs ascending."""
    masks = [
        {output: _union(1 << target for target, _ in arrivals) for output, arrivals in table.items()}
        for table in moves_by_location(automaton)
    ]

    def successors(mask: int) -> list[tuple[int, int]]:
        found: dict[int, int] = {}
        for location in _bits(mask):
            for output, targets in masks[location].items():
                found[output] = found.get(output, 0) | targets
        return sorted(found.items())

    return successors


def _union(masks: Iterable[int]) -> int:
    union = 0
    for mask in masks:
        union |= mask
    return union


def _bits(mask: int) -> Iterator[int]:
    while mask:
        lowest = mask & -mask
        yield lowest.bit_length() - 1
        mask ^= lowest


def _mask(des: DES, names: set[str]) -> int:
    return _union(1 << number for number, name in enumerate(des.locations) if name in names)


def _names(des: DES, mask: int) -> tuple[str, ...]:
    return tuple(des.locations[number] for number in _bits(mask))


def _known(des: DES, start: tuple[str, ...]) -> set[str]:
    unknown = [name for name in start if name not in des.locations]
    if unknown:
        raise UsageError(*(diagnostic("DH0404", f"unknown location `{name}` in `starts`") for name in unknown))
    return set(start)


__all__ = ["LocationObserver", "build_location_observer", "entry_estimates"]
