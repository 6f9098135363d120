"""The hybrid system H: locations with linear dynamics, transitions with resets, bounds, and wishes for its observer.

All values are frozen and their arrays read-only.  A purely discrete model has no state: `is_discrete` is true and every
location's `dynamics` is None.  Names are the text as written.  Source: Balluchi et al. (2012), section 2, (1)-(15).
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from deshybrid.diagnostics import Span, UsageError, diagnostic
from deshybrid.diagnostics.pictured import Pictured
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.predicates import Predicate

if TYPE_CHECKING:
    from deshybrid.model.source import SourceModel

Decision: TypeAlias = Literal["relay", "exclusion", "sprt", "glr", "imm"]
GeneratorDesign: TypeAlias = Literal["luenberger", "unknown_input", "h2", "auto"]


def _nothing() -> Mapping[str, Any]:
    return MappingProxyType({})


@dataclass(frozen=True, slots=True)
class Dwell:
    """Shortest and longest stay in seconds; `None` = not stated."""

    min: float | None = None
    max: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class NoiseForm:
    """In what the noise of a location is more than white with a fixed covariance; by default in nothing.

    The step adds e1 G1 x with G1 = `process_by_state` (n, n), the measurement e2 G2 x with G2 = `measurement_by_state`
    (p, n), e1 and e2 white with variance 1; x is the state before the step, and that which is measured.  A `share` of
    the rows has a measurement noise, e2 G2 x included, whose covariance is `factor` times as large: heavy tails.
    """

    process_by_state: FloatArray | None = None
    measurement_by_state: FloatArray | None = None
    share: float = 0.0
    factor: float = 1.0

    @property
    def keys(self) -> tuple[str, ...]:
        """The keys of `noise` that say so, in the model's words; empty for white noise of a fixed covariance."""
        there = {
            "process_by_state": self.process_by_state is not None,
            "measurement_by_state": self.measurement_by_state is not None,
            "tails": self.share > 0.0,
        }
        return tuple(key for key, stated in there.items() if stated)

    def require_fixed(self, what: str, location: str, *, of: tuple[str, ...] | None = None) -> None:
        """Raise `UsageError` (DH1120) where it has keys, or some `of` them: `what` does not know them."""
        keys = [key for key in self.keys if of is None or key in of]
        if keys:
            named = " and ".join(f"`{key}`" for key in keys)
            helps = ("`estimate` knows it with `imm`, `mmae` and `skf`; heavy tails are there instead of a gate",)
            raise UsageError(
                diagnostic("DH1120", f"{what} does not know {named} of the noise of `{location}`", helps=helps)
            )


@dataclass(frozen=True, slots=True, eq=False)
class Location:
    """One location q with its dynamics; `output_index` and `input_index` place its channels among the system's."""

    name: str
    dynamics: LinearDynamics | None = None
    dwell: Dwell = Dwell()
    invariant: Predicate | None = None
    input_index: tuple[int, ...] = ()
    output_index: tuple[int, ...] = ()
    process_noise: FloatArray | None = None  # (n, n) covariance
    measurement_noise: FloatArray | None = None  # (p, p) covariance
    span: Span | None = field(default=None, repr=False)
    spans: Mapping[str, Span] = field(default_factory=_nothing, repr=False)  # by key: "A", "C", ...
    observed_as: str | None = None  # a location of a coarser model; None: the one of the same name
    noise_form: NoiseForm = NoiseForm()
    deviation: LinearDynamics | None = None  # the largest |true - nominal| of each entry; None: nothing is stated


@dataclass(frozen=True, slots=True, eq=False)
class AffineReset:
    """x := matrix x + offset at a transition; matrix (n, n), offset (n,)."""

    matrix: FloatArray
    offset: FloatArray

    @property
    def changes_nothing(self) -> bool:
        """Whether the state stays as it is."""
        rows = enumerate(self.matrix.tolist())
        return not self.offset.any() and all(value == (i == j) for i, row in rows for j, value in enumerate(row))


@dataclass(frozen=True, slots=True)
class Command:
    """A discrete action of a controller that is known at every sample, and the values it may have."""

    name: str
    values: tuple[str, ...]
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class HybridTransition:
    """`source` —event→ `target`; `outputs` are the possible γ, `None` = ε; without a guard the event is exogenous.

    `when`: the values that commands must have for it; a command that is not named may have any.
    """

    source: str
    event: str
    target: str
    outputs: tuple[str | None, ...] = (None,)
    guard: Predicate | None = None
    reset: AffineReset | None = None  # None in a discrete model; the identity where not written
    span: Span | None = field(default=None, repr=False)
    output_span: Span | None = field(default=None, repr=False)
    when: Mapping[str, tuple[str, ...]] = field(default_factory=_nothing)


