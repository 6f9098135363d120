"""Verdicts on systems that no observer automaton fits: `python -m benchmarks.verdicts [word in the name ...]`.

Each runs in a process of its own, so that the memory is its own.  Times are processor seconds of the check alone.
"""

import math
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable
from functools import partial

from benchmarks.families import from_the_end, observable_from_the_end, observable_sparse, sparse
from deshybrid.des.automaton import DES
from deshybrid.des.observability import check_observability

SYSTEMS: dict[str, Callable[[], DES]] = {
    "100,000 locations, 5 % silent, observable": partial(observable_sparse, 100_000, silent=0.05),
    "100,000 locations, 5 % silent, not observable": partial(sparse, 100_000, silent=0.05),
    "100,000 locations, not observable by C2": partial(sparse, 100_000),
    "20,000 locations, 20 % silent, observable": partial(observable_sparse, 20_000, outputs=8, silent=0.2),
    "20,000 locations, 20 % silent, not observable": partial(sparse, 20_000, outputs=8, silent=0.2),
    "200th from the end, observable": partial(observable_from_the_end, 200),
    "200th from the end, not observable": partial(from_the_end, 200),
}
GROWTH = (1_000, 3_000, 10_000, 30_000, 100_000)


def measure(make: Callable[[], DES]) -> tuple[str, float, float]:
    """Return a row of facts about the verdict, the processor seconds, and the memory in GiB."""
    des = make()
    before = time.process_time()
    report = check_observability(des)
    seconds = time.process_time() - before
    facts = (
        "yes" if report.current_location_observable else "no",
        f"{len(report.c1_failures):,}",
        f"{len(report.c2_failures):,}",
        "" if report.transient_bound is None else str(report.transient_bound),
        report.method,
    )
    return " | ".join(facts), seconds, resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def alone(make: Callable[[], DES]) -> tuple[str, float, float]:
    """Return `measure(make)` from a new process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(measure, (make,))


def exponent(points: list[tuple[int, float]]) -> float:
    """Return the slope of the line through (log size, log time) with the least squares."""
    x, y = ([math.log(value) for value in column] for column in zip(*points, strict=True))
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    rise = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    return rise / sum((a - mean_x) ** 2 for a in x)


def main() -> None:
    """Print one row per system whose name has one of the words given, and the growth where `growth` is one of them."""
    words = sys.argv[1:] or [""]
    print(
        "| system | observable | C1 failures | C2 failures | K | method | s | GiB |\n|---|---|---|---|---|---|---|---|"
    )
    for name, make in SYSTEMS.items():
        if any(word in name for word in words):
            facts, seconds, memory = alone(make)
            print(f"| {name} | {facts} | {seconds:.1f} | {memory:.2f} |", flush=True)
    if any(word in "growth" for word in words):
        points = [(size, alone(partial(observable_sparse, size, silent=0.05))[1]) for size in GROWTH]
        print(f"\ngrowth: {points}, exponent {exponent(points):.2f}")


if __name__ == "__main__":
    main()
