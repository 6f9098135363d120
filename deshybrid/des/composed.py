"""Current-location observability of a composition, decided among few of its components at a time.

By pairs of runs: a system is current-location observable exactly where no cycle of its twin plant leads to two
different states, and no reachable state has a silent self-loop.  (If C1 fails by p -> p' in silence, p' != p, the cycle
that makes p persistent, taken by both runs, leads to (p', p).  If C1 holds, all moves from a cycle on are visible, and
this is C2.)  A composition has too many pairs of states; two facts make do with those of a part S of its components.

Amid the others, S shows a "yes".  Drop what the others are, keep what they may show: whatever two runs of the whole do
that look alike, their shares in S move as two runs of S alone, where a move may also look like one of the others, which
S is not part of.  If these shares of S never differ in component i, the runs never do.  It is enough that they do not
differ after a cycle, unless the others have a cycle of events without S, during which S may wait in doubt for ever.

The others at rest, S shows a "no": runs of S alone that use only events of S are runs of the whole.

For each component S starts as that component, and grows by one that shares events with it, then outputs, until either
shows the answer; with all the components both are exact.  For components that share neither events nor outputs this
says: where two of them go on for ever, each must be known from the start on, since it may rest while another moves.

In: a `Composition`.  Out: a `CompositionReport`.  Cost: |S|-fold products, squared, instead of the whole: the largest S
decides.  A composition that no small S decides ends at a limit, undecided.
Source: the twin plant of Jiang et al. (2001); modular verification as in Contant, Lafortune and Teneketzis (2006).
"""

from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, replace
from functools import cache
from itertools import islice
from itertools import product as combinations
from typing import NamedTuple, TypeAlias

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.composition import Composition, State, unfold
from deshybrid.des.cycles import persistent_nodes
from deshybrid.des.lassos import Lasso, find_lasso
from deshybrid.des.persistence import location_graph
from deshybrid.des.runs import Plant, run_along
from deshybrid.des.search import explore_until
from deshybrid.des.twins import TwinMove, search_twins, twin_witness
from deshybrid.des.witness import Witness
from deshybrid.des.worklist import Graph
from deshybrid.diagnostics import LimitReached, OutOfResources, within

Part: TypeAlias = tuple[int, ...]
Pair: TypeAlias = tuple[State, State]
Atoms: TypeAlias = frozenset[tuple[str, str]]
_NOTHING: Atoms = frozenset()


@dataclass(frozen=True, slots=True)
class CompositionReport:
    """Whether the joint location can be known; `witness` holds two runs of the whole that prove a "no", else None.

    `parts[i]` are the numbers of the components among which component i was shown to be known in the end.
    """

    composition: Composition
    parts: tuple[Part, ...]
    witness: Witness | None = None

    @property
    def current_location_observable(self) -> bool:
        """True where C1 and C2 hold for the composition (Balluchi et al., 2012, Theorem 4)."""
        return self.witness is None


def check_composition(
    composition: Composition,
    *,
    max_pairs: int | None = 200_000,
    timeout: float | None = None,
    max_memory: int | None = None,
) -> CompositionReport:
    """Return whether `composition` is current-location observable, and two runs where it is not.

    Raises `LimitReached` where that is undecided: DH0901 where the parts that would have to be looked at have more than
    `max_pairs` pairs of states, DH0903 and DH0904 beyond `timeout` seconds and `max_memory` bytes of the process; the
    notes say for which components the answer is known.  Raises `UsageError` (DH0421) where two states would have the
    same name.

    >>> def lamp(name, seen):
    ...     return DES.from_transitions([("off", name, "on", seen), ("on", name, "off", seen)], initial=["off"])
    >>> plant = Composition(tuple(lamp(name, name) for name in "abcdefghijklmnopqrstuvwxyzäöüß"))  # 2³⁰ states
    >>> check_composition(plant).current_location_observable
    True
    >>> print(check_composition(Composition((lamp("a", "click"), lamp("b", "click")))).witness)
    outputs: click click click click click
    off.off -a-> on.off -a-> off.off -a-> on.off -a-> off.off -a-> on.off
    off.off -b-> off.on -b-> off.off -a-> on.off -a-> off.off -b-> off.on
    """
    whole, parts = _Whole(composition, max_pairs), list[Part]()
    with within(timeout=timeout, memory=max_memory):
        while len(parts) < len(composition.components):
            try:
                part, witness = _settle(whole, len(parts))
            except LimitReached as limit:
                raise _undecided(limit, len(parts)) from limit
            if witness is not None:
                return CompositionReport(composition, tuple(parts), witness)
            parts += [part] * (len(composition.components) if len(part) == len(composition.components) else 1)
    return CompositionReport(composition, tuple(parts[: len(composition.components)]))


def _undecided(limit: LimitReached, number: int) -> LimitReached:
    known = f"components known in the end: {', '.join(map(str, range(number))) or 'none'}; not decided: {number}"
    return type(limit)(*(replace(d, notes=(*d.notes, known)) for d in limit.diagnostics))


