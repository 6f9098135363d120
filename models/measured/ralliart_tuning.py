"""The measured car identified and its detector tuned on one drive, scored on the other, beside the ratio comparison.

    python models/measured/ralliart_tuning.py run2.csv run3.csv            both directions, one table
    python models/measured/ralliart_tuning.py run2.csv run3.csv --write    and the numbers of each into a model file

In: two raw logs.  Out: a table.  Of the drive that is scored nothing is used before the score.

1. Identification: `deshybrid.fit` with Huber's loss on the stretches with a closed clutch, from nominal numbers; the
   ratios of gears that a drive does not use stay nominal.
2. Tuning of four numbers of the detector, the same in every gear: pole, level of the residual, release, debounce.
   A seeded search from START: WIDE settings around it, then NARROW around the best so far, each number times e^(width
   times a normal number); the result is the geometric mean of the BEST settings, inside what does well rather than on
   its edge.  A setting costs (1 - right)/1 % + wrong gear/0.5 % + false naming/half of the ratio comparison's + 5 for
   each closing of at least 0.3 s that is not named within 250 ms: 1 in each place is what is wanted.

Some six minutes of processor time.  Structure of model and detector were chosen with both drives in sight; numbers not.
"""

import argparse
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from identify import identify, nominal_source, written_values
from numpy.typing import NDArray
from ralliart_log import MODEL, STEP, Drive, GearScore, ratio_names, read_log, score_gears, trace_text

from deshybrid.compiler import recover
from deshybrid.des.signatures import SignaturePlan
from deshybrid.detector.detector import build_detector
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import parameter_text, with_parameters
from deshybrid.model.source import SourceModel, read_source
from deshybrid.observer.hybrid import HybridObserver, build_observer
from deshybrid.simulate.replay import replay
from deshybrid.simulate.trace import parse_trace

REVERSE = MODEL.with_name("ralliart_run3.yaml")
START = {"pole": 12.0, "level": 3.0, "release": 2.5, "debounce": 0.04}
WIDTH = 0.5  # of the logarithms, around START; a third of it later
WIDE, NARROW, BEST = 40, 60, 6
WITHIN = 0.25  # s, of a closing of at least 0.3 s

Values = Mapping[str, float]


@dataclass(frozen=True, slots=True, eq=False)
class Bench:
    """A drive on which settings are tried: the model, its plan (which no number changes), and the bar."""

    source: SourceModel
    plan: SignaturePlan
    drive: Drive
    bar: GearScore

    @classmethod
    def of(cls, source: SourceModel, drive: Drive) -> "Bench":
        """Return the bench of a drive."""
        plan = recover(elaborate(source)).plan
        return cls(source, plan, drive, score_gears(drive, ratio_names(drive)))

    def observer(self, values: Values) -> HybridObserver:
        """Return an observer of the location alone with these numbers."""
        system = elaborate(with_parameters(self.source, values))
        detector = build_detector(system, self.plan, rate=system.observer.rate, step=STEP)
        return build_observer(system, self.plan, detector, None, step=STEP)

    def score(self, values: Values) -> GearScore:
        """Return how well the drive's gears are named with these numbers."""
        observer = self.observer(values)
        estimates = replay(observer, parse_trace(trace_text(self.drive), observer.system))
        return score_gears(self.drive, estimates.location)

    def cost(self, values: Values) -> float:
        """Return what a setting costs; see the module's text."""
        found = self.score(values)
        late = sum(delay is None or delay > WITHIN for delay in found.delays())
        half = max(self.bar.false / 2.0, 1e-9)
        return (1.0 - found.right) / 0.01 + found.wrong / 0.005 + found.false / half + 5.0 * late


def tune(bench: Bench, identified: Values, *, seed: int = 1) -> dict[str, float]:
    """Return the numbers of the detector that do well on the drive of a bench."""
    generator = np.random.default_rng(seed)
    start = np.log(list(START.values()))
    tried: list[tuple[float, NDArray[np.float64]]] = []
    for number in range(WIDE + NARROW):
        around, width = (start, WIDTH) if number < WIDE else (min(tried, key=_cost)[1], WIDTH / 3.0)
        place = _possible(around + width * generator.standard_normal(len(start)))
        tried.append((bench.cost(dict(identified) | _numbers(place)), place))
    tried.sort(key=_cost)
    return _numbers(_possible(np.mean([place for _, place in tried[:BEST]], axis=0)))


def _cost(entry: tuple[float, NDArray[np.float64]]) -> float:
    return entry[0]


def _possible(place: NDArray[np.float64]) -> NDArray[np.float64]:
    """The nearest setting that a detector can have: a release of at least 1, a debounce of at least a step."""
    lowest = [np.log(limit) for limit in (1e-3, 1e-3, 1.0, STEP)]
    return np.maximum(place, lowest)


def _numbers(place: NDArray[np.float64]) -> dict[str, float]:
    return {name: float(f"{number:.3g}") for name, number in zip(START, np.exp(place).tolist(), strict=True)}


def run_name(drive: Drive) -> str:
    """Return the short name of a drive: its log's name up to the first underscore."""
    return drive.name.split("_")[0]


def row(name: str, found: GearScore) -> str:
    """Return one line of the table."""
    delays = ", ".join("never" if delay is None else f"{delay:+.2f}".replace("-", "−") for delay in found.delays())
    shares = f"{100 * found.right:.2f} % | {100 * found.wrong:.2f} % | {100 * found.false:.1f} %"
    return f"| {name} | {shares} | {delays} |"


HEAD = "| | right, of closed | wrong gear | a gear named while not closed | delays in s |\n|---|---|---|---|---|"


def main(arguments: list[str] | None = None) -> int:
    """Identify and tune on each of two drives, score on the other, print the table."""
    parser = argparse.ArgumentParser(description="Identify and tune the measured car on one drive, score on the other.")
    parser.add_argument("logs", nargs=2, type=Path)
    parser.add_argument("--write", action="store_true", help="put the numbers of each log into its model file")
    options = parser.parse_args(arguments)
    source = nominal_source()
    benches = [Bench.of(source, read_log(path)) for path in options.logs]
    lines, texts = [HEAD], []
    for own, other in (benches, benches[::-1]):
        fit = identify(source, [own.drive])
        text = written_values(fit)
        tuned = tune(own, {name: float(number) for name, number in text.items()})
        texts.append(text | {name: f"{number:.15g}" for name, number in tuned.items()})
        values = {name: float(number) for name, number in texts[-1].items()}
        print(f"{own.drive.name}\n{fit}\n{values}", file=sys.stderr, flush=True)
        name = run_name(own.drive)
        lines.append(row(f"{run_name(other.drive)}, ratio comparison", other.bar))
        lines.append(row(f"{run_name(other.drive)}, detector of {name}", other.score(values)))
        lines.append(row(f"{name}, detector of {name}", own.score(values)))
    if options.write:
        for path, text in zip((MODEL, REVERSE), texts, strict=True):
            path.write_text(parameter_text(read_source(path), text), encoding="utf-8")
    print("\n".join(lines))
    return 0


if __name__ == "__main__":
    sys.exit(main())
