"""Interacting filters against their definition, written with densities of scipy, and what they cannot be made for."""

from functools import lru_cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.stats import multivariate_t

from deshybrid.compiler import compile
from deshybrid.detector.bank import assumed_window, build_bank
from deshybrid.diagnostics import ModelError, UsageError
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.load import load, loads
from deshybrid.model.system import HybridSystem
from deshybrid.observer.hybrid import HybridObserver

STEP = 0.05
MODEL = """\
format: deshybrid/1
name: cart
time: continuous
state: [x, v]
input: [u]
output: [x, v]
noise: {process: [[0.01, 0], [0, 0.2]], measurement: [[0.02, 0], [0, 0.05]]}
bounds: {state: 10, input: 1}
defaults: {B: [[0], [1]], C: [[1, 0], [0, 1]], dwell: {min: 1}}
locations:
  free: {A: [[0, 1], [0, -0.2]]}
  held: {A: [[0, 1], [-9, -1]]}
  pushed: {A: [[0, 1], [0, -0.2]], f: [0, 2]}
transitions:
  - {from: free, to: held, event: a, emits: null}
  - {from: held, to: free, event: b, emits: null}
  - {from: held, to: pushed, event: c, emits: null}
  - {from: pushed, to: held, event: d, emits: null}
observer:
  rate: 0.1
  step: 0.05
  dwell: 1
  detector:
    decision: imm
    stay: {held: 3}
    entry: {held: [[1, 0], [0, 0]]}
    entry_time: 0.5
"""
OWNER = (0, 1, 2, 1)


def cart(text: str = MODEL, **changes: str) -> HybridSystem:
    for old, new in changes.items():
        text = text.replace(old, new)
    return loads(text)


def test_the_chain_says_how_long_stays_and_entries_last() -> None:
    chain = build_bank(cart(), step=STEP).chain
    assert np.allclose(chain.sum(axis=0), 1.0)
    ends_held, ends_free, settles = (1.0 - np.exp(-STEP / mean) for mean in (3.0, 10.0, 0.5))
    assert np.allclose(chain[:, 0], [1.0 - ends_free, 0.0, 0.0, ends_free])  # into `held` by its entry
    assert np.allclose(chain[:, 1], [ends_held / 2, 1.0 - ends_held, ends_held / 2, 0.0])
    stays = 1.0 - ends_held
    assert np.allclose(chain[:, 3], [ends_held / 2, stays * settles, ends_held / 2, stays * (1.0 - settles)])


