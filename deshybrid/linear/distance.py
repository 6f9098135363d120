"""How far apart are two locations: what is left of the difference of their outputs when the rival may choose its state?

In: the dynamics p (where the plant is) and q (the rival), a step, a number N of samples, and units of state, input and
output.  Out: a `Distance`.  The idea: with x(0) = x and the input held at u the plant shows O_p x + T_p u + o_p in the
window, and q, from its best state ξ, comes nearest to it by least squares; what is left,

    d(x, u)² = min_ξ |O_p x + T_p u + o_p - O_q ξ - T_q u - o_q|² / (N p),

is the mean square per sample and channel of a residual that no observer of q can avoid, in units of the outputs.  It is
the output energy of the joint system (x, ξ) with the states that q does not measure free: a slow hidden state of q
absorbs much of a mismatch, and d shows how much.  Over all (x, u) of length one in their units, d² is a quadratic form
plus what the offsets add: `worst` is its least value, `typical` its mean.

Cost: one QR of an N p by n matrix and an eigenvalue problem of size n + m.
Source: Varga, Solving Fault Diagnosis Problems (2017), section 2.3, model detection: distances between models; the
free rival state is this project's.
"""

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np

from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.linear.distinguish import on_common_channels
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.linear.sampling import sample_dynamics
from deshybrid.linear.subspaces import RANK_TOLERANCE

Indices: TypeAlias = tuple[tuple[int, ...], tuple[int, ...]]
HALVINGS = 200
LARGEST = 1e60  # of a response in its units; squares of it still have room in doubles


@dataclass(frozen=True, slots=True, eq=False)
class Units:
    """What counts as one: per state (n,), per input of the system (m,), per output of the system (p,)."""

    state: FloatArray
    input: FloatArray
    output: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Distance:
    """Root mean square of what is left per sample and channel, in output units, for (x, u) of length one.

    `worst` is reached at `state` (n + m,), where the rival's best start is `rival` (n_q,); both in their units, the
    rival's as a difference from x where the two have the same number of states.
    """

    worst: float
    typical: float
    state: FloatArray
    rival: FloatArray


def distance(
    first: LinearDynamics,
    second: LinearDynamics,
    *,
    samples: int,
    step: float | None,
    units: Units,
    inputs: Indices,
    outputs: Indices,
) -> Distance:
    """Return how far a plant in `first` is from what `second` can explain, within `samples` samples.

    step: seconds between samples; None where the dynamics are in discrete time.  `inputs` and `outputs`: the places of
    the two locations' channels among the system's; only outputs that both measure are compared.

    >>> z = np.zeros
    >>> def decay(rate):
    ...     return LinearDynamics(np.array([[-rate]]), z((1, 0)), np.ones((1, 1)), z((1, 0)), z((1, 0)), z(1), z(1))
    >>> one = Units(np.ones(1), z(0), np.ones(1))
    >>> channels = {"inputs": ((), ()), "outputs": ((0,), (0,))}
    >>> near, far = (
    ...     distance(decay(1.0), decay(rate), samples=20, step=0.1, units=one, **channels).worst for rate in (1.1, 3.0)
    ... )
    >>> bool(near < far)
    True
    """
    first, second = on_common_channels(first, second, inputs, outputs)
    columns = tuple(dict.fromkeys(inputs[0] + inputs[1]))
    scale = units.output[[channel for channel in outputs[0] if channel in outputs[1]]]
    n, m = len(first.A), len(columns)
    shown, rival = _before_overflow(
        _responses(first, step, samples, scale), _responses(second, step, samples, scale), samples
    )
    own, taken = shown[:, :n] * units.state, rival[:, : len(second.A)]
    taken = taken * units.state if taken.shape[1] == n else taken
    left = np.hstack([own, (shown[:, n:-1] - rival[:, len(second.A) : -1]) * units.input[list(columns)]])
    whole = np.hstack([left, (shown[:, -1] - rival[:, -1])[:, None]])
    best = (
        np.linalg.lstsq(taken, whole, rcond=RANK_TOLERANCE)[0] if taken.size else np.zeros((taken.shape[1], n + m + 1))
    )
    rest = (whole - taken @ best) / np.sqrt(max(len(whole), 1))
    matrix, constant = rest[:, :-1], rest[:, -1]
    state = least_on_sphere(matrix, constant)
    partner = best @ np.append(state, 1.0)
    return Distance(
        worst=float(np.linalg.norm(matrix @ state + constant)),
        typical=float(np.sqrt(np.sum(matrix**2) / (n + m) + constant @ constant)),
        state=frozen_array(state, (n + m,)),
        rival=frozen_array(partner - state[:n] if len(partner) == n else partner, partner.shape),
    )


