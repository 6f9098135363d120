"""Sequential tests of a white residual: their numbers from a demanded rate of false alarms.

ν = L⁻¹ r with S = L Lᵀ has unit covariance and mean zero in the own location; q is its length, h the step.
`false_alarm` is the rate, in 1/s and per generator, at which a location that the plant is in may be denied.

- `sprt`: Wald's sequential probability ratio test of the covariance ρ² 1 against 1, with ρ = 3.  A sample adds
  ½ (1 - 1/ρ²) |ν|² - q ln ρ to the log-likelihood ratio; at or above ln((1 - β)/α) the location is denied, at or below
  ln(β/(1 - α)) it is accepted, and both begin the test again.  A test takes at least one sample, so that α = rate · h
  keeps the rate; β = 1/1000 is the chance that one test accepts a residual of covariance ρ² 1.  Wald: the true errors
  α', β' obey α'/(1 - β') <= α/(1 - β) and β'/(1 - α') <= β/(1 - α).
- `glr`: the log of the generalised likelihood ratio of "the mean has shifted by anything N samples ago" to "it is zero"
  is |S_N|²/(2N), with S_N the sum of the last N values of ν.  The location is denied while it is above c for some
  N <= W.  |S_N|²/N is χ² with q degrees of freedom, so that a sample gives a false alarm with probability at most
  W P(χ²_q > 2c), which is set to rate · h.  W is the number of samples in the slowest time constant of the generators,
  from 2 to 32: a longer memory finds smaller shifts, those of slow disturbances too, which are none of the noise.

In: rates and covariances.  Out: numbers of `DecisionDesign`.  Cost: one quantile of χ².
Source: Wald (1945), Sequential Tests of Statistical Hypotheses; Willsky and Jones (1976); Lai (1995).
"""

import math

import numpy as np

from deshybrid.linear.arrays import FloatArray, frozen_array

RATIO = 3.0
MISS = 1e-3
LEAST_WINDOW, LONGEST_WINDOW = 2, 32


def whitening_of(covariance: FloatArray) -> FloatArray:
    """Return L⁻¹ with covariance = L Lᵀ.

    >>> whitening_of(np.array([[4.0]])).tolist()
    [[0.5]]
    """
    return frozen_array(np.linalg.inv(np.linalg.cholesky(covariance)), covariance.shape)


def wald_test(count: int, *, false_alarm: float, step: float) -> tuple[float, float, float, float]:
    """Return slope, offset, lower and upper level of the test of ν with `count` components; rate in 1/s, step in s.

    >>> slope, offset, lower, upper = wald_test(1, false_alarm=0.1, step=0.1)
    >>> round(slope, 3), round(offset, 3), round(lower, 3), round(upper, 3)
    (0.444, 1.099, -6.898, 4.604)
    """
    alpha = min(false_alarm * step, 0.5)
    slope, offset = (1.0 - 1.0 / RATIO**2) / 2.0, count * math.log(RATIO)
    return slope, offset, math.log(MISS / (1.0 - alpha)), math.log((1.0 - MISS) / alpha)


def window_samples(time_constant: float, step: float) -> int:
    """Return W, the number of samples that a generalised likelihood ratio looks back; both in seconds.

    >>> window_samples(0.07, 0.012), window_samples(100.0, 0.01)
    (6, 32)
    """
    return min(max(math.ceil(time_constant / step - 1e-9), LEAST_WINDOW), LONGEST_WINDOW)


def window_limits(samples: int, count: int, *, false_alarm: float, step: float) -> FloatArray:
    """Return the limits of |S_N|² for N = 1, ..., `samples`; ν has at most `count` components, rate in 1/s, step in s.

    >>> window_limits(2, 2, false_alarm=0.02, step=1.0).round(3).tolist()
    [9.21, 18.421]
    """
    from scipy.stats import chi2

    level = float(chi2.isf(min(false_alarm * step, 0.5) / samples, count))
    return frozen_array(level * np.arange(1.0, samples + 1.0), (samples,))


__all__ = ["wald_test", "whitening_of", "window_limits", "window_samples"]