@dataclass(frozen=True, slots=True, eq=False)
class Bounds:
    """|.| per channel: state (n,), input (m,), disturbance (r,), measurement (p,); `None` where not stated."""

    state: FloatArray | None = None
    input: FloatArray | None = None
    disturbance: FloatArray | None = None
    measurement: FloatArray | None = None


@dataclass(frozen=True, slots=True)
class SignatureCandidate:
    """What the model says of the signature of one location."""

    location: str
    cost: float = 1.0
    by: Literal["residual", "negation"] | None = None  # None: either
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class CoveringDetector:
    """A detector that the model offers: it announces the entry of any of the locations `covers`, all in one way."""

    name: str
    covers: tuple[str, ...]
    cost: float = 1.0
    span: Span | None = field(default=None, compare=False, repr=False)


@dataclass(frozen=True, slots=True)
class SignatureOptions:
    """`candidates` None: any location may have a signature, cost 1; `forbid`: (source, target) never instrumented."""

    candidates: tuple[SignatureCandidate, ...] | None = None
    forbid: tuple[tuple[str, str], ...] = ()
    detectors: tuple[CoveringDetector, ...] = ()


@dataclass(frozen=True, slots=True, eq=False)
class DetectorOptions:
    """What the model file fixes of the transition detector; `None` or a missing location = derived.

    `decision`: how residuals become decisions.  `poles` (rad/s) per location; `threshold`: the residual level, in
    output units per channel, below which a location counts as matching; `release`: factor >= 1 from the lower to the
    upper relay level; `debounce`, `window`: seconds; `false_alarm`: 1/s.
    `design`: how residual generators are made (None: poles placed, or white for tests); `decouple`: the disturbances
    that they must not see (None: as many as can be), for the designs `unknown_input` and `auto`; `delay`: seconds by
    which each output of the system is measured late, (p,).
    Of interacting filters: `confidence`, the probability from which a location is named; `stay`, the mean stay per
    location (s); `entry`, the process noise (n, n) that is added after an entry, and `entry_time`, for how long (s).
    """

    poles: Mapping[str, tuple[complex, ...]] = field(default_factory=_nothing)
    threshold: Mapping[str, FloatArray] = field(default_factory=_nothing)
    release: float | None = None
    debounce: float | None = None
    window: float | None = None
    decision: Decision | None = None
    design: GeneratorDesign | None = None
    decouple: tuple[str, ...] | None = None
    delay: FloatArray | None = None
    false_alarm: float | None = None
    confidence: float | None = None
    stay: Mapping[str, float] = field(default_factory=_nothing)
    entry: Mapping[str, FloatArray] = field(default_factory=_nothing)
    entry_time: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class ObserverOptions:
    """What the model file asks of the observer; rate in 1/s, dwell and step in seconds, poles in rad/s."""

    rate: float | None = None
    dwell: float | None = None
    step: float | None = None
    poles: Mapping[str, tuple[complex, ...]] = field(default_factory=_nothing)
    gains: Mapping[str, FloatArray] = field(default_factory=_nothing)
    coordinates: Mapping[str, FloatArray] = field(default_factory=_nothing)
    initial_state: FloatArray | None = None
    detector: DetectorOptions = DetectorOptions()


@dataclass(frozen=True, slots=True)
class MeasurementModel:
    """How a sensor distorts one output or input, in the order in which it does.

    `lag`: time constant (s) of the first order; `delay` in s; `period`: it takes a value every so many s and holds it;
    `bias`: a constant error; `noise`: deviation of white noise; `quantum`: rounding to multiples of it.  0 = not.
    """

    lag: float = 0.0
    delay: float = 0.0
    period: float = 0.0
    bias: float = 0.0
    noise: float = 0.0
    quantum: float = 0.0


@dataclass(frozen=True, slots=True)
class SignalModel:
    """A test signal: linear interpolation of `points` (time, value) held outside, steps where `hold`, plus a ripple.

    ripple: `amplitude` · sin(2π · `frequency` · t); jitter: uniform in ±`random`, redrawn every `period` seconds.
    """

    points: tuple[tuple[float, float], ...] = ()
    hold: bool = True
    amplitude: float = 0.0
    frequency: float = 0.0
    random: float = 0.0
    period: float = 1.0


