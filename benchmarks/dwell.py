"""How long must stays last?  Required dwell time over the worst switching cycle found: `python -m benchmarks.dwell`.

Families: 3 locations, all transitions between them or one cycle; resets are the identity, mild (I + 0.3 N) or strong
(1.5 N), N with normal entries; rate 0 (as 10⁻⁶ of the slowest pole) or half the slowest pole; n = 3 with one output,
n = 6 with two.  A, C have normal entries, poles between -0.5 and -4 1/s, some in pairs, placed by `scipy`.  Compared:
condition (20) of Balluchi et al. (2012) as `certify` optimises it; Theorem 2 of Balluchi et al. (2003) in its corrected
form, D >= log(‖T_j R T_i⁻¹‖)/(-μ - α_i) with unit eigenvectors; matrix inequalities.  Numbers are medians and 90 %
quantiles.
"""

import sys
import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from scipy.signal import place_poles

from deshybrid.continuous.error import ErrorDynamics, ErrorReset
from deshybrid.continuous.lmi import certify_by_inequalities
from deshybrid.continuous.modes import decay_rate, modal_basis
from deshybrid.continuous.scale import best_scale
from deshybrid.continuous.search import needed_dwell, reset_norm
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.observability import sorted_spectrum

LOCATIONS = 3
NEAR_ZERO = 1e-6
RESETS: dict[str, Callable[[np.random.Generator, int], FloatArray]] = {
    "identity": lambda rng, n: np.eye(n),
    "mild": lambda rng, n: np.eye(n) + 0.3 * rng.standard_normal((n, n)),
    "strong": lambda rng, n: 1.5 * rng.standard_normal((n, n)),
}


class Ratios(NamedTuple):
    """Required dwell time over the worst cycle, by each way, and processor seconds of the last."""

    twenty: float
    theorem_2: float
    forms: float
    seconds: float


class RandomPlants(NamedTuple):
    """A (n, n), C (p, n) and the gain that places the poles, by location, and the resets."""

    A: dict[str, FloatArray]
    C: dict[str, FloatArray]
    gains: dict[str, FloatArray]
    resets: tuple[ErrorReset, ...]

    def loops(self, gains: Mapping[str, FloatArray]) -> ErrorDynamics:
        """Return the error dynamics with these gains."""
        return ErrorDynamics(tuple(self.A), {k: A - gains[k] @ self.C[k] for k, A in self.A.items()}, self.resets)


def random_observer(seed: int, n: int, graph: str, resets: str, *, locations: int = LOCATIONS) -> ErrorDynamics:
    """Return error dynamics with placed poles; the arguments are those of `random_plants`."""
    plants = random_plants(seed, n, graph, resets, locations=locations)
    return plants.loops(plants.gains)


def random_plants(seed: int, n: int, graph: str, resets: str, *, locations: int = LOCATIONS) -> RandomPlants:
    """Return plants with gains that place poles; graph: "full", "cycle", or "sparse" (a cycle with chords)."""
    rng = np.random.default_rng(seed)
    names = [f"q{k}" for k in range(locations)]
    drawn = {name: _plant(rng, n) for name in names}
    arcs = {
        "full": [(a, b) for a in names for b in names if a != b],
        "cycle": list(zip(names, names[1:] + names[:1], strict=True)),
        "sparse": [(names[k], names[(k + hop) % locations]) for k in range(locations) for hop in (1, 7)],
    }[graph]
    jumps = tuple(ErrorReset(a, b, RESETS[resets](rng, n), np.zeros(n)) for a, b in arcs)
    A, C, gains = ({name: parts[k] for name, parts in drawn.items()} for k in range(3))
    return RandomPlants(A, C, gains, jumps)


def _plant(rng: np.random.Generator, n: int) -> tuple[FloatArray, FloatArray, FloatArray]:
    A, C = rng.standard_normal((n, n)), rng.standard_normal((1 if n <= 3 else 2, n))
    poles: list[complex] = []
    while len(poles) < n:
        if n - len(poles) >= 2 and rng.random() < 0.5:
            pole = complex(-rng.uniform(0.5, 3), rng.uniform(0.3, 4))
            poles += [pole, pole.conjugate()]
        else:
            poles.append(complex(-rng.uniform(0.5, 4)))
    return A, C, np.asarray(place_poles(A.T, C.T, np.array(poles)).gain_matrix.T)


