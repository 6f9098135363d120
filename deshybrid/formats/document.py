"""What a file of another tool holds: a discrete-event system, its marked locations, and attributes of its events.

A `DES` knows nothing of marking or control; a `Document` keeps them beside it, so that reading and writing the same
format loses nothing.  A file with observable and unobservable events becomes a system whose observable events show
their own name and whose unobservable events show nothing.

Writing into a format that cannot hold something either warns (DH1014: marking, control, names of events that show
another name) or, where the behaviour itself would change, is refused (DH1012, DH1013).  Cost: linear.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from deshybrid.des.automaton import DES, Transition
from deshybrid.diagnostics import Diagnostic, FormatError, diagnostic
from deshybrid.model.problems import Problems

EPSILON = "ε"
LONGEST_NAME = 1000


@dataclass(frozen=True, slots=True)
class Event:
    """An event of the alphabet: may a supervisor disable it, does an observer see it?"""

    name: str
    controllable: bool = True
    observable: bool = True


@dataclass(frozen=True, slots=True)
class Document:
    """A system with what its file says beyond it; `events` may be empty, then the transitions name them all.

    `warnings` (DH1016) name what the reader passed over.

    >>> Document(DES.from_transitions([("1", "a", "2", "α")]), marked=("2",)).des.locations
    ('1', '2')
    """

    des: DES
    marked: tuple[str, ...] = ()
    events: tuple[Event, ...] = ()
    warnings: tuple[Diagnostic, ...] = field(default=(), compare=False)

    def with_silent(self, names: Iterable[str]) -> "Document":
        """Return the same document, in which the outputs `names` mean ε.

        Raises `FormatError` (DH1005) where no transition shows such an output.

        >>> document = Document(DES.from_transitions([("1", "a", "2", "quiet"), ("2", "b", "1", "α")]))
        >>> document.with_silent(["quiet"]).des.transitions[0].outputs
        (None,)
        """
        silent = tuple(names)
        shown = {output for t in self.des.transitions for output in t.outputs}
        missing = [name for name in silent if name not in shown]
        if missing:
            raise FormatError(*(diagnostic("DH1005", f"no transition shows the output `{name}`") for name in missing))
        arcs = tuple(
            replace(t, outputs=tuple(dict.fromkeys(None if o in silent else o for o in t.outputs)))
            for t in self.des.transitions
        )
        events = tuple(replace(event, observable=False) if event.name in silent else event for event in self.events)
        return replace(self, des=replace(self.des, transitions=arcs), events=events)


@dataclass(frozen=True, slots=True)
class Written:
    """The text of a file, and warnings (DH1014) about what the format cannot hold."""

    text: str
    warnings: tuple[Diagnostic, ...] = ()


class Arc(NamedTuple):
    """One arc of a format that knows only labels: `label` is what is seen, or the event where nothing is seen."""

    source: str
    label: str
    target: str
    visible: bool


class Labelled(NamedTuple):
    """A document as labels: arcs, the alphabet of their labels, and what was lost on the way."""

    arcs: tuple[Arc, ...]
    events: tuple[Event, ...]
    warnings: tuple[Diagnostic, ...]


def labelled(document: Document, format_name: str) -> Labelled:
    """Return the document for a format whose transitions carry one label that is observable or not.

    A visible transition is labelled by its output, since that is what an observer sees; a silent one by its event.
    Raises `FormatError` (DH1013) where a label would be both visible and silent.

    >>> des = DES.from_transitions([("1", "a", "2", "a"), ("2", "b", "1", None)])
    >>> [arc.label for arc in labelled(Document(des), "fsm").arcs]
    ['a', 'b']
    """
    arcs = tuple(
        Arc(t.source, t.event if output is None else output, t.target, output is not None)
        for t in document.des.transitions
        for output in t.outputs
    )
    visible = {arc.label for arc in arcs if arc.visible}
    both = dict.fromkeys(arc.label for arc in arcs if not arc.visible and arc.label in visible)
    if both:
        message = "the silent event `{}` has the name of a visible output, and `{}` writes one label for both"
        raise FormatError(*(diagnostic("DH1013", message.format(name, format_name)) for name in both))
    lost = sum(any(output not in (None, t.event) for output in t.outputs) for t in document.des.transitions)
    what = f"the events of {lost} transition{'s' * (lost > 1)} that show another name; their outputs are written"
    return Labelled(arcs, _alphabet(document, arcs), losses(format_name, {what: bool(lost)}))


def _alphabet(document: Document, arcs: Iterable[Arc]) -> tuple[Event, ...]:
    """The declared events that are labels or on no transition, then the other labels in order of first mention."""
    shown = {arc.label: arc.visible for arc in arcs}
    used = {t.event for t in document.des.transitions} - set(shown)
    declared = {event.name: event for event in document.events if event.name not in used}
    names = dict.fromkeys([*declared, *shown])
    plain = {name: declared.get(name, Event(name)) for name in names}
    return tuple(replace(event, observable=shown.get(name, event.observable)) for name, event in plain.items())


def losses(format_name: str, lost: dict[str, bool]) -> tuple[Diagnostic, ...]:
    """Return one warning (DH1014) for everything that a format cannot hold and the document has.

    >>> losses("fsm", {"the name of the system": False})
    ()
    """
    return tuple(
        diagnostic("DH1014", f"`{format_name}` cannot hold {what}", severity="warning") for what in lost if lost[what]
    )


def marking_losses(document: Document, format_name: str) -> tuple[Diagnostic, ...]:
    """Return the warnings of a format that holds neither marked locations nor attributes of events."""
    return losses(format_name, {"marked locations": bool(document.marked)}) + control_losses(document, format_name)


def control_losses(document: Document, format_name: str) -> tuple[Diagnostic, ...]:
    """Return the warnings of a format that holds no alphabet: controllability, and events on no transition."""
    used = {t.event for t in document.des.transitions}
    return losses(
        format_name,
        {
            "which events are uncontrollable": any(not event.controllable for event in document.events),
            "events that are on no transition": any(event.name not in used for event in document.events),
        },
    )


def reason_against(name: str) -> str:
    """Return why a text cannot be a name in any format, or nothing.

    >>> reason_against("a b"), reason_against(" a")
    ('', 'it begins or ends with a space')
    """
    if not name:
        return "it is empty"
    if name != name.strip():
        return "it begins or ends with a space"
    if not name.isprintable():
        return "it holds a character that cannot be printed"
    return f"it is longer than {LONGEST_NAME} characters" if len(name) > LONGEST_NAME else ""


def refuse_names(names: Iterable[str], format_name: str, against: Callable[[str], str] = reason_against) -> None:
    """Raise `FormatError` (DH1012) with all names that a format cannot hold; `against` is the format's own reason.

    >>> refuse_names(["a", "b"], "fsm", lambda name: "it holds a space" if " " in name else "")
    """
    problems = Problems()
    for name in dict.fromkeys(names):
        reason = reason_against(name) or against(name)
        if reason:
            message = f"`{format_name}` cannot hold the name `{name[:100]}`: {reason}"
            problems.add(diagnostic("DH1012", message, helps=("rename it, or choose another format",)))
    problems.raise_all(FormatError)


def names_of(des: DES) -> tuple[str, ...]:
    """Return the names of locations, events and outputs, each once, in order of declaration.

    >>> names_of(DES.from_transitions([("1", "a", "2", "α")]))
    ('1', '2', 'a', 'α')
    """
    labels = (name for t in des.transitions for name in (t.event, *t.outputs) if name is not None)
    return tuple(dict.fromkeys([*des.locations, *labels]))


def refuse_signatures(transitions: Iterable[Transition], format_name: str) -> None:
    """Raise `FormatError` (DH1013) where a transition carries a signature, which only our own JSON can hold."""
    signed = next((t for t in transitions if t.signature is not None), None)
    if signed is not None:
        message = f"`{format_name}` cannot hold the signature of `{signed}`"
        raise FormatError(diagnostic("DH1013", message, helps=("write `.json`, which can",)))


def refuse_labels(transitions: Iterable[Transition], format_name: str) -> None:
    """Raise `FormatError` (DH1013) where a transition has what only our own formats can hold: signature or commands."""
    arcs = tuple(transitions)
    refuse_signatures(arcs, format_name)
    commanded = next((t for t in arcs if t.commands), None)
    if commanded is not None:
        message = f"`{format_name}` cannot hold the commands on which `{commanded}` depends"
        raise FormatError(diagnostic("DH1013", message, helps=("write `.json` or `.yaml`, which can",)))


def single_initial(des: DES, format_name: str) -> str:
    """Return the initial location, for a format that holds exactly one; else raise `FormatError` (DH1013).

    >>> single_initial(DES(("1", "2"), (), ("2",)), "fsm")
    '2'
    """
    if len(des.initial) != 1:
        message = f"`{format_name}` holds one initial location, and {len(des.initial)} are possible here"
        raise FormatError(
            diagnostic("DH1013", message, helps=("write gen, dot, graphml, json or yaml, which hold several",))
        )
    return des.initial[0]


__all__ = [
    "EPSILON",
    "Arc",
    "Document",
    "Event",
    "Labelled",
    "Written",
    "control_losses",
    "labelled",
    "losses",
    "marking_losses",
    "names_of",
    "reason_against",
    "refuse_labels",
    "refuse_names",
    "refuse_signatures",
    "single_initial",
]
