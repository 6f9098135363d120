"""The constants of one hybrid observer, flat and complete: all that a step needs, in any language.

`HybridObserver` fills them; the reference step, the generated Python and the generated C read them and nothing else, in
the same order of operations, so that the three agree bit for bit.

One tick k, with the sample (u_k, y_k) and the event code at time k·step.  A sample is valid when every number v of it
meets -LARGEST <= v <= LARGEST (so neither NaN nor infinite); the held sample (u', y') is the last valid one.
1. Before the first valid sample nothing advances; with it, every z := z_start y + z_start_offset (x is x_start from the
   beginning).  At every later tick each generator state z and, while `flow` >= 0, the estimate x advance over the past
   step: z := zM z + zU u' + zY y' + zc, x := xM[flow] x + xU u' + xY y' + xc.
   A vector of which a number then leaves ±LARGEST is put back: z to z_start y' + z_start_offset, x to x_start.
2. A valid sample becomes the held one.  Residual of generator g at it: r = rZ z + rU u + rY y + rc.
   Relay: on while |r_c| · weight_c <= limit in every channel c; limit is 1 to switch on, `release` to stay on (a NaN
   switches it off).  Debounce: a generator becomes active after `on_ticks` consecutive ticks with the relay on,
   inactive after `off_ticks` consecutive ticks with it off.  At an invalid sample relay, debounce and activity stay.
   With another decision than the relay: `exclusion` keeps it, `sprt` and `glr` switch by a test of r instead (below),
   and `away` counts the valid ticks for which a generator has not been active, up to `patience_ticks`.
3. Commands: `age` of each value = ticks since it was on, 0 at a tick that brings it (or does not tell the command).
   A move that is seen at a tick may have happened while a value was on that is at most `command_slack` ticks old for an
   event, `window_ticks` for a signature.  A move by either puts older values to `window_ticks` + 1.
   Tracker (a table of states; the on-line tracker says the same of a state when it is asked).
   `silence` = ticks since the last move (0 at the move, and at the start; it stops at `window_ticks`);
   `seen` = generators active at the tick of the last move or at a later one, up to the tick before this one; `stale` =
   generators active at every tick since the one before the last move, where that was by an event and into no
   provisional state.
   (a) An event moves to `on_event[state][event]`; where that is -1 the tick is inconsistent and the move goes to
   `restart_on_event[event]`; a code that is no event moves to `restart`, inconsistent.
   (b) Then the first candidate of the state that holds moves to its target.  A candidate holds when its `active`
   generator is active, not stale (the residual of the location just left is still small when an event comes), and none
   of its `quiet` generators is active.  A negation (`active` = -1) holds when none of its `quiet`
   generators is active and either one of them is in `seen` or `silence` = `window_ticks`: generators that have not had
   the time to become active are no evidence.  A candidate whose target is the state itself (a self-loop) holds only at
   the tick at which its generator becomes active again: it is in `seen`, was not active a tick ago, and `silence` > 0.
   The signature that fired last does not hold again before, at some tick's step (b), its condition was false or it was
   no candidate.
   With another decision than the relay a candidate asks more of its `quiet` generators: each must have been away for
   `exclude_ticks`; where the generator of the identified location is the only one, it is enough that it is not active
   and that `silence` has reached these ticks.  A negation needs no other evidence in this latter case; else the
   generator of the location that its target identifies, if there is one, must be active.
   (c) Without a move in (a) and (b), a state with `timeout_target` /= -1 and `silence` = `window_ticks` moves there
   (-2: inconsistent, to `restart`).  With another decision than the relay, the tick is inconsistent and the state moves
   to `restart` too where neither (a) nor (b) nor a timeout moved it, the location is identified, `silence` =
   `window_ticks`, and its own generator has been away for `patience_ticks`: it was named wrongly, or left for a
   location that nothing shows.
4. At each move, into an identified state (location j): with `flow` = i >= 0, x := R1 x + R0 of `reset_index[i][j]`
   where that is >= 0; `flow` becomes j, or -1 where j has no continuous observer.  Into a provisional state `flow`
   stays, into any other it becomes -1 (x is held).  Before the first tick the rule is that of a move into `initial`.

Status: `inconsistent` if the tick was, else `invalid` if the sample was, else by the state: `identified`, `provisional`
or `searching`.  With another decision than the relay, an identified location whose generator is not active, but is in
`seen` or `silence` has reached `exclude_ticks`, is not told: the status is `provisional`.

Tests: ν = whitening r is white with unit covariance in the own location.  `sprt` adds slope |ν|² - offset to a sum: at
`upper` or above the relay goes off, at `lower` or below it goes on, both put the sum back to 0.  `glr`: with S_N = the
sum of the last N values of ν (0 before the first), the relay is on while |S_N|² <= limits[N - 1] for every N.

`imm`: the generators are interacting filters, μ_g their probabilities, 1/G each at the start.  In step 1, after the z
have advanced: c_j := Σ_i chain[j][i] μ_i, every z_j := Σ_i (chain[j][i] μ_i / c_j) z_i (it stays where c_j = 0), then
μ := c.  In step 2, unless the sum of all is 0 or no number: w_j = share_j μ_j / (1 + |ν_j|²/freedom)^power,
μ_j := w_j / Σ w.  The relay of a location is on while the sum of the μ of its generators is at least `confidence` to
switch on, ½ to stay on; generators beyond the first of a location have none.

Arithmetic: every component is one sum from left to right that starts from its first product: the products with z (or x)
in order of the columns, then those with u, then those with y, then the offset.
"""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import Decision
from deshybrid.observer.online import OnlineTracker
from deshybrid.observer.tabulated import TabulatedTracker

