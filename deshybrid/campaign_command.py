"""The command `campaign`: its options, and what it writes where.

In: the words of the command line.  Out: text or JSON on standard output, a folder of files, an exit code: 0 done,
1 no observer exists, 2 the call is wrong, 3 a limit came first, and what is finished by then is told.
"""

import os
from collections.abc import Iterator
from concurrent.futures import Executor
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from deshybrid.console import say, working
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.options import AsJson, DwellTime, Model, Rate, ReadAs, Step, Timeout

NO, LIMIT = 1, 3


def campaign(
    model: Model,
    engagements: Annotated[int, typer.Option(min=1, help="drive until so many engagements are scored")] = 250,
    seed: Annotated[int, typer.Option(min=0, help="the same seed gives the same bytes")] = 0,
    only: Annotated[list[str] | None, typer.Option(help="count entries into this location; may be repeated")] = None,
    workers: Annotated[int | None, typer.Option(min=1, max=256, help="processes; default: one a core")] = None,
    dask: Annotated[str | None, typer.Option(help="run drives on Dask: `local`, or a scheduler's address")] = None,
    duration: Annotated[float | None, typer.Option(min=0.0, help="of one drive in s; default: the model's")] = None,
    max_drives: Annotated[int, typer.Option(min=1, help="stop with exit code 3 after so many drives")] = 1000,
    drive: Annotated[int | None, typer.Option(min=0, help="write the trace of this drive, and nothing else")] = None,
    plant: Annotated[str | None, typer.Option(help="a finer model whose drives the observer gets")] = None,
    against: Annotated[list[str] | None, typer.Option(help="put the observer of this model beside; repeatable")] = None,
    plots: Annotated[bool, typer.Option("--plots", help="write plots as SVG too")] = False,
    rate: Rate = None,
    dwell: DwellTime = None,
    step: Step = None,
    timeout: Timeout = None,
    read_as: ReadAs = None,
    as_json: AsJson = False,
    output: Annotated[Path | None, typer.Option("-o", "--output", help="folder; with `--drive`, a file")] = None,
) -> None:
    """Simulate many drives and score the observer: delays, misses, wrong names."""
    from deshybrid import campaigns, compiler
    from deshybrid.emit.files import write_result, write_tree
    from deshybrid.formats.reading import read_system
    from deshybrid.simulate.trace import write_trace

    if plots:
        _require_plots(output)
    wishes = campaigns.Wishes(engagements, seed, tuple(only or ()), rate, dwell, step, duration, max_drives)
    progress = campaigns.Progress()
    with working(lambda: f"{progress} of {engagements} engagements", timeout):
        system, warnings = read_system(model, read_as)
        finer = None if plant is None else compiler.to_hybrid(plant)
        others = [compiler.to_hybrid(path) for path in against or ()]
        prepared = campaigns.prepare(system, wishes, plant=finer, against=others)
        say((*warnings, *(() if prepared.task else prepared.made.diagnostics)))
        if prepared.task is None:
            raise typer.Exit(NO)
        if drive is not None:
            write_result(output, write_trace(prepared.task.seen(prepared.task.execution(drive))).encode())
            return
        with _executor(dask, workers) as (executor, count):
            run = campaigns.carry_out(
                prepared, prepared.task, executor, ahead=2 * count, folder=output, progress=progress
            )
        files = campaigns.files(run, plots=plots)
    if output is not None:
        write_tree(output, files)
    write_result(None, files["summary.json" if as_json else "summary.txt"])
    say(run.stopped)
    if run.stopped:
        raise typer.Exit(LIMIT)


@contextmanager
def _executor(dask: str | None, workers: int | None) -> Iterator[tuple[Executor, int]]:
    """Where drives run, and how many at once."""
    if dask is not None:
        from deshybrid.simulate.campaign_dask import dask_executor

        with dask_executor(dask, workers=workers) as found:
            yield found
        return
    from deshybrid.simulate.campaign_executor import local_executor

    count = workers or os.cpu_count() or 1
    with local_executor(count) as executor:
        yield executor, count


def _require_plots(output: Path | None) -> None:
    """What plots need is asked for before the drives, not after them."""
    from deshybrid.emit.plotting import require_matplotlib

    if output is None:
        raise UsageError(diagnostic("DH0805", "`--plots` needs a folder to write to", helps=("add `-o DIR`",)))
    require_matplotlib()
