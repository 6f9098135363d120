"""Plots of an observer at work on a trace: what was true and what was named, what decided it, outputs and states.

In: plain names and arrays, row by row.  Out: SVG bytes, the same for the same values.  Needs matplotlib (extra `plot`).
Colours: where the own location is true is blue, a wrong name is red, no name is grey.  What exceeds twice its level is
drawn logarithmically beyond it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deshybrid.emit.picture import printable
from deshybrid.emit.plotting import as_svg, band, new_figure, plain_style
from deshybrid.linear.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from numpy.typing import NDArray

MOST_PANELS = 12
_TALLEST = 9.0  # inches of a timeline
_STRIP = 0.06  # of a panel: where the location is accepted
_WIDTH = 9.0


@dataclass(frozen=True, slots=True, eq=False)
class Panel:
    """What decides about one location: a column of `values` (N, c) for each curve; `active` (N,): accepted."""

    location: str
    title: str
    curves: Sequence[str]
    levels: Sequence[float]
    values: FloatArray
    active: Sequence[bool]


@dataclass(frozen=True, slots=True, eq=False)
class Timeline:
    """True and said names over time (N,) in s; `names` in their order from below, None where a name is not known.

    `truth` is None where nothing is known of it.  `fired`: times and locations of signatures.  `marks`: times that
    stand out, `marked` says for what.
    """

    title: str
    names: Sequence[str]
    time: FloatArray
    truth: Sequence[str | None] | None
    named: Sequence[str | None]
    fired: Sequence[tuple[float, str]] = ()
    marks: Sequence[float] = ()
    marked: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Course:
    """One number over time: what was measured or is true, and what the observer says; (N,), NaN where not known."""

    label: str
    given: FloatArray
    estimated: FloatArray
    kind: str  # what `given` is: "measured" or "true"


def timeline_plot(line: Timeline, panels: Sequence[Panel] = ()) -> bytes:
    """Return what was true and named and, below it, what decided; of more than twelve panels the first twelve.

    >>> line = Timeline("a case", "ab", np.arange(3.0), "aab", ["a", None, "b"], [(2.0, "b")], [2.0], "entry")
    >>> panel = Panel("b", "s_b", ["y"], [1.0, 1.1], np.array([[3.0], [2.0], [0.5]]), [False, False, True])
    >>> picture = timeline_plot(line, [panel])
    >>> all(text in picture for text in (b"a case", b"s_b", b"wrong name", b"no name"))
    True
    """
    shown = list(panels)[:MOST_PANELS]
    tall = min(1.4 + 0.22 * len(line.names), _TALLEST)
    with plain_style():
        figure = new_figure(_WIDTH, tall + 0.6 + 1.15 * len(shown))
        ratios = [tall, *(1.15 for _ in shown)]
        grid = figure.subplots(1 + len(shown), 1, sharex=True, squeeze=False, height_ratios=ratios)
        _draw_names(grid[0, 0], line)
        for axes, panel, above in zip(grid[1:, 0], shown, [None, *shown], strict=False):
            _draw_panel(axes, line, panel)
            if above is None or above.curves != panel.curves:
                _legend(axes)
        grid[-1, 0].set(xlabel="time (s)")
        return as_svg(figure)


def courses_plot(title: str, time: FloatArray, courses: Sequence[Course]) -> bytes:
    """Return measured and true numbers with the observer's; of more than twelve the first twelve.

    >>> rows = np.arange(3.0)
    >>> b"measured" in courses_plot("a case", rows, [Course("y (m)", rows, rows + 0.1, "measured")])
    True
    """
    shown = list(courses)[:MOST_PANELS]
    with plain_style():
        figure = new_figure(_WIDTH, 0.8 + 1.5 * len(shown))
        grid = figure.subplots(len(shown), 1, sharex=True, squeeze=False)
        for axes, course, above in zip(grid[:, 0], shown, [None, *shown], strict=False):
            if not np.isnan(course.given).all():
                axes.plot(time, course.given, color="tab:grey", linewidth=2.0, label=course.kind)
            axes.plot(time, course.estimated, color="tab:blue", linewidth=1.0, label="observer")
            axes.set(ylabel=printable(course.label))
            axes.margins(x=0.0)
            if above is None or above.kind != course.kind:
                _legend(axes)
        grid[0, 0].set(title=printable(title))
        grid[-1, 0].set(xlabel="time (s)")
        return as_svg(figure)


def _draw_names(axes: "Axes", line: Timeline) -> None:
    """Names as steps, wrong and missing ones as bands, marks as lines from top to bottom."""
    place = {name: float(index) for index, name in enumerate(line.names)}
    said = np.array([place.get(name, np.nan) if name is not None else np.nan for name in line.named])
    if line.truth is not None:
        true = np.array([place.get(name, np.nan) if name is not None else np.nan for name in line.truth])
        wrong = ~np.isnan(true) & ~np.isnan(said) & (true != said)
        band(axes, line.time, wrong, "tab:red", label="wrong name", strength=0.35)
        band(axes, line.time, ~np.isnan(true) & np.isnan(said), "tab:grey", label="no name", strength=0.3)
        axes.step(line.time, true, "-", where="post", linewidth=3.0, color="tab:blue", alpha=0.5, label="true")
    axes.step(line.time, said, "-", where="post", linewidth=1.2, color="black", label="named")
    if line.fired:
        times, locations = zip(*line.fired, strict=True)
        heights = [place[location] for location in locations]
        axes.plot(times, heights, "^", markersize=4.0, color="black", label="signature")
    for number, at in enumerate(line.marks):
        label = None if number else line.marked
        axes.axvline(at, color="tab:red", linewidth=0.9, linestyle="--", label=label)
    axes.set_yticks(range(len(line.names)), [printable(name, 16) for name in line.names])
    axes.set(title=printable(line.title), ylim=(-0.7, len(line.names) - 0.3))
    axes.margins(x=0.0)
    _legend(axes)


def _draw_panel(axes: "Axes", line: Timeline, panel: Panel) -> None:
    """The numbers of one generator against their levels; the own location shaded, acceptance as a strip at the foot."""
    if line.truth is not None:
        band(axes, line.time, _holds(line.truth, panel.location), "tab:blue", label="true", strength=0.15)
    band(axes, line.time, np.array(panel.active, dtype=np.bool_), "tab:green", label="accepted", top=_STRIP)
    for column, name in enumerate(panel.curves):
        axes.plot(line.time, panel.values[:, column], linewidth=1.0, label=printable(name, 24))
    for level in dict.fromkeys(panel.levels):
        axes.axhline(level, color="tab:red", linestyle="--", linewidth=0.9)
    level = max(map(abs, panel.levels))
    if (np.abs(panel.values) > 2.0 * level).any():
        axes.set_yscale("symlog", linthresh=level)
    axes.set(ylabel=printable(panel.title, 16), ylim=(1.3 * min(0.0, *panel.levels), None))
    axes.yaxis.set_major_formatter("{x:g}")
    axes.minorticks_off()
    axes.margins(x=0.0)


def _holds(truth: Sequence[str | None], location: str) -> "NDArray[np.bool_]":
    return np.array([name == location for name in truth], dtype=np.bool_)


def _legend(axes: "Axes") -> None:
    axes.legend(loc="center left", bbox_to_anchor=(1.0, 0.5), fontsize="small", frameon=False)


__all__ = ["MOST_PANELS", "Course", "Panel", "Timeline", "courses_plot", "timeline_plot"]
