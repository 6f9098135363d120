"""All Hypothesis strategies of the tests, and the seeded generators that the bulk comparisons use.

Append your own section; nothing here may depend on the order in which tests run.
"""

import math
import random
from dataclasses import replace
from typing import Literal

import numpy as np
from hypothesis import strategies as st
from scipy.linalg import expm

from deshybrid.continuous.error import ErrorDynamics, ErrorReset
from deshybrid.des.automaton import DES, Transition
from deshybrid.des.candidates import Candidate
from deshybrid.des.composition import Composition
from deshybrid.des.observability import check_observability
from deshybrid.des.signatures import Signature, SignaturePlan
from deshybrid.formats.document import Document, Event
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.predicates import Affine, And
from deshybrid.model.system import (
    AffineReset,
    Bounds,
    Dwell,
    HybridSystem,
    HybridTransition,
    Location,
    ObserverOptions,
)
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem

# ---- discrete-event systems -------------------------------------------------------------------------------------


def random_des(rng: random.Random, *, locations: int = 6, transitions: int = 10) -> DES:
    """A small system with everything that is allowed: silent cycles, dead ends, several outputs, parallel arcs."""
    names = tuple(f"q{number}" for number in range(rng.randint(1, locations)))
    seldom = [(None,), (None,), ("α", "β"), ("α", None), (None, "β", "γ")]
    often = [("α",), ("β",), ("γ",), ("δ",)][: rng.randint(1, 4)]
    share = rng.choice([0.0, 0.15, 0.3, 0.6])
    sources = list(names) if rng.random() < 0.6 else []  # then no location is a dead end
    sources += rng.choices(names, k=rng.randint(0, max(0, transitions - len(sources))))
    arcs = tuple(
        Transition(source, rng.choice("abc"), rng.choice(names), rng.choice(seldom if rng.random() < share else often))
        for source in sources
    )
    initial = tuple(rng.sample(names, rng.randint(1, len(names)))) if rng.random() < 0.4 else ()
    return DES(names, arcs, initial, "random")


def commanded(rng: random.Random, des: DES, values: str = "uvw") -> DES:
    """The system with a command: some transitions are possible under all of its values, others under some."""
    arcs = tuple(
        replace(t, commands=tuple(values if rng.random() < 0.4 else sorted(rng.sample(values, rng.randint(1, 2)))))
        for t in des.transitions
    )
    return replace(des, transitions=arcs)


def random_composition(rng: random.Random) -> Composition:
    """Two or three small components that share some events and some outputs, or none at all."""
    own_events, own_outputs = rng.choice([0.0, 0.5, 0.9, 1.0]), rng.choice([0.0, 0.7, 1.0, 1.0])
    parts = []
    for number in range(rng.choice([2, 2, 3])):
        des = random_des(rng, locations=3, transitions=5)
        private = {event: f"{event}{number}" if rng.random() < own_events else event for event in "abc"}
        seen = {output: f"{output}{number}" if rng.random() < own_outputs else output for output in "αβγδ"}
        arcs = tuple(
            Transition(t.source, private[t.event], t.target, tuple(o and seen[o] for o in t.outputs))
            for t in des.transitions
        )
        start = des.initial[:1] if rng.random() < 0.5 else des.initial
        parts.append(DES(des.locations, arcs, start, f"part {number}"))
    return Composition(tuple(parts), only_common=rng.random() < 0.15)


def living(des: DES) -> DES:
    """The same system with a visible self-loop on every dead end."""
    left = {transition.source for transition in des.transitions}
    loops = tuple(Transition(name, "stay", name, ("α",)) for name in des.locations if name not in left)
    return DES(des.locations, des.transitions + loops, des.initial, des.name)


@st.composite
def systems(draw: st.DrawFn, *, locations: int = 5, transitions: int = 8) -> DES:
    """Any small system, shrinking towards few locations, few transitions, visible outputs."""
    names = tuple(f"q{number}" for number in range(draw(st.integers(1, locations))))
    seen = st.sampled_from([("α",), ("β",), ("α", "β"), (None,), ("α", None)])
    arc = st.builds(Transition, st.sampled_from(names), st.sampled_from("ab"), st.sampled_from(names), seen)
    arcs = tuple(draw(st.lists(arc, max_size=transitions)))
    initial = tuple(draw(st.lists(st.sampled_from(names), max_size=len(names), unique=True)))
    return DES(names, arcs, initial, "random")


