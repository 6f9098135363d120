"""The JSON Schema says of a file what the checks say of its form, because both are made from one description."""

import json
import re
from pathlib import Path
from typing import Any

import pytest

from deshybrid.diagnostics import SourceText
from deshybrid.model.language import MODEL
from deshybrid.model.load import loads
from deshybrid.model.reader import read_tree
from deshybrid.model.schema import json_schema
from deshybrid.model.source import read_source
from deshybrid.model.tree import Node, ScalarNode, SequenceNode

FOLDER = Path(__file__).parent
_TYPES: dict[str, Any] = {
    "object": dict,
    "array": list,
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "null": type(None),
}


def plain(node: Node) -> Any:
    """The value an editor sees: what YAML's core schema makes of the texts."""
    if isinstance(node, SequenceNode):
        return [plain(item) for item in node.items]
    if not isinstance(node, ScalarNode):
        return {key: plain(entry.value) for key, entry in node.entries.items()}
    if node.is_null:
        return None
    if node.plain and node.text in ("true", "false"):
        return node.text == "true"
    if node.plain and re.fullmatch(r"[-+]?(\d+\.?\d*|\.\d+)([eE][-+]?\d+)?", node.text):
        return float(node.text)
    return node.text


def valid(value: Any, schema: dict[str, Any], root: dict[str, Any]) -> bool:
    """A small independent validator of the keywords that the schema uses."""
    if "$ref" in schema and not valid(value, root["$defs"][schema["$ref"].rpartition("/")[2]], root):
        return False
    if "anyOf" in schema and not any(valid(value, part, root) for part in schema["anyOf"]):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    types = schema.get("type", list(_TYPES))
    fits = [isinstance(value, _TYPES[name]) for name in ([types] if isinstance(types, str) else types)]
    if not any(fits) or (isinstance(value, bool) and "boolean" not in types):
        return False
    if isinstance(value, dict):
        return _valid_object(value, schema, root)
    if isinstance(value, list):
        return _valid_array(value, schema, root)
    if isinstance(value, float):
        return (
            value > schema.get("exclusiveMinimum", float("-inf"))
            and value >= schema.get("minimum", value)
            and value <= schema.get("maximum", value)
        )
    return True


def _valid_object(value: dict[str, Any], schema: dict[str, Any], root: dict[str, Any]) -> bool:
    properties, others = schema.get("properties", {}), schema.get("additionalProperties", True)
    if any(key not in value for key in schema.get("required", ())) or len(value) < schema.get("minProperties", 0):
        return False
    for key, part in value.items():
        rule = properties.get(key, others)
        if rule is False or (rule is not True and not valid(part, rule, root)):
            return False
    return True


def _valid_array(value: list[Any], schema: dict[str, Any], root: dict[str, Any]) -> bool:
    if not schema.get("minItems", 0) <= len(value) <= schema.get("maxItems", len(value)):
        return False
    if schema.get("uniqueItems") and len({json.dumps(item) for item in value}) < len(value):
        return False
    rules = schema.get("prefixItems") or [schema.get("items", {})] * len(value)
    return all(valid(item, rule, root) for item, rule in zip(value, rules, strict=True))


GOOD = sorted((FOLDER / "good_models").glob("*.yaml")) + sorted(Path("models").glob("*/*.yaml"))
FORM_CODES = {"DH0111", "DH0112", "DH0113", "DH0118"}
ROWS = [row.split() for row in (FOLDER / "bad_models" / "expected.txt").read_text().splitlines()[1:]]
BAD_FORMS = [row[0] for row in ROWS if row[1] in FORM_CODES]


@pytest.mark.parametrize("path", GOOD, ids=str)
def test_good_model_is_valid(path: Path) -> None:
    schema = json_schema()
    assert valid(plain(read_source(path).tree), schema, schema)


@pytest.mark.parametrize("file", BAD_FORMS)
def test_model_of_the_wrong_form_is_not_valid(file: str) -> None:
    schema = json_schema()
    text = (FOLDER / "bad_models" / file).read_text(encoding="utf-8")
    tree = read_tree(SourceText(file, text))
    assert not valid(plain(tree), schema, schema)


def test_example_in_the_schema_is_a_model() -> None:
    schema = json_schema()
    for example in schema["examples"]:
        assert valid(example, schema, schema)
        assert loads(json.dumps(example)).name == "tank"


def test_schema_is_json_and_describes_every_key_of_the_language() -> None:
    schema = json_schema()
    assert json.loads(json.dumps(schema)) == schema
    assert list(schema["properties"]) == [key.name for key in MODEL.keys]
    assert [path for path, rule in properties_of(schema, "") if not rule.get("description")] == []


def properties_of(part: Any, path: str) -> list[tuple[str, dict[str, Any]]]:
    """Every property of the schema with the keys that lead to it."""
    found: list[tuple[str, dict[str, Any]]] = []
    if isinstance(part, list):
        return [pair for item in part for pair in properties_of(item, path)]
    if isinstance(part, dict):
        for key, value in part.items():
            if key == "properties":
                found += [(f"{path}{name}", rule) for name, rule in value.items()]
            step = "" if key in ("properties", "anyOf", "items", "additionalProperties", "prefixItems") else f"{key}/"
            found += properties_of(value, path + step)
    return found
