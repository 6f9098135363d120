"""The report of a generated filter: a single page on its model, what to expect of it, its cost, and how it is called.

In: the filter, its facts, and the files beside it.  Out: HTML with its style inside: no network, no script.  What stays
in a location is as good as the location's steady-state filter says; nothing is drawn by chance, so that the page is the
same for the same model.  The prose lives in the template.

One Riccati equation for each location.  Source: Hwang et al. (2006), section 3.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from deshybrid.emit.filters import FilterModel
from deshybrid.emit.html import page_environment
from deshybrid.emit.provenance import Provenance
from deshybrid.linear.arrays import FloatArray
from deshybrid.stochastic.steady_state import steady_state
from deshybrid.stochastic.system import Mode

_TITLES = {
    "imm": "interacting multiple model filter (IMM)",
    "mmae": "multiple model adaptive estimation (MMAE)",
    "skf": "switching Kalman filter",
}


@dataclass(frozen=True, slots=True)
class FilterReport:
    """All that the page tells; `facts` are the lines that the generated header has, `step` (s) None where unknown."""

    model: FilterModel
    provenance: Provenance
    facts: tuple[str, ...]
    summary: str = ""
    units: Mapping[str, str] = field(default_factory=dict)
    step: float | None = None
    files: tuple[str, ...] = ()
    prefix: str = ""
    options: tuple[tuple[str, str], ...] = ()


@dataclass(frozen=True, slots=True)
class _Shown:
    """One location as the page shows it; without `deviations` there is no steady-state filter, for the `reason`."""

    name: str
    outputs: tuple[str, ...]
    leaving: tuple[float, ...]
    stay: float
    prior: float
    matrices: tuple[tuple[str, FloatArray], ...]
    radius: float
    deviations: tuple[tuple[float, str], ...]
    reason: str


def emit_filter_report(content: FilterReport) -> str:
    """Return the page.

    >>> from deshybrid.stochastic.examples import calm_and_wild
    >>> walk = FilterModel(calm_and_wild(), "imm", ("x",), (), ("y",))
    >>> page = emit_filter_report(FilterReport(walk, Provenance("walk", "walk.yaml", "3f9c", "0.1.0"), ()))
    >>> page.startswith("<!DOCTYPE html>"), "<script" in page
    (True, False)
    """
    model = content.model
    roles = (("state", model.state_names), ("input", model.input_names), ("measured output", model.output_names))
    context = {
        "content": content,
        "title": _TITLES[model.kind],
        "known": model.kind == "skf",
        "channels": roles,
        "modes": [_shown(model, number) for number in range(len(model.system.modes))],
    }
    return page_environment().get_template("filter.html.j2").render(context).lstrip("\n")


def _shown(model: FilterModel, number: int) -> _Shown:
    system, mode = model.system, model.system.modes[number]
    leaving = system.chain.probability_to_from[:, number]
    ends = 1.0 - float(leaving[number])
    found = steady_state(mode)
    steady = found.filter
    deviations: tuple[tuple[float, str], ...] = ()
    if steady is not None:
        after = np.diagonal(steady.P - steady.filter_gain @ mode.H @ steady.P)
        sizes = np.sqrt(np.maximum(after, 0.0)).tolist()
        deviations = tuple(zip(sizes, model.state_names, strict=True))
    return _Shown(
        name=mode.name,
        outputs=tuple(model.output_names[place] for place in mode.output_index),
        leaving=tuple(leaving.tolist()),
        stay=1.0 / ends if ends > 0.0 else np.inf,
        prior=float(system.mu[number]),
        matrices=tuple(_matrices(mode)),
        radius=0.0 if steady is None else steady.radius,
        deviations=deviations,
        reason=found.reason,
    )


def _matrices(mode: Mode) -> list[tuple[str, FloatArray]]:
    columns = {key: getattr(mode, key)[:, None] for key in ("f", "g")}
    everything = {key: getattr(mode, key) for key in ("F", "B", "H", "D", "Q", "R")} | columns
    return [(key, value) for key, value in everything.items() if value.size and value.any()]


__all__ = ["FilterReport", "emit_filter_report"]
