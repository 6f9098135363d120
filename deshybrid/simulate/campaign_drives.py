"""The drives of a campaign: one seeded execution for each job number.

In: a hybrid system, the campaign's seed, a job number.  Out: an `Execution`, which depends on nothing else, so that any
worker may run any drive at any time, and any drive can be run again alone.

Idea: job k has the k-th child of the campaign's seed sequence (`numpy.random.SeedSequence.spawn`), made directly from
its number.  Its first child shapes the drive as the model's `simulation: {variation: ...}` says, its second is the seed
of the execution: jitter of signals, noise, choices, and all that the model does not mention.

Cost: that of `simulate`.
"""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType

import numpy as np

from deshybrid.model.system import HybridSystem, SignalModel, SimulationOptions
from deshybrid.simulate.execution import Execution, simulate


def drive_sequences(seed: int, job: int) -> tuple[np.random.SeedSequence, np.random.SeedSequence]:
    """Return the seed sequences of one job: of the drive's shape, and of its execution.

    >>> shape, execution = drive_sequences(1, 7)
    >>> shape.spawn_key, execution.spawn_key
    ((7, 0), (7, 1))
    """
    shape, execution = np.random.SeedSequence(seed, spawn_key=(job,)).spawn(2)
    return shape, execution


def drive_seed(seed: int, job: int) -> int:
    """Return the seed of the job's execution, a number of 53 bits, which every reader of JSON keeps whole.

    >>> drive_seed(1, 0) != drive_seed(1, 1)
    True
    """
    return int(drive_sequences(seed, job)[1].generate_state(1, np.uint64)[0]) >> 11


def run_drive(
    system: HybridSystem, *, seed: int, job: int, duration: float | None = None, step: float | None = None
) -> Execution:
    """Return the execution of one job; `duration` and `step` (s) as of `simulate`, which says what it raises.

    >>> import deshybrid as dh
    >>> tank = dh.load("models/two_tank.yaml")
    >>> first, again = (run_drive(tank, seed=3, job=5, duration=9) for _ in range(2))
    >>> first.switches == again.switches
    True
    """
    shaped = vary(system, np.random.default_rng(drive_sequences(seed, job)[0]))
    return simulate(shaped, seed=drive_seed(seed, job), duration=duration, step=step)


def vary(system: HybridSystem, generator: np.random.Generator) -> HybridSystem:
    """Return the system with a `simulation` section that is varied as the section itself says.

    Requests keep their order; one that would come before time 0 comes at 0.

    >>> import deshybrid as dh
    >>> tank = dh.load("models/two_tank.yaml")
    >>> vary(tank, np.random.default_rng(0)).simulation.requests == tank.simulation.requests
    True
    """
    options = system.simulation
    width = options.variation
    shifts = generator.uniform(-width.requests, width.requests, len(options.requests))
    times = np.array([time for time, _ in options.requests]) + shifts
    ordered = np.maximum.accumulate(np.maximum(times, 0.0)).tolist()
    inputs = _scaled(options.input, width.input, generator)
    disturbances = _scaled(options.disturbance, width.disturbance, generator)
    state = options.state
    if state is not None:
        state = state * generator.uniform(1.0 - width.state, 1.0 + width.state, len(state))
        state.flags.writeable = False
    requests = tuple((time, event) for time, (_, event) in zip(ordered, options.requests, strict=True))
    varied = replace(options, requests=requests, input=inputs, disturbance=disturbances, state=state)
    pace = float(generator.uniform(1.0 - width.pace, 1.0 + width.pace))
    return replace(system, simulation=varied if pace == 1.0 else _stretched(varied, pace))


def _stretched(options: SimulationOptions, pace: float) -> SimulationOptions:
    """The same drive with all its times multiplied; sines and jitter keep their own."""

    def signals(given: Mapping[str, SignalModel]) -> Mapping[str, SignalModel]:
        later = ((name, tuple((time * pace, value) for time, value in s.points)) for name, s in given.items())
        return MappingProxyType({name: replace(given[name], points=points) for name, points in later})

    return replace(
        options,
        duration=None if options.duration is None else options.duration * pace,
        requests=tuple((time * pace, event) for time, event in options.requests),
        input=signals(options.input),
        unmeasured=signals(options.unmeasured),
        disturbance=signals(options.disturbance),
        commands=MappingProxyType(
            {name: tuple((time * pace, value) for time, value in said) for name, said in options.commands.items()}
        ),
    )


def _scaled(
    signals: Mapping[str, SignalModel], share: float, generator: np.random.Generator
) -> Mapping[str, SignalModel]:
    scaled = {}
    for name, signal in signals.items():
        factor = float(generator.uniform(1.0 - share, 1.0 + share))
        scaled[name] = replace(signal, points=tuple((time, value * factor) for time, value in signal.points))
    return MappingProxyType(scaled)
