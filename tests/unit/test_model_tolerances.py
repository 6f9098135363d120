"""Tolerances of parameters: enclosures against sampled values, bounds on residuals against plants that are wrong."""

from dataclasses import fields
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from deshybrid.detector.carried_over import carried_over
from deshybrid.detector.detector import build_detector
from deshybrid.detector.residual import ResidualGenerator, build_generator, sampled_dynamics
from deshybrid.detector.thresholds import steady_bound
from deshybrid.diagnostics import ModelError
from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.arithmetic import evaluate
from deshybrid.model.elaborate import elaborate
from deshybrid.model.expressions import ExpressionError, parse_arithmetic
from deshybrid.model.intervals import Interval, enclosure
from deshybrid.model.load import loads
from deshybrid.model.parameters import with_parameters
from deshybrid.model.system import HybridSystem

MODEL = """\
format: deshybrid/1
name: sprung mass
parameters: {k: 4, d: 0.3, m: 1, gain: 1, lift: 0.3}
tolerance: {k: 0.3, m: 0.05, gain: 0.02, lift: 0.5}
state: [x, v]
input: [u]
output: [y]
disturbance: [w]
bounds: {state: {x: 2, v: 3}, input: 1, disturbance: 0.005, measurement: 0.001}
defaults: {B: [[0], [1/m]], E: [[0], [1/m]], C: [[gain, 0]]}
locations:
  free: {A: [[0, 1], [-k/m, -d/m]], f: [0, lift]}
  held: {A: [[0, 1], [-2*k/m, -3*d/m]], dwell: {min: 3}}
transitions: [{from: free, to: held, event: a}, {from: held, to: free, event: b}]
observer: {dwell: 3, step: 0.05}
"""
STEP = 0.05


@pytest.mark.parametrize(
    "text", ["a + b - 2*a*b", "a/b + b**2 - 1/(2 + a)", "(a - 2)**2", "(a - 2)**3", "a**b", "sqrt(a)*exp(-b) + log(b)",
             "sin(3*a) - cos(b)", "abs(a - b) + min(a, b, 1) * max(a, 2)", "-a**2 / pi", "(a - 5)**-2"],
)  # fmt: skip
def test_every_value_lies_within_the_enclosure(text: str) -> None:
    tree, rng = parse_arithmetic(text), np.random.default_rng(3)
    for _ in range(20):
        limits = {name: Interval(*sorted(rng.uniform(0.1, 3.0, 2))) for name in "ab"}
        found = enclosure(tree, limits)
        for share in (*product((0.0, 1.0), repeat=2), *rng.random((30, 2))):
            inside = dict(
                zip(
                    "ab",
                    (i.low + s * (i.high - i.low) for i, s in zip(limits.values(), share, strict=True)),
                    strict=True,
                )
            )
            assert found.low <= evaluate(tree, inside) <= found.high


def test_a_parameter_that_occurs_once_is_enclosed_without_loss() -> None:
    found = enclosure(parse_arithmetic("3/(k**2 + 1)"), {"k": Interval(-1.0, 2.0)})
    assert (found.low, found.high) == (pytest.approx(0.6), pytest.approx(3.0))


@pytest.mark.parametrize("text", ["1/(k - 1)", "sqrt(k - 1)", "tan(k)", "(k - 1)**0.5", "(k - 1)**-2"])
def test_what_is_without_a_bound_is_refused(text: str) -> None:
    with pytest.raises(ExpressionError) as caught:
        enclosure(parse_arithmetic(text), {"k": Interval(0.5, 2.0)})
    assert caught.value.code == "DH0221"


def members(system: HybridSystem, count: int) -> list[HybridSystem]:
    """Plants at the vertices of the tolerances, and random ones between."""
    assert system.source is not None
    names, rng = list(system.tolerance), np.random.default_rng(5)
    nominal = {name: float(system.source.tree.get("parameters").entries[name].value.text) for name in names}  # type: ignore[union-attr]
    signs = [*product((-1.0, 1.0), repeat=len(names)), *rng.uniform(-1, 1, (count, len(names)))]
    wrong = [
        {n: v * (1 + s * system.tolerance[n]) for (n, v), s in zip(nominal.items(), at, strict=True)} for at in signs
    ]
    return [elaborate(with_parameters(system.source, values)) for values in wrong]


@pytest.mark.parametrize("text", [MODEL, "driveline"])
def test_no_matrix_of_a_plant_within_the_tolerances_is_farther_off_than_the_deviation(text: str) -> None:
    """Vertices reach it to rounding where each parameter occurs once."""
    if text == "driveline":
        text = (
            Path("models/balluchi2012/driveline.yaml").read_text(encoding="utf-8")
            + "\ntolerance: {k_shaft: 0.1, mass: 0.05, b_shaft: 0.2}\n"
        )
    system = loads(text)
    reached = {}
    for plant in members(system, 8):
        for here, there in zip(system.locations, plant.locations, strict=True):
            assert here.dynamics is not None and there.dynamics is not None and here.deviation is not None  # noqa: PT018
            for key in (field.name for field in fields(LinearDynamics)):
                off, allowed = (
                    np.abs(getattr(there.dynamics, key) - getattr(here.dynamics, key)),
                    getattr(here.deviation, key),
                )
                assert (off <= allowed * (1 + 1e-12) + 1e-300).all()
                reached[here.name, key] = np.maximum(reached.get((here.name, key), 0.0), off)
    for (name, key), off in reached.items():
        assert off == pytest.approx(getattr(system.location(name).deviation, key), rel=0.06)


