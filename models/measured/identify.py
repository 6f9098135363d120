"""Identifies the driveline of the measured car from its logs, converts them, and scores estimates.

    python models/measured/identify.py fit run2.csv            parameters with intervals, as `deshybrid fit` finds them
    python models/measured/identify.py fit run2.csv --write    the same, and puts them into the model file
    python models/measured/identify.py convert run2.csv trace.csv     a raw log as a trace for `deshybrid run` and `fit`
    python models/measured/identify.py score run2.csv estimate.csv    an estimate (without one: the ratio comparison)

The fit is `deshybrid.fit` with Huber's loss, on the stretches of the forward gears with a clutch reported closed, and
begins at nominal numbers: the first samples of a stretch still slip, and such errors should not count by squares.
Mass, rolling radius and the scale of the torque are taken as known: a torque error that wanders cannot be told from a
scale.  Ratios of gears that no log uses stay nominal.  A minute or two.
"""

import argparse
import csv
import sys
from collections.abc import Sequence
from pathlib import Path

from ralliart_log import MODEL, Drive, GearScore, ratio_names, read_log, score_gears, trace_text

from deshybrid.fit.fitting import fit_parameters
from deshybrid.fit.result import Fit
from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import parameter_text, with_parameters
from deshybrid.model.source import SourceModel, read_source
from deshybrid.simulate.trace import parse_trace

NOMINAL = {"j_e": 0.25, "k_shaft": 4000.0, "b_shaft": 300.0, "slip": 1.0}
RATIOS = {"ratio_1": 3.70, "ratio_2": 2.39, "ratio_3": 1.76, "ratio_4": 1.32, "ratio_5": 0.98}


def nominal_source() -> SourceModel:
    """Return the model file with nominal numbers in place of those that a drive has to say."""
    return with_parameters(read_source(MODEL), NOMINAL | RATIOS)


def identify(source: SourceModel, drives: Sequence[Drive]) -> Fit:
    """Return the parameters that the closed stretches of some drives say, from those of the source."""
    system = elaborate(source)
    gears = sorted({gear for drive in drives for gear in drive.gear.tolist() if 1 <= gear <= len(RATIOS)})
    names = [*NOMINAL, *(f"ratio_{gear}" for gear in gears)]
    traces = [parse_trace(trace_text(drive), system) for drive in drives]
    return fit_parameters(source, traces, names, only=[f"q{gear}" for gear in gears], loss="huber")


def written_values(fit: Fit) -> dict[str, str]:
    """Return what a fit writes into a model: ratios that it did not vary are nominal."""
    nominal = {name: f"{number:.15g}" for name, number in (NOMINAL | RATIOS).items()}
    return nominal | {estimate.name: estimate.written for estimate in fit.estimates}


def score_text(name: str, result: GearScore) -> str:
    """Return one line of figures."""
    delays = ", ".join("never" if d is None else f"{d:+.2f}" for d in result.delays())
    shares = f"right {100 * result.right:.2f} %, wrong gear {100 * result.wrong:.2f} % of closed samples"
    return f"{name}: {shares}; false naming {100 * result.false:.1f} %; delays of closings >= 0.3 s: {delays} s"


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one of the subcommands; returns the exit code."""
    parser = argparse.ArgumentParser(description="Identify the measured car, convert its logs, score estimates.")
    commands = parser.add_subparsers(dest="command", required=True)
    fitting = commands.add_parser("fit", help="parameters with intervals")
    fitting.add_argument("logs", nargs="+", type=Path)
    fitting.add_argument("--write", action="store_true", help="put the numbers into the model file")
    converting = commands.add_parser("convert", help="a raw log as a trace")
    converting.add_argument("log", type=Path)
    converting.add_argument("trace", type=Path)
    scoring = commands.add_parser("score", help="an estimate, or the ratio comparison")
    scoring.add_argument("log", type=Path)
    scoring.add_argument("estimate", nargs="?", type=Path)
    options = parser.parse_args(arguments)
    if options.command == "convert":
        options.trace.write_text(trace_text(read_log(options.log)), encoding="utf-8")
    elif options.command == "score":
        drive = read_log(options.log)
        named: Sequence[str | None] = ratio_names(drive)
        if options.estimate:
            with options.estimate.open(newline="", encoding="utf-8") as file:
                named = [row["location"] or None for row in csv.DictReader(file)]
        print(score_text(options.log.stem, score_gears(drive, named)))
    else:
        result = identify(nominal_source(), [read_log(path) for path in options.logs])
        print(result)
        if options.write:
            MODEL.write_text(parameter_text(read_source(MODEL), written_values(result)), encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
