"""Residual generators and the bounds on their residuals, against sums and simulations written out."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.detector.residual import ResidualGenerator, build_generator, default_poles
from deshybrid.detector.thresholds import (
    absolute_sum,
    floor,
    largest_state,
    settling_ticks,
    steady_bound,
)
from deshybrid.diagnostics import GainError, UsageError
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.load import loads
from deshybrid.model.system import HybridSystem

MODEL = """\
format: deshybrid/1
name: oscillators
time: continuous
state: [x1, x2, x3]
input: [u]
output: [y1, y2]
disturbance: [w]
bounds: {state: 10, input: 1, disturbance: 0.5, measurement: {y1: 0.01, y2: 0.02}}
defaults: {B: [[0], [1], [0]], E: [[0], [1], [0]], C: [[1, 0, 0], [0, 1, 0]], f: [0, 0.1, 0], g: [0.2, 0]}
locations:
  p: {A: [[0, 1, 0], [-4, -0.5, 0], [0, 0, -1]]}
  q: {A: [[0, 1, 0], [-9, -0.5, 0], [0, 0, 2]], D: [[0.3], [0]]}
  r: {A: [[0, 1, 0], [-1, -0.5, 0], [0, 0, -1]], C: [[1, 0, 0]], g: [0.2], output: [y1]}
transitions:
  - {from: p, to: q, event: a, emits: null}
  - {from: q, to: r, event: b, emits: null}
  - {from: r, to: p, event: c, emits: null}
