"""Plots of a campaign as SVG: histogram of delays, confusion matrix.

In: plain numbers and names.  Out: SVG bytes, the same for the same values.  Needs matplotlib (extra `plot`), which is
loaded when a plot is made.
"""

from collections.abc import Sequence

import numpy as np

from deshybrid.emit.picture import printable
from deshybrid.emit.plotting import as_svg, new_figure, plain_style

_BIN = 0.025  # s
_SMALL = 12  # locations up to which each cell of the matrix shows its share


def delay_histogram(delays: Sequence[float], *, missed: int, limit: float) -> bytes:
    """Return a histogram of signed delays (s) with the limit (s), in bins of 25 ms with one edge at 0.

    >>> b"<svg" in delay_histogram([0.1, 0.2], missed=0, limit=0.25)
    True
    """
    low, high = np.floor(min([0.0, *delays]) / _BIN), np.ceil(max([limit, *delays]) / _BIN) + 1
    with plain_style():
        figure = new_figure(7.0, 3.6)
        axes = figure.add_subplot()
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
    shown = [printable(name) for name in names]
    with plain_style():
        figure = new_figure(1.8 + 0.65 * shares.shape[1], 1.4 + 0.55 * shares.shape[0])
        axes = figure.add_subplot()
        axes.imshow(shares, cmap="Blues", vmin=0.0, vmax=1.0, aspect="auto")
        axes.set_xticks(range(len(shown) + 1), [*shown, "no name"], rotation=45, ha="right")
        axes.set_yticks(range(len(shown)), shown)
        axes.set(xlabel="named", ylabel="true")
        if len(shown) <= _SMALL:
            for (row, column), share in np.ndenumerate(shares):
                if counts[row, column]:
                    colour = "white" if share > 0.5 else "black"
                    axes.text(column, row, f"{100 * share:.2g}", ha="center", va="center", color=colour)
        axes.set_title("samples, % of each row")
        return as_svg(figure)


__all__ = ["confusion_plot", "delay_histogram"]
