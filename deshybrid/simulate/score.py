"""Scores: how early, how late, how often wrong an observer named the true location, and how far off its state was.

In: times, true and estimated locations (any two sequences of names, so that other methods can be compared on the same
terms), or a trace with truth and its estimates.  Out: `LocationScore`, `StateScore`, `Score`.

An *engagement* is a true entry into a location that stays for at least `minimum_stay`; the first stay of a run is none,
because nobody saw its beginning.  Its signed delay: where the estimate already names the location at the entry, the
beginning of that naming minus the entry (negative: named early), looking back at most `lead` and never into the
previous stay in the same location; else the first time before the exit at which the estimate names it, minus the entry
(positive); an engagement never named is *missed*, one named later than `limit` is *late*.  Real gearboxes are named
early as a rule: the ratio is right before the clutch is reported closed.

One pass.  Source: Balluchi et al. (2012), section 5 (delays of engagements), with signs.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.simulate.replay import EstimateTrace
from deshybrid.simulate.trace import Trace

_SLACK = 1e-9  # s, so that a delay of exactly `limit` is not late for a rounding error


@dataclass(frozen=True, slots=True)
class Engagement:
    """One true stay: entered and left at these times (s), named with this signed delay (s) or None = never."""

    location: str
    enter: float
    leave: float
    delay: float | None


@dataclass(frozen=True, slots=True)
class LocationTally:
    """Samples and engagements of one true location (or of all): right + wrong + unnamed = samples."""

    name: str
    samples: int
    right: int
    wrong: int
    unnamed: int
    engagements: int
    late: int
    missed: int
    median_delay: float | None
    worst_delay: float | None

    @property
    def wrong_among_named(self) -> float:
        """Share of wrong names among the samples with a name; 0 where there is none."""
        return self.wrong / max(1, self.right + self.wrong)


@dataclass(frozen=True, slots=True)
class LocationScore:
    """How well locations were named; `tallies` by location in the order asked for, `total` over all of them."""

    engagements: tuple[Engagement, ...]
    tallies: tuple[LocationTally, ...]
    total: LocationTally
    limit: float
    minimum_stay: float

    @property
    def delays(self) -> tuple[float, ...]:
        """Signed delays of the engagements that were named, in order of time."""
        return tuple(e.delay for e in self.engagements if e.delay is not None)

    def quantile(self, share: float) -> float | None:
        """Return the delay within which this share of **all** engagements was named; None where too many were missed.

        >>> score_locations([0.0, 1.0, 2.0, 3.0], "abbb", "aabb").quantile(0.9)
        1.0
        """
        count = math.ceil(share * len(self.engagements) - _SLACK)
        delays = sorted(self.delays)
        return delays[count - 1] if 0 < count <= len(delays) else None

    @property
    def worst(self) -> tuple[Engagement, ...]:
        """The five worst engagements: those missed, then by delay, largest first."""
        ranked = sorted(self.engagements, key=lambda e: -math.inf if e.delay is None else -e.delay)
        return tuple(ranked[:5])

    def record(self) -> dict[str, object]:
        """Return the score as a tree for JSON."""
        return {
            "limit": self.limit,
            "minimum_stay": self.minimum_stay,
            "delay_median": self.quantile(0.5),
            "delay_90": self.quantile(0.9),
            "total": tally_record(self.total),
            "locations": [tally_record(tally) for tally in self.tallies],
            "engagements": [engagement_record(engagement) for engagement in self.engagements],
        }

    def __str__(self) -> str:
        total = self.total
        named = f"{total.engagements - total.missed} of {total.engagements}"
        lines = [
            f"engagements of at least {self.minimum_stay:g} s: {named} named, {total.late} later than {self.limit:g} s",
            f"delay: median {in_seconds(self.quantile(0.5))}, 90 % within {in_seconds(self.quantile(0.9))}, "
            f"worst {in_seconds(total.worst_delay)}",
            f"samples: {percent(total.right, total.samples)} right, {percent(total.wrong, total.samples)} wrong, "
            f"{percent(total.unnamed, total.samples)} without a name; "
            f"{100 * total.wrong_among_named:.2f} % of the names are wrong",
        ]
        return "\n".join([*lines, *tally_table(self.tallies), *_worst_lines(self)])


@dataclass(frozen=True, slots=True)
class StateScore:
    """Error of one estimated state: root mean square and largest, over all samples and while the location is known."""

    name: str
    rms: float
    largest: float
    rms_identified: float | None
    largest_identified: float | None

    def record(self) -> dict[str, object]:
        """Return the score as a tree for JSON."""
        return {
            "state": self.name,
            "rms": self.rms,
            "max": self.largest,
            "rms_identified": self.rms_identified,
            "max_identified": self.largest_identified,
        }


@dataclass(frozen=True, slots=True)
class Score:
    """The score of one run against its truth; `locations` is None and `states` empty where the truth is not known."""

    locations: LocationScore | None
    states: tuple[StateScore, ...]

    def record(self) -> dict[str, object]:
        """Return the score as a tree for JSON."""
        locations = None if self.locations is None else self.locations.record()
        return {"locations": locations, "states": [state.record() for state in self.states]}

    def __str__(self) -> str:
        parts = [] if self.locations is None else [str(self.locations)]
        for state in self.states:
            known = "the location is never known"
            if state.rms_identified is not None and state.largest_identified is not None:
                known = f"{state.rms_identified:.4g} rms, {state.largest_identified:.4g} max while identified"
            parts.append(f"error of {state.name}: {state.rms:.4g} rms, {state.largest:.4g} max; {known}")
        return "\n".join(parts) or "the trace has no truth to score against"


def score(
    trace: Trace,
    estimates: EstimateTrace,
    *,
    minimum_stay: float = 0.3,
    lead: float = 0.5,
    limit: float = 0.25,
    only: Sequence[str] | None = None,
) -> Score:
    """Return the score of the estimates against the truth columns of their trace; times in s.

    `only` restricts the location score to samples and engagements of these true locations.
    """
    locations = None
    if trace.true_location is not None:
        names = [location.name for location in trace.system.locations]
        locations = score_locations(
            trace.time.tolist(),
            trace.true_location,
            estimates.location,
            minimum_stay=minimum_stay,
            lead=lead,
            limit=limit,
            only=names if only is None else only,
        )
    return Score(locations, _state_scores(trace, estimates))


def score_locations(
    time: Sequence[float],
    truth: Sequence[str | None],
    estimate: Sequence[str | None],
    *,
    minimum_stay: float = 0.3,
    lead: float = 0.5,
    limit: float = 0.25,
    only: Sequence[str] | None = None,
) -> LocationScore:
    """Return how well `estimate` names `truth`, two sequences of location names over the same times (s).

    None is "not known" in both; samples without truth are not scored.  `only`: the true locations to score, and their
    order; by default all, in order of appearance.  ValueError where the lengths differ.

    >>> result = score_locations([0.0, 0.1, 0.2, 0.3, 0.4, 0.5], "aabbbb", ["a", "a", None, "b", "b", "b"])
    >>> [round(delay, 3) for delay in result.delays], result.total.right, result.total.unnamed
    ([0.1], 5, 1)
    """
    if not len(time) == len(truth) == len(estimate):
        raise ValueError(f"{len(time)} times, {len(truth)} true and {len(estimate)} estimated locations")
    names = tuple(dict.fromkeys(name for name in truth if name is not None)) if only is None else tuple(only)
    engagements = tuple(
        engagement
        for engagement in _engagements(time, truth, estimate, lead)
        if engagement.location in names and engagement.leave - engagement.enter >= minimum_stay - _SLACK
    )
    counted = {name: [0, 0, 0] for name in names}
    for true, said in zip(truth, estimate, strict=True):
        if true in counted:
            counted[true][2 if said is None else 0 if said == true else 1] += 1
    tallies = tuple(tally(name, counted[name], [e for e in engagements if e.location == name], limit) for name in names)
    sums = [sum(counted[name][kind] for name in names) for kind in range(3)]
    return LocationScore(engagements, tallies, tally("all", sums, engagements, limit), limit, minimum_stay)


def _stays(time: Sequence[float], truth: Sequence[str | None]) -> list[tuple[str | None, int, int, float]]:
    """Maximal stretches of one true name: (name, first index, index behind the last, time of leaving)."""
    starts = [i for i in range(len(truth)) if i == 0 or truth[i] != truth[i - 1]]
    ends = [*starts[1:], len(truth)]
    last = len(time) - 1
    return [(truth[i], i, j, time[min(j, last)]) for i, j in zip(starts, ends, strict=True)]


def _engagements(
    time: Sequence[float], truth: Sequence[str | None], estimate: Sequence[str | None], lead: float
) -> list[Engagement]:
    found = []
    left: dict[str, int] = {}  # by location: the index behind its previous stay
    for name, begin, end, leave in _stays(time, truth):
        if name is None:
            continue
        if begin > 0 and truth[begin - 1] is not None:
            named = _first_named(time, estimate, name, (left.get(name, 0), begin, end), lead)
            delay = None if named is None else time[named] - time[begin]
            found.append(Engagement(name, time[begin], leave, delay))
        left[name] = end
    return found


def _first_named(
    time: Sequence[float], estimate: Sequence[str | None], name: str, window: tuple[int, int, int], lead: float
) -> int | None:
    """Index at which the naming begins that holds at the entry, else the first naming before the exit."""
    earliest, begin, end = window
    if estimate[begin] != name:
        return next((i for i in range(begin, end) if estimate[i] == name), None)
    index = begin
    while index > earliest and estimate[index - 1] == name and time[index - 1] >= time[begin] - lead - _SLACK:
        index -= 1
    return index


def is_late(delay: float, limit: float) -> bool:
    """Return whether a delay is beyond the limit (s) by more than rounding.

    >>> is_late(0.1 + 0.2, 0.3), is_late(0.31, 0.3)
    (False, True)
    """
    return delay > limit + _SLACK


def tally(name: str, counts: Sequence[int], engagements: Sequence[Engagement], limit: float) -> LocationTally:
    """Return the tally of one location from its samples (right, wrong, unnamed) and engagements; `limit` in s."""
    delays = sorted(e.delay for e in engagements if e.delay is not None)
    right, wrong, unnamed = counts
    return LocationTally(
        name,
        right + wrong + unnamed,
        right,
        wrong,
        unnamed,
        len(engagements),
        sum(is_late(delay, limit) for delay in delays),
        len(engagements) - len(delays),
        float(np.median(delays)) if delays else None,
        delays[-1] if delays else None,
    )


def _state_scores(trace: Trace, estimates: EstimateTrace) -> tuple[StateScore, ...]:
    if trace.true_state is None:
        return ()
    errors = estimates.state - trace.true_state
    identified = np.array(estimates.identified, dtype=bool)
    scores = []
    for column, name in enumerate(trace.system.state_names):
        known = ~np.isnan(trace.true_state[:, column])
        if known.any():
            overall = _norms(errors[known, column])
            inside = errors[known & identified, column]
            scores.append(StateScore(name, *overall, *(_norms(inside) if inside.size else (None, None))))
    return tuple(scores)


def _norms(errors: FloatArray) -> tuple[float, float]:
    largest = float(np.max(np.abs(errors)))
    unit = largest or 1.0  # the squares of large errors would overflow
    return unit * float(np.sqrt(np.mean((errors / unit) ** 2))), largest


def tally_record(tally: LocationTally) -> dict[str, object]:
    """Return a tally as a tree for JSON."""
    return {
        "location": tally.name,
        "samples": tally.samples,
        "right": tally.right,
        "wrong": tally.wrong,
        "unnamed": tally.unnamed,
        "wrong_among_named": tally.wrong_among_named,
        "engagements": tally.engagements,
        "late": tally.late,
        "missed": tally.missed,
        "delay_median": tally.median_delay,
        "delay_worst": tally.worst_delay,
    }


def engagement_record(engagement: Engagement) -> Mapping[str, object]:
    """Return an engagement as a tree for JSON."""
    return {
        "location": engagement.location,
        "enter": engagement.enter,
        "leave": engagement.leave,
        "delay": engagement.delay,
    }


def in_seconds(value: float | None) -> str:
    """Return a time for a reader, `-` where there is none."""
    return "-" if value is None else f"{value:.3f} s"


def percent(part: int, whole: int) -> str:
    """Return a share of samples for a reader."""
    return f"{100 * part / max(1, whole):.2f} %"


def tally_table(tallies: Sequence[LocationTally]) -> list[str]:
    """Return one line per location that was visited; `-` where there is no engagement."""
    width = max([len("location"), *(len(tally.name) for tally in tallies)])
    lines = [f"{'location':<{width}}  engaged  late  missed    median     worst   samples    right    wrong  unnamed"]
    for tally in tallies:
        if tally.samples:
            counts = f"{tally.engagements:>7}  {tally.late:>4}  {tally.missed:>6}"
            delays = f"{in_seconds(tally.median_delay):>8}  {in_seconds(tally.worst_delay):>8}"
            shares = "  ".join(f"{percent(n, tally.samples):>7}" for n in (tally.right, tally.wrong, tally.unnamed))
            lines.append(f"{tally.name:<{width}}  {counts}  {delays}  {tally.samples:>8}  {shares}")
    return lines


def _worst_lines(score: LocationScore) -> list[str]:
    """The engagements that were late or missed, worst first."""
    bad = [e for e in score.worst if e.delay is None or is_late(e.delay, score.limit)]
    return [
        f"{'missed' if e.delay is None else 'late'}: {e.location} entered at {e.enter:.3f} s"
        + ("" if e.delay is None else f", named {e.delay:.3f} s later")
        for e in bad
    ]
