"""One written value as a number, a pole or a condition; what is wrong with it goes to the stage's problems.

In: a scalar node and the parameters.  Out: the value, or None where a mistake was reported.  A number is zero or has
a size between 1e-50 and 1e50: no quantity of a plant lies outside, and products of a few such numbers stay doubles.
"""

import math
import re

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.model.arithmetic import AlreadyReportedError, Parameters, affine, evaluate
from deshybrid.model.conditions import predicate
from deshybrid.model.expressions import IMAGINARY, ExpressionError, parse_arithmetic, parse_condition
from deshybrid.model.predicates import Predicate, numbers_of
from deshybrid.model.problems import Problems
from deshybrid.model.tree import ScalarNode

_PLAIN_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
SMALLEST, LARGEST = 1e-50, 1e50
_NOT_FINITE = re.compile(r"[+-]?\.?(?:inf|infinity|nan)", re.IGNORECASE)


def number_of(node: ScalarNode, parameters: Parameters, problems: Problems) -> float | None:
    """Return the value of a number or expression; reports DH0105, DH0121 to DH0124.

    >>> from deshybrid.model.source import parse_source
    >>> node = parse_source("rate: 2*k + 1e-3").tree.get("rate")
    >>> number_of(node, {"k": 2.0}, Problems())
    4.001
    """
    if _PLAIN_NUMBER.fullmatch(node.text):  # the common case, without building a tree
        value = float(node.text)
        if math.isfinite(value):
            return _of_a_size(value, node.span, problems)
    if _NOT_FINITE.fullmatch(node.text):
        problems.add(diagnostic("DH0123", "a number must be finite", node.span, f"`{node.text}` is not"))
        return None
    try:
        value = evaluate(parse_arithmetic(node.text), parameters)
    except (ExpressionError, AlreadyReportedError) as error:
        _report(error, node, problems)
        return None
    return _of_a_size(value, node.span, problems)


def pole_of(node: ScalarNode, parameters: Parameters, problems: Problems) -> complex | None:
    """Return a pole, a real or complex number such as `-3+2j`; reports as `number_of`.

    >>> from deshybrid.model.source import parse_source
    >>> pole_of(parse_source("pole: -3+2j").tree.get("pole"), {}, Problems())
    (-3+2j)
    """
    try:
        form = affine(parse_arithmetic(node.text), parameters, frozenset({IMAGINARY}))
    except (ExpressionError, AlreadyReportedError) as error:
        _report(error, node, problems)
        return None
    pole = complex(form.constant, form.coefficients.get(IMAGINARY, 0.0))
    parts = [_of_a_size(part, node.span, problems) for part in (pole.real, pole.imag)]
    return None if None in parts else pole


def condition_of(
    node: ScalarNode, parameters: Parameters, states: tuple[str, ...], inputs: tuple[str, ...], problems: Problems
) -> Predicate | None:
    """Return the predicate of a guard or invariant; reports DH0105, DH0121 to DH0126.

    >>> from deshybrid.model.source import parse_source
    >>> condition_of(parse_source('guard: "h1 >= 1"').tree.get("guard"), {}, ("h1",), (), Problems()).relation
    '<='
    """
    try:
        found = predicate(parse_condition(node.text), parameters, states, inputs)
    except (ExpressionError, AlreadyReportedError) as error:
        _report(error, node, problems)
        return None
    sized = [_of_a_size(float(number), node.span, problems) for number in numbers_of(found)]
    return None if None in sized else found


def odd_size(value: float) -> str:
    """Return what to say of a number whose size no quantity of a plant has; empty where there is nothing to say.

    >>> odd_size(0.0), odd_size(-1e200)
    ('', 'expected 0, or a size from 1e-50 to 1e+50')
    """
    usual = value == 0 or SMALLEST <= abs(value) <= LARGEST
    return "" if usual else f"expected 0, or a size from {SMALLEST:g} to {LARGEST:g}"


def _of_a_size(value: float, span: Span, problems: Problems) -> float | None:
    label = odd_size(value)
    if not label:
        return value
    problems.add(diagnostic("DH0124", f"the number {value:g} is out of range", span, label))
    return None


def _report(error: ExpressionError | AlreadyReportedError, node: ScalarNode, problems: Problems) -> None:
    if isinstance(error, ExpressionError):
        place = node.part(error.start, error.end)
        problems.add(diagnostic(error.code, error.message, place, error.label, helps=error.helps))


__all__ = ["LARGEST", "SMALLEST", "condition_of", "number_of", "odd_size", "pole_of"]
