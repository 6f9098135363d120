"""Campaigns as the command runs them: from a model to the files of a folder.

In: a path, and `Wishes`.  Out: a `Campaign`, its journal, and the texts of its summary and plots.  Cost: that of the
design and of the drives.
"""

from collections.abc import Sequence
from concurrent.futures import Executor
from dataclasses import dataclass
from hashlib import sha256
from importlib.metadata import version
from pathlib import Path

from deshybrid.compiler import Compilation, Source, compile, to_des, to_hybrid
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.emit.campaign_plots import confusion_plot, delay_histogram
from deshybrid.emit.records import to_json
from deshybrid.model.problems import did_you_mean
from deshybrid.model.system import HybridSystem
from deshybrid.observer.hybrid import HybridObserver
from deshybrid.replays import CLOSE_UPS, Replay, close_up, close_up_of_name, replayed
from deshybrid.simulate.campaign import DEFAULT_ENGAGEMENTS, MAX_DRIVES, Campaign, run_campaign
from deshybrid.simulate.campaign_jobs import DriveResult, Rival, Task
from deshybrid.simulate.campaign_journal import Journal
from deshybrid.simulate.campaign_summary import Summary
from deshybrid.simulate.observed import require_observable_by

JOURNAL = "jobs.jsonl"


@dataclass(frozen=True, slots=True)
class Wishes:
    """What a campaign is asked for: times in s, None for the model's; `only`: the locations whose entries count."""

    engagements: int = DEFAULT_ENGAGEMENTS
    seed: int = 0
    only: tuple[str, ...] = ()
    rate: float | None = None
    dwell: float | None = None
    step: float | None = None
    duration: float | None = None
    max_drives: int = MAX_DRIVES


@dataclass(slots=True)
class Progress:
    """How far a campaign is; the one value here that changes, so that another thread can tell it.

    >>> str(Progress(2, 25))
    '2 drives, 25'
    """

    drives: int = 0
    engagements: int = 0

    def __str__(self) -> str:
        return f"{self.drives} drives, {self.engagements}"


@dataclass(frozen=True, eq=False)
class Prepared:
    """A campaign before its first drive; `task` is None where the model has no observer, as `made` explains."""

    made: Compilation
    wishes: Wishes
    task: Task | None

    @property
    def _rivals(self) -> tuple[HybridObserver, ...]:
        rivals = () if self.task is None else self.task.rivals
        return tuple(rival for _, rival in rivals if isinstance(rival, HybridObserver))

    @property
    def header(self) -> dict[str, object]:
        """What a journal has to agree with: all that the results of jobs depend on."""
        wishes, system = self.wishes, self.made.design.system
        return {
            "version": version("deshybrid"),
            "model": system.name,
            "sha256": _digest(system),
            "seed": wishes.seed,
            "rate": wishes.rate,
            "dwell": wishes.dwell,
            "step": wishes.step,
            "duration": wishes.duration,
            "plant": None if self.task is None or self.task.plant is None else _digest(self.task.plant),
            "against": [_digest(rival.system) for rival in self._rivals],
        }


def prepare(
    source: Source, wishes: Wishes, *, plant: HybridSystem | None = None, against: Sequence[HybridSystem] = ()
) -> Prepared:
    """Design the observer of a model; its drives are those of the `plant`, by default of the model itself.

    `against`: further models of the same locations, whose observers get the same drives.  Raises `UsageError`: DH0720
    for an unknown location in `only`, DH0725 and DH0726 for a plant that does not fit, DH0727 for a model in `against`
    that does not compare.

    >>> prepare("models/two_tank.yaml", Wishes(seed=1)).task.names
    ('fill', 'drain')
    """
    system = to_hybrid(source)
    names = tuple(place.name for place in system.locations)
    unknown = [name for name in wishes.only if name not in names]
    if unknown:
        helps = did_you_mean(unknown[0], names)
        raise UsageError(diagnostic("DH0720", f"the model has no location `{unknown[0]}`", helps=helps))
    made = compile(system, rate=wishes.rate, dwell=wishes.dwell, step=wishes.step)
    for observed in (system, *against):
        require_observable_by(plant or system, observed)
    if made.observer is None:
        return Prepared(made, wishes, None)
    comparison = system.simulation.comparison
    rivals: list[tuple[str, Rival]] = [] if comparison is None else [("ratio", comparison)]
    rivals += [(other.name, _rival(other, made.observer, wishes)) for other in against]
    return Prepared(made, wishes, Task(made.observer, wishes.seed, wishes.duration, tuple(rivals), plant))


