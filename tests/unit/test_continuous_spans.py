"""Forms that depend on how long a stay lasts and on the transitions before it: longest stays, and smaller gaps."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.compiler import design
from deshybrid.continuous.cycles import DwellLowerLimit
from deshybrid.continuous.error import ErrorDynamics, ErrorReset
from deshybrid.continuous.form_graph import Forms, Shape, nodes_of
from deshybrid.continuous.forms import FormProblem
from deshybrid.continuous.lmi import InequalityCertificate, shifted_dynamics
from deshybrid.model.load import loads
from deshybrid.verify import verify_design
from tests.certificates import Tree, certified, changed, tree_of

BOTH = ("p", "q")
UNSTABLE = np.array([[0.2, 3.0], [-0.3, 0.2]])
DAMPED = np.array([[0.0, 1.0], [-4.0, -0.8]])


def pair(
    first: np.ndarray, second: np.ndarray, *, step: float | None = None, resets: tuple[np.ndarray, ...] = ()
) -> ErrorDynamics:
    """Two locations that follow each other, given in continuous time."""
    matrices = {name: F if step is None else expm(F * step) for name, F in zip(BOTH, (first, second), strict=True)}
    jumps = resets or (np.eye(len(first)),) * 2
    arcs = (("p", "q", jumps[0]), ("q", "p", jumps[1]))
    return ErrorDynamics(BOTH, matrices, tuple(ErrorReset(*arc, np.zeros(len(first))) for arc in arcs), step)


@pytest.mark.parametrize("step", [None, 0.01])
def test_a_scalar_location_that_grows_and_is_left_in_time_needs_the_closed_form_of_the_other(
    step: float | None,
) -> None:
    """p grows with rate 1 for 1 s at most, q decays with rate 2: 1 + μ (1 + T) = 2 T decides."""
    dynamics = pair(np.array([[1.0]]), np.array([[-2.0]]), step=step)
    border = 1.1 / 1.9
    found = certified(dynamics, rate=0.1, most={"p": 1.0})
    assert 0.999 * border - (step or 0.0) <= found.limit.value <= border
    stay = found.required_dwell if step is None else np.ceil(found.required_dwell / step) * step
    assert border <= stay <= 1.005 * border + (step or 0.0)
    assert found.limit.cycle is not None
    assert max(found.limit.cycle.stays) <= 1.0 + 1e-9
    assert certified(dynamics, rate=0.1).required_dwell == np.inf


def test_a_delay_lets_a_location_grow_for_longer_and_asks_for_more() -> None:
    dynamics = pair(np.array([[1.0]]), np.array([[-2.0]]))
    late = certified(dynamics, rate=0.1, most={"p": 1.0}, delay=0.2)
    border = 0.2 + 1.1 * 1.2 / 1.9  # p up to 1.2 s, q at least T = D - 0.2
    assert border <= late.required_dwell <= 1.01 * border


def growth_of_random_executions(
    dynamics: ErrorDynamics, rate: float, least: float, most: Mapping[str, float], rng: np.random.Generator
) -> float:
    """log of the norm of the error's map, times e^{μ t}, over 300 stays between least and longest."""
    whole, total, time = np.eye(2), 0.0, 0.0
    for k in range(300):
        name = BOTH[k % 2]
        longest = most.get(name, 3 * least)
        stay = float(rng.choice([min(least, longest), longest, rng.uniform(min(least, longest), longest)]))
        whole, time = dynamics.resets[k % 2].matrix @ expm(dynamics.matrices[name] * stay) @ whole, time + stay
        size = np.linalg.norm(whole)
        whole, total = whole / size, total + np.log(size)
    return total + rate * time


def test_the_error_decays_in_executions_that_leave_an_unstable_location_in_time() -> None:
    rng = np.random.default_rng(3)
    dynamics, most = pair(UNSTABLE, DAMPED), {"p": 0.3}
    found = certified(dynamics, rate=0.05, most=most)
    assert 0 < found.required_dwell < np.inf
    assert found.gap < 0.02
    for _ in range(5):
        assert growth_of_random_executions(dynamics, 0.05, found.required_dwell, most, rng) < 3.0


def test_an_oscillating_location_that_is_left_early_asks_for_less() -> None:
    """Left within 1 s, the weakly damped oscillation cannot turn the error where the other location amplifies it."""
    dynamics = pair(np.array([[0.0, 1.0], [-4.0, -0.1]]), np.array([[-1.0, -2.0], [0.0, -1.0]]))
    free, bounded = certified(dynamics, rate=0.01), certified(dynamics, rate=0.01, most={"p": 1.0})
    assert bounded.required_dwell < 0.6 * free.limit.value
    assert free.gap < 0.02
    assert bounded.gap < 0.02


