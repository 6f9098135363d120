"""The command `estimate`: a stochastic model and a trace in, the filter's estimates and their score out.

The columns `true_location` and `true_<state>` of a trace are read for the score only; `skf` alone, whose mode is known
by definition, takes it from `true_location`.  A model in continuous time is sampled at the mean distance of the
trace's rows.  Rows are equally spaced, or some are missing: a gap of several steps is predicted over, step by step, as
if its rows were there without a measurement; the inputs and the known location of the row before are held.

One step a row.  Source: Hwang et al. (2006), section 3.
"""

import math
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from deshybrid.compiler import Source, to_hybrid
from deshybrid.diagnostics import Diagnostic, TraceError, UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, ObserverOptions
from deshybrid.simulate.spacing import mean_step, places
from deshybrid.simulate.table import decode, read_bytes
from deshybrid.simulate.trace import Trace, parse_trace, quoted, shortest
from deshybrid.stochastic.calibration import normal_scores
from deshybrid.stochastic.from_model import require_stochastic, stochastic_system
from deshybrid.stochastic.gating import PATIENCE
from deshybrid.stochastic.record import Engine, Estimates, estimate, estimate_known
from deshybrid.stochastic.score import Consistency, Switch, nees, switches
from deshybrid.stochastic.smoothing import smooth
from deshybrid.stochastic.system import StochasticSystem

EstimateMethod: TypeAlias = Literal["mmae", "imm", "rmimm", "skf"]


@dataclass(frozen=True, eq=False)
class Estimation:
    """The estimates of one trace, row by row, and what they were made from."""

    trace: Trace
    system: StochasticSystem
    method: EstimateMethod
    estimates: Estimates
    gate: float | None = None
    lag: int = 0
    gaps: tuple[int, ...] = ()  # how many rows are missing in each gap
    engine: Engine = "numpy"
    measured: tuple[FloatArray, FloatArray | None] | None = None  # every step, missing rows as well, and the inputs

    @cached_property
    def location(self) -> tuple[str, ...]:
        """The most probable location of each row."""
        return tuple(self.system.names[number] for number in self.estimates.most_probable.tolist())

    @property
    def log_likelihood(self) -> float:
        """log p of all measurements of the trace."""
        return float(self.estimates.log_likelihood.sum())

    def csv(self) -> str:
        """Return the columns `time, location, p_<location>, <state>_hat` as CSV."""
        states = self.trace.system.state_names
        header = ["time", "location", *(f"p_{name}" for name in self.system.names), *(f"{name}_hat" for name in states)]
        numbers = np.hstack([self.estimates.mu, self.estimates.x]).tolist()
        lines = [",".join(map(quoted, header))]
        for time, name, row in zip(self.trace.time.tolist(), self.location, numbers, strict=True):
            lines.append(",".join([shortest(time), quoted(name), *map(shortest, row)]))
        return "\n".join(lines) + "\n"

    @property
    def consistency(self) -> Consistency:
        """Squared residuals of all rows but outliers; only a mixture of one is χ² exactly."""
        return Consistency(float(self.estimates.nis.sum()), int(self.estimates.channels.sum()))

    @cached_property
    def calibration(self) -> Consistency | None:
        """Squared normal scores of all rows, χ² for a mixture, too; None but for `imm` and `mmae` as they stand."""
        if self.measured is None or self.method not in ("imm", "mmae") or self.gate is not None:
            return None
        scores = normal_scores(self.system, *self.measured, method="imm" if self.method == "imm" else "mmae")
        return Consistency(float(np.nansum(scores**2)), int((~np.isnan(scores)).sum()))

    @cached_property
    def problems(self) -> tuple[Diagnostic, ...]:
        """What the trace holds and no filter reads (DH1110)."""
        rows = [k + 1 for k, event in enumerate(self.trace.events) if event is not None]
        if not rows:
            return ()
        text = f"no filter reads the events of the trace; there are {len(rows)}, the first in row {rows[0]}"
        return (diagnostic("DH1110", text, severity="warning"),)

    @cached_property
    def truth(self) -> "Truth":
        """How the estimates stand beside the truth columns, as far as the trace has them."""
        true, names = self.trace.true_location, self.trace.system.state_names
        right = None
        if true is not None and any(name is not None for name in true):
            known = [(a, b) for a, b in zip(true, self.location, strict=True) if a is not None]
            right = sum(a == b for a, b in known) / len(known)
        found = () if true is None else switches(true, self.location)
        if self.trace.true_state is None:
            return Truth(right, found, (), None, None)
        errors = self.estimates.x - self.trace.true_state
        known_rows = ~np.isnan(errors)
        rms = tuple(
            (name, math.hypot(*errors[known_rows[:, i], i].tolist()) / math.sqrt(known_rows[:, i].sum()))
            for i, name in enumerate(names)
            if known_rows[:, i].any()
        )
        whole = known_rows.all(axis=1)
        with np.errstate(over="ignore", invalid="ignore"):  # a truth beyond all numbers has no NEES
            squares = nees(errors[whole], self.estimates.P[whole])
        if not squares.size or not np.isfinite(squares).all():
            return Truth(right, found, rms, None, None)
        low, high = Consistency(0.0, len(names)).band
        return Truth(right, found, rms, float(squares.mean()), float(((low <= squares) & (squares <= high)).mean()))

    def record(self) -> dict[str, object]:
        """Return the summary as a tree for JSON."""
        sums = self.consistency
        return {
            "format": "deshybrid-estimate/1",
            "name": self.trace.system.name,
            "method": self.method,
            "engine": self.engine,
            "rows": len(self.trace),
            "missing_rows": sum(self.gaps),
            "log_likelihood": self.log_likelihood,
            "nis": sums.record(),
            "normal_scores": None if self.calibration is None else self.calibration.record(),
            "lag": self.lag,
            "gate": self.gate,
            "outliers": (np.flatnonzero(self.estimates.gated) + 1).tolist(),
            "readmitted": (np.flatnonzero(self.estimates.readmitted) + 1).tolist(),
            "score": self.truth.record(),
        }

    def __str__(self) -> str:
        lines = [f"log-likelihood: {self.log_likelihood:.6f} over {len(self.trace)} rows ({self.method})"]
        if self.gaps:
            rows, gaps = sum(self.gaps), len(self.gaps)
            where = f"in {gaps} gap{'s' * (gaps > 1)}"
            lines.append(f"missing: {rows} row{'s' * (rows > 1)} {where}, predicted only")
        if self.lag:
            lines.append(f"smoothed: each row with {self.lag} rows after it")
        for name, sums in (("NIS", self.consistency), ("normal scores", self.calibration)):
            if sums is not None and sums.freedom:
                lines.append(f"{name}: {sums}")
        if self.gate is not None:
            taken = int(self.estimates.readmitted.sum())
            back = f"; {taken} more taken, as {PATIENCE} in a row had been left out" if taken else ""
            out = int(self.estimates.gated.sum())
            lines.append(f"outliers: {out} rows beyond the gate of {self.gate:g}, left out{back}")
        return "\n".join([*lines, *self.truth.lines(len(self.system.x))])


