"""Small hand-made SVG charts for the report: where the eigenvalues lie, and how long a detection takes.

In: numbers by location.  Out: SVG text that stands inside a page: no script, no id, names escaped, colours and line
widths by class so that the page's light and dark style apply.  Series differ in shape as well as in colour.
"""

import html
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from deshybrid.emit.picture import LONGEST_NAME, printable
from deshybrid.emit.report_numbers import number, seconds

_WIDTH, _HEIGHT = 620.0, 300.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 56.0, 150.0, 14.0, 40.0
_MOST_SERIES = 12
_SHAPES = (
    "M-4,0a4,4 0 1,0 8,0a4,4 0 1,0 -8,0",
    "M-4,-4h8v8h-8z",
    "M0,-5L5,4H-5z",
    "M0,-5L5,0L0,5L-5,0z",
    "M0,5L5,-4H-5z",
    "M-5,-1.5h3.5v-3.5h3v3.5h3.5v3h-3.5v3.5h-3v-3.5h-3.5z",
)


@dataclass(frozen=True, slots=True)
class _Axes:
    """Linear maps from values to the drawing, with the ticks of both axes."""

    left: float
    right: float
    bottom: float
    top: float

    def x(self, value: float) -> float:
        return _LEFT + (value - self.left) / (self.right - self.left) * (_WIDTH - _LEFT - _RIGHT)

    def y(self, value: float) -> float:
        return _HEIGHT - _BOTTOM - (value - self.bottom) / (self.top - self.bottom) * (_HEIGHT - _TOP - _BOTTOM)


def eigenvalue_chart(spectra: Mapping[str, Sequence[complex]], *, rate: float | None, step: float | None) -> str:
    """Return the complex plane with the eigenvalues of each location (at most twelve) and the line of the rate.

    `rate` in 1/s; with a `step` (s) the eigenvalues are those of a sampled system and the rate is a circle.  The text
    is empty where there is nothing to show.

    >>> eigenvalue_chart({"q": [-1 + 2j, -1 - 2j]}, rate=1.0, step=None).count("<path class='mark")
    3
    """
    points = [value for values in spectra.values() for value in values]
    if not points or not all(math.isfinite(abs(value)) for value in points) or len(spectra) > _MOST_SERIES:
        return ""
    axes = _plane(points, rate, step)
    parts = [_frame(axes, "real part" + ("" if step else " (1/s)"), "imaginary part" + ("" if step else " (1/s)"))]
    parts.append(_rate_mark(axes, rate, step))
    for series, (name, values) in enumerate(spectra.items()):
        parts += [_mark(series, axes.x(value.real), axes.y(value.imag)) for value in values]
        height = _TOP + 16 + 18 * series
        parts.append(_mark(series, _WIDTH - _RIGHT + 22, height))
        parts.append(_text(_WIDTH - _RIGHT + 34, height + 4, _shown(name)))
    return _svg("eigenvalues of each location in the complex plane", parts, _HEIGHT)


def delay_chart(delays: Mapping[str, float | None], *, dwell: float | None) -> str:
    """Return one bar per location: the bound on its detection delay (s), beside the dwell time where that is known.

    >>> "no bound" in delay_chart({"q": None, "p": 0.1}, dwell=0.5)
    True
    """
    finite = [value for value in (*delays.values(), dwell) if value is not None and math.isfinite(value)]
    if not delays or not finite or max(finite) <= 0:
        return ""
    height = _TOP + 26.0 * len(delays) + _BOTTOM
    right = 1.15 * max(finite)
    scale = (_WIDTH - 120.0 - 90.0) / right
    parts = []
    for row, (name, value) in enumerate(delays.items()):
        y = _TOP + 26.0 * row
        parts.append(_text(112, y + 14, _shown(name), anchor="end"))
        length = (right if value is None else value) * scale
        kind = "bar none" if value is None else "bar"
        parts.append(f"<rect class='{kind}' x='120' y='{y + 3:.1f}' width='{length:.1f}' height='15' rx='2'/>")
        parts.append(_text(126 + length, y + 15, "no bound" if value is None else seconds(value)))
    if dwell is not None:
        x, foot = 120 + dwell * scale, height - _BOTTOM + 6
        parts.append(f"<line class='rate' x1='{x:.1f}' y1='{_TOP}' x2='{x:.1f}' y2='{foot:.1f}'/>")
        parts.append(_text(x, foot + 14, f"dwell time {seconds(dwell)}", anchor="middle"))
    return _svg("bound on the detection delay of each location", parts, height)