def _rival(other: HybridSystem, observer: HybridObserver, wishes: Wishes) -> HybridObserver:
    """The observer of another model, which names the same locations at the same times."""
    made = compile(other, rate=wishes.rate, dwell=wishes.dwell, step=wishes.step).observer
    same = [location.name for location in observer.system.locations]
    if made is None:
        raise UsageError(diagnostic("DH0727", f"there is no observer for `{other.name}`"))
    if [location.name for location in other.locations] != same:
        raise UsageError(diagnostic("DH0727", f"`{other.name}` and `{observer.system.name}` differ in their locations"))
    if made.step_seconds != observer.step_seconds:
        steps = f"{made.step_seconds:g} s and {observer.step_seconds:g} s"
        raise UsageError(
            diagnostic("DH0727", f"the observers of `{other.name}` and `{observer.system.name}` step {steps}")
        )
    return made


def carry_out(
    prepared: Prepared,
    task: Task,
    executor: Executor,
    *,
    ahead: int = 1,
    folder: Path | None = None,
    progress: Progress | None = None,
) -> Campaign:
    """Run a prepared campaign with `ahead` jobs under way at once; with a folder, go on with its journal."""
    wishes, told = prepared.wishes, progress or Progress()
    only = wishes.only or task.names

    def count(result: DriveResult) -> None:
        told.drives += 1
        told.engagements += sum(found.location in only for found in result.observer.engagements)

    def run(journal: Journal | None) -> Campaign:
        def keep(result: DriveResult) -> None:
            if journal is not None:
                journal.append(result)
            count(result)

        finished = () if journal is None else journal.finished
        for result in finished:
            count(result)
        return run_campaign(
            task,
            executor,
            engagements=wishes.engagements,
            only=only,
            ahead=ahead,
            finished=finished,
            keep=keep,
            max_drives=wishes.max_drives,
        )

    if folder is None:
        return run(None)
    with Journal(folder / JOURNAL, prepared.header) as journal:
        return run(journal)


def files(campaign: Campaign, *, plots: bool = False) -> dict[str, bytes]:
    """Return the files that tell of a campaign, by name.  Raises `UsageError` (DH0806) for plots without matplotlib."""
    summary = Summary(campaign)
    texts = {"summary.json": to_json(summary.record()).encode(), "summary.txt": f"{summary}\n".encode()}
    return texts | (_plots(summary) if plots else {})


def _plots(summary: Summary) -> dict[str, bytes]:
    task, score = summary.campaign.task, summary.score
    drawn = {
        "delays.svg": delay_histogram(score.delays, missed=score.total.missed, limit=summary.limit),
        "confusion.svg": confusion_plot(task.names, summary.confusion),
    }
    for rank, (drive, engagement) in enumerate(summary.worst[:CLOSE_UPS], start=1):
        drawn[f"worst-{rank}.svg"] = close_up(_replay(task, drive), engagement, f"drive {drive.job}")
    for drive, wrong in summary.longest_wrong:
        if wrong.kind == "foreign":
            drawn["foreign.svg"] = close_up_of_name(_replay(task, drive), wrong, f"drive {drive.job}")
    return drawn


def _replay(task: Task, drive: DriveResult) -> Replay:
    """One drive, run once more."""
    return replayed(task.observer, task.seen(task.execution(drive.job)))


def _digest(system: HybridSystem) -> str:
    """The hash of the model's file; of the automaton, where it came from elsewhere."""
    if system.source is not None:
        return system.source.sha256
    return sha256(repr(to_des(system)).encode()).hexdigest()


__all__ = ["JOURNAL", "Prepared", "Progress", "Wishes", "carry_out", "files", "prepare"]
