"""The order of the stages: the one file to read first.

A model is carried from one frozen value to the next, and each value keeps the value it was made from:

    text -> HybridSystem -> DES -> ObservabilityReport -> Recovery (SignaturePlan) -> Design (gains, detector,
    certificates) -> Compilation (HybridObserver and the texts)

Every function takes a path, a `HybridSystem` or a `DES`.  A "no" is a value too: nothing here raises because the answer
is negative.  Source: Balluchi et al. (2012), sections 3 and 4.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeAlias

from deshybrid.des.automaton import DES
from deshybrid.des.observability import ObservabilityReport, check_observability
from deshybrid.detector.recovery import Recovery
from deshybrid.diagnostics import Diagnostic, GainError, UsageError, diagnostic
from deshybrid.diagnostics.pictured import Explained
from deshybrid.formats.reading import read_system
from deshybrid.model.abstraction import abstract, discrete_model
from deshybrid.model.system import HybridSystem
from deshybrid.model.timing import sampling_step
from deshybrid.observer import MAX_TABLE

if TYPE_CHECKING:
    from deshybrid.continuous.average import AverageDwell
    from deshybrid.continuous.certified import Certificate
    from deshybrid.continuous.cycles import DwellLowerLimit
    from deshybrid.continuous.determinability_design import Determined, Stays
    from deshybrid.continuous.gains import Method as GainMethod
    from deshybrid.continuous.gains import ObserverGains
    from deshybrid.continuous.ultimate import UltimateBound
    from deshybrid.detector.detector import TransitionDetector
    from deshybrid.detector.excitation import Excitation
    from deshybrid.observer.hybrid import HybridObserver

Source: TypeAlias = str | Path | HybridSystem | DES
Method: TypeAlias = Literal["auto", "observer", "pairs"]
MAX_STATES = 100_000


@dataclass(frozen=True, eq=False, repr=False)
class Design(Explained):
    """Stages 7 and 8: detector, gains, certificates and bound; a part is None where `problems` says why it is missing.

    `certificates` of the continuous observer come before those of the sampled one, which is the one that the code runs.
    """

    system: HybridSystem
    recovery: Recovery
    step: float
    detector: "TransitionDetector | None" = None
    gains: "ObserverGains | None" = None
    certificates: "tuple[Certificate, ...]" = ()
    determined: "Determined | None" = None
    problems: tuple[Diagnostic, ...] = ()

    def _drawn(self) -> ObservabilityReport:
        return self.recovery.plan.report

    @property
    def exists(self) -> bool:
        """True where a hybrid observer exists: the location is recoverable and every persistent location has a gain."""
        return self.recovery.plan.recoverable and (self.gains is not None or self.system.is_discrete)

    @property
    def certified(self) -> bool:
        """True where the observer exists and some certificate holds for it, and one for its sampled form that runs.

        An observer of the location alone has nothing to certify; where locations see the state together only, the
        certificate of that counts.
        """
        from deshybrid.continuous.certified import is_certified

        if self.determined is not None and self.determined.required and not self.certificates:
            return self.exists and self.determined.holds
        return self.exists and is_certified(self.certificates)

    @cached_property
    def ultimate(self) -> "UltimateBound | None":
        """The level below which the error stays in the end, in the worst case; found when asked for."""
        from deshybrid.continuous.certified import forms_for
        from deshybrid.continuous.ultimate import ultimate_bound

        if self.gains is not None and self.determined is not None and self.determined.decides:
            from deshybrid.continuous.ultimate_box import ultimate_bound_in_box

            return ultimate_bound_in_box(self.system, self.gains, self.determined.certificates[0])
        if self.gains is None or not self.certificates:
            return None
        forms = forms_for(self.certificates, self.delay)
        return ultimate_bound(self.system, self.gains, delay=self.delay, forms=forms)

    @cached_property
    def lower_limit(self) -> "DwellLowerLimit | None":
        """The largest dwell time at which a switching cycle was found that does not contract; found when asked for."""
        from deshybrid.continuous.certified import known_limit

        if self.gains is None or not self.certificates:
            return None
        return known_limit(self.system, self.gains, self.certificates)

    @cached_property
    def average(self) -> "AverageDwell | None":
        """The average dwell time that is long enough, found when asked for; of the observer without delay."""
        from deshybrid.continuous.average import average_dwell_of

        return average_dwell_of(self.system, self.gains) if self.gains and self.certificates else None

    @cached_property
    def excitations(self) -> "tuple[Excitation, ...]":
        """How soon each signature comes for certain, for how strong a motion; found when asked for."""
        from deshybrid.detector.excitation import excitations

        return () if self.detector is None else excitations(self.detector)

    @property
    def delay(self) -> float:
        """The detection delay Δ that the certificates assume: the detector's window, 0 without a detector."""
        return 0.0 if self.detector is None else self.detector.window

    def document(self) -> dict[str, object]:
        """Return the design as JSON values; the keys are a contract, and `verify` checks the claims in them."""
        from deshybrid.continuous.document import design_document, empty_document

        if self.gains is None:
            return empty_document(self.determined)
        document = design_document(
            self.system,
            self.gains,
            self.certificates,
            self.ultimate,
            lower_limit=self.lower_limit,
            detection_delay=None if self.detector is None else self.detector.detection_delay,
            determined=self.determined,
            average=self.average,
        )
        stated = {"tolerance": dict(self.system.tolerance)} if self.system.tolerance else {}
        return document | stated | {"excitation": [found.record() for found in self.excitations]}

    def __repr__(self) -> str:
        return f"<Design of {self.system.name}: exists={self.exists}, certified={self.certified}, step={self.step:g} s>"

    def __str__(self) -> str:
        from deshybrid.continuous.certified import interval_lines
        from deshybrid.detector.excitation import excitation_lines
        from deshybrid.detector.thresholds import tolerance_lines

        name = self.system.name
        if not self.exists:
            return f"{name}: no hybrid observer"
        if self.gains is None:
            return f"{name}: an observer of the location; there is no continuous state"
        lines = [f"{name}: a switching observer with rate {self.gains.rate:g} 1/s, sampled every {self.step:g} s"]
        lines += [f"  {line}" for line in self.gains.lines()]
        lines += [f"  {c.theorem}: {'holds' if c.holds else 'does not hold'}: {c.reason}" for c in self.certificates]
        lines += str(self.determined).splitlines() if self.determined else []
        lines += interval_lines(self.certificates, self.lower_limit)
        lines += [f"  {self.average}"] if self.average else []
        lines += excitation_lines(self.excitations, self.delay, self.gains.dwell)
        lines += tolerance_lines(self.system)
        if self.ultimate is not None:
            bound = self.ultimate.value
            lines.append(
                f"  ultimate bound: {'none' if bound is None else format(bound, '.4g')} ({self.ultimate.reason})"
            )
        return "\n".join(lines)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class Compilation(Explained):
    """Stage 9: the hybrid observer, None where none exists, with everything it was made from."""

    design: Design
    observer: "HybridObserver | None"

    def _drawn(self) -> object:
        report = self.design.recovery.plan.report
        return report.observer or report

    @property
    def diagnostics(self) -> tuple[Diagnostic, ...]:
        """What the user has to know: why there is no observer, or what limits the one there is."""
        return self.design.recovery.diagnostics + self.design.problems

    @property
    def certified(self) -> bool:
        """True where the observer exists and is certified."""
        return self.observer is not None and self.design.certified

    def __repr__(self) -> str:
        return f"<Compilation of {self.design.system.name}: {self.observer!r}, certified={self.certified}>"

    def __str__(self) -> str:
        text = f"{self.design.recovery.check}\n{self.design.recovery}\n{self.design}"
        return text if self.observer is None else f"{text}\n  location observer: {self.observer.tracker_reason}"


