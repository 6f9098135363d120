"""Stage 1a: check a tree against the description of the language, and take the values out of it.

In: a node, its `Kind`, the scope.  Out: a `Field` with values instead of texts.  Unknown and missing keys, wrong forms,
unknown names, numbers out of range and texts that are no expression are reported, all of them; a value that could not
be read is None.  Cost: one pass over the tree.
"""

from typing import Any

import numpy as np

from deshybrid.diagnostics import ModelError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.attachments import read_array
from deshybrid.model.fields import Field, Fields, Value
from deshybrid.model.kinds import (
    ByForm,
    Condition,
    Definitions,
    Flag,
    Key,
    Kind,
    ListOf,
    MapOf,
    Matrix,
    Name,
    Number,
    Pole,
    Record,
    Row,
    Text,
    Vector,
    Word,
)
from deshybrid.model.language import REFERENCE
from deshybrid.model.naming import check_declared, check_known
from deshybrid.model.problems import MOST_MESSAGES, Problems, did_you_mean, nearest
from deshybrid.model.scalars import condition_of, number_of, odd_size, pole_of
from deshybrid.model.scope import Scope
from deshybrid.model.shapes import count
from deshybrid.model.tree import MappingNode, Node, ScalarNode, SequenceNode, form_of


def decode(node: Node, kind: Kind, scope: Scope, problems: Problems) -> Field:
    """Return the field of a node of that kind.

    Reports DH0105, DH0111 to DH0118, DH0121 to DH0126, DH0201, DH0202, DH0204 and DH0206.

    >>> from deshybrid.model.scope import build_scope
    >>> from deshybrid.model.source import parse_source
    >>> source = parse_source("{parameters: {k: 2}, state: [h], defaults: {A: [[-k]]}}")
    >>> problems = Problems()
    >>> from deshybrid.model.language import LOCATION
    >>> decode(source.tree.get("defaults"), LOCATION, build_scope(source, problems), problems).fields.get("A").array
    array([[-2.]])
    """
    return _Decoder(scope, problems).field(node, kind, "the file")


def describe(kind: Kind) -> str:
    """Return what a kind is written as, in the words of a message.

    >>> describe(ByForm(scalar=Word(("continuous",)), mapping=Record("", ())))
    '`continuous` or a mapping'
    """
    match kind:
        case ByForm():
            forms = [describe(form) for form in (kind.scalar, kind.sequence, kind.mapping) if form is not None]
            return " or ".join([*forms, *(["null"] if kind.null else [])])
        case Word():
            return " or ".join(f"`{choice}`" for choice in kind.choices)
        case ListOf():
            return "a list"
        case Row():
            return "a list of " + " and ".join(describe(item) for item in kind.items)
        case _:
            return _WORDS[type(kind)]


_WORDS: dict[type[Any], str] = {
    Text: "a text",
    Flag: "`true` or `false`",
    Name: "a name",
    Number: "a number or an expression",
    Pole: "a number such as `-3` or `-3+2j`",
    Vector: "a list of numbers",
    Matrix: "a list of rows",
    Condition: 'a condition such as `"h1 >= 0"`',
    Definitions: "a mapping from names to numbers",
    MapOf: "a mapping",
    Record: "a mapping",
}


_UNREADABLE: Value = None


