"""A command, its terminal and its clock: standard streams, a sign of life on long work, the time limit."""

import io
import os
import signal
import sys
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType
from typing import NoReturn

from deshybrid.diagnostics import LimitReached, diagnostic


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
def working(on: str, timeout: float | None = None) -> Iterator[None]:
    """Show after a second that work goes on, where a terminal looks on; turn a time limit into `LimitReached`.

    `on` is what is shown, `timeout` the limit in seconds (DH0903), None for none.

    >>> with working("adding"):
    ...     1 + 1
    2
    """
    done = threading.Event()
    watcher = threading.Thread(target=_spin, args=(on, done), daemon=True)
    if sys.stderr.isatty():
        watcher.start()
    before = signal.signal(signal.SIGALRM, _expire)
    signal.setitimer(signal.ITIMER_REAL, timeout or 0)
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_REAL, 0)
        signal.signal(signal.SIGALRM, before)
        done.set()
        if watcher.is_alive():
            watcher.join()


def _expire(_number: int, _frame: FrameType | None) -> NoReturn:
    helps = ("allow more time with `--timeout`",)
    raise LimitReached(diagnostic("DH0903", "the time limit was reached, so the question stays undecided", helps=helps))


def _spin(on: str, done: threading.Event) -> None:
    if done.wait(1.0):
        return
    from rich.console import Console

    with Console(stderr=True).status(on):
        done.wait()
