"""Location dynamics, residual generators and resets as the flat, sampled arrays of `StepTables`.

The channels of a location are spread over those of the system: a column or row that a location does not have is zero,
and a channel that it does not measure has weight zero in its residual.

In: a hybrid system, gains, a detector, a step.  Out: `FlowTables`, `GeneratorTables`, reset arrays.
Cost: a matrix exponential per location with a gain.  Source: Balluchi et al. (2012), section 4.2, (21) and (22).
"""

from collections.abc import Iterator, Sequence

import numpy as np

from deshybrid.continuous.gains import ObserverGains
from deshybrid.detector.bank import Bank
from deshybrid.detector.detector import TransitionDetector
from deshybrid.detector.held_back import realised
from deshybrid.detector.residual import ResidualGenerator, sampled_dynamics
from deshybrid.diagnostics import Diagnostic, GainError, ModelError, diagnostic, raise_all
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import AffineReset, HybridSystem, HybridTransition, Location
from deshybrid.observer.tables import BankTables, DecisionTables, FlowTables, GeneratorTables

ROUNDING = 1e-9
"""Eigenvalues of a sampled matrix are right to this share."""


def fill_flow(system: HybridSystem, gains: ObserverGains | None, step: float) -> FlowTables:
    """Return x := (A_d - G_d C) x + (B_d - G_d D) u + G_d y + f_d - G_d g for every location with a gain.

    The error of this observer obeys e := (A_d - G_d C) e exactly, as long as input and disturbance are constant between
    samples.  Raises `GainError` (DH0606) where it grows although the continuous one decays: the step is too long.
    Modes that no gain moves may grow: other locations are then relied on.
    """
    n, m, p, count = *_sizes(system), len(system.locations)
    matrix, input_part = np.zeros((count, n, n)), np.zeros((count, n, m))
    output_part, offset = np.zeros((count, n, p)), np.zeros((count, n))
    problems: list[Diagnostic] = []
    defined = []
    for i, location in enumerate(system.locations):
        gain = None if gains is None else gains.gains.get(location.name)
        defined.append(gain is not None)
        if gains is None or gain is None or location.dynamics is None:
            continue
        sampled, sampled_gain = _sampled(system, location.dynamics, gain, step)
        matrix[i] = sampled.A - sampled_gain @ sampled.C
        fixed = gains.fixed_modes[location.name]
        kept = fixed if system.time_step is not None else np.exp(fixed * step)
        problems += _growth(location, matrix[i], step, float(np.abs(kept).max(initial=0.0)))
        input_part[i][:, list(location.input_index)] = sampled.B - sampled_gain @ sampled.D
        output_part[i][:, list(location.output_index)] = sampled_gain
        offset[i] = sampled.f - sampled_gain @ sampled.g
    raise_all(problems, GainError)
    start = np.zeros(n) if system.observer.initial_state is None else system.observer.initial_state
    return FlowTables(
        matrix=frozen_array(matrix, (count, n, n)),
        input=frozen_array(input_part, (count, n, m)),
        output=frozen_array(output_part, (count, n, p)),
        offset=frozen_array(offset, (count, n)),
        start=frozen_array(start, (n,)),
        defined=tuple(defined),
    )


def _sizes(system: HybridSystem) -> tuple[int, int, int]:
    return len(system.state_names), len(system.input_names), len(system.output_names)


def _sampled(
    system: HybridSystem, dynamics: LinearDynamics, gain: FloatArray, step: float
) -> tuple[LinearDynamics, FloatArray]:
    if system.time_step is not None:
        return dynamics, gain
    from deshybrid.linear.sampling import sample_gain

    return sampled_dynamics(system, dynamics, step), sample_gain(dynamics, gain, step)


def _growth(location: Location, matrix: FloatArray, step: float, kept: float) -> Iterator[Diagnostic]:
    """A problem where the error grows, unless that is the growth `kept` of modes that no gain moves."""
    radius = float(np.max(np.abs(np.linalg.eigvals(matrix)), initial=0.0))
    if radius >= 1.0 and radius > kept * (1 + ROUNDING):
        message = f"with a step of {step:g} s the sampled observer of location `{location.name}` does not contract"
        fact = f"its error grows by a factor of {radius:.4g} a step"
        yield diagnostic(
            "DH0606", message, location.span, notes=(fact,), helps=("take a shorter step or smaller gains",)
        )


def fill_generators(system: HybridSystem, detector: TransitionDetector | None) -> GeneratorTables:
    """Return the residual generators of a detector, each filled up with zeros to the largest order, (G, k, ...)."""
    made, places = _running(detector)
    generators = tuple(realised(generator) for generator in made)
    levels = [] if detector is None else [detector.thresholds[place].level for place in places]
    k = max((len(generator.F) for generator in generators), default=0)
    parts = [_spread(system, generator, level, k) for generator, level in zip(generators, levels, strict=True)]
    count, (_, m, p) = len(parts), _sizes(system)
    names = [location.name for location in system.locations]

    def stack(name: str, *shape: int) -> FloatArray:
        return frozen_array(np.array([part[name] for part in parts]).reshape((count, *shape)), (count, *shape))

    return GeneratorTables(
        locations=tuple(names.index(generator.location.name) for generator in generators),
        matrix=stack("matrix", k, k),
        input=stack("input", k, m),
        output=stack("output", k, p),
        offset=stack("offset", k),
        start=stack("start", k, p),
        start_offset=stack("start_offset", k),
        residual_state=stack("residual_state", p, k),
        residual_input=stack("residual_input", p, m),
        residual_output=stack("residual_output", p, p),
        residual_offset=stack("residual_offset", p),
        weight=stack("weight", p),
        release=frozen_array(np.full(count, detector.release if detector else 1.0), (count,)),
        on_ticks=tuple(detector.on_ticks[place] for place in places) if detector else (),
        off_ticks=tuple(detector.off_ticks[place] for place in places) if detector else (),
    )


