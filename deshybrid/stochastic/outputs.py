"""The outputs of a window as one Gaussian: what a sequence of modes makes of a state that is known up to a covariance.

In: the mode that governs every step and the mode that measures every row, the mean and covariance Π₀ of the state at
the first row, inputs.  Out: mean and covariance of the stacked outputs.  The covariance is O Π₀ Oᵀ + T Q̄ Tᵀ + R̄ of the
paper's equation (6), for modes that change; it is built row by row from the covariance of the state with what was
measured before, so that neither O nor T is ever formed.  The outputs of a shorter window are its leading block.

O(N² n² p) for N rows.  Source: Hwang, Balakrishnan and Tomlin (2003), equations (2) to (6), (9), (10).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.stochastic.lanes import symmetric
from deshybrid.stochastic.noise import require_fixed_noise
from deshybrid.stochastic.system import Mode


@dataclass(frozen=True, slots=True, eq=False)
class OutputGaussian:
    """Mean (N p,) and covariance (N p, N p) of the outputs of N rows, row after row."""

    rows: int
    mean: FloatArray
    covariance: FloatArray


def output_gaussian(
    measuring: Sequence[Mode],
    moving: Sequence[Mode],
    *,
    x: ArrayLike,
    P: ArrayLike,
    u: FloatArray | None = None,
) -> OutputGaussian:
    """Return the Gaussian of the outputs of N rows.

    `measuring` holds the N modes, with p outputs each, that measure the rows, `moving` the N - 1 modes that lead from a
    row to the next.  `x` (n,) and `P` (n, n) are mean and covariance Π₀ of the state at the first row; `u` (N, m) is
    the input of every row, held until the next, zero where it is not given.

    >>> walk = Mode("walk", F=[[1.0]], H=[[1.0]], Q=[[1.0]], R=[[0.5]])
    >>> output_gaussian([walk] * 2, [walk], x=[3.0], P=[[2.0]]).covariance.tolist()
    [[2.5, 2.0], [2.0, 3.5]]
    """
    require_fixed_noise((*measuring, *moving), "a Gaussian of the outputs")
    rows, (p, n) = len(measuring), measuring[0].H.shape
    state, spread = np.array(x, dtype=np.float64), np.array(P, dtype=np.float64)
    mean, covariance = np.zeros((rows, p)), np.zeros((rows, p, rows, p))
    cross = np.zeros((n, rows, p))  # covariance of the state with every earlier output
    held = np.zeros((rows, measuring[0].B.shape[1])) if u is None else u
    for k, sensor in enumerate(measuring):
        if k:
            step = moving[k - 1]
            state = step.F @ state + step.B @ held[k - 1] + step.f
            spread = symmetric(step.F @ spread @ step.F.T + step.Q)
            cross[:, :k] = np.tensordot(step.F, cross[:, :k], 1)
        mean[k] = sensor.H @ state + sensor.D @ held[k] + sensor.g
        covariance[k, :, :k] = np.tensordot(sensor.H, cross[:, :k], 1)
        covariance[:k, :, k] = covariance[k, :, :k].transpose(1, 2, 0)
        covariance[k, :, k] = sensor.H @ spread @ sensor.H.T + sensor.R
        cross[:, k] = spread @ sensor.H.T
    size = rows * p
    return OutputGaussian(
        rows, frozen_array(mean.ravel(), (size,)), frozen_array(covariance.reshape(size, size), (size, size))
    )


def staying(mode: Mode, rows: int, *, x: ArrayLike, P: ArrayLike, u: FloatArray | None = None) -> OutputGaussian:
    """Return the outputs of `rows` rows in one mode; the arguments are those of `output_gaussian`.

    >>> still = Mode("still", F=[[1.0]], H=[[2.0]], Q=[[0.0]], R=[[1.0]])
    >>> staying(still, 2, x=[0.0], P=[[1.0]]).covariance.tolist()
    [[5.0, 4.0], [4.0, 5.0]]
    """
    return output_gaussian([mode] * rows, [mode] * (rows - 1), x=x, P=P, u=u)


def switching_once(
    source: Mode,
    target: Mode,
    at: int,
    rows: int,
    *,
    x: ArrayLike,
    P: ArrayLike,
    u: FloatArray | None = None,
) -> OutputGaussian:
    """Return the outputs of `rows` rows whose row `at` (from 0) is the first of `target`, and so is the step to it.

    The papers let a mode govern the steps that *leave* its rows; the dynamics of the new mode then show one row later.

    >>> calm = Mode("calm", F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[1.0]])
    >>> wild = Mode("wild", F=[[1.0]], H=[[1.0]], Q=[[9.0]], R=[[1.0]])
    >>> switching_once(calm, wild, 1, 2, x=[0.0], P=[[0.0]]).covariance.diagonal().tolist()
    [1.0, 10.0]
    """
    modes = [source] * at + [target] * (rows - at)
    return output_gaussian(modes, modes[1:], x=x, P=P, u=u)


__all__ = ["OutputGaussian", "output_gaussian", "staying", "switching_once"]
