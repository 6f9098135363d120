"""Observers by other people's automata libraries; each takes a `DES`, converts it, and counts the states it builds.

In: a `DES`.  Out: for each peer a function without arguments that builds the observer from the peer's own object and
returns the number of its states; the conversion comes before and is not part of the time.
A peer that is not installed raises `ImportError` when it is asked to prepare.

Where a peer can start in one state only, and the system in several, a state of its own leads silently to all of them.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Literal

from deshybrid.des.automaton import DES
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.observer import build_location_observer

Build = Callable[[], int]
EPSILON = 0


@dataclass(frozen=True)
class Peer:
    """`sets`: whether its states are arrival sets (silence before the output) or closed sets (silence after it)."""

    name: str
    sets: Literal["arrival", "closed"]
    prepare: Callable[[DES], Build]


def arcs(des: DES) -> Iterator[tuple[int, int, int]]:
    """Yield (source, output, target) as numbers; outputs count from 1, `EPSILON` is the silent one."""
    place = {name: number for number, name in enumerate(des.locations)}
    outputs: dict[object, int] = {None: EPSILON}
    for transition in des.transitions:
        for seen in transition.seen:
            yield place[transition.source], outputs.setdefault(seen, len(outputs)), place[transition.target]


def starts(des: DES) -> list[int]:
    """Return the numbers of the initial locations."""
    initial = set(des.initial)
    return [number for number, name in enumerate(des.locations) if name in initial]


def one_start(des: DES) -> tuple[list[tuple[int, int, int]], int]:
    """Return the arcs and the number of the only state to start in."""
    first = starts(des)
    if len(first) == 1:
        return list(arcs(des)), first[0]
    extra = len(des.locations)
    return [*arcs(des), *((extra, EPSILON, start) for start in first)], extra


def kaldifst(des: DES) -> Build:
    """Kaldi's own determinisation, which removes ε on the way."""
    import kaldifst

    moves, start = one_start(des)
    fst = kaldifst.StdVectorFst()
    for number in range(max(start + 1, len(des.locations))):
        fst.add_state()
        fst.set_final(number, 0.0)
    fst.start = start
    for source, label, target in moves:
        fst.add_arc(source, kaldifst.StdArc(label, label, 0.0, target))

    def build() -> int:
        kaldifst.determinize_star(fst)
        return int(fst.num_states)

    return build


def openfst(des: DES) -> Build:
    """OpenFst through the wrapper that pynini brings: ε-removal, then determinisation."""
    import pywrapfst

    moves, start = one_start(des)
    fst = pywrapfst.VectorFst()
    one = pywrapfst.Weight.one(fst.weight_type())
    for number in range(max(start + 1, len(des.locations))):
        fst.add_state()
        fst.set_final(number, one)
    fst.set_start(start)
    for source, label, target in moves:
        fst.add_arc(source, pywrapfst.Arc(label, label, one, target))
    return lambda: int(pywrapfst.determinize(fst.rmepsilon()).num_states())


def mata(des: DES) -> Build:
    """Mata through libmata: ε-removal where there is any, then determinisation."""
    from libmata.nfa import nfa

    automaton = nfa.Nfa(len(des.locations))
    for start in starts(des):
        automaton.make_initial_state(start)
    for number in range(len(des.locations)):
        automaton.make_final_state(number)
    silent = False
    for source, label, target in arcs(des):
        silent = silent or label == EPSILON
        automaton.add_transition(source, nfa.epsilon() if label == EPSILON else label, target)

    def build() -> int:
        visible = nfa.remove_epsilon(automaton) if silent else automaton
        return int(nfa.determinize(visible).num_of_states())

    return build


def libfaudes(des: DES) -> Build:
    """libFAUDES: natural projection, which makes the result deterministic."""
    import faudes

    moves = list(arcs(des))
    generator = faudes.Generator()
    visible = faudes.EventSet()
    for label in sorted({label for _, label, _ in moves}):
        generator.InsEvent(f"o{label}")
        if label != EPSILON:
            visible.Insert(f"o{label}")
    event = {label: generator.EventIndex(f"o{label}") for _, label, _ in moves}
    for number in range(len(des.locations)):
        generator.InsState(number + 1)
        generator.SetMarkedState(number + 1)
    for start in starts(des):
        generator.SetInitState(start + 1)
    for source, label, target in moves:
        generator.SetTransition(source + 1, event[label], target + 1)

    def build() -> int:
        if EPSILON in event:
            faudes.ProjectNonDet(generator, visible)
        return int(faudes.Deterministic(generator).Size())

    return build


def foma(des: DES) -> Build:
    """The foma library that foma-with-lib brings: determinisation, with silence on the way."""
    from ctypes import POINTER, c_char_p, c_int, c_void_p

    from foma_with_lib.foma import FSTstruct
    from foma_with_lib.foma import foma as library

    library.fsm_construct_init.restype = c_void_p
    library.fsm_construct_done.restype = POINTER(FSTstruct)
    library.fsm_determinize.restype = POINTER(FSTstruct)
    library.fsm_construct_add_arc.argtypes = [c_void_p, c_int, c_int, c_char_p, c_char_p]
    library.fsm_construct_set_initial.argtypes = [c_void_p, c_int]
    library.fsm_construct_set_final.argtypes = [c_void_p, c_int]
    library.fsm_construct_done.argtypes = [c_void_p]
    handle = library.fsm_construct_init(b"observer")
    for source, label, target in arcs(des):
        symbol = b"@_EPSILON_SYMBOL_@" if label == EPSILON else b"o%d" % label
        library.fsm_construct_add_arc(handle, source, target, symbol, symbol)
    for number in range(len(des.locations)):
        library.fsm_construct_set_final(handle, number)
    for start in starts(des):
        library.fsm_construct_set_initial(handle, start)
    net = library.fsm_construct_done(handle)
    return lambda: int(library.fsm_determinize(net).contents.statecount)


def automata_lib(des: DES) -> Build:
    """automata-lib, in Python: DFA.from_nfa."""
    from automata.fa.dfa import DFA
    from automata.fa.nfa import NFA

    moves, start = one_start(des)
    table: dict[int, dict[str, set[int]]] = {number: {} for number in range(max(start + 1, len(des.locations)))}
    for source, label, target in moves:
        table[source].setdefault("" if label == EPSILON else chr(0x100 + label), set()).add(target)
    automaton = NFA(
        states=set(table),
        input_symbols={symbol for row in table.values() for symbol in row} - {""},
        transitions=table,
        initial_state=start,
        final_states=set(table),
    )
    return lambda: len(DFA.from_nfa(automaton, minify=False).states)


def entry_sets(des: DES) -> Build:
    """deshybrid, arrival sets: from a `DES` to the sets and arcs as arrays, without lists of names."""
    return lambda: len(build_location_observer(eliminate_epsilon(des), max_states=10_000_000))


def closed_sets(des: DES) -> Build:
    """deshybrid, closed sets."""
    return lambda: len(build_location_observer(eliminate_epsilon(des), max_states=10_000_000, closed=True))


OURS = (Peer("deshybrid", "arrival", entry_sets), Peer("deshybrid, closed", "closed", closed_sets))
PEERS = (
    Peer("kaldifst", "arrival", kaldifst),
    Peer("OpenFst", "arrival", openfst),
    Peer("Mata", "arrival", mata),
    Peer("libFAUDES", "arrival", libfaudes),
    Peer("foma", "closed", foma),
    Peer("automata-lib", "closed", automata_lib),
)
