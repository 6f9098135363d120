"""Determinability as a part of a design: which locations rely on each other, and what is proven of them.

In: a system with its gains.  Out: Theorem 4 where the locations form one cycle, and the contraction over the box of
all stays, for the error in continuous time and for that of the sampled observer.

Source: Balluchi et al. (2003), Theorem 4; `determinability_contraction` for what goes beyond it.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TypeAlias

from deshybrid.continuous.determinability import Determinability, determinability
from deshybrid.continuous.determinability_contraction import ContractionCertificate, Stay, certify_box
from deshybrid.continuous.determinability_gains import (
    determinable_gains,
    relies_on_others,
    sojourn_box,
    stated_coordinates,
)
from deshybrid.continuous.error import ErrorReset, dynamics_of, error_dynamics, error_resets, sampled_error_dynamics
from deshybrid.continuous.gains import Method, ObserverGains
from deshybrid.continuous.methods import gains_by_method
from deshybrid.diagnostics import Diagnostic, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem

Stays: TypeAlias = Mapping[str, Stay] | None
"""Shortest and longest stay (s) by location; None where some longest one is not stated."""


@dataclass(frozen=True, slots=True, eq=False)
class Determined:
    """What is known of locations that do not show their whole state.

    required: some location is not detectable, so that the error decays only if the others take part; theorem: Theorem 4
    where the locations form one cycle; certificates: the contraction, none where a longest stay is not stated.
    """

    required: bool
    theorem: Determinability | None
    certificates: tuple[ContractionCertificate, ...] = ()

    @property
    def holds(self) -> bool:
        """True where the contraction is certified, of the sampled observer too."""
        return bool(self.certificates) and all(certificate.holds for certificate in self.certificates)

    @property
    def decides(self) -> bool:
        """True where the contraction, looked for at least, is all that the design can rest on."""
        return self.required and bool(self.certificates)

    @property
    def rate(self) -> float:
        """The certified rate (1/s) over many switches, if all stays are the longest."""
        return min((certificate.rate for certificate in self.certificates), default=0.0)

    @property
    def problems(self) -> tuple[Diagnostic, ...]:
        """A warning (DH0521) for every contraction that was needed and not certified."""
        if not self.required:
            return ()
        return tuple(
            diagnostic("DH0521", f"{entry.theorem}: {entry.reason}", helps=(_HELP,), severity="warning")
            for entry in self.certificates
            if not entry.holds
        )

    def record(self, alone: bool = False) -> dict[str, object] | None:
        """Return Theorem 4 as JSON; `alone`: the locations are certified without each other, for all longer stays."""
        return None if self.theorem is None else self.theorem.record(contracts=self.holds or alone)

    def __str__(self) -> str:
        lines = [] if self.theorem is None else str(self.theorem).splitlines()
        lines += [f"{c.theorem}: {'holds' if c.holds else 'does not hold'}: {c.reason}" for c in self.certificates]
        return "\n".join(f"  {line}" for line in lines)


_HELP = "shorten the longest stays, lengthen the shortest ones, or measure what no location of the round shows"


def theorem_4(
    system: HybridSystem,
    locations: tuple[str, ...],
    gains: Mapping[str, FloatArray] | None = None,
    stays: Stays = None,
) -> Determinability | None:
    """Return Theorem 4, or None where the locations do not form one cycle or every one of them is observable."""
    cycle = _single_cycle(locations, error_resets(system, locations))
    if not cycle:
        return None
    order = tuple(reset.source for reset in cycle)
    splits = {name: stated_coordinates(system, name) for name in order}
    if (
        all(split.observable_dimension == len(split.inverse) for split in splits.values())
        or system.time_step is not None
    ):
        return None
    bounds = None if stays is None else (min(s[0] for s in stays.values()), max(s[1] for s in stays.values()))
    dynamics = {name: dynamics_of(system, name) for name in order}
    return determinability(order, dynamics, splits, cycle, gains=gains, stays=bounds)


def gains_alone_or_together(
    system: HybridSystem, locations: tuple[str, ...], *, rate: float | None, dwell: float | None, method: Method
) -> tuple[ObserverGains, Stays]:
    """Return the gains, and the stays that the model states: by the method where each location can do alone.

    Where one cannot and all longest stays are stated, those of `determinable_gains`.  Raises what these two raise.

    >>> from deshybrid.model.load import load
    >>> twin = load("models/two_tank.yaml")
    >>> gains_alone_or_together(twin, ("fill", "drain"), rate=None, dwell=None, method="place")[0].sources["drain"]
    'search'
    """
    stays = sojourn_box(system, locations, dwell)
    if stays is not None and relies_on_others(system, locations):
        return determinable_gains(system, locations, stays, rate=rate), stays
    return gains_by_method(system, locations, rate=rate, dwell=dwell, method=method), stays


def determined(
    system: HybridSystem,
    gains: ObserverGains,
    stays: Stays,
    *,
    step: float,
    delay: float = 0.0,
) -> Determined | None:
    """Return what is determined by locations together, None where each of them is observable.

    stays (s) by location, None where a longest one is not stated; step (s): of the sampled observer; delay (s): the
    detection delay, by which its stays differ from the plant's.

    >>> from deshybrid.model.load import load
    >>> system, names = load("models/balluchi2003/three_locations.yaml"), ("q1", "q2", "q3")
    >>> stays = sojourn_box(system, names)
    >>> found = determined(system, determinable_gains(system, names, stays), stays, step=0.01)
    >>> found.required, found.holds, found.theorem.start.location
    (True, True, 'q3')
    """
    if not any(len(modes) for modes in gains.fixed_modes.values()):
        return None
    theorem, required = (
        theorem_4(system, gains.locations, gains.gains, stays),
        relies_on_others(system, gains.locations),
    )
    if stays is None or (theorem is None and not required):
        return Determined(required, theorem)
    late = delay + (0.0 if system.time_step is not None else step)
    return Determined(
        required,
        theorem,
        (
            certify_box(error_dynamics(system, gains.gains), stays, gains.scale, delay=delay),
            certify_box(sampled_error_dynamics(system, gains.gains, step), stays, gains.scale, delay=late),
        ),
    )


def determined_without_gains(system: HybridSystem, locations: tuple[str, ...]) -> Determined | None:
    """Return what can be said where no gains exist, because the longest stays are not stated or gains do not fit."""
    theorem = theorem_4(system, locations)
    return None if theorem is None else Determined(relies_on_others(system, locations), theorem)


def _single_cycle(locations: tuple[str, ...], resets: tuple[ErrorReset, ...]) -> tuple[ErrorReset, ...]:
    """The resets in the order of the only cycle, through all locations; empty where there is no such cycle."""
    exits = {reset.source: reset for reset in resets}
    if not locations or len(resets) != len(locations) or len(exits) != len(locations):
        return ()
    order, place = [], locations[0]
    for _ in locations:
        order.append(exits[place])
        place = exits[place].target
    return tuple(order) if place == locations[0] and len({r.source for r in order}) == len(locations) else ()


__all__ = ["Determined", "Stays", "determined", "determined_without_gains", "gains_alone_or_together", "theorem_4"]
