"""The constants of one hybrid observer, flat and complete: all that a step needs, in any language.

`HybridObserver` fills them; the reference step, the generated Python and the generated C read them and nothing else, in
the same order of operations, so that the three agree bit for bit.

One tick k, with the sample (u_k, y_k, event code) at time k·step:
1. Unless it is the first tick: every generator state z and, while `flow` >= 0, the estimate x advance over the past step
   with the held previous sample: z := zM z + zU u' + zY y' + zc, x := xM[flow] x + xU u' + xY y' + xc.
   At the first tick z := z_start y + z_start_offset and x := x_start.
2. Residual of generator g at the new sample: r = rC z + rD u + rg - y; level = max over channels of |r_c| · weight_c.
   Relay: on when level <= 1, off when level > release, else as before.  Debounce: a generator becomes active after
   `on_ticks` consecutive ticks with the relay on, inactive after `off_ticks` consecutive ticks with it off.
3. Tracker: (a) an event moves to `on_event[state][event]`, or, where that is -1, reports `inconsistent` and moves to
   `restart_on_event[event]`; (b) without event, a state with a `timeout_target` >= 0 or -2 left in silence for
   `window_ticks` moves there (-2: inconsistent, to `restart`); (c) then the first candidate of the state whose condition
   holds moves to its target.  A candidate holds when its `active` generator (if >= 0) is active and none of its `quiet`
   generators is; the signature that fired last cannot fire again before its condition was false or it was no candidate.
4. On a move into an identified state (location j) with `flow` = i >= 0: x := R1 x + R0 of `reset_index[i][j]` where >= 0.
   `flow` becomes j in an identified state, stays in a provisional one, and becomes -1 (hold) in any other.

A sample with a number that is not finite is reported as `invalid`: nothing changes but the tick counter.
"""

from dataclasses import dataclass

from deshybrid.linear.arrays import FloatArray

STATUS_NAMES = ("searching", "identified", "provisional", "inconsistent", "invalid")


@dataclass(frozen=True, slots=True, eq=False)
class FlowTables:
    """Sampled continuous observer, per location: x := matrix x + input u + output y + offset.

    Shapes: matrix (L, n, n), input (L, n, m), output (L, n, p), offset (L, n), start (n,); `defined` (L,): false where a
    location has no continuous observer (then `flow` is -1 there).
    """

    matrix: FloatArray
    input: FloatArray
    output: FloatArray
    offset: FloatArray
    start: FloatArray
    defined: tuple[bool, ...]


@dataclass(frozen=True, slots=True, eq=False)
class GeneratorTables:
    """Sampled residual generators, G of them, with relay and debounce.

    Shapes: matrix (G, n, n), input (G, n, m), output (G, n, p), offset (G, n), start (G, n, p), start_offset (G, n);
    residual_state (G, p, n), residual_input (G, p, m), residual_offset (G, p), weight (G, p): 1/threshold, 0 where the
    location does not measure the channel; release (G,) >= 1; on_ticks, off_ticks (G,) >= 1.
    """

    locations: tuple[int, ...]
    matrix: FloatArray
    input: FloatArray
    output: FloatArray
    offset: FloatArray
    start: FloatArray
    start_offset: FloatArray
    residual_state: FloatArray
    residual_input: FloatArray
    residual_offset: FloatArray
    weight: FloatArray
    release: FloatArray
    on_ticks: tuple[int, ...]
    off_ticks: tuple[int, ...]


@dataclass(frozen=True, slots=True)
class Candidate:
    """A signature the tracker listens for in one state."""

    signature: int
    active: int  # generator that must be active, -1 = none (negation)
    quiet: tuple[int, ...]  # generators that must not be active
    target: int  # tracker state


@dataclass(frozen=True, slots=True)
class TrackerState:
    """A state of the location observer at run time: an entry estimate, or a provisional one while a signature is due."""

    entry_estimate: tuple[int, ...]  # location numbers
    location: int  # location number where identified, else -1
    provisional: bool
    on_event: tuple[int, ...]  # by event number (code - 1): tracker state or -1
    candidates: tuple[Candidate, ...]
    timeout_target: int = -1  # tracker state, -1 = no timeout, -2 = inconsistent


@dataclass(frozen=True, slots=True, eq=False)
class StepTables:
    """All constants of one hybrid observer; see the module's text for the meaning of a tick.

    Event codes: 0 = no output seen, e + 1 = `event_names[e]`.
    """

    name: str
    step: float
    location_names: tuple[str, ...]
    state_names: tuple[str, ...]
    input_names: tuple[str, ...]
    output_names: tuple[str, ...]
    event_names: tuple[str, ...]
    signature_names: tuple[str, ...]
    flow: FlowTables
    generators: GeneratorTables
    tracker: tuple[TrackerState, ...]
    initial: int
    restart: int
    restart_on_event: tuple[int, ...]
    window_ticks: int
    reset_index: tuple[tuple[int, ...], ...]  # (L, L), -1 = keep the state
    reset_matrix: FloatArray  # (K, n, n)
    reset_offset: FloatArray  # (K, n)
