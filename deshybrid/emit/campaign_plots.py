"""Plots of a campaign as SVG: histogram of delays, confusion matrix, timelines of single engagements.

In: plain numbers and names.  Out: SVG bytes, the same for the same values.  Needs matplotlib (extra `plot`), which is
loaded when a plot is made.
"""

import io
from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

_BIN = 0.025  # s
_SMALL = 12  # locations up to which each cell of the matrix shows its share


@dataclass(frozen=True, slots=True)
class Timeline:
    """True and said names over time (s) around an engagement, which is entered at `enter`."""

    title: str
    time: Sequence[float]
    truth: Sequence[str | None]
    named: Sequence[str | None]
    enter: float


def require_matplotlib() -> None:
    """Raise `UsageError` (DH0806) where matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        helps = ("install it with `pip install deshybrid[plot]`",)
        raise UsageError(diagnostic("DH0806", "plots need matplotlib, which is not installed", helps=helps)) from error


def delay_histogram(delays: Sequence[float], *, missed: int, limit: float) -> bytes:
    """Return a histogram of signed delays (s) with the limit (s), in bins of 25 ms with one edge at 0.

    >>> b"<svg" in delay_histogram([0.1, 0.2], missed=0, limit=0.25)
    True
    """
    figure, axes = _axes(7.0, 3.6)
    low, high = np.floor(min([0.0, *delays]) / _BIN), np.ceil(max([limit, *delays]) / _BIN) + 1
    axes.hist(list(delays), bins=(np.arange(low, high + 1) * _BIN).tolist(), color="tab:blue")
    axes.axvline(limit, color="tab:red", linestyle="--", label=f"limit {limit:g} s")
    axes.set(xlabel="delay (s), negative: named before the entry", ylabel="engagements")
    axes.set_title(f"{len(delays)} engagements named, {missed} missed")
    axes.legend()
    return as_svg(figure)


def confusion_plot(names: Sequence[str], samples: Sequence[Sequence[int]]) -> bytes:
    """Return the confusion matrix as shares of each row; `samples` (L, L + 1), the last column without a name.

    >>> b"no name" in confusion_plot("ab", [[3, 1, 0], [0, 2, 2]])
    True
    """
    counts = np.array(samples, dtype=np.float64)
    shares = counts / np.maximum(counts.sum(axis=1, keepdims=True), 1.0)
    figure, axes = _axes(1.8 + 0.65 * shares.shape[1], 1.4 + 0.55 * shares.shape[0])
    axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
    axes.set_xticks(range(len(names) + 1), [*names, "no name"], rotation=45, ha="right")
    axes.set_yticks(range(len(names)), list(names))
    axes.set(xlabel="named", ylabel="true")
    if len(names) <= _SMALL:
        for (row, column), share in np.ndenumerate(shares):
            if counts[row, column]:
                colour = "white" if share > 0.5 else "black"
                axes.text(column, row, f"{100 * share:.2g}", ha="center", va="center", color=colour)
    axes.set_title("samples, % of each row")
    return as_svg(figure)


def timeline_plot(line: Timeline, names: Sequence[str]) -> bytes:
    """Return what was true and what was named around one engagement; `names` in the order from below.

    >>> line = Timeline("a case", [0.0, 1.0, 2.0], "aab", ["a", None, "b"], 2.0)
    >>> b"a case" in timeline_plot(line, "ab")
    True
    """
    figure, axes = _axes(7.0, 1.6 + 0.3 * len(names))
    place = {name: float(index) for index, name in enumerate(names)}
    for said, style, width, label in ((line.truth, "-", 3.0, "true"), (line.named, "--", 1.5, "named")):
        heights = [np.nan if name is None else place[name] for name in said]
        axes.step(list(line.time), heights, style, where="post", linewidth=width, label=label)
    axes.axvline(line.enter, color="grey", linewidth=0.8)
    axes.set_yticks(range(len(names)), list(names))
    axes.set(xlabel="time (s)", title=line.title)
    axes.legend(loc="best")
    return as_svg(figure)


def _axes(width: float, height: float) -> "tuple[Figure, Axes]":
    require_matplotlib()
    from matplotlib.figure import Figure

    figure = Figure(figsize=(width, height), layout="constrained")
    return figure, figure.add_subplot()


def as_svg(figure: "Figure") -> bytes:
    """Return a figure as SVG without a date; texts stay texts, so that a reader can search them."""
    import matplotlib

    stream = io.BytesIO()
    with matplotlib.rc_context({"svg.hashsalt": "deshybrid", "svg.fonttype": "none", "text.parse_math": False}):
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


__all__ = ["Timeline", "as_svg", "confusion_plot", "delay_histogram", "require_matplotlib", "timeline_plot"]
