"""Can the inputs and outputs of a window tell which of two locations is active?

In: the dynamics p and q of two locations.  Out: "always", "generic" or "never", with the size of the set on which they
agree.  The idea: run both models on one input; they agree exactly while the joint system, state (x, ξ, 1), shows
y_p - y_q = C_p x - C_q ξ + (D_p - D_q) u + g_p - g_q = 0.  So the question is about the output-nulling states of the
joint system; the last component, constant 1, carries the offsets f and g.  Disturbances are left out.  O(n^4).

With V the pairs (x, ξ) for which *some* input gives equal outputs on a window (an affine set, dimension -1 if empty):
- always: dim V <= 0, that is rank [O_p -O_q T_p - T_q] - rank [T_p - T_q] = n_p + n_q, with O the observability
  matrices and T the block Toeplitz matrices of Markov parameters over enough rows; without inputs and offsets this is
  rank [O_p O_q] = 2n.  At most one pair agrees: without offsets x = ξ = 0 (standstill, which shows nothing).
- never: every state x of p has a partner ξ in q with the same outputs under *every* input, that is T_p = T_q and every
  O_p x + o_p - o_q lies in the range of O_q (o: the response of the offsets).  A self-loop is such a case.
  This is not symmetric: q may explain all that p does, and do more.
- generic: all else; the states and inputs with equal outputs form a proper subspace of all (x, u).

Source: Balluchi et al. (2012), section 4; Vidal et al. (2003), joint observability of linear hybrid systems.
"""

from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np

from deshybrid.linear.arrays import FloatArray
from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.linear.subspaces import RANK_TOLERANCE, ScaledSystem, output_nulling, scaled_system

Verdict: TypeAlias = Literal["always", "generic", "never"]


@dataclass(frozen=True, slots=True)
class Distinguishability:
    """Whether two locations can be told apart from inputs and outputs.

    `rank`: independent conditions that equal outputs put on the n_p + n_q components of (x, ξ), with the input free;
    `equal_dimension`: the dimension of the set of pairs that can agree, -1 where no pair can; `reason`: one sentence.
    """

    verdict: Verdict
    rank: int
    equal_dimension: int
    reason: str


def distinguish(
    first: LinearDynamics,
    second: LinearDynamics,
    *,
    discrete: bool = False,
    inputs: tuple[tuple[int, ...], tuple[int, ...]] | None = None,
    outputs: tuple[tuple[int, ...], tuple[int, ...]] | None = None,
) -> Distinguishability:
    """Return whether a plant in `first` can be told from one in `second`; see the module's text for the three verdicts.

    Parameters
    ----------
    first, second : LinearDynamics
        States may differ in number.  E is ignored.
    discrete : bool
        True where x(k+1) = A x + ...: an offset f then adds up over steps.
    inputs, outputs : pairs of index tuples, optional
        `input_index` and `output_index` of the two locations; without them channels correspond by position, which
        needs equal numbers (ValueError else).  Only output channels that *both* measure are compared: a number in a
        column that a location does not define tells nothing about it.  An input that a location lacks does not act.

    >>> z = np.zeros
    >>> def scalar(a):
    ...     return LinearDynamics(np.array([[a]]), z((1, 0)), np.ones((1, 1)), z((1, 0)), z((1, 0)), z(1), z(1))
    >>> distinguish(scalar(-1.0), scalar(-2.0)).verdict, distinguish(scalar(-1.0), scalar(-1.0)).verdict
    ('always', 'never')
    """
    first, second = on_common_channels(first, second, inputs, outputs)
    joint = _joint_system(first, second, discrete=discrete)
    size = first.A.shape[0] + second.A.shape[0]
    agreeing = output_nulling(joint)
    possible = _shows_constant(agreeing)
    dimension = agreeing.shape[1] - 1 if possible else -1
    rank = size - max(dimension, 0)
    if dimension < 0:
        return Distinguishability("always", rank, -1, "the offsets differ, so no states give equal outputs")
    if _never(joint, first.A.shape[0]):
        reason = "every state of the first location has a partner in the second with equal outputs for every input"
        return Distinguishability("never", rank, dimension, reason)
    if dimension == 0:
        reason = "outputs are equal for one pair of states only (without offsets x = 0 in both)"
        return Distinguishability("always", rank, 0, reason)
    reason = f"pairs of states with equal outputs form a set of dimension {dimension} of {size}, for suitable inputs"
    return Distinguishability("generic", rank, dimension, reason)


