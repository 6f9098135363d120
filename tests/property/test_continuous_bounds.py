"""What certificates and bounds promise, tried on random systems: by matrix exponentials and by simulated errors."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from deshybrid.continuous.cycles import dwell_lower_limit
from deshybrid.continuous.dwell import certify_dwell, certify_sampled
from deshybrid.continuous.error import sampled_error_dynamics
from deshybrid.continuous.gains import ObserverGains, design_gains
from deshybrid.continuous.impulse import impulse_norm, peak_norm
from deshybrid.continuous.ultimate import ultimate_bound
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.linear.sampling import flow_and_integral
from deshybrid.model.system import Bounds, HybridSystem
from tests.switched import linear, switched

SEEDS = st.integers(0, 2**32 - 1)
FEW = settings(max_examples=8, deadline=None, derandomize=True)
NAMES = ("a", "b", "c")


def random_system(rng: np.random.Generator, *, stable: bool = False, resets: bool = True) -> HybridSystem:
    """Two or three locations of one to three states, one or two outputs, an input and a disturbance."""
    n, p, names = int(rng.integers(1, 4)), int(rng.integers(1, 3)), NAMES[: int(rng.integers(2, 4))]
    places = {}
    for name in names:
        A = rng.normal(size=(n, n))
        if stable:
            A = A - (np.linalg.eigvals(A).real.max() + 0.5) * np.eye(n)
        places[name] = linear(
            A,
            rng.normal(size=(p, n)),
            B=rng.normal(size=(n, 1)),
            E=rng.normal(size=(n, 1)),
            f=0.3 * rng.normal(size=n),
            g=0.3 * rng.normal(size=p),
        )
    arcs = [(x, y, np.eye(n) + 0.4 * resets * rng.normal(size=(n, n))) for x in names for y in names if x != y]
    offsets = {(x, y): 0.2 * resets * rng.normal(size=n) for x, y, _ in arcs}
    return switched(places, arcs, offsets=offsets)


def dynamics(system: HybridSystem, name: str) -> LinearDynamics:
    found = system.location(name).dynamics
    assert found is not None
    return found


def designed(system: HybridSystem, rate: float) -> ObserverGains:
    return design_gains(system, tuple(location.name for location in system.locations), rate=rate)


@FEW
@given(SEEDS)
def test_every_reset_after_every_permitted_stay_contracts_at_the_certified_rate(seed: int) -> None:
    """The proof of Theorem 6, by expm in the certificate's norm, independent of eigenvectors."""
    system = random_system(np.random.default_rng(seed))
    gains = designed(system, 1.0)
    found = certify_dwell(system, gains)
    S = found.scale
    assert found.holds
    for t in system.transitions:
        assert t.reset is not None
        for stay in found.dwell * np.array([1.0, 1.01, 1.3, 2.0, 5.0]):
            over = t.reset.matrix @ expm(gains.closed_loop[t.source] * stay)
            assert np.linalg.norm(over * S / S[:, None], 2) <= np.exp(-found.rate * stay) * (1 + 1e-9)


@FEW
@given(SEEDS)
def test_a_sampled_certificate_contracts_over_every_permitted_number_of_steps(seed: int) -> None:
    system = random_system(np.random.default_rng(seed))
    gains = designed(system, 1.0)
    found = certify_sampled(system, gains, step=0.01)
    if not found.holds:
        return
    S, matrices = found.scale, sampled_error_dynamics(system, gains.gains, 0.01).matrices
    steps = round(found.required_dwell / 0.01)
    for t in system.transitions:
        assert t.reset is not None
        for k in (max(steps, 1), steps + 1, 2 * steps + 1):
            over = t.reset.matrix @ np.linalg.matrix_power(matrices[t.source], k)
            assert np.linalg.norm(over * S / S[:, None], 2) <= np.exp(-found.rate * k * 0.01) * (1 + 1e-9)


