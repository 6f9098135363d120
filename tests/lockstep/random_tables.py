"""Random `StepTables` of every small size, zero included: what no model made, but every emitter must print."""

import random

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.observer.tables import Candidate, FlowTables, GeneratorTables, StepTables, TrackerState


def random_tables(seed: int) -> StepTables:
    """Return tables with up to four states, two inputs, three outputs, six locations, three generators.

    Residual generators need an output, and a state or an input; without them there are none.
    """
    draw = random.Random(seed)
    n, m, p = draw.randrange(5), draw.randrange(3), draw.randrange(4)
    locations, events, resets = 1 + draw.randrange(6), draw.randrange(4), draw.randrange(3)
    generators = draw.randrange(4) if p > 0 and n + m > 0 else 0
    states = 1 + draw.randrange(8)

    def numbers(*shape: int) -> FloatArray:
        scale = draw.choice((0.1, 0.4, 1.3))
        return np.array([scale * draw.gauss(0.0, 1.0) for _ in range(int(np.prod(shape)))]).reshape(shape)

    return StepTables(
        name=f"random {seed}",
        step=0.01,
        location_names=_names("location", locations),
        state_names=_names("x", n),
        input_names=_names("u", m),
        output_names=_names("y", p),
        event_names=_names("event", events),
        signature_names=_names("s", locations),
        flow=FlowTables(
            matrix=numbers(locations, n, n),
            input=numbers(locations, n, m),
            output=numbers(locations, n, p),
            offset=numbers(locations, n),
            start=numbers(n),
            defined=tuple(draw.random() < 0.8 for _ in range(locations)),
        ),
        generators=GeneratorTables(
            locations=tuple(draw.randrange(locations) for _ in range(generators)),
            matrix=numbers(generators, n, n),
            input=numbers(generators, n, m),
            output=numbers(generators, n, p),
            offset=numbers(generators, n),
            start=numbers(generators, n, p),
            start_offset=numbers(generators, n),
            residual_state=numbers(generators, p, n),
            residual_input=numbers(generators, p, m),
            residual_offset=numbers(generators, p),
            weight=np.abs(numbers(generators, p)),
            release=1.0 + np.abs(numbers(generators)),
            on_ticks=tuple(1 + draw.randrange(4) for _ in range(generators)),
            off_ticks=tuple(1 + draw.randrange(4) for _ in range(generators)),
        ),
        tracker=tuple(_state(draw, locations, events, generators, states) for _ in range(states)),
        initial=draw.randrange(states),
        restart=draw.randrange(states),
        restart_on_event=tuple(draw.randrange(states) for _ in range(events)),
        window_ticks=1 + draw.randrange(9),
        reset_index=tuple(tuple(draw.randrange(-1, resets) for _ in range(locations)) for _ in range(locations)),
        reset_matrix=numbers(resets, n, n),
        reset_offset=numbers(resets, n),
    )


def _names(kind: str, count: int) -> tuple[str, ...]:
    return tuple(f"{kind} {number}" for number in range(count))


def _state(draw: random.Random, locations: int, events: int, generators: int, states: int) -> TrackerState:
    entry = tuple(sorted(draw.sample(range(locations), 1 + draw.randrange(locations))))
    candidates = tuple(
        Candidate(
            signature=draw.randrange(locations),
            active=draw.randrange(-1, generators),
            quiet=tuple(g for g in range(generators) if draw.random() < 0.3),
            target=draw.randrange(states),
        )
        for _ in range(draw.randrange(4))
    )
    return TrackerState(
        entry_estimate=entry,
        location=entry[0] if len(entry) == 1 else -1,
        provisional=draw.random() < 0.3,
        on_event=tuple(draw.randrange(-1, states) for _ in range(events)),
        candidates=candidates,
        timeout_target=draw.randrange(-2, states),
    )