def random_plan(
    rng: random.Random, *, negations: bool = False, locations: int = 5, commands: bool = False
) -> SignaturePlan:
    """Some transitions carry the signature of their target; nothing says that they recover observability.

    With `negations`, some signatures come by negation, and other locations may have a generator.
    """
    des = living(random_des(rng, locations=locations, transitions=2 * locations - 1))
    des = commanded(rng, des) if commands else des
    marked = [number for number in range(len(des.transitions)) if rng.random() < 0.4]
    signatures, generators = [], []
    for location in des.locations:
        own = tuple(number for number in marked if des.transitions[number].target == location)
        by: Literal["residual", "negation"] = "negation" if negations and rng.random() < 0.4 else "residual"
        if own:
            signatures.append(Signature(f"s_{location}", location, own, by))
        if (own and by == "residual") or (negations and rng.random() < 0.5):
            generators.append(location)
    complementary = des.with_signatures({n: s.name for s in signatures for n in s.transitions})
    report = check_observability(complementary)
    return SignaturePlan(
        des=des,
        candidates=(),
        recoverable=True,
        already_observable=False,
        signatures=tuple(signatures),
        generators=tuple(generators),
        cost=0.0,
        lower_bound=0.0,
        optimal=False,
        fewest=False,
        constraints=(),
        confused=None,
        complementary=complementary,
        report=report,
    )


@st.composite
def systems_with_run(draw: st.DrawFn) -> tuple[DES, str, list[tuple[Transition, str | None]]]:
    """A system, an initial location, and a run from it: each transition with the output that it showed."""
    des = draw(systems())
    start = location = draw(st.sampled_from(des.initial))
    run: list[tuple[Transition, str | None]] = []
    for _ in range(draw(st.integers(0, 12))):
        exits = [transition for transition in des.transitions if transition.source == location]
        if not exits:
            break
        taken = draw(st.sampled_from(exits))
        run.append((taken, draw(st.sampled_from(taken.outputs))))
        location = taken.target
    return des, start, run


def candidates_everywhere(des: DES, *, forbid: tuple[int, ...] = ()) -> tuple[Candidate, ...]:
    """One candidate signature per location, on every transition into it that is not forbidden."""
    return tuple(
        Candidate(
            f"s_{location}",
            location,
            tuple(i for i, t in enumerate(des.transitions) if t.target == location and i not in forbid),
        )
        for location in des.locations
    )


def random_candidates(rng: random.Random, des: DES) -> tuple[Candidate, ...]:
    """Candidates with random costs, some without residual or negation, some transitions left out, some missing."""
    strict = rng.choice([0.0, 1.0])
    forbid = tuple(i for i in range(len(des.transitions)) if rng.random() < 0.15 * strict)
    return tuple(
        Candidate(
            candidate.name,
            candidate.location,
            candidate.transitions,
            rng.choice([0.0, 0.5, 1.0, 1.0, 1.0, 2.0, 3.0]),
            rng.random() >= 0.2 * strict,
            rng.random() >= 0.3 * strict,
        )
        for candidate in candidates_everywhere(des, forbid=forbid)
        if rng.random() >= 0.1 * strict
    )


def random_detectors(rng: random.Random, des: DES, *, most: int = 2) -> tuple[Candidate, ...]:
    """Up to `most` detectors of two or more locations each, which may overlap, on all transitions into these."""
    found = []
    for number in range(rng.randint(1, most)):
        covers = rng.sample(des.locations, rng.randint(min(2, len(des.locations)), len(des.locations)))
        taken = [n for n, t in enumerate(des.transitions) if t.target in covers]
        if taken:
            found.append(Candidate.covering(f"d{number}", covers, taken, cost=rng.choice([0.0, 0.5, 1.0, 1.5, 2.0])))
    return tuple(found)


# ---- hybrid systems that run ------------------------------------------------------------------------------------


