"""Identification: the parameters of a model under which its predictions of measured samples are best, and how sure.

In: a model file, traces in which the location is known, names of parameters.  Out: a `Fit` with estimates, standard
errors and intervals, and the model's text with the new numbers.

Idea: prediction error.  In every stretch of known location a Kalman filter predicts each sample from those before it,
with free initial state; disturbances that enter the location wander at random.  The likelihood of all errors is largest
where the sum of squares of r = white · exp(Σ log det S / 2N) is least, for whitened errors `white` of N numbers: so one
least-squares problem finds the parameters together with the noise levels, whose common factor drops out.  Covariance:
(Jᵀ J)⁻¹ Σr²/N, the curvature of the likelihood there.  A parameter keeps its sign (its logarithm is searched); one
that starts at 0 is searched as it is.

Exact for data made as the filter assumes, for many samples.  Where it does not, the errors are correlated: the result
tells by how much, and intervals are then too narrow.

Some tens of passes over the data for each parameter.  Source: Ljung, System Identification, sections 7.2, 7.4 and 9.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from deshybrid.diagnostics import GainError, ModelError, UsageError, diagnostic
from deshybrid.fit.predictor import Doubt, build_predictor
from deshybrid.fit.stretches import Stretch, stretches_of
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import parameter_text, with_parameters
from deshybrid.model.problems import Problems
from deshybrid.model.scope import build_scope
from deshybrid.model.source import SourceModel
from deshybrid.model.system import HybridSystem
from deshybrid.simulate.trace import Trace

FORMAT = "deshybrid-fit/1"
CONFIDENCE = 0.95
_STEP = 1e-4  # of the search's coordinates, for differences
_FARTHEST = 20.0  # of a logarithm: what is not seen in the data must not run away
_BLIND = 1e-7  # relative singular value of J below which its direction is not seen in the data
_WORST = 1e6  # a whitened error that stands for parameters with which there is no prediction


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
    correlation of a whitened error with the one before it.
    """

    source: SourceModel
    estimates: tuple[Estimate, ...]
    covariance: FloatArray
    noise: Mapping[str, float]
    drift: Mapping[str, tuple[float, float]]
    correlation: float
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


def fit_parameters(
    source: SourceModel,
    traces: Sequence[Trace],
    names: Sequence[str],
    *,
    only: Sequence[str] | None = None,
    by_ratio: bool = False,
) -> Fit:
    """Return the parameters `names` of a model file under which it predicts the traces best.

    `only`: use these locations; by default all.  `by_ratio`: take the location from the model's comparison of ratios.

    Raises `UsageError`: DH0730 and DH0731 for a parameter that cannot be fitted, DH0732 to DH0734 for traces, locations
    and models that are not enough.

    >>> from deshybrid.model.source import parse_source
    >>> source = parse_source('''{format: deshybrid/1, parameters: {k: 2}, state: [h], input: [u], output: [h],
    ...     bounds: {measurement: 0.01}, locations: {on: {A: [[-k]], B: [[1]], C: [[1]]}},
    ...     transitions: [{from: on, to: on, event: a}], observer: {step: 0.1}}''')
    >>> rows = range(40)
    >>> heights = [(1.0 - math.exp(-0.3 * row)) / 3.0 + 0.01 * (row % 2) for row in rows]
    >>> columns = np.ones((40, 1)), np.array(heights)[:, None]
    >>> trace = Trace(elaborate(source), [0.1 * row for row in rows], *columns, true_location=("on",) * 40)
    >>> round(fit_parameters(source, [trace], ["k"]).estimates[0].value, 1)
    3.0
    """
    system = elaborate(source)
    _require(system, only)
    places = [location.name for location in system.locations]
    found = stretches_of(traces, only=places if only is None else only, by_ratio=by_ratio)
    step = float(np.median(np.concatenate([np.diff(trace.time) for trace in traces])))
    return _Search(source, system, tuple(names), found, step).fit()


def _require(system: HybridSystem, only: Sequence[str] | None) -> None:
    if system.is_discrete or not system.output_names:
        raise UsageError(diagnostic("DH0734", f"`{system.name}` measures nothing that parameters could be fitted to"))
    known = {location.name for location in system.locations}
    for name in only or ():
        if name not in known:
            raise UsageError(diagnostic("DH0720", f"the model has no location `{name}`"))


