"""Which pairs of locations a detector has to tell apart, whether it can, and how fast.

In: a hybrid system and its DES.  Out: a `PairSeparation` for each pair of locations the plant may enter, or stay in,
from a common one while the same is seen: a target and its `alternatives`.  Its verdict is that of `linear.distinguish`;
its numbers are those of `linear.distance`, the smaller of the two directions, over the detection window that the model
states, else its dwell time, else 100 steps.  A state of length one is as far out as the bounds say; outputs count in
units of the measurement bound, the *noise*, where the model states one: below 1 an error of the sensors could explain
the difference as well.

A pair `may_be_confused` where some state of full scale shows less than the noise: the states that the rival does not
measure take up the difference, often a slow one.  Cost: O(N p n²) a pair for N samples, at most 400.
Source: Balluchi et al. (2012), section 4.1.
"""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from deshybrid.des.automaton import DES, Transition
from deshybrid.diagnostics import Diagnostic, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.distance import Distance, Units
from deshybrid.model.system import HybridSystem, Location
from deshybrid.model.timing import sampling_step

Feasibility: TypeAlias = Literal["always", "generic", "never", "unknown"]
ORDER: tuple[Feasibility, ...] = ("always", "generic", "unknown", "never")
MOST_SAMPLES = 400
SHOWN = 5
HARDEST = 3
NO_WINDOW = 100  # steps
TAKEN_UP = 1e-3  # of its unit: a state of the rival that moves by less takes up nothing


@dataclass(frozen=True, slots=True)
class PairSeparation:
    """How two locations are told apart: `forward` whether a plant in `first` shows against `second`, `backward` vice
    versa, each with its reason.

    `worst` and `typical`: the root mean square of the difference that is left, in units of the noise (`noise` true) or
    of the outputs, over states of full scale; `seconds`: how soon a typical one exceeds 1, None where it does not
    within `window` seconds; `absorbed_by`: the state of the rival that takes up most where the difference is smallest.
    `nu_gap`: how far apart feedback would find the two, from 0 to 1, inputs and outputs in shares of full scale; None
    where they do not have the same inputs and outputs, or none.
    """

    first: str
    second: str
    forward: Feasibility
    backward: Feasibility
    reasons: tuple[str, str]
    worst: float
    typical: float
    seconds: float | None
    window: float
    noise: bool
    absorbed_by: str | None
    nu_gap: float | None = None

    @property
    def verdict(self) -> Feasibility:
        """The less favourable of the two directions."""
        return worst_of((self.forward, self.backward))

    @property
    def may_be_confused(self) -> bool:
        """True where some state of full scale shows less than the noise, or nothing where no noise is known."""
        return self.verdict in ("generic", "never") if not self.noise else self.worst < 1.0

    def record(self) -> dict[str, object]:
        """Return the entry of `pairs` in the JSON of `recover`."""
        return {
            "locations": [self.first, self.second],
            "feasibility": self.verdict,
            "worst": self.worst,
            "typical": self.typical,
            "unit": "noise" if self.noise else "output",
            "seconds": self.seconds,
            "window": self.window,
            "absorbed_by": self.absorbed_by,
            "nu_gap": self.nu_gap,
        }


def worst_of(verdicts: Iterable[Feasibility]) -> Feasibility:
    """Return the least favourable verdict; `unknown` ranks above `never` only.

    >>> worst_of(("always", "generic"))
    'generic'
    """
    return max(verdicts, key=ORDER.index, default="always")


def alternatives(des: DES, transition: Transition) -> tuple[str, ...]:
    """Return what the plant may do instead of `transition` without a difference in γ or command: stay, or go elsewhere.

    >>> des = DES.from_transitions([("1", "a", "2", "α"), ("1", "b", "3", "α"), ("1", "c", "4", "β")])
    >>> alternatives(des, des.transitions[0])
    ('1', '3')
    """
    source, shown = transition.source, set(transition.occurrences)
    rivals = (other.target for other in des.transitions if other.source == source and shown & set(other.occurrences))
    return tuple(name for name in dict.fromkeys((source, *rivals)) if name != transition.target)


