"""Between which numbers an expression lies while its parameters lie between some: interval arithmetic.

In: a tree of `expressions` and an interval for each parameter.  Out: an `Interval` that contains every value, rounded
outwards; wider than needed where a parameter occurs more than once.  Cost: linear in the tree.
Source: Moore, Kearfott and Cloud (2009), Introduction to Interval Analysis, chapters 2 and 5.
"""

import math
from collections.abc import Callable, Iterable, Mapping
from typing import NamedTuple

from deshybrid.model.arithmetic import CONSTANTS, FUNCTIONS, SELECTIONS
from deshybrid.model.expressions import Call, Chain, Expression, ExpressionError, Minus, Name, Number, Power


class Interval(NamedTuple):
    """All numbers from `low` to `high`."""

    low: float
    high: float

    @property
    def is_a_number(self) -> bool:
        """Whether it is one number only."""
        return self.low == self.high


def enclosure(tree: Expression, parameters: Mapping[str, Interval]) -> Interval:
    """Return an interval that contains the value of the expression for all parameters within theirs.

    Raises `ExpressionError` (DH0221) where there is none: a division by what may be zero, a root of what may be
    negative, `tan`.

    >>> from deshybrid.model.expressions import parse_arithmetic
    >>> found = enclosure(parse_arithmetic("(1 + k)**2 / 4"), {"k": Interval(0.0, 1.0)})
    >>> f"{found.low:.6f} {found.high:.6f}"
    '0.250000 1.000000'
    """
    match tree:
        case Number():
            return Interval(tree.value, tree.value)
        case Name():
            found = parameters.get(tree.text)
            return Interval(CONSTANTS[tree.text], CONSTANTS[tree.text]) if found is None else found
        case Minus():
            inner = enclosure(tree.operand, parameters)
            return Interval(-inner.high, -inner.low)
        case Power():
            return _power(tree, enclosure(tree.base, parameters), enclosure(tree.exponent, parameters))
        case Chain():
            total = enclosure(tree.first, parameters)
            for operator, operand in tree.rest:
                total = _step(tree, operator, total, enclosure(operand, parameters))
            return total
        case Call():
            return _call(tree, [enclosure(argument, parameters) for argument in tree.arguments])
        case _:
            raise _unbounded(tree)


def _step(tree: Chain, operator: str, left: Interval, right: Interval) -> Interval:
    if operator == "+":
        return _around((left.low + right.low, left.high + right.high))
    if operator == "-":
        return _around((left.low - right.high, left.high - right.low))
    if operator == "*":
        return _around(a * b for a in left for b in right)
    if right.low <= 0.0 <= right.high:
        raise _unbounded(tree)
    return _around(a / b for a in left for b in right)


def _power(tree: Power, base: Interval, exponent: Interval) -> Interval:
    """Monotone in both where the base is positive; else for whole exponents."""
    n = exponent.low
    if base.low > 0.0:
        return _around(math.pow(a, b) for a in base for b in exponent)
    if not exponent.is_a_number or n != int(n) or (n < 0 and base.high >= 0.0):
        raise _unbounded(tree)
    corners = [math.pow(a, n) for a in base]
    return _around([*corners, 0.0] if n % 2 == 0 and n > 0 and base.high >= 0.0 else corners)


def _call(tree: Call, arguments: list[Interval]) -> Interval:
    if tree.function in SELECTIONS:
        chosen = SELECTIONS[tree.function]
        return Interval(chosen([a.low for a in arguments]), chosen([a.high for a in arguments]))
    (inner,), function = arguments, FUNCTIONS[tree.function]
    if inner.is_a_number:
        return _around([function(inner.low)])
    if tree.function == "abs":
        return Interval(max(0.0, inner.low, -inner.high), max(-inner.low, inner.high))
    if tree.function in {"sin", "cos"}:  # no steeper than one
        middle, radius = function(0.5 * (inner.low + inner.high)), 0.5 * (inner.high - inner.low)
        return _around((max(-1.0, middle - radius), min(1.0, middle + radius)))
    if tree.function == "tan":
        raise _unbounded(tree)
    return _monotone(tree, function, inner)


def _monotone(tree: Call, function: Callable[[float], float], inner: Interval) -> Interval:
    try:
        return _around([function(inner.low), function(inner.high)])
    except (ValueError, OverflowError):
        raise _unbounded(tree) from None


def _around(values: Iterable[float]) -> Interval:
    """The least interval of these, a little wider than rounding may be wrong."""
    found = list(values)
    low, high = min(found), max(found)
    for _ in range(2):
        low, high = math.nextafter(low, -math.inf), math.nextafter(high, math.inf)
    return Interval(low, high)


def _unbounded(tree: Expression) -> ExpressionError:
    label = "no bound is known within the tolerances"
    return ExpressionError("DH0221", "the tolerances leave this without a bound", tree.start, tree.end, label=label)


__all__ = ["Interval", "enclosure"]