def test_forms_of_many_spans_close_the_gap_that_plain_ones_leave() -> None:
    """One cycle of three damped oscillators: plain forms alone are 2 % off, spans are not."""
    found = spread()
    assert found.gap < 0.01
    assert found.forms is not None
    assert not found.forms.is_plain


@cache
def turning() -> ErrorDynamics:
    rng, names = np.random.default_rng(11), ("p", "q", "r")
    matrices = {}
    for name in names:
        frame = rng.normal(size=(2, 2))
        matrices[name] = frame @ np.array([[-0.3, 2.0], [-2.0, -0.3]]) @ np.linalg.inv(frame)
    arcs = tuple((a, b) for a in names for b in names if a != b)
    return ErrorDynamics(names, matrices, tuple(ErrorReset(*arc, np.eye(2), np.zeros(2)) for arc in arcs))


@cache
def spread() -> InequalityCertificate:
    return certified(turning(), rate=0.05)


def remembering() -> InequalityCertificate:
    """The same claim by forms that remember the last transition, for stays 5 % longer."""
    plain = spread()
    stay = 1.05 * plain.required_dwell
    problem = FormProblem(shifted_dynamics(turning(), 0.05), Shape(cuts=1, memory=1))
    forms = problem.solve([stay] * 3)
    assert forms is not None
    return replace(plain, forms=forms, required_dwell=stay, dwell=stay)


def test_forms_that_remember_the_last_transition_are_verified() -> None:
    made = remembering()
    assert made.forms is not None
    assert set(made.forms.nodes) == {f"{b} after {k}" for k, b in enumerate(("q", "r", "p", "r", "p", "q"))}
    report = verify_design(tree_of(turning(), made))
    assert report.holds, str(report)


def test_every_walk_through_the_graph_of_nodes_follows_the_transitions_of_the_dynamics() -> None:
    """By the definition: the node after a run is named by the location and the last transitions of that run."""
    dynamics, rng = turning(), np.random.default_rng(0)
    for memory in (0, 1, 2, 3):
        nodes = nodes_of(dynamics, memory)
        run: list[int] = []
        name, place = next(iter(nodes)), next(iter(nodes.values())).location
        for _ in range(60):
            leaving = [k for k, reset in enumerate(dynamics.resets) if reset.source == place]
            assert list(nodes[name].exits) == leaving
            number = int(rng.choice(leaving))
            run, name, place = [number, *run], nodes[name].exits[number], dynamics.resets[number].target
            assert nodes[name].location == place
            if len(run) >= memory:
                history = ", ".join(str(k) for k in run[:memory])
                assert name == (f"{place} after {history}" if memory else place)


def least_eigenvalue(dynamics: ErrorDynamics, forms: Forms, rate: float, shortest: Mapping[str, float]) -> float:
    """The least eigenvalue of all inequalities of quadratic forms, written out from their definition."""
    found = [np.linalg.eigvalsh(P).min() / np.linalg.norm(P) for P in forms.P.values()]
    for span in forms.stays:
        node = forms.nodes[span.node]
        F = dynamics.matrices[node.location] + rate * np.eye(2)
        E = expm(F * (shortest[node.location] + span.start))
        slope = (span.Q[-1] - span.Q[0]) / (span.end - span.start)
        made = [forms.P[span.node] - E.T @ span.Q[0] @ E]
        made += [-(slope + F.T @ Q + Q @ F) for Q in span.Q]
        made += [
            Q - dynamics.resets[k].matrix.T @ forms.P[target] @ dynamics.resets[k].matrix
            for Q in span.Q
            for k, target in node.exits.items()
        ]
        found += [np.linalg.eigvalsh(matrix).min() / np.linalg.norm(span.Q[0]) for matrix in made]
    return float(min(found))


