"""Guards and invariants: affine comparisons of states and inputs, joined by and, or, not.

A predicate is a tree of values, never code.  `margin` measures how far it is from changing, so that a simulator can
find the instant of the change by root finding.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

from deshybrid.linear.arrays import FloatArray

Relation: TypeAlias = Literal["<=", "<", "=="]


@dataclass(frozen=True, slots=True, eq=False)
class Affine:
    """The comparison `state @ x + input @ u + constant  relation  0`; shapes (n,), (m,)."""

    state: FloatArray
    input: FloatArray
    constant: float
    relation: Relation

    def margin(self, x: FloatArray, u: FloatArray) -> float:
        """Return a number that is >= 0 exactly where the comparison holds (strictness is ignored at 0).

        >>> import numpy as np
        >>> Affine(np.array([-1.0]), np.array([]), 1.0, "<=").margin(np.array([3.0]), np.array([]))
        2.0
        """
        value = float(self.state @ x + self.input @ u + self.constant)
        return -abs(value) if self.relation == "==" else -value


@dataclass(frozen=True, slots=True)
class And:
    """All parts hold; with no parts, always true."""

    parts: tuple["Predicate", ...]

    def margin(self, x: FloatArray, u: FloatArray) -> float:
        """Return the smallest margin of the parts."""
        return min((part.margin(x, u) for part in self.parts), default=float("inf"))


@dataclass(frozen=True, slots=True)
class Or:
    """At least one part holds."""

    parts: tuple["Predicate", ...]

    def margin(self, x: FloatArray, u: FloatArray) -> float:
        """Return the largest margin of the parts."""
        return max((part.margin(x, u) for part in self.parts), default=float("-inf"))


@dataclass(frozen=True, slots=True)
class Not:
    """The part does not hold."""

    part: "Predicate"

    def margin(self, x: FloatArray, u: FloatArray) -> float:
        """Return the negated margin of the part."""
        return -self.part.margin(x, u)


Predicate: TypeAlias = Affine | And | Or | Not
TRUE = And(())


def numbers_of(predicate: Predicate) -> tuple[float, ...]:
    """Return all coefficients and constants of a predicate, in the order of its comparisons.

    >>> import numpy as np
    >>> numbers_of(Not(Affine(np.array([-1.0]), np.array([]), 2.0, "<=")))
    (-1.0, 2.0)
    """
    match predicate:
        case Affine():
            return (*predicate.state.tolist(), *predicate.input.tolist(), predicate.constant)
        case Not():
            return numbers_of(predicate.part)
        case And() | Or():
            return tuple(number for part in predicate.parts for number in numbers_of(part))


__all__ = ["TRUE", "Affine", "And", "Not", "Or", "Predicate", "Relation", "numbers_of"]
