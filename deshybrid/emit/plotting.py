"""What all plots have in common: matplotlib in one style, SVG without a date, names as they are.

In: a function that draws into a figure.  Out: SVG bytes, the same for the same values, whatever settings of matplotlib
the user keeps.  Needs matplotlib (extra `plot`), which is loaded when a plot is made.
"""

import io
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import numpy as np

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure
    from numpy.typing import NDArray

_STYLE = {"svg.hashsalt": "deshybrid", "svg.fonttype": "none", "text.parse_math": False}


def require_matplotlib() -> None:
    """Raise `UsageError` (DH0806) where matplotlib is not installed."""
    try:
        import matplotlib  # noqa: F401
    except ImportError as error:
        helps = ("install it with `pip install deshybrid[plot]`",)
        raise UsageError(diagnostic("DH0806", "plots need matplotlib, which is not installed", helps=helps)) from error


@contextmanager
def plain_style() -> Iterator[None]:
    """Draw and save under it: the defaults of matplotlib, no formulas in names, no warnings of letters without a shape.

    Raises `UsageError` (DH0806) where matplotlib is not installed.
    """
    require_matplotlib()
    from matplotlib import style

    with style.context(["default", _STYLE]), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing from", category=UserWarning)
        yield


def new_figure(width: float, height: float) -> "Figure":
    """Return an empty figure of so many inches, for use under `plain_style`."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def as_svg(figure: "Figure") -> bytes:
    """Return a figure as SVG without a date; texts stay texts, so that a reader can search them.

    The layout's last digits vary from run to run, so that places are rounded before anything is drawn.

    >>> with plain_style():
    ...     as_svg(new_figure(2.0, 1.0))[:5]
    b'<?xml'
    """
    figure.draw_without_rendering()
    figure.set_layout_engine("none")
    for axes in figure.axes:
        axes.set_position(np.round(axes.get_position().bounds, 6).tolist())
    stream = io.BytesIO()
    figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def band(
    axes: "Axes",
    time: FloatArray,
    mask: "NDArray[np.bool_]",
    colour: str,
    *,
    label: str | None = None,
    top: float = 1.0,
    strength: float = 1.0,
) -> None:
    """Fill where `mask` (N,) holds, each row up to the next one, from the foot of the axes up to a share of them."""
    edges = np.flatnonzero(np.diff(np.concatenate(([False], mask, [False]))))
    begin, end = time[edges[::2]], time[np.minimum(edges[1::2], len(time) - 1)]
    spans = np.stack((begin, end - begin), axis=1).tolist()
    place = axes.get_xaxis_transform()
    axes.broken_barh(spans, (0.0, top), transform=place, color=colour, alpha=strength, linewidth=0.0, label=label)


__all__ = ["as_svg", "band", "new_figure", "plain_style", "require_matplotlib"]