def to_system(source: Source) -> HybridSystem | DES:
    """Return the model or the automaton behind a path, or the value itself; the format of a file is its suffix.

    Raises `InputError` where the file is malformed.

    >>> to_system(DES.from_transitions([("1", "a", "1", "α")])).name
    'des'
    """
    return read_system(source)[0] if isinstance(source, str | Path) else source


def to_des(source: Source) -> DES:
    """Return D_H of a path or a hybrid system, or the DES itself.

    >>> to_des("models/balluchi2012/fig2.yaml").locations
    ('0', '1', '2', '3', '4', '5')
    """
    model = to_system(source)
    return model if isinstance(model, DES) else abstract(model)


def to_hybrid(source: Source) -> HybridSystem:
    """Return the hybrid system of a path, or the system itself; a DES becomes a model without continuous state.

    Raises `UsageError` (DH0308) for a DES that has signatures already.

    >>> to_hybrid("models/two_tank.yaml").state_names
    ('h1', 'h2')
    """
    model = to_system(source)
    return discrete_model(model) if isinstance(model, DES) else model


def check(source: Source, *, method: Method = "auto", max_states: int = MAX_STATES) -> ObservabilityReport:
    """Can the current location be known from the discrete outputs?  Stages 2 to 5.

    Raises `ModelError` for a malformed model and `LimitReached` (DH0901) beyond `max_states` observer states.
    Source: Balluchi et al. (2012), Theorem 4.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("2", "b", "1", "β")])
    >>> check(des).current_location_observable
    True
    """
    return check_observability(to_des(source), method=method, max_states=max_states)


def recover(source: Source, *, max_states: int = MAX_STATES, seconds: float | None = None) -> Recovery:
    """Find the cheapest signatures that make the current location observable, with a proof.  Stage 6.

    After `seconds` the best plan so far is returned, with a lower bound.

    Source: Balluchi et al. (2012), section 4.1; the minimum by implicit hitting sets.

    >>> arcs = [("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")]
    >>> des = DES.from_transitions(arcs)
    >>> [signature.name for signature in recover(des).plan.signatures]
    ['s_2']
    """
    from deshybrid.des.signatures import recover_observability
    from deshybrid.detector.candidates import offers

    model = to_system(source)
    des, candidates, pairs = offers(model)
    offered = tuple(entry.candidate for entry in candidates)
    plan = recover_observability(des, offered, max_states=max_states, seconds=seconds)
    check = check_observability(des, max_states=max_states)
    return Recovery(None if isinstance(model, DES) else model, check, candidates, plan, pairs)


