"""The command `deshybrid`: reads a path or `-`, writes to standard output or `-o`, messages to standard error.

Exit codes: 0 done and the answer is yes, 1 done and the answer is no, 2 the input or the call is wrong, 3 a stated
limit was reached.  Never a traceback on input.  A command imports what it needs when it runs: the start stays light.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, NoReturn

import typer

from deshybrid.analysis_command import analyse
from deshybrid.campaign_command import campaign
from deshybrid.console import open_missing_streams, say, working
from deshybrid.diagnostics import (
    DeshybridError,
    GainError,
    LimitReached,
    UsageError,
    catalogue,
    diagnostic,
)
from deshybrid.estimate_command import estimate
from deshybrid.fit_command import fit
from deshybrid.observer import MAX_TABLE
from deshybrid.options import (
    AsJson,
    CheckMethod,
    DrawFormat,
    DrawWhat,
    DwellTime,
    Every,
    GainMethod,
    Gate,
    GeneratedFilter,
    MaxMemory,
    MaxStates,
    Model,
    Most,
    Output,
    Rate,
    ReadAs,
    Step,
    TableStates,
    Target,
    Timeout,
)
from deshybrid.run_command import run

if TYPE_CHECKING:
    from deshybrid.des.automaton import DES
    from deshybrid.model.system import HybridSystem

YES, NO, WRONG, LIMIT = 0, 1, 2, 3


app = typer.Typer(
    name="deshybrid",
    help="Can the current location of a hybrid plant be known?  If not, why, and which observer would do?",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
app.command()(analyse)
app.command()(campaign)
app.command()(estimate)
app.command()(fit)
app.command()(run)


def _tell_version(wanted: bool) -> None:
    if wanted:
        from importlib.metadata import version

        _write(None, f"deshybrid {version('deshybrid')}\n")
        raise typer.Exit(YES)


@app.callback()
def _entry(
    version: Annotated[
        bool, typer.Option("--version", callback=_tell_version, is_eager=True, help="show the version")
    ] = False,
) -> None:
    """Can the current location of a hybrid plant be known?  If not, why, and which observer would do?"""


def main() -> None:
    """Run the command line; every error the user can cause ends in a message and an exit code."""
    open_missing_streams()
    try:
        app()
    except LimitReached as error:
        say(error.diagnostics)
        sys.exit(LIMIT)
    except GainError as error:
        say(error.diagnostics)
        sys.exit(NO)
    except DeshybridError as error:
        say(error.diagnostics)
        sys.exit(WRONG)
    except OSError as error:
        say([diagnostic("DH0805", f"cannot read or write: {error.strerror}")])
        sys.exit(WRONG)


def _finish(answer: bool) -> NoReturn:
    raise typer.Exit(YES if answer else NO)


def _read(model: str, read_as: str | None) -> "HybridSystem | DES":
    """Read a model or another tool's automaton, and say what its reader passed over."""
    from deshybrid.formats.reading import read_system

    system, warnings = read_system(model, read_as)
    say(warnings)
    return system


def _write(output: Path | None, text: str | bytes) -> None:
    from deshybrid.emit.files import write_result

    write_result(output, text.encode(errors="backslashreplace") if isinstance(text, str) else text)


