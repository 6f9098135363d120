"""Stage 1: from the source model to the hybrid system H.

In: a `SourceModel`.  Out: a `HybridSystem` whose numbers are checked and whose parts know their lines.  Three steps,
each reporting all its mistakes together: gather the names, decode the values, then fit shapes and sizes together.
Cost: linear in the file, apart from the eigenvalues of covariances.
"""

from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

from deshybrid.model.channels import build_bounds, build_channels
from deshybrid.model.commands import build_commands
from deshybrid.model.covariances import build_chain, build_prior
from deshybrid.model.decode import decode
from deshybrid.model.drives import build_simulation
from deshybrid.model.fields import Fields
from deshybrid.model.language import MODEL
from deshybrid.model.locations import build_locations
from deshybrid.model.problems import Problems
from deshybrid.model.scope import Scope, build_scope
from deshybrid.model.source import SourceModel
from deshybrid.model.system import HybridSystem
from deshybrid.model.tolerances import check_bounds, with_deviations
from deshybrid.model.transitions import build_transitions
from deshybrid.model.wishes import build_observer, build_signatures


def elaborate(source: SourceModel) -> HybridSystem:
    """Return the hybrid system of a model file.

    Raises `ModelError` with all mistakes found: DH0105, DH0111 to DH0126 (the file's keys and texts), then DH0201 to
    DH0222 (the model's meaning).

    >>> from deshybrid.model.source import parse_source
    >>> system = elaborate(parse_source('''{format: deshybrid/1, locations: [on, off], transitions: [
    ...     {from: on, to: off, event: stop, emits: down}, {from: off, to: on, event: start, emits: null}]}'''))
    >>> system.is_discrete, system.initial, system.transitions[1].outputs
    (True, ('on', 'off'), (None,))
    """
    problems = Problems()
    scope = build_scope(source, problems)
    model = decode(source.tree, MODEL, scope, problems).fields
    problems.raise_all()
    system = _system(model, scope, source, problems)
    problems.raise_all()
    system = _with_tolerance(system, model, source, problems)
    problems.raise_all()
    return system


def _system(model: Fields, scope: Scope, source: SourceModel, problems: Problems) -> HybridSystem:
    channels = build_channels(model, scope, problems)
    locations = build_locations(model, channels, problems)
    commands = build_commands(model, problems)
    transitions = build_transitions(model, channels, commands, problems)
    names = tuple(location.name for location in locations)
    initial = tuple(item.text for item in model.items("initial") if item.text is not None)
    return HybridSystem(
        model.text("name") or _file_name(source),
        locations,
        transitions,
        initial or names,
        channels.states,
        channels.inputs,
        channels.outputs,
        channels.disturbances,
        channels.units,
        model.fields("time").number("step"),
        build_bounds(model, channels, problems),
        build_signatures(model, transitions, problems),
        build_observer(model, channels, locations, problems),
        build_simulation(model, channels, commands, problems),
        build_chain(model, names, problems),
        build_prior(model, channels, names, problems),
        model.text("summary"),
        model.text("source"),
        source,
        commands,
    )


def _with_tolerance(system: HybridSystem, model: Fields, source: SourceModel, problems: Problems) -> HybridSystem:
    field = model.get("tolerance")
    if field is None:
        return system
    tolerance = {name: share.number or 0.0 for name, share in field.fields}
    check_bounds(field.span, system.bounds, system.input_names, problems)
    locations = with_deviations(system.locations, source.tree, tolerance, problems)
    return replace(system, locations=locations, tolerance=MappingProxyType(tolerance))


def _file_name(source: SourceModel) -> str:
    return "model" if source.folder is None else Path(source.text.name).stem


__all__ = ["elaborate"]
