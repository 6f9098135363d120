"""How many rows a multiple-model filter is expected to take until it names the mode after a switch.

In: a `StochasticSystem` and a switch.  Out: the filter's run on the *mean* measurements, without any noise: the mean
residuals and their covariances, the probabilities that follow from them, the conditions of Proposition 4.1 row by row,
and the first row of the stay from which on the new mode is named.  The plant has been in its old mode for
`SETTLED_ROWS` rows, so that gains and estimates have settled.

The likelihoods are taken at the mean residual, as in the paper.  For MMAE, whose filters are linear, the mean
estimates are exact; the probabilities, and with them the mixed estimates of IMM, are those of a run without noise.
Where the modes differ in their noise alone, the mean residuals are zero in all of them and such a run says nothing:
whichever has the smaller covariance is named for ever.  So runs are drawn as well: `drawn_delays`.

The paper's likelihood has |S|⁻¹ for |S|^(-1/2), so that its (14), (15) and Proposition 4.1 count ln(|S_i|/|S_T|)
twice; it counts once.  Delays count the first row of the new mode as 1.  O(M² n² + M n³) a row.
Source: Hwang, Balakrishnan and Tomlin (2006), section 4.2, (13), (14), Proposition 4.1.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.belief import Belief, read_only
from deshybrid.stochastic.gaussian import squared_norm
from deshybrid.stochastic.multiple import predict_imm, predict_mmae, update
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.record import estimate
from deshybrid.stochastic.sample import sample
from deshybrid.stochastic.system import StochasticSystem

Bank: TypeAlias = Literal["imm", "mmae"]
Truths: TypeAlias = NDArray[np.bool_]
SETTLED_ROWS = 50
"""Rows in the old mode before the switch."""


@dataclass(frozen=True, slots=True, eq=False)
class MeanRun:
    """A filter on mean measurements: mu, predicted_mu (N, M), x (N, M, n), residual (N, M, p), S (N, M, p, p), and the
    true mean state (N, n)."""

    mu: FloatArray
    predicted_mu: FloatArray
    x: FloatArray
    residual: FloatArray
    S: FloatArray
    true: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Conditions:
    """Proposition 4.1 for each row and mode (N, M), true in the column of the true mode itself.

    first: r̄_iᵀ S_i⁻¹ r̄_i + b > 0 with b = ln(|S_i|/|S_T|) + 2 ln(µ⁻_T/µ⁻_i); second: that is above r̄_Tᵀ S_T⁻¹ r̄_T,
    which is that the true mode is the more probable one; third: the same by eigenvalues, sufficient for it.
    """

    first: Truths
    second: Truths
    third: Truths

    @property
    def met(self) -> Truths:
        """(N,): the first condition, and the second or the third, against every other mode."""
        return np.asarray((self.first & (self.second | self.third)).all(axis=-1))


@dataclass(frozen=True, slots=True)
class Delay:
    """The delay that the mean run predicts, and by Proposition 4.1 with its third condition alone; None: never.

    `source_named`: whether the old mode was named before the switch; else a delay says little.
    """

    source: str
    target: str
    method: Bank
    rows: int | None
    by_third_condition: int | None
    source_named: bool


def mean_run(system: StochasticSystem, modes: NDArray[np.intp], method: Bank) -> MeanRun:
    """Return a filter's run on the mean measurements of a plant whose modes (N,) are given by number; inputs are zero.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> mean_run(calm_and_wild(), np.array([0, 0, 1]), "imm").residual.shape
    (3, 2, 1)
    """
    require_fixed_noise(system.modes, "the recursion of mean residuals")
    predict = predict_imm if method == "imm" else predict_mmae
    belief, x = Belief.prior(system), system.x
    rows, true = [], []
    for number in modes:
        mode = system.modes[number]
        x = mode.F @ x + mode.f
        posterior = update(system, predict(system, belief), mode.H @ x + mode.g)
        belief = posterior.belief
        rows.append((belief.mu, posterior.predicted_mu, belief.x, posterior.residual, posterior.S))
        true.append(x)
    mu, predicted, estimates, residual, S = (np.array(part) for part in zip(*rows, strict=True))
    return MeanRun(mu, predicted, estimates, residual, S, np.array(true))


def proposition_4_1(run: MeanRun, true: int, *, determinants: int = 1) -> Conditions:
    """Return the conditions for each row of a run; `determinants`: how often ln(|S_i|/|S_T|) counts, 2 as printed.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> system = calm_and_wild()
    >>> proposition_4_1(mean_run(system, np.zeros(9, dtype=int), "mmae"), 0).met.tolist()[-1]
    True
    """
    log_size, log_mu = np.linalg.slogdet(run.S)[1], np.log(np.maximum(run.predicted_mu, np.finfo(np.float64).tiny))
    b = determinants * (log_size - log_size[:, [true]]) + 2.0 * (log_mu[:, [true]] - log_mu)
    square = squared_norm(run.residual, run.S)
    spectrum = np.linalg.eigvalsh(run.S)
    length = (run.residual**2).sum(axis=-1)
    largest = 1.0 / spectrum[:, [true], 0]  # λ_max of S_T⁻¹
    least = length / spectrum[..., -1]  # λ_min of S_i⁻¹ times ‖r̄_i‖²
    own = np.arange(run.mu.shape[1]) == true
    return Conditions(
        first=(square + b > 0.0) | own,
        second=(square[:, [true]] < square + b) | own,
        third=(length[:, [true]] * largest < least + b) | own,
    )


def predicted_delay(system: StochasticSystem, source: str, target: str, method: Bank, rows: int = 100) -> Delay:
    """Return the delay of a switch, from runs of `rows` rows after it.

    >>> from deshybrid.model.load import load
    >>> from deshybrid.stochastic.from_model import stochastic_system
    >>> turn = stochastic_system(load("models/hwang2006/turn.yaml"))
    >>> [predicted_delay(turn, "CV", "CT", method).rows for method in ("imm", "mmae")]
    [2, 7]
    """
    old, new = system.names.index(source), system.names.index(target)
    run = mean_run(system, switched(old, new, rows), method)
    named = run.mu.argmax(axis=-1)
    conditions = proposition_4_1(run, new)
    sure = np.asarray((conditions.first & conditions.third).all(axis=-1))
    return Delay(
        source,
        target,
        method,
        _from_then_on(named[SETTLED_ROWS:] == new),
        _from_then_on(sure[SETTLED_ROWS:]),
        bool(named[SETTLED_ROWS - 1] == old),
    )


def drawn_delays(
    system: StochasticSystem,
    source: str,
    target: str,
    method: Bank,
    *,
    rows: int = 100,
    trials: int = 200,
    seed: int = 0,
) -> FloatArray:
    """Return the delay of each drawn run (trials,): the first row of the stay that names the mode, infinite for none.

    >>> from deshybrid.model.load import load
    >>> from deshybrid.stochastic.from_model import stochastic_system
    >>> turn = stochastic_system(load("models/hwang2006/turn.yaml"))
    >>> float(np.median(drawn_delays(turn, "CV", "CT", "imm")))
    2.0
    """
    old, new = system.names.index(source), system.names.index(target)
    runs = sample(system, SETTLED_ROWS + rows, seed=seed, trials=(trials,), modes=switched(old, new, rows))
    u = np.zeros((*runs.modes.shape, system.bank.B.shape[2]))
    named = estimate(system, runs.z, u, method=method).most_probable[:, SETTLED_ROWS:] == new
    first = np.where(named.any(axis=1), named.argmax(axis=1) + 1.0, np.inf)
    return read_only(first)


def switched(old: int, new: int, rows: int) -> NDArray[np.intp]:
    """Return the numbers of the modes of a run that switches after `SETTLED_ROWS` rows.

    >>> switched(0, 1, 2)[-3:].tolist()
    [0, 1, 1]
    """
    return np.repeat(np.array([old, new], dtype=np.intp), [SETTLED_ROWS, rows])


def _from_then_on(holds: Truths) -> int | None:
    """The first row (from 1) from which on it holds to the end, None where it does not hold at the end."""
    fails = np.flatnonzero(~holds)
    first = 1 + (int(fails[-1]) + 1 if fails.size else 0)
    return first if first <= len(holds) else None


__all__ = [
    "SETTLED_ROWS",
    "Bank",
    "Conditions",
    "Delay",
    "MeanRun",
    "Truths",
    "drawn_delays",
    "mean_run",
    "predicted_delay",
    "proposition_4_1",
    "switched",
]
