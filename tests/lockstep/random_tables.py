"""Random `StepTables` of every small size, zero included: what no model made, but every emitter must print."""

import random
from dataclasses import replace
from typing import Any

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.abstraction import discrete_model
from deshybrid.model.system import Decision
from deshybrid.observer.hybrid import command_needs
from deshybrid.observer.tables import (
    BankTables,
    Candidate,
    DecisionTables,
    FlowTables,
    GeneratorTables,
    StepTables,
    TrackerState,
)
from deshybrid.observer.tracker import choose_tracker
from tests.strategies import random_plan


def random_tables(seed: int) -> StepTables:
    """Return tables with up to four states, two inputs, three outputs, six locations, three generators.

    Residual generators need an output; without one there are none.
    """
    draw = random.Random(seed)
    n, m, p = draw.randrange(5), draw.randrange(3), draw.randrange(4)
    locations, events, resets = 1 + draw.randrange(6), draw.randrange(4), draw.randrange(3)
    generators = draw.randrange(4) if p > 0 else 0
    states = 1 + draw.randrange(8)
    numbers = _numbers(draw, (n, m, p), locations, tuple(draw.randrange(locations) for _ in range(generators)), resets)
    return StepTables(
        name=f"random {seed}",
        event_names=_names("event", events),
        signature_names=_names("s", locations),
        tracker=tuple(_state(draw, locations, events, generators, states) for _ in range(states)),
        initial=draw.randrange(states),
        restart=draw.randrange(states),
        restart_on_event=tuple(draw.randrange(states) for _ in range(events)),
        **numbers,
    )


def tables_of_plan(
    seed: int, *, as_events: bool, max_states: int, locations: int = 5, commands: bool = False
) -> StepTables:
    """Return random numbers around the tracker of a random plan: a table up to `max_states`, else on line."""
    draw = random.Random(seed)
    plan = random_plan(draw, negations=True, locations=locations, commands=commands)
    des = plan.des
    guaranteed = frozenset(name for name in des.locations if draw.random() < 0.5)
    system = discrete_model(des)
    made = choose_tracker(
        plan,
        signatures_are_events=as_events,
        guaranteed=guaranteed,
        needs=command_needs(system),
        max_states=max_states,
    )
    sizes = (0, 0, 0) if as_events else (1 + draw.randrange(3), draw.randrange(3), 1 + draw.randrange(2))
    owners = () if as_events else tuple(des.locations.index(name) for name in plan.generators)
    numbers = _numbers(draw, sizes, len(des.locations), owners, 0 if as_events else draw.randrange(3))
    return StepTables(
        name=f"plan {seed}",
        event_names=made.event_names,
        signature_names=made.signature_names,
        tracker=made.states,
        initial=made.initial,
        restart=made.restart,
        restart_on_event=made.restart_on_event,
        online=made.online,
        commands=tuple((command.name, command.values) for command in system.commands),
        command_slack=int(not as_events),
        **numbers,
    )


def with_decision(tables: StepTables, kind: Decision, seed: int) -> StepTables:
    """Return the same tables with another decision, of random numbers; as they are without residual generators."""
    count, p, draw = len(tables.generators.locations), len(tables.output_names), random.Random(seed)
    if not count:
        return tables
    whitening = np.array([draw.gauss(0.0, 0.5) for _ in range(count * p * p)]).reshape((count, p, p))
    levels = [[0.5, 0.4 * draw.random() * p, -1.0 - draw.random(), 2.0 + draw.random()] for _ in range(count)]
    decision = DecisionTables(
        kind=kind,
        exclude_ticks=1 + draw.randrange(tables.window_ticks),
        patience_ticks=tables.window_ticks + 1,
        whitening=whitening,
        test=np.array(levels),
        limits=np.array([2.0 * (n + 1) * (0.5 + draw.random()) for n in range(1 + draw.randrange(4))]),
        bank=_bank(draw, tables) if kind == "imm" else None,
    )
    return replace(tables, decision=decision)


def _bank(draw: random.Random, tables: StepTables) -> BankTables:
    """Interacting filters that change their minds; of three or more the last is the first location's second."""
    count = len(tables.generators.locations)
    chain = np.array([[draw.random() ** 3 + 4.0 * (i == j) for i in range(count)] for j in range(count)])
    owner = (*range(count - 1), 0 if count > 2 else count - 1)
    share = np.array([0.5 + 0.5 * draw.random() for _ in range(count)])
    return BankTables(owner, chain / chain.sum(axis=0), share, 2 + draw.randrange(3), 4.0, 0.6)


def _numbers(
    draw: random.Random, sizes: tuple[int, int, int], locations: int, owners: tuple[int, ...], resets: int
) -> dict[str, Any]:
    """Everything in `StepTables` that is not of the tracker; `owners` are the locations that have a generator."""
    (n, m, p), generators = sizes, len(owners)
    k = draw.randrange(n + 3)

    def numbers(*shape: int) -> FloatArray:
        scale = draw.choice((0.1, 0.4, 1.3))
        return np.array([scale * draw.gauss(0.0, 1.0) for _ in range(int(np.prod(shape)))]).reshape(shape)

    return {
        "step": 0.01,
        "location_names": _names("location", locations),
        "state_names": _names("x", n),
        "input_names": _names("u", m),
        "output_names": _names("y", p),
        "flow": FlowTables(
            matrix=numbers(locations, n, n),
            input=numbers(locations, n, m),
            output=numbers(locations, n, p),
            offset=numbers(locations, n),
            start=numbers(n),
            defined=tuple(draw.random() < 0.8 for _ in range(locations)),
        ),
        "generators": GeneratorTables(
            locations=owners,
            matrix=numbers(generators, k, k),
            input=numbers(generators, k, m),
            output=numbers(generators, k, p),
            offset=numbers(generators, k),
            start=numbers(generators, k, p),
            start_offset=numbers(generators, k),
            residual_state=numbers(generators, p, k),
            residual_input=numbers(generators, p, m),
            residual_output=numbers(generators, p, p),
            residual_offset=numbers(generators, p),
            weight=np.abs(numbers(generators, p)),
            release=1.0 + np.abs(numbers(generators)),
            on_ticks=tuple(1 + draw.randrange(4) for _ in range(generators)),
            off_ticks=tuple(1 + draw.randrange(4) for _ in range(generators)),
        ),
        "window_ticks": 1 + draw.randrange(9),
        "reset_index": _reset_index(draw, locations, resets),
        "reset_matrix": numbers(resets, n, n),
        "reset_offset": numbers(resets, n),
    }


def _reset_index(draw: random.Random, locations: int, resets: int) -> tuple[tuple[int, ...], ...]:
    if not resets:
        return ()
    return tuple(tuple(draw.randrange(-1, resets) for _ in range(locations)) for _ in range(locations))


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
