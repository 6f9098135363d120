"""Interacting filters: one stationary Kalman predictor for each location, weighed by how well it predicts.

The location is taken for a Markov chain, the samples for those of the predictor of the present location; the bank keeps
the probability of each, and starts every predictor, at every sample, from the mean of those it may come from.

- Chain: a stay in a location lasts for s seconds in the mean (`stay`, else 10 times the shortest stay), so that it ends
  in a step h with 1 - exp(-h/s); all targets are equally likely.
- An entry leaves the state less known than later samples do: what the clutch passed has twisted the shaft.  A location
  with a noise of its entry has two predictors, one of which has this noise besides and hands over to the other after
  `entry_time` in the mean.  The location has the probability of both.
- Fit: Student's t with ν degrees of freedom instead of a Gaussian, p(r) ~ |S|^(-1/2) (1 + rᵀ S⁻¹ r / ν)^(-m) with
  m = (ν + q)/2 a whole number, so that it takes neither `exp` nor `log`, and no single outlier decides.  ν is 4, or 5
  where the number q of outputs is odd.
- A location is named from the probability `confidence` on, and doubted below one half.

It differs from the interacting multiple model algorithm in its constant gains, and in that a jump happens at the end of
a step: the means are mixed after the prediction.  Nothing is proven of how long it takes to name a location.

In: a hybrid system.  Out: a `Bank`.  Cost: a Riccati equation for each predictor.
Source: Blom and Bar-Shalom (1988), The interacting multiple model algorithm; Roth, Özkan and Gustafsson (2013), A
Student's t filter for heavy tailed process and measurement noise.
"""

import math
from dataclasses import dataclass, replace

import numpy as np

from deshybrid.detector.held_back import held_back
from deshybrid.detector.innovation import white_generator
from deshybrid.detector.levels import Part, white_part
from deshybrid.detector.residual import Followed, ResidualGenerator, sampled_dynamics
from deshybrid.detector.sequential import whitening_of
from deshybrid.diagnostics import Span, UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.system import HybridSystem, Location

CONFIDENCE = 0.95
STAYS = 10.0
LEAST_FREEDOM = 4


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """F predictors: first one for each of the L locations, in the order of the model, then those after an entry.

    `generators` (F), `covariances` (F) of their residuals, (q, q); `owner`: by predictor the number of its location;
    `chain` (F, F): to, from; `whitening` (F) of shape (q, q); `share` (F,): |S|^(-1/2), the largest is 1; `power`: m;
    `freedom`: ν = 2 m - q.
    """

    generators: tuple[ResidualGenerator, ...]
    covariances: tuple[FloatArray, ...]
    owner: tuple[int, ...]
    chain: FloatArray
    whitening: tuple[FloatArray, ...]
    share: FloatArray
    power: int
    freedom: int
    confidence: float


def build_bank(system: HybridSystem, *, step: float) -> Bank:
    """Return the interacting filters of a system; step in seconds.

    Raises `UsageError` (DH0614) where the locations differ in their channels, a transition resets the state, a location
    has a state that grows unseen, no noise, or no mean stay.

    >>> from deshybrid.model.load import load
    >>> bank = build_bank(load("models/balluchi2012/driveline.yaml"), step=0.012)
    >>> len(bank.generators), bank.power, bank.freedom
    (13, 3, 4)
    """
    _require_one_state(system)
    options = system.observer.detector
    owner = [*range(len(system.locations))]
    owner += [number for number in owner if system.locations[number].name in options.entry]
    made = [
        _predictor(system, system.locations[place], step, entry=f >= len(system.locations))
        for f, place in enumerate(owner)
    ]
    whitening = tuple(whitening_of(covariance) for _, covariance in made)
    volumes = np.array([float(np.prod(np.diag(white))) for white in whitening])
    q = len(system.locations[0].output_index)
    power = (q + 1) // 2 + LEAST_FREEDOM // 2
    return Bank(
        generators=tuple(generator for generator, _ in made),
        covariances=tuple(covariance for _, covariance in made),
        owner=tuple(owner),
        chain=_chain(system, owner, step),
        whitening=whitening,
        share=frozen_array(volumes / volumes.max(), volumes.shape),
        power=power,
        freedom=2 * power - q,
        confidence=CONFIDENCE if options.confidence is None else options.confidence,
    )


def bank_parts(system: HybridSystem, bank: Bank) -> tuple[Part, ...]:
    """Return the predictors that stand for the locations, one each, as parts of a detector."""
    first = range(len(system.locations))
    return tuple(white_part(system, bank.generators[f], bank.covariances[f]) for f in first)


