"""The kinds of value a model file may hold: what `language` describes the file with.

Both the checks of `decode` and the JSON Schema of `schema` are driven by these values, so that nothing is said twice.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

Role: TypeAlias = Literal[
    "model",
    "location",
    "state",
    "input",
    "output",
    "disturbance",
    "event",
    "discrete output",
    "detector",
    "command",
    "value",
    "channel",
    "parameter",
]


@dataclass(frozen=True, slots=True)
class Text:
    """Free text."""


@dataclass(frozen=True, slots=True)
class Word:
    """One of a few words."""

    choices: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class Flag:
    """`true` or `false`."""


@dataclass(frozen=True, slots=True)
class Name:
    """A name, as written; `declares` = it is made here, otherwise it must be declared elsewhere under that role."""

    role: Role
    declares: bool = False


@dataclass(frozen=True, slots=True)
class Number:
    """A finite number or an expression in the parameters, within limits (`above` excludes its end)."""

    above: float | None = None
    at_least: float | None = None
    at_most: float | None = None


@dataclass(frozen=True, slots=True)
class Pole:
    """A real or complex number, such as `-3+2j`."""


@dataclass(frozen=True, slots=True)
class Vector:
    """A list of numbers; `length` says which (for people)."""

    length: str


@dataclass(frozen=True, slots=True)
class Matrix:
    """A list of rows, or a reference to an array in a .npz file; `rows`, `columns` say which (for people)."""

    rows: str
    columns: str


@dataclass(frozen=True, slots=True)
class Condition:
    """A guard or invariant: affine comparisons joined by and, or, not."""


@dataclass(frozen=True, slots=True)
class Definitions:
    """The parameters: names with numbers, each in terms of those before it."""


@dataclass(frozen=True, slots=True)
class ListOf:
    """A list of values of one kind; `distinct` = no name twice, `least` entries at least."""

    item: "Kind"
    distinct: bool = False
    least: int = 0


@dataclass(frozen=True, slots=True)
class Row:
    """A list of fixed length."""

    items: tuple["Kind", ...]


@dataclass(frozen=True, slots=True)
class MapOf:
    """A mapping from names of one role to values of one kind; `declares` as in `Name`."""

    role: Role
    value: "Kind"
    declares: bool = False
    least: int = 0


@dataclass(frozen=True, slots=True)
class ByForm:
    """What is meant depends on what is written: nothing (`null`), a single value, a list or a mapping."""

    scalar: "Kind | None" = None
    sequence: "Kind | None" = None
    mapping: "Kind | None" = None
    null: bool = False


@dataclass(frozen=True, slots=True)
class Key:
    """One key of a record, with what it means; `needs_state` = a purely discrete model must not have it."""

    name: str
    kind: "Kind"
    about: str
    required: bool = False
    needs_state: bool = False


@dataclass(frozen=True, slots=True)
class Record:
    """A mapping with known keys."""

    title: str
    keys: tuple[Key, ...]


Kind: TypeAlias = (
    Text
    | Word
    | Flag
    | Name
    | Number
    | Pole
    | Vector
    | Matrix
    | Condition
    | Definitions
    | ListOf
    | Row
    | MapOf
    | ByForm
    | Record
)

__all__ = [
    "ByForm",
    "Condition",
    "Definitions",
    "Flag",
    "Key",
    "Kind",
    "ListOf",
    "MapOf",
    "Matrix",
    "Name",
    "Number",
    "Pole",
    "Record",
    "Role",
    "Row",
    "Text",
    "Vector",
    "Word",
]
