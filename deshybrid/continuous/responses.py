"""How one location answers along given directions: rows d e^{F t}, and how far a bounded disturbance pushes them.

In: the modes of a stable F (n, n) (or of a sampled M), rows d (K, n), a drive N (n, r) of signals between -1 and 1.
Out: d e^{F t} at chosen times, a bound of how far it bends from its chord between two of them, and upper bounds of the
integral of ‖d e^{F s} N‖₁ over [0, t]: the most that the signals can add to d ζ(t), which a bang-bang signal reaches.

The idea: between two times a function differs from its chord by at most w²/8 of its second derivative, which modes
bound; so sums of chords plus that are upper bounds whose excess shrinks with the square of the cells.  In sampled time
nothing lies between two steps.  O(K n cells).

Source: this project; the worst disturbance by the L¹ norm of the impulse response is classical.
"""

from dataclasses import dataclass
from math import factorial

import numpy as np

from deshybrid.continuous.modes import ModalBasis
from deshybrid.linear.arrays import ComplexArray, FloatArray

TURN = 0.25
"""A cell is so short that its leading modes turn by a quarter of a radian at most: chords are then within 1 %."""
MOST_CELLS = 4_000
TERMS = 4
GONE = 1e-6
"""What the slowest mode has lost where the cells end; the rest is bounded mode by mode."""
ROUNDING = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Flow:
    """ζ' = F ζ + drive s, |s| <= 1 channel by channel (or ζ := M ζ + drive s each `step` seconds)."""

    modes: ModalBasis
    drive: FloatArray
    step: float | None

    @property
    def inverse(self) -> ComplexArray:
        """The inverse of the basis, (n, n)."""
        return np.asarray(np.linalg.inv(self.modes.basis), dtype=np.complex128)

    @property
    def exponents(self) -> ComplexArray:
        """The modes as exponents in 1/s; those of a sampled M are logarithms over the step."""
        values = self.modes.eigenvalues
        if self.step is None:
            return values
        least = np.exp(-700.0)
        return np.asarray(np.log(np.where(np.abs(values) < least, least, values)) / self.step, dtype=np.complex128)


def times_from(flow: Flow, start: float, *, turn: float = TURN) -> FloatArray:
    """Return times from `start` on, at which rows are looked at, until all modes are gone.

    `turn` (rad) is what the leading modes may turn from one time to the next.

    >>> flow = Flow(ModalBasis(np.array([-1.0 + 0j]), np.eye(1, dtype=complex), -1.0, 1.0), np.ones((1, 1)), None)
    >>> times_from(flow, 0.0)[[0, 1, -1]].round(2).tolist()
    [0.0, 0.25, 14.0]
    """
    values = flow.exponents
    end = start + np.log(1 / GONE) / max(float(-values.real.max()), 1e-300)
    if flow.step is not None:
        count = int(min(np.ceil((end - start) / flow.step - 1e-6), MOST_CELLS)) + 1
        return np.asarray(start + flow.step * np.arange(count))
    times = [start]
    while times[-1] < end and len(times) < MOST_CELLS:
        times.append(times[-1] + turn / _leading_size(values, times[-1] - start))
    return np.array(times)


def rows_at(flow: Flow, rows: FloatArray, times: FloatArray) -> FloatArray:
    """Return d e^{F t} for every row d and time t: (K, times, n)."""
    weights = rows @ flow.modes.basis
    shaped = weights[:, None, :] * np.exp(np.multiply.outer(times, flow.exponents))[None]
    return np.asarray((shaped @ flow.inverse).real)


def bends(flow: Flow, rows: FloatArray, times: FloatArray) -> FloatArray:
    """Return bounds (K, times - 1, n) of how far d e^{F t} leaves its chord between two times, entry by entry."""
    if flow.step is not None:
        return np.zeros((len(rows), len(times) - 1, rows.shape[1]))
    return np.asarray(_steepness(flow, rows, times, flow.inverse) * (np.diff(times) ** 2 / 8)[None, :, None])


def rest(flow: Flow, rows: FloatArray, time: float) -> FloatArray:
    """Return bounds (K, n) of |d e^{F t}| for all t >= `time`, mode by mode."""
    weights = np.abs(rows @ flow.modes.basis) * np.exp(flow.exponents.real * time)
    return np.asarray(weights @ np.abs(flow.inverse))


