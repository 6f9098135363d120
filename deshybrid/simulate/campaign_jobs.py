"""One job of a campaign: a drive, the observer at work on it, and what of it counts.

In: a `Task` (the observer and the options of the campaign) and a job number.  Out: a `DriveResult`, small enough for a
line of a file; its trace can be had again from the job number (`run_drive`).

Idea: the observer itself travels to the workers, once made, so that they need neither the model file nor the design,
and all of them run the same bits.

A *wrong name* is a longest stretch of rows in which the observer keeps one name that is not true in any of them.  It is
`stale` where that name was true in the row before the stretch (an opening not yet seen), else `early` where it is true
in the row behind it (named before the entry), else `foreign`.  Its length is the time from its first row to the row
behind it.

Cost: that of `simulate` and `replay`.  Source of the score: Balluchi et al. (2012), section 5.
"""

import copyreg
import io
import pickle
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import lru_cache
from types import MappingProxyType
from typing import Any

from deshybrid.observer.hybrid import HybridObserver
from deshybrid.simulate.campaign_drives import drive_seed, run_drive
from deshybrid.simulate.execution import Execution
from deshybrid.simulate.replay import replay
from deshybrid.simulate.score import Engagement, score_locations

KINDS = ("stale", "early", "foreign")


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What all jobs of a campaign share; times in s, None for the model's."""

    observer: HybridObserver
    seed: int
    duration: float | None = None
    minimum_stay: float = 0.3
    lead: float = 0.5

    @property
    def names(self) -> tuple[str, ...]:
        """The locations, in the order of the model."""
        return tuple(location.name for location in self.observer.system.locations)

    def execution(self, job: int) -> Execution:
        """Return the drive of one job, with its trace."""
        system = self.observer.system
        step = None if system.is_discrete else self.observer.step_seconds
        return run_drive(system, seed=self.seed, job=job, duration=self.duration, step=step)


@dataclass(frozen=True, slots=True)
class WrongName:
    """A stretch in which `named` was said and was not true; `truth` is what was at its beginning; times in s."""

    kind: str
    named: str
    truth: str
    begin: float
    seconds: float


@dataclass(frozen=True, slots=True)
class DriveResult:
    """What counts of one drive.

    `stop`: why it ended early, or None; `pending`: requests not met; `rows` and `seconds`: its length; `confusion`:
    rows by true location and by name, in the order of the model, the last column without a name; `wrong`: the longest
    wrong name of each kind.
    """

    job: int
    seed: int
    rows: int
    seconds: float
    stop: str | None
    pending: int
    engagements: tuple[Engagement, ...]
    confusion: tuple[tuple[int, ...], ...]
    wrong: tuple[WrongName, ...]

    def record(self) -> dict[str, object]:
        """Return the result as a tree for JSON."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "DriveResult":
        """Return the result of such a tree.  Raises KeyError, TypeError or ValueError where it is none.

        >>> result = DriveResult(0, 5, 9, 1.0, None, 0, (Engagement("a", 0.1, 0.9, None),), ((1, 0),), ())
        >>> DriveResult.from_record(result.record()) == result
        True
        """
        values = dict(record)
        values["engagements"] = tuple(Engagement(**entry) for entry in values["engagements"])
        values["confusion"] = tuple(tuple(map(int, row)) for row in values["confusion"])
        if any(len(row) != len(values["confusion"]) + 1 for row in values["confusion"]):
            raise ValueError("a confusion matrix has one column more than rows")
        values["wrong"] = tuple(WrongName(**entry) for entry in values["wrong"])
        return cls(**values)


def run_job(packed: bytes, job: int) -> DriveResult:
    """Run one job of a packed task: what executors call."""
    task = _unpacked(packed)
    execution = task.execution(job)
    trace = execution.trace
    named = replay(task.observer, trace).location
    truth, time = trace.true_location or (), trace.time.tolist()
    found = score_locations(time, truth, named, minimum_stay=task.minimum_stay, lead=task.lead)
    return DriveResult(
        job,
        drive_seed(task.seed, job),
        len(trace),
        time[-1] - time[0] if time else 0.0,
        None if execution.stop is None else execution.stop.kind,
        len(execution.pending),
        found.engagements,
        confusion_matrix(task.names, truth, named),
        longest_wrong(wrong_names(time, truth, named)),
    )


def confusion_matrix(
    names: Sequence[str], truth: Sequence[str | None], named: Sequence[str | None]
) -> tuple[tuple[int, ...], ...]:
    """Return rows by true location and by name, the last column without a name.

    >>> confusion_matrix("ab", "aabb", ["a", None, "a", "b"])
    ((1, 0, 1), (1, 1, 0))
    """
    place: dict[str | None, int] = {name: index for index, name in enumerate(names)}
    counts = [[0] * (len(names) + 1) for _ in names]
    for true, said in zip(truth, named, strict=True):
        if true is not None:
            counts[place[true]][place.get(said, len(names))] += 1
    return tuple(map(tuple, counts))


def wrong_names(
    time: Sequence[float], truth: Sequence[str | None], named: Sequence[str | None]
) -> tuple[WrongName, ...]:
    """Return all wrong names, in order of time.

    >>> found = wrong_names([0.0, 1.0, 2.0, 3.0, 4.0], "aabbc", ["a", "a", "a", "b", "a"])
    >>> [(wrong.kind, wrong.named, wrong.begin, wrong.seconds) for wrong in found]
    [('stale', 'a', 2.0, 1.0), ('foreign', 'a', 4.0, 0.0)]
    """
    found, begin = [], 0
    wrong = [said is not None and true not in (None, said) for true, said in zip(truth, named, strict=True)]
    while begin < len(time):
        end = begin + 1
        true, said = truth[begin], named[begin]
        if wrong[begin] and true is not None and said is not None:
            while end < len(time) and wrong[end] and named[end] == said:
                end += 1
            kind = _kind(said, truth[begin - 1] if begin else None, truth[end] if end < len(time) else None)
            found.append(WrongName(kind, said, true, time[begin], time[min(end, len(time) - 1)] - time[begin]))
        begin = end
    return tuple(found)


def _kind(said: str, before: str | None, after: str | None) -> str:
    return "stale" if said == before else "early" if said == after else "foreign"


def longest_wrong(found: Sequence[WrongName]) -> tuple[WrongName, ...]:
    """Return the longest of each kind, the first among equals."""
    by_kind = ([wrong for wrong in found if wrong.kind == kind] for kind in KINDS)
    return tuple(max(some, key=lambda wrong: wrong.seconds) for some in by_kind if some)


def pack(task: Task) -> bytes:
    """Return a task as bytes for another process of the same version; no file format."""
    stream = io.BytesIO()
    pickler = pickle.Pickler(stream, protocol=5)
    pickler.dispatch_table = {**copyreg.dispatch_table, MappingProxyType: _map_parts}
    pickler.dump(task)
    return stream.getvalue()


@lru_cache(maxsize=4)
def _unpacked(packed: bytes) -> Task:
    task: Task = pickle.loads(packed)  # made by `pack` in the process that gave the job
    return task


def _map_parts(frozen: MappingProxyType[Any, Any]) -> tuple[Any, tuple[dict[Any, Any]]]:
    return _frozen_map, (dict(frozen),)


def _frozen_map(content: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(content)
