"""Values of a JSON tree as exact numbers, matrices and objects; what is malformed is refused with its path.

In: a value of the tree and where it stands.  Out: fractions and rows of fractions.  Every refusal is a `UsageError`
(DH0511).
"""

import sys
from collections.abc import Mapping
from fractions import Fraction
from math import isfinite
from typing import NoReturn

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.exact import Rational

LARGEST_INTEGER = int(sys.float_info.max)


def complex_matrix(value: object, where: str, n: int) -> tuple[Rational, Rational]:
    """Return real and imaginary part of n rows of pairs [re, im]."""
    if not isinstance(value, list) or len(value) != n:
        refuse(f"`{where}`: expected {n} rows of pairs [re, im]")
    rows = [matrix_at(row, f"{where}[{k}]", columns=2, rows=n) for k, row in enumerate(value)]
    return tuple(tuple(pair[0] for pair in row) for row in rows), tuple(tuple(pair[1] for pair in row) for row in rows)


def matrix_at(value: object, where: str, *, columns: int | None = None, rows: int | None = None) -> Rational:
    """Return a list of rows as an exact matrix."""
    if not isinstance(value, list) or not all(isinstance(row, list) for row in value):
        refuse(f"`{where}` is not a matrix")
    require(rows is None or len(value) == rows, where, f"{rows} rows")
    require(columns is None or all(len(row) == columns for row in value), where, f"{columns} columns")
    return tuple(tuple(number_at(entry, where) for entry in row) for row in value)


def number_at(value: object, where: str) -> Fraction:
    """Return a finite double or integer, exactly."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        refuse(f"`{where}` holds something else than finite numbers")
    if (abs(value) > LARGEST_INTEGER) if isinstance(value, int) else not isfinite(value):
        refuse(f"`{where}` holds a number that is no finite double")
    return Fraction(value)


def mapping_at(tree: Mapping[str, object], key: str, where: str) -> Mapping[str, object]:
    """Return the object under a key."""
    return as_mapping(tree.get(key), f"{where}.{key}")


def as_mapping(value: object, where: str) -> Mapping[str, object]:
    """Return the value if it is an object."""
    if not isinstance(value, Mapping):
        refuse(f"`{where}` is missing or no JSON object")
    return value


def require(condition: bool, where: str, expected: str) -> None:
    """Refuse what is not as expected."""
    if not condition:
        refuse(f"`{where}`: expected {expected}")


def no_key_twice(pairs: list[tuple[str, object]]) -> dict[str, object]:
    """Return the object; for `json.loads`."""
    found = dict(pairs)
    if len(found) < len(pairs):
        keys = [key for key, _ in pairs]
        twice = next(key for key in keys if keys.count(key) > 1)
        raise ValueError(f"the key `{twice[:80]}` stands twice in one object")
    return found


def no_constant(text: str) -> NoReturn:
    """Refuse NaN and Infinity; for `json.loads`."""
    raise ValueError(f"{text} is not a number of JSON")


def refuse(message: str) -> NoReturn:
    """Raise `UsageError` (DH0511)."""
    raise UsageError(
        diagnostic("DH0511", f"not a design: {message}", helps=("write it with `deshybrid design --json`",))
    )


__all__ = [
    "as_mapping",
    "complex_matrix",
    "mapping_at",
    "matrix_at",
    "no_constant",
    "no_key_twice",
    "number_at",
    "refuse",
    "require",
]
