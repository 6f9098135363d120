"""The answer of `recover`: the plan of signatures, with what the dynamics allow of them.

In: a plan, its candidates, the pairs of locations that it separates.  Out: a value with its messages and its text;
nothing is computed here.  Source: Balluchi et al. (2012), section 4.1.
"""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from deshybrid.des.observability import ObservabilityReport
from deshybrid.des.verdicts import unrecoverable
from deshybrid.diagnostics import Diagnostic
from deshybrid.diagnostics.pictured import Explained
from deshybrid.model.system import HybridSystem

if TYPE_CHECKING:
    from deshybrid.des.signatures import SignaturePlan
    from deshybrid.detector.candidates import FeasibleCandidate
    from deshybrid.detector.pairs import PairSeparation


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Recovery(Explained):
    """Stage 6: which signatures make the current location observable, and which of them the dynamics allow.

    `pairs`: how the locations are told apart that a signature has to separate; empty in a purely discrete model.
    """

    system: HybridSystem | None
    check: ObservabilityReport
    candidates: "tuple[FeasibleCandidate, ...]"
    plan: "SignaturePlan"
    pairs: "tuple[PairSeparation, ...]" = ()

    def _drawn(self) -> ObservabilityReport:
        return self.plan.report

    @property
    def locations_to_estimate(self) -> tuple[str, ...]:
        """The persistent locations: those whose continuous state an observer has to follow."""
        return self.plan.report.persistent

    @property
    def feasibility(self) -> Mapping[str, str]:
        """What the dynamics allow of each signature of the plan, by its name."""
        found = {entry.candidate.name: entry for entry in self.candidates}
        return {
            signature.name: found[signature.name].feasibility(signature.by, signature.transitions)
            for signature in self.plan.signatures
        }

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Why nothing helps, what a limit has left undecided, or which locations the signatures may confuse."""
        from deshybrid.detector.pairs import confusion_warnings

        if self.plan.recoverable:
            return self.plan.undecided + confusion_warnings(self.pairs if self.plan.signatures else ())
        left_out = tuple(verdict.reason for entry in self.candidates for verdict in entry.excluded)
        notes = tuple(f"no signature: {reason}" for reason in left_out)
        return tuple(replace(d, notes=d.notes + notes) for d in unrecoverable(self.plan.report))

    def __str__(self) -> str:
        from deshybrid.detector.pairs import hardest_line

        return "\n".join(filter(None, (str(self.plan), hardest_line(self.pairs if self.plan.signatures else ()))))

    def __repr__(self) -> str:
        return f"<Recovery of {self.plan.des.name}: recoverable={self.plan.recoverable}, signatures={self.plan.names}>"


__all__ = ["Recovery"]