@FEW
@given(SEEDS)
def test_no_cycle_refutes_a_certified_dwell_time(seed: int) -> None:
    system = random_system(np.random.default_rng(seed))
    gains = designed(system, 1.0)
    needed = certify_dwell(system, gains).required_dwell
    limit = dwell_lower_limit(system, gains, longest=3 * needed + 0.1)
    assert limit.value <= needed * (1 + 1e-9)
    assert (limit.cycle is None) == (limit.value == 0)


@pytest.mark.parametrize("seed", range(6))
def test_impulse_and_peak_bounds_lie_above_fine_sums_by_a_few_percent(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 5))
    F = rng.normal(size=(n, n)) * rng.choice([1.0, 10.0])
    F = F - (np.linalg.eigvals(F).real.max() + 0.3) * np.eye(n)
    values, vectors = (part.astype(complex) for part in np.linalg.eig(F))
    width = 1e-2 / np.abs(values).max()
    flow, total, peak, late = expm(F * width), np.zeros((n, n)), np.zeros((n, n)), np.zeros((n, n))
    power, start, time = expm(F * width / 2), 0.4, width / 2
    while time < 16 / -values.real.max():
        total, peak = total + np.abs(power) * width, np.maximum(peak, np.abs(power))
        late = np.maximum(late, np.abs(power)) if time >= start else late
        power, time = flow @ power, time + width
    largest = total.max()
    found = impulse_norm(values, vectors)
    assert (found >= total - 1e-6 * largest).all()
    assert (found <= 1.05 * total + 0.02 * largest).all()
    high = peak_norm(values, vectors)
    assert (high >= peak - 1e-9).all()
    assert (high <= 1.05 * peak + 0.05 * peak.max()).all()
    assert (peak_norm(values, vectors, start=start) >= late - 1e-9).all()


def test_sums_and_peaks_of_powers_bound_those_of_the_definition() -> None:
    rng = np.random.default_rng(1)
    for _ in range(10):
        M = rng.normal(size=(3, 3))
        M = 0.9 * M / np.abs(np.linalg.eigvals(M)).max()
        values, vectors = (part.astype(complex) for part in np.linalg.eig(M))
        powers = np.array([np.linalg.matrix_power(M, k) for k in range(400)])
        total = np.abs(powers).sum(axis=0)
        np.testing.assert_allclose(impulse_norm(values, vectors, step=0.1), total, rtol=1e-3, atol=1e-4 * total.max())
        assert (impulse_norm(values, vectors, step=0.1) >= total * (1 - 1e-9)).all()
        late = np.abs(powers[7:]).max(axis=0)
        assert (peak_norm(values, vectors, start=0.7, step=0.1) >= late * (1 - 1e-9)).all()


def worst_signs(F: np.ndarray, push: np.ndarray, state: int, cells: int, width: float) -> np.ndarray:
    """Bang-bang: signs (cells, r) of the disturbance that drive one state as far as possible at the end of the stay."""
    row, back, signs = np.eye(len(F))[state], expm(F * width), []
    for _ in range(cells):
        signs.append(np.sign(row @ push))
        row = row @ back
    return np.array(signs[::-1])


@FEW
@given(SEEDS)
def test_no_simulated_error_leaves_the_bound_under_disturbance_and_noise(seed: int) -> None:
    """Bang-bang and random disturbances, random stays of at least D, from zero error; Theorem 6."""
    rng = np.random.default_rng(seed)
    system = random_system(rng)
    p = len(system.output_names)
    system = replace(system, bounds=Bounds(disturbance=np.array([0.7]), measurement=np.full(p, 0.05)))
    gains = designed(system, 1.0)
    certificate = certify_dwell(system, gains)
    bound = ultimate_bound(system, gains)
    assert bound.by_state is not None
    n, cells, largest = len(system.state_names), 60, np.zeros(len(system.state_names))
    push = {name: np.hstack([-0.7 * dynamics(system, name).E, 0.05 * gains.gains[name]]) for name in gains.locations}
    for state in range(n):
        error, name = np.zeros(n), gains.locations[0]
        for visit in range(12):
            stay = certificate.dwell * (1.0 if rng.random() < 0.5 else 1 + rng.exponential())
            F = gains.closed_loop[name]
            signs = worst_signs(F, push[name], state, cells, stay / cells)
            if visit % 4 == 3:
                signs = np.sign(rng.normal(size=signs.shape))
            flow, integral = flow_and_integral(F, push[name], stay / cells)
            for sign in signs:
                error = flow @ error + integral @ sign
                largest = np.maximum(largest, np.abs(error))
            exit = system.transitions[rng.choice([k for k, t in enumerate(system.transitions) if t.source == name])]
            assert exit.reset is not None
            error, name = exit.reset.matrix @ error, exit.target
    assert (largest <= bound.by_state * (1 + 1e-9)).all()
    assert bound.value is not None
    assert np.linalg.norm(largest) <= bound.value * np.sqrt(n)


