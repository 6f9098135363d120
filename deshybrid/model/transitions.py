"""The transitions of a system: events, outputs, guards, resets.

In: the decoded file, the channels and the commands.  Out: one `HybridTransition` for each row, in the order written;
DH0203 for a reset of the wrong shape, DH0207 for a location that no transition leaves.
"""

import numpy as np

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.linear.arrays import frozen_array
from deshybrid.model.channels import Channels
from deshybrid.model.commands import build_when
from deshybrid.model.fields import Field, Fields
from deshybrid.model.locations import location_bodies
from deshybrid.model.problems import Problems
from deshybrid.model.shapes import Expected, checked
from deshybrid.model.system import AffineReset, Command, HybridTransition


def build_transitions(
    model: Fields, channels: Channels, commands: tuple[Command, ...], problems: Problems
) -> tuple[HybridTransition, ...]:
    """Return the transitions; a model whose `transition_probability` replaces them may have none."""
    found = tuple(_transition(row, channels, commands, problems) for row in model.items("transitions"))
    if model.get("transitions") is not None or model.get("transition_probability") is None:
        _check_dead_ends(model, found, problems)
    return found


def _transition(row: Field, channels: Channels, commands: tuple[Command, ...], problems: Problems) -> HybridTransition:
    keys = row.fields
    emits = keys.get("emits")
    return HybridTransition(
        keys.text("from"),
        keys.text("event"),
        keys.text("to"),
        _outputs(emits),
        keys.predicate("guard"),
        _reset(keys, channels, problems),
        row.span,
        row.span if emits is None else emits.span,
        build_when(keys.get("when"), commands, problems),
    )


def _outputs(emits: Field | None) -> tuple[str | None, ...]:
    if emits is None:
        return (None,)
    return tuple(item.text for item in emits.items) or (emits.text,)


def _reset(keys: Fields, channels: Channels, problems: Problems) -> AffineReset | None:
    if not channels.states:
        return None
    size, state, written = len(channels.states), channels.state(), keys.fields("reset")
    where = f"the transition from `{keys.text('from')}` to `{keys.text('to')}`"
    matrix = checked(written.get("matrix"), Expected("reset", "matrix", where, state, state), problems)
    offset = checked(written.get("offset"), Expected("reset", "offset", where, state), problems)
    return AffineReset(
        frozen_array(np.eye(size), (size, size)) if matrix is None else matrix,
        frozen_array(np.zeros(size), (size,)) if offset is None else offset,
    )


def _check_dead_ends(model: Fields, transitions: tuple[HybridTransition, ...], problems: Problems) -> None:
    left = {transition.source for transition in transitions}
    bodies: list[tuple[str, Span]] = [(name, span) for name, (_, span) in location_bodies(model).items()]
    for name, span in bodies:
        if name not in left:
            text = f"location `{name}` is a dead end: no transition leaves it"
            helps = (f"write a transition with `from: {name}`; what may stay for ever has one that leads back to it",)
            problems.add(diagnostic("DH0207", text, span, helps=helps))


__all__ = ["build_transitions"]