@dataclass(frozen=True, slots=True)
class Variation:
    """How the drives of a campaign differ, beside their seeds: each number is the half width of a uniform variation.

    `requests` in s, added to each request; the others are shares: of an input's and of a disturbance's points (one
    factor a channel and drive), of each component of the initial state, and of all times of the drive (`pace`: one
    factor a drive, for requests, points and duration).
    """

    requests: float = 0.0
    input: float = 0.0
    disturbance: float = 0.0
    state: float = 0.0
    pace: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class RatioComparison:
    """A location is named where `numerator` over `denominator`, two outputs, lies within `band` of its `ratio`.

    `otherwise` is named while none fits (None: nothing is).  Another answer must last for `debounce` (s) to be named;
    no ratio fits while the size of the denominator is at most `slowest`.
    """

    numerator: str
    denominator: str
    ratio: Mapping[str, float]
    otherwise: str | None = None
    band: float = 0.04
    debounce: float = 0.0
    slowest: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class SimulationOptions:
    """How `simulate` drives the model: the plant's signals, and what the sensors make of them.

    `requests` (time, event): an exogenous event asked for at that time, taken as soon as its guard holds.
    `unmeasured` adds to an input what the trace does not tell (a torque ripple, say).  `commands`: (time, value), held.
    """

    duration: float | None = None
    location: str | None = None
    state: FloatArray | None = None
    requests: tuple[tuple[float, str], ...] = ()
    input: Mapping[str, SignalModel] = field(default_factory=_nothing)
    unmeasured: Mapping[str, SignalModel] = field(default_factory=_nothing)
    disturbance: Mapping[str, SignalModel] = field(default_factory=_nothing)
    measurement: Mapping[str, MeasurementModel] = field(default_factory=_nothing)
    variation: Variation = Variation()
    comparison: RatioComparison | None = None
    commands: Mapping[str, tuple[tuple[float, str], ...]] = field(default_factory=_nothing)


@dataclass(frozen=True, slots=True, eq=False)
class Prior:
    """Mean, covariance and location probabilities one step before the first row of a trace."""

    mean: FloatArray | None = None
    covariance: FloatArray | None = None
    probability: Mapping[str, float] = field(default_factory=_nothing)


@dataclass(frozen=True, slots=True, eq=False, repr=False)
class HybridSystem(Pictured):
    """H: the whole model as numbers, each value leading back to the line of the file it came from."""

    name: str
    locations: tuple[Location, ...]
    transitions: tuple[HybridTransition, ...]
    initial: tuple[str, ...]
    state_names: tuple[str, ...] = ()
    input_names: tuple[str, ...] = ()
    output_names: tuple[str, ...] = ()
    disturbance_names: tuple[str, ...] = ()
    units: Mapping[str, str] = field(default_factory=_nothing)  # by channel name
    time_step: float | None = None  # None = continuous time
    bounds: Bounds = Bounds()
    signatures: SignatureOptions = SignatureOptions()
    observer: ObserverOptions = ObserverOptions()
    simulation: SimulationOptions = SimulationOptions()
    probability_from_to: Mapping[str, Mapping[str, float]] | None = None
    prior: Prior | None = None
    summary: str = ""
    source_note: str = ""
    source: "SourceModel | None" = field(default=None, repr=False)
    commands: tuple[Command, ...] = ()
    tolerance: Mapping[str, float] = field(default_factory=_nothing)  # share of its value, by parameter

    @property
    def command_names(self) -> tuple[str, ...]:
        """The names of the commands."""
        return tuple(command.name for command in self.commands)

    @property
    def is_discrete(self) -> bool:
        """True where the model has no continuous state."""
        return not self.state_names

    def _drawn(self) -> object:
        from deshybrid.model.abstraction import abstract

        return abstract(self)

    def __repr__(self) -> str:
        return (
            f"<HybridSystem {self.name}: {len(self.locations)} locations, {len(self.transitions)} transitions, "
            f"states {self.state_names}, inputs {self.input_names}, outputs {self.output_names}>"
        )

    def location(self, name: str) -> Location:
        """Return the location of that name; KeyError if there is none."""
        found = next((location for location in self.locations if location.name == name), None)
        if found is None:
            raise KeyError(name)
        return found

    def successors(self, name: str) -> tuple[str, ...]:
        """Return Reach(q): the locations one transition away, in order of declaration."""
        targets = {t.target for t in self.transitions if t.source == name}
        return tuple(location.name for location in self.locations if location.name in targets)
