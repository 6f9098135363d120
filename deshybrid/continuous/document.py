"""The JSON form of a continuous design: what `design --json` prints and `verify` checks.

In: gains, certificates, ultimate bound, lower limit.  Out: a tree of plain numbers, strings and lists.  Numbers are
the very doubles that were certified (JSON round-trips them); an infinite number is null, a complex one [re, im].  The
part `system` repeats the matrices that the verifier needs, so that it never opens the model.
"""

from collections.abc import Mapping, Sequence
from math import isfinite

import numpy as np
from numpy.typing import NDArray

from deshybrid.continuous.average import AverageDwell
from deshybrid.continuous.certified import Certificate, dwell_gap, is_certified, least_required
from deshybrid.continuous.cycles import DwellLowerLimit, WitnessCycle
from deshybrid.continuous.determinability_design import Determined
from deshybrid.continuous.determinability_theorem2 import theorem_2
from deshybrid.continuous.error import dynamics_of, error_dynamics, error_resets
from deshybrid.continuous.form_graph import Node, StayForms
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.lmi import InequalityCertificate, stated_stays
from deshybrid.continuous.ultimate import UltimateBound
from deshybrid.linear.arrays import ComplexArray, FloatArray
from deshybrid.model.system import HybridSystem


def design_document(
    system: HybridSystem,
    gains: ObserverGains,
    certificates: Sequence[Certificate],
    ultimate: UltimateBound | None = None,
    *,
    lower_limit: DwellLowerLimit | None = None,
    detection_delay: Mapping[str, float | None] | None = None,
    determined: Determined | None = None,
    average: AverageDwell | None = None,
) -> dict[str, object]:
    """Return the design as a JSON tree; keys as in the documentation of `design`, in that order, extras after them.

    `required_dwell` is the least of the certificates in continuous time with the longest delay; `gap` is how far that
    without delay lies above the lower limit, as a share of the limit.
    """
    cycle = None if lower_limit is None else lower_limit.cycle
    alone = bool(certificates) and is_certified(certificates)
    return {
        "gains": {name: _rows(gain) for name, gain in gains.gains.items()},
        "eigenvalues": {name: _complex(values) for name, values in gains.eigenvalues.items()},
        "condition": {name: _finite(kappa) for name, kappa in gains.condition.items()},
        "certificates": [certificate_record(entry) for entry in certificates]
        + ([] if determined is None else [entry.record() for entry in determined.certificates]),
        "required_dwell": _finite(least_required(certificates)),
        "dwell_lower_limit": None if lower_limit is None else _finite(lower_limit.value),
        "witness_cycle": None if cycle is None else _cycle_record(cycle),
        "ultimate_bound": None if ultimate is None else _finite(ultimate.value),
        "detection_delay": dict(detection_delay or {}),
        "determinability": None if determined is None else determined.record(alone),
        "theorem_2": theorem_2(error_dynamics(system, gains.gains), gains.dwell).record(),
        "gap": _finite(dwell_gap(certificates, lower_limit)),
        "average_dwell": None if average is None else average.record(),
        "rate": gains.rate,
        "requested_rate": gains.requested_rate,
        "method": gains.method,
        "gain_sources": dict(gains.sources),
        "fixed_modes": {name: _complex(modes) for name, modes in gains.fixed_modes.items() if len(modes)},
        "ultimate_bound_by_state": _by_state(system, ultimate),
        "ultimate_bound_reason": None if ultimate is None else ultimate.reason,
        "ultimate_certificate": _bound_record(system, gains, ultimate),
        "system": _system_record(system, gains.locations),
    }


def empty_document(determined: Determined | None = None) -> dict[str, object]:
    """Return the tree of a design without gains; what locations could determine together may be known all the same."""
    return {
        "gains": {},
        "eigenvalues": {},
        "condition": {},
        "certificates": [],
        "required_dwell": None,
        "dwell_lower_limit": None,
        "witness_cycle": None,
        "ultimate_bound": None,
        "detection_delay": {},
        "determinability": None if determined is None else determined.record(),
    }