def pushed(flow: Flow, rows: FloatArray, times: FloatArray) -> FloatArray:
    """Return upper bounds (K, times) of the integral of ‖d e^{F s} N‖₁ over [0, t]; in sampled time of the sum.

    >>> flow = Flow(ModalBasis(np.array([-1.0 + 0j]), np.eye(1, dtype=complex), -1.0, 1.0), np.ones((1, 1)), None)
    >>> pushed(flow, np.ones((1, 1)), np.array([0.0, 1.0])).round(2).tolist()  # 1 - e⁻¹
    [[0.0, 0.63]]
    """
    if flow.step is not None:
        return _summed(flow, rows, times)
    fine = times_from(flow, 0.0, turn=TURN / 5)
    fine = np.unique(np.concatenate([fine, times[times < fine[-1]]]))
    values = _driven(flow, rows, fine)
    width = np.diff(fine)
    chords = (values[:, 1:] + values[:, :-1]) / 2 * width
    total = np.cumsum(
        chords + _steepness(flow, rows, fine, flow.inverse @ flow.drive).sum(axis=2) * width**3 / 12, axis=1
    )
    total = np.hstack([np.zeros((len(rows), 1)), total, total[:, -1:] + pushed_after(flow, rows, fine[-1])[:, None]])
    return np.asarray(total[:, np.searchsorted(fine, times)] * (1 + ROUNDING))


def pushed_after(flow: Flow, rows: FloatArray, time: float) -> FloatArray:
    """Return bounds (K,) of the same integral from `time` on, mode by mode."""
    weights = np.abs(rows @ flow.modes.basis) * np.exp(flow.exponents.real * time)
    decay = -flow.exponents.real if flow.step is None else 1 - np.exp(flow.exponents.real * flow.step)
    return np.asarray((weights / decay) @ np.abs(flow.inverse @ flow.drive).sum(axis=1))


def _leading_size(values: ComplexArray, elapsed: float) -> float:
    """The size of the modes that are not gone: a mean in which a mode weighs as it has decayed beside the slowest."""
    weights = np.exp((values.real - values.real.max()) * elapsed)
    return float(max(np.sqrt((weights * np.abs(values) ** 2).sum() / weights.sum()), 1e-300))


def _driven(flow: Flow, rows: FloatArray, times: FloatArray) -> FloatArray:
    """‖d e^{F t} N‖₁ (K, times)."""
    weights = (rows @ flow.modes.basis)[:, None, :] * np.exp(np.multiply.outer(times, flow.exponents))[None]
    return np.asarray(np.abs((weights @ (flow.inverse @ flow.drive)).real).sum(axis=2))


def _steepness(flow: Flow, rows: FloatArray, times: FloatArray, columns: ComplexArray) -> FloatArray:
    """Bounds (K, cells, c) of the second derivative of d e^{F t} N over each cell.

    Its Taylor series from the cell's beginning: derivatives as they are there, which near-equal modes leave small, and
    only the remainder mode by mode.
    """
    values, width = flow.exponents, np.diff(times)
    weights = (rows @ flow.modes.basis)[:, None, :]
    shapes = np.exp(np.multiply.outer(times[:-1], values))[None]
    total = np.zeros((len(rows), len(width), columns.shape[1]))
    for k in range(TERMS):
        derivative = np.abs(((weights * shapes * values ** (2 + k)) @ columns).real)
        total += derivative * (width**k / factorial(k))[None, :, None]
    remainder = (np.abs(weights * shapes) * np.abs(values) ** (2 + TERMS)) @ np.abs(columns)
    return np.asarray(total + remainder * (width**TERMS / factorial(TERMS))[None, :, None])


def _summed(flow: Flow, rows: FloatArray, times: FloatArray) -> FloatArray:
    """The sum over the steps before each time; what lies before the first step looked at is summed too."""
    counts = np.rint(times / flow.step).astype(int) if flow.step else np.zeros(len(times), dtype=int)
    values = _driven(flow, rows, np.arange(counts[-1]) * (flow.step or 1.0))
    total = np.hstack([np.zeros((len(rows), 1)), np.cumsum(values, axis=1)])
    return np.asarray(total[:, counts] * (1 + ROUNDING))


__all__ = ["Flow", "bends", "pushed", "pushed_after", "rest", "rows_at", "times_from"]
