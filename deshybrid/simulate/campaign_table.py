"""The observer of a campaign beside its rivals, on the same drives.

In: a `Campaign`.  Out: one `TableRow` for each detector and each part of the locations: those that the model's ratio
comparison tells apart (the gears of a car: closings) and the others (its open driveline: openings); without a
comparison all locations are one part.  Every detector is scored on the same engagements, the campaign's; samples and
wrong names are those of all drives.

One pass.  Source: Balluchi et al. (2012), section 5, for the limit; the signs of delays as in `score`.
"""

from dataclasses import dataclass

from deshybrid.simulate.campaign import Campaign
from deshybrid.simulate.campaign_jobs import KINDS
from deshybrid.simulate.score import in_seconds, is_late, percent


@dataclass(frozen=True, slots=True)
class TableRow:
    """One detector on the entries into some locations.

    `within`: entries named within the limit; `worst`: the latest naming (s), None where one was missed or none was
    there; `samples` and `right`: rows of traces in which one of `into` is true, and those named rightly; `wrong`: rows
    with another name; `longest`: of each kind, how long (s) one of `into` was said at most while it was not true.
    """

    detector: str
    into: tuple[str, ...]
    engagements: int
    missed: int
    within: int
    worst: float | None
    samples: int
    right: int
    wrong: int
    longest: tuple[float, ...]

    def record(self) -> dict[str, object]:
        """Return the row as a tree for JSON."""
        return {
            "detector": self.detector,
            "into": list(self.into),
            "engagements": self.engagements,
            "missed": self.missed,
            "within_limit": self.within / max(1, self.engagements),
            "worst": self.worst,
            "samples": self.samples,
            "right": self.right,
            "wrong": self.wrong,
            "longest_wrong": dict(zip(KINDS, self.longest, strict=True)),
        }


def table_rows(campaign: Campaign, *, limit: float) -> tuple[TableRow, ...]:
    """Return the rows by part, and in each part by detector; `limit` in s.

    >>> from deshybrid import campaigns
    >>> from deshybrid.simulate.campaign_executor import Here
    >>> ready = campaigns.prepare("models/two_tank.yaml", campaigns.Wishes(engagements=3, duration=30.0))
    >>> [(row.detector, row.engagements) for row in table_rows(campaigns.carry_out(ready, ready.task, Here()), limit=9)]
    [('observer', 3)]
    """
    detectors = enumerate(campaign.task.detectors)
    rows = [_row(campaign, place, name, part, limit) for place, (name, _) in detectors for part in _parts(campaign)]
    return tuple(sorted(rows, key=lambda row: _parts(campaign).index(row.into)))


def table_text(rows: tuple[TableRow, ...], *, limit: float) -> list[str]:
    """Return the table for a reader, one line a row; the longest wrong names are those of the row's locations."""
    width = max(len("detector"), *(len(row.detector) for row in rows))
    into = max(len("entries into"), *(len(_shown(row.into)) for row in rows))
    head = f"{'detector':<{width}}  {'entries into':<{into}}  engaged  within {limit:g} s  missed     worst    right"
    lines = [f"{head}  longest {', '.join(KINDS)} name"]
    for row in rows:
        counts = f"{row.engagements:>7}  {percent(row.within, row.engagements):>{len(f'within {limit:g} s')}}"
        shares = f"{row.missed:>6}  {in_seconds(row.worst):>8}  {percent(row.right, row.samples):>7}"
        longest = ", ".join(map(in_seconds, row.longest))
        lines.append(f"{row.detector:<{width}}  {_shown(row.into):<{into}}  {counts}  {shares}  {longest}")
    return lines


def _shown(names: tuple[str, ...]) -> str:
    return " ".join(names) if len(names) <= 3 else f"{names[0]} … {names[-1]}"


def _parts(campaign: Campaign) -> tuple[tuple[str, ...], ...]:
    """The locations that count, those with a ratio apart from those without."""
    rule = campaign.task.observer.system.simulation.comparison
    told = tuple(name for name in campaign.only if rule is not None and name in rule.ratio)
    others = tuple(name for name in campaign.only if name not in told)
    return tuple(part for part in (told, others) if part)


def _row(campaign: Campaign, place: int, detector: str, into: tuple[str, ...], limit: float) -> TableRow:
    names = campaign.task.names
    namings = [drive.namings[place] for drive in campaign.drives]
    delays = [e.delay for _, e in campaign.engagements_of(place) if e.location in into]
    named = [delay for delay in delays if delay is not None]
    counts = [naming.confusion[names.index(name)] for naming in namings for name in into]
    samples, unnamed = sum(map(sum, counts)), sum(row[-1] for row in counts)
    right = sum(naming.confusion[names.index(name)][names.index(name)] for naming in namings for name in into)
    wrong = [found for naming in namings for found in naming.wrong if found.named in into]
    return TableRow(
        detector,
        into,
        len(delays),
        len(delays) - len(named),
        sum(not is_late(delay, limit) for delay in named),
        max(named) if named and len(named) == len(delays) else None,
        samples,
        right,
        samples - right - unnamed,
        tuple(max((found.seconds for found in wrong if found.kind == kind), default=0.0) for kind in KINDS),
    )


__all__ = ["TableRow", "table_rows", "table_text"]
