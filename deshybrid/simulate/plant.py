"""A hybrid plant in motion: flows, guards, resets and events from outside, on a grid of sub-steps.

In: a system and what acts on it from outside (`Drive`).  Out: the states and locations on the grid, the switches, and
the reason to stop, if there is one.

Inputs, disturbances and commands are held over a sub-step.  Within it the flow is exact, and the instant of an event is
found by root finding.  Guarded transitions are urgent: taken as soon as the guard holds, once the shortest stay has
passed.  What a command excludes waits until the command permits it.
The row of a trace at time t shows what is true after all events up to and including t.  Transitions that would follow
each other in one instant stop the run: B12 excludes them.

Some 20 microseconds for each sub-step, some milliseconds for each event.
Source: Balluchi et al. (2012), section 2, executions of a hybrid system.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.predicates import Predicate
from deshybrid.model.system import HybridSystem, HybridTransition, Location
from deshybrid.simulate.chance import Chance
from deshybrid.simulate.commands import Timeline
from deshybrid.simulate.events import Agenda, Stop, Switch
from deshybrid.simulate.flow import Flow, build_flow, outputs_of
from deshybrid.simulate.guards import RESOLUTION, Piece, Watch, build_watch, first_time, holds
from deshybrid.simulate.signals import START, stream

_SHRINKING = 10  # so many stays in a row, each shorter than the one before, are taken for Zeno behaviour
_SHRINKING_CROWDED = 5  # as many suffice where two outputs fall into one step at last
_MOST_PER_STEP = 100  # transitions within one sampling step
_LARGEST = 1e30  # a state beyond it counts as grown beyond all numbers, as in the observer's step
_TRIES = 1000  # draws of an initial state within the invariant


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """What acts on the plant on a grid of sub-steps: time (N,) in s, inputs (N, m), disturbances (N, r).

    `shown` (N, m) is the part of the inputs that the trace tells.
    """

    step: float
    substeps: int
    time: FloatArray
    shown: FloatArray
    inputs: FloatArray
    disturbances: FloatArray
    commands: Timeline

    @property
    def tick(self) -> float:
        """Length of one sub-step in s."""
        return self.step / self.substeps


@dataclass(frozen=True, slots=True, eq=False)
class Mode:
    """One location ready to run."""

    index: int
    location: Location
    flow: Flow
    watch: Watch
    exits: tuple[HybridTransition, ...]


class Decision(NamedTuple):
    """Go on to `until` (s after the tick) and take one of `due` there; `forced`: they may have different events."""

    until: float
    due: tuple[HybridTransition, ...] = ()
    forced: bool = False
    stop: Stop | None = None


def build_modes(system: HybridSystem, tick: float) -> dict[str, Mode]:
    """Return each location with its flow and the comparisons to watch, by name."""
    modes = {}
    for index, location in enumerate(system.locations):
        exits = tuple(t for t in system.transitions if t.source == location.name)
        predicates: list[Predicate] = [t.guard for t in exits if t.guard is not None]
        if location.invariant is not None:
            predicates.append(location.invariant)
        flow = build_flow(system, location, tick)
        modes[location.name] = Mode(index, location, flow, build_watch(predicates, flow, tick), exits)
    return modes


class Plant:
    """One run; `run` fills states (N, n), places (N,), switches and seen outputs as far as it comes."""

    def __init__(self, system: HybridSystem, drive: Drive, seed: int) -> None:
        self.system, self.drive = system, drive
        self.agenda = Agenda(system, seed)
        self.chance = Chance(system, seed, drive.tick)
        with np.errstate(over="ignore", invalid="ignore"):
            self.modes = build_modes(system, drive.tick)
        self.states = np.zeros((len(drive.time), len(system.state_names)))
        self.places = np.zeros(len(drive.time), dtype=np.int64)
        self.sampled = 0
        self.switches: list[Switch] = []
        self.seen: list[tuple[int, str]] = []  # (row of the trace, output)
        self._close = RESOLUTION * drive.tick
        self._begin(stream(seed, START))

    def run(self) -> Stop | None:
        """Run to the end of the drive, or to the reason why that is not possible."""
        with np.errstate(over="ignore", invalid="ignore"):
            for tick in range(len(self.drive.time)):
                stop = self._pass(tick)
                if stop is not None:
                    if self.sampled == tick and stop.kind != "crowded":
                        self._sample(tick)  # it stopped in the very instant of this tick
                    return stop
        return None

    def outputs(self) -> FloatArray:
        """Return what the sensors see before they distort it, NaN where a location does not measure, (sampled, p)."""
        values = np.full((self.sampled, len(self.system.output_names)), np.nan)
        places = self.places[: self.sampled]
        for mode in self.modes.values():
            rows = np.flatnonzero(places == mode.index)
            channels, outputs = outputs_of(self.system, mode.location, self.states[rows], self.drive.inputs[rows])
            values[np.ix_(rows, np.asarray(channels, dtype=np.int64))] = outputs
        return values

    def _begin(self, generator: np.random.Generator) -> None:
        before = self.chance.start()
        if before is not None:
            name, self.x = before
            self._enter(self.modes[self.chance.next_location(name)], 0.0)
            for _ in range(self.drive.substeps):  # the step to the first row
                self._advance(0, self.drive.tick)
                self.x = self.chance.shake(self.mode.location.name, self.x)
            return
        wishes = self.system.simulation
        names = self.system.initial
        name = wishes.location or names[int(generator.integers(len(names)))]
        self._enter(self.modes[name], 0.0)
        n, bound = len(self.system.state_names), self.system.bounds.state
        if wishes.state is not None:
            self.x = np.array(wishes.state, dtype=np.float64)
            return
        invariant = self.mode.location.invariant
        for _ in range(_TRIES):
            self.x = np.zeros(n) if bound is None else generator.uniform(-bound, bound)
            if invariant is None or holds(invariant, self.mode.watch.values(self._point(0))):
                return

    def _enter(self, mode: Mode, now: float) -> None:
        self.mode, self.entered = mode, now
        self.leave = self.agenda.draw_leave(mode.location, now, mode.exits)

    def _point(self, tick: int) -> FloatArray:
        return np.concatenate([self.x, self.drive.inputs[tick], self.drive.disturbances[tick], [1.0]])

    def _pass(self, tick: int) -> Stop | None:
        """All events at this tick, its sample, and the way to the next tick with the events on it."""
        offset, sampled = 0.0, False
        while True:
            last = tick == len(self.drive.time) - 1
            decision = Decision(self.drive.tick) if last else self._decide(tick, offset)
            if decision.stop is not None:
                return decision.stop
            if not sampled and not (decision.due and decision.until <= self._close):
                self._sample(tick)
                sampled = True
                if self.chance.is_chain and tick % self.drive.substeps == 0 and not last:
                    self._follow_chain(self._time(tick))
            if last:
                return None
            if not self._advance(tick, decision.until - offset):
                return self._unstable(self._time(tick))
            offset = decision.until
            if decision.due:
                stop = self._fire(decision, self._time(tick, offset), tick + sampled)
                if stop is not None:
                    return stop
            elif offset >= self.drive.tick:
                self.x = self.chance.shake(self.mode.location.name, self.x)
                return None

    def _time(self, tick: int, offset: float = 0.0) -> float:
        return float(self.drive.time[tick]) + offset

    def _sample(self, tick: int) -> None:
        self.states[tick] = self.x
        self.places[tick] = self.mode.index
        self.sampled = tick + 1

    def _advance(self, tick: int, duration: float) -> bool:
        """Move the state; False where it grew beyond all numbers."""
        if duration >= self.drive.tick:
            self.x = self.mode.flow.whole @ self._point(tick)
        elif duration > 0.0:
            self.x = self.mode.flow.after(self._point(tick), duration)
        return _is_within(self.x)

    def _unstable(self, now: float) -> Stop:
        location = self.mode.location
        message = f"the state of location `{location.name}` grows beyond all numbers"
        return Stop("unstable", now, message, location.span)

    def _decide(self, tick: int, offset: float) -> Decision:
        """What happens first between `offset` and the next tick."""
        now, mode = self._time(tick, offset), self.mode
        end = self._stretch_end(tick, offset)
        if self.system.time_step is not None and self.switches and self.switches[-1].time == now:
            return Decision(end)  # discrete time: one transition a step
        if end - offset <= self._close:
            return Decision(end)  # too short to tell a sign from rounding; the next stretch decides
        ready = self._ready(now, tick)
        overdue = now >= self.entered + (mode.location.dwell.max or np.inf) - self._close
        invariant = mode.location.invariant
        pieces: Sequence[Piece] = ()
        if overdue or invariant is not None or any(t.guard is not None for t in ready):
            pieces = mode.watch.pieces(self._point(tick), end - offset)
        chances = [(0.0 if t.guard is None else first_time(pieces, t.guard, True), t) for t in ready]
        timed = [(time, t) for time, t in chances if time is not None]
        limit = 0.0 if overdue else None if invariant is None else first_time(pieces, invariant, False)
        soonest = min((time for time, _ in timed), default=np.inf)
        if limit is not None and soonest > limit + self._close:
            enabled = self._enabled(pieces, limit, now + limit, tick)
            stop = None if enabled else self._must_leave(now + limit, overdue)
            return Decision(offset + limit, enabled, forced=True, stop=stop)
        if not timed:
            return Decision(end)
        return Decision(offset + soonest, tuple(t for time, t in timed if time <= soonest + self._close))

    def _stretch_end(self, tick: int, offset: float) -> float:
        """The next sub-step, or before it the time at which another transition may be taken or must be."""
        whole = self.drive.tick
        if self.system.time_step is not None:
            return whole
        dwell, head = self.mode.location.dwell, self.agenda.head
        gates = [self.entered + (dwell.min or 0.0), self.entered + (dwell.max or np.inf)]
        gates += [time for time in (self.leave, head and head[0]) if time is not None]
        start = self._time(tick)
        inside = [g - start for g in gates if offset + self._close < g - start < whole - self._close]
        return min(inside, default=whole)

    def _ready(self, now: float, tick: int) -> list[HybridTransition]:
        """The transitions that may be taken from now on, as soon as their guards hold."""
        if now < self.entered + (self.mode.location.dwell.min or 0.0) - self._close:
            return []
        exits, head = self._permitted(self.mode.exits, tick), self.agenda.head
        ready = [t for t in exits if t.guard is not None and t.event not in self.agenda.requested]
        if head is not None and now >= head[0] - self._close:
            ready += [t for t in exits if t.event == head[1]]
        if self.leave is not None and now >= self.leave - self._close:
            free = [t for t in exits if t.guard is None]
            ready += [free[self.agenda.choose(len(free))]] if free else []
        return ready

    def _permitted(self, exits: tuple[HybridTransition, ...], tick: int) -> tuple[HybridTransition, ...]:
        """Those that the commands of this sub-step permit."""
        if not self.drive.commands.names:
            return exits
        now = float(self.drive.time[tick])
        return tuple(t for t in exits if self.drive.commands.permits(t, now))

    def _enabled(self, pieces: Sequence[Piece], limit: float, when: float, tick: int) -> tuple[HybridTransition, ...]:
        """All transitions that can be taken at the instant at which the location cannot be stayed in any longer."""
        if when < self.entered + (self.mode.location.dwell.min or 0.0) - self._close:
            return ()
        values = [piece.values for piece in pieces if abs(piece.offset - limit) <= self._close]
        exits = self._permitted(self.mode.exits, tick)
        return tuple(t for t in exits if t.guard is None or any(holds(t.guard, v) for v in values))

    def _must_leave(self, when: float, overdue: bool) -> Stop:
        location = self.mode.location
        if overdue:
            message = f"the longest stay in location `{location.name}` is over and no transition is enabled"
            return Stop("blocked", when, message, location.span)
        message = f"the invariant of location `{location.name}` ends and no transition is enabled"
        return Stop("invariant", when, message, location.spans.get("invariant", location.span))

    def _fire(self, decision: Decision, now: float, tick: int) -> Stop | None:
        """Take a transition now, seen at `tick`; or say why that is not possible."""
        due = decision.due
        if len({t.event for t in due}) > 1 and not decision.forced:
            events = " and ".join(dict.fromkeys(f"`{t.event}`" for t in due))
            message = f"the events {events} are enabled at the same instant in location `{due[0].source}`"
            return Stop("simultaneous", now, message, due[1].span)
        taken = due[self.agenda.choose(len(due))]
        if self.switches and now - self.switches[-1].time <= self._close:
            message = f"`{taken.event}` would follow `{self.switches[-1].event}` in the same instant"
            return Stop("simultaneous", now, message, taken.span)
        x = self.x if taken.reset is None else taken.reset.matrix @ self.x + taken.reset.offset
        if not _is_within(x):
            return self._unstable(now)
        self.x = x
        output = taken.outputs[self.agenda.choose(len(taken.outputs))]
        self.switches.append(Switch(now, taken.event, taken.source, taken.target, output))
        self.agenda.meet(taken.event, now + self._close)
        self._enter(self.modes[taken.target], now)
        return self._zeno(now, taken) or self._show(output, now, tick, taken)

    def _follow_chain(self, now: float) -> None:
        """Enter the location that governs the step to the next row."""
        source = self.mode.location.name
        target = self.chance.next_location(source)
        if target != source:
            self.switches.append(Switch(now, "chain", source, target, None))
            self._enter(self.modes[target], now)

    def _show(self, output: str | None, now: float, tick: int, taken: HybridTransition) -> Stop | None:
        """Put an output into its row of the trace, which has room for one."""
        if output is None:
            return None
        row = -(-tick // self.drive.substeps)
        if self.seen and self.seen[-1][0] == row:
            message = f"the outputs `{self.seen[-1][1]}` and `{output}` fall into one step of {self.drive.step:g} s"
            return self._shrinking(_SHRINKING_CROWDED, taken) or Stop("crowded", now, message, taken.span)
        self.seen.append((row, output))
        return None

    def _zeno(self, now: float, taken: HybridTransition) -> Stop | None:
        """Stays that shrink below the sampling step, or too many transitions within one."""
        step = self.drive.step
        if len(self.switches) > _MOST_PER_STEP and now - self.switches[-_MOST_PER_STEP - 1].time <= step:
            message = f"Zeno behaviour, more than {_MOST_PER_STEP} transitions within {step:g} s"
            return Stop("zeno", now, message, taken.span)
        return self._shrinking(_SHRINKING, taken)

    def _shrinking(self, count: int, taken: HybridTransition) -> Stop | None:
        """So many stays in a row, each shorter than the one before, the last shorter than the sampling step."""
        stays = np.diff([switch.time for switch in self.switches[-count - 1 :]])
        if len(stays) < count or stays[-1] >= self.drive.step or not (np.diff(stays) < -self._close).all():
            return None
        ratio, now = float(stays[-1] / stays[-2]), self.switches[-1].time
        accumulation = now + float(stays[-1]) * ratio / (1.0 - ratio)
        message = f"Zeno behaviour, the stays shrink by {ratio:.3g} and accumulate at about {accumulation:.6g} s"
        return Stop("zeno", now, message, taken.span)


def _is_within(x: FloatArray) -> bool:
    """False for NaN too."""
    return bool((np.abs(x) < _LARGEST).all())
