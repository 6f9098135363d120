"""How wrong a number of the observer's model may be before engagements are named later than 250 ms.

    python -m benchmarks.tolerance                  measure, and draw
    python -m benchmarks.tolerance clutch stated    measure one plant and detector anew
    python -m benchmarks.tolerance draw             draw the kept points again

In: the driveline with the paper's detector and with the one that its model states.  Out: `benchmarks/tolerance.json`,
and curves in `docs`.

Idea: the plant is right and the observer is wrong.  So the drives are simulated once, until 250 gears are engaged, and
each observer, made for a model with one number changed (or fed a torque estimate with a bias), gets the same traces;
the signatures are those of the right model.  The observers run as generated C.  For each sign the error is doubled
until some closing is late, and until more than 1 % are; from there it is halved towards the last error at which that
was not so; where the right model is late already, all doublings are tried.  What lies between the points is not known:
lateness need not grow with the error.

Half a second of processor time a point, some minutes in all.
"""

import json
import sys
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from benchmarks.compiled import namer
from deshybrid import compiler, replays
from deshybrid.compiler import Design
from deshybrid.detector.detector import build_detector
from deshybrid.emit.plotting import as_svg, new_figure, plain_style
from deshybrid.emit.records import to_json
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import with_parameters
from deshybrid.model.problems import Problems
from deshybrid.model.scope import build_scope
from deshybrid.model.source import SourceModel, read_source
from deshybrid.model.system import HybridSystem
from deshybrid.observer.hybrid import HybridObserver, build_observer
from deshybrid.simulate.campaign_drives import run_drive
from deshybrid.simulate.campaign_summary import LIMIT
from deshybrid.simulate.execution import Execution
from deshybrid.simulate.observed import as_observed
from deshybrid.simulate.score import Engagement, is_late, score_locations
from deshybrid.simulate.trace import Trace

FOLDER = "models/balluchi2012"
DETECTORS = {"relay": f"{FOLDER}/driveline_relay.yaml", "stated": f"{FOLDER}/driveline.yaml"}
PLANTS = {"driveline": f"{FOLDER}/driveline.yaml", "clutch": f"{FOLDER}/clutch.yaml"}
POINTS = Path(__file__).parent / "tolerance.json"
DOCS = Path(__file__).parents[1] / "docs"
GEARS = ("q1", "q2", "q3", "q4", "q5", "qR")
ENGAGEMENTS, SEED = 250, 1
FEW = ENGAGEMENTS // 100  # so many are not more than 1 %
HALVINGS = 4


@dataclass(frozen=True)
class Wrong:
    """What is wrong: a parameter by a share of its value, or the torque's estimate by N m; from `least` on, doubled."""

    name: str
    parameter: str | None
    unit: str
    least: float
    below: float
    above: float

    def amounts(self, sign: int) -> list[float]:
        """Return the errors of one sign that are tried in turn."""
        most, sizes = self.below if sign < 0 else self.above, [self.least]
        while 2.0 * sizes[-1] <= most:
            sizes.append(2.0 * sizes[-1])
        return [sign * size for size in sizes]


CASES = (
    Wrong("inertia of the engine", "j_e", "%", 0.05, 0.8, 3.2),
    Wrong("stiffness of the shafts", "k_shaft", "%", 0.05, 0.8, 3.2),
    Wrong("ratio of the final drive", "final", "%", 0.0025, 0.16, 0.16),
    Wrong("bias of the torque", None, "N m", 5.0, 160.0, 160.0),
)


class Late(NamedTuple):
    """Of so many engagements, how many were named later than the limit or never, and the latest (None: one never)."""

    engagements: int
    late: int
    worst: float | None


class Point(NamedTuple):
    """Closings of gears and openings of the driveline with one error, and the share of rows with a wrong name."""

    amount: float
    closings: Late
    openings: Late
    wrong: float


class Drive(NamedTuple):
    """One drive as observers see it: samples (N, 3) of torque and speeds, and what was true."""

    samples: NDArray[np.float64]
    time: list[float]
    truth: tuple[str | None, ...]


Probe: TypeAlias = Callable[[float], Point]


