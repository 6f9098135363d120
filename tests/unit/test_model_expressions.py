"""Expressions and conditions: what they mean, and how they are refused."""

import math

import numpy as np
import pytest

from deshybrid.model.arithmetic import affine, evaluate
from deshybrid.model.conditions import predicate
from deshybrid.model.expressions import LONGEST_TEXT, ExpressionError, parse_arithmetic, parse_condition


def value(text: str, **parameters: float) -> float:
    return evaluate(parse_arithmetic(text), parameters)


def refusal(text: str, *, condition: bool = False) -> ExpressionError:
    def read() -> object:
        if condition:
            return predicate(parse_condition(text), {"k": 2.0}, ("x", "y"), ("u",))
        return evaluate(parse_arithmetic(text), {"k": 2.0})

    with pytest.raises(ExpressionError) as caught:
        read()
    return caught.value


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("1 - 2 - 3", -4),
        ("12 / 2 / 3", 2),
        ("2 + 3 * 4", 14),
        ("-2 ** 2", -4),
        ("(-2) ** 2", 4),
        ("2 ** 3 ** 2", 512),
        ("2 ** -1", 0.5),
        ("2 ** -2 ** 2", 2.0**-4),
        ("--1", 1),
        ("+-+1", -1),
        ("-3 * -2", 6),
        ("012", 12),
        (".5", 0.5),
        ("5.", 5),
        ("1e-3", 0.001),
        ("1E3", 1000),
        ("pi", math.pi),
        ("sqrt(16) + exp(0) + log(1)", 5),
        ("sin(pi/2) - cos(0)", 0),
        ("abs(-3) * tan(0)", 0),
        ("min(3, 1, 2) + max(1, 2)", 3),
        ("min(3)", 3),
        (" ( 1 ) ", 1),
        ("k*k", 4),
        ("1\n+ 1", 2),
    ],
)
def test_arithmetic_means_what_python_means_by_it(text: str, expected: float) -> None:
    assert value(text, k=2.0) == pytest.approx(expected, abs=1e-15)


@pytest.mark.parametrize(
    ("text", "code", "piece"),
    [
        ("1 +", "DH0121", ""),
        ("", "DH0121", ""),
        ("(1", "DH0121", ""),
        ("1)", "DH0121", ")"),
        ("2k", "DH0121", "k"),
        ("2 3", "DH0121", "3"),
        ("1 // 2", "DH0121", "/"),
        ("2^2", "DH0121", "^"),
        ("1 % 2", "DH0121", "%"),
        ("k.real", "DH0121", "."),
        ("k[0]", "DH0121", "["),
        ("'k'", "DH0121", "'"),
        ("lambda: 1", "DH0121", ":"),
        ("1 < 2", "DH0121", "<"),
        ("sqrt(1, 2)", "DH0121", "sqrt(1, 2)"),
        ("sqrt()", "DH0121", ")"),
        ("sqrt", "DH0122", "sqrt"),
        ("q + 1", "DH0122", "q"),
        ("eval(1)", "DH0122", "eval"),
        ("__import__(1)", "DH0122", "__import__"),
        ("2j", "DH0122", "2j"),
        ("k/0", "DH0123", "k/0"),
        ("1 + k/(k - 2)", "DH0123", "k/(k - 2)"),
        ("log(k - 2)", "DH0123", "log(k - 2)"),
        ("(0 - 1)**0.5", "DH0123", "(0 - 1)**0.5"),
        ("0**-1", "DH0123", "0**-1"),
        ("1e999", "DH0123", "1e999"),
        ("1e308*10", "DH0123", "1e308*10"),
        ("9**9**9**9", "DH0123", "9**9**9"),
    ],
)
def test_what_is_no_arithmetic_is_refused_at_its_place(text: str, code: str, piece: str) -> None:
    found = refusal(text)
    assert (found.code, text[found.start : found.end]) == (code, piece)


def test_innermost_power_is_the_piece_that_overflows() -> None:
    assert refusal("9**9**9**9").start == 3