class _Search:
    """One least-squares problem; coordinates: parameters, then logarithms of noise levels over their start."""

    def __init__(
        self, source: SourceModel, system: HybridSystem, names: tuple[str, ...], found: tuple[Stretch, ...], step: float
    ) -> None:
        with_parameters(source, dict.fromkeys(names, 1.0))  # tells of names that are none
        values = build_scope(source, Problems()).parameters
        self.source, self.system, self.names, self.stretches, self.step = source, system, names, found, step
        self.start = np.array([values[name] or 0.0 for name in names])
        self.doubt = _first_doubt(system, found)
        self.numbers = sum(stretch.outputs.size for stretch in found)
        self.drifting = np.flatnonzero(self.doubt.drift > 0.0)

    def fit(self) -> Fit:
        """Solve the problem and measure how sharp its minimum is."""
        from scipy.optimize import least_squares

        size = len(self.names) + len(self.doubt.noise) - 1 + 2 * len(self.drifting)
        farthest = np.full(size, _FARTHEST)
        farthest[: len(self.names)][self.start == 0.0] = np.inf
        z = least_squares(
            self.residuals,
            np.zeros(size),
            bounds=(-farthest, farthest),
            x_scale="jac",
            diff_step=[_STEP],
            ftol=1e-6,
            xtol=1e-6,
        ).x
        J = self._jacobian(z)
        scale = float(np.sum(self.residuals(z) ** 2)) / self.numbers
        covariance = _covariance(J, scale)[: len(self.names), : len(self.names)]
        return self._result(z, covariance, scale)

    def values(self, z: FloatArray) -> FloatArray:
        """The parameters at a point of the search."""
        head = z[: len(self.names)]
        return np.where(self.start != 0.0, self.start * np.exp(head), head)

    def residuals(self, z: FloatArray) -> FloatArray:
        """r of the module's docstring; large numbers where the model cannot predict at all."""
        try:
            white, log_size = self._errors(z)
        except (ModelError, UsageError, GainError, np.linalg.LinAlgError, FloatingPointError):
            return np.full(self.numbers, _WORST)
        together = np.concatenate([errors.ravel() for errors in white])
        return together * float(np.exp(log_size / (2.0 * self.numbers)))

    def _errors(self, z: FloatArray) -> tuple[list[FloatArray], float]:
        values = dict(zip(self.names, self.values(z).tolist(), strict=True))
        system = elaborate(with_parameters(self.source, values))
        doubt = self._doubt(z)
        longest: dict[str, int] = {}
        for stretch in self.stretches:
            longest[stretch.location] = max(longest.get(stretch.location, 0), len(stretch.outputs))
        predictors = {}
        with np.errstate(over="raise", invalid="raise"):
            for name, samples in longest.items():
                location = system.location(name)
                own = replace(doubt, noise=doubt.noise[list(location.output_index)])
                if location.dynamics is not None:
                    predictors[name] = build_predictor(
                        location.dynamics,
                        own,
                        step=self.step,
                        is_sampled=system.time_step is not None,
                        samples=samples,
                    )
            found = [predictors[stretch.location].errors(stretch) for stretch in self.stretches]
        return [white for white, _ in found], sum(log_size for _, log_size in found)

    def _doubt(self, z: FloatArray) -> Doubt:
        levels = np.exp(z[len(self.names) :])
        first, second = len(self.doubt.noise) - 1, len(self.doubt.noise) - 1 + len(self.drifting)
        noise, drift, memory = self.doubt.noise.copy(), self.doubt.drift.copy(), self.doubt.memory.copy()
        noise[1:] *= levels[:first]
        drift[self.drifting] *= levels[first:second]
        memory[self.drifting] *= levels[second:]
        return replace(self.doubt, noise=noise, drift=drift, memory=memory)

    def _jacobian(self, z: FloatArray) -> FloatArray:
        """Central differences."""
        columns = []
        for shift in _STEP * np.eye(len(z)):
            columns.append((self.residuals(z + shift) - self.residuals(z - shift)) / (2.0 * shift.max()))
        return np.array(columns).T

    def _result(self, z: FloatArray, covariance: FloatArray, scale: float) -> Fit:
        from scipy.stats import t

        factor = float(t.ppf(0.5 + CONFIDENCE / 2.0, max(1, self.numbers - len(z))))
        spreads = np.sqrt(np.diag(covariance)).tolist()
        parts = zip(self.names, self.start.tolist(), self.values(z).tolist(), spreads, strict=True)
        estimates = tuple(_estimate(name, start, value, spread, factor) for name, start, value, spread in parts)
        doubt, sigma = self._doubt(z), np.sqrt(scale) / np.exp(self._errors(z)[1] / (2.0 * self.numbers))
        drifts = {
            self.system.disturbance_names[place]: (float(sigma * doubt.drift[place]), float(doubt.memory[place]))
            for place in self.drifting
        }
        return Fit(
            self.source,
            estimates,
            covariance,
            dict(zip(self.system.output_names, (sigma * doubt.noise).tolist(), strict=True)),
            drifts,
            _correlation(self._errors(z)[0]),
            self.stretches,
        )


