"""What several certificates of one observer say together.

In: certificates by the paper's conditions and by matrix inequalities, for continuous and sampled observers.  Out:
whether the observer is certified, the least required dwell time, and how far that is from the worst switching cycle.
"""

from collections.abc import Sequence
from math import inf
from typing import TypeAlias

from deshybrid.continuous.cycles import DwellLowerLimit, dwell_lower_limit
from deshybrid.continuous.dwell import DwellTimeCertificate, certify_dwell, certify_sampled
from deshybrid.continuous.gains import ObserverGains
from deshybrid.continuous.lmi import InequalityCertificate
from deshybrid.model.system import HybridSystem

Certificate: TypeAlias = DwellTimeCertificate | InequalityCertificate


def paper_certificates(
    system: HybridSystem, gains: ObserverGains, *, step: float, delay: float
) -> tuple[DwellTimeCertificate, ...]:
    """Return Theorem 6, Theorem 7 with the detection delay, and the sampled observer, which sees a switch a step late.

    `step` and `delay` in seconds.
    """
    late = 0.0 if system.time_step is not None else step
    return (
        certify_dwell(system, gains),
        *((certify_dwell(system, gains, delay=delay),) if delay > 0.0 else ()),
        certify_sampled(system, gains, step=step, delay=delay + late),
    )


def known_limit(system: HybridSystem, gains: ObserverGains, certificates: Sequence[Certificate]) -> DwellLowerLimit:
    """Return the lower limit of the dwell time without delay: that of the forms, else that of the plain search."""
    for certificate in certificates:
        if isinstance(certificate, InequalityCertificate) and certificate.theorem == "LMI":
            return certificate.limit  # the first of them is the one without delay
    return dwell_lower_limit(system, gains, longest=certificates[0].required_dwell)


def is_certified(certificates: Sequence[Certificate]) -> bool:
    """Return whether one certificate holds for the continuous observer and one for the sampled one that runs.

    Only certificates with the longest delay of their kind count.  Without any there is nothing to certify: true.
    """
    kinds = [_of_kind(certificates, sampled=sampled) for sampled in (False, True)]
    return all(any(entry.holds for entry in kind) for kind in kinds if kind)


def deciding(certificates: Sequence[Certificate]) -> Certificate | None:
    """Return the certificate that asks for most, where of each kind that has to hold only the best one counts.

    None where there are no certificates.
    """
    kinds = [_of_kind(certificates, sampled=sampled) for sampled in (False, True)]
    best = [min(kind, key=lambda entry: entry.required_dwell) for kind in kinds if kind]
    return max(best, key=lambda entry: (entry.required_dwell, entry.delay), default=None)


def least_required(certificates: Sequence[Certificate]) -> float:
    """Return the least dwell time (s) that a certificate with the longest delay asks for, in continuous time."""
    plain = _of_kind(certificates, sampled=False) or _of_kind(certificates, sampled=True)
    return min((entry.required_dwell for entry in plain), default=inf)


def dwell_gap(certificates: Sequence[Certificate], limit: DwellLowerLimit | None) -> float:
    """Return (least required dwell time - limit)/limit, both without delay; infinite where the limit is zero."""
    plain = [entry for entry in certificates if not entry.theorem.endswith("-sampled") and entry.delay == 0]
    required = min((entry.required_dwell for entry in plain), default=inf)
    if limit is None or required == inf:
        return inf
    if limit.value > 0:
        return required / limit.value - 1
    return inf if required > 0 else 0.0


def interval_lines(certificates: Sequence[Certificate], limit: DwellLowerLimit | None) -> list[str]:
    """Return in words between which dwell times the truth lies; nothing where no cycle was found."""
    gap = dwell_gap(certificates, limit)
    if limit is None or limit.cycle is None or gap == inf:
        return []
    needed, cycle = limit.value * (1 + gap), " -> ".join(limit.cycle.locations)
    return [
        f"  dwell time needed without delay: {limit.value:.6g} s to {needed:.6g} s, a gap of {100 * gap:.2g} %;",
        f"    with stays of the first, the cycle {cycle} does not contract",
    ]


def forms_for(certificates: Sequence[Certificate], delay: float) -> InequalityCertificate | None:
    """Return the certificate by forms of the continuous observer for this delay (s), None where there is none."""
    plain = [entry for entry in certificates if isinstance(entry, InequalityCertificate) and entry.delay == delay]
    return next((entry for entry in plain if not entry.theorem.endswith("-sampled")), None)


def _of_kind(certificates: Sequence[Certificate], *, sampled: bool) -> list[Certificate]:
    kind = [entry for entry in certificates if entry.theorem.endswith("-sampled") == sampled]
    latest = max((entry.delay for entry in kind), default=0.0)
    return [entry for entry in kind if entry.delay == latest]


__all__ = [
    "Certificate",
    "deciding",
    "dwell_gap",
    "forms_for",
    "interval_lines",
    "is_certified",
    "known_limit",
    "least_required",
    "paper_certificates",
]
