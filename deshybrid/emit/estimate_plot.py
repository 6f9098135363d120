"""A plot of a filter's estimates as SVG: probabilities of the locations, squared residuals, states with their spread.

In: plain arrays, row by row.  Out: SVG bytes, the same for the same values.  Needs matplotlib (extra `plot`), which is
loaded when a plot is made.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from deshybrid.emit.plotting import as_svg, new_figure, plain_style
from deshybrid.linear.arrays import FloatArray

_MOST_STATES = 8


@dataclass(frozen=True, slots=True, eq=False)
class EstimatePlot:
    """What is drawn, for N rows: time (N,), mu (N, M), true modes by number or -1 (N,), x and truth (N, n), and so on.

    `deviation` (N, n) is the standard deviation of each state, `nis` (N,) the squared residual of a measured number,
    `outlier` (N,) where a row was left out; what is not known is NaN.
    """

    title: str
    locations: Sequence[str]
    states: Sequence[str]
    time: FloatArray
    mu: FloatArray
    true_mode: Sequence[int]
    x: FloatArray
    deviation: FloatArray
    truth: FloatArray
    nis: FloatArray
    outlier: Sequence[bool]


def estimate_plot(made: EstimatePlot) -> bytes:
    """Return the plot; of more than eight states the first eight are drawn.

    >>> rows, flat, no = np.arange(3.0), np.zeros((3, 1)), [False] * 3
    >>> shown = EstimatePlot("a flight", ["level"], ["x"], rows, flat + 1, [0, 0, -1], flat, flat, flat, rows, no)
    >>> b"a flight" in estimate_plot(shown)
    True
    """
    with plain_style():
        shown = list(made.states)[:_MOST_STATES]
        figure = new_figure(8.0, 3.4 + 1.3 * len(shown))
        axes = figure.subplots(2 + len(shown), 1, sharex=True, squeeze=False)[:, 0]
        true = np.asarray(made.true_mode)
        for place, name in enumerate(made.locations):
            (line,) = axes[0].step(made.time, made.mu[:, place], where="post", label=name)
            height = np.where(true == place, -0.1 - 0.08 * place, np.nan)
            axes[0].step(made.time, height, where="post", color=line.get_color(), linewidth=3.0)
        axes[0].set(ylabel="probability", title=made.title)
        axes[0].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        axes[1].plot(made.time, made.nis, ".", markersize=3.0, color="tab:blue")
        axes[1].axhline(1.0, color="grey", linewidth=0.8)
        axes[1].set(ylabel="NIS, 1 expected", yscale="symlog")
        for place, name in enumerate(shown):
            low, high = (made.x[:, place] + side * made.deviation[:, place] for side in (-2.0, 2.0))
            axes[2 + place].fill_between(made.time, low, high, alpha=0.3, linewidth=0.0, label="± 2 deviations")
            axes[2 + place].plot(made.time, made.x[:, place], label="estimate")
            axes[2 + place].plot(made.time, made.truth[:, place], "k--", linewidth=0.8, label="true")
            axes[2 + place].set(ylabel=name)
        for row in np.flatnonzero(made.outlier).tolist():
            axes[1].axvline(made.time[row], color="tab:red", linewidth=0.8)
        axes[-1].set(xlabel="time (s)")
        axes[-1].legend(loc="center left", bbox_to_anchor=(1.0, 0.5))
        return as_svg(figure)


__all__ = ["EstimatePlot", "estimate_plot"]
