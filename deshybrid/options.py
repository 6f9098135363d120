"""The options and arguments that several commands share, with what `--help` says of them.

In: nothing.  Out: annotated types for the functions of `cli`.
"""

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Literal

import typer

from deshybrid.console import size_in_bytes


class Target(StrEnum):
    """A language that observers are generated in."""

    C = "c"
    PYTHON = "python"


Model = Annotated[
    str, typer.Argument(metavar="MODEL", help="a model, another tool's automaton, or - for standard input")
]
Output = Annotated[Path | None, typer.Option("-o", "--output", help="write the result here instead of standard output")]
ReadAs = Annotated[str | None, typer.Option("--from", help="format of MODEL, as of `convert`; default: its suffix")]
AsJson = Annotated[bool, typer.Option("--json", help="write JSON")]
MaxStates = Annotated[int, typer.Option(min=1, help="stop with exit code 3 beyond this many observer states")]
TableStates = Annotated[
    int, typer.Option(min=1, help="the most states of a tabulated location observer; beyond them it runs on line")
]
Timeout = Annotated[
    float | None, typer.Option(min=0.001, max=1e7, help="stop with exit code 3 after this many seconds")
]
MaxMemory = Annotated[
    int | None,
    typer.Option(
        parser=size_in_bytes,
        metavar="SIZE",
        help="stop with exit code 3 beyond this much memory, as in 4GiB; default: half of what is available",
    ),
]
Rate = Annotated[float | None, typer.Option(help="rate of convergence in 1/s; default: the model's `observer: rate`")]
DwellTime = Annotated[float | None, typer.Option(help="dwell time in s; default: the model's")]
Step = Annotated[
    float | None, typer.Option(help="sampling step in s; default: the model's `observer: step`, else a derived one")
]
CheckMethod = Literal["auto", "observer", "pairs"]
GainMethod = Annotated[
    Literal["place", "lqe", "lmi"],
    typer.Option("--method", help="place poles, filter noise, or design gains and forms together"),
]
DrawFormat = Literal["svg", "png", "pdf", "dot", "mmd", "graphml"]
DrawWhat = Literal["des", "dprime", "observer", "complementary", "complementary-observer"]
Loss = Literal["squares", "huber"]
TraceFile = Annotated[str, typer.Option("--trace", help="a trace as CSV, or - for standard input")]
FilterMethod = Annotated[
    Literal["mmae", "imm", "rmimm", "skf"], typer.Option("--method", help="the filter; `skf` knows the location")
]
Lag = Annotated[int, typer.Option(min=0, help="rows after its own that an estimate may use; `imm` only")]
GeneratedFilter = Annotated[
    Literal["imm", "mmae", "rmimm", "skf"] | None,
    typer.Option("--filter", help="generate this filter of a stochastic model instead (`rmimm` is refused)"),
]
Gate = Annotated[
    float | None, typer.Option(help="probability with which a good row is kept; one beyond it counts as missing")
]
FilterEngine = Annotated[
    Literal["numpy", "numba", "roots"],
    typer.Option("--engine", help="`numba` is fast (extra `numba`), `roots` keeps digits of variances far apart"),
]
EstimatePlot = Annotated[Path | None, typer.Option("--plot", help="write a plot as SVG (extra `plot`)")]
Plots = Annotated[Path | None, typer.Option("--plots", help="write plots as SVG into this folder (extra `plot`)")]
Between = Annotated[
    tuple[float, float] | None, typer.Option(metavar="FROM TO", help="draw the rows between these times in s")
]
Every = Annotated[bool, typer.Option("--all", help="list all cheapest sets")]
Most = Annotated[int, typer.Option(min=1, help="list at most so many sets, with exit code 3 beyond")]

__all__ = [
    "AsJson",
    "Between",
    "CheckMethod",
    "DrawFormat",
    "DrawWhat",
    "DwellTime",
    "EstimatePlot",
    "Every",
    "FilterEngine",
    "FilterMethod",
    "GainMethod",
    "Gate",
    "GeneratedFilter",
    "Lag",
    "MaxMemory",
    "MaxStates",
    "Model",
    "Most",
    "Output",
    "Plots",
    "Rate",
    "ReadAs",
    "Step",
    "TableStates",
    "Target",
    "Timeout",
    "TraceFile",
]
