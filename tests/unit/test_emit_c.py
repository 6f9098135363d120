"""Names, constants and layout of generated C; what the compiler says of it is in `tests/lockstep`."""

import ctypes
import re

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from deshybrid.diagnostics import UsageError, catalogue
from deshybrid.emit.c import emit_c
from deshybrid.emit.identifiers import (
    c_comment,
    c_real,
    c_string,
    check_names,
    check_prefix,
    identifier,
    unique_identifiers,
)
from deshybrid.emit.provenance import Provenance, banner
from deshybrid.observer.tables import FlowTables, GeneratorTables, StepTables, TrackerState

ORIGIN = Provenance("lamp", "models/lamp.yaml", "3f9c" * 16, "0.1.0")


def lamp(start: float = 0.0, **names: tuple[str, ...]) -> StepTables:
    """One state, one location, one event."""
    one = np.ones((1, 1))
    generators = [np.zeros((0,) * axes) for axes in [3, 3, 3, 2, 3, 2, 3, 3, 3, 2, 2, 1]]
    flow = FlowTables(
        *(0.5 * np.ones((1, 1, 1)), np.zeros((1, 1, 0)), np.zeros((1, 1, 0)), one, np.array([start])), (True,)
    )
    return StepTables(
        *("lamp", 0.1, names.get("locations", ("on",)), ("x",), (), (), names.get("events", ("click",)), ()),
        flow,
        GeneratorTables((), *generators, (), ()),
        (TrackerState((0,), 0, False, (0,), ()),),
        *(0, 0, (0,), 1, ((-1,),)),
        np.zeros((0, 1, 1)),
        np.zeros((0, 1)),
    )


def code_of(error: UsageError) -> list[str]:
    return [diagnostic.code for diagnostic in error.diagnostics]


@pytest.mark.parametrize("prefix", ["gearbox", "a", "left_wheel2", "A" * 40, "real", "N", "x"])
def test_an_ordinary_identifier_is_a_prefix(prefix):
    assert len(emit_c(lamp(), prefix=prefix, provenance=ORIGIN)) == 6


NO_IDENTIFIERS = ["", "1a", "a-b", "a b", "ä", "a/../b", "a\n", "a;", 'a"']
TAKEN = ["_a", "a_", "a__b", "int", "class", "and_eq", "lambda", "math", "STDIO", "random", "con", "test", "A" * 41]


@pytest.mark.parametrize("prefix", [*NO_IDENTIFIERS, *TAKEN])
def test_anything_else_is_refused_as_a_prefix(prefix):
    with pytest.raises(UsageError) as caught:
        check_prefix(prefix)
    assert code_of(caught.value) == ["DH0811"]


@given(st.text() | st.sampled_from(["class", "math", "test", "2", "", "_", "A" * 41, "x" * 39 + " y"]))
def test_a_usable_prefix_can_be_made_from_any_name(name):
    check_prefix(identifier(name))


def test_a_name_that_no_c_string_holds_is_refused_and_all_of_them_are_reported():
    with pytest.raises(UsageError) as caught:
        check_names("event", ["a\0b", "fine", "x" * 256, "ω" * 128])
    assert code_of(caught.value) == ["DH0812"] * 3
    with pytest.raises(UsageError):
        emit_c(lamp(events=("a\0",)), prefix="lamp", provenance=ORIGIN)


@pytest.mark.parametrize("constant", [float("nan"), float("inf"), -float("inf")])
def test_a_constant_that_is_not_finite_is_refused(constant):
    with pytest.raises(UsageError) as caught:
        c_real(constant, "double")
    assert code_of(caught.value) == ["DH0813"]


@pytest.mark.parametrize("constant", [1e39, -1e39, 1e-60])
def test_a_constant_that_a_float_loses_is_refused_in_float_and_kept_in_double(constant):
    with pytest.raises(UsageError) as caught:
        emit_c(lamp(start=constant), prefix="lamp", real="float", provenance=ORIGIN)
    assert code_of(caught.value) == ["DH0813"]
    assert c_real(constant, "double") in emit_c(lamp(start=constant), prefix="lamp", provenance=ORIGIN)["lamp.c"]


def test_another_real_type_is_refused():
    with pytest.raises(UsageError) as caught:
        emit_c(lamp(), prefix="lamp", real="half", provenance=ORIGIN)
    assert code_of(caught.value) == ["DH0814"]