def _location(draw: st.DrawFn, name: str, n: int) -> Location:
    """Small integers give slow, damped or rotating flows; measured is the first state, in some locations all."""
    entries = st.integers(-3, 3).map(float)
    matrix = np.array(draw(st.lists(entries, min_size=n * n, max_size=n * n))).reshape(n, n) - 2.0 * np.eye(n)
    drift = np.array(draw(st.lists(entries, min_size=n, max_size=n)))
    shortest = draw(st.sampled_from([None, 0.15, 0.4]))
    dynamics = LinearDynamics(matrix, np.ones((n, 1)), np.eye(n)[:1], np.zeros((1, 1)), np.eye(n), drift, np.zeros(1))
    return Location(name, dynamics, Dwell(shortest), input_index=(0,), output_index=(0,))


@st.composite
def hybrid_systems(draw: st.DrawFn) -> HybridSystem:
    """A system of 1 to 3 locations and states, with guarded and unguarded transitions, resets and several outputs."""
    n = draw(st.integers(1, 3))
    names = tuple(f"q{number}" for number in range(draw(st.integers(1, 3))))
    row = st.lists(st.integers(-2, 2).map(float), min_size=n, max_size=n)
    guard = st.builds(
        lambda s, c: Affine(np.array(s), np.zeros(1), c, "<="), row, st.floats(-2.0, 2.0, allow_nan=False)
    )
    reset = st.builds(lambda s: AffineReset(np.eye(n) * 0.5, np.array(s)), row)
    outputs = st.sampled_from([("α",), ("β",), (None,), ("α", None), ("α", "β")])
    arc = st.builds(
        HybridTransition,
        st.sampled_from(names),
        st.sampled_from("abc"),
        st.sampled_from(names),
        outputs,
        st.none() | guard | st.builds(lambda g, h: And((g, h)), guard, guard),
        st.none() | reset,
    )
    return HybridSystem(
        "random",
        tuple(_location(draw, name, n) for name in names),
        tuple(draw(st.lists(arc, min_size=1, max_size=5))),
        names,
        tuple(f"x{number}" for number in range(n)),
        ("u",),
        ("y",),
        tuple(f"w{number}" for number in range(n)),
        bounds=Bounds(np.ones(n), np.ones(1), np.full(n, 0.3), np.full(1, 0.01)),
        observer=ObserverOptions(step=0.05, dwell=0.2),
    )


# ---- texts of the model language ----------------------------------------------------------------------------------

PARAMETERS = {"k": 2.5, "tau": -0.75, "größe": 3.0}


def _unary(part: tuple[str, float]) -> list[tuple[str, float]]:
    text, value = part
    found = [(f"({text})", value), (f"-({text})", -value), (f"+({text})", value), (f"abs({text})", abs(value))]
    found += [(f"sin({text})", math.sin(value)), (f"cos( {text} )", math.cos(value))]
    if value >= 0:
        found.append((f"sqrt({text})", math.sqrt(value)))
    if value < 50:
        found.append((f"exp({text})", math.exp(value)))
    if value > 0:
        found.append((f"log({text})", math.log(value)))
    return found


def _binary(parts: tuple[tuple[str, float], tuple[str, float]]) -> list[tuple[str, float]]:
    (left, a), (right, b) = parts
    found = [(f"({left})+({right})", a + b), (f"({left}) - ({right})", a - b), (f"({left})*({right})", a * b)]
    found += [(f"min({left}, {right})", min(a, b)), (f"max({left},{right})", max(a, b))]
    if b:
        found.append((f"({left})/({right})", a / b))
    if 0.01 < a < 100 and abs(b) < 100:
        found.append((f"({left})**({right})", a**b))
    return found


def arithmetic() -> st.SearchStrategy[tuple[str, float]]:
    """A text of the expression language with its value, which Python's own arithmetic computed beside it."""
    numbers = st.floats(0, 1e3, allow_subnormal=False).map(lambda number: (repr(number), number))
    names = st.sampled_from([*PARAMETERS.items(), ("pi", math.pi)])
    return st.recursive(
        numbers | names,
        lambda inner: (
            inner.flatmap(lambda part: st.sampled_from(_unary(part)))
            | st.tuples(inner, inner).flatmap(lambda parts: st.sampled_from(_binary(parts)))
        ),
        max_leaves=20,
    ).filter(lambda part: abs(part[1]) < 1e100)


