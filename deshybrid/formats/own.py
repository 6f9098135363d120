"""deshybrid's own files of an automaton: the JSON form of a document, and the model language.

The key `format` tells the two apart, whatever the suffix.  JSON (`format: deshybrid-des/1`) holds everything that a
`Document` has: `locations`, `initial`, `marked`, `events` with `controllable` and `observable`, and `transitions` with
`from`, `to`, `event`, `emits` (a list; null is ε) and, where there are any, `signature` and `commands` (a list: those
that permit it).  The model language holds the system alone; of a hybrid model the DES is taken.
Cost: linear.  Source: this project.
"""

import json
from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path

from deshybrid.des.automaton import DES, Transition
from deshybrid.diagnostics import FormatError, SourceText, diagnostic, raise_all
from deshybrid.formats.builder import Builder, Word, mistake
from deshybrid.formats.document import (
    Document,
    Event,
    Written,
    marking_losses,
    names_of,
    refuse_names,
    refuse_signatures,
)
from deshybrid.formats.reading import AUTOMATON, is_automaton
from deshybrid.model.abstraction import COMMAND, abstract
from deshybrid.model.elaborate import elaborate
from deshybrid.model.naming import LONGEST_NAME
from deshybrid.model.problems import did_you_mean
from deshybrid.model.source import parse_source
from deshybrid.model.tree import MappingNode, Node, ScalarNode, SequenceNode, form_of

_KEYS = ("format", "name", "locations", "initial", "marked", "events", "transitions")
_EVENT_KEYS = ("name", "controllable", "observable")
_TRANSITION_KEYS = ("from", "to", "event", "emits", "signature", "commands")


def read_own(source: SourceText) -> Document:
    """Return the document of our JSON, or the DES of a model file, with a warning (DH1016) where it has dynamics.

    Raises `FormatError`: DH1002 (not this form), DH1003 (unknown key), DH1005 to DH1008; `ModelError` where the text is
    neither YAML nor JSON, or a model contradicts itself.

    >>> text = '{"format": "deshybrid-des/1", "locations": ["1"], "initial": ["1"], "transitions": []}'
    >>> read_own(SourceText("a.json", text)).des.locations
    ('1',)
    >>> text = "{format: deshybrid/1, locations: [1], transitions: [{from: 1, to: 1, event: a}]}"
    >>> str(read_own(SourceText("a.yaml", text)).des.transitions[0])
    '1 -a/ε-> 1'
    """
    folder = None if source.name.startswith("<") else Path(source.name).parent
    model = parse_source(source.text, source.name, folder)
    if is_automaton(model.tree):
        return read_automaton(model.tree)
    system = elaborate(model)
    message = "the dynamics of the model are passed over; its discrete-event system is taken"
    warnings = (diagnostic("DH1016", message, severity="warning"),) if system.state_names else ()
    return Document(abstract(system), warnings=warnings)


def read_automaton(tree: MappingNode) -> Document:
    """Return the document of a parsed file of the JSON form; errors as in `read_own`."""
    builder = Builder(tree.span.source)
    _check_keys(tree, _KEYS, builder)
    given = _word(_value(tree, "format"))
    if given.text != AUTOMATON:
        raise mistake("DH1003", f"unknown format `{given.text[:40]}`", given.span, "", f"expected: `{AUTOMATON}`")
    for word in _words(tree, "locations"):
        builder.declare(word)
    builder.initial |= {word.text: word for word in _words(tree, "initial")}
    builder.marked |= {word.text: word for word in _words(tree, "marked")}
    for node in _nodes(tree, "events"):
        _read_event(_mapping(node), builder)
    arcs = tuple(_read_transition(_mapping(node), builder) for node in _nodes(tree, "transitions"))
    name = _word(_value(tree, "name")).text if tree.get("name") else ""
    document = builder.document(name)
    return replace(document, des=replace(document.des, transitions=arcs))


def _check_keys(node: MappingNode, known: tuple[str, ...], builder: Builder) -> None:
    for key, entry in node.entries.items():
        if key not in known:
            helps = did_you_mean(key, known)
            builder.report("DH1003", f"unknown key `{key[:40]}`", entry.key.span, "", *helps)


def _value(node: MappingNode, key: str) -> Node:
    found = node.get(key)
    if found is None:
        raise mistake("DH1002", f"the key `{key}` is missing", node.span)
    return found


def _word(node: Node) -> Word:
    if not isinstance(node, ScalarNode) or node.is_null:
        raise mistake("DH1002", "a name is expected", node.span, f"{form_of(node)} is here")
    return Word(node.text, node.span)


def _mapping(node: Node) -> MappingNode:
    if not isinstance(node, MappingNode):
        raise mistake("DH1002", "a mapping is expected", node.span, f"{form_of(node)} is here")
    return node


def _nodes(node: MappingNode, key: str) -> Iterable[Node]:
    found = node.get(key)
    if found is None:
        return ()
    if not isinstance(found, SequenceNode):
        raise mistake("DH1002", f"`{key}` is a list", found.span, f"{form_of(found)} is here")
    return found.items


def _words(node: MappingNode, key: str) -> Iterator[Word]:
    return (_word(item) for item in _nodes(node, key))


def _truth(node: MappingNode, key: str) -> bool:
    if node.get(key) is None:
        return True
    word = _word(_value(node, key))
    if word.text not in ("true", "false"):
        raise mistake("DH1002", f"`{key}` is true or false", word.span)
    return word.text == "true"