def _running(detector: TransitionDetector | None) -> tuple[tuple[ResidualGenerator, ...], Sequence[int]]:
    """The generators that run, and which of the detector's each stands for: interacting filters have some besides."""
    if detector is None:
        return (), ()
    bank = detector.decision.bank
    if bank is None:
        return detector.generators, range(len(detector.generators))
    return bank.generators, bank.owner


def _spread(system: HybridSystem, generator: ResidualGenerator, level: FloatArray, size: int) -> dict[str, FloatArray]:
    """One generator of order k <= size with the channels of the system, by the names of `GeneratorTables`."""
    _, m, p = _sizes(system)
    own, columns, outputs = range(len(generator.F)), generator.location.input_index, generator.location.output_index
    rows = [outputs[channel] for channel in generator.channels]
    shown = np.zeros(p)
    shown[rows] = 1.0 / level
    return {
        "matrix": _placed(generator.F, (size, size), own, own),
        "input": _placed(generator.input, (size, m), own, columns),
        "output": _placed(generator.gain, (size, p), own, outputs),
        "offset": _placed(generator.offset[:, None], (size, 1), own, (0,))[:, 0],
        "start": _placed(generator.start, (size, p), own, outputs),
        "start_offset": _placed(generator.start_offset[:, None], (size, 1), own, (0,))[:, 0],
        "residual_state": _placed(generator.H, (p, size), rows, own),
        "residual_input": _placed(generator.through, (p, m), rows, columns),
        "residual_output": _placed(generator.J, (p, p), rows, outputs),
        "residual_offset": _placed(generator.residual_offset[:, None], (p, 1), rows, (0,))[:, 0],
        "weight": shown,
    }


def _placed(part: FloatArray, shape: tuple[int, int], rows: Sequence[int], columns: Sequence[int]) -> FloatArray:
    """The matrix with `part` at these rows and columns, and zeros elsewhere."""
    whole = np.zeros(shape)
    whole[np.ix_(rows, columns)] = part
    return whole


def fill_decision(system: HybridSystem, detector: TransitionDetector | None) -> DecisionTables:
    """Return the constants of a detector's decision; those of the relay where there is none."""
    if detector is None or detector.decision.kind == "relay":
        return DecisionTables()
    design, p = detector.decision, len(system.output_names)
    made, _ = _running(detector)
    whitening = np.zeros((len(made), p, p))
    for g, (generator, white) in enumerate(zip(made, design.whitening, strict=False)):
        rows = [generator.location.output_index[channel] for channel in generator.channels]
        whitening[g] = _placed(white, (p, p), rows, rows)
    return DecisionTables(
        kind=design.kind,
        exclude_ticks=design.exclude_ticks,
        patience_ticks=detector.window_ticks + 1,
        whitening=frozen_array(whitening, whitening.shape),
        test=frozen_array(np.array(design.test).reshape((len(design.test), 4)), (len(design.test), 4)),
        limits=np.zeros(0) if design.limits is None else design.limits,
        bank=None if design.bank is None else _bank_tables(design.bank),
    )


def _bank_tables(bank: Bank) -> BankTables:
    return BankTables(bank.owner, bank.chain, bank.share, bank.power, float(bank.freedom), bank.confidence)


def fill_resets(
    system: HybridSystem, persistent: tuple[str, ...]
) -> tuple[tuple[tuple[int, ...], ...], FloatArray, FloatArray]:
    """Return `reset_index` (L, L), `reset_matrix` (K, n, n) and `reset_offset` (K, n) for the transitions i -> j.

    A reset that changes nothing has index -1; where none changes anything the index is empty.  Raises `ModelError`
    (DH0605) where two transitions from the same persistent location to the same target have different resets: the
    observer knows locations, not transitions.
    """
    n, count = len(system.state_names), len(system.locations)
    place = {location.name: number for number, location in enumerate(system.locations)}
    first: dict[tuple[int, int], HybridTransition] = {}
    problems = []
    for transition in system.transitions:
        known = first.setdefault((place[transition.source], place[transition.target]), transition)
        if transition.source in persistent and not _same(known.reset, transition.reset):
            problems.append(_two_resets(known, transition))
    raise_all(problems, ModelError)
    index = [[-1] * count for _ in range(count)]
    resets: list[AffineReset] = []
    for (source, target), transition in first.items():
        reset = transition.reset
        if reset is not None and not reset.changes_nothing:
            index[source][target] = len(resets)
            resets.append(reset)
    matrices = np.array([reset.matrix for reset in resets]).reshape((len(resets), n, n))
    offsets = np.array([reset.offset for reset in resets]).reshape((len(resets), n))
    rows = tuple(map(tuple, index)) if resets else ()
    return rows, frozen_array(matrices, matrices.shape), frozen_array(offsets, offsets.shape)


def _same(first: AffineReset | None, second: AffineReset | None) -> bool:
    if first is None or second is None:
        return first is second
    return np.array_equal(first.matrix, second.matrix) and np.array_equal(first.offset, second.offset)


def _two_resets(first: HybridTransition, second: HybridTransition) -> Diagnostic:
    return diagnostic(
        "DH0605",
        f"two transitions from `{first.source}` to `{first.target}` have different resets",
        second.span,
        "this reset",
        context=((first.span, "differs from this one"),),
        notes=("the observer resets its estimate by the pair of locations, whichever of the transitions was taken",),
        helps=("give both the same reset, or split the target location in two",),
    )


__all__ = ["fill_decision", "fill_flow", "fill_generators", "fill_resets"]
