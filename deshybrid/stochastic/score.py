"""How good the estimates of a filter were: right modes, delays after switches, errors, and consistency.

In: true and estimated modes or states as sequences and arrays.  Out: `Switch`, `Consistency`, NEES.

A delay counts rows: a switch whose own row already names the new mode has delay 1, as in the paper.  Consistency asks
whether squared residuals are as large as the filter believes: those of a matched filter are white, so that their sum is
χ² distributed over any number of rows; squared errors of the state (NEES) are not white along a run, and have that
distribution over independent trials only.  A mixture is no Gaussian, and its sums follow χ² closely but not exactly;
`deshybrid.stochastic.calibration` has the numbers that do.

Source: Hwang et al. (2006), section 4.3 (delays); Bar-Shalom, Li and Kirubarajan (2001), section 5.4.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.gaussian import squared_norm


@dataclass(frozen=True, slots=True)
class Switch:
    """A true entry into `mode` at a row; `delay` in rows from 1 to the first that names it, None where none did."""

    row: int
    mode: str
    delay: int | None


def switches(true: Sequence[str | None], estimated: Sequence[str]) -> tuple[Switch, ...]:
    """Return every switch between two known true modes, and when it was seen; ValueError where the lengths differ.

    >>> switches("aabbbaa", "aaabbbb")
    (Switch(row=2, mode='b', delay=2), Switch(row=5, mode='a', delay=None))
    """
    if len(true) != len(estimated):
        raise ValueError(f"{len(true)} true and {len(estimated)} estimated modes")
    starts = [k for k in range(1, len(true)) if true[k] != true[k - 1]]
    found = []
    for start, end in pairwise([*starts, len(true)]):
        mode, before = true[start], true[start - 1]
        if mode is None or before is None:
            continue
        delay = next((k - start + 1 for k in range(start, end) if estimated[k] == mode), None)
        found.append(Switch(start, mode, delay))
    return tuple(found)


@dataclass(frozen=True, slots=True)
class Consistency:
    """The sum of squares that a matched filter spreads as χ² with `freedom` degrees, and its 95 % band."""

    total: float
    freedom: int

    @property
    def band(self) -> tuple[float, float]:
        """What a matched filter stays within in 95 of 100 runs."""
        from scipy.stats import chi2

        return float(chi2.ppf(0.025, self.freedom)), float(chi2.ppf(0.975, self.freedom))

    @property
    def holds(self) -> bool:
        """Whether the sum lies within its band."""
        low, high = self.band
        return low <= self.total <= high

    def record(self) -> dict[str, object] | None:
        """Return the sum and its band as a tree for JSON, None without any number."""
        if not self.freedom:
            return None
        return {"sum": self.total, "freedom": self.freedom, "band_95": list(self.band)}

    def __str__(self) -> str:
        low, high = (bound / self.freedom for bound in self.band)
        where = "within" if self.holds else "outside"
        return f"{self.total / self.freedom:.3f} a measured number, {where} the 95 % band {low:.3f} to {high:.3f}"


def nees(error: ArrayLike, P: ArrayLike) -> FloatArray:
    """Return eᵀ P⁻¹ e of errors (..., n) and covariances (..., n, n): n on average for a matched filter.

    NaN where P is singular.

    >>> nees([3.0], [[9.0]]).tolist()
    1.0
    """
    e, covariance = np.asarray(error, dtype=np.float64), np.asarray(P, dtype=np.float64)
    singular = np.linalg.matrix_rank(covariance, hermitian=True) < e.shape[-1]
    solvable = np.where(np.asarray(singular)[..., None, None], np.eye(e.shape[-1]), covariance)
    return np.where(singular, np.nan, squared_norm(e, solvable))


__all__ = ["Consistency", "Switch", "nees", "switches"]