def riccati(A: FloatArray, Q: FloatArray, C: FloatArray, V: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Gain and covariance of the residual of the stationary predictor, by walking there."""
    P = np.eye(len(A))
    for _ in range(1000):
        S = C @ P @ C.T + V
        K = A @ P @ C.T @ np.linalg.inv(S)
        P = A @ P @ A.T + Q - K @ S @ K.T
    return K, S


def sampled_noise(A: FloatArray, noise: FloatArray) -> FloatArray:
    """The integral of e^{As} W e^{Aᵀs} over a step, by the midpoint rule."""
    parts = 100
    flows = [expm(A * STEP * (i + 0.5) / parts) for i in range(parts)]
    return np.asarray(sum(flow @ noise @ flow.T for flow in flows) * STEP / parts)


@lru_cache
def naive_filters() -> list[tuple[FloatArray, ...]]:
    """By filter the flow, the input, the offset, the gain and the covariance of the residual."""
    system, made = cart(), []
    for number, place in enumerate(OWNER):
        location = system.locations[place]
        dynamics, process, V = location.dynamics, location.process_noise, location.measurement_noise
        assert dynamics is not None
        assert process is not None
        assert V is not None
        noise = process + (system.observer.detector.entry["held"] if number == 3 else 0.0)
        block = np.zeros((4, 4))
        block[:2] = np.hstack([dynamics.A, dynamics.B, dynamics.f[:, None]])
        flow = expm(block * STEP)
        gain, covariance = riccati(flow[:2, :2], sampled_noise(dynamics.A, noise), dynamics.C, V)
        made.append((flow[:2, :2], flow[:2, 2], flow[:2, 3], gain, covariance))
    return made


def naive_probabilities(chain: FloatArray, inputs: FloatArray, outputs: FloatArray) -> FloatArray:
    """The probability of each filter after each sample."""
    A, B, f, K, S = zip(*naive_filters(), strict=True)
    z, mu, found = [outputs[0].copy() for _ in OWNER], np.full(4, 0.25), []
    for k, y in enumerate(outputs):
        if k:
            moved = [A[i] @ z[i] + B[i] * inputs[k - 1] + f[i] + K[i] @ (outputs[k - 1] - z[i]) for i in range(4)]
            joint = chain * mu
            mu = joint.sum(axis=1)
            z = [sum(joint[j, i] / mu[j] * moved[i] for i in range(4)) for j in range(4)]
        fits = [multivariate_t(z[j], S[j], df=4).pdf(y) for j in range(4)]
        mu = mu * fits / np.sum(mu * fits)
        found.append(mu)
    return np.array(found)


@lru_cache
def observer_of_the_cart() -> HybridObserver:
    observer = compile(cart(), step=STEP).observer
    assert observer is not None
    return observer


def drive(seed: int, rows: int = 60) -> tuple[FloatArray, FloatArray]:
    """Inputs and outputs of a cart that is let go, caught and pushed."""
    draw, x, found = np.random.default_rng(seed), np.array([1.0, 0.0]), []
    inputs = draw.uniform(-1.0, 1.0, rows)
    for k in range(rows):
        found.append(x + draw.normal(0.0, 0.15, 2))
        held = (k // 20) % 2
        x = x + STEP * np.array([x[1], -9.0 * held * x[0] - x[1] + inputs[k] + (0 if held else 2.0 * (k > 30))])
    return inputs, np.array(found)


@settings(max_examples=10, deadline=None)
@given(st.integers(0, 10_000))
def test_the_probabilities_of_the_step_are_those_of_the_definition(seed: int) -> None:
    observer, (inputs, outputs) = observer_of_the_cart(), drive(seed)
    expected = naive_probabilities(build_bank(cart(), step=STEP).chain, inputs, outputs)
    state = observer.start()
    for u, y, probabilities in zip(inputs, outputs, expected, strict=True):
        state, _ = observer.step(state, (float(u),), tuple(map(float, y)), None)
        assert np.allclose([mu for (mu,) in state.evidence], probabilities, rtol=1e-4, atol=1e-9)


def test_a_location_is_named_from_the_confidence_on_and_doubted_below_one_half() -> None:
    observer = observer_of_the_cart()
    state, named = observer.start(), []
    for u, y in zip(*drive(3, 200), strict=True):
        before = state.active
        state, estimate = observer.step(state, (float(u),), tuple(map(float, y)), None)
        mu = [value for (value,) in state.evidence]
        chances = (mu[0], mu[1] + mu[3], mu[2])
        assert state.relay == (*(c >= (0.5 if on else 0.95) for c, on in zip(chances, before, strict=False)), False)
        named.append(estimate.location)
    assert {"free", "held", "pushed"} <= set(named)


def test_a_name_is_waited_for_half_of_a_stay_where_nothing_else_is_stated() -> None:
    assert assumed_window(cart()) == 0.5
    unbounded = cart(**{", dwell: {min: 1}": "", "  dwell: 1\n": "", "{held: 3}": "{free: 6, held: 3, pushed: 4}"})
    assert assumed_window(unbounded) == 1.5


@pytest.mark.parametrize(
    ("old", "new", "why"),
    [
        ("    decision: imm\n", "    decision: imm\n    design: h2\n", "not of the design `h2`"),
        ("    entry_time: 0.5\n", "", "`entry` needs `entry_time`"),
        (", dwell: {min: 1}", "", "no mean stay"),
        ("event: b, emits: null", "event: b, emits: null, reset: {matrix: [[1, 0], [0, 0]]}", "resets the state"),
        (
            "pushed: {A: [[0, 1], [0, -0.2]], f: [0, 2]}",
            "pushed: {A: [[0, 1], [0, 1]], C: [[0, 0], [0, 0]]}",
            "measures",
        ),
        ("pushed: {A: [[0, 1], [0, -0.2]],", "pushed: {A: [[1, 0], [0, 1]], C: [[0, 1], [0, 1]],", "grows"),
        ("pushed: {A: [[0, 1], [0, -0.2]],", "pushed: {output: [x], C: [[1, 0]], A: [[0, 1], [0, -0.2]],", "channels"),
    ],
)
def test_what_interacting_filters_cannot_be_made_for_is_told(old: str, new: str, why: str) -> None:
    text = MODEL.replace(old, new).replace("  dwell: 1\n", "" if "min" in old else "  dwell: 1\n")
    assert text != MODEL
    with pytest.raises(UsageError, match=why) as told:
        build_bank(loads(text), step=STEP)
    assert told.value.diagnostics[0].code == "DH0614"


@pytest.mark.parametrize(
    ("old", "new", "code"),
    [
        ("decision: imm", "confidence: 1", "DH0124"),
        ("entry: {held: [[1, 0], [0, 0]]}", "entry: {held: [[1, 0], [0, -1]]}", "DH0210"),
        ("entry: {held: [[1, 0], [0, 0]]}", "entry: {nowhere: [[1, 0], [0, 0]]}", "DH0201"),
        ("stay: {held: 3}", "stay: {held: 0}", "DH0124"),
    ],
)
def test_numbers_that_make_no_sense_are_refused_where_they_stand(old: str, new: str, code: str) -> None:
    text = MODEL.replace(old, new)
    with pytest.raises(ModelError) as told:
        loads(text)
    assert [problem.code for problem in told.value.diagnostics] == [code]


def test_the_driveline_has_a_second_filter_for_every_gear() -> None:
    bank = build_bank(load("models/balluchi2012/driveline.yaml"), step=0.012)
    assert bank.owner == (0, 1, 2, 3, 4, 5, 6, 0, 1, 2, 3, 4, 5)
    assert bank.share.max() == 1.0
