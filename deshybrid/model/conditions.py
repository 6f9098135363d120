"""Guards and invariants: from the tree of a condition to a `Predicate` over the system's states and inputs.

In: a parsed condition, the parameters, the names of states and inputs.  Out: affine comparisons joined by and, or, not.
The input vector of a predicate holds the inputs of the whole system, in their order.
"""

import numpy as np

from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.arithmetic import AffineForm, Parameters, affine
from deshybrid.model.expressions import Comparison, Expression, ExpressionError, Junction, Negation
from deshybrid.model.predicates import Affine, And, Not, Or, Predicate, Relation


def predicate(tree: Expression, parameters: Parameters, states: tuple[str, ...], inputs: tuple[str, ...]) -> Predicate:
    """Return the predicate of a condition.

    Raises `ExpressionError`: DH0125 (a number where a comparison belongs), DH0126 (not affine), and those of
    `arithmetic.evaluate`.

    >>> from deshybrid.model.expressions import parse_condition
    >>> predicate(parse_condition("h >= 2*k"), {"k": 0.5}, ("h",), ()).constant
    1.0
    """
    match tree:
        case Junction():
            parts = tuple(predicate(part, parameters, states, inputs) for part in tree.parts)
            return And(parts) if tree.operator == "&" else Or(parts)
        case Negation():
            return Not(predicate(tree.part, parameters, states, inputs))
        case Comparison():
            symbols = frozenset((*states, *inputs))
            forms = [affine(operand, parameters, symbols) for operand in tree.operands]
            links = tuple(
                _link(left, relation, right, states, inputs)
                for left, relation, right in zip(forms, tree.relations, forms[1:], strict=False)
            )
            return links[0] if len(links) == 1 else And(links)
        case _:
            helps = ("compare it with something, for example `h1 >= 0`",)
            message = "expected a condition, found a number"
            raise ExpressionError("DH0125", message, tree.start, tree.end, helps=helps)


def _link(
    left: AffineForm, relation: str, right: AffineForm, states: tuple[str, ...], inputs: tuple[str, ...]
) -> Affine:
    """`left relation right` as `difference <= 0`, `< 0` or `== 0`."""
    if relation in (">=", ">"):
        left, right = right, left
    difference = left.plus(right.scaled(-1.0))
    kinds: dict[str, Relation] = {"<=": "<=", ">=": "<=", "<": "<", ">": "<", "==": "=="}
    return Affine(
        _coefficients(difference, states), _coefficients(difference, inputs), difference.constant, kinds[relation]
    )


def _coefficients(form: AffineForm, names: tuple[str, ...]) -> FloatArray:
    return frozen_array(np.array([form.coefficients.get(name, 0.0) for name in names]), (len(names),))


__all__ = ["predicate"]
