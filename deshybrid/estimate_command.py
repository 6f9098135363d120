"""The command `estimate`: its options, and what it writes where.

In: the words of the command line.  Out: the estimates as CSV, the score beside them, a plot where one is asked for.
"""

from deshybrid.console import say, tell_beside, working
from deshybrid.options import AsJson, EstimatePlot, FilterEngine, FilterMethod, Gate, Lag, Model, Output, TraceFile


def estimate(
    model: Model,
    trace: TraceFile,
    method: FilterMethod = "imm",
    lag: Lag = 0,
    gate: Gate = None,
    engine: FilterEngine = "numpy",
    plot: EstimatePlot = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Estimate location and state of a stochastic model on a trace; log-likelihood and score at the end."""
    from deshybrid import estimation
    from deshybrid.emit.files import write_result, write_whole
    from deshybrid.emit.records import to_json

    with working("estimating"):
        made = estimation.estimate_trace(model, trace, method=method, gate=gate, lag=lag, engine=engine)
        picture = None if plot is None else estimation.plot(made)
    if plot is not None and picture is not None:
        write_whole(plot, picture)
    write_result(output, made.csv().encode(errors="backslashreplace"))
    say(made.problems)
    tell_beside(output, to_json(made.record()) if as_json else f"{made}\n")
