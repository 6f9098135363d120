"""Identification: the parameters of a model under which its predictions of measured samples are best, and how sure.

In: a model file, traces in which the location is known, names of parameters.  Out: a `Fit` with estimates, standard
errors and intervals, and the model's text with the new numbers.

Idea: prediction error.  In every stretch of known location a Kalman filter predicts each sample from those before it,
with free initial state; disturbances that enter the location wander at random.  The likelihood of all errors is largest
where the sum of squares of r = white · exp(Σ log det S / 2N) is least, for whitened errors `white` of N numbers: so one
least-squares problem finds the parameters together with the noise levels, whose common factor drops out.  A parameter
keeps its sign (its logarithm is searched); one that starts at 0 is searched as it is.

`huber`: Σ ρ(r) with ρ(r) = r²/2 up to c and c |r| - c²/2 beyond, c = 1.345 robust deviations (1.4826 times the median
of |r|), so that an outlier counts by its sign alone.  The deviation is taken from the minimum before, three times.

Exact for data made as the filter assumes, for many samples.  Where it does not, the errors are correlated: the result
tells by how much, and intervals count it (`uncertainty`).

Some tens of passes over the data for each parameter.  Source: Ljung, System Identification, sections 7.2, 7.4, 9, 15.2;
Huber and Ronchetti, Robust Statistics, section 7.8.
"""

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from deshybrid.diagnostics import GainError, ModelError, UsageError, diagnostic
from deshybrid.fit.predictor import Doubt, build_predictor
from deshybrid.fit.result import HUBER, Estimate, Fit, Loss
from deshybrid.fit.stretches import Stretch, stretches_of
from deshybrid.fit.uncertainty import Spread, spread_of
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import with_parameters
from deshybrid.model.problems import Problems
from deshybrid.model.scope import build_scope
from deshybrid.model.source import SourceModel
from deshybrid.model.system import HybridSystem
from deshybrid.simulate.trace import Trace

_STEP = 1e-4  # of the search's coordinates, for differences
_FARTHEST = 20.0  # of a logarithm: what is not seen in the data must not run away
_ROUNDS = 3  # of the robust deviation
_WORST = 1e6  # a whitened error that stands for parameters with which there is no prediction


def fit_parameters(
    source: SourceModel,
    traces: Sequence[Trace],
    names: Sequence[str],
    *,
    only: Sequence[str] | None = None,
    by_ratio: bool = False,
    loss: Loss = "squares",
) -> Fit:
    """Return the parameters `names` of a model file under which it predicts the traces best.

    `only`: use these locations; by default all.  `by_ratio`: take the location from the model's comparison of ratios.
    `loss`: how prediction errors count, by their squares or, beyond 1.345 robust deviations, by their size (Huber).

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
    return _Search(source, system, tuple(names), found, step).fit(loss)


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

    def fit(self, loss: Loss) -> Fit:
        """Solve the problem and measure how sharp its minimum is."""
        z = self._minimum(np.zeros(len(self.names) + len(self.doubt.noise) - 1 + 2 * len(self.drifting)), math.inf)
        deviation, limit = float(np.sqrt(np.mean(self.residuals(z) ** 2))), math.inf
        for _ in range(_ROUNDS if loss == "huber" else 0):
            deviation = robust_deviation(self.residuals(z))
            limit = HUBER * deviation
            z = self._minimum(z, limit)
        spread = spread_of(self._jacobian(z), self.residuals(z), self._samples(), limit=limit)
        return self._result(z, spread, deviation, limit, loss)

    def _minimum(self, start: FloatArray, limit: float) -> FloatArray:
        """The minimum of Σ ρ(r), with ρ linear beyond the limit."""
        from scipy.optimize import least_squares

        farthest = np.full(len(start), _FARTHEST)
        farthest[: len(self.names)][self.start == 0.0] = np.inf
        found = least_squares(
            self.residuals,
            start,
            bounds=(-farthest, farthest),
            x_scale="jac",
            diff_step=[_STEP],
            ftol=1e-6,
            xtol=1e-6,
            loss="huber" if math.isfinite(limit) else "linear",
            f_scale=limit if math.isfinite(limit) else 1.0,
        )
        return np.asarray(found.x, dtype=np.float64)

    def _samples(self) -> NDArray[np.intp]:
        """By residual, the number of its sample."""
        widths = np.concatenate([np.full(len(s.outputs), s.outputs.shape[1]) for s in self.stretches])
        return np.repeat(np.arange(len(widths)), widths)

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

    def _result(self, z: FloatArray, spread: Spread, deviation: float, limit: float, loss: Loss) -> Fit:
        k = len(self.names)
        covariance = spread.covariance[:k, :k]
        parts = zip(
            self.names,
            self.start.tolist(),
            self.values(z).tolist(),
            np.sqrt(np.diag(covariance)).tolist(),
            strict=True,
        )
        white, log_size = self._errors(z)
        doubt, sigma = self._doubt(z), deviation / np.exp(log_size / (2.0 * self.numbers))
        drifts = {
            self.system.disturbance_names[place]: (float(sigma * doubt.drift[place]), float(doubt.memory[place]))
            for place in self.drifting
        }
        return Fit(
            self.source,
            tuple(_estimate(name, start, value, size, spread.factor) for name, start, value, size in parts),
            covariance,
            dict(zip(self.system.output_names, (sigma * doubt.noise).tolist(), strict=True)),
            drifts,
            _correlation(white),
            loss,
            float(np.mean(np.abs(self.residuals(z)) > limit)),
            spread.lag,
            self.stretches,
        )


def robust_deviation(residuals: FloatArray) -> float:
    """Return 1.4826 times the median of |r|: the standard deviation of normal numbers, whatever a few outliers do.

    >>> round(robust_deviation(np.array([1.0, -1.0, 1.0, 1e6])), 4)
    1.4826
    """
    return max(1.4826 * float(np.median(np.abs(residuals))), 1e-300)


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


def _correlation(white: Sequence[FloatArray]) -> float:
    """The largest correlation, over the outputs, of an error with the one before it in its stretch."""
    outputs = max(errors.shape[1] for errors in white)
    found = []
    for channel in range(outputs):
        parts = [errors[:, channel] for errors in white if channel < errors.shape[1]]
        together = sum(float(part[1:] @ part[:-1]) for part in parts)
        found.append(abs(together) / max(1e-300, sum(float(part @ part) for part in parts)))
    return max(found)


__all__ = ["fit_parameters", "robust_deviation"]
