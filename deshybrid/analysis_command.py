"""The command `analyse`: its options, and what it writes where.

In: the words of the command line.  Out: text or JSON, a message for every "no", an exit code: 0 everything that was
asked holds, 1 something does not, 2 the call is wrong.
"""

from math import isfinite
from typing import Annotated

import typer

from deshybrid.console import say, working
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.options import AsJson, Model, Output, Timeout

YES, NO = 0, 1


def analyse(
    model: Model,
    window: Annotated[int, typer.Option(min=1, max=2000, help="rows that are compared")] = 100,
    error: Annotated[float, typer.Option(help="probability of a wrong name, below 0.5")] = 0.01,
    factor: Annotated[float, typer.Option(help="by which errors have to shrink a row, between 0 and 1")] = 0.99,
    delay: Annotated[int, typer.Option(min=0, help="rows until a switch is known")] = 0,
    error_bound: Annotated[float, typer.Option(min=0.0, help="the mean error that may be left")] = 0.0,
    state_bound: Annotated[
        float | None, typer.Option(min=0.0, help="bound of every mean state; default: the model's `bounds: state`")
    ] = None,
    step: Annotated[float | None, typer.Option(help="distance of rows in s; for models in continuous time")] = None,
    held: Annotated[
        list[str] | None, typer.Option("--input", metavar="NAME=VALUE", help="hold a known input here; others at 0")
    ] = None,
    timeout: Timeout = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """What can be known of a stochastic model beforehand: modes told apart, rows between switches, filters."""
    from deshybrid.analysis.whole import Question
    from deshybrid.analysis.whole import analyse as answer
    from deshybrid.emit.files import write_result
    from deshybrid.emit.records import to_json
    from deshybrid.stochastic.telling_apart import Window

    with working("analysing", timeout):
        inputs = tuple(_held(word) for word in held or ())
        question = Question(Window(window, error=error), factor, delay, error_bound, state_bound, step, inputs)
        made = answer(model, question)
        text = to_json(made.record()) if as_json else f"{made}\n"
    write_result(output, text.encode())
    say(made.diagnostics)
    raise typer.Exit(YES if made.holds else NO)


def _held(word: str) -> tuple[str, float]:
    """The name and the value of `NAME=VALUE`."""
    from deshybrid.simulate.table import number

    name, separator, text = word.rpartition("=")
    value = number(text)
    if not separator or value is None or not isfinite(value):
        raise UsageError(diagnostic("DH1209", f"`--input {word}` is not of the form NAME=VALUE with a finite number"))
    return name, value
