"""The hybrid observer H_O: location observer, transition detector and switching Luenberger observer in one pure step.

In: a hybrid system, its `SignaturePlan`, the detector, the gains, a step.  Out: a `HybridObserver`: the constants of a
step as `StepTables`, and the values they were made from.  `start` and `step` run the reference step (`reference`),
which the generated C and Python equal bit for bit; they take a state and return another, and raise on no sample.

Source: Balluchi et al. (2012), section 4.2, Figure 10.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any, TypeAlias

from deshybrid.continuous.certified import Certificate
from deshybrid.continuous.gains import ObserverGains
from deshybrid.des.automaton import Output
from deshybrid.des.signatures import SignaturePlan
from deshybrid.detector.detector import TransitionDetector
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.model.system import HybridSystem
from deshybrid.observer import MAX_TABLE, judgement, reference
from deshybrid.observer.filling import fill_decision, fill_flow, fill_generators, fill_resets
from deshybrid.observer.judgement import Scale
from deshybrid.observer.tables import STATUS_NAMES, StepTables, plain_tables
from deshybrid.observer.tracker import CommandNeeds, Tracker, choose_tracker, outputs_of

ObserverState: TypeAlias = reference.State
UNKNOWN_EVENT = -1


@dataclass(frozen=True, slots=True)
class Estimate:
    """What the observer says after one sample.

    `location`: the current location, None while it is not known for certain; `identified`: whether it is known;
    `entry_estimate`: the locations that may have been entered when the last output was seen; `signature`: the one that
    fired at this sample; `status`: one of `STATUS_NAMES`; `state`: the estimate x̂ (n numbers).
    """

    location: str | None
    entry_estimate: tuple[str, ...]
    identified: bool
    signature: str | None
    status: str
    state: tuple[float, ...]


@dataclass(frozen=True, eq=False)
class HybridObserver:
    """H_O: a step over `tables`, and the values that the tables were made from."""

    system: HybridSystem
    plan: SignaturePlan
    detector: TransitionDetector | None
    gains: ObserverGains | None
    tables: StepTables
    certificates: tuple[Certificate, ...] = ()
    max_states: int = MAX_TABLE
    _plain: dict[str, Any] = field(init=False, repr=False)
    _codes: dict[str, int] = field(init=False, repr=False)
    _shown: dict[str, str] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_plain", plain_tables(self.tables))
        object.__setattr__(self, "_codes", {name: code + 1 for code, name in enumerate(self.tables.event_names)})
        object.__setattr__(self, "_shown", _signatures_in_events(self.plan) if self.system.is_discrete else {})

    @property
    def tracker_reason(self) -> str:
        """How the location observer runs, by a table or on line, and why."""
        if self.tables.online is None:
            return f"a table of {_states(len(self.tables.tracker))}, the limit is {self.max_states}"
        pairs = f"on line, a set of up to {self.tables.online.pairs} pairs"
        if self.tables.commands:
            return f"{pairs}; the commands decide what is possible"
        return f"{pairs}; a table would have more than {_states(self.max_states)}"

    @property
    def step_seconds(self) -> float:
        """The time between two samples."""
        return self.tables.step

    def start(self) -> ObserverState:
        """Return the state before the first sample."""
        return reference.start(self._plain)

    def step(
        self,
        state: ObserverState,
        input: Sequence[float],
        output: Sequence[float],
        event: str | None,
        command: Sequence[str | None] = (),
    ) -> tuple[ObserverState, Estimate]:
        """Take one sample: m inputs, p outputs, and the discrete output seen since the previous sample, if any.

        `command`: the value of each command, None or a value that the model does not know where it is unknown; without
        it all are.  Nothing in a sample raises: numbers that are not finite give the status `invalid`, events that
        nothing explains (or that the model does not know) give `inconsistent` and a restart.  Raises `UsageError`
        (DH0607) where the number of inputs, outputs or commands is wrong.
        """
        self._require_widths(input, output, command)
        code = 0 if not event else self._codes.get(event, UNKNOWN_EVENT)
        tables = self.tables
        values = zip(tables.commands, command or [None] * len(tables.commands), strict=True)
        given = tuple(known.index(value) + 1 if value in known else 0 for (_, known), value in values)
        sample = tuple(float(value) for value in input), tuple(float(value) for value in output)
        after, said = reference.step(self._plain, state, *sample, code, command=given)
        location, tracker, signature, status, x = said
        estimate = Estimate(
            location=tables.location_names[location] if location >= 0 else None,
            entry_estimate=tuple(tables.location_names[i] for i in self._plain["tracker"].entry_estimate(tracker)),
            identified=location >= 0,
            signature=self._signature(signature, event),
            status=STATUS_NAMES[status],
            state=x,
        )
        return after, estimate

    @property
    def scales(self) -> tuple[Scale, ...]:
        """What each residual generator is judged by, in the order of `tables.generators`."""
        return judgement.scales(self._plain, self.tables.output_names)

    def judged(self, before: ObserverState, after: ObserverState) -> tuple[tuple[float, ...], ...]:
        """Return by generator the numbers of its scale, from the states before and after a step with a valid sample."""
        return judgement.judged(self._plain, before, after)

    def _signature(self, number: int, event: str | None) -> str | None:
        if number >= 0:
            return self.tables.signature_names[number]
        return self._shown.get(event) if event else None

    def _require_widths(self, input: Sequence[float], output: Sequence[float], command: Sequence[str | None]) -> None:
        wanted = len(self.tables.input_names), len(self.tables.output_names)
        if (len(input), len(output)) != wanted:
            message = (
                f"a sample has {len(input)} inputs and {len(output)} outputs, expected {wanted[0]} and {wanted[1]}"
            )
            raise UsageError(diagnostic("DH0607", message))
        if len(command) not in (0, len(self.tables.commands)):
            message = f"a sample has {len(command)} commands, expected {len(self.tables.commands)}"
            raise UsageError(diagnostic("DH0607", message))

    def __repr__(self) -> str:
        shown = "on-line tracker" if self.tables.online else f"{len(self.tables.tracker)} tracker states"
        return (
            f"<HybridObserver of {self.system.name}: {shown}, "
            f"{len(self.tables.generators.locations)} residual generators, step {self.tables.step:g} s>"
        )


def build_observer(
    system: HybridSystem,
    plan: SignaturePlan,
    detector: TransitionDetector | None,
    gains: ObserverGains | None,
    *,
    step: float,
    certificates: tuple[Certificate, ...] = (),
    max_states: int = MAX_TABLE,
) -> HybridObserver:
    """Return the hybrid observer of a plan that makes the location observable; step in seconds.

    A purely discrete model needs neither detector nor gains: its signatures come as events, and a sample is a row.
    Where a location has no gain, its continuous estimate is held.  The location observer is a table of up to
    `max_states` states; where there are more, the on-line tracker takes its place and gives the same estimates.

    Raises `UsageError` (DH0608) where the plan recovers nothing or a detector is missing, `ModelError` (DH0605) for two
    resets between the same locations, `GainError` (DH0606) where the step is too long for a gain.

    >>> from deshybrid.des.signatures import recover_observability
    >>> from deshybrid.model.abstraction import abstract
    >>> from deshybrid.model.load import loads
    >>> system = loads('''
    ... {format: deshybrid/1, name: pump, locations: [on, off],
    ...  transitions: [{from: on, to: off, event: a, emits: α}, {from: off, to: on, event: b, emits: β}]}
    ... ''')
    >>> observer = build_observer(system, recover_observability(abstract(system), ()), None, None, step=1.0)
    >>> state, estimate = observer.step(observer.start(), (), (), "α")
    >>> estimate.location, estimate.status
    ('off', 'identified')
    """
    _require_plan(system, plan, detector)
    delays = {} if detector is None else detector.delays
    certain = frozenset(name for name, d in delays.items() if d.seconds is not None and not d.condition)
    tracker = choose_tracker(
        plan,
        signatures_are_events=system.is_discrete,
        guaranteed=certain,
        needs=command_needs(system),
        generators=None if detector is None else tuple(g.location.name for g in detector.generators),
        max_states=max_states,
    )
    tables = _tables(system, plan, detector, gains, tracker, step=step)
    return HybridObserver(system, plan, detector, gains, tables, certificates, max_states)


def command_needs(system: HybridSystem) -> CommandNeeds:
    """Return the commands of a model as the tracker knows them.

    >>> from deshybrid.model.load import loads
    >>> command_needs(loads('''
    ... {format: deshybrid/1, commands: {lever: [P, D]}, locations: [on], transitions: [
    ...  {from: on, to: on, event: a, when: {lever: D}}, {from: on, to: on, event: b}]}
    ... '''))
    CommandNeeds(commands=(2,), masks=((2,), ()))
    """
    bits: dict[tuple[str, str], int] = {}
    for command in system.commands:
        for value in command.values:
            bits[command.name, value] = 1 << len(bits)
    masks = tuple(
        tuple(sum(bits[name, value] for value in values) for name, values in transition.when.items())
        for transition in system.transitions
    )
    return CommandNeeds(tuple(len(command.values) for command in system.commands), masks)


def _tables(
    system: HybridSystem,
    plan: SignaturePlan,
    detector: TransitionDetector | None,
    gains: ObserverGains | None,
    tracker: Tracker,
    *,
    step: float,
) -> StepTables:
    reset_index, reset_matrix, reset_offset = fill_resets(system, plan.report.persistent)
    return StepTables(
        name=system.name,
        step=step,
        location_names=tuple(location.name for location in system.locations),
        state_names=system.state_names,
        input_names=system.input_names,
        output_names=system.output_names,
        event_names=tracker.event_names,
        signature_names=tracker.signature_names,
        flow=fill_flow(system, gains, step),
        generators=fill_generators(system, detector),
        tracker=tracker.states,
        initial=tracker.initial,
        restart=tracker.restart,
        restart_on_event=tracker.restart_on_event,
        window_ticks=1 if detector is None else detector.window_ticks,
        reset_index=reset_index,
        reset_matrix=reset_matrix,
        reset_offset=reset_offset,
        online=tracker.online,
        commands=tuple((command.name, command.values) for command in system.commands),
        command_slack=0 if system.is_discrete else 1,
        decision=fill_decision(system, detector),
    )


def _states(count: int) -> str:
    return "1 state" if count == 1 else f"{count} states"


def _signatures_in_events(plan: SignaturePlan) -> dict[str, str]:
    """In a purely discrete model a signature comes as an event: alone, or as the pair `γ,s`."""
    names = {signature.name: signature.name for signature in plan.signatures}
    for transition in plan.complementary.transitions if plan.complementary else ():
        if transition.signature is not None:
            names |= {str(Output(gamma, transition.signature)): transition.signature for gamma in transition.outputs}
    outputs = set(outputs_of(plan.des))
    return {event: name for event, name in names.items() if event not in outputs}


def _require_plan(system: HybridSystem, plan: SignaturePlan, detector: TransitionDetector | None) -> None:
    if not plan.recoverable:
        fact = "no set of signatures makes the current location observable, so there is no location observer to run"
        raise UsageError(diagnostic("DH0608", f"`{system.name}` has no hybrid observer", notes=(fact,)))
    if plan.signatures and detector is None and not system.is_discrete:
        names = ", ".join(f"`{signature.name}`" for signature in plan.signatures)
        raise UsageError(diagnostic("DH0608", f"the plan of `{system.name}` needs a detector for {names}"))


__all__ = ["Estimate", "HybridObserver", "ObserverState", "build_observer"]