@app.command()
def check(
    model: Model,
    method: Annotated[CheckMethod, typer.Option(help="build the observer, use the pair automaton, or choose")] = "auto",
    max_states: MaxStates = 100_000,
    timeout: Timeout = None,
    max_memory: MaxMemory = None,
    read_as: ReadAs = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Can the current location be known from the discrete outputs?  If not, exactly why."""
    from deshybrid import compiler
    from deshybrid.des.observability import ObservabilityReport, UndecidedCheck, verdict_diagnostics
    from deshybrid.emit.records import check_record, to_json

    def tell(report: ObservabilityReport) -> None:
        _write(output, to_json(check_record(report)) if as_json else f"{report}\n")
        say(verdict_diagnostics(report))

    try:
        with working("checking", timeout, max_memory):
            report = compiler.check(_read(model, read_as), method=method, max_states=max_states)
    except UndecidedCheck as limit:
        tell(limit.report)
        raise
    tell(report)
    _finish(report.current_location_observable is True)


@app.command()
def recover(
    model: Model,
    max_states: MaxStates = 100_000,
    timeout: Timeout = None,
    max_memory: MaxMemory = None,
    every: Every = False,
    most: Most = 100,
    read_as: ReadAs = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Which smallest set of extra signals makes the current location observable?"""
    from deshybrid import plans
    from deshybrid.emit.records import to_json

    with working("looking for the cheapest signatures", timeout, max_memory):
        found = plans.answer(_read(model, read_as), max_states=max_states, seconds=timeout, most=most if every else 0)
    _write(output, to_json(found.record()) if as_json else f"{found}\n")
    say(found.diagnostics)
    if not found.decided:
        raise typer.Exit(LIMIT)
    _finish(found.recovery.plan.recoverable)


@app.command()
def design(
    model: Model,
    rate: Rate = None,
    dwell: DwellTime = None,
    step: Step = None,
    method: GainMethod = "place",
    timeout: Timeout = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Which switching observer estimates the state, and for which dwell time is it guaranteed?"""
    from deshybrid import compiler
    from deshybrid.emit.records import to_json

    with working("designing", timeout):
        made = compiler.design(_read(model, None), rate=rate, dwell=dwell, step=step, method=method)
    _write(output, to_json(made.document()) if as_json else f"{made}\n")
    say((*made.recovery.diagnostics, *made.problems))
    _finish(made.certified)


@app.command("compile")
def compile_model(
    model: Model,
    output: Annotated[str, typer.Option("-o", "--output", help="the folder for everything that is written")],
    target: Annotated[list[Target] | None, typer.Option(help="code to generate; may be repeated")] = None,
    real: Annotated[Literal["double", "float"], typer.Option(help="the generated C's type of real numbers")] = "double",
    prefix: Annotated[
        str | None, typer.Option(help="prefix of all generated names; default: from the model's name")
    ] = None,
    kind: GeneratedFilter = None,
    gate: Gate = None,
    rate: Rate = None,
    dwell: DwellTime = None,
    step: Step = None,
    method: GainMethod = "place",
    max_states: TableStates = MAX_TABLE,
    timeout: Timeout = None,
    max_memory: MaxMemory = None,
    read_as: ReadAs = None,
    as_json: AsJson = False,
) -> None:
    """Write report, drawings, design and observer code into a folder; with `--filter` the code of a filter."""
    from deshybrid import bundle, compiler
    from deshybrid.emit.files import write_tree
    from deshybrid.emit.records import to_json

    if not output:
        raise UsageError(diagnostic("DH0805", "`-o` names no folder"))
    folder = Path(output)
    wishes = bundle.Wishes(tuple(target or ("c", "python")), real, prefix)
    if kind is not None or gate is not None:
        from deshybrid import filter_bundle

        with working("generating", timeout, max_memory):
            texts = filter_bundle.files(_read(model, read_as), kind, wishes, step=step, gate=gate)
        write_tree(folder, texts)
        manifest = texts["MANIFEST.json"].decode()
        return _write(None, manifest if as_json else bundle.listing(folder, texts))
    with working("compiling", timeout, max_memory):
        made = compiler.compile(
            _read(model, read_as), rate=rate, dwell=dwell, step=step, method=method, max_states=max_states
        )
        files = bundle.files(made, wishes)
    write_tree(folder, files)
    _write(None, to_json(bundle.record(made, wishes)) if as_json else f"{made}\n{bundle.listing(folder, files)}")
    say(made.diagnostics)
    _finish(made.certified)


@app.command()
def simulate(
    model: Model,
    seed: Annotated[int, typer.Option(min=0, help="the same seed gives the same bytes")] = 0,
    duration: Annotated[float | None, typer.Option(min=0.0, help="seconds; default: the model's, or 60")] = None,
    step: Step = None,
    timeout: Timeout = None,
    output: Output = None,
) -> None:
    """Simulate the plant with disturbances and sensors, and write the trace with its truth."""
    from deshybrid import compiler
    from deshybrid.simulate.execution import simulate as execute
    from deshybrid.simulate.trace import write_trace

    with working("simulating", timeout):
        execution = execute(compiler.to_hybrid(_read(model, None)), seed=seed, duration=duration, step=step)
    _write(output, write_trace(execution.trace))
    if execution.stop is not None:
        say([execution.stop.diagnostic])
    _finish(execution.stop is None)


@app.command()
def draw(
    model: Model,
    what: Annotated[DrawWhat, typer.Option(help="what to draw")] = "des",
    output: Output = None,
    kind: Annotated[DrawFormat | None, typer.Option("--format", help="default: the suffix of -o, else svg")] = None,
    max_states: MaxStates = 100_000,
    timeout: Timeout = None,
    max_memory: MaxMemory = None,
    read_as: ReadAs = None,
) -> None:
    """Draw the automaton or an observer; persistent, C1- and C2-failing parts are visible at a glance."""
    from deshybrid import bundle

    chosen = kind or bundle.format_of(output)
    with working("drawing", timeout, max_memory):
        picture = bundle.drawing(_read(model, read_as), what, chosen, max_states=max_states)
    _write(output, picture)


@app.command()
def convert(
    source: Annotated[str, typer.Argument(metavar="SOURCE", help="a file of any format, or - for standard input")],
    target: Annotated[Path | None, typer.Argument(metavar="TARGET", help="the file to write, the same as -o")] = None,
    read_as: Annotated[str | None, typer.Option("--from", help="format of SOURCE; default: its suffix")] = None,
    write_as: Annotated[str | None, typer.Option("--to", help="format of the result; default: its suffix")] = None,
    silent: Annotated[list[str] | None, typer.Option(help="an output that means ε; may be repeated")] = None,
    symbols: Annotated[str | None, typer.Option(help="the symbol table of an AT&T text")] = None,
    output: Output = None,
) -> None:
    """Turn automata of other tools into models, and models into files of other tools."""
    from deshybrid.formats.table import convert_file

    if target is not None and output is not None:
        raise UsageError(diagnostic("DH0805", "the result has two names", helps=("write TARGET or `-o`, not both",)))
    written = convert_file(source, target or output, read_as, write_as, silent=silent or (), symbols=symbols)
    _write(target or output, written.text)
    say(written.warnings)


@app.command()
def verify(
    design_file: Annotated[str, typer.Argument(metavar="FILE", help="a design, a plan, a compiled folder, or -")],
    model: Annotated[str | None, typer.Option(help="the model that the JSON of `recover` has to be for")] = None,
    timeout: Timeout = None,
    as_json: AsJson = False,
    output: Output = None,
) -> None:
    """Check the certificates of a design, or a plan of signatures, exactly and without the code that made them."""
    from deshybrid import plans
    from deshybrid.emit.records import to_json
    from deshybrid.verify import read_design

    with working("verifying", timeout):
        result = plans.verify_tree(read_design(design_file), None if model is None else _read(model, None))
    _write(output, to_json(result.record()) if as_json else f"{result}\n")
    _finish(result.holds)


@app.command()
def new(name: Annotated[str, typer.Argument(help="the model's name")] = "my_plant", output: Output = None) -> None:
    """Write a small model file to start from."""
    from deshybrid.model.starter import starter_model

    _write(output, starter_model(name))


@app.command()
def explain(code: Annotated[str, typer.Argument(metavar="CODE", help="a code such as DH0203")]) -> None:
    """Explain a message's code."""
    found = catalogue().get(code.upper())
    if found is None:
        from deshybrid.model.problems import did_you_mean

        raise UsageError(diagnostic("DH0307", f"no code `{code}`", helps=did_you_mean(code.upper(), catalogue())))
    _write(None, f"{found.code}: {found.title}\n\n{found.text}\n")


@app.command()
def schema(output: Output = None) -> None:
    """Print the JSON Schema of model files."""
    from deshybrid.emit.records import to_json
    from deshybrid.model.schema import json_schema

    _write(output, to_json(json_schema()))


if __name__ == "__main__":
    main()
