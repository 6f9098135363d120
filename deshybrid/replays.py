"""An observer at work on a trace, as pictures: the timeline with what decided, outputs and states, the worst cases.

In: estimates with what they were judged by.  Out: the bytes of SVG files by their names.
Cost: that of the drawings.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.emit.replay_plots import Course, Panel, Timeline, courses_plot, timeline_plot
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem
from deshybrid.observer.hybrid import HybridObserver
from deshybrid.simulate.campaign_jobs import WrongName, longest_wrong, wrong_names
from deshybrid.simulate.judged import Judged, replay_judged
from deshybrid.simulate.replay import EstimateTrace
from deshybrid.simulate.score import Engagement, is_late, score_locations
from deshybrid.simulate.trace import Trace

BEFORE, BEHIND = 1.0, 0.5  # s that a close-up shows besides
CLOSE_UPS = 3  # pictures of single engagements


@dataclass(frozen=True, eq=False)
class Replay:
    """An observer's estimates of a trace, and what its residual generators were judged by."""

    observer: HybridObserver
    estimates: EstimateTrace
    judged: tuple[Judged, ...]

    @property
    def trace(self) -> Trace:
        """The trace that was replayed."""
        return self.estimates.trace

    @cached_property
    def late(self) -> tuple[Engagement, ...]:
        """The engagements that were named later than the limit or never, worst first; at most five."""
        truth = self.trace.true_location
        if truth is None:
            return ()
        score = score_locations(self.trace.time.tolist(), truth, self.estimates.location)
        return tuple(e for e in score.worst if e.delay is None or is_late(e.delay, score.limit))

    @property
    def foreign(self) -> WrongName | None:
        """The longest name that was neither still held nor only early, None where there is none."""
        truth = self.trace.true_location or (None,) * len(self.trace)
        found = longest_wrong(wrong_names(self.trace.time.tolist(), truth, self.estimates.location))
        kept = [wrong for wrong in found if wrong.kind == "foreign"]
        return max(kept, key=lambda wrong: wrong.seconds, default=None)


def replayed(observer: HybridObserver, trace: Trace) -> Replay:
    """Run an observer over a trace and keep what its residual generators were judged by."""
    return Replay(observer, *replay_judged(observer, trace))


def plots(made: Replay, between: tuple[float, float] | None = None) -> dict[str, bytes]:
    """Return `timeline.svg`, `states.svg` where there are any, and close-ups: `worst-1.svg` and so on of what was late,
    `foreign.svg` of the longest foreign name.

    `between`: the times (s) that are drawn, all where None.  Raises `UsageError`: DH0806 without matplotlib, DH0728
    where no row lies between the times.

    >>> import deshybrid as dh
    >>> from deshybrid.simulate.execution import simulate
    >>> tank = dh.load("models/two_tank.yaml")
    >>> list(plots(replayed(dh.compile(tank).observer, simulate(tank, duration=3.0).trace), (1.0, 3.0)))
    ['timeline.svg', 'states.svg']
    """
    rows, system = _rows(made.trace, between), made.trace.system
    line = _timeline(made, rows, system.name, marks=[found.enter for found in made.late], marked="late or missed")
    drawn = {"timeline.svg": timeline_plot(line, _panels(made, rows))}
    if not system.is_discrete:
        drawn["states.svg"] = courses_plot(system.name, made.trace.time[rows], _courses(made, rows))
    time = made.trace.time[rows]
    late = [found for found in made.late if time[0] <= found.enter <= time[-1]]
    for rank, engagement in enumerate(late[:CLOSE_UPS], start=1):
        drawn[f"worst-{rank}.svg"] = close_up(made, engagement, system.name)
    foreign = made.foreign
    if foreign is not None and time[0] <= foreign.begin <= time[-1]:
        drawn["foreign.svg"] = close_up_of_name(made, foreign, system.name)
    return drawn


def close_up(made: Replay, engagement: Engagement, where: str) -> bytes:
    """Return the timeline around an engagement, with what decided about the locations that were true or named."""
    end = engagement.leave if engagement.delay is None else engagement.enter + max(engagement.delay, 0.0)
    delay = "never named" if engagement.delay is None else f"named {engagement.delay:+.3f} s"
    title = f"{engagement.location}, {where} at {engagement.enter:.3f} s: {delay}"
    return _close_up(made, (engagement.enter, end), title, "entry")