def _responses(dynamics: LinearDynamics, step: float | None, samples: int, scale: FloatArray) -> FloatArray:
    """Outputs over the window in their units, (N p, n + m + 1): by initial state, by constant input, by the offsets."""
    sampled = dynamics if step is None else sample_dynamics(dynamics, step)
    n, m = sampled.B.shape
    inside = np.zeros((n + m + 1, n + m + 1))
    inside[:n] = np.hstack([sampled.A, sampled.B, sampled.f[:, None]])
    inside[n:, n:] = np.eye(m + 1)
    rows = np.hstack([sampled.C, sampled.D, sampled.g[:, None]]) / scale[:, None]
    found = np.zeros((samples, len(scale), n + m + 1))
    with np.errstate(over="ignore", invalid="ignore"):
        for k in range(samples):
            found[k] = rows
            rows = rows @ inside
    return found.reshape(-1, n + m + 1)


def _before_overflow(first: FloatArray, second: FloatArray, samples: int) -> tuple[FloatArray, FloatArray]:
    """The samples before anything has grown beyond LARGEST, one at least: what is unstable ends the window."""
    within = [(np.abs(rows) <= LARGEST).reshape(samples, -1).all(axis=1) for rows in (first, second)]
    beyond = np.flatnonzero(~(within[0] & within[1]))
    kept = max(1, int(beyond[0])) if len(beyond) else samples
    return first[: kept * (len(first) // samples)], second[: kept * (len(second) // samples)]


def least_on_sphere(matrix: FloatArray, constant: FloatArray) -> FloatArray:
    """Return a vector z of length one that makes |matrix z + constant| least; shapes (r, n), (r,) to (n,).

    At the minimum (S - λ I) z = -matrixᵀ constant with S = matrixᵀ matrix and λ at most its least eigenvalue; the λ
    that gives length one is found by bisection.  Source: Golub and Van Loan, section 6.2 (a secular equation).

    >>> least_on_sphere(np.diag([3.0, 1.0]), np.zeros(2)).round(6).tolist()
    [0.0, 1.0]
    """
    values, basis = np.linalg.eigh(matrix.T @ matrix)
    pull = -(basis.T @ (matrix.T @ constant))
    size = max(float(np.abs(values).max(initial=0.0)), float(np.linalg.norm(pull)), 1e-300)
    lowest = values <= values[0] + 1e-12 * size
    high, low = float(values[0]) - 1e-13 * size, float(values[0]) - 2.0 * float(np.linalg.norm(pull)) - size
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if np.linalg.norm(pull / (values - middle)) <= 1.0 else (low, middle)
    z = pull / (values - low)
    if np.linalg.norm(z) < 1.0 - 1e-9:  # the pull has no part along the lowest: its length is made up there, either way
        z[np.argmax(lowest)] += np.sqrt(max(1.0 - float(z @ z), 0.0))
    found = basis @ z
    first = found[np.argmax(np.abs(found))]
    found = found if np.any(constant) or first > 0 else -found
    return np.asarray(found / np.linalg.norm(found))


__all__ = ["Distance", "Units", "distance", "least_on_sphere"]
