"""How fast the IMM runs: the flight of section 5 of Hwang et al. (2006), 100 trials, beside FilterPy in one run.

    python -m benchmarks.filter_speed

Two modes, six states, two outputs, 150 rows.  FilterPy takes one trial at a time, the first ten of each round; what it
estimates is compared before anything is timed.  Processor seconds; FilterPy and ours take turns, so that both meet the
same load, and a ratio is the median over the rounds.
"""

import time
from collections.abc import Callable
from statistics import median

import numpy as np

from benchmarks.filters import flown, system_of
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.multiple import predict_imm, update
from deshybrid.stochastic.record import estimate
from tests.crosscheck.test_against_filterpy import filterpy_imm

ROUNDS, OTHERS = 5, 10


def seconds(work: Callable[[], object]) -> float:
    start = time.process_time()
    work()
    return time.process_time() - start


def one_at_a_time(system, z) -> Belief:
    belief = Belief.prior(system)
    for row in z:
        belief = update(system, predict_imm(system, belief), row).belief
    return belief


def main() -> None:
    system, flights = system_of("maneuver"), flown(30.0, seed=5)
    trials, rows = flights.z.shape[:2]
    made = estimate(system, flights.z)
    compiled = estimate(system, flights.z, engine="numba")  # compiles, which is not timed
    np.testing.assert_allclose(compiled.x, made.x, rtol=1e-9, atol=1e-9 * np.abs(made.x).max())
    for trial in range(OTHERS):
        mu, x, P = filterpy_imm(system, flights.z[trial])
        for ours, theirs in ((made.mu, mu), (made.x, x), (made.P, P)):
            np.testing.assert_allclose(ours[trial], theirs, rtol=1e-9, atol=1e-9 * np.abs(theirs).max())
    works = {
        "FilterPy": (OTHERS, lambda: [filterpy_imm(system, z) for z in flights.z[:OTHERS]]),
        "NumPy, one trial, row by row": (1, lambda: one_at_a_time(system, flights.z[0])),
        "NumPy, 100 trials": (trials, lambda: estimate(system, flights.z)),
        "numba, 100 trials": (trials, lambda: estimate(system, flights.z, engine="numba")),
        "numba, one trial": (1, lambda: estimate(system, flights.z[0], engine="numba")),
    }
    found: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(ROUNDS):
        for name, (count, work) in works.items():
            found[name].append(1e6 * seconds(work) / (count * rows))
    print("| filter | µs a trial and row | times as fast as FilterPy |", "|---|---|---|", sep="\n")
    for name, times in found.items():
        ratio = median(theirs / ours for theirs, ours in zip(found["FilterPy"], times, strict=True))
        print(f"| {name} | {median(times):.3g} | {ratio:.3g} |")


if __name__ == "__main__":
    main()
