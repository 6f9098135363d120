"""Other numbers for a model's parameters: in its tree, so that it can be elaborated anew, and in its text.

In: a `SourceModel` and numbers by parameter.  Out: a source model with these numbers, or the text of the file in which
nothing else has changed: comments, order and layout stay.  Cost: that of a copy.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType

from deshybrid.diagnostics import Diagnostic, Span, UsageError, diagnostic
from deshybrid.model.problems import did_you_mean
from deshybrid.model.reader import read_tree
from deshybrid.model.source import SourceModel
from deshybrid.model.tree import Entry, MappingNode, ScalarNode


def with_parameters(source: SourceModel, values: Mapping[str, float]) -> SourceModel:
    """Return the source model with these numbers in `parameters`; its text and places stay those of the file.

    Raises `UsageError`: DH0730 for a name that is no parameter, DH0731 for one whose number cannot be replaced.

    >>> from deshybrid.model.elaborate import elaborate
    >>> from deshybrid.model.source import parse_source
    >>> source = parse_source("{parameters: {k: 2}, locations: {on: {A: [[-k]]}}, state: [h], output: [y], "
    ...                       "format: deshybrid/1, defaults: {C: [[1]]}, transitions: [{from: on, to: on, event: a}]}")
    >>> elaborate(with_parameters(source, {"k": 3.0})).locations[0].dynamics.A.tolist()
    [[-3.0]]
    """
    nodes = {name: _written(source, name) for name in values}
    block = source.tree.entries["parameters"] if nodes else None
    if block is None or not isinstance(block.value, MappingNode):
        return source
    entries = dict(block.value.entries)
    for name, node in nodes.items():
        entries[name] = Entry(entries[name].key, replace(node, text=repr(float(values[name])), plain=True))
    changed = replace(block.value, entries=MappingProxyType(entries))
    tree = MappingNode(
        MappingProxyType({**source.tree.entries, "parameters": Entry(block.key, changed)}), source.tree.span
    )
    return replace(source, tree=tree)


def parameter_text(source: SourceModel, written: Mapping[str, str]) -> str:
    """Return the text of the model file with other numbers, as written here, in `parameters`.

    A parameter that stands in a file that this one extends is written into this one, where it comes before the other.
    Raises `UsageError` as `with_parameters`.

    >>> from deshybrid.model.source import parse_source
    >>> parameter_text(parse_source("parameters: {k: 2, b: 2*k}  # made up"), {"k": "3.25"})
    'parameters: {k: 3.25, b: 2*k}  # made up'
    """
    lines = source.text.text.split("\n")
    spans = {name: _written(source, name).span for name in written}
    here = [(span, written[name]) for name, span in spans.items() if span.source is source.text]
    for span, text in sorted(here, key=_order, reverse=True):
        line, begin = lines[span.line - 1], span.column - 1
        lines[span.line - 1] = line[:begin] + text + line[begin + span.length :]
    added = {name: text for name, text in written.items() if spans[name].source is not source.text}
    return "\n".join(_with_added(lines, source, added) if added else lines)


def _order(place: tuple[Span, str]) -> tuple[int, int]:
    return place[0].line, place[0].column


def _with_added(lines: Sequence[str], source: SourceModel, added: Mapping[str, str]) -> list[str]:
    """The lines of a file that extends another with more parameters, in front of those that it has itself."""
    own = read_tree(source.text)
    block = own.get("parameters") if isinstance(own, MappingNode) else None
    pairs = [f"{name}: {text}" for name, text in added.items()]
    if block is not None:
        return _in_front(lines, block.span, block.span, pairs)
    extends = source.tree.entries["extends"].key.span
    return _in_front(lines, own.span, extends, [f"parameters: {{{', '.join(pairs)}}}"])


def _in_front(lines: Sequence[str], mapping: Span, key: Span, pairs: Sequence[str]) -> list[str]:
    """The lines with more pairs in a mapping, in its style: behind its brace, or on lines above a key of it."""
    row, column = mapping.line - 1, mapping.column
    line = lines[row]
    if line[column - 1 : column] == "{":
        rest = line[column:]
        comma = "" if rest.lstrip().startswith("}") else ", "
        return [*lines[:row], line[:column] + ", ".join(pairs) + comma + rest, *lines[row + 1 :]]
    above = key.line - 1
    return [*lines[:above], *(" " * (key.column - 1) + pair for pair in pairs), *lines[above:]]


def _written(source: SourceModel, name: str) -> ScalarNode:
    """The scalar in which a parameter's number or expression is written."""
    block = source.tree.get("parameters")
    entry = block.entries.get(name) if isinstance(block, MappingNode) else None
    if entry is None:
        known = tuple(block.entries) if isinstance(block, MappingNode) else ()
        text = f"the model has no parameter `{name}`"
        raise UsageError(diagnostic("DH0730", text, helps=did_you_mean(name, known)))
    if not isinstance(entry.value, ScalarNode) or entry.value.offset is None:
        raise UsageError(_unreplaceable(name, entry.value.span))
    return entry.value


def _unreplaceable(name: str, span: Span) -> Diagnostic:
    helps = ("write the parameter in this file, as one number or expression on one line, without an anchor",)
    return diagnostic("DH0731", f"the number of parameter `{name}` cannot be replaced", span, helps=helps)


__all__ = ["parameter_text", "with_parameters"]
