"""Output languages: deterministic and minimal automata, inclusion, equivalence, and a shortest word that tells apart.

The output language of a system holds every word that some run from the initial set shows; with `marked` locations,
every word that some run to one of them shows.

In: a `DES`.  Out: a `DeterministicAutomaton`, or whether languages are included or equal, with a shortest word that
breaks it.  Idea: the subset construction over closed estimates, minimised by refinement (Moore); inclusion by pairs of
a location of the one and a set of the other, so that only one side is determinised.
Cost: up to 2^|Q| states where a side is determinised, which no method avoids in the worst case.
Source: Hopcroft, Motwani and Ullman (2006); Moore (1956).
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from typing import Literal

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.bitsets import mask_of, members
from deshybrid.des.estimates import closed_sets
from deshybrid.des.runs import known_locations
from deshybrid.des.search import find_first, labels_to
from deshybrid.des.worklist import explore


@dataclass(frozen=True, slots=True)
class DeterministicAutomaton:
    """At most one move per state and output; a word is accepted where its moves exist and end in `accepting`.

    `states[i]` is the closed estimate that state i stands for (after minimisation, that of the first of the states that
    became one); state 0 is initial; `transitions` are (state number, output, state number), grouped by source.
    """

    states: tuple[tuple[str, ...], ...]
    transitions: tuple[tuple[int, Output, int], ...]
    accepting: tuple[int, ...]

    def accepts(self, outputs: Iterable[Output | str]) -> bool:
        """Return whether a word is in the language; an output may be given as text.

        >>> automaton = determinise(DES.from_transitions([("1", "a", "2", "α")], initial=["1"]))
        >>> automaton.accepts(["α"]), automaton.accepts(["α", "α"])
        (True, False)
        """
        table = {(source, str(output)): target for source, output, target in self.transitions}
        state: int | None = 0
        for output in outputs:
            state = None if state is None else table.get((state, str(output)))
        return state in self.accepting

    def to_des(self, *, name: str = "deterministic") -> DES:
        """Return the same as a `DES` whose locations are the state numbers, each event named as what it shows.

        >>> str(determinise(DES.from_transitions([("1", "a", "1", "α")])).to_des().transitions[0])
        '0 -α/α-> 0'
        """
        arcs = tuple(
            Transition(
                str(source),
                str(output),
                str(target),
                (output.gamma,),
                output.signature,
                commands=() if output.command is None else (output.command,),
            )
            for source, output, target in self.transitions
        )
        return DES(tuple(str(number) for number in range(len(self.states))), arcs, ("0",), name)


@dataclass(frozen=True, slots=True)
class LanguageReport:
    """Whether a relation between two output languages holds; `word` is a shortest one that breaks it, else None.

    `missing_from` says which of the two systems cannot show the word.
    """

    holds: bool
    word: tuple[str, ...] | None
    missing_from: Literal["first", "second"] | None = None


def determinise(
    des: DES, *, marked: Iterable[str] | None = None, max_states: int | None = 100_000
) -> DeterministicAutomaton:
    """Return the deterministic automaton of the output language; its states are the closed estimates.

    Accepting are the estimates with a `marked` location, all where none is given.  Up to 2^|Q| states.
    Raises `LimitReached` (DH0901) beyond `max_states`, `UsageError` (DH0404).
    Source: Hopcroft, Motwani and Ullman (2006), the subset construction.

    >>> des = DES.from_transitions([("1", "a", "1", "α"), ("1", "a", "2", "α"), ("2", "b", "1", None)], initial=["2"])
    >>> automaton = determinise(des)
    >>> automaton.states, [(source, str(output), target) for source, output, target in automaton.transitions]
    ((('1', '2'),), [(0, 'α', 0)])
    """
    goals = _marked(des, marked, "marked")
    sets = closed_sets(des)
    graph = explore([sets.initial], sets.successors, limit=max_states, what="observer states")
    accepting = tuple(number for number, mask in enumerate(graph.nodes) if mask & goals)
    return DeterministicAutomaton(tuple(sets.names(mask) for mask in graph.nodes), graph.arcs, accepting)


def minimise(automaton: DeterministicAutomaton) -> DeterministicAutomaton:
    """Return the deterministic automaton with the fewest states that accepts the same words.

    States from which nothing is accepted are dropped (the initial one stays), and so is what cannot be reached.  States
    are numbered by breadth-first search, outputs by their text, so that equal languages give equal `transitions` and
    `accepting`.  At most n rounds over all transitions.  Source: Moore (1956); Hopcroft, Motwani and Ullman (2006).

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "a", "1", "α"), ("1", "b", "3", None)], initial=["1"])
    >>> len(determinise(des).states), len(minimise(determinise(des)).states)
    (2, 1)
    """
    moves: list[list[tuple[Output, int]]] = [[] for _ in automaton.states]
    useful = _useful(automaton)
    for source, output, target in automaton.transitions:
        if target in useful:
            moves[source].append((output, target))
    kinds = _equivalent(moves, automaton.accepting)
    first = {kind: state for state, kind in reversed(list(enumerate(kinds)))}

    def onwards(state: int) -> Iterator[tuple[Output, int]]:
        return ((output, first[kinds[target]]) for output, target in sorted(moves[state], key=_text_of_output))

    graph = explore([first[kinds[0]]], onwards)
    accepted = set(automaton.accepting)
    accepting = tuple(number for number, state in enumerate(graph.nodes) if state in accepted)
    return DeterministicAutomaton(tuple(automaton.states[state] for state in graph.nodes), graph.arcs, accepting)


def _text_of_output(move: tuple[Output, int]) -> tuple[str, ...]:
    return tuple(part or "" for part in move[0])


def _useful(automaton: DeterministicAutomaton) -> set[int]:
    """The states from which something is accepted."""
    before: list[list[tuple[None, int]]] = [[] for _ in automaton.states]
    for source, _, target in automaton.transitions:
        before[target].append((None, source))
    return set(explore(automaton.accepting, before.__getitem__).nodes)


def _equivalent(moves: list[list[tuple[Output, int]]], accepting: tuple[int, ...]) -> list[int]:
    """Refine "accepts now or not" by where the outputs lead, until nothing changes (Moore)."""
    accepted = set(accepting)
    kinds, count = [int(state in accepted) for state in range(len(moves))], 0
    while len(set(kinds)) > count:
        count = len(set(kinds))
        numbers: dict[tuple[int, frozenset[tuple[Output, int]]], int] = {}
        ahead = [frozenset((output, kinds[target]) for output, target in table) for table in moves]
        kinds = [numbers.setdefault(split, len(numbers)) for split in zip(kinds, ahead, strict=True)]
    return kinds


def included(
    first: DES,
    second: DES,
    *,
    first_marked: Iterable[str] | None = None,
    second_marked: Iterable[str] | None = None,
    max_states: int | None = 1_000_000,
) -> LanguageReport:
    """Return whether every word of `first` is a word of `second`, with a shortest one that is not.

    Marked locations restrict a language to the words of runs that end there.  Up to |Q₁| · 2^|Q₂| states, found on the
    fly; the problem is PSPACE-complete.  Raises `LimitReached` (DH0901), `UsageError` (DH0404).
    Source: Hopcroft, Motwani and Ullman (2006), with only one side determinised.

    >>> one = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")], initial=["1"])
    >>> two = DES.from_transitions([("x", "a", "x", "α"), ("x", "b", "x", "β")])
    >>> included(one, two).holds, included(two, one).word
    (True, ('β',))
    """
    mine, theirs = closed_sets(first), closed_sets(second)
    goals = _marked(first, first_marked, "first_marked")
    allowed = _marked(second, second_marked, "second_marked")

    def onwards(node: tuple[int, int]) -> Iterator[tuple[Output, tuple[int, int]]]:
        location, others = node
        answers = dict(theirs.successors(others))
        for output, targets in mine.successors(1 << location):
            for target in members(targets):
                yield output, (target, answers.get(output, 0))

    def breaks(node: tuple[int, int]) -> bool:
        return bool(goals >> node[0] & 1) and not node[1] & allowed

    roots = ((location, theirs.initial) for location in members(mine.initial))
    graph, goal = find_first(roots, onwards, breaks, limit=max_states, what="states of the comparison")
    if goal is None:
        return LanguageReport(True, None)
    return LanguageReport(False, tuple(str(output) for output in labels_to(graph, goal)), "second")


def equivalent(
    first: DES,
    second: DES,
    *,
    first_marked: Iterable[str] | None = None,
    second_marked: Iterable[str] | None = None,
    max_states: int | None = 1_000_000,
) -> LanguageReport:
    """Return whether two systems show the same words, with a shortest word that only one of them shows.

    Two inclusions; cost, errors and source as for `included`.

    >>> one = DES.from_transitions([("1", "a", "1", "α")])
    >>> two = DES.from_transitions([("x", "a", "y", "α"), ("y", "s", "y", None)], initial=["x"])
    >>> equivalent(one, two)
    LanguageReport(holds=False, word=('α', 'α'), missing_from='second')
    """
    first_marks = None if first_marked is None else known_locations(first, first_marked, "first_marked")
    second_marks = None if second_marked is None else known_locations(second, second_marked, "second_marked")
    there = included(first, second, first_marked=first_marks, second_marked=second_marks, max_states=max_states)
    back = included(second, first, first_marked=second_marks, second_marked=first_marks, max_states=max_states)
    if back.word is not None and (there.word is None or len(back.word) < len(there.word)):
        return replace(back, missing_from="first")
    return there


def _marked(des: DES, marked: Iterable[str] | None, what: str) -> int:
    return mask_of(des.locations, des.locations if marked is None else known_locations(des, marked, what))


__all__ = ["DeterministicAutomaton", "LanguageReport", "determinise", "equivalent", "included", "minimise"]
