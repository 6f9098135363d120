"""How wrong a parameter may be before an engagement is named later than 250 ms: `python -m benchmarks.tolerance`.

In: `models/balluchi2012/driveline_relay.yaml`, the paper's detector.  Out: `benchmarks/tolerance.json`, and the curves
of `docs/tolerance.svg`, which `python -m benchmarks.tolerance draw` draws again without measuring.

Idea: the observer is designed for the model; its drives come from a plant that is the same model with one number
changed, or whose estimate of the torque has a bias.  All drives have the same seed.  Counted are the closings of gears;
one that is never named is drawn at the top of the picture.

Some minutes of one core.
"""

import json
import sys
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

from deshybrid import campaigns
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import with_parameters
from deshybrid.model.problems import Problems
from deshybrid.model.scope import build_scope
from deshybrid.model.source import SourceModel, read_source
from deshybrid.model.system import HybridSystem, MeasurementModel
from deshybrid.simulate.campaign_executor import Here
from deshybrid.simulate.campaign_summary import LIMIT
from deshybrid.simulate.campaign_table import table_rows

MODEL = "models/balluchi2012/driveline_relay.yaml"
POINTS = Path(__file__).parent / "tolerance.json"
PICTURE = Path(__file__).parents[1] / "docs" / "tolerance.svg"
GEARS = ("q1", "q2", "q3", "q4", "q5", "qR")
ENGAGEMENTS, DURATION = 8, 46.0  # the first half of one drive: all gears but reverse, up and down
SHARES = (-0.6, -0.4, -0.2, -0.1, 0.0, 0.1, 0.2, 0.4, 0.6)


@dataclass(frozen=True)
class Wrong:
    """What is wrong: a parameter by a share of its value, or the torque's estimate by N m; and how much."""

    name: str
    parameter: str | None
    unit: str
    amounts: tuple[float, ...]


RATIOS = (-0.06, -0.04, -0.02, -0.01, 0.0, 0.01, 0.02, 0.04, 0.06)
BIASES = (-60.0, -40.0, -20.0, -10.0, 0.0, 10.0, 20.0, 40.0, 60.0)
CASES = (
    Wrong("inertia of the engine", "j_e", "%", SHARES),
    Wrong("stiffness of the shafts", "k_shaft", "%", SHARES),
    Wrong("ratio of the final drive", "final", "%", RATIOS),
    Wrong("bias of the torque", None, "N m", BIASES),
)


def plant_with(source: SourceModel, case: Wrong, amount: float) -> HybridSystem:
    """Return the model with one thing wrong."""
    system = elaborate(source)
    if case.parameter is None:
        sensors = {**system.simulation.measurement, "T_e": MeasurementModel(bias=amount)}
        return replace(system, simulation=replace(system.simulation, measurement=MappingProxyType(sensors)))
    stated = build_scope(source, Problems()).parameters[case.parameter] or 0.0
    return elaborate(with_parameters(source, {case.parameter: stated * (1.0 + amount)}))


def measure() -> dict[str, list[tuple[float, int, int, float | None]]]:
    """Return by case: amount, closings, closings named within the limit, the worst delay (None: one was missed)."""
    source = read_source(MODEL)
    prepared = campaigns.prepare(
        elaborate(source), campaigns.Wishes(engagements=ENGAGEMENTS, only=GEARS, duration=DURATION)
    )
    found: dict[str, list[tuple[float, int, int, float | None]]] = {}
    for case in CASES:
        for amount in case.amounts:
            if prepared.task is None:
                raise SystemExit(f"{MODEL} has no observer")
            task = replace(prepared.task, plant=plant_with(source, case, amount))
            row = table_rows(campaigns.carry_out(prepared, task, Here()), limit=LIMIT)[0]
            found.setdefault(case.name, []).append((amount, row.engagements, row.within, row.worst))
            print(case.name, amount, row.within, "of", row.engagements, row.worst, flush=True)
    return found


def first_missed(rows: list[tuple[float, int, int, float | None]], sign: int) -> float | None:
    """Return the smallest amount of this sign at which an engagement comes later than the limit.

    >>> first_missed([(-0.1, 9, 9, 0.2), (0.0, 9, 9, 0.1), (0.1, 9, 9, 0.2), (0.2, 9, 8, None)], 1)
    0.2
    """
    bad = [amount for amount, closings, within, _ in rows if within < closings and amount * sign >= 0.0]
    return min(bad, key=abs, default=None)


def draw(points: Mapping[str, list[tuple[float, int, int, float | None]]]) -> None:
    """Write the picture: the same points give the same bytes."""
    import matplotlib as mpl

    mpl.use("svg")
    mpl.rcParams |= {"svg.hashsalt": "tolerance", "svg.fonttype": "none"}
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9.0, 5.6), layout="constrained")
    for place, case in enumerate(CASES, start=1):
        axes = figure.add_subplot(2, 2, place)
        scale = 100.0 if case.unit == "%" else 1.0
        rows = points[case.name]
        top = max(2.0 * LIMIT, *(1.2 * worst for _, _, _, worst in rows if worst is not None))
        heights = [top if worst is None else max(worst, 0.0) for _, _, _, worst in rows]
        axes.plot([scale * amount for amount, *_ in rows], heights, "o-", color="tab:blue")
        axes.axhline(LIMIT, color="tab:red", linestyle="--")
        axes.set(title=case.name, xlabel=f"error ({case.unit})", ylabel="worst delay (s)", ylim=(0.0, 1.05 * top))
    figure.savefig(PICTURE, format="svg", metadata={"Date": None, "Creator": None})


def main(words: list[str]) -> None:
    """Measure unless asked to draw only, then draw."""
    if words != ["draw"]:
        POINTS.write_text(json.dumps(measure(), indent=1) + "\n", encoding="utf-8")
    draw(json.loads(POINTS.read_text(encoding="utf-8")))


if __name__ == "__main__":
    main(sys.argv[1:])
