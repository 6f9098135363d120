"""Families of discrete-event systems to measure on; a family, its parameters and a seed always give the same system."""

import random
from collections.abc import Callable

from benchmarks.plants import ring_of_trains, transfer_line
from deshybrid.des.automaton import DES
from deshybrid.des.composition import Composition

Row = tuple[str, str, str, str | None]


def sparse(locations: int, *, branching: int = 2, outputs: int = 32, silent: float = 0.0, seed: int = 1) -> DES:
    """Each location has `branching` transitions to random locations; each is silent with probability `silent`."""
    draw = random.Random(seed)
    rows: list[Row] = [
        (f"q{p}", f"e{k}", f"q{draw.randrange(locations)}", _output(draw, outputs, silent))
        for p in range(locations)
        for k in range(branching)
    ]
    return DES.from_transitions(rows, name=f"sparse {locations}")


def observable_sparse(
    locations: int, *, branching: int = 2, outputs: int = 32, silent: float = 0.0, seed: int = 1
) -> DES:
    """As `sparse`, but silent transitions occur among the first, transient locations only, and outputs never tie.

    So many locations are transient, and lead onward only, that `silent` of all transitions are silent.
    """
    draw = random.Random(seed)
    transient = int(locations * silent)
    rows: list[Row] = []
    for p in range(locations):
        seen: list[str | None] = [f"o{number}" for number in draw.sample(range(outputs), branching)]
        if p < transient:
            seen = [None] * branching
        lowest = p + 1 if p < transient else transient
        rows += [(f"q{p}", f"e{k}", f"q{draw.randrange(lowest, locations)}", seen[k]) for k in range(branching)]
    return DES.from_transitions(rows, name=f"observable sparse {locations}")


def dense(locations: int, *, branching: int = 10, outputs: int = 20, seed: int = 1) -> DES:
    """Few locations with many transitions each."""
    return sparse(locations, branching=branching, outputs=outputs, seed=seed)


def from_the_end(k: int) -> DES:
    """Was the k-th output from the end a 1?  The observer remembers the last k outputs: 2^k states, never certain."""
    rows: list[Row] = [("s0", "a", "s0", "0"), ("s0", "b", "s0", "1"), ("s0", "c", "s1", "1")]
    for number in range(1, k):
        rows += [(f"s{number}", event, f"s{number + 1}", event) for event in "01"]
    return DES.from_transitions(rows, initial=["s0"], name=f"{k}-th from the end")


def observable_from_the_end(k: int) -> DES:
    """The same memory of k outputs, unrolled over k levels that end in one last location: observable, 2^k states.

    Location `s<level>_<i>` stands for: at `level` outputs, i outputs ago there was a 1 that the system took note of.
    """
    rows: list[Row] = []
    for level in range(k):
        rows.append((f"s{level}_0", "c", f"s{level + 1}_1", "1"))
        for i in range(level + 1):
            rows += [(f"s{level}_{i}", event, f"s{level + 1}_{i + (i > 0)}", event) for event in "01"]
    rows += [(f"s{k}_{i}", "end", "end", "2") for i in range(k + 1)]
    rows.append(("end", "end", "end", "2"))
    return DES.from_transitions(rows, initial=["s0_0"], name=f"observable, {k} outputs of memory")


def ring(locations: int, *, outputs: int = 1) -> DES:
    """One cycle; with one output, nothing is ever known of the location."""
    rows: list[Row] = [(f"q{p}", "next", f"q{(p + 1) % locations}", f"o{p % outputs}") for p in range(locations)]
    return DES.from_transitions(rows, name=f"ring {locations}")


def line(locations: int) -> DES:
    """One output, again and again, up to a last location that keeps to itself."""
    rows: list[Row] = [(f"q{p}", "next", f"q{p + 1}", "o") for p in range(locations - 1)]
    return DES.from_transitions(
        [*rows, (f"q{locations - 1}", "stay", f"q{locations - 1}", "o")], name=f"line {locations}"
    )


def line_of_stations(stations: int, *, size: int = 6, alike: tuple[int, ...] = ()) -> Composition:
    """Stations in a row, each with `size` locations, hence size^stations states.

    A station works step by step, may lose a step, and when it is done hands its piece on to the next, which is empty
    then.  The stations `alike` show the same for their work.
    """
    shown = ("work" if k in alike else f"work{k}" for k in range(stations))
    return Composition(tuple(_station(k, size, text) for k, text in enumerate(shown)))


def _station(k: int, size: int, shown: str) -> DES:
    rows: list[Row] = [(str(n), f"work{k}", str(n + 1), shown) for n in range(size - 1)]
    rows += [(str(n + 1), f"lose{k}", str(n), f"lose{k}") for n in range(size - 1)]
    rows.append((str(size - 1), f"pass{k}", "0", f"pass{k}"))
    if k:
        rows.append(("0", f"pass{k - 1}", "1", None))
    return DES.from_transitions(rows, initial=["0"], name=f"station {k}")


def _output(draw: random.Random, outputs: int, silent: float) -> str | None:
    return None if draw.random() < silent else f"o{draw.randrange(outputs)}"


FAMILIES: dict[str, Callable[[], DES]] = {
    "random 1,000": lambda: sparse(1_000, branching=3, outputs=8),
    "random 1,000, 10 % silent": lambda: sparse(1_000, branching=3, outputs=12, silent=0.1),
    "random 3,000, 40 % silent": lambda: sparse(3_000, silent=0.4),
    "random 10,000, 5 % silent": lambda: sparse(10_000, silent=0.05),
    "random 400, 80 % silent": lambda: sparse(400, branching=3, silent=0.8),
    "dense 100": lambda: dense(100, branching=10, outputs=24),
    "14th from the end": lambda: from_the_end(14),
    "16th from the end": lambda: from_the_end(16),
    "line 1,000": lambda: line(1_000),
    "ring 3,000": lambda: ring(3_000, outputs=3),
    "ring of trains": ring_of_trains,
    "transfer line": transfer_line,
}
