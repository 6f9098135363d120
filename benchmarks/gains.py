"""How much shorter may stays be if gains are designed together with their forms?  `python -m benchmarks.gains`.

Systems: those of `benchmarks.dwell`, n = 3, one output, 3 locations, all transitions between them; A, C with normal
entries, poles between -0.5 and -4 1/s, some in pairs; rate 0 (as 10⁻⁶ of the slowest pole).  The start is the gain that
places these poles, the cap of every location is that gain's norm ‖G‖₂ for C with a row of length 1.  Both gains get
their required dwell time from `certify_by_inequalities`.  Numbers are medians over the systems; the last two columns
are processor seconds of the co-design and the largest share of a cap that was used.
"""

import sys
import time
from typing import NamedTuple

import numpy as np

from benchmarks.dwell import NEAR_ZERO, random_plants, slowest_pole
from deshybrid.continuous.codesign import descended, first_point
from deshybrid.continuous.codesign_step import GainPlant
from deshybrid.continuous.lmi import certify_by_inequalities

SYSTEMS = 20


class Outcome(NamedTuple):
    """Required dwell times (s) before and after, processor seconds, and the largest share of a cap."""

    before: float
    after: float
    seconds: float
    share: float


def measured(seed: int, resets: str) -> Outcome | None:
    """Return what the co-design does to one system; None where any stay was long enough from the start."""
    drawn = random_plants(seed, 3, "full", resets)
    rate = NEAR_ZERO * slowest_pole(drawn.loops(drawn.gains))
    lengths = {name: np.linalg.norm(rows, axis=1) for name, rows in drawn.C.items()}
    moved = {name: matrix + rate * np.eye(len(matrix)) for name, matrix in drawn.A.items()}
    rows = {name: C / lengths[name][:, None] for name, C in drawn.C.items()}
    plant = GainPlant(moved, rows, drawn.resets, None, {})
    start = {name: gain * lengths[name] for name, gain in drawn.gains.items()}
    caps = {name: float(np.linalg.norm(gain, 2)) for name, gain in start.items()}
    before = time.process_time()
    point = first_point(plant, start)
    found = None if point is None else descended(plant, point, caps)
    seconds = time.process_time() - before
    if found is None:
        return None
    ends = {name: gain / lengths[name] for name, gain in found.gains.items()}
    loops = [drawn.loops(gains) for gains in (drawn.gains, ends)]
    needs = [certify_by_inequalities(loop, rate=rate).required_dwell for loop in loops]
    share = max(float(np.linalg.norm(gain, 2)) / caps[name] for name, gain in found.gains.items())
    return None if needs[0] == 0 else Outcome(needs[0], needs[1], seconds, share)


def main() -> None:
    """Print one row per kind of resets; the argument is the number of systems in each (default 20)."""
    count = SYSTEMS if len(sys.argv) == 1 else int(sys.argv[1])
    print("| resets | systems | placed, s | together, s | ratio | shorter by > 1 % | longer | s each | of the cap |")
    print("|---" * 9 + "|")
    for resets in ("identity", "mild", "strong"):
        found = [measured(seed, resets) for seed in range(count)]
        rows = np.array([entry for entry in found if entry is not None])
        middle, ratios = np.median(rows, axis=0), rows[:, 1] / rows[:, 0]
        better, worse = int((ratios < 0.99).sum()), int((ratios > 1.0).sum())
        print(
            f"| {resets} | {len(rows)} of {count} | {middle[0]:.3f} | {middle[1]:.3f} | {np.median(ratios):.2f} "
            f"| {better} | {worse} | {middle[2]:.1f} | {rows[:, 3].max():.4f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
