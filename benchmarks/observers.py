"""Build the observers of the families and compare with plain Python sets: `python -m benchmarks.observers`.

Plain sets means what a textbook says: eliminate ε, then a subset construction on frozen sets of names.  Both must find
equally many states and arcs; that of deshybrid has names in order and persistent states besides.
Times are processor seconds, the best of three.
"""

import time
from collections.abc import Callable

from benchmarks.families import FAMILIES
from deshybrid.des.automaton import DES, Output
from deshybrid.des.epsilon import eliminate_epsilon
from deshybrid.des.observer import build_location_observer
from deshybrid.des.worklist import explore

Names = frozenset[str]


def by_plain_sets(des: DES) -> tuple[int, int]:
    """Return the number of states and arcs of D_O."""
    moves: dict[str, list[tuple[Output, str]]] = {name: [] for name in des.locations}
    for edge in eliminate_epsilon(des).edges:
        moves[edge.source].append((edge.output, edge.target))

    def successors(state: Names) -> list[tuple[Output, Names]]:
        found: dict[Output, set[str]] = {}
        for name in state:
            for output, target in moves[name]:
                found.setdefault(output, set()).add(target)
        return [(output, frozenset(entered)) for output, entered in found.items()]

    graph = explore([frozenset(des.initial)], successors)
    return len(graph.nodes), len(graph.arcs)


def by_deshybrid(des: DES) -> tuple[int, int]:
    """Return the number of states and arcs of D_O."""
    observer = build_location_observer(eliminate_epsilon(des), max_states=10_000_000)
    return len(observer.states), len(observer.transitions)


def best_of_three(build: Callable[[DES], tuple[int, int]], make: Callable[[], DES]) -> tuple[float, tuple[int, int]]:
    """Return the shortest of three times, on a new system each time, and the size that was found."""
    times = []
    for _ in range(3):
        des = make()
        before = time.process_time()
        size = build(des)
        times.append(time.process_time() - before)
    return min(times), size


def main() -> None:
    """Print one row per family."""
    print("| family | states | arcs | plain sets, s | deshybrid, s | ratio |\n|---|---|---|---|---|---|")
    for name, make in FAMILIES.items():
        plain, expected = best_of_three(by_plain_sets, make)
        ours, size = best_of_three(by_deshybrid, make)
        if size != expected:
            raise SystemExit(f"{name}: {size} by deshybrid, {expected} by plain sets")
        states, arcs = size
        print(f"| {name} | {states:,} | {arcs:,} | {plain:.2f} | {ours:.2f} | {ours / plain:.2f} |", flush=True)


if __name__ == "__main__":
    main()
