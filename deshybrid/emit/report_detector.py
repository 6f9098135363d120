"""How the report says of each signature from which residual it is made, and what decides.

In: a `TransitionDetector`.  Out: sentences; what stands between backticks is a name.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from deshybrid.emit.report_numbers import number, seconds

if TYPE_CHECKING:
    from deshybrid.des.signatures import Signature
    from deshybrid.detector.detector import TransitionDetector

_TESTS = {"sprt": "probability ratio test", "glr": "likelihood ratio test"}


@dataclass(frozen=True, slots=True)
class SignatureDesign:
    """One signature: its name, the design of its residual, and what decides that it comes."""

    signature: str
    residual: str
    decision: str


def signature_designs(detector: "TransitionDetector") -> tuple[SignatureDesign, ...]:
    """Return the design of each signature of the plan; none where signatures come as events.

    >>> import deshybrid as dh
    >>> for found in signature_designs(dh.design("models/two_tank.yaml").detector):
    ...     print(f"{found.residual}; {found.decision}")
    Luenberger observer, poles placed; exclusion: every alternative beyond its bound for 0.36 s
    """
    if not detector.generators:
        return ()
    return tuple(
        SignatureDesign(signature.name, _residual(detector, signature), _decision(detector, signature))
        for signature in detector.plan.signatures
    )


def _residual(detector: "TransitionDetector", signature: "Signature") -> str:
    if detector.decision.kind != "imm" and signature.by == "negation":
        return "none of its own: a negation of the residuals of the alternatives"
    return next(g.design for g in detector.generators if g.location.name == signature.location)


def _decision(detector: "TransitionDetector", signature: "Signature") -> str:
    design, step = detector.decision, detector.step
    long = seconds(design.exclude_ticks * step)
    if design.kind == "exclusion":
        return f"exclusion: every alternative beyond its bound for {long}"
    if design.bank is not None:
        return f"interacting filters: a probability of {number(design.bank.confidence)} at least"
    if design.kind in _TESTS:
        rate = f"{number(design.false_alarm)} false alarms a second"
        return f"{_TESTS[design.kind]} ({design.kind}, {rate}): every alternative denied for {long}"
    if signature.by == "negation":
        return "relay: those of the alternatives are off"
    place = next(g for g, made in enumerate(detector.generators) if made.location.name == signature.location)
    waits = seconds(detector.on_ticks[place] * step)
    return f"relay: below the threshold in every output for {waits}, and those of the alternatives are off"


__all__ = ["SignatureDesign", "signature_designs"]
