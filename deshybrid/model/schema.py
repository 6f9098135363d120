"""The model language as JSON Schema, for editors and other tools; `deshybrid schema` prints it.

In: the description in `language`.  Out: a schema of draft 2020-12 with a description at every key and one example.
What a schema cannot say (shapes, sums, names that are declared elsewhere) is checked by `elaborate` alone.
Names are texts, but an editor reads an unquoted `1` as a number and `true` as a truth value: all three are names.
Source: JSON Schema, draft 2020-12, core and validation.
"""

from typing import Any

from deshybrid.model.kinds import (
    ByForm,
    Condition,
    Definitions,
    Flag,
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
from deshybrid.model.language import FORMAT, MODEL, REFERENCE

Schema = dict[str, Any]

_EXAMPLE: Schema = {
    "format": FORMAT,
    "name": "tank",
    "parameters": {"k": 2.0},
    "state": {"h": "m"},
    "output": ["y"],
    "locations": {"fill": {"A": [["-k"]], "C": [[1]]}, "drain": {"A": [[-1]], "C": [[1]]}},
    "transitions": [
        {"from": "fill", "to": "drain", "event": "open", "emits": "alarm", "guard": "h >= 1"},
        {"from": "drain", "to": "fill", "event": "close", "emits": None},
    ],
}


def json_schema() -> Schema:
    """Return the JSON Schema of `format: deshybrid/1`.

    >>> json_schema()["properties"]["observer"]["properties"]["rate"]["description"]
    'convergence rate µ of the estimation error, 1/s'
    """
    head: Schema = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "deshybrid model",
        **_record(MODEL),
        "required": ["format"],
        "anyOf": [{"required": ["locations"]}, {"required": ["extends"]}],
    }
    shared: Schema = {
        "name": {"type": ["string", "number", "boolean"], "description": "a name, taken as the text written"},
        "number": {
            "type": ["number", "string"],
            "description": "a finite number, or an expression in `parameters`: + - * / **, parentheses, "
            "sqrt exp log sin cos tan abs min max pi",
        },
        "file": _record(REFERENCE),
    }
    return {**head, "$defs": shared, "examples": [_EXAMPLE]}


_NUMBER: Schema = {"$ref": "#/$defs/number"}
_NAME: Schema = {"$ref": "#/$defs/name"}
_FILE: Schema = {"$ref": "#/$defs/file"}


def _schema(kind: Kind) -> Schema:
    match kind:
        case Record():
            return _record(kind)
        case ByForm():
            return _by_form(kind)
        case Name():
            return _NAME
        case Number():
            return _number(kind)
        case ListOf():
            listed: Schema = {"type": "array", "items": _schema(kind.item)}
            limits = {"minItems": kind.least, "uniqueItems": kind.distinct}
            return listed | {key: value for key, value in limits.items() if value}
        case Row():
            length = len(kind.items)
            items = [_schema(item) for item in kind.items]
            return {"type": "array", "prefixItems": items, "minItems": length, "maxItems": length}
        case MapOf():
            mapping: Schema = {"type": "object", "additionalProperties": _schema(kind.value)}
            return mapping | ({"minProperties": kind.least} if kind.least else {})
        case Definitions():
            return {"type": "object", "additionalProperties": _NUMBER}
        case _:
            return _plain(kind)


def _plain(kind: Text | Word | Flag | Pole | Condition | Vector | Matrix) -> Schema:
    vector: Schema = {"type": "array", "items": _NUMBER}
    match kind:
        case Text():
            return {"type": ["string", "number", "boolean"]}
        case Word():
            return {"enum": list(kind.choices)}
        case Flag():
            return {"type": "boolean"}
        case Pole():
            return {"type": ["number", "string"]}
        case Condition():
            return {"type": "string"}
        case Vector():
            return {"anyOf": [vector, _FILE]}
        case Matrix():
            return {"anyOf": [{"type": "array", "items": vector}, _FILE]}


def _number(kind: Number) -> Schema:
    limits = {"exclusiveMinimum": kind.above, "minimum": kind.at_least, "maximum": kind.at_most}
    return _NUMBER | {key: value for key, value in limits.items() if value is not None}


def _by_form(kind: ByForm) -> Schema:
    forms = [_schema(form) for form in (kind.scalar, kind.sequence, kind.mapping) if form is not None]
    if kind.null:
        forms.append({"type": "null"})
    return forms[0] if len(forms) == 1 else {"anyOf": forms}


def _record(record: Record) -> Schema:
    properties = {key.name: _schema(key.kind) | {"description": key.about} for key in record.keys}
    required = [key.name for key in record.keys if key.required]
    schema: Schema = {"type": "object", "description": record.title, "properties": properties}
    return schema | ({"required": required} if required else {}) | {"additionalProperties": False}


__all__ = ["json_schema"]
