"""The command `fit`: its options, and what it writes where.

In: the words of the command line.  Out: the model with new numbers on standard output or in a file, the report beside
it, an exit code: 0 done, 1 the traces do not determine a parameter, 2 the call is wrong, 3 a limit came first.
"""

from pathlib import Path
from typing import Annotated

import typer

from deshybrid.console import say, tell_beside, working
from deshybrid.diagnostics import diagnostic
from deshybrid.options import AsJson, Loss, Model, Output, Timeout

NO = 1


def fit(
    model: Model,
    trace: Annotated[list[Path], typer.Option("--trace", help="a trace with known locations; may be repeated")],
    vary: Annotated[list[str], typer.Option("--vary", help="a parameter to identify; may be repeated")],
    only: Annotated[list[str] | None, typer.Option(help="use this location only; may be repeated")] = None,
    by_ratio: Annotated[bool, typer.Option("--by-ratio", help="take locations from the model's `comparison`")] = False,
    loss: Annotated[Loss, typer.Option(help="how errors count; `huber` makes little of outliers")] = "squares",
    timeout: Timeout = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Identify parameters of a model from traces, with uncertainties, and write the model with them."""
    from deshybrid.emit.files import write_result
    from deshybrid.emit.records import to_json
    from deshybrid.fit.fitting import fit_parameters
    from deshybrid.model.elaborate import elaborate
    from deshybrid.model.source import read_source
    from deshybrid.simulate.trace import read_trace

    with working("fitting", timeout):
        source = read_source(model)
        system = elaborate(source)
        traces = [read_trace(path, system) for path in trace]
        found = fit_parameters(source, traces, vary, only=only, by_ratio=by_ratio, loss=loss)
    write_result(output, found.model_text.encode())
    tell_beside(output, to_json(found.record()) if as_json else f"{found}\n")
    hidden = [estimate.name for estimate in found.estimates if estimate.error == float("inf")]
    if hidden:
        names = ", ".join(f"`{name}`" for name in hidden)
        helps = ("fix one of them (leave out its `--vary`), or add traces in which they matter",)
        say([diagnostic("DH0735", f"the traces do not determine {names}", helps=helps)])
        raise typer.Exit(NO)
