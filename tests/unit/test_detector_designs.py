"""Residual generators by design, against simulations: what is decoupled is not seen, and nothing else is lost."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import expm, solve_discrete_lyapunov

from deshybrid.detector.contrast import contrast
from deshybrid.detector.designs import design_generator
from deshybrid.detector.held_back import realised
from deshybrid.detector.residual import ResidualGenerator, build_generator, follow, sampled_dynamics
from deshybrid.detector.thresholds import steady_bound
from deshybrid.detector.trade_off import filtering_generator
from deshybrid.detector.unknown_input import decouplable
from deshybrid.diagnostics import ModelError, UsageError
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.load import load, loads
from deshybrid.model.system import HybridSystem
from tests.unit.test_detector_thresholds import MODEL, STEP

DRIVELINE = load("models/balluchi2012/driveline.yaml")
GEARS = ("q1", "q2", "q3", "q4", "q5", "qR")


def asked(detector: str, text: str = MODEL) -> HybridSystem:
    return loads(f"{text}observer: {{detector: {{{detector}}}}}\n")


def driveline(**wishes: object) -> HybridSystem:
    """The driveline without the poles and thresholds of its file."""
    plain = replace(DRIVELINE.observer.detector, poles={}, threshold={}, **wishes)  # type: ignore[arg-type]
    return replace(DRIVELINE, observer=replace(DRIVELINE.observer, detector=plain))


def made(system: HybridSystem, name: str, step: float = STEP, rate: float = 2.0) -> ResidualGenerator:
    return design_generator(system, system.location(name), rate=rate, dwell=None, step=step)


def residuals(
    generator: ResidualGenerator, x: FloatArray, u: FloatArray, w: FloatArray, v: FloatArray, *, follow_x: bool = True
) -> FloatArray:
    """Run the plant of the generator's location, w held over each step, and the generator on its outputs."""
    d, step = generator.dynamics, generator.step
    n, m, r = len(d.A), d.B.shape[1], d.E.shape[1]
    block = np.zeros((n + m + r + 1,) * 2)
    block[:n] = np.hstack([d.A, d.B, d.E, d.f[:, None]])
    flow = expm(block * step)[:n]
    z = generator.T @ x if follow_x else np.zeros(len(generator.F))
    seen = []
    for u_now, w_now, v_now in zip(u, w, v, strict=True):
        y = d.C @ x + d.D @ u_now + d.g + v_now
        seen.append(generator.H @ z + generator.through @ u_now + generator.J @ y + generator.residual_offset)
        z = generator.F @ z + generator.input @ u_now + generator.gain @ y + generator.offset
        x = flow @ np.concatenate([x, u_now, w_now, [1.0]])
    return np.array(seen)


@pytest.mark.parametrize("design", ["luenberger", "unknown_input", "h2", "auto"])
@pytest.mark.parametrize("name", ["p", "q"])
def test_every_design_is_exact_in_its_own_location_without_disturbance_and_noise(design: str, name: str) -> None:
    generator, rng = made(asked(f"design: {design}"), name), np.random.default_rng(1)
    shown = residuals(generator, rng.normal(size=3), rng.normal(size=(30, 1)), np.zeros((30, 1)), np.zeros((30, 2)))
    assert np.abs(shown).max() < 1e-9


@pytest.mark.parametrize("name", ["p", "q"])
def test_a_decoupled_disturbance_of_any_size_leaves_the_residual_alone(name: str) -> None:
    generator, rng = made(asked("design: unknown_input"), name), np.random.default_rng(2)
    x, u, v = rng.normal(size=3), rng.normal(size=(60, 1)), 0.01 * rng.normal(size=(60, 2))
    quiet, loud = (residuals(generator, x, u, w, v) for w in (np.zeros((60, 1)), 1e3 * rng.normal(size=(60, 1))))
    assert loud == pytest.approx(quiet, abs=1e-7)
    paper = made(asked("design: luenberger"), name)
    shaken = residuals(paper, x, u, 1e3 * rng.normal(size=(60, 1)), v)
    assert np.abs(shaken).max() > 1.0


