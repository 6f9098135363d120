"""How large a residual may get in its own location, and how long its transient lasts: bounds for every signal.

The error of a residual generator obeys e(k+1) = F e(k) + G v(k) - d(k), r = H e + J v, with |v| <= V at the samples
and d(k) = ∫ T e^{A(h-s)} E w(s) ds, |w| <= W, where w may vary within a step.  Once the transient is over,

    |r| <= Σ_k ∫ |H F^k T e^{A s} E| ds W + Σ_k |H F^k G| V + |J| V        (entrywise),

the peak gain (L¹ norm) of the sampled transfer; no smaller bound holds for all w and v.  The sums stop when ‖F^m‖ is
small; the rest is bounded by the geometric series, and the integrals by the trapezoidal rule plus its error bound, so
that the result is an upper bound (up to rounding).

Where parameters have tolerances, x' = A x + B u + E w + f + δ with |δ| <= |ΔA| X + |ΔB| U + |Δf| + |ΔE| W: one more
disturbance, that enters every state, and in the same way a part of the measurement error (`unmodelled`).

In: a `ResidualGenerator` and `Bounds`.  Out: numbers per row of the residual.  Cost: O(m (p + k) k columns)
with m about 7 time constants over the step.  Source: Desoer and Vidyasagar, Feedback Systems, section 6.4 (peak gain).
"""

import numpy as np

from deshybrid.detector.residual import ResidualGenerator
from deshybrid.linear.arrays import FloatArray
from deshybrid.model.system import HybridSystem, Location

FLOOR = 1e-4  # share of a channel's full scale
PANELS = 8
ENOUGH = 1e-3
MOST_STEPS = 100_000


def absolute_sum(F: FloatArray, C: FloatArray, X: FloatArray) -> FloatArray:
    """Return an upper bound of Σ_k |C F^k X|, entrywise over k = 0, 1, ...; shapes (k, k), (p, k), (k, c) to (p, c).

    Infinite where ‖F^m‖ does not fall below 1/1000 within 100,000 steps.

    >>> float(absolute_sum(np.array([[0.5]]), np.eye(1), np.eye(1))[0, 0])
    2.0
    """
    total = np.zeros((C.shape[0], X.shape[1]))
    inner = np.zeros_like(X, dtype=np.float64)
    power = np.eye(F.shape[0])
    for _ in range(MOST_STEPS):
        moved = power @ X
        total += np.abs(C @ moved)
        inner += np.abs(moved)
        power = F @ power
        size = float(np.linalg.norm(power, np.inf)) if power.size else 0.0
        if size <= ENOUGH:
            tail = size / (1.0 - size) * np.max(inner, axis=0, initial=0.0)
            return np.asarray(total + np.abs(C).sum(axis=1)[:, None] * tail)
    return np.full_like(total, np.inf)


def steady_bound(system: HybridSystem, generator: ResidualGenerator) -> FloatArray:
    """Return the largest |r| per row (q,) in the own location after the transient; zero without bounds.

    A measurement bound is meant to contain quantisation.  Where the model states no bound on a disturbance or a
    measurement, the ideal case is taken: `DetectionThreshold.reason` says so.
    """
    noise = measurement_bound(system, generator, generator.location)
    bound = (np.abs(generator.J) + absolute_sum(generator.F, generator.H, generator.gain)) @ noise
    if system.bounds.disturbance is not None and system.bounds.disturbance.any():
        bound = bound + _disturbance_sum(system, generator, generator.dynamics.E) @ system.bounds.disturbance
    moved, _ = unmodelled(system, generator.location)
    if moved.any():
        bound = bound + _disturbance_sum(system, generator, np.eye(len(moved))) @ moved
    return np.asarray(bound)


def measurement_bound(system: HybridSystem, generator: ResidualGenerator, plant: Location) -> FloatArray:
    """Return the bound on the error of the generator's channels while the plant is there, (p,); 0 where not stated."""
    index, stated = list(generator.location.output_index), system.bounds.measurement
    error = np.zeros(len(system.output_names)) if stated is None else stated.copy()
    error[list(plant.output_index)] += unmodelled(system, plant)[1]
    return np.asarray(error[index])


def unmodelled(system: HybridSystem, plant: Location) -> tuple[FloatArray, FloatArray]:
    """Return what wrong parameters add to x' (or to the next x) and to y at most while the plant is there: (n,), (p,).

    Zero where no tolerance is stated.
    """
    wrong, bounds = plant.deviation, system.bounds
    if wrong is None or bounds.state is None:
        return np.zeros(len(system.state_names)), np.zeros(len(plant.output_index))
    u = np.zeros(0) if bounds.input is None else bounds.input[list(plant.input_index)]
    w = np.zeros(wrong.E.shape[1]) if bounds.disturbance is None else bounds.disturbance
    moved = wrong.A @ bounds.state + wrong.B @ u + wrong.E @ w + wrong.f
    return np.asarray(moved), np.asarray(wrong.C @ bounds.state + wrong.D @ u + wrong.g)


def floor(system: HybridSystem, generator: ResidualGenerator) -> FloatArray:
    """Return the least threshold per row of the residual, (q,): 1/10,000 of the full scale of its channel.

    It stands for rounding, and for inputs that are not quite constant between samples; without it a noise-free residual
    would never be small enough.
    """
    return FLOOR * full_scale(system, generator)


