"""How residuals become decisions: the paper's relays, exclusion of every alternative, or tests of the residuals.

- `relay`: a location is named when its relay is on and those of the alternatives are off.  A small residual is taken
  for a proof, which it is not: free states that nothing measures can take up the difference.
- `exclusion`: a location is named when every alternative has been *excluded* for H samples: its residual was beyond
  what the bounds on disturbance and measurement error allow in that location.  H is the longest time, over all
  generators, that the transient of an entry can last, from the worst mismatch that the bounds allow.  A location that
  is named and explains nothing more is told no longer; after the window it is given up and the search begins again.

Why a name is then true: suppose that the plant is in c, an alternative, entered at t_c, when another location is named
at t.  Its residual is within its bound from t_c + H on, so t < t_c + H.  Before t_c the plant was in an alternative c'
(or in the location that is named, which is then named late); it had been there for a dwell time D >= H, so c' was not
excluded at the last sample before t_c, which is one of the last H: a contradiction.  At the start H is waited for.

- `imm`: the location of the most likely of interacting filters is named, once it is likely enough (`bank`).
- `sprt`, `glr`: tests of a white residual (`innovation`, `sequential`) deny and accept a location in place of its
  relay; names are given as by exclusion, with H the time after which what the transient of an entry adds to the mean of
  the residual is half its deviation.  Only locations of the plan are judged, so that a location without a
  generator is never an obstacle, and never excluded: names are right as a rule, not for certain.

In: a hybrid system and the parts of its detector.  Out: a `DecisionDesign`.  Cost: that of `levels.settling`.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from deshybrid.detector.bank import Bank
from deshybrid.detector.levels import Part, settling, worst_mismatch
from deshybrid.detector.sequential import wald_test, whitening_of, window_limits, window_samples
from deshybrid.detector.thresholds import settling_ticks
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import Decision, HybridSystem

TESTS: tuple[Decision, ...] = ("sprt", "glr", "imm")
FALSE_ALARM = 1e-5  # 1/s: about one a day
NEGLIGIBLE = 0.5  # of the residual's deviation


class DecisionWish(NamedTuple):
    """What is wanted of the decision: `stated` by the model, or the default, for the reason given."""

    kind: Decision
    stated: bool
    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class DecisionDesign:
    """How a detector decides; `exclude_ticks` is H in samples, 0 for the relay.

    `false_alarm` in 1/s per generator, 0 where nothing is demanded.  For the tests: `whitening` (q, q) by generator;
    `test`, by generator: slope, offset, lower and upper level of `sprt`; `limits` of `glr`, one for each number of
    samples; `bank` of `imm`.
    """

    kind: Decision
    reason: str
    exclude_ticks: int = 0
    false_alarm: float = 0.0
    whitening: tuple[FloatArray, ...] = ()
    test: tuple[tuple[float, float, float, float], ...] = ()
    limits: FloatArray | None = None
    bank: Bank | None = None

    @property
    def is_test(self) -> bool:
        """Whether residuals are judged by chance, so that they have to be white and no time to a decision is proven."""
        return self.kind in TESTS


def wanted_decision(system: HybridSystem) -> DecisionWish:
    """Return what the model states, else exclusion where its bounds make it possible, else the relay.

    >>> from deshybrid.model.load import loads
    >>> wanted_decision(loads('''
    ... {format: deshybrid/1, name: lamp, locations: [on], transitions: [{from: on, to: on, event: blink}]}
    ... '''))
    DecisionWish(kind='relay', stated=False, reason='the model has no continuous state')
    """
    stated = system.observer.detector.decision
    if stated is not None:
        return DecisionWish(stated, True, "stated by the model")
    if system.is_discrete:
        return DecisionWish("relay", False, "the model has no continuous state")
    lacking = _lacking(system)
    if lacking:
        return DecisionWish("relay", False, f"{lacking}, so no location can be excluded")
    return DecisionWish("exclusion", False, "the bounds of the model make it possible")


def _lacking(system: HybridSystem) -> str:
    bounds = system.bounds
    needed = {
        "state": bounds.state is None,
        "input": bounds.input is None and bool(system.input_names),
        "disturbance": bounds.disturbance is None and bool(system.disturbance_names),
        "measurement": bounds.measurement is None,
    }
    missing = [name for name, is_missing in needed.items() if is_missing]
    if missing:
        return f"the model states no bound for {' and '.join(missing)}"
    blind = [q.name for q in system.locations if q.dynamics is None or not q.dynamics.C.any()]
    return f"location `{blind[0]}` measures nothing" if blind else ""


def judged_locations(system: HybridSystem, plan_generators: tuple[str, ...], kind: Decision) -> tuple[str, ...]:
    """Return the locations that need a generator: exclusion judges all of them, those of the plan come first.
    >>> from deshybrid.model.load import load
    >>> judged_locations(load("models/two_tank.yaml"), ("drain",), "exclusion")
    ('drain', 'fill')
    """
    others = (location.name for location in system.locations) if kind == "exclusion" else ()
    return tuple(dict.fromkeys((*plan_generators, *others)))


def design_decision(
    system: HybridSystem, wish: DecisionWish, parts: tuple[Part, ...], *, dwell: float | None, bank: Bank | None = None
) -> DecisionDesign:
    """Return the decision of a detector with these parts; dwell in seconds, None where the model states none.

    Where exclusion is only the default and cannot be had, or takes longer than a stay, it is the relay instead, and
    `reason` says why.  Raises `UsageError` (DH0614) where the model states a decision that cannot be had.
    """
    if wish.kind == "relay" or not parts:
        return _relay(system, wish.reason)
    if bank is not None:
        why = f"{wish.reason}; probabilities from {bank.confidence:g} on" + _if_right(system)
        return DecisionDesign("imm", why, 1, whitening=bank.whitening, bank=bank)
    if wish.kind in TESTS:
        return _test(system, wish, parts)
    lasting = [settling(system, part) for part in parts]
    endless = [part.generator.location.name for part, ticks in zip(parts, lasting, strict=True) if ticks is None]
    if endless:
        why = f"nothing bounds how long the residual of `{endless[0]}` takes to settle"
        if wish.stated:
            raise _impossible(wish.kind, why)
        return _relay(system, f"{why}, so no location can be excluded")
    ticks = max((0 if last is None else last) + part.on_ticks for part, last in zip(parts, lasting, strict=True))
    seconds = ticks * parts[0].generator.step
    if not wish.stated and dwell is not None and seconds > dwell:
        return _relay(system, f"an exclusion would take {seconds:.3g} s, longer than a stay of {dwell:.3g} s")
    return DecisionDesign("exclusion", f"{wish.reason}; sound where every stay lasts at least {seconds:.3g} s", ticks)


def _relay(system: HybridSystem, reason: str) -> DecisionDesign:
    """The relay; with a demanded rate of false alarms its release level is derived (`chatter`)."""
    rate = system.observer.detector.false_alarm
    if rate is None:
        return DecisionDesign("relay", reason)
    return DecisionDesign(
        "relay", f"{reason}; noise alone switches a relay off and on at most {rate:g} times a second", false_alarm=rate
    )


def _if_right(system: HybridSystem) -> str:
    """What to add where tolerances are stated and the decision does not allow for them."""
    return "; it holds where the parameters are right: their tolerances are not allowed for" if system.tolerance else ""


def _impossible(kind: Decision, why: str) -> UsageError:
    helps = ("state all `bounds`, and thresholds above the residual that they allow",)
    return UsageError(diagnostic("DH0614", f"the detector cannot decide by {kind}: {why}", helps=helps))


def _test(system: HybridSystem, wish: DecisionWish, parts: tuple[Part, ...]) -> DecisionDesign:
    """The numbers of a test; its window is that of the slowest generator."""
    stated, step = system.observer.detector.false_alarm, parts[0].generator.step
    rate = FALSE_ALARM if stated is None else stated
    whitening = tuple(whitening_of(part.covariance) for part in parts)
    counts = [len(matrix) for matrix in whitening]
    samples = window_samples(max(part.generator.time_constant for part in parts), step) if wish.kind == "glr" else 0
    judged = zip(parts, whitening, strict=True)
    ticks = max(_fading(system, part, white, wish.kind) + part.on_ticks for part, white in judged)
    return DecisionDesign(
        wish.kind,
        f"{wish.reason}; at most {rate:g} false alarms a second and generator, if the noise is white and Gaussian"
        + _if_right(system),
        ticks + samples,
        rate,
        whitening,
        tuple(wald_test(count, false_alarm=rate, step=step) for count in counts) if wish.kind == "sprt" else (),
        window_limits(samples, max(counts), false_alarm=rate, step=step) if wish.kind == "glr" else None,
    )


def _fading(system: HybridSystem, part: Part, whitening: FloatArray, kind: Decision) -> int:
    """Samples until the worst mismatch shifts the white residual by half its deviation at most."""
    mismatch, generator = worst_mismatch(system, part.generator), part.generator
    white = replace(generator, H=whitening @ generator.H)
    ticks = None if mismatch is None else settling_ticks(white, mismatch, np.full(len(whitening), NEGLIGIBLE))
    if ticks is None:
        why = f"nothing bounds how long the residual of `{generator.location.name}` takes to settle"
        raise _impossible(kind, why)
    return ticks


__all__ = ["TESTS", "DecisionDesign", "DecisionWish", "design_decision", "judged_locations", "wanted_decision"]
