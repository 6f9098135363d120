"""Where the jobs of a campaign run: in this process, or in processes of their own.

In: a number of workers.  Out: an `Executor` for `run_campaign`; any other one does as well.
"""

import multiprocessing
import signal
from collections.abc import Callable
from concurrent.futures import Executor, Future, ProcessPoolExecutor
from typing import ParamSpec, TypeVar

P = ParamSpec("P")
T = TypeVar("T")


class Here(Executor):
    """Runs each job at once, in the calling process; what a job raises is raised where it is submitted.

    >>> Here().submit(pow, 2, 5).result()
    32
    """

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a job and return its result as a future that is done."""
        future: Future[T] = Future()
        future.set_result(fn(*args, **kwargs))
        return future


def local_executor(workers: int) -> Executor:
    """Return an executor with so many processes; for one worker it is this process.

    The processes start anew (`spawn`): what goes on in threads of this one cannot hold them up.  Ctrl-C is for this
    process alone, which then tells what is finished.
    """
    if workers == 1:
        return Here()
    fresh = multiprocessing.get_context("spawn")
    return ProcessPoolExecutor(workers, mp_context=fresh, initializer=_leave_interrupts_to_the_parent)


def _leave_interrupts_to_the_parent() -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
