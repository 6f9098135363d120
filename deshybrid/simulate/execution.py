"""Executions: a run of the model, what the sensors showed of it, and why it stopped.

In: a hybrid system, a seed, a duration and a step.  Out: an `Execution` with the trace (and its truth) at the step, the
switches at their exact times, and the reason to stop early, if there is one.  The same seed gives the same bytes.

The signals, requests and sensors of the model's `simulation` drive the run.  What it does not mention is random: inputs
and disturbances within their bounds (zero where unbounded), redrawn about every second; measurement noise within its
bound; the initial state within the state bounds (zero where unbounded); the initial location among `initial`.  Noise
that the model states as covariances is drawn where no bound is stated (`chance`).

A purely discrete model has no grid: its trace has one row per transition and a first row at time 0.

Source: Balluchi et al. (2012), section 2 (executions), section 5 (sensors).
"""

import math
from dataclasses import dataclass

import numpy as np

from deshybrid.diagnostics import Diagnostic, Span, UsageError, diagnostic, raise_all
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, HybridTransition
from deshybrid.model.timing import sampling_step
from deshybrid.simulate.commands import command_timeline
from deshybrid.simulate.events import Agenda, Stop, Switch
from deshybrid.simulate.plant import Drive, Plant
from deshybrid.simulate.sensors import measure, measure_inputs
from deshybrid.simulate.signals import DISTURBANCE, INPUT, START, UNMEASURED, sample_channels, stream
from deshybrid.simulate.trace import Trace

DEFAULT_DURATION = 60.0  # s
MAX_TICKS = 20_000_000
_SUBSTEPS = 10  # at least so many for each step
_MOST_SUBSTEPS = 1000
_PER_PERIOD = 16  # sub-steps for one period of a ripple or of an oscillation of the model


@dataclass(frozen=True, slots=True, eq=False)
class Execution:
    """One run: its trace with truth, its switches, the requests it did not meet, and why it stopped early or None.

    `step` is the trace's (None in a purely discrete model), `duration` what was asked for, both in s.
    """

    system: HybridSystem
    seed: int
    duration: float
    step: float | None
    trace: Trace
    switches: tuple[Switch, ...]
    pending: tuple[tuple[float, str], ...] = ()
    stop: Stop | None = None

    def __repr__(self) -> str:
        end = f"stopped: {self.stop.kind}" if self.stop else f"{self.duration:g} s"
        return f"Execution({self.system.name}, seed {self.seed}: {len(self.switches)} switches, {end})"


def simulate(
    system: HybridSystem,
    *,
    seed: int = 0,
    duration: float | None = None,
    step: float | None = None,
    substeps: int | None = None,
) -> Execution:
    """Return an execution of the system.

    Parameters
    ----------
    seed : int >= 0
        Choices, noise and random signals follow from it.
    duration : float, s
        By default that of the model's `simulation`, or 60 s.
    step : float, s
        Time between two rows of the trace; by default the model's, or a derived one (`sampling_step`).  A purely
        discrete model needs none and ignores it: it has one row for each transition.
    substeps : int
        Divisions of one step, over which inputs are held; by default 10, more where a ripple or an oscillation of the
        model has less than 16 of them in one period.

    Raises
    ------
    UsageError
        DH0701 (seed), DH0702 (duration), DH0703 (an impossible step), DH0704 (too many sub-steps).

    >>> from deshybrid.model.system import Dwell, HybridTransition, Location
    >>> pair = (HybridTransition("on", "a", "off", ("α",)), HybridTransition("off", "b", "on"))
    >>> places = (Location("on", dwell=Dwell(2, 2)), Location("off", dwell=Dwell(3, 3)))
    >>> toy = HybridSystem("toy", places, pair, ("on",))
    >>> [(s.time, s.event, s.output) for s in simulate(toy, seed=1, duration=6).switches]
    [(2.0, 'a', 'α'), (5.0, 'b', None)]
    """
    duration = duration if duration is not None else system.simulation.duration or DEFAULT_DURATION
    raise_all(_mistakes(seed, duration), UsageError)
    if system.is_discrete:
        return _run_automaton(system, seed, duration)
    step = _step_of(system, step)
    drive = build_drive(system, seed=seed, duration=duration, step=step, substeps=substeps or _substeps(system, step))
    plant = Plant(system, drive, seed)
    stop = plant.run()
    trace = _trace(plant, seed)
    return Execution(system, seed, duration, step, trace, tuple(plant.switches), plant.agenda.pending, stop)


