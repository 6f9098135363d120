"""The command `analyse`: its options, and what it writes where.

In: the words of the command line.  Out: text or JSON, a message for every "no", an exit code: 0 everything that was
asked holds, 1 something does not, 2 the call is wrong.
"""

from typing import Annotated

import typer

from deshybrid.console import say, working
from deshybrid.options import AsJson, Model, Output, Timeout

YES, NO = 0, 1


def analyse(
    model: Model,
    window: Annotated[int, typer.Option(min=1, max=2000, help="rows that are compared")] = 100,
    error: Annotated[float, typer.Option(help="probability of a wrong name, below 0.5")] = 0.01,
    step: Annotated[float | None, typer.Option(help="distance of rows in s; for models in continuous time")] = None,
    timeout: Timeout = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Which modes and switches do the outputs of a stochastic model tell apart, and after how many rows?"""
    from deshybrid import analysis
    from deshybrid.emit.files import write_result
    from deshybrid.emit.records import to_json
    from deshybrid.stochastic.telling_apart import Window

    with working("analysing", timeout):
        made = analysis.analyse(model, step=step, window=Window(rows=window, error=error))
        text = to_json(made.record()) if as_json else f"{made}\n"
    write_result(output, text.encode())
    say(made.diagnostics)
    raise typer.Exit(YES if made.holds else NO)
