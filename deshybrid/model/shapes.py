"""Shapes of matrices and vectors against the sizes of the model, with messages that say where each size comes from.

In: a decoded array, what its rows and columns stand for.  Out: the array, or None where DH0203 was reported.
"""

from dataclasses import dataclass

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.fields import Field
from deshybrid.model.problems import Problems
from deshybrid.model.tree import Node, ScalarNode, SequenceNode

_LONGEST_EXAMPLE = 60


@dataclass(frozen=True, slots=True)
class Extent:
    """A size of the model: how many, of what (in the singular), and the place and fact that fix it."""

    size: int
    item: str
    span: Span | None
    fact: str


@dataclass(frozen=True, slots=True)
class Expected:
    """What a matrix is called and belongs to, and its extents; `columns` None for a vector."""

    title: str
    key: str
    where: str
    rows: Extent
    columns: Extent | None = None


def count(number: int, noun: str) -> str:
    """Return a number with its noun.

    >>> count(1, "column"), count(3, "column")
    ('1 column', '3 columns')
    """
    return f"{number} {noun}" + ("" if number == 1 else "s")


def checked(field: Field | None, expected: Expected, problems: Problems) -> FloatArray | None:
    """Return the array of a field if its shape is the expected one; report DH0203 and return None if not."""
    array = None if field is None else field.array
    if field is None or array is None:
        return None
    if array.ndim == 2 and array.size == 0 and array.shape[0] == 0 and expected.rows.size == 0:
        return array.reshape(0, 0 if expected.columns is None else expected.columns.size)
    wanted = (expected.rows.size,) if expected.columns is None else (expected.rows.size, expected.columns.size)
    if array.shape == wanted:
        return array
    _report(field, array.shape, wanted, expected, problems)
    return None


def _report(
    field: Field, shape: tuple[int, ...], wanted: tuple[int, ...], expected: Expected, problems: Problems
) -> None:
    title = f"{expected.title} `{expected.key}` of {expected.where}"
    wrong = [i for i in range(len(wanted)) if shape[i] != wanted[i]]
    extent = expected.columns if wrong[-1] == 1 and expected.columns is not None else expected.rows
    line = "entry" if expected.columns is None else ("row", "column")[wrong[-1]]
    if len(wrong) == 2:
        text = f"{title} is {_shown(shape)}, expected {_shown(wanted)}"
        helps = f"write one row per {expected.rows.item} and one column per {extent.item}"
    else:
        plural = "entries" if line == "entry" else line + "s"
        number = f"1 {line}" if shape[wrong[0]] == 1 else f"{shape[wrong[0]]} {plural}"
        text = f"{title} has {number}, expected {wanted[wrong[0]]}"
        helps = f"write one {line} of `{expected.key}` per {extent.item}{_example(field.node, wanted, expected.key)}"
    context = ((extent.span, extent.fact),) if extent.span is not None else ()
    problems.add(diagnostic("DH0203", text, field.span, f"shape {_shown(shape)}", context=context, helps=(helps,)))


def _shown(shape: tuple[int, ...]) -> str:
    return f"({shape[0]},)" if len(shape) == 1 else f"({shape[0]}, {shape[1]})"


def _example(node: Node, wanted: tuple[int, ...], key: str) -> str:
    """The value as written, cut or filled with zeros to the wanted shape; empty where that would be long."""
    if not isinstance(node, SequenceNode):
        return ""
    if len(wanted) == 1:
        text = _row(node, wanted[0])
    else:
        rows = [row for row in node.items[: wanted[0]] if isinstance(row, SequenceNode)]
        texts = [_row(row, wanted[1]) for row in rows]
        texts += [_row(None, wanted[1])] * (wanted[0] - len(texts))
        text = "[" + ", ".join(texts) + "]"
    return f": `{key}: {text}`" if len(text) <= _LONGEST_EXAMPLE else ""


def _row(node: SequenceNode | None, length: int) -> str:
    texts = [item.text for item in (node.items if node is not None else ()) if isinstance(item, ScalarNode)]
    texts = texts[:length] + ["0"] * (length - len(texts))
    return "[" + ", ".join(texts) + "]"


__all__ = ["Expected", "Extent", "checked", "count"]
