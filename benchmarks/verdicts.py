"""Verdicts on systems that no observer automaton fits: `python -m benchmarks.verdicts [word in the name ...]`.

Each runs in a process of its own, so that the memory is its own.  Times are processor seconds of the check alone.
With the word `growth`, the growth of time with size is measured and kept in `growth.json`, which `growth.py` draws.
"""

import json
import multiprocessing
import resource
import sys
import time
from collections.abc import Callable, Mapping
from functools import partial
from typing import Any, TypeAlias

from benchmarks.families import (
    from_the_end,
    line_of_stations,
    observable_from_the_end,
    observable_sparse,
    sparse,
)
from benchmarks.growth import POINTS
from deshybrid.des.automaton import DES
from deshybrid.des.composed import check_composition
from deshybrid.des.composition import Composition
from deshybrid.des.observability import check_observability

Measure: TypeAlias = Callable[[Callable[[], Any]], tuple[str, float, float]]
SYSTEMS: dict[str, Callable[[], DES]] = {
    "100,000 locations, 5 % silent, observable": partial(observable_sparse, 100_000, silent=0.05),
    "100,000 locations, 5 % silent, not observable": partial(sparse, 100_000, silent=0.05),
    "100,000 locations, not observable by C2": partial(sparse, 100_000),
    "20,000 locations, 20 % silent, observable": partial(observable_sparse, 20_000, outputs=8, silent=0.2),
    "20,000 locations, 20 % silent, not observable": partial(sparse, 20_000, outputs=8, silent=0.2),
    "200th from the end, observable": partial(observable_from_the_end, 200),
    "200th from the end, not observable": partial(from_the_end, 200),
}
COMPOSITIONS: dict[str, Callable[[], Composition]] = {
    "12 stations, 6¹² states, observable": partial(line_of_stations, 12),
    "12 stations, 6¹² states, two alike, not observable": partial(line_of_stations, 12, alike=(4, 9)),
    "12 stations, 20¹² states, observable": partial(line_of_stations, 12, size=20),
    "12 stations, 20¹² states, two alike, not observable": partial(line_of_stations, 12, size=20, alike=(4, 9)),
}
SIZES = (1_000, 2_000, 5_000, 10_000, 20_000, 50_000, 100_000)


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
    return " | ".join(facts), seconds, memory()


def measure_composition(make: Callable[[], Composition]) -> tuple[str, float, float]:
    """Return the same for a composition: the answer, the largest part that was looked at or the length of the runs."""
    plant = make()
    before = time.process_time()
    report = check_composition(plant)
    seconds = time.process_time() - before
    if report.witness is None:
        facts = f"yes | parts of {max(map(len, report.parts))} of {len(plant.components)} components"
    else:
        facts = f"no | two runs of {' and '.join(str(len(run) - 1) for run in report.witness.runs)} steps"
    return facts, seconds, memory()


def memory() -> float:
    """Return the most memory that this process held, in GiB."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 2**20


def alone(how: Measure, make: Callable[[], Any]) -> tuple[str, float, float]:
    """Return `how(make)` from a new process."""
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        return pool.apply(how, (make,))


def table(systems: Mapping[str, Callable[[], Any]], how: Measure, columns: str, words: list[str]) -> None:
    """Print one row per system whose name has one of the words."""
    wanted = {name: make for name, make in systems.items() if any(word in name for word in words)}
    if wanted:
        print(f"\n| system | {columns} | s | GiB |\n|{'---|' * (columns.count('|') + 4)}")
    for name, make in wanted.items():
        facts, seconds, gib = alone(how, make)
        print(f"| {name} | {facts} | {seconds:.2f} | {gib:.2f} |", flush=True)


def measure_growth() -> None:
    """Measure the observable and the other sparse systems at all sizes, and keep the points."""
    families = {"observable": observable_sparse, "not observable": sparse}
    points = {
        name: [[size, *alone(measure, partial(family, size, silent=0.05))[1:]] for size in SIZES]
        for name, family in families.items()
    }
    POINTS.write_text(json.dumps({"columns": ["locations", "seconds", "GiB"], "points": points}, indent=1) + "\n")


def main() -> None:
    """Print the tables, all rows or those with a word of the call in their name; `growth` measures the growth."""
    words = sys.argv[1:] or [""]
    table(SYSTEMS, measure, "observable | C1 failures | C2 failures | K | method", words)
    table(COMPOSITIONS, measure_composition, "observable | by", words)
    if "growth" in words:
        measure_growth()


if __name__ == "__main__":
    main()
