"""Campaigns: seeded drives, until so many engagements are scored.

In: a `Task`, the number of engagements, and any `concurrent.futures.Executor`.  Out: a `Campaign`, the results of the
drives in the order of their jobs.  The same for any executor and any number of workers: a drive depends on its job
number only, results are taken in the order of jobs, and the first drive that completes the number is the last.

Idea: a window of jobs is always on its way; those behind the last one are thrown away.

Cost: that of the drives, and of at most `ahead` in vain.
"""

from collections import deque
from collections.abc import Callable, Sequence
from concurrent.futures import BrokenExecutor, Executor, Future
from dataclasses import dataclass

from deshybrid.diagnostics import Diagnostic, LimitReached, diagnostic
from deshybrid.simulate.campaign_jobs import DriveResult, Task, pack, run_job
from deshybrid.simulate.score import Engagement

DEFAULT_ENGAGEMENTS = 250
MAX_DRIVES = 1000


@dataclass(frozen=True, slots=True, eq=False)
class Campaign:
    """The drives of a campaign in the order of their jobs; `only`: the locations whose engagements count.

    `stopped` says which limit ended it before `wanted` engagements were there, or is None.
    """

    task: Task
    wanted: int
    only: tuple[str, ...]
    drives: tuple[DriveResult, ...]
    stopped: tuple[Diagnostic, ...] = ()

    @property
    def engagements(self) -> tuple[tuple[DriveResult, Engagement], ...]:
        """The first `wanted` engagements that count, as named by the observer, with their drives, by job and time."""
        return self.engagements_of(0)

    def engagements_of(self, detector: int) -> tuple[tuple[DriveResult, Engagement], ...]:
        """The same engagements as another detector named them, by its place in `task.detectors`."""
        counted = [
            (drive, found)
            for drive in self.drives
            for found in drive.namings[detector].engagements
            if found.location in self.only
        ]
        return tuple(counted[: self.wanted])

    @property
    def complete(self) -> bool:
        """Whether all engagements that were wanted are there."""
        return len(self.engagements) == self.wanted

    def __repr__(self) -> str:
        have = f"{len(self.engagements)} of {self.wanted} engagements"
        return f"Campaign({self.task.observer.system.name}, seed {self.task.seed}: {len(self.drives)} drives, {have})"


def run_campaign(
    task: Task,
    executor: Executor,
    *,
    engagements: int = DEFAULT_ENGAGEMENTS,
    only: Sequence[str] | None = None,
    ahead: int = 1,
    finished: Sequence[DriveResult] = (),
    keep: Callable[[DriveResult], None] = lambda _: None,
    max_drives: int = MAX_DRIVES,
) -> Campaign:
    """Run drives until `engagements` of them count.

    Parameters
    ----------
    executor : Executor
        Where jobs run; it is not shut down.
    only : sequence of str
        Entries into these locations count; by default into all.
    ahead : int >= 1
        Jobs that are under way at once: at least the number of the executor's workers, better twice as many.
    finished : results of the first jobs
        From an earlier start; they are not run again.
    keep : function
        Called with each new result, in the order of jobs.
    max_drives : int
        The campaign stops incomplete after so many (DH0910 in `stopped`).

    A limit that is reached on the way (time, memory, Ctrl-C, a dead worker) is in `stopped`, not raised.

    >>> from deshybrid import compiler
    >>> from deshybrid.simulate.campaign_executor import Here
    >>> observer = compiler.compile("models/two_tank.yaml").observer
    >>> run_campaign(Task(observer, seed=1, duration=30), Here(), engagements=4)
    Campaign(two_tank, seed 1: 1 drives, 4 of 4 engagements)
    """
    counted = tuple(task.names if only is None else only)
    drives: list[DriveResult] = []
    stopped: tuple[Diagnostic, ...] = ()
    have = 0
    waiting: deque[Future[DriveResult]] = deque()
    packed, submitted = pack(task), len(finished)
    try:
        while have < engagements and len(drives) < max_drives:
            if len(drives) < len(finished):
                result = finished[len(drives)]
            else:
                while len(waiting) < ahead and submitted < max_drives:
                    waiting.append(executor.submit(run_job, packed, submitted))
                    submitted += 1
                result = waiting[0].result()
                waiting.popleft()
                keep(result)
            drives.append(result)
            have += sum(found.location in counted for found in result.observer.engagements)
        if have < engagements:
            stopped = (_too_few(max_drives, have, engagements),)
    except LimitReached as limit:
        stopped = limit.diagnostics
    except BrokenExecutor:
        stopped = (diagnostic("DH0911", "a worker process ended before its drive did"),)
    finally:
        for future in waiting:
            future.cancel()
    return Campaign(task, engagements, counted, tuple(drives), stopped)


def _too_few(drives: int, have: int, wanted: int) -> Diagnostic:
    text = f"{drives} drives have {have} engagements, fewer than the {wanted} that are wanted"
    return diagnostic("DH0910", text, helps=("allow more with `--max-drives`, or make the drives longer",))


__all__ = ["DEFAULT_ENGAGEMENTS", "MAX_DRIVES", "Campaign", "run_campaign"]