"""
STEP = 0.02


def system_of(text: str = MODEL) -> HybridSystem:
    return loads(text)


def generator_of(name: str, system: HybridSystem | None = None, step: float = STEP) -> ResidualGenerator:
    system = system or system_of()
    return build_generator(system, system.location(name), rate=1.0, dwell=None, step=step)


def residuals(generator: ResidualGenerator, w: FloatArray, v: FloatArray, error: FloatArray) -> FloatArray:
    """r = H e + J v along e := F e + G v - T (what w does); w (N, s, 1) is constant over s equal parts of a step."""
    parts = w.shape[1]
    A, E = generator.dynamics.A, generator.dynamics.E
    n = len(A)
    block = expm(np.block([[A, E], [np.zeros((1, n + 1))]]) * generator.step / parts)
    seen = []
    for w_step, v_now in zip(w, v, strict=True):
        seen.append(generator.H @ error + generator.J @ v_now)
        moved = np.zeros(n)
        for part in w_step:
            moved = block[:n, :n] @ moved + block[:n, n:] @ part
        error = generator.F @ error + generator.gain @ v_now - generator.T @ moved
    return np.array(seen)


@pytest.mark.parametrize("name", ["p", "q", "r"])
def test_noise_free_residual_of_the_own_location_is_zero_from_the_true_state_on(name: str) -> None:
    """The generator is exact for a held input, whatever the step: offsets, feedthrough and inputs included."""
    generator, rng = generator_of(name, step=0.3), np.random.default_rng(1)
    dynamics = generator.dynamics
    block = np.zeros((5, 5))
    block[:3, :3], block[:3, 3:4], block[:3, 4] = dynamics.A, dynamics.B, dynamics.f
    flow = expm(block * 0.3)
    x = rng.normal(size=3)
    z = generator.T @ x
    for _ in range(20):
        u = rng.normal(size=1)
        y = dynamics.C @ x + dynamics.D @ u + dynamics.g
        shown = generator.H @ z + generator.through @ u + generator.J @ y + generator.residual_offset
        assert np.allclose(shown, 0.0, atol=1e-9)
        z = generator.F @ z + generator.input @ u + generator.gain @ y + generator.offset
        x = (flow @ np.concatenate([x, u, [1.0]]))[:3]


@pytest.mark.parametrize("name", ["p", "q", "r"])
def test_residual_decays_at_the_sampled_poles(name: str) -> None:
    generator = generator_of(name)
    expected = np.sort(np.exp(np.real(generator.poles) * STEP))
    assert np.sort(np.linalg.eigvals(generator.F).real) == pytest.approx(expected, rel=1e-6)


def test_modes_that_no_output_shows_are_left_out_even_if_they_grow() -> None:
    assert [generator_of(name).F.shape for name in "pqr"] == [(2, 2)] * 3
    assert np.abs(np.linalg.eigvals(generator_of("q").F)).max() < 1.0


def test_start_explains_the_first_output() -> None:
    generator = generator_of("p")
    y = np.array([0.7, -0.3])
    z = generator.start @ y + generator.start_offset
    assert generator.H @ z + generator.residual_offset == pytest.approx(-generator.J @ y)


def test_default_poles_follow_rate_and_dwell_and_stay_below_what_the_step_resolves() -> None:
    assert default_poles(2, rate=2.0, dwell=None, step=1e-3) == (-10, -15)
    assert default_poles(1, rate=2.0, dwell=0.1, step=1e-3) == (-100,)
    assert default_poles(1, rate=2.0, dwell=0.1, step=0.01) == (-30,)
    assert default_poles(1, rate=None, dwell=None, step=0.01) == (-10,)


def test_stated_poles_are_taken_and_checked() -> None:
    written = MODEL + "observer: {detector: {poles: {p: [-7, -8, -9]}}}\n"
    assert generator_of("p", system_of(written)).poles == (-7, -8)
    with pytest.raises(UsageError, match="DH0602"):
        generator_of("p", system_of(written.replace("-7", "7")))


def test_a_location_that_measures_nothing_has_no_generator() -> None:
    blind = MODEL.replace("C: [[1, 0, 0]], g: [0.2], output: [y1]", "C: [[0, 0, 0]], g: [0.2], output: [y1]")
    with pytest.raises(GainError, match="DH0603"):
        generator_of("r", system_of(blind))


def test_absolute_sum_is_the_sum_of_absolute_impulse_responses() -> None:
    rng = np.random.default_rng(3)
    for _ in range(20):
        F = rng.normal(size=(3, 3))
        F *= 0.95 / np.abs(np.linalg.eigvals(F)).max()
        C, X = rng.normal(size=(2, 3)), rng.normal(size=(3, 2))
        power, naive = np.eye(3), np.zeros((2, 2))
        for _ in range(3000):
            naive += np.abs(C @ power @ X)
            power = F @ power
        found = absolute_sum(F, C, X)
        assert (found >= naive * (1 - 1e-12)).all()
        assert found == pytest.approx(naive, rel=0.2)


def test_absolute_sum_of_an_unstable_matrix_is_infinite() -> None:
    assert np.isinf(absolute_sum(np.array([[1.001]]), np.eye(1), np.eye(1))).all()


@pytest.mark.parametrize("name", ["p", "q", "r"])
def test_an_adversary_reaches_the_steady_bound_and_never_exceeds_it(name: str) -> None:
    """w and v chosen against one channel: w switches sign within a step as the impulse response does."""
    system, generator = system_of(), generator_of(name)
    bounds, length, parts = steady_bound(system, generator), 400, 8
    assert system.bounds.disturbance is not None
    assert system.bounds.measurement is not None
    noise = system.bounds.measurement[list(generator.location.output_index)]
    A, E = generator.dynamics.A, generator.dynamics.E
    late = [generator.T @ expm(A * (parts - 0.5 - i) / parts * generator.step) @ E for i in range(parts)]
    for channel in range(len(bounds)):
        w, v = np.zeros((length, parts, 1)), np.zeros((length, len(noise)))
        row = generator.H[channel]
        v[-1] = -np.sign(np.eye(len(noise))[channel]) * noise
        for back in range(length - 2, -1, -1):
            w[back] = [-np.sign(row @ entering) * system.bounds.disturbance for entering in late]
            v[back] = np.sign(row @ generator.gain) * noise
            row = row @ generator.F
        reached = abs(residuals(generator, w, v, np.zeros(2))[-1][channel])
        assert reached <= bounds[channel]
        assert reached == pytest.approx(bounds[channel], rel=0.02)


def test_bounds_without_disturbance_or_noise_are_zero_and_the_floor_is_a_share_of_full_scale() -> None:
    quiet = replace(system_of(), bounds=replace(system_of().bounds, disturbance=None, measurement=None))
    assert steady_bound(quiet, generator_of("p")).tolist() == [0.0, 0.0]
    assert floor(quiet, generator_of("p")) == pytest.approx([1e-4 * 10.2, 1e-4 * 10.0])
    unbounded = replace(quiet, bounds=replace(quiet.bounds, state=None))
    assert floor(unbounded, generator_of("p")).tolist() == [1e-4, 1e-4]


@pytest.mark.parametrize("name", ["p", "q", "r"])
def test_generator_state_stays_within_its_bound_for_every_bounded_input_and_output(name: str) -> None:
    system, generator = system_of(), generator_of(name)
    bound = largest_state(system, generator)
    assert bound is not None
    rng = np.random.default_rng(5)
    limit = np.array([10.0 + 0.2 + 0.3 + 0.01, 10.0 + 0.02])[list(generator.location.output_index)]
    for _ in range(20):
        z = generator.start @ (rng.choice([-1, 1], len(limit)) * limit) + generator.start_offset
        for _ in range(200):
            assert (np.abs(z) <= bound).all()
            u, y = rng.choice([-1, 1], 1), rng.choice([-1, 1], len(limit)) * limit
            z = generator.F @ z + generator.input @ u + generator.gain @ y + generator.offset


def test_generator_state_has_no_bound_where_the_model_states_none_for_state_or_input() -> None:
    system, generator = system_of(), generator_of("p")
    for name in ("state", "input"):
        assert largest_state(replace(system, bounds=replace(system.bounds, **{name: None})), generator) is None


def test_settling_is_the_last_sample_at_which_the_transient_can_exceed_the_margin() -> None:
    generator, rng = generator_of("p"), np.random.default_rng(7)
    for _ in range(20):
        mismatch, margin = rng.uniform(0, 10, 2), rng.uniform(0.01, 1, 2)
        power, last = np.eye(2), -1
        for tick in range(2000):
            if (np.abs(generator.H @ power) @ mismatch > margin).any():
                last = tick
            power = generator.F @ power
        assert settling_ticks(generator, mismatch, margin) == last + 1


def test_settling_never_ends_without_a_margin() -> None:
    generator = generator_of("p")
    assert settling_ticks(generator, np.ones(2), np.array([0.1, 0.0])) is None
    assert settling_ticks(generator, np.array([np.inf, 1.0]), np.ones(2)) is None
