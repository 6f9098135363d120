"""Plans of signatures as the commands tell them: `recover` with all that it prints, `verify` with the model it names.

In: a model, or the JSON of a plan.  Out: values with a text, a JSON tree, and messages.  Cost: that of the stages.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from deshybrid.compiler import Recovery, Source, recover, to_system
from deshybrid.detector.candidates import offers
from deshybrid.diagnostics import Diagnostic, UsageError, diagnostic
from deshybrid.emit.records import minimum_record, plan_parts, recover_record

if TYPE_CHECKING:
    from deshybrid.des.minimum import MinimumSets
    from deshybrid.verify import VerifyReport


@dataclass(frozen=True, slots=True)
class Answer:
    """What `recover` answers; `minimum` holds all cheapest sets, None where they were not asked for."""

    recovery: Recovery
    minimum: "MinimumSets | None"

    @property
    def decided(self) -> bool:
        """False where a limit was reached before the plan was proven cheapest, or before all sets were found."""
        plan = self.recovery.plan
        return not plan.recoverable or (plan.optimal and (self.minimum is None or self.minimum.complete))

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """Why nothing helps, or what is undecided."""
        return self.recovery.diagnostics + (() if self.minimum is None else self.minimum.undecided)

    def record(self) -> dict[str, object]:
        """Return the answer as a JSON tree."""
        record = recover_record(self.recovery.plan, self.recovery.feasibility)
        record |= {"pairs": [pair.record() for pair in self.recovery.pairs]}
        return record if self.minimum is None else record | minimum_record(self.minimum)

    def __str__(self) -> str:
        return f"{self.recovery}" if self.minimum is None else f"{self.recovery}\n{self.minimum}"


def answer(source: Source, *, max_states: int, seconds: float | None = None, most: int = 0) -> Answer:
    """Return the cheapest signatures of a model, and up to `most` sets that cost the same.

    >>> print(answer("models/balluchi2012/fig3.yaml", max_states=1000, most=10).minimum)
    2 cheapest sets
      {s_3} with 3
      {s_4} with 4
    """
    from deshybrid.des.minimum import minimum_sets_of

    recovery = recover(source, max_states=max_states, seconds=seconds)
    return Answer(recovery, minimum_sets_of(recovery.plan, most=most, seconds=seconds) if most else None)


def verify_tree(document: Mapping[str, object], model: Source | None = None) -> "VerifyReport":
    """Return what is proved of a design or a plan; a plan may have to be for a certain model.

    Raises `UsageError` (DH0408) where a model is given for something else than a plan.
    """
    from deshybrid.verify import is_plan, verify_design, verify_plan

    if is_plan(document):
        return verify_plan(document, None if model is None else _parts(model))
    if model is not None:
        raise UsageError(diagnostic("DH0408", "`--model` goes with a plan of `recover`, and this is none"))
    return verify_design(document)


def _parts(model: Source) -> dict[str, object]:
    found = offers(to_system(model))
    return plan_parts(found.des, (entry.candidate for entry in found.candidates))


__all__ = ["Answer", "answer", "verify_tree"]