def on_common_channels(
    first: LinearDynamics,
    second: LinearDynamics,
    inputs: tuple[tuple[int, ...], tuple[int, ...]] | None,
    outputs: tuple[tuple[int, ...], tuple[int, ...]] | None,
) -> tuple[LinearDynamics, LinearDynamics]:
    """Give both locations the same input columns (zero where one lacks an input) and the output rows of both."""
    inputs = inputs or (tuple(range(first.B.shape[1])), tuple(range(second.B.shape[1])))
    outputs = outputs or (tuple(range(first.C.shape[0])), tuple(range(second.C.shape[0])))
    for names, pair in (("inputs", inputs), ("outputs", outputs)):
        counts = tuple(d.B.shape[1] if names == "inputs" else d.C.shape[0] for d in (first, second))
        if tuple(len(index) for index in pair) != counts:
            raise ValueError(f"{counts} {names} of the two locations do not fit the channels {pair}")
    columns = tuple(dict.fromkeys(inputs[0] + inputs[1]))
    rows = tuple(channel for channel in outputs[0] if channel in outputs[1])
    return _arranged(first, inputs[0], outputs[0], columns, rows), _arranged(
        second, inputs[1], outputs[1], columns, rows
    )


def _arranged(
    dynamics: LinearDynamics,
    inputs: tuple[int, ...],
    outputs: tuple[int, ...],
    columns: tuple[int, ...],
    rows: tuple[int, ...],
) -> LinearDynamics:
    place = [outputs.index(channel) for channel in rows]
    B, D = np.zeros((dynamics.A.shape[0], len(columns))), np.zeros((len(rows), len(columns)))
    for source, channel in enumerate(inputs):
        B[:, columns.index(channel)] = dynamics.B[:, source]
        D[:, columns.index(channel)] = dynamics.D[place, source]
    return LinearDynamics(dynamics.A, B, dynamics.C[place], D, dynamics.E, dynamics.f, dynamics.g[place])


def _joint_system(first: LinearDynamics, second: LinearDynamics, *, discrete: bool) -> ScaledSystem:
    """State (x, ξ, c): c is the constant, in units of the largest offset, so that offsets weigh like matrix entries."""
    n, k = first.A.shape[0], second.A.shape[0]
    g = _difference(first.g, second.g)
    unit = float(np.max(np.abs(np.concatenate([first.f, second.f, g])), initial=0.0)) or 1.0
    A = np.zeros((n + k + 1, n + k + 1))
    A[:n, :n], A[n : n + k, n : n + k] = first.A, second.A
    A[:n, -1], A[n : n + k, -1], A[-1, -1] = first.f / unit, second.f / unit, float(discrete)
    B = np.vstack([first.B, second.B, np.zeros((1, first.B.shape[1]))])
    C = np.hstack([first.C, -second.C, (g / unit)[:, None]])
    return scaled_system(A, B, C, _difference(first.D, second.D))


def _difference(first: FloatArray, second: FloatArray) -> FloatArray:
    """Return first - second, with zero where they differ by rounding only (scaling must not blow that up)."""
    rounding = np.abs(first - second) <= RANK_TOLERANCE * np.maximum(np.abs(first), np.abs(second))
    return np.where(rounding, 0.0, first - second)


def _shows_constant(basis: FloatArray) -> bool:
    """True where the subspace holds a vector with c = 1, so that it contains actual pairs of states."""
    return bool(np.linalg.norm(basis[-1]) > np.sqrt(RANK_TOLERANCE)) if basis.shape[1] else False


def _never(joint: ScaledSystem, n: int) -> bool:
    """T_p = T_q (inputs excite only what the difference never shows), and every x has a partner."""
    size, m, p = joint.A.shape[0], joint.B.shape[1], joint.C.shape[0]
    silent = output_nulling(joint._replace(B=np.zeros((size, 0)), D=np.zeros((p, 0))))
    hidden_inputs = np.linalg.norm(joint.B - silent @ (silent.T @ joint.B), axis=0) if m else np.zeros(0)
    if np.any(hidden_inputs > RANK_TOLERANCE) or np.any(np.abs(joint.D) > RANK_TOLERANCE):
        return False
    kept = [*range(n), size - 1]
    return int(np.linalg.matrix_rank(silent[kept], tol=np.sqrt(RANK_TOLERANCE))) == n + 1


__all__ = ["Distinguishability", "Verdict", "distinguish", "on_common_channels"]