def _estimate(name: str, start: float, value: float, spread: float, factor: float) -> Estimate:
    """One parameter from the standard error of its search coordinate; `factor` of it is half the interval."""
    if not (factor * spread < _FARTHEST or (start == 0.0 and np.isfinite(spread))):
        return Estimate(name, start, value, np.inf, (-np.inf, np.inf))
    if start == 0.0:
        return Estimate(name, start, value, spread, (value - factor * spread, value + factor * spread))
    ends = sorted((value * float(np.exp(-factor * spread)), value * float(np.exp(factor * spread))))
    return Estimate(name, start, value, spread * abs(value), (ends[0], ends[1]))


def _first_doubt(system: HybridSystem, found: Sequence[Stretch]) -> Doubt:
    """Noise and sizes to start from: the model's bounds, and where it states none, the data's own size."""
    bounds = system.bounds
    largest = max(1.0, *(float(np.abs(stretch.outputs).max()) for stretch in found))

    def sizes(stated: FloatArray | None, count: int, otherwise: float) -> FloatArray:
        given = np.full(count, otherwise) if stated is None else stated.astype(np.float64)
        return np.where(given > 0.0, given, otherwise)

    disturbance = sizes(bounds.disturbance, len(system.disturbance_names), largest)
    entered = np.zeros(len(disturbance), dtype=bool)
    for name in {stretch.location for stretch in found}:
        dynamics = system.location(name).dynamics
        if dynamics is not None:
            entered |= np.abs(dynamics.E).any(axis=0)
    if bounds.disturbance is not None:
        entered &= bounds.disturbance > 0.0
    return Doubt(
        sizes(bounds.measurement, len(system.output_names), 1e-3 * largest),
        np.where(entered, 0.1 * disturbance, 0.0),
        np.ones(len(disturbance)),
        sizes(bounds.state, len(system.state_names), largest),
        disturbance,
    )


def _covariance(J: FloatArray, scale: float) -> FloatArray:
    """(Jᵀ J)⁻¹ times the scale; NaN in rows and columns of what the data do not see."""
    norms = np.linalg.norm(J, axis=0)
    blind = norms == 0.0
    unit = J / np.where(blind, 1.0, norms)
    _, singular, V = np.linalg.svd(unit, full_matrices=False)
    seen = singular > _BLIND * singular[0]
    inverse = np.where(seen, 1.0 / np.where(seen, singular, 1.0), 0.0)
    norms[blind] = 1.0
    covariance: FloatArray = scale * (V.T * inverse**2) @ V / np.outer(norms, norms)
    hidden = (np.abs(V[~seen]) > 1e-3).any(axis=0) | blind
    covariance[hidden] = np.nan
    covariance[:, hidden] = np.nan
    covariance.flags.writeable = False
    return covariance


def _correlation(white: Sequence[FloatArray]) -> float:
    """The largest correlation, over the outputs, of an error with the one before it in its stretch."""
    outputs = max(errors.shape[1] for errors in white)
    found = []
    for channel in range(outputs):
        parts = [errors[:, channel] for errors in white if channel < errors.shape[1]]
        together = sum(float(part[1:] @ part[:-1]) for part in parts)
        found.append(abs(together) / max(1e-300, sum(float(part @ part) for part in parts)))
    return max(found)


__all__ = ["Estimate", "Fit", "fit_parameters"]
