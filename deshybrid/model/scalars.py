"""One written value as a number, a pole or a condition; what is wrong with it goes to the stage's problems.

In: a scalar node and the parameters.  Out: the value, or None where a mistake was reported.
"""

import math
import re

from deshybrid.diagnostics import diagnostic
from deshybrid.model.arithmetic import AlreadyReportedError, Parameters, affine, evaluate
from deshybrid.model.conditions import predicate
from deshybrid.model.expressions import IMAGINARY, ExpressionError, parse_arithmetic, parse_condition
from deshybrid.model.predicates import Predicate
from deshybrid.model.problems import Problems
from deshybrid.model.tree import ScalarNode

_PLAIN_NUMBER = re.compile(r"[+-]?(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?")
_NOT_FINITE = re.compile(r"[+-]?\.?(?:inf|infinity|nan)", re.IGNORECASE)


def number_of(node: ScalarNode, parameters: Parameters, problems: Problems) -> float | None:
    """Return the value of a number or expression; reports DH0105, DH0121, DH0122, DH0123.

    >>> from deshybrid.model.source import parse_source
    >>> node = parse_source("rate: 2*k + 1e-3").tree.get("rate")
    >>> number_of(node, {"k": 2.0}, Problems())
    4.001
    """
    if _PLAIN_NUMBER.fullmatch(node.text):  # the common case, without building a tree
        value = float(node.text)
        if math.isfinite(value):
            return value
    if _NOT_FINITE.fullmatch(node.text):
        problems.add(diagnostic("DH0123", "a number must be finite", node.span, f"`{node.text}` is not"))
        return None
    try:
        return evaluate(parse_arithmetic(node.text), parameters)
    except (ExpressionError, AlreadyReportedError) as error:
        _report(error, node, problems)
        return None


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
    return complex(form.constant, form.coefficients.get(IMAGINARY, 0.0))


def condition_of(
    node: ScalarNode, parameters: Parameters, states: tuple[str, ...], inputs: tuple[str, ...], problems: Problems
) -> Predicate | None:
    """Return the predicate of a guard or invariant; reports DH0105, DH0121 to DH0123, DH0125, DH0126.

    >>> from deshybrid.model.source import parse_source
    >>> condition_of(parse_source('guard: "h1 >= 1"').tree.get("guard"), {}, ("h1",), (), Problems()).relation
    '<='
    """
    try:
        return predicate(parse_condition(node.text), parameters, states, inputs)
    except (ExpressionError, AlreadyReportedError) as error:
        _report(error, node, problems)
        return None


def _report(error: ExpressionError | AlreadyReportedError, node: ScalarNode, problems: Problems) -> None:
    if isinstance(error, ExpressionError):
        place = node.part(error.start, error.end)
        problems.add(diagnostic(error.code, error.message, place, error.label, helps=error.helps))


__all__ = ["condition_of", "number_of", "pole_of"]
