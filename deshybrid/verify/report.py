"""What a verifier says: one entry per claim that was checked, and what was not.

In: the outcome of every check.  Out: a `VerifyReport`, which holds where all that is claimed is proved.
"""

from dataclasses import dataclass
from typing import NamedTuple

UNCHECKED = ("the model itself",)
"""What no report of a design checks: also that no reset or location of the model is missing in the file."""


class Check(NamedTuple):
    """One inequality: the certificate and location it belongs to, what it says, and whether it was proved."""

    certificate: str
    location: str
    inequality: str
    proved: bool


@dataclass(frozen=True, slots=True)
class VerifyReport:
    """What was proved.  `silent`: certificates that do not claim to hold, of which nothing was checked.

    `unchecked`: every key of the file that is not checked here, and what else is not, with a `doubt` that follows in
    the text.  `what` was checked: inequalities of certificates, claims of a plan.

    `holds`: at least one certificate claims to hold, and every inequality of those that do was proved.
    """

    checks: tuple[Check, ...]
    silent: tuple[str, ...]
    unchecked: tuple[str, ...] = UNCHECKED
    what: str = "inequalities"
    doubt: str = "; whether a reset or location was left out"

    @property
    def holds(self) -> bool:
        """True where something is claimed and all that is claimed is proved."""
        return bool(self.checks) and all(check.proved for check in self.checks)

    @property
    def refused(self) -> tuple[Check, ...]:
        """The inequalities that could not be proved."""
        return tuple(check for check in self.checks if not check.proved)

    def record(self) -> dict[str, object]:
        """Return the report as a JSON tree."""
        checks = [check._asdict() for check in self.checks]
        return {
            "format": "deshybrid-verify/1",
            "holds": self.holds,
            "checks": checks,
            "silent": list(self.silent),
            "unchecked": list(self.unchecked),
        }

    def __str__(self) -> str:
        if not self.checks:
            return "nothing verified: no certificate of this design claims to hold"
        lines = [f"refused: {c.certificate}, {c.location}: not proved: {c.inequality}" for c in self.refused]
        lines += [f"not claimed: {name}" for name in self.silent]
        lines.append("not checked: " + ", ".join(self.unchecked) + self.doubt)
        verdict = "refused" if self.refused else "verified"
        proved = len(self.checks) - len(self.refused)
        return "\n".join([f"{verdict}: {proved} of {len(self.checks)} {self.what} proved in exact arithmetic", *lines])


__all__ = ["UNCHECKED", "Check", "VerifyReport"]