def certificate_record(certificate: Certificate) -> dict[str, object]:
    """Return one certificate with all that proves it: T, the scale of the norm, and the terms of (20); or the forms."""
    if isinstance(certificate, InequalityCertificate):
        return _form_record(certificate)
    record: dict[str, object] = {
        "theorem": certificate.theorem,
        "rate": certificate.rate,
        "dwell": _finite(certificate.dwell),
        "delay": certificate.delay,
        "holds": certificate.holds,
        "P": None if certificate.P is None else {name: _rows(matrix) for name, matrix in certificate.P.items()},
        "required_dwell": _finite(certificate.required_dwell),
        "reason": certificate.reason,
        "step": certificate.step,
        "scale": certificate.scale.tolist(),
        "terms": {
            name: {
                "alpha": _finite(term.alpha),
                "kappa": _finite(term.kappa),
                "r": term.r,
                "required": _finite(term.required),
            }
            for name, term in certificate.terms.items()
        },
        "T": {name: [_complex(row) for row in basis] for name, basis in certificate.T.items()},
    }
    if certificate.theorem.endswith("-sampled"):
        record["matrices"] = {name: _rows(matrix) for name, matrix in certificate.matrices.items()}
    return record


def _cycle_record(cycle: WitnessCycle) -> dict[str, object]:
    return {
        "locations": list(cycle.locations),
        "stays": list(cycle.stays),
        "growth": _finite(cycle.growth),
        "resets": list(cycle.resets),
    }


def _form_record(certificate: InequalityCertificate) -> dict[str, object]:
    forms = certificate.forms
    record: dict[str, object] = {
        "theorem": certificate.theorem,
        "rate": certificate.rate,
        "dwell": _finite(certificate.dwell),
        "delay": certificate.delay,
        "holds": certificate.holds,
        "P": None if forms is None else {name: _rows(matrix) for name, matrix in forms.P.items()},
        "nodes": None if forms is None else {name: _node(node) for name, node in forms.nodes.items()},
        "stays": None if forms is None else [_span(span) for span in forms.stays],
        "degree": certificate.degree,
        "required_dwell": _finite(certificate.required_dwell),
        "shortest_stays": dict(certificate.least),
        "reason": certificate.reason,
        "step": certificate.step,
    }
    if certificate.theorem.endswith("-sampled"):
        record["matrices"] = {name: _rows(matrix) for name, matrix in certificate.matrices.items()}
    return record


def _node(node: Node) -> dict[str, object]:
    return {"location": node.location, "exits": [[number, target] for number, target in node.exits.items()]}


def _span(span: StayForms) -> dict[str, object]:
    return {"node": span.node, "from": span.start, "to": _finite(span.end), "Q": [_rows(form) for form in span.Q]}


def _system_record(system: HybridSystem, locations: tuple[str, ...]) -> dict[str, object]:
    pairs = [(name, dynamics_of(system, name)) for name in locations]
    return {
        "time_step": system.time_step,
        "states": list(system.state_names),
        "locations": {name: {"A": _rows(dynamics.A), "C": _rows(dynamics.C)} for name, dynamics in pairs},
        "longest_stays": stated_stays(system, locations)[1],
        "resets": [
            {"from": reset.source, "to": reset.target, "matrix": _rows(reset.matrix)}
            for reset in error_resets(system, locations)
        ],
    }


def _by_state(system: HybridSystem, ultimate: UltimateBound | None) -> dict[str, float] | None:
    if ultimate is None or ultimate.by_state is None:
        return None
    return dict(zip(system.state_names, ultimate.by_state.tolist(), strict=True))


def _bound_record(
    system: HybridSystem, gains: ObserverGains, ultimate: UltimateBound | None
) -> dict[str, object] | None:
    """The sets that prove the ultimate bound, with what drives the error: E w̄, and v̄ before the gain."""
    if ultimate is None or ultimate.certificate is None:
        return None
    bounds = system.bounds
    locations = {}
    for name, entered in ultimate.certificate.sets.items():
        E, outputs = dynamics_of(system, name).E, list(system.location(name).output_index)
        felt = np.zeros(len(outputs)) if bounds.measurement is None else bounds.measurement[outputs]
        locations[name] = {
            "disturbance": _rows(E[:, :0] if bounds.disturbance is None else E * bounds.disturbance),
            "noise": felt.tolist(),
            "directions": _rows(entered.directions),
            "levels": entered.levels.tolist(),
            "bases": entered.bases.tolist(),
        }
    return {"stay": ultimate.certificate.stay, "locations": locations}


def _rows(matrix: FloatArray) -> list[list[float]]:
    return [[float(value) for value in row] for row in matrix]


def _complex(values: ComplexArray | NDArray[np.complex128]) -> list[list[float]]:
    return [[float(value.real), float(value.imag)] for value in values]


def _finite(value: float | None) -> float | None:
    return float(value) if value is not None and isfinite(value) else None


__all__ = ["certificate_record", "design_document", "empty_document"]