def test_every_code_of_emission_is_explained():
    assert {"DH0811", "DH0812", "DH0813", "DH0814"} <= set(catalogue())


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_double_constant_reads_back_as_the_same_bits(value):
    text = c_real(value, "double")
    assert float(text).hex() == value.hex()
    assert re.fullmatch(r"-?\d+(\.\d+)?(e[+-]?\d+)?", text)
    assert re.search(r"[.e]", text)


@given(st.floats(width=32, allow_nan=False, allow_infinity=False))
def test_a_float_constant_has_its_suffix_and_reads_back_as_the_same_bits(value):
    text = c_real(value, "float")
    assert re.fullmatch(r"-?\d+(\.\d+)?(e[+-]?\d+)?f", text)
    assert re.search(r"[.e]", text)
    assert bytes(ctypes.c_float(float(text[:-1]))) == bytes(ctypes.c_float(value))


@given(st.text())
def test_a_c_string_is_printable_ascii_without_trigraphs_and_holds_the_bytes_of_the_name(text):
    literal = c_string(text)
    assert literal.isascii()
    assert literal.isprintable()
    assert "??" not in literal
    parts = re.findall(rb"\\[0-7]{3}|\\[\"\\?]|[^\"\\]", literal[1:-1].encode())
    assert b"".join(parts) == literal[1:-1].encode()
    read = [p if len(p) == 1 else p[1:] if len(p) == 2 else bytes([int(p[1:], 8)]) for p in parts]
    assert b"".join(read) == text.encode()


@given(st.lists(st.text(alphabet='*/?"\\ \n\rab\u2028')).map("".join))
def test_a_comment_stays_in_its_comment(text):
    inside = c_comment(text)
    assert inside.isascii()
    assert not inside or inside.isprintable()
    assert not any(mark in inside for mark in ("*/", "/*", "??"))


@given(st.lists(st.text(alphabet="aA1_ -ω", max_size=4)))
def test_identifiers_made_from_names_are_distinct_and_need_nothing_reserved(names):
    found = unique_identifiers(names, ["NONE"])
    assert len(found) == len(names)
    assert len({"NONE", *found}) == len(names) + 1
    assert all(re.fullmatch(r"[A-Za-z0-9]+(_[A-Za-z0-9]+)*", name) for name in found)


def test_a_name_that_is_an_identifier_stays_as_it_is():
    assert unique_identifiers(["q1", "qN", "qR"]) == ("q1", "qN", "qR")


def test_header_says_origin_certificate_cost_and_ownership():
    origin = Provenance("lamp", "models/lamp.yaml", "3f9c" * 16, "0.1.0", ("Rate 2.0 1/s by Theorem 6.",), ("Enjoy.",))
    head = emit_c(lamp(), prefix="lamp", provenance=origin)["lamp.h"].partition("#ifndef")[0]
    for fact in (
        "Generated by deshybrid 0.1.0 from models/lamp.yaml.  Do not edit.  The generated code is yours.",
        f"Model lamp, sha256 {'3f9c' * 16}.",
        "Rate 2.0 1/s by Theorem 6.",
        "One step: at most 1 multiplications and 1 additions.",
        "Memory: 64 bytes of state, ",
        "Enjoy.",
    ):
        assert fact in head


def test_without_a_certificate_the_header_says_so():
    assert "No certificate holds" in emit_c(lamp(), prefix="lamp", provenance=ORIGIN)["lamp.h"]


def test_header_lines_of_hostile_origin_stay_in_their_lines():
    lines = banner(Provenance("a\nb", "c\r\nd", "", "1", ("x " * 200,)), [])
    assert all(line.isascii() and line.isprintable() and len(line) <= 112 for line in lines)


def test_float_code_holds_no_double_constant():
    files = emit_c(lamp(start=0.1), prefix="lamp", real="float", provenance=ORIGIN)
    code = re.sub(r"/\*.*?\*/", "", files["lamp.c"] + files["lamp.h"] + files["lamp_selftest.c"], flags=re.S)
    assert "double" not in code.replace("in double", "")
    assert re.findall(r"(?<![\w.])\d+(?:\.\d+(?:e[+-]?\d+)?|e[+-]?\d+)(?![\df])", code) == []


def test_all_files_of_c_are_ascii_and_end_with_a_line_end():
    for text in emit_c(lamp(locations=("größer\n",)), prefix="lamp", provenance=ORIGIN).values():
        assert text.isascii()
        assert text.endswith("\n")
