"""Samples with the estimates of the reference step: what generated code is compared with.

In: `StepTables` and a seed.  Out: a list of samples, each with the estimate that the reference step gave.  The samples
are made to reach much of the observer: for a while the outputs are what one residual generator predicts, so that its
location becomes active, then another's or noise; events are mostly those that the present state knows.  Some samples
are invalid, some events are no events.

In single precision the reference runs on `numpy.float32` scalars, operation by operation, so that its results are
those of a C compiler for `float`, bit for bit.

`count` reference steps.  Source of the idea: test vectors of Embedded Coder and SymForce.
"""

import random
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from deshybrid.observer import reference
from deshybrid.observer.tables import StepTables, plain_tables

Sample = tuple[tuple[float, ...], tuple[float, ...], int, tuple[int, ...]]


@dataclass(frozen=True, slots=True)
class Vector:
    """One sample (input, output, event and command codes), whether the observer was reset before it, and the estimate.

    `location` and `signature` are -1 where there is none; `tracker` is the location observer's state, and
    `entry_estimate` the locations it stands for; `status` an index into `STATUS_NAMES`.
    """

    input: tuple[float, ...]
    output: tuple[float, ...]
    event: int
    command: tuple[int, ...]
    reset: bool
    location: int
    tracker: int
    entry_estimate: tuple[int, ...]
    signature: int
    status: int
    x: tuple[float, ...]


def record_vectors(
    tables: StepTables, *, seed: int, count: int, real: Literal["double", "float"] = "double", reset_every: int = 0
) -> tuple[Vector, ...]:
    """Return `count` random samples with the estimates of the reference step, from its start on.

    With `reset_every` = r > 0 the observer is reset before the samples r, 2 r, ...

    >>> from deshybrid.compiler import compile
    >>> from deshybrid.model.load import loads
    >>> turns = "[{from: off, to: on, event: press}, {from: on, to: off, event: release}]"
    >>> lamp = compile(loads(f"{{format: deshybrid/1, name: lamp, locations: [off, on], transitions: {turns}}}"))
    >>> len(record_vectors(lamp.observer.tables, seed=1, count=20))
    20
    """
    number = np.float32 if real == "float" else float
    constants = _converted(plain_tables(tables), number)
    sampler = _Sampler(tables, constants, random.Random(seed), number)
    state = reference.start(constants)
    vectors = []
    with np.errstate(all="ignore"):
        for index in range(count):
            reset = reset_every > 0 and index > 0 and index % reset_every == 0
            state = reference.start(constants) if reset else state
            given, measured, event, command = sampler.sample(index, state)
            state, estimate = reference.step(constants, state, given, measured, event, command=command)
            location, tracker, signature, status, x = estimate
            entered = constants["tracker"].entry_estimate(tracker)
            said = (location, tracker, entered, signature, status, _floats(x))
            vectors.append(Vector(_floats(given), _floats(measured), event, command, reset, *said))
    return tuple(vectors)


def _converted(value: Any, number: type) -> Any:
    """Return the tables with every float as a `number`; the tracker, a named tuple, has none."""
    if isinstance(value, float):
        return number(value)
    if isinstance(value, dict):
        return {key: _converted(entry, number) for key, entry in value.items()}
    return tuple(_converted(entry, number) for entry in value) if type(value) is tuple else value


def _floats(values: tuple[Any, ...]) -> tuple[float, ...]:
    return tuple(float(value) for value in values)


class _Sampler:
    """Draws samples beside the running reference, whose generator states it reads to please one generator at a time."""

    def __init__(self, tables: StepTables, constants: Any, source: random.Random, number: type) -> None:
        self._inputs, self._outputs = len(tables.input_names), len(tables.output_names)
        self._constants, self._source, self._number = constants, source, number
        self._events = len(tables.event_names)
        self._patience = (
            2 + max((*tables.generators.on_ticks, *tables.generators.off_ticks, 0)) + tables.window_ticks // 4
        )
        self._answers = [-np.linalg.pinv(matrix) for matrix in tables.generators.residual_output]  # to make r = 0
        self._pleased, self._left, self._event_chance = -1, 0, 0.0
        self._command = (0,) * len(tables.commands)

    def sample(self, index: int, state: reference.State) -> Sample:
        """Return (input, output, event and command codes) for sample `index`, the reference being in `state`."""
        if self._left == 0:
            self._pleased = self._below(len(self._constants["generators"]) + 1) - 1
            self._left = 1 + self._below(2 * self._patience)
            self._event_chance = (0.0, 0.03, 0.2)[self._below(3)]
        self._left -= 1
        given = tuple(self._number(2.0 * self._source.random() - 1.0) for _ in range(self._inputs))
        measured = tuple(self._number(value) for value in self._measured(given, state))
        return (*self._spoiled(given, measured), self._event(index, state), self._commanded())

    def _measured(self, given: tuple[Any, ...], state: reference.State) -> Iterator[Any]:
        if self._pleased < 0 or state.sample is None:
            return (20.0 * self._source.random() - 10.0 for _ in range(self._outputs))
        generator = self._constants["generators"][self._pleased]
        z = reference.advance(self._constants, state).z[self._pleased]
        silent = (self._number(0.0),) * self._outputs
        shown = reference.affine(generator["residual_rows"], generator["residual_offset"], z + given + silent)
        quiet = self._answers[self._pleased] @ np.array(shown, dtype=np.float64)
        return (float(value) * (1.0 + 1e-3 * (self._source.random() - 0.5)) for value in quiet)

    def _spoiled(self, given: tuple[Any, ...], measured: tuple[Any, ...]) -> tuple[tuple[Any, ...], tuple[Any, ...]]:
        """Now and then a number is NaN, infinite or too large."""
        if self._source.random() >= 0.03:
            return given, measured
        numbers = list(given + measured)
        if numbers:
            wrong = (float("nan"), float("inf"), float("-inf"), 1e31)[self._below(4)]
            numbers[self._below(len(numbers))] = self._number(wrong)
        return tuple(numbers[: self._inputs]), tuple(numbers[self._inputs :])

    def _commanded(self) -> tuple[int, ...]:
        """Commands stay for a while; now and then one is unknown, as 0 or by a code that is no value."""
        for place, count in enumerate(self._constants["commands"]):
            if self._source.random() < 1.0 / self._patience:
                code = self._below(count + 3) - 1
                self._command = (*self._command[:place], code, *self._command[place + 1 :])
        return self._command

    def _event(self, index: int, state: reference.State) -> int:
        """Mostly none or one that the tracker knows; sometimes any; seldom a code that is no event."""
        if index % (8 * self._patience) == 5 * self._patience:
            return (-1, self._events + 1, 2**31 - 1)[self._below(3)]
        if self._source.random() >= self._event_chance or self._events == 0:
            return 0
        tracker = self._constants["tracker"]
        known = [e + 1 for e in range(self._events) if tracker.after_event(state.tracker, e) >= 0]
        if known and self._source.random() < 0.9:
            return known[self._below(len(known))]
        return 1 + self._below(self._events)

    def _below(self, limit: int) -> int:
        return int(self._source.random() * limit)
