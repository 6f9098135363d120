"""How much time and memory a piece of work may take: long searches ask at short intervals and stop with a message.

In: limits, stated once around the work (`within`).  Out: `OutOfResources` from the next `check_limits` that finds one
reached, with the code of that limit; a failed allocation is turned into the same.
Idea: the limits belong to the work that goes on, as a deadline belongs to a day, not to each function that is called on
the way; they are a context variable, so threads have their own, and they end with the `with` block.
Cost: a look at the clock, and at the size of the process (some 10 µs) where the work has become large.
"""

import math
import os
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass

from deshybrid.diagnostics.errors import LimitReached
from deshybrid.diagnostics.messages import Diagnostic, diagnostic

_PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096
_LITTLE = 2**28  # bytes
_CGROUP = (  # limit and use of a container, by version of the control groups
    ("/sys/fs/cgroup/memory.max", "/sys/fs/cgroup/memory.current"),
    ("/sys/fs/cgroup/memory/memory.limit_in_bytes", "/sys/fs/cgroup/memory/memory.usage_in_bytes"),
)


class OutOfResources(LimitReached):
    """Time, memory or patience ran out: another way to the answer has no more of it than the one that was tried."""


@dataclass(frozen=True, slots=True)
class _Limits:
    deadline: float  # as `time.monotonic` counts
    memory: float | None  # bytes of the whole process; None: what is sensible, found when it is first asked for


_NONE = _Limits(math.inf, math.inf)
_LIMITS: ContextVar[_Limits] = ContextVar("limits", default=_NONE)


@contextmanager
def within(*, timeout: float | None = None, memory: int | None = None) -> Iterator[None]:
    """Limit the time (seconds) and the memory (bytes of the whole process) of what is done inside.

    None keeps the limit that holds outside; where there is none, the memory is what the process holds, and half of what
    it can still get.  Raises `OutOfResources`: DH0903 for time, DH0904 for memory, which is also
    what a failed allocation becomes.

    >>> with within(timeout=60.0, memory=2**40):
    ...     check_limits()
    """
    outer = _LIMITS.get()
    deadline = math.inf if timeout is None else time.monotonic() + timeout
    stated = [most for most in (None if outer is _NONE else outer.memory, memory) if most is not None]
    token = _LIMITS.set(_Limits(min(outer.deadline, deadline), min(stated, default=None)))
    try:
        yield
    except MemoryError as error:
        raise out_of_memory("an allocation failed") from error
    finally:
        _LIMITS.reset(token)


@contextmanager
def last_moments(seconds: float) -> Iterator[None]:
    """Give a few seconds and a little memory more, whatever the limit: to tell what is known when it was reached.

    >>> with within(timeout=0.0), last_moments(10.0):
    ...     check_limits()
    """
    memory = max(_most_memory(), (resident_memory() or 0) + _LITTLE)
    token = _LIMITS.set(_Limits(time.monotonic() + seconds, memory))
    try:
        yield
    finally:
        _LIMITS.reset(token)


def check_limits(ahead: int = 0) -> None:
    """Raise `OutOfResources` where the time is over, or where `ahead` more bytes would be more than there may be.

    >>> with within(memory=2**50):
    ...     check_limits(2**51)
    Traceback (most recent call last):
        ...
    deshybrid.diagnostics.limits.OutOfResources: DH0904: the memory limit was reached
    """
    _most_memory()
    check_stated_limits(ahead)


def check_stated_limits(ahead: int = 0) -> None:
    """Do what `check_limits` does, but leave out a memory limit that nobody stated: this costs next to nothing.

    >>> with within(timeout=60.0):
    ...     check_stated_limits()
    """
    limits = _LIMITS.get()
    if time.monotonic() > limits.deadline:
        raise out_of_time()
    if limits.memory is not None and limits.memory < math.inf:
        held = resident_memory() or 0
        if held + ahead > limits.memory:
            facts = f"{_size(held)} are in use, {_size(ahead)} more are needed, {_size(limits.memory)} are allowed"
            raise out_of_memory(facts)


def _most_memory() -> float:
    """The memory limit; where none is stated inside of `within`, what is sensible when this is first asked."""
    limits = _LIMITS.get()
    if limits.memory is None:
        limits = _Limits(limits.deadline, _sensible_memory())
        _LIMITS.set(limits)  # it ends with the block of `within` all the same
    return math.inf if limits.memory is None else limits.memory


def out_of_time() -> OutOfResources:
    """Return the error that says so.

    >>> out_of_time().diagnostics[0].code
    'DH0903'
    """
    return OutOfResources(_undecided("DH0903", "the time limit was reached", "allow more time with `--timeout`"))


def out_of_memory(fact: str) -> OutOfResources:
    """Return the error that says so; `fact` tells how much there was.

    >>> out_of_memory("1.0 GiB are in use").diagnostics[0].notes
    ('1.0 GiB are in use', 'the question stays undecided')
    """
    return OutOfResources(_undecided("DH0904", "the memory limit was reached", "allow more with `--max-memory`", fact))


def interrupted() -> OutOfResources:
    """Return the error that says that the user ended the work.

    >>> interrupted().diagnostics[0].code
    'DH0905'
    """
    return OutOfResources(_undecided("DH0905", "interrupted", "once more ends the command at once"))


def _undecided(code: str, what: str, advice: str, *facts: str) -> Diagnostic:
    return diagnostic(code, what, notes=(*facts, "the question stays undecided"), helps=(advice,))


def resident_memory() -> int | None:
    """Return the bytes of main memory that this process holds (elsewhere than on Linux: the most it held), else None.

    >>> resident_memory() > 2**20
    True
    """
    pages = _words("/proc/self/statm")
    if len(pages) > 1:
        return int(pages[1]) * _PAGE
    try:
        import resource
    except ImportError:
        return None
    most = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    return most if sys.platform == "darwin" else most * 1024


def data_memory() -> int | None:
    """Return the bytes that this process has asked for, used or not, None elsewhere than on Linux.

    >>> data_memory() > 2**20
    True
    """
    pages = _words("/proc/self/statm")
    return int(pages[5]) * _PAGE if len(pages) > 5 else None


def allowance() -> int | None:
    """Return how many bytes more the present limit allows, None where there is no limit.

    >>> with within(memory=2**50):
    ...     allowance() > 2**40
    True
    """
    most, held = _most_memory(), resident_memory()
    return None if most == math.inf or held is None else max(int(most) - held, 0)


def available_memory() -> int | None:
    """Return the bytes that this process can still get without others being moved out, None where nothing tells.

    >>> available_memory() > 2**20
    True
    """
    words = _words("/proc/meminfo")
    found = [int(words[words.index("MemAvailable:") + 1]) * 1024] if "MemAvailable:" in words else []
    for limit, use in _CGROUP:
        stated, used = _words(limit), _words(use)
        if stated and used and stated[0].isdigit():
            found.append(max(int(stated[0]) - int(used[0]), 0))
    return min(found, default=None)


def _sensible_memory() -> float:
    held, available = resident_memory(), available_memory()
    return math.inf if held is None or available is None else held + available // 2


def _words(path: str) -> list[str]:
    try:
        with open(path, encoding="ascii") as file:
            return file.read().split()
    except OSError:
        return []


def _size(count: float) -> str:
    return f"{count / 2**30:.2f} GiB"


__all__ = [
    "OutOfResources",
    "allowance",
    "available_memory",
    "check_limits",
    "check_stated_limits",
    "data_memory",
    "interrupted",
    "last_moments",
    "out_of_memory",
    "out_of_time",
    "resident_memory",
    "within",
]