def design(
    source: Source,
    *,
    rate: float | None = None,
    dwell: float | None = None,
    step: float | None = None,
    method: "GainMethod" = "place",
    max_states: int = MAX_STATES,
) -> Design:
    """Design detector and gains, and certify them for the stated rate (1/s) and dwell time (s).  Stages 7 and 8.

    Arguments override what the model's `observer` section says; for `method` see `deshybrid.continuous.methods`.
    Raises `UsageError` (DH0306) for a model without continuous state.  Source: Balluchi et al. (2012), Theorems 6, 7.

    >>> made = design("models/two_tank.yaml")
    >>> made.gains.locations, made.certified
    (('fill', 'drain'), True)
    """
    system = to_hybrid(source)
    if system.is_discrete:
        raise UsageError(
            diagnostic("DH0306", f"`{system.name}` has no continuous state, so there is no gain to design")
        )
    recovery = recover(system, max_states=max_states)
    draft = Design(system, recovery, sampling_step(system) if step is None else step)
    if not recovery.plan.recoverable:
        return draft
    from deshybrid.continuous.determinability_design import determined_without_gains, gains_alone_or_together

    places = recovery.locations_to_estimate
    try:
        gains, stays = gains_alone_or_together(system, places, rate=rate, dwell=dwell, method=method)
    except GainError as error:
        return replace(draft, determined=determined_without_gains(system, places), problems=error.diagnostics)
    return _certified(replace(draft, gains=gains, problems=gains.warnings), stays)


def _certified(draft: Design, stays: "Stays") -> Design:
    """Add detector, certificates and bound to a draft that has gains and a step."""
    from deshybrid.continuous.certified import paper_certificates
    from deshybrid.continuous.determinability_design import determined
    from deshybrid.continuous.lmi import certify_forms
    from deshybrid.continuous.methods import gains_by_method
    from deshybrid.detector.detector import build_detector

    system, gains, plan = draft.system, draft.gains, draft.recovery.plan
    if gains is None:
        return draft
    detector = build_detector(system, plan, rate=gains.rate, step=draft.step) if plan.signatures else None
    warnings = () if detector is None else detector.warnings
    made = replace(draft, detector=detector, problems=draft.problems + warnings)
    together = determined(system, gains, stays, step=made.step, delay=made.delay)
    if together is not None:
        made = replace(made, determined=together, problems=made.problems + together.problems)
        if together.required and stays is not None:
            return replace(made, gains=replace(gains, rate=together.rate or gains.rate))
    certificates = paper_certificates(system, gains, step=made.step, delay=made.delay)
    if not certificates[-1].holds and made.delay > 0.0 and gains.method != "lmi":
        places, rate, dwell = gains.locations, gains.requested_rate, gains.dwell
        aimed = gains_by_method(system, places, rate=rate, dwell=dwell, delay=made.delay, method=gains.method)
        retried = paper_certificates(system, aimed, step=made.step, delay=made.delay)
        if retried[-1].holds:
            gains, certificates = aimed, retried
    return replace(made, gains=gains, certificates=certificates + certify_forms(system, gains, certificates))


def compile(
    source: Source,
    *,
    rate: float | None = None,
    dwell: float | None = None,
    step: float | None = None,
    method: "GainMethod" = "place",
    max_states: int = MAX_TABLE,
) -> Compilation:
    """Carry a model through all stages to the hybrid observer that runs.  Stage 9.

    Arguments are those of `design`.  A purely discrete model gives an observer of the location alone, one tick a row.
    The location observer becomes a table of up to `max_states` states; where there are more, it runs on line, with the
    same estimates.
    Source: Balluchi et al. (2012), sections 3.2 and 4.2.

    >>> made = compile("models/balluchi2012/fig2.yaml")
    >>> state, estimate = made.observer.step(made.observer.start(), (), (), "α")
    >>> estimate.entry_estimate
    ('0', '2')
    """
    from deshybrid.observer.hybrid import build_observer

    system = to_hybrid(source)
    if system.is_discrete:
        made = Design(system, recover(system, max_states=max_states), step or 1.0)
    else:
        made = design(system, rate=rate, dwell=dwell, step=step, method=method, max_states=max_states)
    if not made.exists:
        return Compilation(made, None)
    given = (system, made.recovery.plan, made.detector, made.gains)
    try:
        observer = build_observer(*given, step=made.step, certificates=made.certificates, max_states=max_states)
    except GainError as error:
        return Compilation(replace(made, problems=made.problems + error.diagnostics), None)
    return Compilation(made, observer)


__all__ = ["Compilation", "Design", "Recovery", "check", "compile", "design", "recover", "to_des", "to_system"]