def _require_one_state(system: HybridSystem) -> None:
    """Means are mixed, and fits compared: that needs one state and the same outputs everywhere."""
    stated = system.observer.detector.design
    if stated is not None:
        raise _impossible(f"its filters are Kalman predictors, not of the design `{stated}`")
    first = system.locations[0]
    for location in system.locations:
        if (location.input_index, location.output_index) != (first.input_index, first.output_index):
            raise _impossible(f"`{location.name}` and `{first.name}` have different channels", location.span)
    for transition in system.transitions:
        if transition.reset is not None and not transition.reset.changes_nothing:
            why = f"the transition from `{transition.source}` to `{transition.target}` resets the state"
            raise _impossible(why, transition.span)


def _impossible(why: str, span: Span | None = None) -> UsageError:
    return UsageError(diagnostic("DH0614", f"the detector cannot decide by imm: {why}", span))


def _predictor(
    system: HybridSystem, location: Location, step: float, *, entry: bool
) -> tuple[ResidualGenerator, FloatArray]:
    """The stationary Kalman predictor of the whole state, and the covariance of its residual."""
    dynamics = location.dynamics
    if dynamics is None or not dynamics.C.any():
        raise _impossible(f"location `{location.name}` measures nothing", location.span)
    sampled = sampled_dynamics(system, dynamics, step)
    n, p = len(sampled.A), len(dynamics.C)
    whole = Followed(
        location=location,
        dynamics=dynamics,
        step=step,
        A=sampled.A,
        B=sampled.B,
        offset=sampled.f,
        Y=np.zeros((n, p)),
        C=dynamics.C,
        W=np.eye(p),
        T=np.eye(n),
        channels=tuple(range(p)),
    )
    noise = system.observer.detector.entry[location.name] if entry else None
    try:
        made, covariance = white_generator(system, whole, besides=noise)
    except np.linalg.LinAlgError as error:
        raise _impossible(
            f"a part of the state of `{location.name}` grows and no output shows it", location.span
        ) from error
    design = "Kalman predictor after an entry" if entry else "Kalman predictor of interacting filters"
    return replace(held_back(system, made), design=design), covariance


def _chain(system: HybridSystem, owner: list[int], step: float) -> FloatArray:
    """The probabilities of a step, (F, F): to, from."""
    options, count = system.observer.detector, len(system.locations)
    if options.entry and options.entry_time is None:
        raise _impossible("`entry` needs `entry_time`, the time after which a state counts as known")
    names = [location.name for location in system.locations]
    doors = {place: f for f, place in enumerate(owner)}  # the last of a location: the one after an entry, if it has one
    chain = np.eye(len(owner))
    for f, place in enumerate(owner):
        arcs = (t.target for t in system.transitions if t.source == names[place] and t.target != names[place])
        targets = [names.index(name) for name in dict.fromkeys(arcs)]
        leaves = -math.expm1(-step / _mean_stay(system, system.locations[place])) if targets else 0.0
        settles = -math.expm1(-step / options.entry_time) if f >= count and options.entry_time else 0.0
        chain[f, f] = (1.0 - leaves) * (1.0 - settles)
        if f >= count:
            chain[place, f] = (1.0 - leaves) * settles
        for target in targets:
            chain[doors[target], f] = leaves / len(targets)
    return frozen_array(chain, chain.shape)


def shortest_stay(system: HybridSystem) -> float | None:
    """Return the dwell time that the model states, in s: that of the observer, else the shortest of a location.

    >>> from deshybrid.model.load import load
    >>> shortest_stay(load("models/balluchi2012/driveline.yaml"))
    0.9
    """
    stays = [location.dwell.min for location in system.locations if location.dwell.min]
    return system.observer.dwell or min(stays, default=None)


def assumed_window(system: HybridSystem) -> float:
    """Return how long a name may take, in s: half of the shortest stay, or of the shortest mean one."""
    return (shortest_stay(system) or min(system.observer.detector.stay.values())) / 2.0


def _mean_stay(system: HybridSystem, location: Location) -> float:
    stated = system.observer.detector.stay.get(location.name)
    shortest = location.dwell.min or system.observer.dwell
    if stated is None and not shortest:
        raise _impossible(
            f"location `{location.name}` has no mean stay (`stay`) and no shortest one (`dwell`)", location.span
        )
    return stated if stated is not None else STAYS * float(shortest or 0.0)


__all__ = ["Bank", "assumed_window", "bank_parts", "build_bank", "shortest_stay"]