def slowest_pole(dynamics: ErrorDynamics) -> float:
    """Return the slowest decay rate of all locations, 1/s."""
    return min(-decay_rate(sorted_spectrum(F), None) for F in dynamics.matrices.values())


def by_condition_20(dynamics: ErrorDynamics, rate: float) -> float:
    """Return the dwell time that (20) asks for, with the best common scale and column lengths."""
    n = len(next(iter(dynamics.matrices.values())))
    scale = best_scale(dynamics, np.ones(n), rate)
    needs = []
    for name, F in dynamics.matrices.items():
        norm = reset_norm([reset.matrix for reset in dynamics.exits(name)], scale)
        needs.append(needed_dwell(modal_basis(F, scale), norm, rate))
    return max(needs)


def by_theorem_2(dynamics: ErrorDynamics, rate: float) -> float:
    """Return the dwell time that Theorem 2 of B03 asks for, its transformations in the order of its own proof."""
    eigen = {name: np.linalg.eig(F) for name, F in dynamics.matrices.items()}
    needs = [0.0]
    for reset in dynamics.resets:
        values, vectors = eigen[reset.source]
        moved = np.linalg.solve(eigen[reset.target][1], reset.matrix @ vectors)
        needs.append(np.log(max(1.0, np.linalg.norm(moved, 2))) / (-rate - values.real.max()))
    return max(needs)


def measured(seed: int, n: int, graph: str, resets: str, share: float) -> Ratios | None:
    """Return the ratios for one system; None where every switching contracts, so that there is nothing to divide by."""
    dynamics = random_observer(seed, n, graph, resets)
    rate = max(share, NEAR_ZERO) * slowest_pole(dynamics)
    before = time.process_time()
    found = certify_by_inequalities(dynamics, rate=rate)
    seconds = time.process_time() - before
    limit = found.limit.value
    if found.required_dwell == 0.0:
        return None
    needs = by_condition_20(dynamics, rate), by_theorem_2(dynamics, rate), found.required_dwell
    return Ratios(*(need / limit if limit else np.inf for need in needs), seconds)


def main() -> None:
    """Print one row per family; the argument is the number of systems in each (default 20 for n = 3, 5 for n = 6)."""
    counts = {3: 20, 6: 5} if len(sys.argv) == 1 else dict.fromkeys((3, 6), int(sys.argv[1]))
    print(
        "| n | graph | resets | rate | systems | (20) | Theorem 2 | matrix inequalities | s each |\n" + "|---" * 9 + "|"
    )
    for n, graph in ((n, graph) for n in counts for graph in ("full", "cycle")):
        for resets, share in ((kind, share) for kind in RESETS for share in (0.0, 0.5)):
            found = [measured(seed, n, graph, resets, share) for seed in range(counts[n])]
            rows = np.array([entry for entry in found if entry is not None])
            middle, high = np.quantile(rows, 0.5, axis=0), np.quantile(rows, 0.9, axis=0)
            shown = " | ".join(f"{middle[k]:.3g}, {high[k]:.3g}" for k in range(2))
            ours = f"{middle[2]:.3f}, {high[2]:.3f}"
            family = f"{n} | {graph} | {resets} | {share:g} | {len(rows)} of {counts[n]}"
            print(f"| {family} | {shown} | {ours} | {middle[3]:.2f} |", flush=True)
    for n, graph, locations in ((6, "full", 10), (6, "sparse", 30)):
        dynamics = random_observer(0, n, graph, "mild", locations=locations)
        before = time.process_time()
        made = certify_by_inequalities(dynamics, rate=0.5 * slowest_pole(dynamics))
        seconds = time.process_time() - before
        print(f"{locations} locations, n = {n}, {graph}: {seconds:.0f} s, gap {100 * made.gap:.1f} %", flush=True)


if __name__ == "__main__":
    main()