@pytest.mark.parametrize("gear", GEARS)
def test_the_torque_at_the_wheels_is_decoupled_from_every_gear_of_the_driveline(gear: str) -> None:
    """rank(C F) = 1: the crankshaft is followed with the wheels' speed as an input; order 2 instead of 3."""
    system = driveline(design="unknown_input", decouple=("T_w",))
    generator, rng = made(system, gear, step=0.012), np.random.default_rng(3)
    assert (len(generator.F), generator.channels) == (2, (0,))
    assert generator.design == "Luenberger observer, poles placed; decoupled from `T_w`"
    w = np.zeros((80, 3))
    w[:, 0] = 800.0 * rng.choice([-1, 1], 80)
    x, u, v = np.array([0.1, 200.0, 50.0]), 100.0 * rng.normal(size=(80, 1)), np.zeros((80, 2))
    quiet, loud = (residuals(generator, x, u, wheels, v) for wheels in (0 * w, w))
    assert loud == pytest.approx(quiet, abs=1e-6)


def test_without_names_the_disturbance_is_decoupled_that_buys_most_contrast() -> None:
    free = driveline(design="unknown_input")
    for gear in ("q1", "q5"):
        named = made(driveline(design="unknown_input", decouple=("T_w",)), gear, step=0.012)
        assert np.array_equal(made(free, gear, step=0.012).F, named.F)


def test_what_buys_nothing_is_not_decoupled_by_auto() -> None:
    """Without disturbances there is no gain in giving an output away."""
    text = MODEL.replace("disturbance: 0.5", "disturbance: 0")
    assert made(asked("design: auto", text), "p").channels == (0, 1)


@pytest.mark.parametrize("name", ["p", "q"])
def test_auto_has_at_least_the_contrast_of_every_other_design(name: str) -> None:
    of = {d: contrast(asked(f"design: {d}"), made(asked(f"design: {d}"), name)) for d in ("luenberger", "h2", "auto")}
    assert of["auto"] >= max(of.values()) / 1.05


@pytest.mark.parametrize("design", ["unknown_input", "h2"])
@pytest.mark.parametrize("name", ["p", "q"])
def test_no_bounded_disturbance_and_noise_exceeds_the_steady_bound_of_a_design(design: str, name: str) -> None:
    system = asked(f"design: {design}")
    generator, bound, rng = made(system, name), steady_bound(system, made(system, name)), np.random.default_rng(5)
    for _ in range(10):
        w, v = 0.5 * rng.choice([-1, 1], (200, 1)), np.array([0.01, 0.02]) * rng.choice([-1, 1], (200, 2))
        shown = residuals(generator, rng.normal(size=3), rng.normal(size=(200, 1)), w, v)
        assert (np.abs(shown) <= bound).all()


def variance(gain: FloatArray) -> float:
    """Of the residual of `p` before its own noise, by Lyapunov's equation, in units of the noise; else infinite.

    The weights do not matter for which gain is best: the predictor is, in all of them at once.
    """
    system = asked("design: h2")
    followed = follow(system, system.location("p"), STEP)
    moved = followed.T @ sampled_dynamics(system, followed.dynamics, STEP).E * 0.5
    F, sensor = followed.A - gain @ followed.C, np.diag([0.01**2, 0.02**2])
    if np.abs(np.linalg.eigvals(F)).max() >= 1.0:
        return np.inf
    P = solve_discrete_lyapunov(F, moved @ moved.T + gain @ sensor @ gain.T)
    return float((1.0 / np.diag(sensor)) @ np.diag(followed.C @ P @ followed.C.T))


def filter_at(rate: float) -> ResidualGenerator:
    system = asked("design: h2")
    return filtering_generator(system, follow(system, system.location("p"), STEP), rate)


def test_no_other_gain_has_a_smaller_residual_variance_than_the_filter() -> None:
    best, rng = filter_at(0.0).gain, np.random.default_rng(7)
    others = [best * (1.0 + size * rng.normal(size=best.shape)) for size in (0.01, 0.1, 1.0, 10.0) for _ in range(25)]
    assert all(variance(other) >= variance(best) * (1.0 - 1e-6) for other in others)


