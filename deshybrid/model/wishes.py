"""What a model file asks of its observer: signatures, gains or poles, the transition detector.

In: the decoded keys `signatures` and `observer`.  Out: `SignatureOptions`, `ObserverOptions`; DH0211 for poles that no
real matrix has, DH0218 for a forbidden pair without a transition, DH0219 for a location with poles and gains.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Literal, get_args

from deshybrid.diagnostics import diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.channels import Channels, per_channel
from deshybrid.model.covariances import covariance
from deshybrid.model.fields import Field, Fields
from deshybrid.model.problems import Problems
from deshybrid.model.shapes import Expected, checked, count
from deshybrid.model.system import (
    CoveringDetector,
    Decision,
    DetectorOptions,
    GeneratorDesign,
    HybridTransition,
    Location,
    ObserverOptions,
    SignatureCandidate,
    SignatureOptions,
)

_DECISIONS: Mapping[str | None, Decision] = {name: name for name in get_args(Decision)}
_DESIGNS: Mapping[str | None, GeneratorDesign] = {name: name for name in get_args(GeneratorDesign)}
_PAIRING = 1e-9  # poles written by expressions may differ from their conjugates by rounding


def build_signatures(model: Fields, transitions: tuple[HybridTransition, ...], problems: Problems) -> SignatureOptions:
    """Return what the file says of signatures; reports DH0218."""
    written = model.fields("signatures")
    arcs = {(transition.source, transition.target) for transition in transitions}
    pairs = []
    for row in written.items("forbid"):
        source, target = (item.text or "" for item in row.items)
        if (source, target) not in arcs:
            text = f"no transition leads from `{source}` to `{target}`"
            problems.add(diagnostic("DH0218", text, row.span, "nothing to forbid"))
        pairs.append((source, target))
    detectors = tuple(_detector_of_several(name, field) for name, field in written.fields("detectors"))
    if written.get("candidates") is None:
        return SignatureOptions(None, tuple(pairs), detectors)
    candidates = tuple(_candidate(name, field) for name, field in written.fields("candidates"))
    return SignatureOptions(candidates, tuple(pairs), detectors)


def _candidate(name: str, field: Field) -> SignatureCandidate:
    kinds: dict[str, Literal["residual", "negation"]] = {"residual": "residual", "negation": "negation"}
    cost = field.fields.number("cost")
    span = field.key.span if field.key is not None else field.span
    return SignatureCandidate(name, 1.0 if cost is None else cost, kinds.get(field.fields.text("by")), span)


def _detector_of_several(name: str, field: Field) -> CoveringDetector:
    cost, covers = field.fields.number("cost"), field.fields.get("covers")
    span = field.key.span if field.key is not None else field.span
    return CoveringDetector(name, () if covers is None else covers.names, 1.0 if cost is None else cost, span)


def build_observer(
    model: Fields, channels: Channels, locations: tuple[Location, ...], problems: Problems
) -> ObserverOptions:
    """Return what the file asks of the observer; reports DH0203, DH0210, DH0211, DH0214 and DH0219."""
    written = model.fields("observer")
    state = Expected("start", "initial_state", "the observer", channels.state())
    both = [name for name, _ in written.fields("gains") if written.fields("poles").get(name) is not None]
    for name in both:
        field = written.fields("poles").get(name)
        text, helps = f"location `{name}` has both poles and gains", ("gains are certified as given; leave one out",)
        problems.add(diagnostic("DH0219", text, field.span if field else None, helps=helps))
    return ObserverOptions(
        written.number("rate"),
        written.number("dwell"),
        written.number("step"),
        _poles(written.fields("poles"), len(channels.states), problems),
        _gains(written.fields("gains"), channels, locations, problems),
        _coordinates(written.fields("coordinates"), channels, problems),
        checked(written.get("initial_state"), state, problems),
        _detector(written.fields("detector"), channels, locations, problems),
    )


def _gains(
    written: Fields, channels: Channels, locations: tuple[Location, ...], problems: Problems
) -> Mapping[str, FloatArray]:
    gains = {}
    measured = {location.name: location.output_index for location in locations}
    for name, field in written:
        outputs = tuple(channels.outputs[i] for i in measured.get(name, ()))
        columns = channels.extent("output", outputs, "output", "output")
        expected = Expected("observer gain", name, "`gains`", channels.state(), columns)
        gain = checked(field, expected, problems)
        if gain is not None:
            gains[name] = gain
    return MappingProxyType(gains)


def _coordinates(written: Fields, channels: Channels, problems: Problems) -> Mapping[str, FloatArray]:
    found = {}
    for name, field in written:
        expected = Expected("coordinates", name, "`coordinates`", channels.state(), channels.state())
        rows = checked(field, expected, problems)
        if rows is not None:
            found[name] = rows
    return MappingProxyType(found)


def _detector(
    written: Fields, channels: Channels, locations: tuple[Location, ...], problems: Problems
) -> DetectorOptions:
    return DetectorOptions(
        _poles(written.fields("poles"), len(channels.states), problems),
        _thresholds(written.get("threshold"), channels, locations, problems),
        written.number("release"),
        written.number("debounce"),
        written.number("window"),
        _DECISIONS.get(written.text("decision")),
        _DESIGNS.get(written.text("design")),
        None if written.get("decouple") is None else tuple(item.text or "" for item in written.items("decouple")),
        per_channel(written.get("delay"), channels.outputs, "the delay", problems),
        written.number("false_alarm"),
        written.number("confidence"),
        _stays(written.fields("stay")),
        _entries(written.fields("entry"), channels, problems),
        written.number("entry_time"),
    )


def _stays(written: Fields) -> Mapping[str, float]:
    return MappingProxyType({name: field.number for name, field in written if field.number is not None})


def _entries(written: Fields, channels: Channels, problems: Problems) -> Mapping[str, FloatArray]:
    extent, found = channels.state(), {}
    for name, field in written:
        noise = covariance(field, f"noise after an entry into `{name}`", extent, problems)
        if noise is not None:
            found[name] = noise
    return MappingProxyType(found)


def _thresholds(
    field: Field | None, channels: Channels, locations: tuple[Location, ...], problems: Problems
) -> Mapping[str, FloatArray]:
    if field is None:
        return MappingProxyType({})
    levels = {}
    for location in locations:
        outputs = tuple(channels.outputs[i] for i in location.output_index)
        part = field if field.number is not None else field.fields.get(location.name)
        level = per_channel(part, outputs, "the threshold", problems)
        if level is not None:
            levels[location.name] = level
    return MappingProxyType(levels)


def _poles(written: Fields, size: int, problems: Problems) -> Mapping[str, tuple[complex, ...]]:
    found = {}
    for name, field in written:
        poles = [(item.value, item) for item in field.items if isinstance(item.value, complex)]
        if len(poles) != size:
            text = f"location `{name}` has {count(len(poles), 'pole')}, expected {size}"
            problems.add(diagnostic("DH0211", text, field.span, helps=("write one pole per state component",)))
        else:
            _check_conjugates(poles, problems)
        found[name] = tuple(pole for pole, _ in poles)
    return MappingProxyType(found)


def _check_conjugates(poles: list[tuple[complex, Field]], problems: Problems) -> None:
    alone: list[tuple[complex, Field]] = []
    for pole, item in poles:
        near = _PAIRING * max(1.0, abs(pole))
        if abs(pole.imag) <= near * 1e-3:
            continue
        partner = next((other for other in alone if abs(other[0].conjugate() - pole) <= near), None)
        if partner is None:
            alone.append((pole, item))
        else:
            alone.remove(partner)
    for pole, item in alone:
        text = "a complex pole has no conjugate beside it"
        helps = (f"write {pole.real:g}{-pole.imag:+g}j too: a real matrix has both",)
        problems.add(diagnostic("DH0211", text, item.span, helps=helps))


__all__ = ["build_observer", "build_signatures"]
