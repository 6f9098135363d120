"""Commands during a run: which values the controller sets, when, and what they permit.

In: a system, a seed, a duration.  Out: a `Timeline`, the values of all commands from each change to the next.
A command that the model's `simulation` mentions has the values written there.  Else it follows the requests: with each
one it takes the first value that the requested transition permits, unless the present one does.  Without requests it is
drawn anew about every second.

Linear in the changes.  Source: this project.
"""

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from deshybrid.model.system import Command, HybridSystem, HybridTransition
from deshybrid.simulate.signals import COMMANDS, stream

_SLACK = 1e-9  # s, by which a change may come early, so that rounding never delays it
Changes = list[tuple[float, str]]


@dataclass(frozen=True, slots=True)
class Timeline:
    """`values[i]`, one for each command of `names`, hold from `times[i]` (s, ascending, the first 0) on."""

    names: tuple[str, ...]
    times: tuple[float, ...]
    values: tuple[tuple[str, ...], ...]

    def at(self, time: float) -> tuple[str, ...]:
        """Return the values at a time."""
        return self.values[bisect_right(self.times, time + _SLACK) - 1]

    def permits(self, transition: HybridTransition, time: float) -> bool:
        """Return whether the commands at a time permit a transition."""
        when = transition.when
        return not when or all(
            value in when.get(name, (value,)) for name, value in zip(self.names, self.at(time), strict=True)
        )

    def first_permitted(
        self, time: float, transitions: Sequence[HybridTransition]
    ) -> tuple[float, tuple[HybridTransition, ...]]:
        """Return the first time from `time` on at which commands permit some of the transitions, and these."""
        later = self.times[bisect_right(self.times, time + _SLACK) :]
        for moment in (time, *later):
            found = tuple(t for t in transitions if self.permits(t, moment))
            if found:
                return moment, found
        return math.inf, ()


def command_timeline(system: HybridSystem, *, seed: int, duration: float, period: float = 1.0) -> Timeline:
    """Return the commands of a run of `duration` s; `period` (s): how often a random one is drawn.

    >>> from deshybrid.model.load import loads
    >>> car = loads('''{format: deshybrid/1, commands: {lever: [P, D]}, locations: [rest, drive], transitions: [
    ...   {from: rest, to: drive, event: go, when: {lever: D}}, {from: drive, to: rest, event: halt, when: {lever: P}}],
    ...   simulation: {location: rest, requests: [[2, go], [5, halt]]}}''')
    >>> command_timeline(car, seed=0, duration=9)
    Timeline(names=('lever',), times=(0.0, 2.0, 5.0), values=(('P',), ('D',), ('P',)))
    """
    changes = [
        _changes(system, place, command, seed=seed, duration=duration, period=period)
        for place, command in enumerate(system.commands)
    ]
    times = sorted({0.0, *(time for found in changes for time, _ in found if time > 0.0)})
    values = (tuple(_held(found, time) for found in changes) for time in times)
    return Timeline(system.command_names, tuple(times), tuple(values))


def _held(changes: Changes, time: float) -> str:
    """The value at a time; before the first change it is that of the first."""
    return next((value for when, value in reversed(changes) if when <= time), changes[0][1])


def _changes(
    system: HybridSystem, place: int, command: Command, *, seed: int, duration: float, period: float
) -> Changes:
    written = system.simulation.commands.get(command.name)
    if written is not None:
        return list(written)
    if system.simulation.requests:
        return list(_as_requested(system, command))
    drawn = stream(seed, COMMANDS, place).integers(len(command.values), size=math.floor(duration / period) + 1)
    return [(index * period, command.values[int(value)]) for index, value in enumerate(np.asarray(drawn))]


def _as_requested(system: HybridSystem, command: Command) -> Iterator[tuple[float, str]]:
    """Follow the requests from location to location, as if each were met."""
    here, value = system.simulation.location, command.values[0]
    yield 0.0, value
    for time, event in sorted(system.simulation.requests, key=lambda request: request[0]):
        named = [t for t in system.transitions if t.event == event]
        taken = next((t for t in named if t.source == here), named[0])
        here, permitted = taken.target, taken.when.get(command.name, (value,))
        if value not in permitted:
            value = permitted[0]
            yield time, value
