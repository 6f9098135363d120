"""What a campaign has shown: delays, misses, wrong names, confusions, and the worst cases.

In: a `Campaign`.  Out: its `Summary` as JSON tree and as table.  Counted are the campaign's engagements, the first
`wanted` ones; samples and wrong names are those of all drives.  Quantiles are over all engagements: a missed one is
later than any other, so where too many are missed there is none (null).

One pass.  Source: Balluchi et al. (2012), section 5 (90 % within 250 ms, worst 500 ms); the signs of delays as in
`score`.
"""

from dataclasses import dataclass
from functools import cached_property

from deshybrid.simulate.campaign import Campaign
from deshybrid.simulate.campaign_jobs import KINDS, DriveResult, WrongName
from deshybrid.simulate.campaign_table import TableRow, table_rows, table_text
from deshybrid.simulate.score import (
    Engagement,
    LocationScore,
    engagement_record,
    in_seconds,
    is_late,
    percent,
    tally,
    tally_record,
    tally_table,
)

FORMAT = "deshybrid-campaign/1"
LIMIT = 0.25  # s
_WORST = 5


@dataclass(frozen=True)
class Summary:
    """The figures of a campaign; an engagement is in time within `limit` (s)."""

    campaign: Campaign
    limit: float = LIMIT

    @cached_property
    def confusion(self) -> tuple[tuple[int, ...], ...]:
        """Rows of traces by true location and by name (last column: none), over all drives."""
        size = len(self.campaign.task.names)
        sums = [[0] * (size + 1) for _ in range(size)]
        for drive in self.campaign.drives:
            for row, counts in zip(sums, drive.observer.confusion, strict=True):
                row[:] = [a + b for a, b in zip(row, counts, strict=True)]
        return tuple(map(tuple, sums))

    @cached_property
    def score(self) -> LocationScore:
        """The score over the locations that count."""
        campaign = self.campaign
        engagements = tuple(found for _, found in campaign.engagements)
        samples = {
            name: (row[place], sum(row) - row[place] - row[-1], row[-1])
            for place, (name, row) in enumerate(zip(campaign.task.names, self.confusion, strict=True))
            if name in campaign.only
        }
        tallies = tuple(
            tally(name, counts, [e for e in engagements if e.location == name], self.limit)
            for name, counts in samples.items()
        )
        sums = [sum(counts[kind] for counts in samples.values()) for kind in range(3)]
        total = tally("all", sums, engagements, self.limit)
        return LocationScore(engagements, tallies, total, self.limit, campaign.task.minimum_stay)

    @cached_property
    def worst(self) -> tuple[tuple[DriveResult, Engagement], ...]:
        """The five worst engagements with their drives: those missed, then by delay, largest first."""
        return tuple(
            sorted(
                self.campaign.engagements,
                key=lambda case: (case[1].delay is not None, -(case[1].delay or 0.0)),
            )[:_WORST]
        )

    @cached_property
    def longest_wrong(self) -> tuple[tuple[DriveResult, WrongName], ...]:
        """The longest wrong name of each kind with its drive; the first among equals."""
        cases = [(drive, wrong) for drive in self.campaign.drives for wrong in drive.observer.wrong]
        by_kind = ([case for case in cases if case[1].kind == kind] for kind in KINDS)
        return tuple(max(some, key=lambda case: case[1].seconds) for some in by_kind if some)

    @cached_property
    def table(self) -> tuple[TableRow, ...]:
        """The observer beside its rivals."""
        return table_rows(self.campaign, limit=self.limit)

    @property
    def within(self) -> int:
        """How many engagements were named within the limit."""
        return sum(not is_late(delay, self.limit) for delay in self.score.delays)

    def record(self) -> dict[str, object]:
        """Return the summary as a tree for JSON."""
        campaign, score = self.campaign, self.score
        names, total = campaign.task.names, score.total
        return {
            "format": FORMAT,
            "name": campaign.task.observer.system.name,
            "seed": campaign.task.seed,
            "complete": campaign.complete,
            "only": list(campaign.only),
            "drives": len(campaign.drives),
            "stopped_drives": sum(drive.stop is not None for drive in campaign.drives),
            "unmet_requests": sum(drive.pending for drive in campaign.drives),
            "seconds": sum(drive.seconds for drive in campaign.drives),
            "wanted": campaign.wanted,
            "engagements": total.engagements,
            "found": total.engagements - total.missed,
            "missed": total.missed,
            "limit": self.limit,
            "within_limit": self.within / max(1, total.engagements),
            "delays": {
                "50": score.quantile(0.5),
                "90": score.quantile(0.9),
                "99": score.quantile(0.99),
                "max": score.quantile(1.0),
            },
            "table": [row.record() for row in self.table],
            "locations": [tally_record(entry) for entry in score.tallies],
            "wrong_names": {
                wrong.kind: {"job": drive.job, "seed": drive.seed, **_wrong_record(wrong)}
                for drive, wrong in self.longest_wrong
            },
            "confusion": {"true": list(names), "named": [*names, None], "samples": [list(r) for r in self.confusion]},
            "worst": [{"job": drive.job, "seed": drive.seed, **engagement_record(e)} for drive, e in self.worst],
        }

    def __str__(self) -> str:
        campaign, score = self.campaign, self.score
        total = score.total
        stopped = sum(drive.stop is not None for drive in campaign.drives)
        unmet = sum(drive.pending for drive in campaign.drives)
        lines = [
            f"{campaign.task.observer.system.name}, seed {campaign.task.seed}: {len(campaign.drives)} drives, "
            f"{stopped} stopped early, {unmet} requests not met",
            f"engagements of at least {score.minimum_stay:g} s: {total.engagements - total.missed} of "
            f"{total.engagements} named, {percent(self.within, total.engagements)} within {self.limit:g} s",
            f"delay: 50 % within {in_seconds(score.quantile(0.5))}, 90 % within {in_seconds(score.quantile(0.9))}, "
            f"99 % within {in_seconds(score.quantile(0.99))}, all within {in_seconds(score.quantile(1.0))}",
            *table_text(self.table, limit=self.limit),
            *tally_table(score.tallies),
            *(_wrong_line(drive, wrong) for drive, wrong in self.longest_wrong),
            *(_worst_line(drive, engagement) for drive, engagement in self.worst),
        ]
        return "\n".join(lines)


def _wrong_record(wrong: WrongName) -> dict[str, object]:
    return {"named": wrong.named, "true": wrong.truth, "begin": wrong.begin, "seconds": wrong.seconds}


def _wrong_line(drive: DriveResult, wrong: WrongName) -> str:
    return (
        f"longest {wrong.kind} name: {wrong.named} for {wrong.seconds:.3f} s while {wrong.truth} is true, "
        f"drive {drive.job} at {wrong.begin:.3f} s"
    )


def _worst_line(drive: DriveResult, engagement: Engagement) -> str:
    named = "never named" if engagement.delay is None else f"named {engagement.delay:+.3f} s"
    return f"worst: {engagement.location}, drive {drive.job}, entered at {engagement.enter:.3f} s, {named}"


__all__ = ["FORMAT", "LIMIT", "Summary"]
