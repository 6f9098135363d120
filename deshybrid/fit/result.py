"""What an identification found: estimates with intervals, noise levels, and the model's text with the new numbers.

In: the numbers that `fitting` found.  Out: `Estimate` and `Fit`, and their record for JSON.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, TypeAlias

import numpy as np

from deshybrid.fit.stretches import Stretch
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import parameter_text
from deshybrid.model.source import SourceModel

Loss: TypeAlias = Literal["squares", "huber"]
FORMAT = "deshybrid-fit/1"
CONFIDENCE = 0.95
HUBER = 1.345  # robust standard deviations: 95 % efficient where no error is an outlier


@dataclass(frozen=True, slots=True)
class Estimate:
    """One parameter: where it started, what was found, its standard error and its interval of 95 %.

    `error` is infinite where the traces say nothing about the parameter, or not apart from others.
    """

    name: str
    start: float
    value: float
    error: float
    interval: tuple[float, float]

    @property
    def written(self) -> str:
        """The value with as many digits as its standard error makes worth writing."""
        known = np.isfinite(self.error) and self.error > 0.0 and self.value != 0.0
        digits = int(np.ceil(np.log10(abs(self.value) / self.error))) + 3 if known else 6
        return f"{self.value:.{min(max(digits, 3), 15)}g}"


@dataclass(frozen=True, eq=False)
class Fit:
    """The outcome of an identification.

    `covariance` (k, k) of the parameters' search coordinates: relative to a parameter's value where that does not start
    at 0; NaN where the traces say nothing.  `noise`: standard deviation by output; `drift`: intensity by wandering
    disturbance, per square root of a second, with the time in s after which it is forgotten; `correlation`: the largest
    correlation of a whitened error with the one before it.  `loss`: how errors counted, and `outliers` the share of
    those beyond the limit of Huber's; `lag`: over how many samples the correlation of errors was counted.
    """

    source: SourceModel
    estimates: tuple[Estimate, ...]
    covariance: FloatArray
    noise: Mapping[str, float]
    drift: Mapping[str, tuple[float, float]]
    correlation: float
    loss: Loss
    outliers: float
    lag: int
    stretches: tuple[Stretch, ...]

    @property
    def rows(self) -> int:
        """Samples that the fit used."""
        return sum(len(stretch.outputs) for stretch in self.stretches)

    @property
    def determined(self) -> bool:
        """Whether the traces determine every parameter that was asked for."""
        return all(math.isfinite(estimate.error) for estimate in self.estimates)

    @cached_property
    def model_text(self) -> str:
        """The text of the model file with the estimates in place of the numbers they started from."""
        return parameter_text(self.source, {estimate.name: estimate.written for estimate in self.estimates})

    def record(self) -> dict[str, object]:
        """Return the result as a tree for JSON; what is not determined has no error and no interval (null)."""
        return {
            "format": FORMAT,
            "name": elaborate(self.source).name,
            "rows": self.rows,
            "stretches": len(self.stretches),
            "confidence": CONFIDENCE,
            "determined": self.determined,
            "parameters": [_estimate_record(estimate) for estimate in self.estimates],
            "relative_covariance": self.covariance.tolist() if self.determined else None,
            "noise": dict(self.noise),
            "drift": {name: {"intensity": size, "memory": memory} for name, (size, memory) in self.drift.items()},
            "correlation": self.correlation,
            "loss": self.loss,
            "outliers": self.outliers,
            "lag": self.lag,
        }

    def __str__(self) -> str:
        width = max(len("parameter"), *(len(estimate.name) for estimate in self.estimates))
        lines = [f"{self.rows} samples in {len(self.stretches)} stretches of known location"]
        lines.append(f"{'parameter':<{width}}       start    estimate   std error  interval of 95 %")
        for e in self.estimates:
            seen = math.isfinite(e.error)
            tail = f"{e.error:>10.3g}  {e.interval[0]:.6g} to {e.interval[1]:.6g}" if seen else "  not determined"
            lines.append(f"{e.name:<{width}}  {e.start:>10.6g}  {e.value:>10.6g}  {tail}")
        lines += [f"noise of {name}: {size:.3g}" for name, size in self.noise.items()]
        lines += [
            f"drift of {name}: {size:.3g} per square root of a second, forgotten within {memory:.3g} s"
            for name, (size, memory) in self.drift.items()
        ]
        lines.append(f"correlation of a prediction error with the one before: at most {self.correlation:.2f}")
        lines.append(f"intervals count correlation over {self.lag} samples")
        if self.loss == "huber":
            lines.append(f"outliers: {100.0 * self.outliers:.1f} % of the errors are beyond {HUBER} robust deviations")
        return "\n".join(lines)


def _estimate_record(estimate: Estimate) -> dict[str, object]:
    seen = math.isfinite(estimate.error)
    return {
        "name": estimate.name,
        "start": estimate.start,
        "estimate": estimate.value,
        "standard_error": estimate.error if seen else None,
        "interval": list(estimate.interval) if seen else None,
    }


__all__ = ["CONFIDENCE", "HUBER", "Estimate", "Fit", "Loss"]
