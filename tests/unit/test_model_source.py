"""The source model: what is read from a text, and what stays exactly as it was written."""

import io
import subprocess
import sys
from hashlib import sha256
from pathlib import Path

import pytest

from deshybrid.diagnostics import ModelError
from deshybrid.model.load import load, loads
from deshybrid.model.reader import MOST_DEPTH, MOST_NODES
from deshybrid.model.source import MOST_BYTES, parse_source, read_source
from deshybrid.model.tree import MappingNode, Node, ScalarNode, SequenceNode

TWO_TANK = Path("tests/unit/good_models/two_tank.yaml")
DISCRETE = "format: deshybrid/1\nlocations: [1]\ntransitions: [{from: 1, to: 1, event: a}]\n"


def child(node: Node | None, *path: str | int) -> Node:
    for step in path:
        if isinstance(step, int):
            assert isinstance(node, SequenceNode)
            node = node.items[step]
        else:
            assert isinstance(node, MappingNode)
            node = node.get(step)
    assert node is not None
    return node


def code_of(text: str) -> str:
    with pytest.raises(ModelError) as caught:
        parse_source(text)
    return caught.value.diagnostics[0].code


@pytest.mark.parametrize(
    "name", ["on", "off", "yes", "1", "012", "1e-3", "0x1F", "1_000", "TRUE", "2001-01-01", "12:30"]
)
def test_name_stays_the_text_as_written(name: str) -> None:
    text = f'format: deshybrid/1\nlocations: ["{name}"]\ntransitions: [{{from: "{name}", to: {name}, event: {name}}}]'
    system = loads(text)
    assert system.locations[0].name == name
    assert system.transitions[0].event == name


def test_quoted_null_is_a_name_and_a_plain_one_is_the_null_output() -> None:
    rows = ["emits: null", 'emits: "null"', "emits: ~", "emits: ", "emits: [a, null, 'null']"]
    arcs = "".join(f"  - {{from: 1, to: 1, event: e, {row}}}\n" for row in rows)
    system = loads(f"format: deshybrid/1\nlocations: [1]\ntransitions:\n{arcs}")
    outputs = [transition.outputs for transition in system.transitions]
    assert outputs == [(None,), ("null",), (None,), (None,), ("a", None, "null")]


@pytest.mark.parametrize("text", ["a: {b: [x, 'yy', \"z\\n\"]}", "a:\n  b:\n  - x\n  - 'yy'\n  - \"z\\n\"\n"])
def test_every_node_knows_its_place(text: str) -> None:
    lines = text.split("\n")
    for index, shown in enumerate(["x", "'yy'", '"z\\n"']):
        node = child(parse_source(text).tree, "a", "b", index)
        line = lines[node.span.line - 1]
        assert line[node.span.column - 1 : node.span.column - 1 + node.span.length] == shown


def test_part_of_a_quoted_text_is_placed_inside_its_quotes_and_of_an_escaped_one_at_its_start() -> None:
    tree = parse_source("a: 'k/0'\nb: \"k\\u002F0\"\nc: >-\n  k/\n  0\n").tree
    quoted, escaped, folded = (child(tree, key) for key in "abc")
    assert isinstance(quoted, ScalarNode)
    assert isinstance(escaped, ScalarNode)
    assert isinstance(folded, ScalarNode)
    assert quoted.part(2, 3).column == 7
    assert escaped.text == "k/0"
    assert escaped.part(2, 3) == escaped.span
    assert folded.part(2, 3) == folded.span


def test_line_ends_of_other_systems_and_a_byte_order_mark_change_nothing(tmp_path: Path) -> None:
    systems = []
    for index, data in enumerate(
        [DISCRETE.encode(), b"\xef\xbb\xbf" + DISCRETE.encode(), DISCRETE.replace("\n", "\r\n").encode()]
    ):
        path = tmp_path / f"{index}.yaml"
        path.write_bytes(data)
        systems.append(load(path))
    places = {(s.transitions[0].span.line, s.transitions[0].span.column) for s in systems if s.transitions[0].span}
    assert places == {(3, 15)}


