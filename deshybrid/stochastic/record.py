"""A filter at work on whole records, any number of trials at once.

In: a `StochasticSystem`, measurements z (..., N, p) with NaN where one is missing, inputs u (..., N, m).  Out:
`Estimates`, with the same leading axes.  The prior lies one step before the first measurement: predict, then update.
The input of a row is held until the next row; the step to the first row takes the first row's input.

One step a row.  Source: Hwang et al. (2006), section 3.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Literal, TypeAlias, TypeVar

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic import gaussian, multiple, switching
from deshybrid.stochastic.belief import Belief, Posterior, read_only, sealed, squared_residual
from deshybrid.stochastic.gating import Flags, Gate, Judgement
from deshybrid.stochastic.lanes import behind, in_front, trials_last
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.residual_mean import ResidualBelief, predict_rmimm, update_rmimm
from deshybrid.stochastic.roots import RootBelief, predict_roots, update_roots
from deshybrid.stochastic.switching import ModeNumbers
from deshybrid.stochastic.system import StochasticSystem

State = TypeVar("State")
Inputs: TypeAlias = tuple[FloatArray | None, FloatArray | None]  # of the step that leads to a row, and of the row
Step: TypeAlias = Callable[[State, FloatArray, Inputs, Gate | None], tuple[State, Posterior]]
UnknownModeMethod: TypeAlias = Literal["mmae", "imm", "rmimm"]
Engine: TypeAlias = Literal["numpy", "numba", "roots"]
_PREDICT: dict[str, Callable[[StochasticSystem, Belief, FloatArray | None], Belief]] = {
    "mmae": multiple.predict_mmae,
    "imm": multiple.predict_imm,
}


@dataclass(frozen=True, slots=True, eq=False)
class Estimates:
    """Row by row: x (..., N, n), P (..., N, n, n), mu (..., N, M), and (..., N) the others; read-only.

    x and P are mean and covariance of the mixture given all rows up to this one; `log_likelihood` is that of the row's
    measurement given the rows before, `nis` its squared residual in units of its covariance, `channels` how many
    outputs were used; `gated` tells whether the row was an outlier and left out, `readmitted` whether it lay beyond the
    gate and was taken, because the gate was open after `PATIENCE` outliers in a row.
    """

    x: FloatArray
    P: FloatArray
    mu: FloatArray
    log_likelihood: FloatArray
    nis: FloatArray
    channels: FloatArray
    gated: Flags
    readmitted: Flags

    def __post_init__(self) -> None:
        for name in ("x", "P", "mu", "log_likelihood", "nis", "channels", "gated", "readmitted"):
            object.__setattr__(self, name, read_only(getattr(self, name)))

    @property
    def most_probable(self) -> ModeNumbers:
        """The number of the most probable mode of each row (..., N); of equals the first."""
        best: ModeNumbers = self.mu.argmax(axis=-1)
        return best

    def rows(self, numbers: ModeNumbers) -> "Estimates":
        """Return the estimates of some rows, by number.

        >>> from deshybrid.stochastic.examples import calm_and_wild
        >>> estimate(calm_and_wild(), [[0.1], [np.nan], [9.0]]).rows(np.array([0, 2])).x.shape
        (2, 1)
        """
        return Estimates(
            self.x[..., numbers, :],
            self.P[..., numbers, :, :],
            self.mu[..., numbers, :],
            self.log_likelihood[..., numbers],
            self.nis[..., numbers],
            self.channels[..., numbers],
            self.gated[..., numbers],
            self.readmitted[..., numbers],
        )


def estimate(
    system: StochasticSystem,
    z: ArrayLike,
    u: ArrayLike | None = None,
    *,
    method: UnknownModeMethod = "imm",
    gate: float | None = None,
    engine: Engine = "numpy",
) -> Estimates:
    """Return the estimates of a multiple-model filter; z (..., N, p), u (..., N, m).

    A row that no mode expects with the probability `gate` is an outlier and counts as missing, unless the filter itself
    seems to be lost (`deshybrid.stochastic.gating`).  The engine `numba`
    (extra `numba`; `imm` and `mmae`) compiles for seconds when it is first used, and is several times as
    fast for many trials or rows; results are those of `numpy` up to rounding.  The engine `roots` (`imm` only) works on
    square roots of covariances, for those that spread over more than eight digits.

    Raises `UsageError`: DH1103 where the modes measure different outputs, DH1105, DH1107 where a shape does not fit,
    DH1108 where numbers overflow, DH1109 where numba is not installed or does not run this, DH1111 for a gate that is
    no probability.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> estimate(calm_and_wild(), [[0.1], [0.2], [9.0], [1.0]]).most_probable.tolist()
    [0, 0, 1, 1]
    """
    _check_gate(system, gate)
    measured, inputs = _records(system, z, u)
    trials = measured.shape[:-2]
    seen = ~np.isnan(measured) & system.comparable_bank.measured[0]
    opening = None if gate is None else Gate.of(measured.shape[-1], gate, trials)
    if engine == "roots":
        if method != "imm":
            raise UsageError(diagnostic("DH1109", "the engine `roots` runs `imm` only"))
        rows = _rows(measured, inputs)
        return _stacked(_run(RootBelief.prior(system, trials), _root_step(system), rows, opening), seen)
    if engine == "numba":
        if method == "rmimm":
            raise UsageError(diagnostic("DH1109", "numba runs `imm` and `mmae`"))
        require_fixed_noise(system.modes, "the engine `numba`")
        made = _compiled(system, (measured, inputs), seen, opening, mixing=method == "imm")
        if made is not None:
            return made
    rows = _rows(measured, inputs)
    if method == "rmimm":
        return _stacked(_run(ResidualBelief.prior(system, trials), _residual_step(system), rows, opening), seen)
    return _stacked(_run(Belief.prior(system, trials), _step(system, method), rows, opening), seen)


def _compiled(
    system: StochasticSystem,
    record: tuple[FloatArray, FloatArray | None],
    seen: Flags,
    gate: Gate | None,
    *,
    mixing: bool,
) -> Estimates | None:
    """The estimates by numba; None where they are not finite, so that numpy may say why."""
    try:
        from deshybrid.stochastic.compiled import run
    except ImportError as error:
        helps = ("install it with `pip install deshybrid[numba]`, or take the engine `numpy`",)
        raise UsageError(diagnostic("DH1109", "the engine `numba` is not installed", helps=helps)) from error
    z, u = record
    trials, count = z.shape[:-2], math.prod(z.shape[:-2])
    flat = behind(np.where(seen, z, np.nan), 2).reshape(*z.shape[-2:], count)
    inputs = np.zeros((len(flat), 0, count)) if u is None else behind(u, 2).reshape(*u.shape[-2:], count)
    log_Pi, prior = system.log_probability_to_from, Belief.prior(system)
    limits = np.zeros(0) if gate is None else gate.limits
    found = run(system.comparable_bank, log_Pi, prior, (flat, inputs), mixing=mixing, limits=limits)
    if not all(np.isfinite(column).all() for column in found):
        return None
    shaped = (part.reshape(*part.shape[:-1], *trials) for part in found)
    columns = [sealed(in_front(part, part.ndim - len(trials))) for part in shaped]
    x, P, mu, log_likelihood, nis = columns[:5]
    gated, readmitted = (column > 0 for column in columns[5:])
    used = seen & ~gated[..., None]
    return Estimates(x, P, mu, log_likelihood, nis, used.sum(axis=-1).astype(np.float64), gated, readmitted)


def _step(system: StochasticSystem, method: str) -> Step[Belief]:
    predict = _PREDICT[method]

    def step(belief: Belief, z: FloatArray, u: Inputs, gate: Gate | None) -> tuple[Belief, Posterior]:
        posterior = multiple.update(system, predict(system, belief, u[0]), z, u[1], gate=gate)
        return posterior.belief, posterior

    return step


def _residual_step(system: StochasticSystem) -> Step[ResidualBelief]:
    def step(state: ResidualBelief, z: FloatArray, u: Inputs, gate: Gate | None) -> tuple[ResidualBelief, Posterior]:
        return update_rmimm(system, predict_rmimm(system, state, u[0]), z, u[1], gate=gate)

    return step


def _root_step(system: StochasticSystem) -> Step[RootBelief]:
    def step(state: RootBelief, z: FloatArray, u: Inputs, gate: Gate | None) -> tuple[RootBelief, Posterior]:
        return update_roots(system, predict_roots(system, state, u[0]), z, u[1], gate=gate)

    return step


def _run(
    state: State,
    step: Step[State],
    rows: Sequence[tuple[FloatArray, FloatArray | None, FloatArray | None]],
    gate: Gate | None,
) -> list[tuple[FloatArray, ...]]:
    found: list[tuple[FloatArray, ...]] = []
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is looked for
        for k, (z, u_before, u) in enumerate(rows):
            with _naming(k):
                state, posterior = step(state, z, (u_before, u), gate)
                _require_likelihood(posterior.log_likelihood)
            belief, gate = posterior.belief, posterior.judgement.gate
            found.append((*belief.mixture(), belief.mu, *_innovation(posterior)))
    return found


def _innovation(posterior: Posterior) -> tuple[FloatArray, ...]:
    flags = _flags(posterior.judgement)
    return posterior.log_likelihood, *flags, posterior.predicted_mu, posterior.residual, posterior.S


def _flags(judgement: Judgement) -> tuple[FloatArray, FloatArray]:
    return judgement.gated.astype(np.float64), judgement.readmitted.astype(np.float64)


def _require_likelihood(log_likelihood: FloatArray) -> None:
    if not np.isfinite(log_likelihood).all():
        raise gaussian.overflow()


@contextmanager
def _naming(row: int) -> Iterator[None]:
    """Say in which row a filter failed."""
    try:
        yield
    except UsageError as error:
        told = (replace(found, message=f"row {row + 1}: {found.message}") for found in error.diagnostics)
        raise UsageError(*told) from None


def estimate_known(
    system: StochasticSystem,
    z: ArrayLike,
    modes: ArrayLike,
    u: ArrayLike | None = None,
    *,
    moved_by: ArrayLike | None = None,
    gate: float | None = None,
) -> Estimates:
    """Return the estimates of the switching Kalman filter; z (..., N, p), modes (..., N) by number, u (..., N, m).

    The mode of a row measures it; `moved_by` (..., N) is the mode of the step that leads to it: by default the row's
    own, as in the other filters, while the freeway paper takes that of the row before.  `gate` as in `estimate`.

    Raises `UsageError`: DH1105, DH1107 where a shape or a number of a mode does not fit, DH1108, DH1111.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> estimate_known(calm_and_wild(), [[0.1], [0.2]], [0, 0]).mu.tolist()
    [[1.0, 0.0], [1.0, 0.0]]
    """
    _check_gate(system, gate)
    measured, inputs = _records(system, z, u)
    known = _known_modes(system, modes, measured.shape[:-1])
    moving = known if moved_by is None else _known_modes(system, moved_by, measured.shape[:-1])
    trials, n = measured.shape[:-2], len(system.x)
    x, P = np.broadcast_to(system.x, (*trials, n)), np.broadcast_to(system.P, (*trials, n, n))
    certain, one, rows = np.eye(len(system.modes))[known], np.ones((*trials, 1)), []
    opening = None if gate is None else Gate.of(measured.shape[-1], gate, trials)
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is looked for
        for k, (z_row, u_before, u_row) in enumerate(_rows(measured, inputs)):
            with _naming(k):
                x, P = switching.predict(system, x, P, moving[..., k], u=u_before)
                done, judged = switching.update(system, x, P, known[..., k], z_row, u=u_row, gate=opening)
                _require_likelihood(done.log_likelihood)
            x, P, residual, S = done.x, done.P, done.residual[..., None, :], done.S[..., None, :, :]
            rows.append((x, P, certain[..., k, :], done.log_likelihood, *_flags(judged), one, residual, S))
            opening = judged.gate
    return _stacked(rows, ~np.isnan(measured) & system.bank.measured[known])


def _check_gate(system: StochasticSystem, gate: float | None) -> None:
    """A gate and heavy tails answer the same outliers, and the limits of the gate are those of a Gaussian."""
    for mode in system.modes if gate is not None else ():
        mode.noise.require_fixed("a gate", mode.name, of=("tails",))


def _records(system: StochasticSystem, z: ArrayLike, u: ArrayLike | None) -> tuple[FloatArray, FloatArray | None]:
    measured = np.asarray(z, dtype=np.float64)
    outputs, m = system.bank.H.shape[1], system.bank.B.shape[2]
    if measured.ndim < 2 or measured.shape[-1] != outputs or np.isinf(measured).any():
        text = f"`z` has shape {measured.shape}, expected (..., rows, {outputs}) without infinite numbers"
        raise UsageError(diagnostic("DH1107", text))
    measured = trials_last(measured, 2)
    if u is None and m == 0:
        return measured, None
    expected = (*measured.shape[:-1], m)
    inputs = np.asarray(np.nan if u is None else u, dtype=np.float64)
    if inputs.shape != expected or not np.isfinite(inputs).all():
        text = f"`u` has shape {inputs.shape}, expected {expected} with finite numbers"
        raise UsageError(diagnostic("DH1107", text))
    return measured, trials_last(inputs, 2)


def _known_modes(system: StochasticSystem, modes: ArrayLike, shape: tuple[int, ...]) -> ModeNumbers:
    known = np.asarray(modes)
    size = len(system.modes)
    if known.shape != shape or known.dtype.kind not in "iu" or ((known < 0) | (known >= size)).any():
        text = f"`modes` has shape {known.shape} and type {known.dtype}, expected {shape} with numbers below {size}"
        raise UsageError(diagnostic("DH1107", text))
    return known.astype(np.intp)


def rows_of(
    system: StochasticSystem, z: ArrayLike, u: ArrayLike | None = None
) -> list[tuple[FloatArray, FloatArray | None, FloatArray | None]]:
    """Return each row's measurement (..., p), the input of the step that leads to it, and its own input (..., m).

    Raises `UsageError` (DH1107) where a shape does not fit.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> [z.tolist() for z, _, _ in rows_of(calm_and_wild(), [[0.1], [0.2]])]
    [[0.1], [0.2]]
    """
    return _rows(*_records(system, z, u))


def _rows(
    measured: FloatArray, inputs: FloatArray | None
) -> list[tuple[FloatArray, FloatArray | None, FloatArray | None]]:
    """Each row's measurement, the input of the step that leads to it, and its own input."""
    count = measured.shape[-2]
    if inputs is None:
        return [(measured[..., k, :], None, None) for k in range(count)]
    return [(measured[..., k, :], inputs[..., max(k - 1, 0), :], inputs[..., k, :]) for k in range(count)]