def _read_event(node: MappingNode, builder: Builder) -> None:
    _check_keys(node, _EVENT_KEYS, builder)
    name = _word(_value(node, "name"))
    builder.usable(name, "an event")
    builder.declare_event(name, _truth(node, "controllable"), _truth(node, "observable"))


def _read_transition(node: MappingNode, builder: Builder) -> Transition:
    _check_keys(node, _TRANSITION_KEYS, builder)
    source, event, target = (_word(_value(node, key)) for key in ("from", "event", "to"))
    emits = _value(node, "emits")
    items = emits.items if isinstance(emits, SequenceNode) else (emits,)
    outputs = tuple(None if isinstance(item, ScalarNode) and item.is_null else _word(item).text for item in items)
    if not outputs:
        builder.report("DH1002", "`emits` is empty", emits.span, "", "null is the silent output")
    for output in outputs:
        builder.arc(source, event, target, output)
    signature = _word(_value(node, "signature")).text if node.get("signature") else None
    commands = tuple(word.text for word in _words(node, "commands"))
    return Transition(source.text, event.text, target.text, outputs, signature, node.span, emits.span, commands)


def write_json(document: Document) -> Written:
    """Return a document as our JSON; raises `FormatError` (DH1012) for a name that no format holds.

    >>> from deshybrid.des.automaton import DES
    >>> write_json(Document(DES.from_transitions([("1", "a", "1", None)]))).text.splitlines()[1]
    '  "format": "deshybrid-des/1",'
    """
    des = document.des
    signatures = [t.signature for t in des.transitions if t.signature is not None]
    events = [event.name for event in document.events]
    refuse_names([des.name, *names_of(des), *signatures, *events], "json")
    lists = {"locations": des.locations, "initial": des.initial, "marked": document.marked}
    lines = ["{", f'  "format": {_text(AUTOMATON)},', f'  "name": {_text(des.name)},']
    lines += [f'  "{key}": {_text(list(names))},' for key, names in lists.items()]
    lines.append(f'  "events": {_rows(_event_record(event) for event in document.events)},')
    lines.append(f'  "transitions": {_rows(_transition_record(t) for t in des.transitions)}')
    return Written("\n".join([*lines, "}", ""]))


def _event_record(event: Event) -> dict[str, object]:
    return {"name": event.name, "controllable": event.controllable, "observable": event.observable}


def _transition_record(t: Transition) -> dict[str, object]:
    record: dict[str, object] = {"from": t.source, "to": t.target, "event": t.event, "emits": list(t.outputs)}
    record |= {} if t.signature is None else {"signature": t.signature}
    return record | ({"commands": list(t.commands)} if t.commands else {})


def _rows(records: Iterable[dict[str, object]]) -> str:
    rows = [f"    {_text(record)}" for record in records]
    return "[\n" + ",\n".join(rows) + "\n  ]" if rows else "[]"


def _text(value: object) -> str:
    return json.dumps(value, ensure_ascii=False)


def write_yaml(document: Document) -> Written:
    """Return a document as a model file without continuous state.

    Raises `FormatError`: DH1012 (a name longer than 100 characters, `|` in a location's), DH1013 (a signature, or a
    dead end: the model language asks for a living system).

    >>> from deshybrid.des.automaton import DES
    >>> write_yaml(Document(DES.from_transitions([("1", "a", "1", None)]))).text.splitlines()[-1]
    '  - {from: "1", to: "1", event: "a", emits: [null]}'
    """
    des = document.des
    refuse_signatures(des.transitions, "yaml")
    refuse_names([des.name, *names_of(des)], "yaml", _against)
    refuse_names(des.locations, "yaml", lambda name: "`|` separates locations in an estimate" if "|" in name else "")
    _refuse_dead_ends(des)
    lines = ["format: deshybrid/1", f"name: {_text(des.name)}"]
    lines += [f"{key}: {_text(list(names))}" for key, names in (("locations", des.locations), ("initial", des.initial))]
    commands = list(dict.fromkeys(value for t in des.transitions for value in t.commands))
    lines += [f"commands: {{{COMMAND}: {_text(commands)}}}"] if commands else []
    lines.append("transitions:" if des.transitions else "transitions: []")
    for t in des.transitions:
        ends = f"from: {_text(t.source)}, to: {_text(t.target)}, event: {_text(t.event)}"
        when = f", when: {{{COMMAND}: {_text(list(t.commands))}}}" if t.commands else ""
        lines.append(f"  - {{{ends}, emits: {_text(list(t.outputs))}{when}}}")
    return Written("\n".join([*lines, ""]), marking_losses(document, "yaml"))


def _refuse_dead_ends(des: DES) -> None:
    left = {t.source for t in des.transitions}
    helps = ("add a transition that leads back to it, for what may stay for ever; or write `json`",)
    message = "`yaml` cannot hold location `{}`: no transition leaves it"
    dead = (diagnostic("DH1013", message.format(name), helps=helps) for name in des.locations if name not in left)
    raise_all(dead, FormatError)


def _against(name: str) -> str:
    return f"it is longer than {LONGEST_NAME} characters" if len(name) > LONGEST_NAME else ""


__all__ = ["read_automaton", "read_own", "write_json", "write_yaml"]