def full_scale(system: HybridSystem, generator: ResidualGenerator) -> FloatArray:
    """Return the largest |y| of each row's channel that the bounds on the state allow, (q,); 1 where not known."""
    dynamics, bounds = generator.dynamics, system.bounds
    scale = np.zeros(dynamics.C.shape[0])
    if bounds.state is not None:
        scale = np.abs(dynamics.C) @ bounds.state + np.abs(dynamics.g)
    return np.where(scale > 0.0, scale, 1.0)[list(generator.channels)]


def _disturbance_sum(system: HybridSystem, generator: ResidualGenerator, E: FloatArray) -> FloatArray:
    """Return Σ_k ∫ |H F^k T e^{A s} E| ds over a step, shape (q, r); in discrete time Σ_k |H F^k T E|."""
    A, T, step = generator.dynamics.A, generator.T, generator.step
    if system.time_step is not None:
        return absolute_sum(generator.F, generator.H, T @ E)
    from scipy.linalg import expm

    panel = step / PANELS
    flow, nodes = expm(A * panel), [E]
    for _ in range(PANELS):
        nodes.append(flow @ nodes[-1])
    weights = [panel / 2 if i in (0, PANELS) else panel for i in range(PANELS + 1)]
    columns = np.hstack([T @ node * weight for weight, node in zip(weights, nodes, strict=True)])
    sums = absolute_sum(generator.F, generator.H, np.hstack([columns, np.eye(len(generator.F))]))
    trapezoid = sums[:, : columns.shape[1]].reshape(len(sums), PANELS + 1, E.shape[1]).sum(axis=1)
    curvature = np.abs(T) @ expm(np.abs(A) * step) @ np.abs(A) @ np.abs(A) @ np.abs(E)
    return np.asarray(trapezoid + sums[:, columns.shape[1] :] @ curvature * (PANELS * panel**3 / 12))


def largest_state(system: HybridSystem, generator: ResidualGenerator) -> FloatArray | None:
    """Return a bound on |z| (k,) while the plant is anywhere within the stated bounds; None where these are missing."""
    bounds = system.bounds
    if bounds.state is None or (system.input_names and bounds.input is None):
        return None
    u = np.zeros(0) if bounds.input is None else bounds.input
    y = _largest_output(system, bounds.state, u)
    own_u, own_y = u[list(generator.location.input_index)], y[list(generator.location.output_index)]
    columns = np.hstack([generator.input, generator.gain, generator.offset[:, None]])
    driven = absolute_sum(generator.F, np.eye(len(generator.F)), columns) @ np.concatenate([own_u, own_y, [1.0]])
    first = np.abs(generator.start) @ own_y + np.abs(generator.start_offset)
    return np.asarray(driven + _largest_powers(generator.F) @ first)


def tolerance_lines(system: HybridSystem) -> list[str]:
    """Return what a design says of the tolerances of parameters, in a line; none where none are stated.

    >>> from deshybrid.model.load import load
    >>> tolerance_lines(load("models/two_tank.yaml"))
    []
    """
    shares = ", ".join(f"{name} {100 * share:g} %" for name, share in system.tolerance.items())
    text = (
        f"  thresholds and proven delays allow for parameters that are wrong by {shares}; gains and bounds of x do not"
    )
    return [text] if shares else []


def _largest_output(system: HybridSystem, x: FloatArray, u: FloatArray) -> FloatArray:
    """Return a bound on |y| over all locations, (p,) of the system; a channel that a location lacks is taken as 0."""
    y = np.zeros(len(system.output_names))
    for location in system.locations:
        own, dynamics = list(location.output_index), location.dynamics
        if dynamics is not None:
            here = np.abs(dynamics.C) @ x + np.abs(dynamics.D) @ u[list(location.input_index)] + np.abs(dynamics.g)
            y[own] = np.maximum(y[own], here + unmodelled(system, location)[1])
    return y if system.bounds.measurement is None else y + system.bounds.measurement


def _largest_powers(F: FloatArray) -> FloatArray:
    """Return an entrywise bound on |F^k| over all k."""
    largest = power = np.eye(len(F))
    for _ in range(MOST_STEPS):
        power = F @ power
        largest = np.maximum(largest, np.abs(power))
        if np.linalg.norm(power, np.inf) <= ENOUGH:
            return np.asarray(np.maximum(largest, ENOUGH * largest.max()))
    return np.full_like(F, np.inf)


def settling_ticks(generator: ResidualGenerator, mismatch: FloatArray, margin: FloatArray) -> int | None:
    """Return the number of samples after which |H F^k e| <= margin for ever, for every |e| <= mismatch; None if never.

    The error is that at the first sample in the location; a residual that is late settles as much later.

    Shapes: mismatch (k,), margin (q,).
    """
    if not np.isfinite(mismatch).all() or (margin <= 0.0).any():
        return None
    F, H = generator.F, generator.H
    power, last, quiet, block = np.eye(len(F)), -1, 0, 0
    for tick in range(MOST_STEPS):
        if (np.abs(H @ power) @ mismatch > margin).any():
            last = tick
        inside = (np.abs(H).sum(axis=1) * np.max(np.abs(power) @ mismatch, initial=0.0) <= margin).all()
        quiet = quiet + 1 if inside else 0
        if not block and np.linalg.norm(power, np.inf) <= 0.5:
            block = tick
        if block and quiet >= block:  # from here on every block of samples repeats this one, at most half as large
            return last + 1 + generator.lag
        power = F @ power
    return None


__all__ = [
    "absolute_sum",
    "floor",
    "full_scale",
    "largest_state",
    "measurement_bound",
    "settling_ticks",
    "steady_bound",
    "tolerance_lines",
    "unmodelled",
]