def compared_pairs(des: DES) -> tuple[tuple[str, str], ...]:
    """Return the pairs that transitions and their alternatives make, each once, in order of declaration.

    >>> compared_pairs(DES.from_transitions([("1", "a", "2", "α"), ("1", "b", "3", "α"), ("1", "c", "4", "β")]))
    (('1', '2'), ('1', '3'), ('1', '4'), ('2', '3'))
    """
    place = {name: number for number, name in enumerate(des.locations)}
    found = {
        (transition.target, other)
        for transition in des.transitions
        if transition.target != transition.source
        for other in alternatives(des, transition)
    }
    ordered = {(one, other) if place[one] < place[other] else (other, one) for one, other in found}
    return tuple(sorted(ordered, key=lambda pair: (place[pair[0]], place[pair[1]])))


def separations(system: HybridSystem, des: DES) -> tuple[PairSeparation, ...]:
    """Return a `PairSeparation` for each of the `compared_pairs`; none in a purely discrete model.

    >>> from deshybrid.model.abstraction import abstract
    >>> from deshybrid.model.load import load
    >>> tank = load("models/two_tank.yaml")
    >>> [(pair.verdict, pair.may_be_confused) for pair in separations(tank, abstract(tank))]
    [('generic', True)]
    """
    return () if system.is_discrete else tuple(separate(system, *pair) for pair in compared_pairs(des))


def separate(system: HybridSystem, first: str, second: str) -> PairSeparation:
    """Return how two locations of a system with continuous state are told apart."""
    one, other = system.location(first), system.location(second)
    window, step = detection_window(system), sampling_step(system)
    samples = max(1, min(MOST_SAMPLES, round(window / step)))
    both = _distances(system, one, other, samples, window / samples)
    near = min(both, key=lambda distance: distance.worst)
    verdicts = (_verdict(system, one, other), _verdict(system, other, one))
    return PairSeparation(
        first=first,
        second=second,
        forward=verdicts[0][0],
        backward=verdicts[1][0],
        reasons=(verdicts[0][1], verdicts[1][1]),
        worst=near.worst,
        typical=min(distance.typical for distance in both),
        seconds=_seconds(system, one, other, samples, window / samples),
        window=window,
        noise=system.bounds.measurement is not None and bool(system.bounds.measurement.all()),
        absorbed_by=_absorbed(system, near),
        nu_gap=_gap(system, one, other),
    )


def detection_window(system: HybridSystem) -> float:
    """Return the time (s) in which locations should be told apart: stated, else the dwell time, else 100 steps."""
    stays = [location.dwell.min for location in system.locations if location.dwell.min]
    stated = system.observer.detector.window or system.observer.dwell or min(stays, default=None)
    return NO_WINDOW * sampling_step(system) if stated is None else stated


def _verdict(system: HybridSystem, one: Location, other: Location) -> tuple[Feasibility, str]:
    from deshybrid.linear.distinguish import distinguish

    if one.dynamics is None or other.dynamics is None:
        return "unknown", "a location has no dynamics"
    found = distinguish(
        one.dynamics,
        other.dynamics,
        discrete=system.time_step is not None,
        inputs=(one.input_index, other.input_index),
        outputs=(one.output_index, other.output_index),
    )
    return found.verdict, found.reason


def _distances(system: HybridSystem, one: Location, other: Location, samples: int, step: float) -> tuple[Distance, ...]:
    return tuple(_distance(system, *pair, samples, step) for pair in ((one, other), (other, one)))


def _distance(system: HybridSystem, plant: Location, rival: Location, samples: int, step: float) -> Distance:
    from deshybrid.linear.distance import distance

    if plant.dynamics is None or rival.dynamics is None:
        return Distance(0.0, 0.0, np.zeros(0), np.zeros(0))
    return distance(
        plant.dynamics,
        rival.dynamics,
        samples=samples,
        step=step if system.time_step is None else None,
        units=_units(system),
        inputs=(plant.input_index, rival.input_index),
        outputs=(plant.output_index, rival.output_index),
    )


def _gap(system: HybridSystem, one: Location, other: Location) -> float | None:
    """The ν-gap of what the inputs do to the outputs, each in shares of the largest that the bounds allow."""
    from deshybrid.linear.gap import Realisation, bilinear, nu_gap

    same = one.input_index == other.input_index and one.output_index == other.output_index
    if one.dynamics is None or other.dynamics is None or not same or 0 in one.dynamics.D.shape:
        return None
    u = _positive(system.bounds.input, len(system.input_names))[list(one.input_index)]
    x = _positive(system.bounds.state, len(system.state_names))
    y = np.maximum(*(np.abs(location.C) @ x for location in (one.dynamics, other.dynamics)))
    y = np.where(y > 0.0, y, 1.0)
    plants = [Realisation(d.A, d.B * u, d.C / y[:, None], d.D * u / y[:, None]) for d in (one.dynamics, other.dynamics)]
    if system.time_step is not None:
        plants = [moved for moved in map(bilinear, plants) if moved is not None]
    try:
        return nu_gap(*plants) if len(plants) == 2 else None
    except np.linalg.LinAlgError:  # no factorisation in floating point
        return None