@pytest.mark.parametrize(
    "text", ["(" * 60 + "1" + ")" * 60, "-" * 60 + "1", "2**" * 60 + "1", "abs(" * 60 + "1" + ")" * 60]
)
def test_expression_that_is_too_deep_is_refused_without_exhausting_the_stack(text: str) -> None:
    assert refusal(text).code == "DH0105"


def test_long_chain_is_no_deep_expression() -> None:
    assert value("+".join(["1"] * 900)) == 900
    assert refusal("1+" * LONGEST_TEXT).code == "DH0105"


@pytest.mark.parametrize(
    ("text", "code", "piece"),
    [
        ("x", "DH0125", "x"),
        ("x > 1 & y", "DH0125", "y"),
        ("!x", "DH0125", "x"),
        ("x*y > 1", "DH0126", "x*y"),
        ("1/x > 1", "DH0126", "1/x"),
        ("x**2 > 1", "DH0126", "x**2"),
        ("2**x > 1", "DH0126", "2**x"),
        ("max(x, y) > 1", "DH0126", "max(x, y)"),
        ("x = 1", "DH0121", "="),
        ("x != 1", "DH0121", "!="),
        ("x > 1 and y > 1", "DH0121", "and"),
        ("not x > 1", "DH0121", "not"),
        ("x > ", "DH0121", ""),
        ("(x > 1", "DH0121", ""),
        ("(x > 1) + 1 > 0", "DH0121", "(x > 1)"),
        ("(x > 1) > 0", "DH0121", "(x > 1)"),
        ("x => 1", "DH0121", "="),
        ("z > 1", "DH0122", "z"),
        ("x/(k - 2) > 1", "DH0123", "x/(k - 2)"),
        ("", "DH0121", ""),
    ],
)
def test_what_is_no_affine_condition_is_refused_at_its_place(text: str, code: str, piece: str) -> None:
    found = refusal(text, condition=True)
    assert (found.code, text[found.start : found.end]) == (code, piece)


@pytest.mark.parametrize(
    ("text", "x", "y", "u", "holds"),
    [
        ("x >= 1", 1.5, 0, 0, True),
        ("x >= 1", 0.5, 0, 0, False),
        ("2*(x - y)/4 < sqrt(k*2)", 3, 0, 0, True),
        ("2*(x - y)/4 < sqrt(k*2)", 5, 0, 0, False),
        ("0 <= x <= y", 1, 2, 0, True),
        ("0 <= x <= y", 3, 2, 0, False),
        ("0 <= x <= y", -1, 2, 0, False),
        ("x > 1 | y > 1 & u > 1", 2, 0, 0, True),
        ("(x > 1 | y > 1) & u > 1", 2, 0, 0, False),
        ("x > 1 || y > 1 && u > 1", 0, 2, 2, True),
        ("!(x > 1)", 0, 0, 0, True),
        ("!!(x > 1)", 0, 0, 0, False),
        ("-x + k*u > -(y)", 0, 0, 1, True),
        ("((x + y)) * 2 > 3", 1, 1, 0, True),
        ("k > 1", 0, 0, 0, True),
    ],
)
def test_condition_holds_where_its_margin_is_positive(text: str, x: float, y: float, u: float, holds: bool) -> None:
    found = predicate(parse_condition(text), {"k": 2.0}, ("x", "y"), ("u",))
    margin = found.margin(np.array([x, y], dtype=float), np.array([u], dtype=float))
    assert margin != 0
    assert (margin > 0) == holds


def test_affine_form_collects_equal_names() -> None:
    form = affine(parse_arithmetic("x + 2*x - y/2 - (x - 3)"), {}, frozenset({"x", "y"}))
    assert (form.constant, dict(form.coefficients)) == (3.0, {"x": 2.0, "y": -0.5})


def test_name_in_other_scripts_is_a_name() -> None:
    assert value("α + größe", **{"α": 1.0, "größe": 2.0}) == 3