def build_drive(system: HybridSystem, *, seed: int, duration: float, step: float, substeps: int) -> Drive:
    """Return the grid and the signals on it; all times in s.  Raises `UsageError` DH0704 beyond MAX_TICKS sub-steps."""
    if not duration / step * substeps < MAX_TICKS:
        text = f"{duration:g} s in sub-steps of {step / substeps:g} s are more than {MAX_TICKS} sub-steps"
        helps = ("shorten the run or choose a longer step",)
        raise UsageError(diagnostic("DH0704", text, _written_step(system, step), helps=helps))
    ticks = np.arange(math.floor(duration / step + 1e-9) * substeps + 1)
    time = (ticks // substeps) * step + (ticks % substeps) * (step / substeps)
    wishes, bounds = system.simulation, system.bounds
    period = max(1, round(1.0 / step)) * step  # changes of unmentioned signals fall on rows

    shown = sample_channels(system.input_names, wishes.input, bounds.input, time, seed=seed, kind=INPUT, period=period)
    hidden = sample_channels(
        system.input_names, wishes.unmeasured, None, time, seed=seed, kind=UNMEASURED, period=period
    )
    disturbances = sample_channels(
        system.disturbance_names,
        wishes.disturbance,
        bounds.disturbance,
        time,
        seed=seed,
        kind=DISTURBANCE,
        period=period,
    )
    commands = command_timeline(system, seed=seed, duration=duration, period=period)
    return Drive(step, substeps, time, shown, shown + hidden, disturbances, commands)


def _written_step(system: HybridSystem, step: float) -> Span | None:
    """Where the model says this step; None where it came from elsewhere."""
    if system.source is None:
        return None
    if step == system.time_step:
        return system.source.place("time", "step")
    return system.source.place("observer", "step") if step == system.observer.step else None


def _mistakes(seed: int, duration: float) -> list[Diagnostic]:
    mistakes = []
    if seed < 0:
        mistakes.append(diagnostic("DH0701", f"the seed is {seed}, expected a whole number from 0"))
    if not 0.0 < duration < math.inf:
        mistakes.append(diagnostic("DH0702", f"the duration is {duration:g} s, expected a positive number of seconds"))
    return mistakes


def _step_of(system: HybridSystem, wanted: float | None) -> float:
    """The step of the trace; in discrete time a whole number of the model's own steps."""
    step = sampling_step(system) if wanted is None else wanted
    own = system.time_step
    whole = own is None or (step / own > 0.5 and abs(step / own - round(step / own)) < 1e-9)
    if not (0.0 < step < math.inf and whole):
        expected = "a positive number of seconds" if own is None else f"a multiple of the model's step {own:g} s"
        raise UsageError(diagnostic("DH0703", f"the step is {step:g} s, expected {expected}"))
    return step


def _substeps(system: HybridSystem, step: float) -> int:
    """Sub-steps for one step: enough for the fastest ripple and the fastest oscillation of the model."""
    if system.time_step is not None:
        return round(step / system.time_step)
    wishes = system.simulation
    signals = [*wishes.input.values(), *wishes.unmeasured.values(), *wishes.disturbance.values()]
    rates = [signal.frequency for signal in signals if signal.amplitude]
    for location in system.locations:
        if location.dynamics is not None and location.dynamics.A.size:
            rates.append(float(np.abs(np.linalg.eigvals(location.dynamics.A).imag).max()) / (2.0 * math.pi))
    return max(_SUBSTEPS, math.ceil(min(_PER_PERIOD * max(rates, default=0.0) * step, _MOST_SUBSTEPS)))


def _trace(plant: Plant, seed: int) -> Trace:
    """The rows up to the last one that was reached."""
    system, drive = plant.system, plant.drive
    rows = np.arange(0, plant.sampled, drive.substeps)
    seen = dict(plant.seen)
    names = [location.name for location in system.locations]
    errors = plant.chance.errors(plant.places[rows])
    return Trace(
        system,
        row_times(len(rows), drive.step),
        measure_inputs(system, drive.shown[: plant.sampled], substeps=drive.substeps, tick=drive.tick, seed=seed),
        measure(system, plant.outputs(), errors, substeps=drive.substeps, tick=drive.tick, seed=seed),
        tuple(seen.get(row) for row in range(len(rows))),
        tuple(names[place] for place in plant.places[rows].tolist()),
        plant.states[rows],
        tuple(drive.commands.at(time) for time in drive.time[rows].tolist()),
    )


def row_times(count: int, step: float) -> FloatArray:
    """Return the times of equally spaced rows, without the last digits that only rounding puts there.

    >>> row_times(4, 0.1).tolist()
    [0.0, 0.1, 0.2, 0.3]
    """
    return np.array([float(f"{index * step:.12g}") for index in range(count)])


def _run_automaton(system: HybridSystem, seed: int, duration: float) -> Execution:
    """A run of a purely discrete model, one row for each transition."""
    agenda, generator = Agenda(system, seed), stream(seed, START)
    name = system.simulation.location or system.initial[int(generator.integers(len(system.initial)))]
    commands = command_timeline(system, seed=seed, duration=duration)
    switches: list[Switch] = []
    places, now, stop = [name], 0.0, None
    while True:
        when, options = commands.first_permitted(*_next_exit(system, agenda, name, now))
        location = system.location(name)
        over = now + (location.dwell.max or math.inf)
        if not options or when > min(over, duration):
            if not any(t.source == name for t in system.transitions):
                stop = Stop("blocked", now, f"no transition leaves location `{name}`", location.span)
            elif over <= duration:
                text = f"the longest stay in location `{name}` is over and the commands permit no transition"
                stop = Stop("blocked", over, text, location.span)
            break
        taken = options[agenda.choose(len(options))]
        if switches and when <= now:
            stop = Stop("simultaneous", when, f"`{taken.event}` would follow in the same instant", taken.span)
            break
        output = taken.outputs[agenda.choose(len(taken.outputs))]
        switches.append(Switch(when, taken.event, name, taken.target, output))
        agenda.meet(taken.event, when)
        name, now = taken.target, when
        places.append(name)
    empty = np.zeros((len(places), 0))
    times, events = np.array([0.0, *(s.time for s in switches)]), (None, *(s.output for s in switches))
    told = tuple(map(commands.at, times.tolist()))
    trace = Trace(system, times, empty, empty, events, tuple(places), commands=told)
    return Execution(system, seed, duration, None, trace, tuple(switches), agenda.pending, stop)


def _next_exit(
    system: HybridSystem, agenda: Agenda, name: str, entered: float
) -> tuple[float, tuple[HybridTransition, ...]]:
    """When a purely discrete location is left, and by which of the transitions; none where nothing asks for it."""
    location = system.location(name)
    exits = tuple(t for t in system.transitions if t.source == name)
    leave = agenda.draw_leave(location, entered, exits)
    if leave is not None:
        return leave, exits
    forced = entered + (location.dwell.max or math.inf)
    asked = tuple(t for t in exits if agenda.head is not None and t.event == agenda.head[1])
    if agenda.head is not None and asked:
        when = max(agenda.head[0], entered + (location.dwell.min or 0.0))
        if when <= forced:
            return when, asked
    return forced, exits if forced < math.inf else ()
