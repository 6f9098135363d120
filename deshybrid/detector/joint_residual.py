"""Whether a residual can stay below its release level for several samples together: a linear program.

In: a `Rival`, a strength, samples after the entry.  Out: whether some z(0), disturbance and measurement error within
their bounds, and some motion of that strength at least, keep every row of the residual within the level at all of these
samples.  The residuals are affine in these unknowns (`least_residual`); a single sample is often within reach of the
worst start where no start keeps them all.  What is known of z(0) is the interval of each H F^k z(0), and of directions
all around; a disturbance that varies within a step widens the levels.

A "no" counts only where the solver proves it, with levels widened by a millionth.
Cost: a linear program with k + N (r + p) unknowns for N samples.  Source: this project's.
"""

import numpy as np

from deshybrid.detector.least_residual import Course, Rival
from deshybrid.detector.motions import Motion
from deshybrid.linear.arrays import FloatArray

WIDER = 1.0 + 1e-6
KNOWN_OF_THE_START = 100
"""At least so many of the intervals are used."""
INFEASIBLE = 2
"""The solver's word for a linear program without a solution."""


def refuted(rival: Rival, certain: list[bool], strength: float, release: float) -> list[bool]:
    """Return at which samples a rival is inactive for certain, for `certain`, those known from single samples.

    It is active while it has never been off since the entry, or has been on for its debounce.
    """
    found, known = list(certain), next((k for k, inactive in enumerate(certain) if inactive), None)
    off = gives_up(rival, strength, release, first=0, latest=known)
    for k in range(len(certain) if off is None else off, len(certain)):
        again = range(k - rival.on_ticks + 1, k + 1)
        found[k] = found[k] or k < rival.on_ticks or not _can_be_on(rival, strength, release, again)
    return found


def gives_up(rival: Rival, strength: float, release: float, *, first: int, latest: int | None) -> int | None:
    """Return the first sample by which a rival has been inactive at `first` or since.

    `latest`: one by which it has; None, which is returned, where none is known.
    """
    if latest is None:
        return None
    begin = max(0, first - rival.on_ticks + 1)
    low, high = first - 1, latest
    while high - low > 1:
        middle = (low + high) // 2
        can = _can_be_on(rival, strength, release, range(begin, middle + 1))
        low, high = (middle, high) if can else (low, middle)
    return high


def _can_be_on(rival: Rival, strength: float, release: float, samples: range) -> bool:
    """Whether the relay may be on at all these samples; of a course that begins later the first ones are free."""
    if rival.course is None:
        return True
    lag = rival.course.generator.lag
    seen = range(max(samples.start, lag) - lag, samples.stop - lag)
    return not seen or can_stay(rival, rival.course, strength, release, seen)


def can_stay(rival: Rival, course: Course, strength: float, release: float, samples: range) -> bool:
    """Return whether the residual may be within the release level at all these samples of its course."""
    ways = ((0.0, 0.0),) if rival.motion.kind == "rest" else ((strength, 1.0), (-1.0, -strength))
    return any(_feasible(rival.motion, course, way, release, list(samples)) for way in ways)


def _feasible(
    motion: Motion, course: Course, strengths: tuple[float, float], release: float, samples: list[int]
) -> bool:
    """The unknowns: the strength, z(0), and what is pushed and heard."""
    from scipy.optimize import linprog

    k = course.over_z.shape[2]
    moved = course.over_x @ motion.state + course.over_u @ motion.input
    rows = np.hstack([moved[samples].reshape(-1, 1), _rows(course, samples)])
    within = WIDER * release + _varying(course)[samples].ravel()
    middle = course.known[samples].ravel()
    starts, sides = _starts(course, motion, max(KNOWN_OF_THE_START, samples[-1] + 1))
    padded = np.hstack([starts, np.zeros((len(starts), rows.shape[1] - k - 1))])
    answer = linprog(
        np.zeros(rows.shape[1]),
        A_ub=np.vstack([rows, -rows, padded]),
        b_ub=np.concatenate([within - middle, within + middle, sides + (WIDER - 1.0) * (1.0 + np.abs(sides))]),
        bounds=[strengths] + [(None, None)] * k + [(-1.0, 1.0)] * (rows.shape[1] - k - 1),
    )
    return bool(answer.status != INFEASIBLE)


def _starts(course: Course, motion: Motion, until: int) -> tuple[FloatArray, FloatArray]:
    """Rows over (strength, z(0)) and their largest values: the intervals of the first samples and of the directions."""
    k, T = course.over_z.shape[2], course.generator.T
    rows = np.vstack([course.over_z[:until].reshape(-1, k), course.sides])
    low, high = (
        np.concatenate([a[:until].ravel(), b]) for a, b in zip(course.carried, course.carried_sides, strict=True)
    )
    plain = np.hstack([np.zeros((len(rows), 1)), rows])
    parts, ends = [plain, -plain], [high, -low]
    if course.tracked is not None and course.tracked_sides is not None:
        both = zip(course.tracked, course.tracked_sides, strict=True)
        low, high = (np.concatenate([a[:until].ravel(), b]) + rows @ (T @ course.rest) for a, b in both)
        behind = np.hstack([-(rows @ (T @ motion.state))[:, None], rows])
        parts, ends = [*parts, behind, -behind], [*ends, high, -low]
    return np.vstack(parts), np.concatenate(ends)


def _rows(course: Course, chosen: list[int]) -> FloatArray:
    """The residuals at the chosen samples over (z(0), what was pushed and heard before, what is heard at each)."""
    count, q, k = len(chosen), *course.over_z.shape[1:]
    r, p, last = course.held.shape[2], course.heard.shape[2], chosen[-1]
    found = np.zeros((count, q, k + last * (r + p) + count * p))
    for place, tick in enumerate(chosen):
        found[place, :, :k] = course.over_z[tick]
        for before in range(tick):
            here = k + before * (r + p)
            found[place, :, here : here + r] = course.held[tick - 1 - before]
            found[place, :, here + r : here + r + p] = course.heard[tick - 1 - before]
        own = k + last * (r + p) + place * p
        found[place, :, own : own + p] = course.direct
    return found.reshape(count * q, -1)


def _varying(course: Course) -> FloatArray:
    """What disturbances that vary within their steps add at most since the entry, (K', q)."""
    return np.vstack([np.zeros((1, course.smeared.shape[1])), np.cumsum(course.smeared, axis=0)[:-1]])


__all__ = ["can_stay", "refuted"]