def _settle(whole: "_Whole", number: int) -> tuple[Part, Witness | None]:
    """Grow a part around one component until it shows that this component is known, or that the state is not."""
    part: Part = (number,)
    while len(part) < len(whole.components):
        too_many: LimitReached | None = None
        try:
            if not whole.leaves_doubt(part, number):
                return part, None
        except OutOfResources:
            raise
        except LimitReached as limit:
            too_many = limit
        for active in whole.worth_trying(part):
            witness = _confusion_within_limit(whole, active)
            if witness is not None:
                return part, witness
        if too_many is not None:
            raise too_many
        part = tuple(sorted((*part, whole.nearest(part))))
    return part, whole.confusion(part)


def _confusion_within_limit(whole: "_Whole", active: Part) -> Witness | None:
    try:
        return whole.confusion(active)
    except OutOfResources:
        raise
    except LimitReached:
        return None


class _Label(NamedTuple):
    """What a move of a part may show, with the shares of the others: surely these outputs, at most those, or nothing.

    Shares are compared as sets of the texts between `+`: where these differ, what is seen does.
    """

    sure: Atoms
    most: Atoms
    silent: bool

    def alike(self, other: "_Label") -> bool:
        """Whether both may show the same, and not nothing."""
        return bool(self.most and other.most) and self.sure <= other.most and other.sure <= self.most


class _PartMove(NamedTuple):
    label: _Label
    alone: bool  # nothing may be seen of it, or only what a move of the others may show as well
    target: State


class _Whole:
    """The composition, with who takes part in which event."""

    def __init__(self, composition: Composition, max_pairs: int | None) -> None:
        self.max_pairs = max_pairs
        possible = dict.fromkeys(composition.events)
        self.components = tuple(_only(component, possible) for component in composition.components)
        alphabets = [set(component.events) for component in self.components]
        self.users = {event: [i for i, known in enumerate(alphabets) if event in known] for event in possible}
        self.shown: dict[tuple[int, str], dict[Output | None, None]] = {}
        for i, component in enumerate(self.components):
            for transition in component.transitions:
                self.shown.setdefault((i, transition.event), {}).update(dict.fromkeys(transition.seen))

    def leaves_doubt(self, part: Part, number: int) -> bool:
        """Whether `part`, amid the others, may be in two states that differ in component `number`, for ever."""
        place, waits = part.index(number), bool(self._movers_without(part))
        moves = self._moves_amid(part)

        def onwards(pair: Pair) -> Iterator[tuple[bool, Pair]]:
            left, right = pair
            for move in moves(left):
                if move.alone:
                    yield move.label.silent and move.target == left, (move.target, right)
                for other in moves(right):
                    if move.label.alike(other.label):
                        yield False, (move.target, other.target)
            for other in moves(right):
                if other.alone:
                    yield False, (left, other.target)

        def doubt(twins: Graph[Pair, bool]) -> bool | None:
            differ = [left[place] != right[place] for left, right in twins.nodes]
            lasting = (waits and any(differ)) or any(silent_loop for _, silent_loop, _ in twins.arcs)
            return lasting or find_lasso(twins, goal=differ.__getitem__) is not None or None

        initial = [self.components[i].initial for i in part]
        roots = ((p, q) for p in combinations(*initial) for q in combinations(*initial))
        return explore_until(self._first(roots), onwards, doubt, limit=self.max_pairs, what=_WHAT) is not None

    def _first(self, roots: Iterator[Pair]) -> Iterator[Pair]:
        """As many as the search needs to see that there are too many."""
        return islice(roots, None if self.max_pairs is None else self.max_pairs + 1)

    def _moves_amid(self, part: Part) -> Callable[[State], list[_PartMove]]:
        """The moves of the part of a state, with what may be seen of them while the others do what they want."""
        successors = Composition(tuple(self.components[i] for i in part)).successors()
        others = [self._label(None, event, part) for event in self.users if not self._takes_part(part, event)]

        @cache
        def moves(state: State) -> list[_PartMove]:
            found: dict[_PartMove, None] = {}
            for joint, target in successors(state):
                for seen in Transition("", joint.event, "", joint.outputs, joint.signature).seen:
                    label = self._label(seen, joint.event, part)
                    found[_PartMove(label, label.silent or any(map(label.alike, others)), target)] = None
            return list(found)

        return moves

    def _label(self, seen: Output | None, event: str, part: Part) -> _Label:
        """What may be seen of `event` where the part shows `seen`."""
        sure = most = _atoms(seen)
        silent = seen is None
        for i in self.users[event]:
            if i not in part:
                choices = [_atoms(output) for output in self.shown[i, event]]
                silent = silent and _NOTHING in choices
                sure = sure.union(*choices) if len(choices) == 1 else sure
                most = most.union(*choices)
        return _Label(sure, most, silent)

    def _takes_part(self, part: Part, event: str) -> bool:
        return any(i in part for i in self.users[event])

    def _movers_without(self, part: Part) -> list[int]:
        """The components that have a cycle of events in which the part takes no part."""
        free = {event for event in self.users if not self._takes_part(part, event)}
        outside = [i for i in range(len(self.components)) if i not in part]
        return [i for i in outside if _has_cycle(_only(self.components[i], free))]

    def worth_trying(self, part: Part) -> list[Part]:
        """The part alone, with one that shows the same, and with one that can go on for ever while the part waits."""
        shown = self._texts(part)
        others = [i for i in range(len(self.components)) if i not in part and not shown.isdisjoint(self._texts((i,)))]
        others += self._movers_without(part)[:1]
        return [part, *((*part, i) for i in dict.fromkeys(others))]

    def nearest(self, part: Part) -> int:
        """A component outside: one that shares events with the part, else outputs, else one that can go on without."""
        outside = [i for i in range(len(self.components)) if i not in part]
        mine = {event for event in self.users if self._takes_part(part, event)}
        shown = self._texts(part)
        movers = self._movers_without(part)
        return min(
            outside,
            key=lambda i: (
                mine.isdisjoint(self.components[i].events),
                shown.isdisjoint(self._texts((i,))),
                i not in movers,
            ),
        )

    def _texts(self, part: Part) -> Atoms:
        shown = (seen for (i, _), outputs in self.shown.items() if i in part for seen in outputs)
        return _NOTHING.union(*map(_atoms, shown))

    def confusion(self, active: Part) -> Witness | None:
        """Two runs that prove a "no" while the components that are not `active` rest; None where there are none."""
        free = {event for event, users in self.users.items() if all(i in active for i in users)}
        resting = [replace(_only(component, ()), initial=component.initial[:1]) for component in self.components]
        moving = [_only(component, free) for component in self.components]
        chosen = (moving[i] if i in active else resting[i] for i in range(len(moving)))
        plant = unfold(Composition(tuple(chosen)))
        roots = ((p, q) for p in plant.initial for q in plant.initial)
        found = search_twins(roots, plant.ways, plant.ways, _lasting_doubt, limit=self.max_pairs)
        return None if found is None else _as_witness(plant, *found)