@pytest.mark.parametrize("rate", [1.0, 10.0, 40.0])
def test_the_error_of_a_filter_decays_at_the_rate_that_was_asked(rate: float) -> None:
    system = asked("design: h2")
    generator = filtering_generator(system, follow(system, system.location("p"), STEP), rate)
    assert np.abs(np.linalg.eigvals(generator.F)).max() <= np.exp(-rate * STEP) * (1 + 1e-9)


def test_more_speed_costs_variance() -> None:
    slow, middle, fast = (variance(filter_at(rate).gain) for rate in (0.0, 20.0, 60.0))
    assert slow < middle < fast


def test_a_disturbance_that_no_output_shows_at_once_cannot_be_decoupled_and_the_message_says_so() -> None:
    """In `r` only y1 is measured, and w acts on its second derivative: rank(C E) = 0."""
    system = asked("design: unknown_input, decouple: [w]")
    with pytest.raises(UsageError, match="DH0612") as caught:
        made(system, "r")
    assert "rank(C E) = 0, below rank(E) = 1" in str(caught.value)
    dynamics = system.location("r").dynamics
    assert dynamics is not None
    assert decouplable(dynamics) == ()


def test_a_location_where_nothing_can_be_decoupled_gets_the_trade_off_instead() -> None:
    other, filtered = made(asked("design: unknown_input"), "r"), made(asked("design: h2"), "r")
    assert np.array_equal(other.gain, filtered.gain)


def test_two_disturbances_for_two_outputs_leave_no_residual() -> None:
    with pytest.raises(UsageError, match="2 outputs leave no residual"):
        made(driveline(design="unknown_input", decouple=("T_w", "T_p")), "q1", step=0.012)


@pytest.mark.parametrize("wish", ["design: kalman", "decouple: [x]", "delay: {y3: 0.1}", "delay: -1"])
def test_a_design_that_is_none_and_channels_that_are_none_are_refused_at_their_place(wish: str) -> None:
    with pytest.raises(ModelError) as caught:
        asked(wish)
    assert all(problem.span is not None for problem in caught.value.diagnostics)


def test_delayed_outputs_give_the_residual_of_the_ones_in_time_as_much_later() -> None:
    """y1 one sample late, y2 three: the filter that runs has five more states, and its residual is three late."""
    system = asked("delay: {y1: 0.02, y2: 0.061}")
    core, running = made(asked("design: luenberger"), "q"), realised(made(system, "q"))
    assert (made(system, "q").lag, len(running.F) - len(core.F)) == (3, 5)
    rng = np.random.default_rng(11)
    u, y = rng.normal(size=(300, 1)), rng.normal(size=(300, 2))
    late = np.column_stack([np.concatenate([y[:1, i].repeat(d), y[: 300 - d, i]]) for i, d in enumerate((1, 3))])
    in_time = outputs_of(core, u, y, core.start @ y[0] + core.start_offset)
    settled = outputs_of(running, u, late, running.start @ late[0] + running.start_offset)
    assert settled[280:] == pytest.approx(in_time[277:297], abs=1e-9)


def outputs_of(generator: ResidualGenerator, u: FloatArray, y: FloatArray, z: FloatArray) -> FloatArray:
    seen = []
    for u_now, y_now in zip(u, y, strict=True):
        seen.append(generator.H @ z + generator.through @ u_now + generator.J @ y_now + generator.residual_offset)
        z = generator.F @ z + generator.input @ u_now + generator.gain @ y_now + generator.offset
    return np.array(seen)


def test_a_delay_below_half_a_step_changes_nothing() -> None:
    system = asked("delay: 0.009")
    assert made(system, "p").held == ()


def test_the_plain_bank_of_the_paper_is_what_a_model_without_a_design_gets() -> None:
    system = loads(MODEL)
    paper = build_generator(system, system.location("p"), rate=2.0, dwell=None, step=STEP)
    assert np.array_equal(made(system, "p").F, paper.F)