def test_a_hundred_perturbed_forms_over_spans_are_refused() -> None:
    """Each is false by far more than rounding, by the inequalities written out in floating point."""
    dynamics, most, rng, refused = pair(UNSTABLE, DAMPED), {"p": 0.1}, np.random.default_rng(5), 0
    made = certified(dynamics, rate=0.01, most=most)
    shortest = {"p": 0.1, "q": 2 * made.required_dwell}
    forms = FormProblem(shifted_dynamics(dynamics, 0.01), most=most).solve(list(shortest.values()))
    assert forms is not None
    stay, no_witness = shortest["q"], DwellLowerLimit(0.0, None)
    made = replace(made, forms=forms, required_dwell=stay, dwell=stay, limit=no_witness)
    assert verify_design(tree_of(dynamics, made)).holds
    assert least_eigenvalue(dynamics, forms, 0.01, shortest) > 0
    while refused < 100:
        k = int(rng.integers(len(forms.stays)))
        span = forms.stays[k]
        noise = rng.normal(size=(2, 2)) * rng.choice([0.1, 0.5])
        Q = tuple(form + np.linalg.norm(form) * (noise + noise.T) for form in span.Q)
        false = replace(forms, stays=(*forms.stays[:k], replace(span, Q=Q), *forms.stays[k + 1 :]))
        if least_eigenvalue(dynamics, false, 0.01, shortest) > -1e-6:
            continue
        refused += 1
        assert not verify_design(tree_of(dynamics, replace(made, forms=false))).holds


@cache
def grown() -> Tree:
    dynamics = pair(UNSTABLE, DAMPED)
    return tree_of(dynamics, certified(dynamics, rate=0.05, most={"p": 0.3}))


DROPOUT = """
format: deshybrid/1
name: dropout
state: [x, v]
output: [y]
disturbance: [w]
bounds: {disturbance: 0.1, measurement: 0.01}
defaults: {A: [[0, 1], [1, -0.2]], E: [[0], [1]]}
locations:
  seen: {C: [[1, 0]], dwell: {min: 1.5}}
  blind: {C: [[0, 0]], LONGEST}
transitions:
  - {from: seen, to: blind, event: fails, emits: fails}
  - {from: blind, to: seen, event: back, emits: back}
observer: {rate: 0.2, step: 0.01}
"""


def test_a_sensor_that_fails_for_a_short_time_leaves_a_certified_observer_of_an_unstable_plant() -> None:
    made = design(loads(DROPOUT.replace("LONGEST", "dwell: {max: 0.4}")))
    assert made.certified
    assert [(entry.theorem, entry.holds) for entry in made.certificates[2:]] == [("LMI", True), ("LMI-sampled", True)]
    assert [(p.code, p.severity) for p in made.problems] == [("DH0503", "warning")]
    assert made.ultimate is not None
    assert "`blind`" in made.ultimate.reason
    report = verify_design(made.document())
    assert report.holds, str(report)
    outside = design(loads(DROPOUT.replace("LONGEST", "dwell: {min: 0.1}")))
    assert not outside.certified
    assert [(p.code, p.severity) for p in outside.problems] == [("DH0503", "error")]


CLAIM = ("certificates", 0)
TAMPERED: list[tuple[str, tuple[str | int, ...], Callable[[Any], Any], str]] = [
    ("the longest stay", ("system", "longest_stays", "p"), lambda v: 2 * v, "stay inequality"),
    ("no longest stay", ("system", "longest_stays"), lambda v: {}, "the spans cover all stays"),
    ("a span ends early", (*CLAIM, "stays", 0, "to"), lambda v: 0.5 * v, "the spans cover all stays"),
    ("a span is missing", (*CLAIM, "stays"), lambda v: v[1:], "the spans cover all stays"),
    ("the delay", (*CLAIM, "delay"), lambda v: v + 0.1, "stay inequality"),
    ("Q at the end of a span", (*CLAIM, "stays", 0, "Q", 1), lambda Q: [[2 * v for v in r] for r in Q], "flow"),
    ("Q at the start", (*CLAIM, "stays", 0, "Q", 0), lambda Q: [[2 * v for v in r] for r in Q], "stay inequality"),
    ("an exit is missing", (*CLAIM, "nodes", "p", "exits"), lambda v: [], "every reset leads from each node"),
    ("an exit to elsewhere", (*CLAIM, "nodes", "p", "exits", 0, 1), lambda v: "p", "every reset leads from each node"),
    ("a node is of elsewhere", (*CLAIM, "nodes", "p", "location"), lambda v: "q", "every location has a node"),
    ("a witness stays too long", ("witness_cycle", "stays", 0), lambda v: v + 9, "longer than its location allows"),
]


@pytest.mark.parametrize(("what", "path", "change", "broken"), TAMPERED, ids=[entry[0] for entry in TAMPERED])
def test_a_changed_certificate_with_spans_is_refused_and_the_reason_named(
    what: str, path: tuple[str | int, ...], change: Callable[[Any], Any], broken: str
) -> None:
    report = verify_design(changed(grown(), path, change))
    assert not report.holds
    assert any(broken in check.inequality for check in report.refused), str(report)