def flat_arithmetic() -> st.SearchStrategy[str]:
    """A text without parentheses, in which precedence alone decides; Python reads it the same way."""
    leaf = st.sampled_from(["1", "2.5", "3", "0.25", "-2", "+3", "--2"])
    operator = st.sampled_from(["+", "-", "*", "/", " + ", " - ", " * ", " / ", "**"])
    tail = st.lists(st.tuples(operator, leaf), max_size=8)
    return st.tuples(leaf, tail).map(lambda parts: parts[0] + "".join(op + right for op, right in parts[1]))


def names_of_the_language() -> st.SearchStrategy[str]:
    """Texts that may name a location."""
    printable = st.text(min_size=1, max_size=12).filter(str.isprintable)
    words = st.sampled_from(
        ["on", "off", "null", "~", "1", "012", "1e-3", "true", "a:b", "a: b", "- x", "#", "'", '"', "{", "*a"]
    )
    return (printable | words).filter(lambda name: name == name.strip() and "|" not in name)


@st.composite
def damaged(draw: st.DrawFn, text: str) -> str:
    """A text with a few characters deleted, doubled or replaced."""
    for _ in range(draw(st.integers(1, 4))):
        start = draw(st.integers(0, len(text) - 1))
        end = min(len(text), start + draw(st.integers(0, 6)))
        piece = draw(st.sampled_from(["", text[start:end] * 2, *"[]{}:,-\n", "null", "1e999"]))
        text = text[:start] + piece + text[end:]
        if not text:
            return "x"
    return text


# ---- files of other tools ---------------------------------------------------------------------------------------


def hostile_names(*, without: str = "") -> st.SearchStrategy[str]:
    """Names that are awkward in some format: quotes, brackets, escapes, keywords, letters of other alphabets."""
    awkward = [" ", '"', "'", "<", ">", "&", "%", "#", "/", "\\", "|", ";", ":", "+", "{", "}", "[", "]", "=", "-", ","]
    letters = st.sampled_from([letter for letter in [*"ab01", "α", "é", "漢", "🙂", *awkward] if letter not in without])
    texts = st.text(letters, min_size=1, max_size=6).map(str.strip).filter(bool)
    words = ["graph", "node", "null", "true", "~", "0x1", "+o+", "<S>", "&lt;", "\\n", "EVENTS", "0", "ε", "a b", "--"]
    return st.one_of(texts, st.sampled_from([word for word in words if not set(word) & set(without)]))


@st.composite
def documents(draw: st.DrawFn, *, without: str = "", outputs: bool = True, one_initial: bool = False) -> Document:
    """A document with hostile names, whose transitions are distinct and, without `outputs`, show their own event."""
    names = draw(st.lists(hostile_names(without=without), min_size=1, max_size=4, unique=True))
    events = draw(st.lists(hostile_names(without=without), min_size=1, max_size=3, unique=True))
    visible = {event: draw(st.booleans()) for event in events}
    shown = st.lists(st.one_of(st.none(), hostile_names(without=without)), min_size=1, max_size=2, unique=True)
    place = st.sampled_from(names)
    ends = draw(st.lists(st.tuples(place, st.sampled_from(events), place), max_size=6, unique=True))
    arcs = tuple(
        Transition(*end, tuple(draw(shown)) if outputs else ((end[1] if visible[end[1]] else None),)) for end in ends
    )
    count = 1 if one_initial else len(names)
    start = draw(st.lists(place, min_size=1, max_size=count, unique=True))
    initial = [name for name in names if name in start]
    marked = tuple(name for name in names if draw(st.booleans()))
    alphabet = tuple(Event(event, draw(st.booleans()), visible[event]) for event in events)
    return Document(DES(tuple(names), arcs, tuple(initial), draw(hostile_names(without=without))), marked, alphabet)


# ---- switched error dynamics --------------------------------------------------------------------------------------