_WHAT = "pairs of states of a part"


def _only(component: DES, events: Container[str]) -> DES:
    return replace(component, transitions=tuple(t for t in component.transitions if t.event in events))


def _atoms(seen: Output | None) -> Atoms:
    texts = (
        () if seen is None else ((kind, text) for kind, text in zip(_KINDS, seen[:2], strict=True) if text is not None)
    )
    return frozenset((kind, atom) for kind, text in texts for atom in text.split("+"))


_KINDS = ("output", "signature")


def _has_cycle(component: DES) -> bool:
    return bool(persistent_nodes(location_graph(replace(component, initial=component.locations))))


def _lasting_doubt(twins: Graph[tuple[str, str], TwinMove]) -> Lasso | None:
    """A silent self-loop, or a cycle that leads to two different states."""
    for number, (source, move, target) in enumerate(twins.arcs):
        if source == target and move.output is None:
            return Lasso(tuple(twins.path_to(source)), (number,), ())
    return find_lasso(twins, goal=lambda node: twins.nodes[node][0] != twins.nodes[node][1])


def _as_witness(plant: Plant, twins: Graph[tuple[str, str], TwinMove], lasso: Lasso) -> Witness:
    """C1 where a run is silent on its cycle or after it; else all moves from the cycle on are visible, which is C2."""
    before, around, after = ([twins.arcs[arc][1] for arc in part] for part in lasso)
    starts = twins.nodes[twins.arcs[(lasso.before or lasso.around)[0]][0]]
    for side, start in enumerate(starts):
        if all(move[side] is None for move in around):
            continue
        for way in (around, after):
            for number, move in enumerate(way):
                if move[side] is not None and move.output is None:
                    return _c1_witness(plant, start, side, (before, around, way[: number + 1]))
    runs = twin_witness(plant, starts, before, around, after)
    return Witness("C2", runs.outputs, runs.runs, runs.cycles, runs.repeated)


def _c1_witness(plant: Plant, start: str, side: int, parts: tuple[list[TwinMove], ...]) -> Witness:
    """The run of one side through the cycle up to its silent step, and the same without that step."""
    own = [[(n, m.output) for m in part if (n := (m.left, m.right)[side]) is not None] for part in parts]
    shown = [[str(output) for _, output in part if output is not None] for part in own]
    run = run_along(plant, start, (number for part in own for number, _ in part))
    marks = (len(own[0]), len(own[0]) + len(own[1]))
    loop = run[-1].location == run[-2].location
    return Witness(
        condition="C1",
        outputs=tuple(output for part in shown for output in part),
        runs=(run,) if loop else (run, run[:-1]),
        cycles=(marks,) if loop else (marks, marks),
        repeated=(len(shown[0]), len(shown[0]) + len(shown[1])),
    )


__all__ = ["CompositionReport", "check_composition"]
