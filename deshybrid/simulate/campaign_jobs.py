"""One job of a campaign: a drive, the observer and its rivals at work on it, and what of it counts.

In: a `Task` (the observer, its rivals and the options of the campaign) and a job number.  Out: a `DriveResult`, small
enough for a line of a file; its trace can be had again from the job number (`run_drive`).

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
from typing import Any, TypeAlias

from deshybrid.model.system import HybridSystem, RatioComparison
from deshybrid.observer.hybrid import HybridObserver
from deshybrid.simulate.campaign_drives import drive_seed, run_drive
from deshybrid.simulate.comparison import names_by_ratio
from deshybrid.simulate.execution import Execution
from deshybrid.simulate.observed import as_observed
from deshybrid.simulate.replay import replay
from deshybrid.simulate.score import Engagement, score_locations
from deshybrid.simulate.trace import Trace

KINDS = ("stale", "early", "foreign")
OBSERVER = "observer"  # its name among its rivals

Rival: TypeAlias = RatioComparison | HybridObserver


@dataclass(frozen=True, slots=True, eq=False)
class Task:
    """What all jobs of a campaign share; times in s, None for the model's.

    `rivals`: other ways to name the locations, by their names, which get the same drives.  `plant`: a finer model whose
    drives the observer gets instead of those of its own.
    """

    observer: HybridObserver
    seed: int
    duration: float | None = None
    rivals: tuple[tuple[str, Rival], ...] = ()
    plant: HybridSystem | None = None
    minimum_stay: float = 0.3
    lead: float = 0.5

    def seen(self, execution: Execution) -> Trace:
        """Return the trace of a drive as the observer sees it, with the truth in the words of its model."""
        return as_observed(execution.trace, self.observer.system)

    @property
    def names(self) -> tuple[str, ...]:
        """The locations, in the order of the model."""
        return tuple(location.name for location in self.observer.system.locations)

    @property
    def detectors(self) -> tuple[tuple[str, Rival], ...]:
        """The observer and its rivals, by name."""
        return ((OBSERVER, self.observer), *self.rivals)

    def execution(self, job: int) -> Execution:
        """Return the drive of one job, with the trace of the plant."""
        system = self.observer.system
        step = None if system.is_discrete else self.observer.step_seconds
        return run_drive(self.plant or system, seed=self.seed, job=job, duration=self.duration, step=step)


@dataclass(frozen=True, slots=True)
class WrongName:
    """A stretch in which `named` was said and was not true; `truth` is what was at its beginning; times in s."""

    kind: str
    named: str
    truth: str
    begin: float
    seconds: float


@dataclass(frozen=True, slots=True)
class Naming:
    """How one detector named the locations of one drive.

    `confusion`: rows by true location and by name, in the order of the model, the last column without a name; `wrong`:
    the longest wrong name of each kind and name.
    """

    engagements: tuple[Engagement, ...]
    confusion: tuple[tuple[int, ...], ...]
    wrong: tuple[WrongName, ...]

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "Naming":
        """Return the naming of a tree.  Raises KeyError, TypeError or ValueError where it is none."""
        confusion = tuple(tuple(map(int, row)) for row in record["confusion"])
        if any(len(row) != len(confusion) + 1 for row in confusion):
            raise ValueError("a confusion matrix has one column more than rows")
        engagements = tuple(Engagement(**entry) for entry in record["engagements"])
        return cls(engagements, confusion, tuple(WrongName(**entry) for entry in record["wrong"]))


@dataclass(frozen=True, slots=True)
class DriveResult:
    """What counts of one drive.

    `stop`: why it ended early, or None; `pending`: requests not met; `rows` and `seconds`: its length; `namings`: of
    the observer and its rivals, in the order of `Task.detectors`.
    """

    job: int
    seed: int
    rows: int
    seconds: float
    stop: str | None
    pending: int
    namings: tuple[Naming, ...]

    @property
    def observer(self) -> Naming:
        """How the observer itself named the locations."""
        return self.namings[0]

    def record(self) -> dict[str, object]:
        """Return the result as a tree for JSON."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: Mapping[str, Any]) -> "DriveResult":
        """Return the result of such a tree.  Raises KeyError, TypeError or ValueError where it is none.

        >>> naming = Naming((Engagement("a", 0.1, 0.9, None),), ((1, 0),), ())
        >>> result = DriveResult(0, 5, 9, 1.0, None, 0, (naming,))
        >>> DriveResult.from_record(result.record()) == result
        True
        """
        namings = tuple(Naming.from_record(entry) for entry in record["namings"])
        if not namings:
            raise ValueError("a drive has at least the naming of the observer")
        return cls(**{**record, "namings": namings})


def run_job(packed: bytes, job: int) -> DriveResult:
    """Run one job of a packed task: what executors call."""
    task = _unpacked(packed)
    execution = task.execution(job)
    trace = task.seen(execution)
    return DriveResult(
        job,
        drive_seed(task.seed, job),
        len(trace),
        float(trace.time[-1] - trace.time[0]) if len(trace) else 0.0,
        None if execution.stop is None else execution.stop.kind,
        len(execution.pending),
        tuple(_naming(task, trace, named_by(rival, execution.trace)) for _, rival in task.detectors),
    )


def named_by(rival: Rival, trace: Trace) -> tuple[str | None, ...]:
    """Return the location that a detector names in each row of a trace, which may be one of another model."""
    if isinstance(rival, RatioComparison):
        return names_by_ratio(rival, trace)
    return replay(rival, as_observed(trace, rival.system)).location


def _naming(task: Task, trace: Trace, named: Sequence[str | None]) -> Naming:
    time, truth = trace.time.tolist(), trace.true_location or ()
    return Naming(
        score_locations(time, truth, named, minimum_stay=task.minimum_stay, lead=task.lead).engagements,
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
    """Return the longest of each kind and name, the first among equals, in order of kinds."""
    longest: dict[tuple[str, str], WrongName] = {}
    for wrong in found:
        before = longest.get((wrong.kind, wrong.named))
        if before is None or wrong.seconds > before.seconds:
            longest[wrong.kind, wrong.named] = wrong
    return tuple(sorted(longest.values(), key=lambda wrong: KINDS.index(wrong.kind)))


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
