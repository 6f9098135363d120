"""How a model file wants to be simulated: signals, requests, sensors, and what campaigns compare with.

In: the decoded key `simulation`.  Out: `SimulationOptions`; DH0217 where times do not increase, DH0201 for a value that
a command does not have.
"""

from collections.abc import Mapping
from itertools import pairwise
from types import MappingProxyType

from deshybrid.diagnostics import diagnostic
from deshybrid.model.channels import Channels
from deshybrid.model.commands import check_value
from deshybrid.model.fields import Field, Fields
from deshybrid.model.problems import Problems
from deshybrid.model.shapes import Expected, checked
from deshybrid.model.system import (
    Command,
    MeasurementModel,
    RatioComparison,
    SignalModel,
    SimulationOptions,
    Variation,
)


def build_simulation(
    model: Fields, channels: Channels, commands: tuple[Command, ...], problems: Problems
) -> SimulationOptions:
    """Return the options of `simulate`; reports DH0201, DH0203 and DH0217."""
    written = model.fields("simulation")
    expected = Expected("start", "state", "the simulation", channels.state())
    return SimulationOptions(
        written.number("duration"),
        written.text("location") or None,
        checked(written.get("state"), expected, problems),
        _requests(written, problems),
        _signals(written.fields("input"), problems),
        _signals(written.fields("unmeasured"), problems),
        _signals(written.fields("disturbance"), problems),
        MappingProxyType({name: _sensor(field.fields) for name, field in written.fields("measurement")}),
        _variation(written.fields("variation")),
        _comparison(written.get("comparison")),
        _commands(written.fields("commands"), commands, problems),
    )


def _commands(
    written: Fields, commands: tuple[Command, ...], problems: Problems
) -> Mapping[str, tuple[tuple[float, str], ...]]:
    known = {command.name: command for command in commands}
    held = {}
    for name, field in written:
        _check_times(field.items, problems, strictly=True)
        points = [(row.items[0].number or 0.0, row.items[1]) for row in field.items] or [(0.0, field)]
        for _, value in points:
            if name in known and value.text is not None:
                check_value(value.text, value, known[name], problems)
        held[name] = tuple((time, value.text or "") for time, value in points)
    return MappingProxyType(held)


def _requests(written: Fields, problems: Problems) -> tuple[tuple[float, str], ...]:
    rows = written.items("requests")
    _check_times(rows, problems, strictly=False)
    return tuple((row.items[0].number or 0.0, row.items[1].text or "") for row in rows)


def _check_times(rows: tuple[Field, ...], problems: Problems, *, strictly: bool) -> None:
    times = [row.items[0] for row in rows]
    for before, after in pairwise(times):
        first, second = before.number or 0.0, after.number or 0.0
        if second < first or (strictly and second == first):
            context = ((before.span, f"{first:g} s"),)
            problems.add(diagnostic("DH0217", "times do not increase", after.span, f"{second:g} s", context=context))


def _signals(written: Fields, problems: Problems) -> Mapping[str, SignalModel]:
    return MappingProxyType({name: _signal(field, problems) for name, field in written})


def _signal(field: Field, problems: Problems) -> SignalModel:
    if field.number is not None:
        return SignalModel(((0.0, field.number),))
    keys = field.fields
    rows = keys.items("points")
    _check_times(rows, problems, strictly=True)
    hold, period = keys.get("hold"), keys.number("period")
    return SignalModel(
        tuple((row.items[0].number or 0.0, row.items[1].number or 0.0) for row in rows),
        hold is None or bool(hold.value),
        keys.number("amplitude") or 0.0,
        keys.number("frequency") or 0.0,
        keys.number("random") or 0.0,
        1.0 if period is None else period,
    )


def _variation(keys: Fields) -> Variation:
    return Variation(*(keys.number(name) or 0.0 for name in ("requests", "input", "disturbance", "state", "pace")))


def _comparison(written: Field | None) -> RatioComparison | None:
    if written is None:
        return None
    keys = written.fields
    return RatioComparison(
        keys.text("numerator"),
        keys.text("denominator"),
        MappingProxyType({name: field.number or 0.0 for name, field in keys.fields("ratio")}),
        keys.text("otherwise") or None,
        keys.number("band") or 0.0,
        keys.number("debounce") or 0.0,
        keys.number("slowest") or 0.0,
    )


def _sensor(keys: Fields) -> MeasurementModel:
    names = ("lag", "delay", "period", "bias", "noise", "quantum")
    return MeasurementModel(*(keys.number(name) or 0.0 for name in names))


__all__ = ["build_simulation"]
