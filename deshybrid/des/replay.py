"""Checks a witness against the model alone: nothing here uses the code that found it, nor D'_H, nor an observer.

In: a `DES` and a `Witness`.  Out: what is wrong with the witness, nothing where it proves its condition broken.
Idea: follow each run through the transitions as written.  Cost: length of the runs times number of transitions.
"""

from itertools import pairwise

from deshybrid.des.automaton import DES
from deshybrid.des.witness import Step, Witness


def replay_witness(des: DES, witness: Witness) -> bool:
    """Return whether the witness proves that `des` breaks the condition it names.

    >>> from deshybrid.des.observability import check_observability
    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> replay_witness(des, check_observability(des).witness)
    True
    """
    return not witness_faults(des, witness)


def witness_faults(des: DES, witness: Witness) -> tuple[str, ...]:
    """Return what is wrong with the witness, one sentence each; empty where it is a proof."""
    faults = [fault for number, run in enumerate(witness.runs) for fault in _run_faults(des, run, number)]
    faults += _cycle_faults(witness)
    if not faults:
        faults += _c1_faults(des, witness) if witness.condition == "C1" else _c2_faults(des, witness)
    return tuple(faults)


def _run_faults(des: DES, run: tuple[Step, ...], number: int) -> list[str]:
    arcs = {(t.source, t.event, t.target) for t in des.transitions}
    starts = bool(run) and run[0].location in des.initial
    faults = [] if starts else [f"run {number} does not start in an initial location"]
    for before, step in pairwise(run):
        if (before.location, step.event, step.location) not in arcs:
            faults.append(f"run {number} has no transition {before.location} -{step.event}-> {step.location}")
    return faults


def _cycle_faults(witness: Witness) -> list[str]:
    faults = [] if witness.runs else ["there is no run"]
    if len(witness.cycles) != len(witness.runs):
        faults.append("not every run has a cycle")
    for number, (run, (start, stop)) in enumerate(zip(witness.runs, witness.cycles, strict=False)):
        if not 0 <= start < stop < len(run) or run[start].location != run[stop].location:
            faults.append(f"the cycle of run {number} does not lead back to where it starts")
    return faults


def _c1_faults(des: DES, witness: Witness) -> list[str]:
    """A persistent location is left in silence: the outputs are all shown before the last step of the first run."""
    run = witness.runs[0]
    faults = [] if witness.cycles[0][1] < len(run) - 1 else ["the silent step is no exit after the cycle"]
    if not _silent_possible(des, run[-2], run[-1]):
        faults.append("the last step of the first run is never silent")
    if len(witness.runs) == 1 and run[-1].location != run[-2].location:
        faults.append("the run without its last step is missing")
    if len(witness.runs) > 1 and (witness.runs[1] != run[:-1] or run[-1].location == run[-2].location):
        faults.append("the second run is not the first one without its last step")
    if not _shows(des, run[:-1], witness, witness.cycles[0]):
        faults.append("the run cannot show the outputs")
    return faults


def _c2_faults(des: DES, witness: Witness) -> list[str]:
    """Two runs, both ending visibly, in different locations, with the same outputs, also on their cycles."""
    start, stop = witness.repeated
    faults = [] if len(witness.runs) == 2 else ["there are not two runs"]
    if len({run[-1].location for run in witness.runs}) < 2:
        faults.append("the runs end in the same location")
    if not 0 <= start < stop <= len(witness.outputs):
        faults.append("the cycle shows nothing")
    for number, (run, cycle) in enumerate(zip(witness.runs, witness.cycles, strict=True)):
        if not _shows(des, run, witness, cycle, visible_end=True):
            faults.append(f"run {number} cannot show the outputs")
    return faults


def _silent_possible(des: DES, before: Step, step: Step) -> bool:
    arc = (before.location, step.event, step.location)
    return any(None in t.seen for t in des.transitions if (t.source, t.event, t.target) == arc)


def _shows(
    des: DES, run: tuple[Step, ...], witness: Witness, cycle: tuple[int, int], *, visible_end: bool = False
) -> bool:
    """Whether the run can show all outputs, with exactly the repeated ones shown on its cycle."""
    marks = dict(zip(cycle, witness.repeated, strict=True))
    shown = {0} if marks.get(0, 0) == 0 else set()  # how many outputs may have been shown so far
    for position, (before, step) in enumerate(pairwise(run), start=1):
        arc = (before.location, step.event, step.location)
        seen = [output for t in des.transitions if (t.source, t.event, t.target) == arc for output in t.seen]
        silent = set(shown) if None in seen and not (visible_end and position == len(run) - 1) else set()
        texts = {str(output) for output in seen if output is not None}
        shown = silent | {n + 1 for n in shown if n < len(witness.outputs) and witness.outputs[n] in texts}
        if position in marks:
            shown &= {marks[position]}
    return len(witness.outputs) in shown


__all__ = ["replay_witness", "witness_faults"]