class _Decoder:
    """One method for each kind; `what` is the key the value stands under, for the messages."""

    def __init__(self, scope: Scope, problems: Problems) -> None:
        self._scope = scope
        self._problems = problems

    def field(self, node: Node, kind: Kind, what: str, key: ScalarNode | None = None) -> Field:
        """Return the decoded node."""
        match node:
            case ScalarNode():
                value = self._scalar(node, kind, what)
            case SequenceNode():
                value = self._sequence(node, kind, what)
            case MappingNode():
                value = self._mapping(node, kind, what)
        return Field(value, node, key)

    def _scalar(self, node: ScalarNode, kind: Kind, what: str) -> Value:
        if node.is_null:
            nullable = isinstance(kind, ByForm) and kind.null
            return None if nullable else self._wrong(node, kind, what)
        match kind:
            case ByForm(scalar=form) if form is not None:
                return self._scalar(node, form, what)
            case Text():
                return node.text.strip()
            case Name():
                return self._name(node, kind)
            case Number():
                return self._number(node, kind, what)
            case Word():
                return self._word(node, kind, what)
            case Flag():
                return self._flag(node, what)
            case Pole():
                return pole_of(node, self._scope.parameters, self._problems)
            case Condition():
                names = self._scope.names
                return condition_of(node, self._scope.parameters, names["state"], names["input"], self._problems)
            case _:
                return self._wrong(node, kind, what)

    def _sequence(self, node: SequenceNode, kind: Kind, what: str) -> Value:
        match kind:
            case ByForm(sequence=form) if form is not None:
                return self._sequence(node, form, what)
            case ListOf():
                return self._list(node, kind, what)
            case Row():
                if len(node.items) != len(kind.items):
                    return self._wrong(node, kind, what, f"{len(node.items)} values are here")
                return tuple(self.field(*pair, what) for pair in zip(node.items, kind.items, strict=True))
            case Vector():
                numbers = self._numbers(node, what)
                return None if numbers is None else frozen_array(numbers, (len(numbers),))
            case Matrix():
                return self._matrix(node, what)
            case _:
                return self._wrong(node, kind, what)

    def _mapping(self, node: MappingNode, kind: Kind, what: str) -> Value:
        match kind:
            case ByForm(mapping=form) if form is not None:
                return self._mapping(node, form, what)
            case Record():
                return self._record(node, kind, what)
            case MapOf():
                return self._map(node, kind, what)
            case Definitions():
                return Fields({})  # the scope has read them
            case Vector() | Matrix():
                return self._attached(node, 1 if isinstance(kind, Vector) else 2)
            case _:
                return self._wrong(node, kind, what)

    def _wrong(self, node: Node, kind: Kind, what: str, found: str = "") -> Value:
        expected = f"expected {describe(kind)}"
        message = f"`{what}` is {form_of(node)}" if not found else f"`{what}` does not have the right length"
        self._problems.add(diagnostic("DH0113", message, node.span, expected, notes=(found,) if found else ()))
        return _UNREADABLE

    def _record(self, node: MappingNode, record: Record, what: str) -> Fields:
        keys = {key.name: key for key in record.keys}
        fields, meant = {}, set[str]()
        for name, entry in node.entries.items():
            if name not in keys:
                meant.add(self._unknown_key(entry.key, keys))
            elif keys[name].needs_state and not self._scope.has_state:
                helps = ("declare the states, `state: [x1, x2]`, or leave this out",)
                message = f"`{name}` needs a continuous state, and the model has none"
                self._problems.add(diagnostic("DH0206", message, entry.key.span, helps=helps))
            else:
                fields[name] = self.field(entry.value, keys[name].kind, name, entry.key)
        for key in record.keys:
            if key.required and key.name not in node.entries and key.name not in meant:
                self._missing_key(node, key, what)
        return Fields(fields)

    def _unknown_key(self, key: ScalarNode, known: dict[str, Key]) -> str:
        """Report the key; return the one that was probably meant, which is then not reported as missing."""
        meant, helps = "", tuple[str, ...]()
        if len(self._problems.found) < MOST_MESSAGES:  # what will not be listed is not compared
            meant, helps = nearest(key.text, known), did_you_mean(key.text, known)
        if ":" in key.text and key.plain and key.text.partition(":")[0] in known:
            meant, helps = key.text.partition(":")[0], ("write a space after the colon",)
        self._problems.add(diagnostic("DH0111", f"unknown key `{key.text}`", key.span, helps=helps))
        return meant

    def _missing_key(self, node: MappingNode, key: Key, what: str) -> None:
        shown = "the file" if what == "the file" else f"`{what}`"
        label = f"`{key.name}` is missing here"
        helps = (f"`{key.name}` is {describe(key.kind)}: {key.about}",)
        self._problems.add(diagnostic("DH0112", f"{shown} has no key `{key.name}`", node.span, label, helps=helps))

    def _map(self, node: MappingNode, kind: MapOf, what: str) -> Fields:
        self._check_length(node, len(node.entries), kind.least, what)
        fields = {}
        for name, entry in node.entries.items():
            if kind.declares:
                check_declared(entry.key, kind.role, self._problems)
            else:
                check_known(entry.key, kind.role, self._scope.known, self._problems)
            fields[name] = self.field(entry.value, kind.value, name, entry.key)
        return Fields(fields)

    def _list(self, node: SequenceNode, kind: ListOf, what: str) -> tuple[Field, ...]:
        self._check_length(node, len(node.items), kind.least, what)
        if kind.distinct:
            self._check_distinct(node, what)
        return tuple(self.field(item, kind.item, what) for item in node.items)

    def _check_length(self, node: Node, length: int, least: int, what: str) -> None:
        if length < least:
            self._problems.add(diagnostic("DH0113", f"`{what}` is empty", node.span, "expected at least one entry"))

    def _check_distinct(self, node: SequenceNode, what: str) -> None:
        first: dict[tuple[str, bool], ScalarNode] = {}
        for item in node.items:
            if isinstance(item, ScalarNode):
                earlier = first.setdefault((item.text, item.is_null), item)
                if earlier is not item:
                    context = ((earlier.span, "first written here"),)
                    text = f"`{item.text}` stands twice in `{what}`"
                    self._problems.add(diagnostic("DH0204", text, item.span, "and again here", context=context))

    def _name(self, node: ScalarNode, kind: Name) -> str:
        if kind.declares:
            check_declared(node, kind.role, self._problems)
        else:
            check_known(node, kind.role, self._scope.known, self._problems)
        return node.text

    def _word(self, node: ScalarNode, kind: Word, what: str) -> str:
        if node.text not in kind.choices:
            expected = f"expected {describe(kind)}"
            self._problems.add(diagnostic("DH0118", f"`{what}` is `{node.text[:80]}`", node.span, expected))
        return node.text

    def _flag(self, node: ScalarNode, what: str) -> bool:
        if node.text.lower() not in ("true", "false"):
            expected = "expected `true` or `false`"
            self._problems.add(diagnostic("DH0118", f"`{what}` is `{node.text[:80]}`", node.span, expected))
        return node.text.lower() == "true"

    def _number(self, node: ScalarNode, kind: Number, what: str) -> float | None:
        value = number_of(node, self._scope.parameters, self._problems)
        if value is None:
            return None
        limits = [
            (kind.above is not None and not value > kind.above, f"more than {kind.above or 0:g}"),
            (kind.at_least is not None and value < kind.at_least, f"at least {kind.at_least or 0:g}"),
            (kind.at_most is not None and value > kind.at_most, f"at most {kind.at_most or 0:g}"),
        ]
        for violated, expected in limits:
            if violated:
                text = f"`{what}` is {value:g}"
                self._problems.add(diagnostic("DH0124", text, node.span, f"expected {expected}"))
        return value

    def _numbers(self, node: SequenceNode, what: str) -> list[float] | None:
        values = []
        for item in node.items:
            if isinstance(item, ScalarNode) and not item.is_null:
                values.append(number_of(item, self._scope.parameters, self._problems))
            else:
                self._wrong(item, Number(), what)
                values.append(None)
        known = [value for value in values if value is not None]
        return known if len(known) == len(values) else None

    def _matrix(self, node: SequenceNode, what: str) -> FloatArray | None:
        rows: list[list[float]] = []
        complete = True
        for item in node.items:
            if not isinstance(item, SequenceNode):
                helps = (f"write a list of rows, `{what}: [[...]]`",)
                label = "expected a row, a list of numbers"
                text = f"a row of `{what}` is {form_of(item)}"
                self._problems.add(diagnostic("DH0113", text, item.span, label, helps=helps))
                return None
            row = self._numbers(item, what)
            complete = complete and row is not None
            if len(item.items) != len(node.items[0].items):  # type: ignore[union-attr]  # an earlier turn saw it
                self._ragged(node, item, what)
                return None
            rows.append(row or [])
        columns = len(rows[0]) if rows else 0
        return frozen_array(np.array(rows).reshape(len(rows), columns), (len(rows), columns)) if complete else None

    def _ragged(self, node: SequenceNode, item: SequenceNode, what: str) -> None:
        first = node.items[0]
        width = len(first.items) if isinstance(first, SequenceNode) else 0
        text = f"the rows of `{what}` differ in length"
        context = ((first.span, count(width, "number")),)
        self._problems.add(diagnostic("DH0202", text, item.span, count(len(item.items), "number"), context=context))

    def _attached(self, node: MappingNode, dimensions: int) -> FloatArray | None:
        reference = self._record(node, REFERENCE, "an array in a file")
        file, key = reference.get("file"), reference.get("key")
        if file is None or key is None or file.text is None or key.text is None:
            return None
        try:
            array = read_array(self._scope.folder, file.text, key.text, file.span, key.span)
        except ModelError as error:
            for problem in error.diagnostics:
                self._problems.add(problem)
            return None
        if array.ndim != dimensions:
            text = f"array `{key.text}` has {array.ndim} dimensions, expected {dimensions}"
            self._problems.add(diagnostic("DH0115", text, key.span))
            return None
        odd = next((value for value in array.ravel().tolist() if odd_size(value)), None)
        if odd is not None:
            text = f"array `{key.text}` holds {odd:g}, which is out of range"
            self._problems.add(diagnostic("DH0124", text, key.span, odd_size(odd)))
            return None
        return frozen_array(array, array.shape)


__all__ = ["decode", "describe"]
