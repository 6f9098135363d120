"""Covariances and probabilities: what makes a model stochastic.

In: the decoded keys `noise`, `prior`, `transition_probability`.  Out: checked arrays and mappings; DH0209 where
probabilities do not sum to one, DH0210 where a matrix is no covariance.
Probabilities are written `{from: {to: p}}`, so that their orientation cannot be mistaken.
"""

from collections.abc import Mapping
from types import MappingProxyType

import numpy as np

from deshybrid.diagnostics import Span, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.channels import Channels
from deshybrid.model.fields import Field, Fields
from deshybrid.model.problems import Problems
from deshybrid.model.shapes import Expected, Extent, checked
from deshybrid.model.system import Prior
from deshybrid.model.tree import SequenceNode

_ROUNDING = 1e-9
_ROW = "a row is written {from: {to: p}}: the chances of where the next step leads"
_TRANSPOSED = "the columns sum to 1 instead: write {from: {to: p}}, the other way round"


def covariance(field: Field | None, title: str, extent: Extent, problems: Problems) -> FloatArray | None:
    """Return a symmetric, positive semidefinite matrix; reports DH0203 and DH0210.

    Eigenvalues below zero by less than 1e-9 of the largest are taken as rounding, and so are differences across the
    diagonal.
    """
    if field is None:
        return None
    key = field.key.text if field.key is not None else title
    array = checked(field, Expected("covariance", key, f"the {title}", extent, extent), problems)
    if array is None or array.size == 0:
        return array
    scale = float(np.abs(array).max()) or 1.0
    differences = np.abs(array / scale - (array / scale).T)
    if differences.max() > _ROUNDING:
        row, column = (int(i) for i in np.unravel_index(int(differences.argmax()), array.shape))
        text = f"the covariance of the {title} is not symmetric"
        context = ((_entry(field, column, row), f"entry ({column + 1}, {row + 1}) is {array[column, row]:g}"),)
        label = f"entry ({row + 1}, {column + 1}) is {array[row, column]:g}"
        problems.add(diagnostic("DH0210", text, _entry(field, row, column), label, context=context))
        return None
    smallest = float(np.linalg.eigvalsh(array / scale)[0]) * scale
    if smallest < -_ROUNDING * scale * len(array):
        text = f"the covariance of the {title} is not positive semidefinite"
        label = f"its smallest eigenvalue is {smallest:.3g}"
        problems.add(diagnostic("DH0210", text, field.span, label))
        return None
    return array


def _entry(field: Field, row: int, column: int) -> Span:
    if isinstance(field.node, SequenceNode):
        line = field.node.items[row]
        if isinstance(line, SequenceNode):
            return line.items[column].span
    return field.span


def build_chain(
    model: Fields, locations: tuple[str, ...], problems: Problems
) -> Mapping[str, Mapping[str, float]] | None:
    """Return the probabilities {from: {to: p}}, zeros left out as written; reports DH0209."""
    field = model.get("transition_probability")
    if field is None:
        return None
    rows = field.fields
    for name in locations:
        if rows.get(name) is None:
            text = f"`transition_probability` has no row for location `{name}`"
            helps = (f"write `{name}: {{...}}`; to stay for ever is `{name}: {{{name}: 1}}`",)
            problems.add(diagnostic("DH0209", text, field.span, helps=helps))
    chain = {name: _probabilities(row) for name, row in rows}
    sums = [sum(row.get(name, 0.0) for row in chain.values()) for name in locations]
    transposed = all(abs(total - 1.0) <= _ROUNDING for total in sums)
    for name, row in rows:
        _check_sum(row, f"the probabilities from location `{name}`", _TRANSPOSED if transposed else _ROW, problems)
    return MappingProxyType({name: chain[name] for name in locations if name in chain})


def build_prior(model: Fields, channels: Channels, locations: tuple[str, ...], problems: Problems) -> Prior | None:
    """Return the prior; reports DH0203, DH0209 and DH0210."""
    if model.get("prior") is None:
        return None
    prior = model.fields("prior")
    expected = Expected("mean", "mean", "the prior", channels.state())
    mean = checked(prior.get("mean"), expected, problems)
    spread = covariance(prior.get("covariance"), "prior", channels.state(), problems)
    row = prior.get("probability")
    if row is None:
        return Prior(mean, spread)
    _check_sum(row, "the prior probabilities", "one number for each location", problems)
    given = _probabilities(row)
    return Prior(mean, spread, MappingProxyType({name: given.get(name, 0.0) for name in locations}))


def _probabilities(row: Field) -> Mapping[str, float]:
    return MappingProxyType({name: part.number for name, part in row.fields if part.number is not None})


def _check_sum(row: Field, what: str, advice: str, problems: Problems) -> None:
    total = sum(_probabilities(row).values())
    if abs(total - 1.0) > _ROUNDING:
        label = f"sum {total:.12g}"
        problems.add(diagnostic("DH0209", f"{what} do not sum to 1", row.span, label, helps=(advice,)))


__all__ = ["build_chain", "build_prior", "covariance"]
