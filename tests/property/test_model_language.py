"""Facts that hold for every text of the model language, and for every text at all."""

import json
from collections.abc import Callable
from operator import add
from operator import mul as multiply
from operator import sub as subtract
from operator import truediv as divide
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.diagnostics import ModelError, catalogue, render_all
from deshybrid.model.arithmetic import evaluate
from deshybrid.model.conditions import predicate
from deshybrid.model.expressions import ExpressionError, parse_arithmetic, parse_condition
from deshybrid.model.load import loads
from tests.strategies import PARAMETERS, arithmetic, damaged, flat_arithmetic, names_of_the_language

EXAMPLES = [
    Path("tests/unit/good_models/two_tank.yaml").read_text(encoding="utf-8"),
    Path("tests/unit/good_models/everything.yaml").read_text(encoding="utf-8"),
    Path("tests/unit/good_models/two_tank.json").read_text(encoding="utf-8"),
    Path("models/balluchi2012/fig2.yaml").read_text(encoding="utf-8"),
]


@given(arithmetic())
def test_expression_has_the_value_that_python_gives_its_tree(case: tuple[str, float]) -> None:
    text, expected = case
    outcome = value_or_refusal(lambda: evaluate(parse_arithmetic(text), PARAMETERS))
    if isinstance(outcome, ExpressionError):
        assert outcome.code == "DH0105"  # longer or deeper than an expression may be
    else:
        assert outcome == pytest.approx(expected, rel=1e-12, abs=1e-300)


def value_or_refusal(read: Callable[[], float]) -> float | ExpressionError:
    try:
        return read()
    except ExpressionError as error:
        return error


def by_precedence(text: str) -> float:
    """The value of a text without parentheses and names, by splitting it where it binds least."""
    text = text.replace(" ", "")
    for operators in ("+-", "*/"):
        for place in range(len(text) - 1, 0, -1):
            before = text[place - 1]
            binary = before not in "+-*/" and not (text[place] == "*" and text[place + 1 : place + 2] == "*")
            if text[place] in operators and binary:
                operation = {"+": add, "-": subtract, "*": multiply, "/": divide}[text[place]]
                return operation(by_precedence(text[:place]), by_precedence(text[place + 1 :]))
    if text[0] in "+-":
        return by_precedence(text[1:]) * (-1 if text[0] == "-" else 1)
    base, power, exponent = text.partition("**")
    return float(base) ** by_precedence(exponent) if power else float(text)


@given(flat_arithmetic())
def test_operators_bind_as_in_python(text: str) -> None:
    try:
        expected = by_precedence(text)
    except OverflowError:
        with pytest.raises(ExpressionError):
            evaluate(parse_arithmetic(text), {})
        return
    assert evaluate(parse_arithmetic(text), {}) == pytest.approx(expected, rel=1e-12, abs=1e-300)


@given(
    st.lists(st.floats(-9, 9).map(lambda value: round(value, 2)), min_size=4, max_size=4),
    st.sampled_from(["<=", "<", ">=", ">", "=="]),
    st.lists(st.integers(-5, 5), min_size=3, max_size=3),
)
def test_comparison_has_the_margin_of_its_two_sides(numbers: list[float], relation: str, point: list[int]) -> None:
    a, b, c, d = numbers
    x, y, u = point
    text = f"{a}*x + y*({b}) {relation} ({c})*u - {d}"
    found = predicate(parse_condition(text), {}, ("x", "y"), ("u",))
    difference = (c * u - d) - (a * x + y * b)
    expected = {"<": difference, "<=": difference, ">": -difference, ">=": -difference, "==": -abs(difference)}
    margin = found.margin(np.array([x, y], dtype=float), np.array([u], dtype=float))
    assert margin == pytest.approx(expected[relation], abs=1e-12)


@given(st.lists(names_of_the_language(), min_size=1, max_size=6, unique=True))
def test_names_survive_the_way_through_a_file(names: list[str]) -> None:
    arcs = [{"from": name, "to": name, "event": name, "emits": [name, None]} for name in names]
    text = json.dumps({"format": "deshybrid/1", "locations": names, "transitions": arcs})
    system = loads(text)
    assert [location.name for location in system.locations] == names
    assert [(t.event, t.outputs) for t in system.transitions] == [(name, (name, None)) for name in names]


def refusal_or_none(text: str) -> ModelError | None:
    """Nothing but a `ModelError` may come out; the folder holds the array that one of the examples refers to."""
    try:
        loads(text, "m.yaml", Path("tests/unit/good_models"))
    except ModelError as error:
        return error
    return None


@settings(max_examples=150, deadline=None)
@given(st.data())
def test_damaged_model_is_read_or_refused_with_a_known_code_and_a_place(data: st.DataObject) -> None:
    text = data.draw(damaged(data.draw(st.sampled_from(EXAMPLES))))
    error = refusal_or_none(text)
    if error is not None:
        assert all(found.code in catalogue() and found.span is not None for found in error.diagnostics)
        assert all(line.isprintable() for line in render_all(error.diagnostics).split("\n"))


@given(st.text(max_size=60))
def test_any_text_at_all_is_refused_without_a_traceback(text: str) -> None:
    assert refusal_or_none(text) is not None


@given(st.text(alphabet="()+-*/.&|!<>=, 0123456789exyksqrt", max_size=40))
def test_any_expression_at_all_has_a_finite_value_or_a_code(text: str) -> None:
    for read in (
        lambda: evaluate(parse_arithmetic(text), PARAMETERS),
        lambda: predicate(parse_condition(text), PARAMETERS, ("x", "y"), ()).margin(np.zeros(2), np.zeros(0)),
    ):
        outcome = value_or_refusal(read)
        if isinstance(outcome, ExpressionError):
            assert outcome.code in catalogue()
            assert 0 <= outcome.start <= outcome.end <= len(text)
        else:
            assert np.isfinite(outcome)
