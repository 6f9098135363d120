"""How far are ultimate bounds above what an adversary reaches?  `python -m benchmarks.bounds [systems]`.

The error dynamics are the families of `benchmarks.dwell`, driven by two disturbances with normal columns, each
between -1 and 1. Stays last at least 1.2 times what condition (20) asks for, the rate is half of the slowest pole.
Compared, state by state, as medians and 90 % quantiles over systems and states: (31) as printed, ‖ζ‖ <= b (infinite
where (20) fails with unit eigenvectors); the reachable sets. The adversary is `benchmarks.adversary`: a search for
the worst stays, exits and bang-bang signals; what it reaches is a lower bound of every bound.
"""

import sys
import time
from collections.abc import Mapping

import numpy as np
from scipy.linalg import expm

from benchmarks.adversary import Jump, place, worst_errors
from benchmarks.dwell import by_condition_20, random_observer, slowest_pole
from deshybrid.continuous.ellipsoids import entry_ellipsoids
from deshybrid.continuous.entrywise import Stay
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.forms import FormProblem
from deshybrid.continuous.impulse import impulse_norm
from deshybrid.continuous.lmi import shifted_dynamics
from deshybrid.continuous.mismatch import in_time
from deshybrid.continuous.modes import modal_basis
from deshybrid.continuous.reach import entry_sets, highest, seen_exits
from deshybrid.continuous.responses import Flow
from deshybrid.linear.arrays import FloatArray


def by_equation_31(dynamics: ErrorDynamics, drives: Mapping[str, FloatArray], rate: float, stay: float) -> float:
    """Return b of (31) as printed, unit eigenvectors, W the largest row sum of a drive; infinite where (20) fails."""
    kappa, reset, norm, n = {}, {}, {}, 0
    for name, F in dynamics.matrices.items():
        values, vectors = np.linalg.eig(F)
        n, kappa[name] = len(F), float(np.linalg.cond(vectors))
        reset[name] = max(float(np.linalg.norm(r.matrix, 2)) for r in dynamics.exits(name))
        if np.log(max(1.0, reset[name] * kappa[name])) / (-rate - values.real.max()) > stay:
            return float("inf")
        times = np.linspace(0, 12 / -values.real.max(), 4_000)
        power, step, total = np.eye(n), expm(F * times[1]), np.zeros((n, n))
        for _ in times:
            total, power = total + np.abs(power) * times[1], step @ power
        norm[name] = float(total.sum(axis=1).max())
    W = max(float(np.abs(drive).sum(axis=1).max()) for drive in drives.values())
    c = max(np.sqrt(n) * reset[name] * norm[name] for name in norm)
    level = c / -np.expm1(-rate * stay)
    return float(max(kappa[name] * level + np.sqrt(n) * norm[name] for name in norm) * W)


def by_reachable_sets(
    dynamics: ErrorDynamics, drives: Mapping[str, FloatArray], rate: float, stay: float
) -> FloatArray | None:
    """Return the bound of each state, started from ellipsoids; None where no forms were found."""
    forms = FormProblem(shifted_dynamics(dynamics, rate)).solve([stay] * len(dynamics.locations))
    if forms is None:
        return None
    stays = {}
    for name, F in dynamics.matrices.items():
        modes = modal_basis(F, np.ones(len(F)))
        forced = impulse_norm(modes.eigenvalues, modes.basis) @ np.abs(drives[name]).sum(axis=1)
        stays[name] = Stay(forced, modes, tuple(in_time(r.target, r.matrix) for r in dynamics.exits(name)))
    beta = dict.fromkeys(stays, stay)
    known = entry_ellipsoids(dynamics, forms.P, forms.ends, stays, beta)
    if known is None:
        return None
    flows = {name: Flow(entry.modes, drives[name], None) for name, entry in stays.items()}
    exits = {name: entry.exits for name, entry in stays.items()}
    sets = entry_sets(lambda entered: seen_exits(flows, exits, entered, beta), known, len(next(iter(drives.values()))))
    return np.max([highest(flow, stays[name].exits, sets[name], stay) for name, flow in flows.items()], axis=0)


def measured(seed: int, n: int, graph: str, resets: str) -> tuple[list[float], list[float], float] | None:
    """Return both ratios for each state and processor seconds of the second; None where there are no forms."""
    dynamics = random_observer(seed, n, graph, resets)
    rng, rate = np.random.default_rng(seed), slowest_pole(dynamics) / 2
    drives = {name: rng.standard_normal((n, 2)) for name in dynamics.locations}
    stay = 1.2 * by_condition_20(dynamics, rate) + 0.1
    before = time.process_time()
    bound = by_reachable_sets(dynamics, drives, rate, stay)
    seconds = time.process_time() - before
    if bound is None:
        return None
    places = {name: place(F, drives[name], stay) for name, F in dynamics.matrices.items()}
    reached = worst_errors(places, [Jump(r.source, r.target, r.matrix) for r in dynamics.resets], stay, bound)
    if (reached > bound * (1 + 1e-9)).any():
        raise SystemExit(f"the bound of system {seed} ({n}, {graph}, {resets}) is left: this must not be")
    printed = by_equation_31(dynamics, drives, rate, stay)
    return (printed / reached).tolist(), (bound / reached).tolist(), seconds


def main() -> None:
    """Print one row per family; the argument is the number of systems in each (default 10 for n = 3, 3 for n = 6)."""
    counts = {3: 10, 6: 3} if len(sys.argv) == 1 else dict.fromkeys((3, 6), int(sys.argv[1]))
    print("| n | graph | resets | systems | (31) | reachable sets | s each |\n" + "|---" * 7 + "|")
    for n, graph, resets in (
        (n, graph, resets) for n in counts for graph in ("full", "cycle") for resets in ("identity", "mild", "strong")
    ):
        found = [entry for seed in range(counts[n]) if (entry := measured(seed, n, graph, resets)) is not None]
        printed, sharp = ([ratio for entry in found for ratio in entry[k]] for k in (0, 1))
        cells = [
            f"{np.median(values):.3g}, {np.quantile(values, 0.9, method='higher'):.3g}" for values in (printed, sharp)
        ]
        seconds = np.mean([entry[2] for entry in found])
        print(f"| {n} | {graph} | {resets} | {len(found)} | {cells[0]} | {cells[1]} | {seconds:.1f} |", flush=True)


if __name__ == "__main__":
    main()
