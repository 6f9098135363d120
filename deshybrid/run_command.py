"""The command `run`: its options, and what it writes where.

In: the words of the command line.  Out: the estimates as CSV, the score beside them, a folder of plots where one is
asked for; exit code 1 where no observer exists.
"""

import typer

from deshybrid.console import say, tell_beside, working
from deshybrid.observer import MAX_TABLE
from deshybrid.options import (
    AsJson,
    Between,
    DwellTime,
    GainMethod,
    Model,
    Output,
    Plots,
    Rate,
    ReadAs,
    Step,
    TableStates,
    TraceFile,
)

NO = 1


def run(
    model: Model,
    trace: TraceFile,
    rate: Rate = None,
    dwell: DwellTime = None,
    step: Step = None,
    method: GainMethod = "place",
    max_states: TableStates = MAX_TABLE,
    plots: Plots = None,
    between: Between = None,
    read_as: ReadAs = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Run the observer on a trace; with truth columns in the trace, print the score."""
    from deshybrid import compiler, replays
    from deshybrid.emit.files import write_result, write_tree
    from deshybrid.emit.plotting import require_matplotlib
    from deshybrid.emit.records import to_json
    from deshybrid.formats.reading import read_system
    from deshybrid.simulate.replay import replay, write_estimates
    from deshybrid.simulate.score import score
    from deshybrid.simulate.trace import read_trace

    if plots is not None:
        require_matplotlib()
    with working("running"):
        system, warnings = read_system(model, read_as)
        say(warnings)
        made = compiler.compile(system, rate=rate, dwell=dwell, step=step, method=method, max_states=max_states)
        if made.observer is None:
            say(made.diagnostics)
            raise typer.Exit(NO)
        samples = read_trace(trace, made.observer.system, step=made.observer.step_seconds)
        if plots is None:
            estimates = replay(made.observer, samples)
        else:
            replayed = replays.replayed(made.observer, samples)
            estimates, pictures = replayed.estimates, replays.plots(replayed, between)
            write_tree(plots, pictures)
    write_result(output, write_estimates(estimates).encode(errors="backslashreplace"))
    if samples.true_location is not None:
        result = score(samples, estimates)
        tell_beside(output, to_json(result.record()) if as_json else f"{result}\n")