def _units(system: HybridSystem) -> Units:
    bounds = system.bounds
    return Units(
        state=_positive(bounds.state, len(system.state_names)),
        input=_positive(bounds.input, len(system.input_names)),
        output=_positive(bounds.measurement, len(system.output_names)),
    )


def _positive(bound: FloatArray | None, size: int) -> FloatArray:
    return np.ones(size) if bound is None else np.where(bound > 0.0, bound, 1.0)


def _seconds(system: HybridSystem, one: Location, other: Location, samples: int, step: float) -> float | None:
    """The first of 1, 2, 4, ... samples at which a typical difference exceeds 1, in both directions."""
    taken = 1
    while taken <= samples:
        if min(distance.typical for distance in _distances(system, one, other, taken, step)) >= 1.0:
            return taken * step
        taken = 2 * taken if 2 * taken <= samples or taken == samples else samples
    return None


def _absorbed(system: HybridSystem, near: Distance) -> str | None:
    moved = np.abs(near.rival)
    if len(moved) != len(system.state_names) or moved.max(initial=0.0) < TAKEN_UP:
        return None
    return system.state_names[int(np.argmax(moved))]


def hardest_line(pairs: Iterable[PairSeparation]) -> str:
    """Return one line on the pairs that are told apart worst as a rule; empty without pairs.

    >>> from deshybrid.model.abstraction import abstract
    >>> from deshybrid.model.load import load
    >>> tank = load("models/two_tank.yaml")
    >>> hardest_line(separations(tank, abstract(tank)))
    '  hardest to tell apart within 0.6 s: fill and drain (232 times the noise, at worst 0)'
    """
    ranked = sorted(pairs, key=lambda pair: pair.typical)[:HARDEST]
    if not ranked:
        return ""
    unit = " times the noise" if ranked[0].noise else ""
    told = (f"{pair.first} and {pair.second} ({pair.typical:.3g}{unit}, at worst {pair.worst:.2g})" for pair in ranked)
    return f"  hardest to tell apart within {ranked[0].window:g} s: " + ", ".join(told)


def confusion_warnings(pairs: Iterable[PairSeparation]) -> tuple[Diagnostic, ...]:
    """Return the warning (DH0611) that some of these pairs may be confused; none where none may be.

    >>> from deshybrid.model.abstraction import abstract
    >>> from deshybrid.model.load import load
    >>> tank = load("models/two_tank.yaml")
    >>> [warning.code for warning in confusion_warnings(separations(tank, abstract(tank)))]
    ['DH0611']
    """
    doubtful = sorted((pair for pair in pairs if pair.may_be_confused), key=lambda pair: pair.typical)
    if not doubtful:
        return ()
    notes = tuple(_notes(doubtful))
    count = "1 pair of locations" if len(doubtful) == 1 else f"{len(doubtful)} pairs of locations"
    message = f"{count} may be confused: free states of a wrong location can take up the difference"
    helps = ("measure another state, or wait longer; a simulation shows how often it happens",)
    return (diagnostic("DH0611", message, notes=notes, helps=helps, severity="warning"),)


def _notes(doubtful: list[PairSeparation]) -> Iterator[str]:
    for pair in doubtful[:SHOWN]:
        unit = "times the noise" if pair.noise else "in units of the outputs"
        absorbed = f"; there `{pair.absorbed_by}` of the wrong one takes it up" if pair.absorbed_by else ""
        seen = f"as a rule {pair.typical:.3g} {unit} within {pair.window:g} s, at worst {pair.worst:.2g}{absorbed}"
        yield f"`{pair.first}` and `{pair.second}`: {seen}"
    if len(doubtful) > SHOWN:
        yield f"{len(doubtful) - SHOWN} pairs more, which are easier as a rule: `recover --json` lists all"


__all__ = [
    "Feasibility",
    "PairSeparation",
    "alternatives",
    "compared_pairs",
    "confusion_warnings",
    "detection_window",
    "hardest_line",
    "separate",
    "separations",
    "worst_of",
]