@dataclass(frozen=True, slots=True)
class Truth:
    """Share of rows with the right location, switches and delays, RMS by state, NEES; None or empty where unknown.

    `nees_within` is the share of rows whose NEES lies in the 95 % band of one row: squared errors of neighbouring rows
    depend on each other, so that their sum has no band of its own.
    """

    right: float | None
    switches: tuple[Switch, ...]
    rms: tuple[tuple[str, float], ...]
    nees: float | None
    nees_within: float | None

    def record(self) -> dict[str, object]:
        """Return the score as a tree for JSON."""
        return {
            "right": self.right,
            "switches": [{"row": s.row, "location": s.mode, "delay": s.delay} for s in self.switches],
            "rms": dict(self.rms),
            "nees": self.nees,
            "nees_within_95": self.nees_within,
        }

    def lines(self, states: int) -> list[str]:
        """Return the score as lines of text."""
        found = [] if self.right is None else [f"location: {100 * self.right:.2f} % of the rows right"]
        for switch in self.switches:
            seen = "not named before the next" if switch.delay is None else f"named at row {switch.delay} of the stay"
            found.append(f"  switch to {switch.mode} at row {switch.row}: {seen}")
        found += [f"error of {name}: {rms:.4g} rms" for name, rms in self.rms]
        if self.nees is None or self.nees_within is None:
            return found
        low, high = Consistency(0.0, states).band
        share = f"{100 * self.nees_within:.1f} % of the rows within the 95 % band {low:.3f} to {high:.3f} of one row"
        return [*found, f"NEES: {self.nees:.3f} on average, {states} expected; {share}"]


