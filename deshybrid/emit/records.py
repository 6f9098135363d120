"""The JSON forms of the stages' values; their keys are a contract (see the documentation of the commands)."""

import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict

from deshybrid.des.automaton import DES, Output, Transition
from deshybrid.des.candidates import Candidate
from deshybrid.des.minimum import MinimumSets
from deshybrid.des.observability import ObservabilityReport
from deshybrid.des.observer import LocationObserver
from deshybrid.des.plan import Constraint, Signature, SignaturePlan
from deshybrid.des.separation import Shown
from deshybrid.des.witness import Witness


def to_json(record: Mapping[str, object]) -> str:
    """Return a record as JSON text, names as written, keys in the order of the contract, with a last newline.

    >>> to_json({"name": "Σ"})
    '{\\n  "name": "Σ"\\n}\\n'
    """
    return json.dumps(record, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def check_record(report: ObservabilityReport) -> dict[str, object]:
    """Return what `check --json` prints (format `deshybrid-check/1`), with `undecided` where a limit was reached."""
    des, stopped = report.des, report.undecided
    record: dict[str, object] = {
        "format": "deshybrid-check/1",
        "name": des.name,
        "locations": len(des.locations),
        "transitions": len(des.transitions),
        "alive": report.alive,
        "persistent": list(report.persistent),
        "current_location_observable": report.current_location_observable,
        "transient_bound": report.transient_bound,
        "c1_failures": [{"from": t.source, "to": t.target, "event": t.event} for t in report.c1_failures],
        "c2_failures": [
            {"location": failure.location, "observer_states": [list(state) for state in failure.observer_states]}
            for failure in report.c2_failures
        ],
        "witness": None if report.witness is None else _witness_record(report.witness),
        "method": report.method,
        "observer": None if report.observer is None else _observer_record(report.observer),
    }
    return record if stopped is None else {**record, "undecided": asdict(stopped)}


def _witness_record(witness: Witness) -> dict[str, object]:
    return {
        "condition": witness.condition,
        "outputs": list(witness.outputs),
        "runs": [[[step.event, step.location] for step in run] for run in witness.runs],
    }


def _observer_record(observer: LocationObserver) -> dict[str, object]:
    return {
        "states": [list(state) for state in observer.states],
        "initial": observer.initial,
        "transitions": [[source, str(output), target] for source, output, target in observer.transitions],
        "persistent": list(observer.persistent),
    }


def recover_record(plan: SignaturePlan, feasibility: Mapping[str, str]) -> dict[str, object]:
    """Return what `recover --json` prints; `feasibility` by signature name: always, generic, never or unknown.

    What comes after `check` is what `verify` needs: numbers of transitions are places in `system.transitions`.
    """
    return {
        "recoverable": plan.recoverable,
        "already_observable": plan.already_observable,
        "signatures": [
            signature_record(plan.des, signature) | {"feasibility": feasibility[signature.name]}
            for signature in plan.signatures
        ],
        "generators": len(plan.generators),
        "cost": plan.cost,
        "lower_bound": plan.lower_bound,
        "optimal": plan.optimal,
        "check": check_record(plan.report),
        "gap": plan.gap,
        "fewest": plan.fewest,
        "generator_names": list(plan.generators),
        "instrumented": {signature.name: list(signature.transitions) for signature in plan.signatures},
        **plan_parts(plan.des, plan.candidates),
        "constraints": [_constraint_record(constraint) for constraint in plan.constraints],
    }


def signature_record(des: DES, signature: Signature) -> dict[str, object]:
    """Return a signature of a plan; `covers` is there for a detector of several locations only."""
    arcs = [des.transitions[number] for number in signature.transitions]
    return {
        "name": signature.name,
        "location": signature.location,
        **({"covers": list(signature.covers)} if signature.covers else {}),
        "transitions": [[arc.source, arc.event, arc.target] for arc in arcs],
        "by": signature.by,
    }


def system_record(des: DES) -> dict[str, object]:
    """Return the DES that a plan is for; an output null is ε.  A fifth entry of a transition lists its commands."""
    return {
        "locations": list(des.locations),
        "initial": list(des.initial),
        "transitions": [_transition_record(t) for t in des.transitions],
    }


def _transition_record(t: Transition) -> list[object]:
    outputs = list(dict.fromkeys(_text(shown) for shown in t.occurrences))
    return [t.source, t.event, t.target, outputs, *([list(t.commands)] if t.commands else [])]


def candidate_records(candidates: Iterable[Candidate]) -> list[dict[str, object]]:
    """Return the candidates that a plan was chosen from."""
    return [
        {
            "name": candidate.name,
            "locations": list(candidate.entered),
            "covering": bool(candidate.covers),
            "transitions": list(candidate.transitions),
            "cost": candidate.cost,
            "residual": candidate.residual,
            "negation": candidate.negation,
        }
        for candidate in candidates
    ]


def plan_parts(des: DES, candidates: Iterable[Candidate]) -> dict[str, object]:
    """Return the parts of a plan that come from its model."""
    return {"system": system_record(des), "candidates": candidate_records(candidates)}


def minimum_record(found: MinimumSets) -> dict[str, object]:
    """Return what `recover --all --json` adds."""
    des = found.plan.des
    sets = [
        {"signatures": [signature_record(des, s) for s in one.signatures], "generator_names": list(one.generators)}
        for one in found.sets
    ]
    return {"minimum_sets": sets, "all_minimum_sets": found.complete}


def _constraint_record(constraint: Constraint) -> dict[str, object]:
    return {
        "condition": constraint.condition,
        "transitions": list(constraint.transitions),
        "detectors": list(constraint.detectors),
        "runs": [[_step_record(step) for step in run] for run in constraint.runs],
        "cycles": [list(cycle) for cycle in constraint.cycles],
    }


def _step_record(step: Shown) -> list[object]:
    command = None if step.output is None else step.output.command
    return [step.transition, _text(step.output), *([] if command is None else [command])]


def _text(output: Output | None) -> str | None:
    """What is seen beside the command."""
    return None if output is None or output.is_nothing else str(output._replace(command=None))
