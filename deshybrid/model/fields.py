"""Decoded values with their places: what elaboration reads instead of the raw tree.

A `Field` holds one value and the node it was written as; `Fields` holds the keys of a record or of a mapping by name.
The getters return nothing where a key is missing, so that elaboration states its defaults in one place.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from deshybrid.diagnostics import Span
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.predicates import Affine, And, Not, Or, Predicate
from deshybrid.model.tree import Node, ScalarNode


@dataclass(frozen=True, slots=True, eq=False)
class Field:
    """A decoded value, the node it was read from, and the key it stands under."""

    value: "Value"
    node: Node
    key: ScalarNode | None = None

    @property
    def span(self) -> Span:
        """The place of the value."""
        return self.node.span

    @property
    def number(self) -> float | None:
        """The value if it is a number."""
        return self.value if isinstance(self.value, float) else None

    @property
    def text(self) -> str | None:
        """The value if it is a text or a name."""
        return self.value if isinstance(self.value, str) else None

    @property
    def array(self) -> FloatArray | None:
        """The value if it is a vector or a matrix."""
        return self.value if isinstance(self.value, np.ndarray) else None

    @property
    def predicate(self) -> Predicate | None:
        """The value if it is a condition."""
        return self.value if isinstance(self.value, Affine | And | Or | Not) else None

    @property
    def items(self) -> "tuple[Field, ...]":
        """The entries if it is a list."""
        return self.value if isinstance(self.value, tuple) else ()

    @property
    def fields(self) -> "Fields":
        """The keys if it is a record or a mapping."""
        return self.value if isinstance(self.value, Fields) else NO_FIELDS

    @property
    def names(self) -> tuple[str, ...]:
        """The names of a list of names, or the keys of a mapping."""
        if isinstance(self.value, Fields):
            return tuple(self.value.entries)
        return tuple(item.text for item in self.items if item.text is not None)


@dataclass(frozen=True, slots=True, eq=False)
class Fields:
    """Fields by name, in the order written.

    >>> NO_FIELDS.number("rate") is None, NO_FIELDS.text("name"), NO_FIELDS.fields("bounds") is NO_FIELDS
    (True, '', True)
    """

    entries: Mapping[str, Field]

    def __iter__(self) -> Iterator[tuple[str, Field]]:
        return iter(self.entries.items())

    def get(self, key: str) -> Field | None:
        """Return the field, or None."""
        return self.entries.get(key)

    def number(self, key: str) -> float | None:
        """Return a number, or None."""
        field = self.get(key)
        return None if field is None else field.number

    def text(self, key: str) -> str:
        """Return a text, empty where there is none."""
        field = self.get(key)
        return "" if field is None else field.text or ""

    def predicate(self, key: str) -> Predicate | None:
        """Return a condition, or None."""
        field = self.get(key)
        return None if field is None else field.predicate

    def items(self, key: str) -> tuple[Field, ...]:
        """Return the entries of a list, none where it is missing."""
        field = self.get(key)
        return () if field is None else field.items

    def fields(self, key: str) -> "Fields":
        """Return a record or a mapping, empty where it is missing."""
        field = self.get(key)
        return NO_FIELDS if field is None else field.fields

    def over(self, below: "Fields") -> "Fields":
        """Return these fields, and those of `below` whose keys are not among them."""
        return Fields({**below.entries, **self.entries})


NO_FIELDS = Fields({})
Value: TypeAlias = bool | float | complex | str | FloatArray | Predicate | tuple[Field, ...] | Fields | None

__all__ = ["NO_FIELDS", "Field", "Fields", "Value"]