def close_up_of_name(made: Replay, wrong: WrongName, where: str) -> bytes:
    """Return the timeline around a wrong name."""
    title = f"{wrong.named} for {wrong.seconds:.3f} s while {wrong.truth} is true, {where} at {wrong.begin:.3f} s"
    return _close_up(made, (wrong.begin, wrong.begin + wrong.seconds), title, "wrong name begins")


def _close_up(made: Replay, during: tuple[float, float], title: str, marked: str) -> bytes:
    rows = _rows(made.trace, (during[0] - BEFORE, during[1] + BEHIND))
    line = _timeline(made, rows, title, marks=[during[0]], marked=marked)
    return timeline_plot(line, _panels(made, rows))


def _rows(trace: Trace, between: tuple[float, float] | None) -> slice:
    first, last = (0, len(trace)) if between is None else np.searchsorted(trace.time, between, side="left").tolist()
    if last <= first:
        span = f"goes from {trace.time[0]:g} s to {trace.time[-1]:g} s" if len(trace) else "is empty"
        asked = "" if between is None else f" between {between[0]:g} s and {between[1]:g} s"
        raise UsageError(diagnostic("DH0728", f"there is no row to draw{asked}", notes=(f"the trace {span}",)))
    return slice(first, last)


def _timeline(made: Replay, rows: slice, title: str, *, marks: Sequence[float], marked: str) -> Timeline:
    estimates, trace, time = made.estimates, made.trace, made.trace.time[rows]
    announced = {signature.name: signature.location for signature in made.observer.plan.signatures}
    fired = [
        (at, announced[name])
        for at, name in zip(time.tolist(), estimates.signature[rows], strict=True)
        if name in announced
    ]
    return Timeline(
        title=title,
        names=[location.name for location in trace.system.locations],
        time=time,
        truth=None if trace.true_location is None else trace.true_location[rows],
        named=estimates.location[rows],
        fired=fired,
        marks=[at for at in marks if time[0] <= at <= time[-1]],
        marked=marked,
    )


def _panels(made: Replay, rows: slice) -> list[Panel]:
    """What decided about the locations that were true, named or accepted in these rows."""
    met = {*(made.trace.true_location or ())[rows], *made.estimates.location[rows]}
    return [
        Panel(
            location=entry.location,
            title=entry.signature or entry.location,
            curves=entry.scale.curves,
            levels=entry.scale.levels,
            values=entry.values[rows],
            active=entry.active[rows],
        )
        for entry in made.judged
        if entry.location in met or any(entry.active[rows])
    ]


def _courses(made: Replay, rows: slice) -> list[Course]:
    """Outputs as measured and as the estimated state explains them, then the other states as they are and estimated."""
    trace, estimates, system = made.trace, made.estimates, made.trace.system
    explained = explained_outputs(system, estimates)
    found = [
        Course(_labelled(system, name), trace.outputs[rows, place], explained[rows, place], "measured")
        for place, name in enumerate(system.output_names)
    ]
    truth = trace.true_state
    unknown = np.full((len(trace), len(system.state_names)), np.nan)
    found += [
        Course(
            _labelled(system, name),
            (unknown if truth is None else truth)[rows, place],
            estimates.state[rows, place],
            "true",
        )
        for place, name in enumerate(system.state_names)
        if name not in system.output_names
    ]
    return found


def explained_outputs(system: HybridSystem, estimates: EstimateTrace) -> FloatArray:
    """Return C x̂ + D u + g of the location that is named, (N, p); NaN where none is, or where it lacks the output.

    >>> import deshybrid as dh
    >>> from deshybrid.simulate.execution import simulate
    >>> from deshybrid.simulate.replay import replay
    >>> tank = dh.load("models/two_tank.yaml")
    >>> estimates = replay(dh.compile(tank).observer, simulate(tank, duration=1.0).trace)
    >>> explained_outputs(tank, estimates).shape
    (101, 1)
    """
    explained = np.full((len(estimates), len(system.output_names)), np.nan)
    for location in system.locations:
        rows = [row for row, name in enumerate(estimates.location) if name == location.name]
        dynamics = location.dynamics
        if dynamics is not None and rows:
            u = estimates.trace.inputs[np.ix_(rows, list(location.input_index))]
            y = estimates.state[rows] @ dynamics.C.T + u @ dynamics.D.T + dynamics.g
            explained[np.ix_(rows, list(location.output_index))] = y
    return explained


def _labelled(system: HybridSystem, name: str) -> str:
    unit = system.units.get(name)
    return f"{name} ({unit})" if unit else name


__all__ = ["CLOSE_UPS", "Replay", "close_up", "close_up_of_name", "explained_outputs", "plots", "replayed"]
