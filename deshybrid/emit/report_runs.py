"""Runs side by side: what happened, what was seen, and what the observer said, one row for each output.

In: an `ObservabilityReport` with a witness.  Out: the rows of a table that anyone can follow with a finger.
Idea: every step of a run either shows the next output or is silent; which, is found by dynamic programming over the
number of outputs shown so far, and the marks of the repeatable part are kept.  Cost: steps times outputs of the run.
Source: Balluchi et al. (2012), section 3.1 (why C1 and C2 are necessary).
"""

from dataclasses import dataclass
from itertools import pairwise

from deshybrid.des.automaton import DES
from deshybrid.des.observer import entry_estimates
from deshybrid.des.report import ObservabilityReport
from deshybrid.des.witness import Step, Witness


@dataclass(frozen=True, slots=True)
class RunRow:
    """One row: the output seen (None: nothing), the steps of each run up to it, and the entry estimate after it.

    `repeatable` rows form the cycle that can be gone through again and again.
    """

    seen: str | None
    steps: tuple[tuple[Step, ...], ...]
    estimate: tuple[str, ...]
    repeatable: bool


def witness_rows(report: ObservabilityReport) -> tuple[RunRow, ...]:
    """Return the rows of the report's witness; none where the verdict is yes.

    >>> from deshybrid.des.observability import check_observability
    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> last = witness_rows(check_observability(des))[-1]
    >>> last.seen, [[step.location for step in steps] for steps in last.steps], last.estimate
    (None, [['5'], []], ('2',))
    """
    witness = report.witness
    if witness is None:
        return ()
    columns = [_by_output(report.des, witness, number) for number in range(len(witness.runs))]
    estimates = entry_estimates(report.automaton, witness.outputs)
    first, last = witness.repeated
    rows = [
        RunRow(witness.outputs[k - 1] if k else None, tuple(c[k] for c in columns), estimates[k], first < k <= last)
        for k in range(len(witness.outputs) + 1)
    ]
    silent_end = tuple(column[-1] for column in columns)
    return (*rows, RunRow(None, silent_end, estimates[-1], False)) if any(silent_end) else tuple(rows)


def _by_output(des: DES, witness: Witness, number: int) -> list[tuple[Step, ...]]:
    """The steps of a run in groups: the start, the steps up to output 1, up to output 2, ..., and those after the last.

    Every group but the first and the last ends with the step that shows the output.
    """
    run = witness.runs[number]
    shown = _shown_after(des, witness, number)
    groups: list[list[Step]] = [[] for _ in range(len(witness.outputs) + 2)]
    groups[0].append(run[0])
    for position in range(1, len(run)):
        visible = shown[position] > shown[position - 1]
        groups[shown[position] if visible else shown[position] + 1].append(run[position])
    return [tuple(group) for group in groups]


def _shown_after(des: DES, witness: Witness, number: int) -> list[int]:
    """How many outputs have been shown after each step of the run, consistent with its repeatable part."""
    run, outputs = witness.runs[number], witness.outputs
    marks = dict(zip(witness.cycles[number], witness.repeated, strict=True))
    possible = [{0}]
    for position, (before, step) in enumerate(pairwise(run), start=1):
        silent, texts = _seen(des, before, step)
        reached = {n for n in possible[-1] if silent}
        reached |= {n + 1 for n in possible[-1] if n < len(outputs) and outputs[n] in texts}
        possible.append(reached & {marks[position]} if position in marks else reached)
    return _backwards(des, run, outputs, possible)


def _backwards(des: DES, run: tuple[Step, ...], outputs: tuple[str, ...], possible: list[set[int]]) -> list[int]:
    """Walk back from all outputs shown, taking the last step as visible where it can be."""
    shown = [len(outputs)]
    for position in range(len(run) - 1, 0, -1):
        _, texts = _seen(des, run[position - 1], run[position])
        here = shown[-1]
        visible = here > 0 and here - 1 in possible[position - 1] and outputs[here - 1] in texts
        shown.append(here - 1 if visible else here)
    return shown[::-1]


def _seen(des: DES, before: Step, step: Step) -> tuple[bool, frozenset[str]]:
    """Whether the step may be silent, and the outputs that it may show."""
    arc = (before.location, step.event, step.location)
    seen = [output for t in des.transitions if (t.source, t.event, t.target) == arc for output in t.seen]
    return None in seen, frozenset(str(output) for output in seen if output is not None)


def run_text(steps: tuple[Step, ...]) -> str:
    """Return steps as `event → location` texts, as they follow each other.

    >>> run_text((Step("c", "3"), Step("a", "0")))
    'c → 3, a → 0'
    """
    return ", ".join(f"{step.event} → {step.location}" if step.event else step.location for step in steps)