LARGEST = 1e30
STATUS_NAMES = ("searching", "identified", "provisional", "inconsistent", "invalid")


@dataclass(frozen=True, slots=True, eq=False)
class FlowTables:
    """Sampled continuous observer, per location: x := matrix x + input u + output y + offset.

    Shapes: matrix (L, n, n), input (L, n, m), output (L, n, p), offset (L, n), start (n,); `defined` (L,): false where
    a location has no continuous observer (then `flow` is -1 there).
    """

    matrix: FloatArray
    input: FloatArray
    output: FloatArray
    offset: FloatArray
    start: FloatArray
    defined: tuple[bool, ...]


@dataclass(frozen=True, slots=True, eq=False)
class GeneratorTables:
    """Sampled residual generators, G of them, with relay and debounce; k is the largest order, others are padded by 0.

    Shapes: matrix (G, k, k), input (G, k, m), output (G, k, p), offset (G, k), start (G, k, p), start_offset (G, k);
    residual_state (G, p, k), residual_input (G, p, m), residual_output (G, p, p), residual_offset (G, p), weight
    (G, p): 1/threshold, 0 where the generator has no residual on the channel; release (G,) >= 1; on_ticks, off_ticks
    (G,) >= 1.
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
    residual_output: FloatArray
    residual_offset: FloatArray
    weight: FloatArray
    release: FloatArray
    on_ticks: tuple[int, ...]
    off_ticks: tuple[int, ...]

    @property
    def order(self) -> int:
        """How many numbers each generator remembers."""
        return int(self.matrix.shape[1])


def _none() -> FloatArray:
    return np.zeros((0, 0, 0))


@dataclass(frozen=True, slots=True, eq=False)
class BankTables:
    """Interacting filters: what `imm` has beside generators and whitening.

    `owner` (G): by generator the number of its location among the first generators, which are one for each; `chain`
    (G, G): to, from; `share` (G,); `power`, `freedom`: m and ν; `confidence`: from which a location is named.
    """

    owner: tuple[int, ...]
    chain: FloatArray
    share: FloatArray
    power: int
    freedom: float
    confidence: float


@dataclass(frozen=True, slots=True, eq=False)
class DecisionTables:
    """How residuals become decisions; for the `relay` all but `kind` is empty.

    1 <= `exclude_ticks` <= `window_ticks` < `patience_ticks`.  For the tests, whitening
    (G, p, p), zero where the location does not measure a channel; `test` (G, 4): slope, offset, lower, upper of `sprt`;
    `limits` (W,) of `glr`, one for each number of samples; `bank` of `imm`.
    """

    kind: Decision = "relay"
    exclude_ticks: int = 0
    patience_ticks: int = 0
    whitening: FloatArray = field(default_factory=_none)
    test: FloatArray = field(default_factory=_none)
    limits: FloatArray = field(default_factory=_none)
    bank: BankTables | None = None


@dataclass(frozen=True, slots=True)
class Candidate:
    """A signature the tracker listens for in one state."""

    signature: int  # number in `signature_names`
    active: int  # generator that must be active, -1 = none (negation)
    quiet: tuple[int, ...]  # generators that must not be active
    target: int  # tracker state


@dataclass(frozen=True, slots=True)
class TrackerState:
    """A state of the location observer at run time: an entry estimate, provisional while a signature is due."""

    entry_estimate: tuple[int, ...]  # location numbers
    location: int  # location number where identified, else -1
    provisional: bool
    on_event: tuple[int, ...]  # by event number (code - 1): tracker state or -1
    candidates: tuple[Candidate, ...]
    timeout_target: int = -1  # tracker state after `window_ticks` of silence, -1 = no timeout, -2 = inconsistent


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
    tracker: tuple[TrackerState, ...]  # empty where `online` takes its place
    initial: int
    restart: int
    restart_on_event: tuple[int, ...]  # by event number: always a tracker state
    window_ticks: int
    reset_index: tuple[tuple[int, ...], ...]  # (L, L), -1 = keep the state; empty where there are no resets
    reset_matrix: FloatArray  # (K, n, n)
    reset_offset: FloatArray  # (K, n)
    online: OnlineTracker | None = None  # its states are bit masks, `initial` and `restart` too
    commands: tuple[tuple[str, tuple[str, ...]], ...] = ()  # names and values
    command_slack: int = 0  # ticks before the one at which an event is seen, whose commands may have been on at it
    decision: DecisionTables = DecisionTables()


def plain_tables(tables: StepTables) -> dict[str, object]:
    """Return the tables as nested tuples of plain numbers under the names that `reference` reads.

    A row holds the coefficients of one component in the order of its sum: state (or z), input, output.  A generator is
    a mapping of its own; "tracker" answers for tracker states, by a table or on line.
    """
    flow, decision = tables.flow, tables.decision
    own = tables.generators.locations
    return {
        "decision": decision.kind,
        "exclude_ticks": decision.exclude_ticks,
        "patience": decision.patience_ticks,
        "limits": _plain(decision.limits) if decision.kind == "glr" else (),
        **_plain_bank(decision.bank),
        "evidence": (evidence_start(tables),) * evidence_size(tables),
        "own": tuple(own.index(i) if i in own else -1 for i in range(len(tables.location_names))),
        "initial": tables.initial,
        "restart": tables.restart,
        "events": len(tables.event_names),
        "window_ticks": tables.window_ticks,
        "start": _plain(flow.start),
        "flow_defined": flow.defined,
        "flow_rows": _plain(np.concatenate((flow.matrix, flow.input, flow.output), axis=2)),
        "flow_offset": _plain(flow.offset),
        "reset_index": tables.reset_index,
        "reset_rows": _plain(tables.reset_matrix),
        "reset_offset": _plain(tables.reset_offset),
        "commands": tuple(len(values) for _, values in tables.commands),
        "command_slack": tables.command_slack,
        "generators": tuple(_plain_generator(tables, g) for g in range(len(own))),
        "tracker": tables.online or _plain_tracker(tables),
    }


def evidence_size(tables: StepTables) -> int:
    """Return how many numbers the decision remembers per generator.

    The sum of `sprt`, the window of `glr`, the probability of `imm`.
    """
    window = len(tables.decision.limits) * len(tables.output_names)
    return {"sprt": 1, "glr": window, "imm": 1}.get(tables.decision.kind, 0)


def evidence_start(tables: StepTables) -> float:
    """Return what these numbers are before the first sample."""
    return 0.0 if tables.decision.bank is None else 1.0 / len(tables.generators.locations)


def _plain_bank(bank: BankTables | None) -> dict[str, object]:
    if bank is None:
        return {}
    return {
        "owner": bank.owner,
        "chain": _plain(bank.chain),
        "share": _plain(bank.share),
        "power": bank.power,
        "freedom": bank.freedom,
        "confidence": bank.confidence,
    }


def _plain_generator(tables: StepTables, g: int) -> dict[str, object]:
    generators, decision = tables.generators, tables.decision
    tested = decision.kind in ("sprt", "glr", "imm")
    rows = np.concatenate((generators.matrix[g], generators.input[g], generators.output[g]), axis=1)
    parts = (generators.residual_state[g], generators.residual_input[g], generators.residual_output[g])
    return {
        "rows": _plain(rows),
        "offset": _plain(generators.offset[g]),
        "start": _plain(generators.start[g]),
        "start_offset": _plain(generators.start_offset[g]),
        "residual_rows": _plain(np.concatenate(parts, axis=1)),
        "residual_offset": _plain(generators.residual_offset[g]),
        "weight": _plain(generators.weight[g]),
        "release": float(generators.release[g]),
        "on_ticks": generators.on_ticks[g],
        "off_ticks": generators.off_ticks[g],
        "whitening": _plain(decision.whitening[g]) if tested else (),
        "unbiased": (0.0,) * len(tables.output_names) if tested else (),
        "test": _plain(decision.test[g]) if decision.kind == "sprt" else (),
    }


def _plain_tracker(tables: StepTables) -> TabulatedTracker:
    states = tuple(
        (
            state.location,
            state.provisional,
            state.on_event,
            tuple((c.signature, c.active, c.quiet, c.target) for c in state.candidates),
            state.timeout_target,
            state.entry_estimate,
        )
        for state in tables.tracker
    )
    return TabulatedTracker(states, tables.restart_on_event)


def _plain(array: FloatArray) -> tuple[Any, ...]:
    """Return an array as nested tuples of floats (`tolist` keeps every bit)."""

    def frozen(values: Any) -> Any:
        return tuple(frozen(value) for value in values) if isinstance(values, list) else values

    return tuple(frozen(array.tolist()))