def test_json_with_the_same_tree_gives_the_same_system() -> None:
    first, second = load(TWO_TANK), load(TWO_TANK.with_suffix(".json"))
    assert repr(first) == repr(second)
    assert first.source is not None
    assert second.source is not None
    assert first.source.sha256 != second.source.sha256


def test_json_escapes_of_characters_beyond_sixteen_bits_are_joined() -> None:
    node = child(parse_source('{"name": "\\ud83d\\ude00 \\u00e9"}').tree, "name")
    assert isinstance(node, ScalarNode)
    assert node.text == "\N{GRINNING FACE} é"


def test_json_indented_with_tabs_is_read() -> None:
    arcs = '[\n\t\t{"from": 1, "to": 1, "event": "a"}\n\t]'
    system = loads('{\n\t"format": "deshybrid/1",\n\t"locations":\t[1],\n\t"transitions": ' + arcs + "\n}")
    assert system.locations[0].name == "1"


def test_dash_reads_standard_input(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(io.BytesIO(DISCRETE.encode())))
    source = read_source("-")
    assert source.text.name == "<stdin>"
    assert source.folder is None


def test_file_larger_than_the_limit_is_refused_before_it_is_parsed(tmp_path: Path) -> None:
    path = tmp_path / "large.yaml"
    path.write_bytes(b"#" * (MOST_BYTES + 1))
    with pytest.raises(ModelError) as caught:
        load(path)
    assert caught.value.diagnostics[0].code == "DH0105"


def test_endless_file_is_read_only_up_to_the_limit() -> None:
    if not Path("/dev/zero").exists():
        pytest.skip("the system has no endless file")
    with pytest.raises(ModelError) as caught:
        load("/dev/zero")
    assert caught.value.diagnostics[0].code == "DH0105"


def test_aliases_count_as_often_as_they_are_used() -> None:
    used = parse_source("a: &a [1, 2]\nb: [*a, *a]").tree
    assert len(child(used, "b", 1).items) == 2  # type: ignore[union-attr]
    rows = ", ".join(["*a"] * 1_000)
    values = ", ".join(["1"] * (MOST_NODES // 1_000))
    assert code_of(f"a: &a [{values}]\nb: [{rows}]") == "DH0105"


def test_nesting_up_to_the_limit_is_read_and_one_more_is_refused() -> None:
    deep = MOST_DEPTH - 1  # the file itself is the first mapping
    parse_source("a: " + "[" * deep + "]" * deep)
    assert code_of("a: " + "[" * (deep + 1) + "]" * (deep + 1)) == "DH0105"
    assert code_of("a: " + "{b: " * 5_000) == "DH0105"


@pytest.mark.parametrize(
    "text", ["a: [1, 2", "a: {b: 1", 'a: "x', "a: 'x", "a: @b", "a: %b", "a: `b`", "]", "a: |x\n b", "a: !<x"]
)
def test_broken_yaml_is_refused_with_a_place(text: str) -> None:
    assert code_of(text) == "DH0101"


@pytest.mark.parametrize("char", ["\0", "\x07", "\x1b", "\x7f", "\x85", "\u2028", "\ufeff", "\ud800"])
def test_control_character_is_refused_plain_and_escaped(char: str) -> None:
    assert code_of(f"a: x{char}y") == "DH0103"
    assert code_of(f'a: "\\u{ord(char):04x}"') == "DH0103"


def test_hash_is_that_of_the_bytes_of_the_file(tmp_path: Path) -> None:
    path = tmp_path / "m.yaml"
    path.write_bytes(b"a: 1\r\n")
    assert read_source(path).sha256 == sha256(b"a: 1\r\n").hexdigest()


def test_loading_a_model_imports_no_heavy_library() -> None:
    """A cold `check` has to answer at once, so what only other commands need stays unloaded."""
    heavy = ("scipy", "networkx", "pydantic", "jinja2", "pygraphviz", "matplotlib")
    code = f"import sys, deshybrid.model.load as m; m.load({str(TWO_TANK)!r})\n"
    code += f"print([name for name in {heavy} if name in sys.modules])"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
