"""How residual generators are made: by the design that the model asks for, on samples of one time.

In: a system, a location, rate, dwell time and step.  Out: a `ResidualGenerator`.
- `luenberger`: the paper's bank, poles placed (`residual`).
- `unknown_input`: disturbances are decoupled and the poles of what is left placed (`unknown_input`): those named under
  `decouple`, else the one that buys the largest `contrast`, and further ones while they buy more; a location where none
  can be decoupled gets `h2`.
- `h2`: nothing decoupled, the gain the best trade-off of disturbance and noise at the wanted speed (`trade_off`).
- `auto`: these, and the trade-off for what is left after decoupling; of all that of the largest contrast, the first in
  this order where nothing is gained.
The speed is that of the stated poles (the slowest), else of the default ones.

Tests (`sprt`, `glr`) need white residuals (`innovation`), with nothing decoupled, or as `unknown_input` says; other
designs are refused.

Outputs that are measured late are taken together as of one time (`held_back`).

Cost: that of one design and its contrast for every disturbance that can be decoupled, twice for `auto`.
Source: Balluchi et al. (2012), section 5.1.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import TypeAlias

from deshybrid.detector.contrast import contrast
from deshybrid.detector.held_back import held_back
from deshybrid.detector.innovation import white_generator
from deshybrid.detector.residual import Followed, ResidualGenerator, default_poles, follow, placed_generator
from deshybrid.detector.trade_off import filtering_generator
from deshybrid.detector.unknown_input import decouplable, decoupled
from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location

Maker: TypeAlias = Callable[[Followed], ResidualGenerator]
GAIN = 1.05
"""A design of `auto` takes the place of an earlier one only for so much more contrast."""


def design_generator(
    system: HybridSystem,
    location: Location,
    *,
    rate: float | None,
    dwell: float | None,
    step: float,
    speed: float = 1.0,
) -> ResidualGenerator:
    """Return the residual generator of `location` by the design that the model asks for.

    Raises what `build_generator` does, and `UsageError` (DH0612) where nothing can be decoupled, (DH0613) where no
    filter is found.

    >>> from deshybrid.model.load import load
    >>> driveline = load("models/balluchi2012/driveline.yaml")
    >>> made = design_generator(driveline, driveline.location("q1"), rate=1.0, dwell=0.9, step=0.012)
    >>> made.F.shape, made.channels
    ((3, 3), (0, 1))
    """
    followed, wanted = follow(system, location, step), system.observer.detector.design

    def placed(part: Followed) -> ResidualGenerator:
        default = default_poles(len(part.A), rate=rate, dwell=dwell, step=step, speed=speed)
        return placed_generator(system, part, default)

    def filtering(part: Followed) -> ResidualGenerator:
        slowest = default_poles(1, rate=rate, dwell=dwell, step=step, speed=speed)
        stated = system.observer.detector.poles.get(location.name) or slowest
        return filtering_generator(system, part, -max(pole.real for pole in stated))

    if wanted in {None, "luenberger"}:
        _require_no_decoupling(system)
        return held_back(system, placed(followed))
    if wanted == "h2":
        _require_no_decoupling(system)
    possible = _may_decouple(system, followed)
    if wanted == "h2" or (wanted == "unknown_input" and not possible):
        return held_back(system, filtering(followed))
    if wanted == "unknown_input":
        return held_back(system, _decoupling(system, followed, placed)[1])
    choices = [placed(followed), filtering(followed)]
    if possible:
        choices += [_decoupling(system, followed, made)[1] for made in (placed, filtering)]
    return held_back(system, _best(system, choices))


def white_design(system: HybridSystem, location: Location, step: float) -> tuple[ResidualGenerator, FloatArray]:
    """Return a generator whose residual is white, by the design that the model asks for, and its covariance (q, q).

    Raises `UsageError` (DH0614) for a design whose residual is not white, or without noise; (DH0612) where nothing can
    be decoupled, `GainError` (DH0603) where the location measures nothing.
    """
    options, followed = system.observer.detector, follow(system, location, step)
    if options.design not in {None, "unknown_input"}:
        text = f"the detector cannot test residuals of the design `{options.design}`, which are not white"
        helps = (
            "leave `design` out for Kalman predictors, of least variance for the noise of the model, or write "
            "`design: unknown_input` for those that disturbances do not move",
        )
        raise UsageError(diagnostic("DH0614", text, helps=helps))
    if options.design is None:
        _require_no_decoupling(system)
    if options.design is None or not _may_decouple(system, followed):
        made, covariance = white_generator(system, followed)
        return held_back(system, made), covariance
    columns, made = _decoupling(system, followed, lambda part: white_generator(system, part)[0])
    _, covariance = white_generator(system, decoupled(system, followed, columns))
    return held_back(system, made), covariance


def _may_decouple(system: HybridSystem, followed: Followed) -> bool:
    return system.observer.detector.decouple is not None or bool(decouplable(followed.dynamics))


def _require_no_decoupling(system: HybridSystem) -> None:
    options = system.observer.detector
    if options.decouple is not None:
        text = f"`decouple` is stated, but the design is `{options.design or 'luenberger'}`, which decouples nothing"
        helps = ("write `design: unknown_input`, or leave `decouple` out",)
        raise UsageError(diagnostic("DH0612", text, helps=helps))


def _decoupling(system: HybridSystem, followed: Followed, made: Maker) -> tuple[tuple[int, ...], ResidualGenerator]:
    """What is decoupled: what the model names, or what buys contrast, one disturbance at least; and the generator."""

    def without(columns: tuple[int, ...]) -> ResidualGenerator:
        found = made(decoupled(system, followed, columns))
        names = ", ".join(f"`{system.disturbance_names[column]}`" for column in columns)
        return replace(found, design=f"{found.design}; decoupled from {names}")

    names = system.observer.detector.decouple
    if names is not None:
        columns = tuple(system.disturbance_names.index(name) for name in names)
        return columns, without(columns)
    best: tuple[tuple[int, ...], ResidualGenerator] | None = None
    while True:
        kept = () if best is None else best[0]
        sets = [tuple(sorted((*kept, column))) for column in decouplable(followed.dynamics, kept)]
        found = {columns: without(columns) for columns in sets}
        choice = _best(system, ([best[1]] if best else []) + list(found.values()))
        if best is not None and choice is best[1]:
            return best
        best = next((columns, generator) for columns, generator in found.items() if generator is choice)


def _best(system: HybridSystem, choices: Iterable[ResidualGenerator]) -> ResidualGenerator:
    """The generator of the largest contrast, the first of those that are nearly as good."""
    first, *others = choices
    best, size = first, contrast(system, first)
    for choice in others:
        other = contrast(system, choice)
        if other > GAIN * size:
            best, size = choice, other
    return best


__all__ = ["design_generator", "white_design"]
