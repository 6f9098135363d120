"""Certificates for tests: each that is made here has passed the verifier, which knows nothing of its maker.

Tests make certificates through this module only (`tests/architecture` sees to it).
"""

import copy
import json
from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType
from typing import Any

from deshybrid.continuous.certified import Certificate
from deshybrid.continuous.document import certificate_record, design_document
from deshybrid.continuous.dwell import DwellTimeCertificate
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.lmi import InequalityCertificate, certify_by_inequalities, certify_forms
from deshybrid.model.system import HybridSystem
from deshybrid.verify import verify_design

Tree = dict[str, Any]
NONE: Mapping[str, float] = MappingProxyType({})


def certified(
    dynamics: ErrorDynamics,
    *,
    rate: float,
    dwell: float | None = None,
    delay: float = 0.0,
    least: Mapping[str, float] = NONE,
    most: Mapping[str, float] = NONE,
    sampled: bool = False,
) -> InequalityCertificate:
    """The certificate of `certify_by_inequalities`, whose claim the verifier accepted where it makes one."""
    found = certify_by_inequalities(
        dynamics, rate=rate, dwell=dwell, delay=delay, least=least, most=most, sampled=sampled
    )
    if found.holds:
        report = verify_design(tree_of(dynamics, found))
        assert report.holds, str(report)
    return found


def certified_forms(
    system: HybridSystem, gains: ObserverGains, papers: Sequence[DwellTimeCertificate]
) -> tuple[InequalityCertificate, ...]:
    """The certificates of `certify_forms`, accepted together with those of the paper's conditions."""
    found = certify_forms(system, gains, papers)
    both: tuple[Certificate, ...] = (*papers, *found)
    if any(entry.holds for entry in both):
        report = verify_design(design_document(system, gains, both))
        assert report.holds, str(report)
    return found


def changed(tree: Tree, path: tuple[str | int, ...], change: Callable[[Any], Any]) -> Tree:
    """A copy of the tree in which the value at the path is another one."""
    made = copy.deepcopy(tree)
    place: Any = made
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = change(place[path[-1]])
    return made


def tree_of(dynamics: ErrorDynamics, certificate: InequalityCertificate) -> Tree:
    """A design with these error dynamics, a plant that is not measured: A - 0 C, and this certificate alone."""
    n = len(next(iter(dynamics.matrices.values())))
    cycle, limit = certificate.limit.cycle, certificate.limit.value if certificate.delay == 0 else 0.0
    tree = {
        "rate": certificate.rate,
        "required_dwell": certificate.required_dwell,
        "gains": {name: [[0.0]] * n for name in dynamics.locations},
        "dwell_lower_limit": limit,
        "witness_cycle": None
        if cycle is None or limit == 0.0
        else {"locations": list(cycle.locations), "stays": list(cycle.stays), "resets": list(cycle.resets)},
        "system": {
            "time_step": dynamics.step,
            "longest_stays": dict(certificate.most),
            "locations": {name: {"A": F.tolist(), "C": [[0.0] * n]} for name, F in dynamics.matrices.items()},
            "resets": [{"from": r.source, "to": r.target, "matrix": r.matrix.tolist()} for r in dynamics.resets],
        },
        "certificates": [certificate_record(certificate)],
    }
    found: Tree = json.loads(json.dumps(tree))
    return found