def _plane(points: Iterable[complex], rate: float | None, step: float | None) -> _Axes:
    xs = [value.real for value in points] + [0.0]
    ys = [abs(value.imag) for value in points]
    if step is not None:
        xs += [-1.0, 1.0]
        ys += [1.0]
    elif rate is not None:
        xs.append(-rate)
    wide = max(xs) - min(xs) or 1.0
    tall = max(ys) or wide / 4
    return _Axes(min(xs) - 0.08 * wide, max(xs) + 0.05 * wide, -1.15 * tall, 1.15 * tall)


def _frame(axes: _Axes, below: str, beside: str) -> str:
    """Axes through the origin, four to eight ticks on each, and what they measure."""
    x0, x1, y0, y1 = _LEFT, _WIDTH - _RIGHT, _HEIGHT - _BOTTOM, _TOP
    parts = [f"<rect class='frame' x='{x0}' y='{y1}' width='{x1 - x0}' height='{y0 - y1}'/>"]
    for value in _ticks(axes.left, axes.right):
        x, kind = axes.x(value), "axis" if value == 0 else "grid"
        parts.append(f"<line class='{kind}' x1='{x:.1f}' y1='{y0}' x2='{x:.1f}' y2='{y1}'/>")
        parts.append(_text(x, y0 + 15, number(value, 3), anchor="middle"))
    for value in _ticks(axes.bottom, axes.top):
        y, kind = axes.y(value), "axis" if value == 0 else "grid"
        parts.append(f"<line class='{kind}' x1='{x0}' y1='{y:.1f}' x2='{x1}' y2='{y:.1f}'/>")
        parts.append(_text(x0 - 6, y + 4, number(value, 3), anchor="end"))
    parts.append(_text((x0 + x1) / 2, y0 + 32, below, anchor="middle"))
    middle = (y0 + y1) / 2
    parts.append(f"<text x='12' y='{middle}' transform='rotate(-90 12 {middle})' text-anchor='middle'>{beside}</text>")
    return "".join(parts)


def _ticks(low: float, high: float) -> list[float]:
    """Round numbers inside [low, high], about five of them."""
    raw = (high - low) / 5
    power = 10.0 ** math.floor(math.log10(raw))
    unit = next(factor * power for factor in (1, 2, 5, 10) if factor * power >= raw)
    return [i * unit for i in range(math.ceil(low / unit), math.floor(high / unit) + 1)]


def _rate_mark(axes: _Axes, rate: float | None, step: float | None) -> str:
    """The line Re λ = -rate, or the circles |λ| = 1 and |λ| = e^(-rate·step) of a sampled system."""
    if step is not None:
        radii = [1.0] if rate is None else [1.0, math.exp(-rate * step)]
        return "".join(
            f"<ellipse class='{kind}' cx='{axes.x(0):.1f}' cy='{axes.y(0):.1f}' rx='{axes.x(radius) - axes.x(0):.1f}' "
            f"ry='{axes.y(0) - axes.y(radius):.1f}'/>"
            for kind, radius in zip(("circle", "circle rate"), radii, strict=False)
        )
    if rate is None:
        return ""
    x = axes.x(-rate)
    line = f"<line class='rate' x1='{x:.1f}' y1='{_TOP}' x2='{x:.1f}' y2='{_HEIGHT - _BOTTOM}'/>"
    return line + _text(x - 4, _TOP + 12, f"−µ = {number(-rate)}", anchor="end")


def _mark(series: int, x: float, y: float) -> str:
    shape = _SHAPES[series % len(_SHAPES)]
    return f"<path class='mark s{series % _MOST_SERIES}' transform='translate({x:.1f} {y:.1f})' d='{shape}'/>"


def _text(x: float, y: float, text: str, *, anchor: str = "start") -> str:
    return f"<text x='{x:.1f}' y='{y:.1f}' text-anchor='{anchor}'>{html.escape(text)}</text>"


def _shown(name: str) -> str:
    return printable(name, min(LONGEST_NAME, 16))


def _svg(title: str, parts: Iterable[str], height: float) -> str:
    head = f"<svg class='chart' viewBox='0 0 {_WIDTH:.0f} {height:.0f}' role='img' aria-label='{title}'>"
    return head + "".join(parts) + "</svg>"
