"""A command, its terminal and its limits: standard streams, a sign of life on long work, time, memory, Ctrl-C."""

import io
import os
import re
import signal
import sys
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from types import FrameType
from typing import NoReturn

import typer

from deshybrid.diagnostics import Diagnostic, render_all, within
from deshybrid.diagnostics.limits import allowance, data_memory, interrupted, out_of_time

try:
    import resource
except ImportError:  # not everywhere; nothing is fenced there
    resource = None  # type: ignore[assignment]

_ROOM = 2**28  # bytes for libraries that are loaded on the way


def open_missing_streams() -> None:
    """Replace closed standard streams, None in Python, by empty ones, which say the same without a traceback.

    >>> open_missing_streams()
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, mode, encoding="utf-8"))  # noqa: SIM115 - lives as long as the process
    if isinstance(sys.stderr, io.TextIOWrapper):
        sys.stderr.reconfigure(errors="backslashreplace")


@contextmanager
def working(on: str | Callable[[], str], timeout: float | None = None, memory: int | None = None) -> Iterator[None]:
    """Show after a second that work goes on, where a terminal looks on; end the work at its limits, and on Ctrl-C.

    `on` is what is shown, or says it anew each time; `timeout` in seconds, None for none; `memory` in bytes of the
    whole process, None for what it holds and half of what is available.  Raises `OutOfResources` (DH0903 to DH0905).

    >>> with working("adding"):
    ...     1 + 1
    2
    """
    done = threading.Event()
    watcher = threading.Thread(target=_spin, args=(on, done), daemon=True)
    if sys.stderr.isatty():
        watcher.start()
    before = [(number, signal.signal(number, end)) for number, end in _ENDS]
    signal.setitimer(signal.ITIMER_REAL, timeout or 0)
    try:
        with within(memory=memory), _fence():
            yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        for number, handler in before:
            signal.signal(number, handler)
        done.set()
        if watcher.is_alive():
            watcher.join()


def _expire(_number: int, _frame: FrameType | None) -> NoReturn:
    raise out_of_time()


def _stop(number: int, _frame: FrameType | None) -> NoReturn:
    signal.signal(number, signal.SIG_DFL)  # whoever asks twice does not want to wait for the last look
    raise interrupted()


_ENDS = ((signal.SIGALRM, _expire), (signal.SIGINT, _stop))


@contextmanager
def _fence() -> Iterator[None]:
    """Let an allocation fail that is far beyond what is allowed, before the system ends the process for it."""
    held, free = data_memory(), allowance()
    if resource is None or held is None or free is None:
        yield
        return
    before = soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    most = held + int(1.5 * free) + _ROOM
    if all(limit == resource.RLIM_INFINITY or most < limit for limit in (soft, hard)):
        resource.setrlimit(resource.RLIMIT_DATA, (most, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def size_in_bytes(text: str) -> int:
    """Return the bytes that a text such as `4GiB` stands for; raises `typer.BadParameter`.

    >>> size_in_bytes("4GiB"), size_in_bytes("1.5 GB"), size_in_bytes("512M"), size_in_bytes("1000000")
    (4294967296, 1500000000, 536870912, 1000000)
    """
    found = re.fullmatch(r"(\d+(?:\.\d+)?) ?(?:([KMGT])(iB|B)?)?", text.strip())
    if found is None:
        raise typer.BadParameter(f"`{text}` is no size: write 4GiB, 512M or 1.5GB")
    number, prefix, unit = found.groups()
    return int(float(number) * (1000 if unit == "B" else 1024) ** ("KMGT".index(prefix) + 1 if prefix else 0))


def say(diagnostics: Iterable[Diagnostic]) -> None:
    """Write messages to standard error, each with its place and its advice.

    >>> say([])
    """
    text = render_all(diagnostics)
    if text:
        sys.stderr.write(text + "\n")


def tell_beside(output: Path | None, text: str) -> None:
    """Write a command's second text to standard output where its result goes to a file, else to standard error.

    >>> tell_beside(Path("estimates.csv"), "log-likelihood: -3.5\\n")
    log-likelihood: -3.5
    """
    (sys.stderr if output is None or str(output) == "-" else sys.stdout).write(text)


def _spin(on: str | Callable[[], str], done: threading.Event) -> None:
    if done.wait(1.0):
        return
    from rich.console import Console

    with Console(stderr=True).status(on if isinstance(on, str) else on()) as status:
        while not done.wait(0.25):
            if not isinstance(on, str):
                status.update(on())
