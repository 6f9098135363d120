"""How the time of a verdict grows with the size: `python -m benchmarks.growth` draws the points of `growth.json`.

In: `benchmarks/growth.json`, which `python -m benchmarks.verdicts growth` measures.  Out: `docs/growth.svg`.
The exponent is the slope of the line with the least squares through (log size, log time).
"""

import json
import math
from pathlib import Path

POINTS = Path(__file__).parent / "growth.json"
PICTURE = Path(__file__).parents[1] / "docs" / "growth.svg"
Point = tuple[int, float, float]


def points() -> dict[str, list[Point]]:
    """Return the measured (locations, processor seconds, GiB) by family."""
    found = json.loads(POINTS.read_text(encoding="utf-8"))
    return {name: [(size, seconds, gib) for size, seconds, gib in rows] for name, rows in found["points"].items()}


def fit(rows: list[Point]) -> tuple[float, float]:
    """Return factor and exponent of the power of the size that fits the seconds best.

    >>> fit([(10, 2.0, 0.1), (20, 8.0, 0.1), (40, 32.0, 0.1)])
    (0.02, 2.0)
    """
    x, y = [math.log(size) for size, _, _ in rows], [math.log(seconds) for _, seconds, _ in rows]
    mean_x, mean_y = sum(x) / len(x), sum(y) / len(y)
    rise = sum((a - mean_x) * (b - mean_y) for a, b in zip(x, y, strict=True))
    exponent = rise / sum((a - mean_x) ** 2 for a in x)
    return round(math.exp(mean_y - exponent * mean_x), 12), round(exponent, 12)


def draw() -> None:
    """Write the picture: the same points give the same bytes."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams |= {"svg.hashsalt": "growth", "svg.fonttype": "none"}  # the same bytes each time, text as text
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(6.0, 4.0))
    for (name, rows), mark in zip(points().items(), "os", strict=False):
        factor, exponent = fit(rows)
        sizes = [size for size, _, _ in rows]
        (line,) = axes.loglog(sizes, [factor * size**exponent for size in sizes])
        label = f"{name}: exponent {exponent:.2f}"
        axes.loglog(sizes, [seconds for _, seconds, _ in rows], mark, color=line.get_color(), label=label)
    axes.set(xlabel="locations", ylabel="processor seconds", title="Verdict on sparse random systems, 5 % silent")
    axes.grid(True, which="both", alpha=0.3)
    axes.legend()
    figure.savefig(PICTURE, metadata={"Date": None}, bbox_inches="tight")


if __name__ == "__main__":
    draw()
