"""A negative verdict as coded messages: which condition fails, where in the model, and a run that anyone can replay.

In: an `ObservabilityReport`.  Out: at most one message for each of C1 (DH0401) and C2 (DH0402); further places where
the same condition fails are labels of the same message.  Cost: linear in the witness.
"""

from deshybrid.des.automaton import Transition
from deshybrid.des.observer import entry_estimates
from deshybrid.des.report import C2Failure, ObservabilityReport
from deshybrid.des.witness import Step, Witness
from deshybrid.diagnostics import Diagnostic, diagnostic

_VERDICT = "not current-location observable: "


def verdict_diagnostics(report: ObservabilityReport, *, proposal: tuple[str, ...] = ()) -> tuple[Diagnostic, ...]:
    """Return the messages of a negative verdict, none where the system is current-location observable.

    `proposal` names the signatures that a recovery found, for the help.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.observability import check_observability
    >>> from deshybrid.diagnostics import render
    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> print(render(verdict_diagnostics(check_observability(des), proposal=("s_5",))[0]))
    error[DH0401]: not current-location observable: an exit transition of persistent location `2` is unobservable (C1)
      = note: 2 -d-> 5 emits the null output
      = note: `2` is persistent: it lies on the cycle 2 -d-> 5 -a-> 2
      = note: after the run a d from `5` the plant is in `5`, the observer still says {2}
      = help: complement this transition with a signature; `deshybrid recover` proposes {s_5}
    """
    messages = (_c1_message(report, proposal), _c2_message(report, proposal))
    return tuple(message for message in messages if message is not None)


def unrecoverable(report: ObservabilityReport) -> tuple[Diagnostic, ...]:
    """Return the message that no signatures help (DH0403), from the report of the system with all candidates.

    None where that system is current-location observable.

    >>> from deshybrid.des.automaton import DES
    >>> from deshybrid.des.observability import check_observability
    >>> des = DES.from_transitions([("2", "d", "5", None), ("5", "a", "2", "α")])
    >>> [message.notes[0] for message in unrecoverable(check_observability(des))]
    ['with all of them, an exit transition of persistent location `2` is still unobservable (C1)']
    """
    return tuple(
        diagnostic(
            "DH0403",
            "no set of the candidate signatures makes the system current-location observable",
            message.span,
            message.labels[0].text if message.labels else "",
            notes=(_still(message), *message.notes),
        )
        for message in verdict_diagnostics(report)[:1]
    )


def _still(message: Diagnostic) -> str:
    fact = message.message.removeprefix(_VERDICT).replace(" is ", " is still ", 1)
    return f"with all of them, {fact}"


def _c1_message(report: ObservabilityReport, proposal: tuple[str, ...]) -> Diagnostic | None:
    if not report.c1_failures:
        return None
    first, *others = report.c1_failures
    places = [first.output_span or first.span] + [other.output_span or other.span for other in others]
    labels = [_silence(transition, place is None) for transition, place in zip(report.c1_failures, places, strict=True)]
    witness = report.witness
    notes = () if witness is None else (_cycle_note(first.source, witness), _c1_run_note(report, witness))
    return diagnostic(
        "DH0401",
        f"{_VERDICT}an exit transition of persistent location `{first.source}` is unobservable (C1)",
        places[0],
        labels[0],
        context=tuple(zip(places[1:], labels[1:], strict=True)),
        notes=notes,
        helps=(_advice("complement this transition with a signature", proposal),),
    )


def _silence(transition: Transition, homeless: bool) -> str:
    verb = "emits" if set(transition.outputs) == {None} else "may emit"
    arc = f"{transition.source} -{transition.event}-> {transition.target} " if homeless else ""
    return f"{arc}{verb} the null output"


def _cycle_note(location: str, witness: Witness) -> str:
    start, stop = witness.cycles[0]
    steps = witness.runs[0][start + 1 : stop + 1]
    places = [step.location for step in steps]
    if location not in places:
        return f"`{location}` is persistent: it is reached from the cycle {_arrows(places[-1], steps)}"
    turn = places.index(location) + 1  # tell the cycle from that location on
    return f"`{location}` is persistent: it lies on the cycle {_arrows(location, steps[turn:] + steps[:turn])}"


def _c1_run_note(report: ObservabilityReport, witness: Witness) -> str:
    """The run without its cycle is a run too, and a shorter one to read."""
    (start, stop), run = witness.cycles[0], witness.runs[0]
    short = run[: start + 1] + run[stop + 1 :]
    outputs = witness.outputs[: witness.repeated[0]] + witness.outputs[witness.repeated[1] :]
    said = ",".join(entry_estimates(report.automaton, outputs)[-1])
    plant = short[-1].location
    if plant == short[-2].location:
        return f"the observer does not see the last step of the run {_events(short)} from `{short[0].location}`"
    told = f"after the run {_events(short)} from `{short[0].location}` the plant is in `{plant}`"
    if plant in said.split(","):
        return f"{told}, but of the last step the observer sees nothing: its entry estimate stays {{{said}}}"
    return f"{told}, the observer still says {{{said}}}"


def _c2_message(report: ObservabilityReport, proposal: tuple[str, ...]) -> Diagnostic | None:
    """Locations that are entered silently only are left to the message of C1, which is their cause."""
    confused = [failure for failure in report.c2_failures if failure.observer_states]
    if not confused:
        return None
    spans = [report.des.location_spans.get(failure.location) for failure in confused]
    facts = [_confusion_note(failure, report.method) for failure in confused]
    return diagnostic(
        "DH0402",
        f"{_VERDICT}persistent location `{confused[0].location}` is confused with another for ever (C2)",
        spans[0],
        facts[0],
        context=tuple(zip(spans[1:], facts[1:], strict=True)),
        notes=() if report.witness is None else _c2_run_notes(report.witness),
        helps=(_advice("complement a transition into one of them with a signature", proposal),),
    )


def _confusion_note(failure: C2Failure, method: str) -> str:
    if method == "pairs":
        others = (name for state in failure.observer_states for name in state if name != failure.location)
        return f"`{failure.location}` is confused with {', '.join(f'`{name}`' for name in others)}"
    states = ", ".join("{" + ",".join(state) + "}" for state in failure.observer_states)
    return f"`{failure.location}` is in the persistent observer state {states}"


def _c2_run_notes(witness: Witness) -> tuple[str, ...]:
    if witness.condition != "C2":
        return ()
    first, second = witness.runs
    start, stop = witness.repeated
    return (
        f"the run {_events(first)} from `{first[0].location}` ends in `{first[-1].location}`, "
        f"the run {_events(second)} from `{second[0].location}` in `{second[-1].location}`; "
        f"both show {' '.join(witness.outputs)}",
        f"the part that shows {' '.join(witness.outputs[start:stop])} can be repeated in both runs for ever",
    )


def _advice(change: str, proposal: tuple[str, ...]) -> str:
    proposed = f"proposes {{{','.join(proposal)}}}" if proposal else "finds the cheapest set"
    return f"{change}; `deshybrid recover` {proposed}"


def _events(run: tuple[Step, ...]) -> str:
    return " ".join(step.event for step in run[1:])


def _arrows(start: str, steps: tuple[Step, ...]) -> str:
    return start + "".join(f" -{step.event}-> {step.location}" for step in steps)


__all__ = ["unrecoverable", "verdict_diagnostics"]
