"""The value of a parsed expression: a number, or an affine form in some of its names.

In: a tree of `expressions` and the parameters.  Out: finite floats only; division by zero, overflow and values outside
a function's domain are reported at the smallest piece of the text that causes them.  Cost: linear in the tree.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType

from deshybrid.model.expressions import (
    IMAGINARY,
    Call,
    Chain,
    Comparison,
    Expression,
    ExpressionError,
    Junction,
    Minus,
    Name,
    Negation,
    Number,
    Power,
)
from deshybrid.model.problems import did_you_mean

CONSTANTS: Mapping[str, float] = MappingProxyType({"pi": math.pi})
FUNCTIONS: Mapping[str, Callable[[float], float]] = MappingProxyType(
    {
        "sqrt": math.sqrt,
        "exp": math.exp,
        "log": math.log,
        "sin": math.sin,
        "cos": math.cos,
        "tan": math.tan,
        "abs": abs,
    }
)
SELECTIONS: Mapping[str, Callable[[list[float]], float]] = MappingProxyType({"min": min, "max": max})
RESERVED = frozenset({*CONSTANTS, *FUNCTIONS, *SELECTIONS, "and", "or", "not"})

Parameters = Mapping[str, float | None]  # None: its own expression is wrong and was reported


class AlreadyReportedError(Exception):
    """The expression uses a parameter whose mistake was reported where it is defined; say nothing more."""


@dataclass(frozen=True, slots=True)
class AffineForm:
    """`constant` + the sum of coefficient times name."""

    constant: float
    coefficients: Mapping[str, float] = field(default_factory=dict)

    def scaled(self, factor: float) -> "AffineForm":
        """Return the form times a number."""
        return AffineForm(factor * self.constant, {name: factor * c for name, c in self.coefficients.items()})

    def plus(self, other: "AffineForm") -> "AffineForm":
        """Return the sum of two forms."""
        names = dict.fromkeys((*self.coefficients, *other.coefficients))
        total = {name: self.coefficients.get(name, 0.0) + other.coefficients.get(name, 0.0) for name in names}
        return AffineForm(self.constant + other.constant, total)


def evaluate(tree: Expression, parameters: Parameters) -> float:
    """Return the value of an arithmetic expression.

    Raises `ExpressionError`: DH0121 (a condition where a number belongs), DH0122 (unknown name), DH0123 (no finite real
    value), and `AlreadyReportedError`.

    >>> from deshybrid.model.expressions import parse_arithmetic
    >>> evaluate(parse_arithmetic("-2 ** 2 + min(k, 3) / 2"), {"k": 1.0})
    -3.5
    """
    match tree:
        case Number():
            return tree.value
        case Name():
            return _named(tree, parameters)
        case Minus():
            return -evaluate(tree.operand, parameters)
        case Power():
            base, exponent = evaluate(tree.base, parameters), evaluate(tree.exponent, parameters)
            return _finite(lambda: math.pow(base, exponent), tree.start, tree.end)
        case Chain():
            return _chain(tree, parameters)
        case Call():
            return _call(tree, parameters)
        case Comparison() | Junction() | Negation():
            raise ExpressionError("DH0121", "expected a number, found a condition", tree.start, tree.end)


def affine(tree: Expression, parameters: Parameters, symbols: frozenset[str]) -> AffineForm:
    """Return the expression as an affine form in `symbols`.

    Raises `ExpressionError`: DH0126 where it is not affine in them, and all of `evaluate`.

    >>> from deshybrid.model.expressions import parse_arithmetic
    >>> affine(parse_arithmetic("2*(h - 1)/k"), {"k": 4.0}, frozenset({"h"}))
    AffineForm(constant=-0.5, coefficients={'h': 0.5})
    """
    if not _mentions(tree, symbols):
        return AffineForm(evaluate(tree, parameters))
    match tree:
        case Name():
            return AffineForm(0.0, {tree.text: 1.0})
        case Minus():
            return affine(tree.operand, parameters, symbols).scaled(-1.0)
        case Chain():
            return _affine_chain(tree, parameters, symbols)
        case _:
            raise _not_affine(tree.start, tree.end)


def _affine_chain(tree: Chain, parameters: Parameters, symbols: frozenset[str]) -> AffineForm:
    form = affine(tree.first, parameters, symbols)
    for operator, operand in tree.rest:
        right = affine(operand, parameters, symbols)
        if operator in "+-":
            form = form.plus(right.scaled(1.0 if operator == "+" else -1.0))
        elif operator == "*" and not form.coefficients:
            form = right.scaled(form.constant)
        elif right.coefficients:
            raise _not_affine(tree.start, operand.end)
        elif operator == "*":
            form = form.scaled(right.constant)
        else:
            form = form.scaled(_finite(_step("/", 1.0, right.constant), tree.start, operand.end))
        if not all(map(math.isfinite, (form.constant, *form.coefficients.values()))):
            raise _no_value("the result is beyond the largest number", tree.start, operand.end)
    return form


def _not_affine(start: int, end: int) -> ExpressionError:
    helps = ("only sums of states and inputs times parameters and numbers can be compared",)
    return ExpressionError("DH0126", "the expression is not affine in states and inputs", start, end, helps=helps)


def _mentions(tree: Expression, symbols: frozenset[str]) -> bool:
    match tree:
        case Number():
            return False
        case Name():
            return tree.text in symbols
        case Minus():
            return _mentions(tree.operand, symbols)
        case Power():
            return _mentions(tree.base, symbols) or _mentions(tree.exponent, symbols)
        case Chain():
            return _mentions(tree.first, symbols) or any(_mentions(operand, symbols) for _, operand in tree.rest)
        case Call():
            return any(_mentions(argument, symbols) for argument in tree.arguments)
        case Comparison() | Junction() | Negation():
            return False


def _named(name: Name, parameters: Parameters) -> float:
    if name.text in parameters:
        value = parameters[name.text]
        if value is None:
            raise AlreadyReportedError
        return value
    if name.text in CONSTANTS:
        return CONSTANTS[name.text]
    if name.text == IMAGINARY:
        message = "an imaginary number has no place here"
        raise ExpressionError("DH0122", message, name.start, name.end, helps=("only poles may be complex",))
    if name.text in FUNCTIONS or name.text in SELECTIONS:
        helps: tuple[str, ...] = (f"`{name.text}` is a function: write `{name.text}(...)`",)
    else:
        helps = did_you_mean(name.text, (*parameters, *CONSTANTS))
    message = f"unknown name `{name.text}`"
    raise ExpressionError("DH0122", message, name.start, name.end, label="not a parameter defined before", helps=helps)


def _call(call: Call, parameters: Parameters) -> float:
    if call.function not in FUNCTIONS and call.function not in SELECTIONS:
        helps = did_you_mean(call.function, (*FUNCTIONS, *SELECTIONS))
        end = call.start + len(call.function)
        raise ExpressionError("DH0122", f"unknown function `{call.function}`", call.start, end, helps=helps)
    values = [evaluate(argument, parameters) for argument in call.arguments]
    if call.function in SELECTIONS:
        return SELECTIONS[call.function](values)
    if len(values) != 1:
        message = f"`{call.function}` takes one argument, {len(values)} are given"
        raise ExpressionError("DH0121", message, call.start, call.end)
    return _finite(lambda: FUNCTIONS[call.function](values[0]), call.start, call.end)


def _chain(tree: Chain, parameters: Parameters) -> float:
    total = evaluate(tree.first, parameters)
    for operator, operand in tree.rest:
        total = _finite(_step(operator, total, evaluate(operand, parameters)), tree.start, operand.end)
    return total


def _step(operator: str, left: float, right: float) -> Callable[[], float]:
    match operator:
        case "+":
            return lambda: left + right
        case "-":
            return lambda: left - right
        case "*":
            return lambda: left * right
        case _:
            return lambda: left / right


def _finite(compute: Callable[[], float], start: int, end: int) -> float:
    """The result of one operation, or the reason why there is none, at the piece of text it was written with."""
    try:
        value = compute()
    except ZeroDivisionError:
        raise _no_value("division by zero", start, end) from None
    except OverflowError:
        raise _no_value("the result is beyond the largest number", start, end) from None
    except ValueError:
        raise _no_value("there is no real value", start, end) from None
    if not math.isfinite(value):
        raise _no_value("the result is beyond the largest number", start, end)
    return value


def _no_value(reason: str, start: int, end: int) -> ExpressionError:
    return ExpressionError("DH0123", "the expression has no finite value", start, end, label=reason)


__all__ = ["CONSTANTS", "FUNCTIONS", "RESERVED", "AffineForm", "AlreadyReportedError", "affine", "evaluate"]