def drives(plant: HybridSystem, system: HybridSystem, step: float) -> list[Drive]:
    """Return the drives of the campaign's seed, until enough gears are engaged, as the system's channels."""
    found: list[Drive] = []
    closings = 0
    while closings < ENGAGEMENTS:
        trace = as_observed(run_drive(plant, seed=SEED, job=len(found), step=step).trace, system)
        found.append(drive_of(trace))
        scored = score_locations(found[-1].time, found[-1].truth, (None,) * len(trace)).engagements
        closings += sum(engagement.location in GEARS for engagement in scored)
    return found


def drive_of(trace: Trace) -> Drive:
    """Return a trace whose every output is measured as a drive."""
    return Drive(np.hstack([trace.inputs, trace.outputs]), trace.time.tolist(), trace.true_location or ())


def observer_with(source: SourceModel, right: Design, case: Wrong, amount: float) -> HybridObserver:
    """Return the observer of a model with one number wrong, for the signatures of the right one.

    It estimates the location only, which the estimate of the state does not touch.
    """
    system = elaborate(source)
    if case.parameter is not None:
        stated = build_scope(source, Problems()).parameters[case.parameter] or 0.0
        system = elaborate(with_parameters(source, {case.parameter: stated * (1.0 + amount)}))
    plan, gains = right.recovery.plan, right.gains
    detector = build_detector(system, plan, rate=None if gains is None else gains.rate, step=right.step)
    return build_observer(system, plan, detector, None, step=right.step)


def late_of(engagements: Sequence[Engagement]) -> Late:
    """Count what is late among engagements."""
    worst = [engagement.delay for engagement in engagements]
    late = sum(delay is None or is_late(delay, LIMIT) for delay in worst)
    known = [delay for delay in worst if delay is not None]
    return Late(len(worst), late, max(known) if len(known) == len(worst) and known else None)


def prober(source: SourceModel, right: Design, case: Wrong, given: Sequence[Drive]) -> Probe:
    """Return the function that scores an error of one case on given drives."""

    def probe(amount: float) -> Point:
        name_rows = namer(observer_with(source, right, case, amount))
        bias = np.array([amount if case.parameter is None else 0.0, 0.0, 0.0])
        scores = [score_locations(d.time, d.truth, name_rows(d.samples + bias)) for d in given]
        found = [engagement for score in scores for engagement in score.engagements]
        closings, openings = (
            [e for e in found if (e.location in GEARS) == gear][:ENGAGEMENTS] for gear in (True, False)
        )
        wrong, rows = (sum(getattr(score.total, name) for score in scores) for name in ("wrong", "samples"))
        return Point(amount, late_of(closings), late_of(openings), wrong / rows)

    return probe


def curve(probe: Probe, case: Wrong, *, few: int = FEW) -> list[Point]:
    """Return all points tried: outwards until closings are late, and until more than a few are, then inwards."""
    points = {0.0: probe(0.0)}
    for sign in (-1, 1):
        for most in (0, few):
            for amount in _searched(points, case.amounts(sign), most):
                points.setdefault(amount, probe(amount))
    return [points[amount] for amount in sorted(points)]


def _searched(points: Mapping[float, Point], outwards: Sequence[float], most: int) -> Iterator[float]:
    """The errors to try next, given what is known of those before; what is yielded is known afterwards."""
    good = bad = 0.0
    for amount in outwards:
        if amount not in points:
            yield amount
        if points[amount].closings.late > most and not points[0.0].closings.late > most:
            bad = amount
            break
        good = amount
    for _ in range(HALVINGS if bad else 0):
        middle = (good + bad) / 2.0
        if middle not in points:
            yield middle
        good, bad = (good, middle) if points[middle].closings.late > most else (middle, bad)


def first_late(points: Sequence[Sequence[Any]], sign: int, most: int) -> float | None:
    """Return the smallest error of this sign at which more than `most` closings are late; None: at none that was tried.

    >>> first_late([(-0.1, (9, 0, 0.2)), (0.0, (9, 0, 0.1)), (0.1, (9, 1, 0.3)), (0.2, (9, 8, None))], 1, 0)
    0.1
    """
    bad = [amount for amount, closings, *_ in points if closings[1] > most and amount * sign >= 0.0]
    return min(bad, key=abs, default=None)