@st.composite
def switched_errors(draw: st.DrawFn) -> tuple[ErrorDynamics, dict[str, tuple[float, float]]]:
    """Two or three locations on a random graph without dead ends, any of which may grow, with bounds of their stays."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, count = draw(st.integers(1, 3)), draw(st.integers(2, 3))
    names = tuple(f"q{number}" for number in range(count))
    step = draw(st.sampled_from([None, 0.25]))
    arcs = {(k, (k + 1) % count) for k in range(count)}
    arcs |= {(k, j) for k in range(count) for j in range(count) if rng.random() < 0.3}
    matrices = {}
    for name in names:
        F = rng.standard_normal((n, n)) - draw(st.sampled_from([0.0, 1.0, 3.0])) * np.eye(n)
        matrices[name] = F if step is None else expm(F * step)
    size = draw(st.sampled_from([0.2, 0.5, 1.0]))
    resets = tuple(
        ErrorReset(names[i], names[j], size * rng.standard_normal((n, n)), np.zeros(n)) for i, j in sorted(arcs)
    )
    stays = {name: (low := rng.integers(1, 5) / 4, low + rng.integers(0, 6) / 4) for name in names}
    return ErrorDynamics(names, matrices, resets, step), stays


@st.composite
def written_cycles(draw: st.DrawFn) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """A cycle as (A, C, R¹ to the next), in small fractions: diagonal plants with some axes unseen, axes permuted."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    n, count = draw(st.integers(1, 3)), draw(st.integers(1, 3))
    cycle = []
    for _ in range(count):
        A = np.diag(rng.permutation(np.arange(1, n + 1)) / 10 - 0.2)
        seen = rng.random(n) < 0.6
        C = (seen * rng.integers(1, 4, n) / 3)[None]
        cycle.append((A, C, np.eye(n)[rng.permutation(n)] * rng.integers(0, 3, n) / 7))
    return cycle


# ---- stochastic systems -----------------------------------------------------------------------------------------


def random_stochastic_system(rng: np.random.Generator, *, plain: bool = False) -> StochasticSystem:
    """Two to four modes that measure the same outputs, an asymmetric chain; `plain`: no inputs and no offsets."""
    count, n, p = (int(rng.integers(low, high)) for low, high in ((2, 5), (1, 5), (1, 4)))
    m = 0 if plain else int(rng.integers(0, 3))
    scale = 0.0 if plain else 1.0
    names = tuple(f"m{number}" for number in range(count))
    modes = []
    for name in names:
        F, H, root, noise = (rng.standard_normal(shape) for shape in ((n, n), (p, n), (n, n), (p, p)))
        modes.append(
            Mode(
                name,
                F=F / max(1.0, np.abs(np.linalg.eigvals(F)).max()),
                H=H,
                Q=root @ root.T + 0.01 * np.eye(n),
                R=noise @ noise.T + 0.1 * np.eye(p),
                B=rng.standard_normal((n, m)),
                D=rng.standard_normal((p, m)),
                f=scale * rng.standard_normal(n),
                g=scale * rng.standard_normal(p),
            )
        )
    chain = ModeTransition.from_rows(names, rng.dirichlet(np.ones(count), size=count))
    root = rng.standard_normal((n, n))
    prior = {"x": rng.standard_normal(n), "P": root @ root.T + 0.1 * np.eye(n), "mu": rng.dirichlet(np.ones(count))}
    return StochasticSystem(modes, chain, x=prior["x"], P=prior["P"], mu=prior["mu"])


def drawn_record(
    rng: np.random.Generator,
    system: StochasticSystem,
    trials: tuple[int, ...] = (),
    *,
    rows: int = 12,
    missing: float = 0.2,
) -> tuple[np.ndarray, np.ndarray]:
    """Measurements with holes, and inputs."""
    p, m = system.bank.H.shape[1], system.bank.B.shape[2]
    z = 3.0 * rng.standard_normal((*trials, rows, p))
    z[rng.random(z.shape) < missing] = np.nan
    return z, rng.standard_normal((*trials, rows, m))


@st.composite
def pairs_of_dynamics(draw: st.DrawFn) -> tuple[LinearDynamics, LinearDynamics]:
    """Two locations with the same channels: one to three states each, up to one input, one or two outputs, offsets."""
    rng = np.random.default_rng(draw(st.integers(0, 2**32 - 1)))
    m, p = draw(st.integers(0, 1)), draw(st.integers(1, 2))
    both = []
    for n in (draw(st.integers(1, 3)), draw(st.integers(1, 3))):
        A = rng.normal(size=(n, n)) - 1.5 * np.eye(n)
        offsets = draw(st.booleans())
        both.append(
            LinearDynamics(
                A,
                rng.normal(size=(n, m)),
                rng.normal(size=(p, n)),
                rng.normal(size=(p, m)),
                np.zeros((n, 0)),
                rng.normal(size=n) * offsets,
                rng.normal(size=p) * offsets,
            )
        )
    return both[0], both[1]
