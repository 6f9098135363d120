"""Propositions 4.2 to 4.4 of Hwang et al. (2006), as printed: bounds of the detection delay that do not hold.

In: a `StochasticSystem` and a switch from mode j to T.  Out: what each proposition says, None where it gives no finite
number.  They are here to be compared with `predicted_delay`, which replaces them.  What is wrong with them:

- (18), from which all follow, bounds the mean residual of the wrong filter from below by σ_min of wide matrices,
  [F_i Gx Gu] and [H_T F_T Hx Hu].  A wide matrix has a null space: no such bound exists.
- The covariances' determinants count twice (`detection_delay`).
- The wrong filter that matters most is that of j, which was right until the switch: its mean error ē_j is zero.  In
  condition 2 of 4.2 the logarithm of ‖ē_T‖/‖ē_j‖ is then infinite.
- Condition 2 of 4.2 divides by ln(σ_min(F_i)/σ_max(F_T)), which is negative almost always; the inequality then turns
  around and bounds the delay from above by nothing.
- Condition 1 of 4.2 contains the probabilities of the very row that it is to find.  (J_i >= 0 in condition 2 is "easily
  satisfied", says the paper; it is not asked.)
- Inputs that differ between the modes, all that differs in the example of section 4.3, do not occur in (16) to (20).
- 4.4 takes ratios of "any row" of Π; of the two readings the one by rows of the matrix [from, to] makes sense.

O(n³) for each pair, and a mean run.  Source: Hwang, Balakrishnan and Tomlin (2006), (16) to (22).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import floor, inf, isfinite, log

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.detection_delay import (
    SETTLED_ROWS,
    Bank,
    MeanRun,
    Truths,
    mean_run,
    proposition_4_1,
    switched,
)
from deshybrid.stochastic.mean_residual import Mismatch, mismatch
from deshybrid.stochastic.steady_state import SteadyFilter
from deshybrid.stochastic.system import StochasticSystem


@dataclass(frozen=True, slots=True)
class PrintedDelays:
    """The rows after which the propositions name the new mode; None: no finite bound.

    proposition_4_2: by condition 1 and by condition 2; proposition_4_3: for two modes, None also for more;
    proposition_4_4: whether it promises detection at once; difficulty: the expression (21), infinite where some wrong
    filter has no error.
    """

    proposition_4_2: tuple[int | None, int | None]
    proposition_4_3: int | None
    proposition_4_4: bool
    difficulty: float


@dataclass(frozen=True, slots=True)
class _Sizes:
    """The printed numbers of one wrong filter: singular values, eigenvalues, ‖ē‖ at the switch and a row before."""

    alpha: float
    per_log: float  # 2 / λ_max(S_T⁻¹)
    determinants: float  # ln(|S_i|/|S_T|)
    seen: tuple[float, float]  # σ_max and σ_min of H_T F_T
    F: tuple[float, float]  # σ_max(F_T), σ_min(F_i)
    wide: tuple[float, float]  # σ_min of [F_i Gx Gu] and of L_i
    error: tuple[float, float]  # of T and of i, at the switch
    error_before: tuple[float, float]

    def right(self, rows: int) -> float:
        """σ_max(H_T F_T)² σ_max(F_T)^(2 (δ-1)) ‖ē_T‖²: (17) squared."""
        return float((self.seen[0] * self.F[0] ** (rows - 1) * self.error[0]) ** 2)

    def wrong(self, rows: int) -> float:
        """α σ_min(L_i)² σ_min([F_i Gx Gu])^(2 (δ-1)) ‖ē_i‖²: (18) squared, times α."""
        return float(self.alpha * (self.wide[1] * self.wide[0] ** (rows - 1) * self.error[1]) ** 2)


def printed_delays(
    system: StochasticSystem,
    filters: Sequence[SteadyFilter],
    source: str,
    target: str,
    method: Bank,
    *,
    rows: int = 100,
) -> PrintedDelays:
    """Return what the propositions say of a switch; `filters` are those of all modes; up to `rows` rows are looked at.

    >>> from deshybrid.model.load import load
    >>> from deshybrid.stochastic.from_model import stochastic_system
    >>> from deshybrid.stochastic.steady_state import steady_state
    >>> turn = stochastic_system(load("models/hwang2006/turn.yaml"))
    >>> filters = tuple(steady_state(mode).filter for mode in turn.modes)
    >>> printed_delays(turn, filters, "CV", "CT", "mmae").proposition_4_2
    (None, None)
    """
    old, new = system.names.index(source), system.names.index(target)
    run = mean_run(system, switched(old, new, rows), method)
    others = [number for number in range(len(filters)) if number != new]
    errors = [_errors(system, run, SETTLED_ROWS - 1 - back, method) for back in (0, 1)]
    sizes = {i: _sizes(filters, i, new, errors) for i in others}
    after, positive = run.predicted_mu[SETTLED_ROWS:], proposition_4_1(run, new, determinants=2).first[SETTLED_ROWS:]
    firsts = [_first_condition(sizes[i], after, positive[:, i], (i, new)) for i in others]
    seconds = [_second_condition(sizes[i], positive[:, i]) for i in others]
    return PrintedDelays(
        (_whole(max(firsts, default=1.0)), _whole(max(seconds, default=1.0))),
        _whole(_third(system, sizes[others[0]], others[0], rows)) if len(others) == 1 else None,
        all(_at_once(system, sizes[i]) for i in others),
        max((_difficulty(sizes[i]) for i in others), default=-inf),
    )


def _whole(rows: float) -> int | None:
    return int(rows) if isfinite(rows) else None


def _sizes(filters: Sequence[SteadyFilter], i: int, true: int, errors: Sequence[Sequence[float]]) -> _Sizes:
    pair, own = mismatch(filters[i], filters[true].mode), mismatch(filters[true], filters[true].mode)
    S, S_true = filters[i].S, filters[true].S
    smallest_true = float(np.linalg.eigvalsh(S_true)[0])  # 1 / λ_max(S_T⁻¹)
    seen = np.linalg.svd(pair.seen, compute_uv=False)
    wide = [_least_singular(matrix) for matrix in _wide(pair)]
    return _Sizes(
        alpha=smallest_true / float(np.linalg.eigvalsh(S)[-1]),
        per_log=2.0 * smallest_true,
        determinants=float(np.linalg.slogdet(S)[1] - np.linalg.slogdet(S_true)[1]),
        seen=(float(seen[0]), float(seen[-1])),
        F=(float(np.linalg.norm(own.error, 2)), _least_singular(pair.error)),
        wide=(wide[0], wide[1]),
        error=(errors[0][true], errors[0][i]),
        error_before=(errors[1][true], errors[1][i]),
    )


def _wide(pair: Mismatch) -> tuple[FloatArray, FloatArray]:
    return np.hstack([pair.error, pair.Gx, pair.Gu]), np.hstack([pair.seen, pair.Hx, pair.Hu])


def _least_singular(matrix: FloatArray) -> float:
    return float(np.linalg.svd(matrix, compute_uv=False)[-1])


def _errors(system: StochasticSystem, run: MeanRun, row: int, method: Bank) -> list[float]:
    """‖ē_i‖ that every filter starts the next step with: IMM mixes its estimates before."""
    x = run.x[row]
    if method == "imm":
        joint = system.chain.probability_to_from * run.mu[row]
        total = joint.sum(axis=1, keepdims=True)
        x = np.where(total > 0.0, joint / np.where(total > 0.0, total, 1.0), np.eye(len(x))) @ x
    gaps = run.true[row] - x
    scale = np.finfo(np.float64).eps * 1e3 * max(float(np.abs(run.true[row]).max()), 1.0)
    return [size if size > scale else 0.0 for size in np.linalg.norm(gaps, axis=1).tolist()]


def _first_condition(sizes: _Sizes, after: FloatArray, positive: Truths, modes: tuple[int, int]) -> float:
    """4.2, condition 1: the first row at which it holds, β with the probabilities of the mean run.

    `positive`: condition 1 of Proposition 4.1; modes: that of the wrong filter, and the true one.
    """
    i, true = modes
    for rows in range(1, len(after) + 1):
        log_mu = np.log(np.maximum(after[rows - 1], np.finfo(np.float64).tiny))
        beta = sizes.per_log * (sizes.determinants + float(log_mu[true] - log_mu[i]))
        if positive[rows - 1] and sizes.right(rows) < beta + sizes.wrong(rows):
            return rows
    return inf


def _second_condition(sizes: _Sizes, positive: Truths) -> float:
    """4.2, condition 2; infinite where what it divides by is not positive, or ē_i is zero."""
    if sizes.F[1] <= sizes.F[0]:
        return inf
    least = 1.0 + _difficulty(sizes) / log(sizes.F[1] / sizes.F[0])  # the braces of condition 2 are twice (21)
    rows = max(1.0, floor(least) + 1.0) if isfinite(least) else max(1.0, least)
    return rows if rows <= len(positive) and positive[int(rows) - 1] else inf


def _third(system: StochasticSystem, sizes: _Sizes, i: int, most: int) -> float:
    """(22), for two modes."""
    staying = float(system.chain.probability_to_from[i, i])
    if staying >= 1.0:
        return inf
    odds = log(staying / (1.0 - staying)) if staying > 0.0 else -inf
    left = sizes.per_log * (sizes.determinants - odds)
    return next((float(rows) for rows in range(1, most + 1) if sizes.wrong(rows) + left > sizes.right(rows)), inf)


def _at_once(system: StochasticSystem, sizes: _Sizes) -> bool:
    """4.4, with the errors of the row before."""
    from_to = system.chain.probability_to_from.T
    off = ~np.eye(len(from_to), dtype=np.bool_)
    with np.errstate(divide="ignore"):
        ratio = (from_to / np.diagonal(from_to)[:, None])[off].min(initial=np.inf)
        chance = float(np.log(ratio))
    wrong = sizes.alpha * (sizes.wide[1] * sizes.wide[0] * sizes.error_before[1]) ** 2
    right = (sizes.seen[0] * sizes.error_before[0]) ** 2
    return bool(wrong + sizes.per_log * (sizes.determinants + chance) > right)


def _difficulty(sizes: _Sizes) -> float:
    """(21): small where a switch is easily detected, the paper says."""
    if sizes.error[1] == 0.0 or sizes.seen[1] == 0.0:
        return inf
    if sizes.error[0] == 0.0:
        return -inf
    return -0.5 * log(sizes.alpha) + log(sizes.seen[0] / sizes.seen[1]) + log(sizes.error[0] / sizes.error[1])


__all__ = ["PrintedDelays", "printed_delays"]