def run(
    generator: ResidualGenerator, system: HybridSystem, true: LinearDynamics, seed: int, samples: int
) -> FloatArray:
    """Residuals (samples, q) of a wrong plant that is driven as hard as can be, until it leaves the bounds."""
    rng, plant = np.random.default_rng(seed), sampled_dynamics(system, true, STEP)
    x, z, seen = np.zeros(2), np.zeros(len(generator.F)), np.zeros((samples, 1))
    for k in range(samples):
        u = 1.0 if x[1] >= 0.0 else -1.0  # in step with the mass
        y = true.C @ x + 0.001 * rng.choice([-1.0, 1.0])
        seen[k] = generator.H @ z + generator.J @ y + generator.residual_offset
        z = generator.F @ z + generator.input @ [u] + generator.gain @ y + generator.offset
        x = plant.A @ x + plant.B @ [u] + plant.E @ [0.005 * u] + plant.f
        if (np.abs(x) > [2, 3]).any():
            return seen[: k + 1]
    return seen


@pytest.mark.parametrize("name", ["free", "held"])
def test_the_residual_of_a_plant_within_the_tolerances_stays_within_its_bound(name: str) -> None:
    """From no error at the start; without the tolerances the bound is left."""
    system, exact = loads(MODEL), loads(MODEL.replace("tolerance:", "# "))
    generator, same = (build_generator(s, s.location(name), rate=1.0, dwell=None, step=STEP) for s in (system, exact))
    bound, narrow = steady_bound(system, generator), steady_bound(exact, same)
    largest = 0.0
    for number, plant in enumerate(members(system, 8)):
        true = plant.location(name).dynamics
        assert true is not None
        largest = max(largest, float(np.abs(run(generator, system, true, number, 400)).max()))
    assert 1.2 * narrow[0] < largest <= bound[0]


def test_what_is_carried_over_from_a_wrong_plant_lies_within_its_interval() -> None:
    """The states of plant and generator after a stay of three seconds in `held`."""
    system = loads(MODEL)
    generator = build_generator(system, system.location("free"), rate=1.0, dwell=None, step=STEP)
    rows = np.random.default_rng(2).normal(size=(12, 4))
    found = carried_over(system, generator, system.location("held"), rows)
    assert found is not None
    for number, plant in enumerate(members(system, 8)):
        rng, true = np.random.default_rng(number), plant.location("held").dynamics
        assert true is not None
        sampled, x, z = sampled_dynamics(system, true, STEP), rng.uniform(-1, 1, 2), np.zeros(2)
        for _ in range(60):
            u, y = rng.choice([-1.0, 1.0]), true.C @ x + rng.uniform(-0.001, 0.001)
            z = generator.F @ z + generator.input @ [u] + generator.gain @ y + generator.offset
            x = sampled.A @ x + sampled.B @ [u] + sampled.E @ [0.005 * u] + sampled.f
        assert (np.abs(x) <= [2, 3]).all()
        values = rows @ np.concatenate([x, z])
        assert (values >= found.low).all()
        assert (values <= found.high).all()


def test_thresholds_say_for_which_tolerances_they_hold_and_tests_that_they_do_not_allow_for_them() -> None:
    from deshybrid import compiler

    system = loads(MODEL)
    made = build_detector(system, compiler.recover(system).plan, rate=1.0, step=STEP)
    assert made.thresholds[0].reason.endswith(
        "for every plant within the tolerances (k 0.3, m 0.05, gain 0.02, lift 0.5)"
    )
    tested = loads(MODEL.replace("step: 0.05", "step: 0.05, detector: {decision: glr}"))
    decision = build_detector(tested, compiler.recover(tested).plan, rate=1.0, step=STEP).decision
    assert "their tolerances are not allowed for" in decision.reason


def test_a_design_tells_its_tolerances_in_text_and_json() -> None:
    from deshybrid import compiler

    made = compiler.design(loads(MODEL))
    assert made.document()["tolerance"] == {"k": 0.3, "m": 0.05, "gain": 0.02, "lift": 0.5}
    assert "wrong by k 30 %, m 5 %, gain 2 %, lift 50 %" in str(made)
    assert "tolerance" not in compiler.design("models/two_tank.yaml").document()


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("k: 0.3,", "kk: 0.3,", "DH0201"),
        ("k: 0.3,", "k: -0.3,", "DH0124"),
        ("k: 0.3,", "k: 1,", "DH0221"),
        ("input: 1, ", "", "DH0222"),
        ("m: 0.05", "m: 1", "DH0221"),
    ],
)
def test_a_tolerance_that_makes_no_sense_is_refused(old: str, new: str, code: str) -> None:
    text = MODEL.replace(old, new).replace("-2*k/m", "-2*k/m + 0/k")
    with pytest.raises(ModelError, match=code):
        loads(text)