@dataclass(frozen=True)
class Run:
    """A plant's run on a grid of time: location, state and input per cell, and where it switches."""

    cells: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]]  # location, x, u, w at the beginning of the cell
    width: float
    largest: np.ndarray


def plant_run(rng: np.random.Generator, system: HybridSystem, stay_cells: int, width: float) -> Run:
    name, x = system.locations[0].name, np.zeros(len(system.state_names))
    cells, largest = [], np.zeros(len(x))
    for _ in range(10):
        d = dynamics(system, name)
        flow, integral = flow_and_integral(d.A, np.hstack([d.B, d.E, d.f[:, None]]), width)
        for _ in range(stay_cells + int(rng.integers(0, 10))):
            u, w = np.sign(rng.normal(size=1)), 0.2 * np.sign(rng.normal(size=1))
            cells.append((name, x, u, w))
            largest = np.maximum(largest, np.abs(x))
            x = flow @ x + integral @ np.concatenate([u, w, [1.0]])
        largest = np.maximum(largest, np.abs(x))
        arcs = [t for t in system.transitions if t.source == name]
        exit = arcs[rng.integers(len(arcs))]
        assert exit.reset is not None
        x, name = exit.reset.matrix @ x + exit.reset.offset, exit.target
    return Run(cells, width, largest)


def observer_errors(system: HybridSystem, gains: ObserverGains, run: Run, late: int) -> np.ndarray:
    """The largest error of an observer that learns of every switch `late` cells after it, from zero error."""
    followed, estimate, largest = run.cells[0][0], run.cells[0][1], np.zeros(len(run.largest))
    n = len(estimate)
    resets = {(t.source, t.target): t.reset for t in system.transitions}
    for k, (name, x, u, w) in enumerate(run.cells):
        known = run.cells[max(k - late, 0)][0]
        if known != followed:
            reset = resets[followed, known]
            assert reset is not None
            estimate, followed = reset.matrix @ estimate + reset.offset, known
        largest = np.maximum(largest, np.abs(estimate - x))
        i, j, G = dynamics(system, name), dynamics(system, followed), gains.gains[followed]
        joint = np.block([[i.A, np.zeros((n, n))], [G @ i.C, j.A - G @ j.C]])
        constant = np.concatenate([i.B @ u + i.E @ w + i.f, j.B @ u + j.f + G @ (i.g - j.g)])
        flow, integral = flow_and_integral(joint, constant[:, None], run.width)
        estimate = (flow @ np.concatenate([x, estimate]) + integral[:, 0])[n:]
    return largest


@FEW
@given(SEEDS)
def test_no_simulated_error_leaves_the_bound_when_switches_are_detected_late(seed: int) -> None:
    """Plant and observer side by side; the state bound is what the plant reached, a little more; Theorem 7."""
    rng = np.random.default_rng(seed)
    system = random_system(rng, stable=True)
    gains = designed(system, 0.5)
    late, width = int(rng.integers(1, 6)), 0.02
    needed = certify_dwell(system, gains, delay=late * width).required_dwell
    stay_cells = int(np.ceil(needed / width)) + 1
    run = plant_run(rng, system, stay_cells, width)
    limits = Bounds(state=1.02 * run.largest + 1e-3, input=np.ones(1), disturbance=np.array([0.2]))
    bounded = replace(system, bounds=limits)
    bound = ultimate_bound(bounded, gains, dwell=stay_cells * width, delay=late * width)
    assert bound.by_state is not None, bound.reason
    assert (observer_errors(system, gains, run, late) <= bound.by_state).all()