def estimate_trace(
    source: Source,
    trace: str | Path,
    *,
    method: EstimateMethod = "imm",
    gate: float | None = None,
    lag: int = 0,
    engine: Engine = "numpy",
) -> Estimation:
    """Return the estimates of a stochastic model (a path or a system) on a trace (a path, or - for standard input).

    A row that no location expects with the probability `gate` counts as missing, up to 5 in a row.  With a `lag`, which
    `imm` alone has, an estimate uses so many rows after its own.  `skf` and the smoother run on the engine `numpy`.

    Raises `ModelError` (DH1101), `UsageError` (DH0306, DH1103, DH1105, DH1108, DH1109, DH1111, DH1112) and `TraceError`
    (DH0310 to DH0324; DH1106 where `skf` is not told the location of a row).

    >>> estimate_trace("models/hwang2006/turn.yaml", "models/hwang2006/turn.csv").location[:2]
    ('CV', 'CV')
    """
    if lag and method != "imm":
        raise UsageError(diagnostic("DH1112", f"`{method}` has no smoother, so that its lag is 0"))
    if engine != "numpy" and (lag or method == "skf"):
        what = "the smoother" if lag else "`skf`"
        raise UsageError(diagnostic("DH1109", f"the engine `{engine}` does not run {what}"))
    model = to_hybrid(source)
    require_stochastic(model)
    name, data = read_bytes(trace)
    samples, step = _read_trace(decode(name, data), model, name)
    system = stochastic_system(model, step=step)
    at = np.arange(len(samples)) if step is None else places(samples.time, step)
    z, u, before = _every_step(samples, at)
    if method == "skf":
        made = estimate_known(system, z, np.array(_known(samples))[before], u, gate=gate)
    elif method == "imm" and lag:
        made = smooth(system, z, u, lag=lag, gate=gate)
    else:
        made = estimate(system, z, u, method=method, gate=gate, engine=engine)
    gaps = tuple(gap - 1 for gap in np.diff(at).tolist() if gap > 1)
    return Estimation(samples, system, method, made.rows(at), gate, lag, gaps, engine, (z, u))


def plot(made: Estimation) -> bytes:
    """Return a plot of the estimates as SVG; raises `UsageError` (DH0806) without matplotlib.

    >>> b"<svg" in plot(estimate_trace("models/hwang2006/turn.yaml", "models/hwang2006/turn.csv"))
    True
    """
    from deshybrid.emit.estimate_plot import EstimatePlot, estimate_plot

    trace, estimates, names = made.trace, made.estimates, made.system.names
    variances = np.diagonal(estimates.P, axis1=-2, axis2=-1)
    with np.errstate(invalid="ignore", divide="ignore"):
        nis = estimates.nis / estimates.channels  # NaN where nothing was measured
    return estimate_plot(
        EstimatePlot(
            title=f"{trace.system.name}: {made.method}",
            locations=names,
            states=trace.system.state_names,
            time=trace.time,
            mu=estimates.mu,
            true_mode=[-1 if name is None else names.index(name) for name in trace.true_location or ()]
            or [-1] * len(trace),
            x=estimates.x,
            deviation=np.sqrt(np.maximum(variances, 0.0)),
            truth=np.full_like(estimates.x, np.nan) if trace.true_state is None else trace.true_state,
            nis=nis,
            outlier=estimates.gated.tolist(),
        )
    )


def _read_trace(text: str, model: HybridSystem, name: str) -> tuple[Trace, float | None]:
    """The trace and its step: that of the model in discrete time, else the mean distance of its rows."""
    if model.time_step is not None:
        return parse_trace(text, model, step=model.time_step, name=name, missing_rows=True), model.time_step
    samples = parse_trace(text, replace(model, observer=ObserverOptions()), name=name)
    if len(samples) < 2:
        return samples, None
    step = mean_step(samples.time)
    return parse_trace(text, model, step=step, name=name, missing_rows=True), step


def _every_step(samples: Trace, at: NDArray[np.intp]) -> tuple[FloatArray, FloatArray, NDArray[np.intp]]:
    """Measurements and inputs of every step, and which row of the trace is the last one then."""
    steps = np.arange(int(at[-1]) + 1)
    before = np.searchsorted(at, steps, side="right") - 1
    z = np.full((len(steps), samples.outputs.shape[1]), np.nan)
    z[at] = samples.outputs
    return z, samples.inputs[before], before


def _known(samples: Trace) -> list[int]:
    """The number of the true location of every row."""
    true = samples.true_location
    names = [location.name for location in samples.system.locations]
    if true is None or None in true:
        where = "has no column `true_location`" if true is None else f"has none in row {true.index(None) + 1}"
        helps = ("take `imm` where the location is not known",)
        raise TraceError(
            diagnostic("DH1106", f"`skf` needs the location of every row, and the trace {where}", helps=helps)
        )
    return [names.index(name) for name in true if name is not None]


__all__ = ["EstimateMethod", "Estimation", "Truth", "estimate_trace", "plot"]