def measure(plants: Sequence[str], detectors: Sequence[str]) -> dict[str, dict[str, dict[str, list[Point]]]]:
    """Return the points by plant, detector and case."""
    found: dict[str, dict[str, dict[str, list[Point]]]] = {}
    for plant in plants:
        given: list[Drive] = []
        for detector in detectors:
            source = read_source(DETECTORS[detector])
            right = compiler.design(elaborate(source))
            given = given or drives(compiler.to_hybrid(PLANTS[plant]), right.system, right.step)
            for case in CASES:
                points = curve(prober(source, right, case, given), case)
                found.setdefault(plant, {}).setdefault(detector, {})[case.name] = points
                told = {sign: [first_late(points, sign, most) for most in (0, FEW)] for sign in (-1, 1)}
                print(plant, detector, case.name, len(points), "points", told, flush=True)
    return found


def draw(points: Mapping[str, Mapping[str, Sequence[Sequence[Any]]]]) -> bytes:
    """Return the curves of one plant: the same points give the same bytes."""
    with plain_style():
        figure = new_figure(9.0, 6.4)
        for place, case in enumerate(CASES, start=1):
            axes, scale = figure.add_subplot(2, 2, place), 100.0 if case.unit == "%" else 1.0
            for colour, (detector, cases) in zip(("tab:blue", "tab:orange"), points.items(), strict=True):
                rows = cases[case.name]
                amounts = [scale * amount for amount, *_ in rows]
                for part, kind, style in ((1, "closings", "o-"), (2, "openings", "x:")):
                    shares = [100.0 * row[part][1] / row[part][0] for row in rows]
                    axes.plot(amounts, shares, style, color=colour, markersize=3.0, label=f"{detector}, {kind}")
            axes.axhline(1.0, color="tab:red", linestyle="--")
            axes.set_xscale("symlog", linthresh=scale * case.least)
            axes.set_yscale("symlog", linthresh=1.0)
            for axis in (axes.xaxis, axes.yaxis):
                axis.set_major_formatter("{x:g}")
            axes.set(title=case.name, xlabel=f"error ({case.unit})", ylabel="later than 250 ms (%)", ylim=(-0.1, 110.0))
        figure.axes[0].legend(fontsize="small")
        return as_svg(figure)


def other_plant(share: float) -> Execution:
    """Return the first drive of the campaign of seed 0 with a plant whose final drive is another by this share."""
    source = read_source(DETECTORS["relay"])
    final = build_scope(source, Problems()).parameters["final"] or 0.0
    plant = elaborate(with_parameters(source, {"final": final * (1.0 + share)}))
    return run_drive(plant, seed=0, job=0, duration=12.0, step=plant.observer.step)


def draw_other_plant() -> bytes:
    """Return the timeline of the drive in which no gear engages, named by the observer of the model."""
    made = compiler.compile(DETECTORS["relay"]).observer
    if made is None:
        raise SystemExit(f"{DETECTORS['relay']} has no observer")
    trace = as_observed(other_plant(-0.06).trace, made.system)
    return replays.plots(replays.replayed(made, trace), (0.0, 8.0))["timeline.svg"]


def main(words: list[str]) -> None:
    """Measure the plants and detectors that are named, all where none of a kind is, unless asked to draw only; draw."""
    kept = json.loads(POINTS.read_text(encoding="utf-8"))
    if words != ["draw"]:
        plants, detectors = ([name for name in known if name in words] or [*known] for known in (PLANTS, DETECTORS))
        for plant, found in measure(plants, detectors).items():
            kept[plant] |= found
        POINTS.write_text(to_json(kept), encoding="utf-8")
    for plant, points in json.loads(POINTS.read_text(encoding="utf-8")).items():
        (DOCS / f"tolerance-{plant}.svg").write_bytes(draw(points))
    (DOCS / "tolerance-other-plant.svg").write_bytes(draw_other_plant())


if __name__ == "__main__":
    main(sys.argv[1:])