def test_the_bound_needs_what_it_uses_and_says_what_is_missing() -> None:
    system = random_system(np.random.default_rng(3), stable=True)
    gains = designed(system, 0.5)
    assert "disturbance" in ultimate_bound(system, gains).reason
    disturbed = replace(system, bounds=Bounds(disturbance=np.ones(1)))
    assert ultimate_bound(disturbed, gains).value is not None
    late = ultimate_bound(disturbed, gains, dwell=50.0, delay=0.1)
    assert (late.value, late.by_state) == (None, None)
    assert "bound of the state" in late.reason
    placed = replace(disturbed, bounds=Bounds(disturbance=np.ones(1), state=np.ones(len(system.state_names))))
    assert "bound of the input" in ultimate_bound(placed, gains, dwell=50.0, delay=0.1).reason
    assert "(20) does not hold" in ultimate_bound(disturbed, gains, dwell=1e-6).reason


def test_without_disturbance_and_delay_the_bound_is_zero() -> None:
    system = replace(random_system(np.random.default_rng(4)), bounds=Bounds(disturbance=np.zeros(1)))
    assert ultimate_bound(system, designed(system, 1.0)).value == 0.0


def test_the_bound_grows_in_proportion_to_the_disturbance() -> None:
    system = random_system(np.random.default_rng(5))
    gains = designed(system, 1.0)
    small, large = (
        ultimate_bound(replace(system, bounds=Bounds(disturbance=np.array([w]))), gains) for w in (0.1, 1.0)
    )
    assert small.value is not None
    assert large.value == pytest.approx(10 * small.value)


def test_the_bound_is_never_above_equation_31_as_printed() -> None:
    """(31) in plain units, all locations with one W: b = max_i {κ_i c/(1 - e^{-μ D}) + √n ‖e^{F_i t}‖₁} W."""
    compared = 0
    for seed in range(8):
        system = replace(random_system(np.random.default_rng(seed)), bounds=Bounds(disturbance=np.array([0.4])))
        gains = designed(system, 1.0)
        certificate = certify_dwell(system, gains, dwell=3 * certify_dwell(system, gains).required_dwell + 0.1)
        bound = ultimate_bound(system, gains, dwell=certificate.dwell)
        n = len(system.state_names)
        W = max(0.4 * np.abs(dynamics(system, name).E).max() for name in gains.locations)
        kappa, r, norm = {}, {}, {}
        for name in gains.locations:
            T = np.linalg.eig(gains.closed_loop[name])[1]
            kappa[name] = np.linalg.cond(T)
            r[name] = max(np.linalg.norm(t.reset.matrix, 2) for t in system.transitions if t.source == name and t.reset)
            times = np.linspace(0, 20, 4_001)
            modes = np.linalg.eigvals(gains.closed_loop[name])
            step = expm(gains.closed_loop[name] * (times[1] - times[0]))
            power, total = np.eye(n), np.zeros((n, n))
            for _ in times:
                total, power = total + np.abs(power) * (times[1] - times[0]), step @ power
            norm[name] = total.sum(axis=1).max()
            needed = np.log(max(1.0, r[name] * kappa[name])) / (-certificate.rate - modes.real.max())
            if needed > certificate.dwell:
                break
        else:
            c = max(np.sqrt(n) * r[name] * norm[name] for name in norm)
            level = c / (1 - np.exp(-certificate.rate * certificate.dwell))
            printed = max(kappa[name] * level + np.sqrt(n) * norm[name] for name in norm) * W
            assert bound.by_state is not None
            assert bound.by_state.max() <= 1.05 * printed
            compared += 1
    assert compared >= 4