def _stacked(rows: Sequence[tuple[FloatArray, ...]], seen: Flags) -> Estimates:
    columns = [_one_array(column, seen.ndim - 2) for column in zip(*rows, strict=True)]
    x, P, mu, log_likelihood, outlier, taken, *innovation = columns
    with np.errstate(over="ignore", invalid="ignore"):
        nis = squared_residual(*innovation)
    _require_finite(seen.ndim - 2, (x, P, mu, log_likelihood, nis))
    gated = outlier > 0.0
    used = seen & ~gated[..., None]
    return Estimates(x, P, mu, log_likelihood, nis, used.sum(axis=-1).astype(np.float64), gated, taken > 0.0)


def _require_finite(rows_axis: int, columns: Sequence[FloatArray]) -> None:
    """Name the first row in which a number is not finite."""
    if all(np.isfinite(column).all() for column in columns):
        return
    wrong = [~np.isfinite(np.moveaxis(column, rows_axis, 0)).reshape(column.shape[rows_axis], -1) for column in columns]
    first = np.flatnonzero(np.concatenate(wrong, axis=1).any(axis=1))[0]
    with _naming(int(first)):
        raise gaussian.overflow()


def _one_array(rows: Sequence[FloatArray], trials: int) -> FloatArray:
    """Rows (trials, ...) as one array (trials, rows, ...), in memory row by row."""
    row_first = np.stack([behind(row, row.ndim - trials) for row in rows])
    return sealed(in_front(row_first, row_first.ndim - trials))


__all__ = ["Engine", "Estimates", "UnknownModeMethod", "estimate", "estimate_known", "rows_of"]
