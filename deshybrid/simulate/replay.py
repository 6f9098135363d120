"""The observer at work on a trace: one estimate per row.

In: an observer with a pure step, and a trace.  Out: `EstimateTrace`, which keeps both the trace and every estimate, and
its CSV form.  The truth in the trace is never shown to the observer.

An output that some locations do not measure may be NaN in a row; the observer is then given the last value seen (0
before the first), because a location that does not measure a channel does not look at it.  A channel that every
location measures is passed on as it is: where it is NaN, the observer says `invalid`.

One step per row.  Source: Balluchi et al. (2012), section 4.2, Figure 15, run in sampled time.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.simulate.trace import Trace, quoted, shortest

S = TypeVar("S")


class EstimateLike(Protocol):
    """What an observer says after one sample."""

    @property
    def location(self) -> str | None:
        """The current location, or None while it is not known."""

    @property
    def entry_estimate(self) -> tuple[str, ...]:
        """The locations that may have been entered when the last output was seen."""

    @property
    def identified(self) -> bool:
        """Whether the location is known."""

    @property
    def signature(self) -> str | None:
        """The signature that fired at this sample, or None."""

    @property
    def status(self) -> str:
        """One word: `searching`, `identified`, `provisional`, `inconsistent`, `invalid`."""

    @property
    def state(self) -> Sequence[float]:
        """The estimate of the continuous state, n numbers."""


E_co = TypeVar("E_co", bound=EstimateLike, covariant=True)


class ObserverLike(Protocol[S, E_co]):
    """An observer whose step is pure: what it remembers goes in and comes out as a value."""

    def start(self) -> S:
        """Return what the observer remembers before the first sample."""

    def step(
        self,
        state: S,
        input: Sequence[float],
        output: Sequence[float],
        event: str | None,
        command: Sequence[str | None] = (),
    ) -> tuple[S, E_co]:
        """Return what the observer remembers after one sample, and its estimate."""


@dataclass(frozen=True, slots=True, eq=False)
class EstimateTrace:
    """The estimates of one run, row by row of `trace`; state (N, n), read-only."""

    trace: Trace
    location: tuple[str | None, ...]
    entry_estimate: tuple[tuple[str, ...], ...]
    identified: tuple[bool, ...]
    signature: tuple[str | None, ...]
    status: tuple[str, ...]
    state: FloatArray

    def __len__(self) -> int:
        return len(self.location)

    def to_table(self) -> dict[str, Sequence[object] | FloatArray]:
        """Return the columns of the estimates' file by their names, which pandas takes as they are.

        An `entry_estimate` is a tuple of names, `identified` a truth value, None where there is no name.
        """
        table: dict[str, Sequence[object] | FloatArray] = {"time": self.trace.time, "location": self.location}
        table |= {"entry_estimate": self.entry_estimate, "identified": self.identified}
        table |= {"signature": self.signature, "status": self.status}
        names = self.trace.system.state_names
        return table | {f"{name}_hat": self.state[:, place] for place, name in enumerate(names)}

    def __repr__(self) -> str:
        share = 100.0 * sum(self.identified) / max(1, len(self))
        return f"EstimateTrace({self.trace.system.name}: {len(self)} rows, identified in {share:.1f} %)"


def replay(observer: ObserverLike[S, EstimateLike], trace: Trace) -> EstimateTrace:
    """Run an observer over a trace, one step per row.

    >>> from types import SimpleNamespace
    >>> from deshybrid.model.system import HybridSystem, Location
    >>> toy = HybridSystem("toy", (Location("a"), Location("b")), (), ("a",))
    >>> says = SimpleNamespace(
    ...     location="b", entry_estimate=("a", "b"), identified=True, signature=None, status="identified", state=()
    ... )
    >>> observer = SimpleNamespace(start=lambda: 0, step=lambda state, u, y, event, command: (state + 1, says))
    >>> replay(observer, Trace(toy, [0.0], np.zeros((1, 0)), np.zeros((1, 0)))).location
    ('b',)
    """
    return estimate_trace(trace, [estimate for _, estimate in steps(observer, trace)])


def steps(observer: ObserverLike[S, E_co], trace: Trace) -> Iterator[tuple[S, E_co]]:
    """Yield what an observer remembers and says after each row of a trace."""
    state = observer.start()
    outputs = _held_where_optional(trace).tolist()
    rows = zip(trace.inputs.tolist(), outputs, trace.events, trace.commands, strict=True)
    for row_input, row_output, event, command in rows:
        state, estimate = observer.step(state, tuple(row_input), tuple(row_output), event, command)
        yield state, estimate


def estimate_trace(trace: Trace, estimates: Sequence[EstimateLike]) -> EstimateTrace:
    """Return the estimates of all rows as one value."""
    names = trace.system.state_names
    states = np.array([tuple(estimate.state) for estimate in estimates], dtype=np.float64)
    states = states.reshape(len(estimates), len(names))
    states.flags.writeable = False
    return EstimateTrace(
        trace,
        tuple(estimate.location for estimate in estimates),
        tuple(tuple(estimate.entry_estimate) for estimate in estimates),
        tuple(bool(estimate.identified) for estimate in estimates),
        tuple(estimate.signature for estimate in estimates),
        tuple(estimate.status for estimate in estimates),
        states,
    )


def write_estimates(estimates: EstimateTrace) -> str:
    """Return the estimates as CSV: time, location, entry_estimate, identified, signature, status, <state>_hat.

    `location` and `signature` are empty where there is none; the names in `entry_estimate` are joined by `|`.
    """
    header = ["time", "location", "entry_estimate", "identified", "signature", "status"]
    header += [f"{name}_hat" for name in estimates.trace.system.state_names]
    columns = zip(
        map(shortest, estimates.trace.time.tolist()),
        (quoted(name or "") for name in estimates.location),
        (quoted("|".join(names)) for names in estimates.entry_estimate),
        ("1" if known else "0" for known in estimates.identified),
        (quoted(name or "") for name in estimates.signature),
        map(quoted, estimates.status),
        (list(map(shortest, row)) for row in estimates.state.tolist()),
        strict=True,
    )
    lines = [",".join(map(quoted, header))]
    lines += [",".join([*fields, *numbers]) for *fields, numbers in columns]
    return "\n".join(lines) + "\n"


def _held_where_optional(trace: Trace) -> FloatArray:
    """Outputs in which the channels that not every location measures hold their last value instead of NaN."""
    outputs = trace.outputs.copy()
    for channel in range(outputs.shape[1]):
        if all(channel in location.output_index for location in trace.system.locations):
            continue
        seen = np.maximum.accumulate(np.where(np.isnan(outputs[:, channel]), -1, np.arange(len(trace))))
        outputs[:, channel] = np.where(seen >= 0, outputs[np.maximum(seen, 0), channel], 0.0)
    return outputs
