"""The answer of a recovery: signatures, what they cost, and the constraints that prove that nothing cheaper works.

In: what `signatures` found.  Out: values that can be read and printed; nothing is computed here.
Source: Balluchi et al. (2012), section 4.1.
"""

from dataclasses import dataclass
from typing import Literal

from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate
from deshybrid.des.report import ObservabilityReport
from deshybrid.des.separation import Shown
from deshybrid.des.witness import Witness
from deshybrid.diagnostics import Diagnostic, diagnostic
from deshybrid.diagnostics.pictured import Explained


@dataclass(frozen=True, slots=True)
class Signature:
    """A signature of a plan: emitted on `transitions` (numbers), by a residual generator or by negation.

    `covers`: the locations of a covering detector, joined by `|` in `location`.
    """

    name: str
    location: str
    transitions: tuple[int, ...]
    by: Literal["residual", "negation"]
    covers: tuple[str, ...] = ()

    def __str__(self) -> str:
        return self.name


@dataclass(frozen=True, slots=True)
class Constraint:
    """What every plan must have: a signature of its own on one of `transitions`, or one of the covering `detectors`.

    `runs` force it.  C2: two runs that show the same under every other signature, up to their cycles (`cycles[r]` are
    positions in run r), on them and after them, and that end in different locations.  C1: one run, with a cycle, whose
    last step, out of a persistent location, is silent under every other signature.
    """

    condition: Literal["C1", "C2"]
    transitions: tuple[int, ...]
    detectors: tuple[str, ...]
    runs: tuple[tuple[Shown, ...], ...]
    cycles: tuple[tuple[int, int], ...]

    def __len__(self) -> int:
        return len(self.transitions) + len(self.detectors)


@dataclass(frozen=True, slots=True)
class SignaturePlan(Explained):
    """The answer of `recover_observability`; everything in order of declaration.

    `generators` are the locations that need a residual generator, and the names of covering detectors; `cost` is what
    these cost, `lower_bound` what every plan costs at least, as the `constraints` prove.  `optimal`: the two are equal.
    `fewest`: nothing of the same cost is better in the further objectives either; false where a limit was reached.
    `report` is that of the complementary DES; where nothing helps (`recoverable` is false, no cost), it is that of the
    system with all candidates, and `confused` shows what remains.
    """

    des: DES
    candidates: tuple[Candidate, ...]
    recoverable: bool
    already_observable: bool
    signatures: tuple[Signature, ...]
    generators: tuple[str, ...]
    cost: float | None
    lower_bound: float | None
    optimal: bool
    fewest: bool
    constraints: tuple[Constraint, ...]
    confused: Witness | None
    complementary: DES | None
    report: ObservabilityReport

    def _drawn(self) -> ObservabilityReport:
        return self.report

    @property
    def names(self) -> str:
        """The names of the signatures as a set, as the papers write it."""
        return "{" + ",".join(signature.name for signature in self.signatures) + "}"

    @property
    def gap(self) -> float | None:
        """What a cheaper plan could save at most, as a share of the cost; 0 where the plan is proven cheapest."""
        if self.cost is None or self.lower_bound is None:
            return None
        return 0.0 if self.optimal else (self.cost - self.lower_bound) / self.cost

    @property
    def undecided(self) -> tuple[Diagnostic, ...]:
        """The warning that a limit was reached before the plan was proven cheapest (DH0902); none where it is."""
        if not self.recoverable or (self.optimal and self.fewest):
            return ()
        if self.optimal:
            text = "these signatures cost least, but whether fewer transitions could carry them is undecided"
            return (diagnostic("DH0902", text, severity="warning"),)
        facts = f"every plan costs at least {self.lower_bound:g}, this one costs {self.cost:g}"
        text = "whether cheaper signatures exist is undecided: a limit was reached"
        return (diagnostic("DH0902", text, notes=(facts,), helps=("allow more time with `--timeout`",)),)

    def __str__(self) -> str:
        if self.already_observable:
            return f"{self.des.name}: current-location observable without signatures"
        if not self.recoverable:
            return f"{self.des.name}: no set of the candidate signatures makes it current-location observable"
        lines = [f"{self.des.name}: current-location observable with signatures {self.names}"]
        for signature in self.signatures:
            taken = (self.des.transitions[number] for number in signature.transitions)
            arcs = ", ".join(f"{t.source} -{t.event}-> {t.target}" for t in taken)
            way = f"one detector of {signature.location}" if signature.covers else signature.by
            lines.append(f"  {signature.name} by {way} on {arcs}")
        kind = "residual generators" if not any(s.covers for s in self.signatures) else "generators and detectors"
        proof = "proven least" if self.optimal else f"at least {self.lower_bound:g} is needed"
        lines.append(f"  {kind}: {', '.join(self.generators) or 'none'}; cost {self.cost:g}, {proof}")
        return "\n".join(lines)

    def __repr__(self) -> str:
        return (
            f"<SignaturePlan of {self.des.name}: recoverable={self.recoverable}, signatures={self.names}, "
            f"generators={len(self.generators)}, cost={self.cost}>"
        )


__all__ = ["Constraint", "Signature", "SignaturePlan"]
