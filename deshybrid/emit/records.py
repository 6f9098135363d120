"""The JSON forms of the stages' values; their keys are a contract (see the documentation of the commands)."""

import json
from collections.abc import Mapping
from dataclasses import asdict

from deshybrid.des.observability import ObservabilityReport
from deshybrid.des.observer import LocationObserver
from deshybrid.des.signatures import SignaturePlan
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
    """Return what `recover --json` prints; `feasibility` by signature name: always, generic, never or unknown."""
    arcs = plan.des.transitions
    return {
        "recoverable": plan.recoverable,
        "already_observable": plan.already_observable,
        "signatures": [
            {
                "name": signature.name,
                "location": signature.location,
                "transitions": [[arcs[i].source, arcs[i].event, arcs[i].target] for i in signature.transitions],
                "by": signature.by,
                "feasibility": feasibility[signature.name],
            }
            for signature in plan.signatures
        ],
        "generators": len(plan.generators),
        "cost": plan.cost,
        "lower_bound": plan.lower_bound,
        "optimal": plan.optimal,
        "check": check_record(plan.report),
    }
