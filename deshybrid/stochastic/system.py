"""A stochastic linear hybrid system: modes with Gaussian noise, a Markov chain over them, and a prior.

In: matrices, by their names of the field (F H Q R, B and D for inputs, f and g for offsets).  Out: frozen values, their
shapes checked, and the `Bank` that holds all modes as stacked arrays, which is what the filters compute with.

In `stochastic/` a location is called a mode.  A step leads from row k-1 to row k; in the multiple-model filters the
mode of row k governs both that step and the measurement at its end.
Source: Hwang, Balakrishnan and Tomlin (2006), equations (1) and (2).
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from deshybrid.diagnostics import UsageError, diagnostic
from deshybrid.linear.arrays import FloatArray, frozen_array
from deshybrid.model.system import NoiseForm

_ROUNDING = 1e-9


def _checked(values: ArrayLike, shape: tuple[int, ...], name: str) -> FloatArray:
    try:
        return frozen_array(values, shape)
    except (ValueError, TypeError) as error:
        raise UsageError(diagnostic("DH1104", f"{name} does not fit: {error}")) from None


def _size(values: ArrayLike, axis: int) -> int:
    """The size along an axis, 1 where there is none; what is no array is refused by the check of its shape."""
    try:
        shape = np.shape(values)
    except ValueError:  # rows of different lengths
        return 1
    return shape[axis] if axis < len(shape) else 1


def checked_covariance(values: ArrayLike, size: int, name: str) -> FloatArray:
    """Return a symmetric positive semidefinite matrix as a read-only copy; raises `UsageError` (DH1104).

    >>> checked_covariance([[2.0]], 1, "`Q`").tolist()
    [[2.0]]
    """
    array = _checked(values, (size, size), name)
    scale = float(np.abs(array).max(initial=0.0)) or 1.0
    symmetric = bool(np.abs(array - array.T).max(initial=0.0) <= _ROUNDING * scale)
    if not symmetric or (size and np.linalg.eigvalsh(array)[0] < -_ROUNDING * scale * size):
        raise UsageError(diagnostic("DH1104", f"{name} is no covariance: not symmetric positive semidefinite"))
    return array


def _checked_form(noise: NoiseForm, shape: tuple[int, int], of: str) -> NoiseForm:
    p, n = shape
    process, measurement = noise.process_by_state, noise.measurement_by_state
    if not 0.0 <= noise.share <= 1.0 or not 1.0 <= noise.factor < np.inf:
        text = f"the tails {of} have a share of {noise.share:g} and a factor of {noise.factor:g}"
        raise UsageError(diagnostic("DH1104", text, helps=("a share lies between 0 and 1, a factor is at least 1",)))
    return NoiseForm(
        None if process is None else _checked(process, (n, n), f"`process_by_state` {of}"),
        None if measurement is None else _checked(measurement, (p, n), f"`measurement_by_state` {of}"),
        noise.share,
        noise.factor,
    )


@dataclass(frozen=True, slots=True, eq=False, init=False)
class Mode:
    """x(k) = F x(k-1) + B u + f + w, z = H x + D u + g + v, with covariances Q of w and R of v.

    Shapes: F, Q (n, n), H (p, n), R (p, p), B (n, m), D (p, m), f (n,), g (p,); without B there is no input.
    `output_index`: the places of the p outputs among those of the whole system, by default the first p.
    `noise`: in what w and v are more than white with these covariances (`deshybrid.stochastic.noise`).
    Raises `UsageError` (DH1104) where a shape does not fit or a covariance is none.

    >>> Mode("still", F=[[1.0]], H=[[1.0]], Q=[[0.0]], R=[[1.0]]).B.shape
    (1, 0)
    """

    name: str
    F: FloatArray
    H: FloatArray
    Q: FloatArray
    R: FloatArray
    B: FloatArray
    D: FloatArray
    f: FloatArray
    g: FloatArray
    output_index: tuple[int, ...]
    noise: NoiseForm

    def __init__(
        self,
        name: str,
        *,
        F: ArrayLike,
        H: ArrayLike,
        Q: ArrayLike,
        R: ArrayLike,
        B: ArrayLike | None = None,
        D: ArrayLike | None = None,
        f: ArrayLike | None = None,
        g: ArrayLike | None = None,
        output_index: Sequence[int] | None = None,
        noise: NoiseForm | None = None,
    ) -> None:
        n, p = _size(F, 0), _size(H, 0)
        given = D if B is None else B
        m = 0 if given is None else _size(given, 1)
        of = f"of mode `{name}`"
        values = {
            "name": name,
            "F": _checked(F, (n, n), f"`F` {of}"),
            "H": _checked(H, (p, n), f"`H` {of}"),
            "Q": checked_covariance(Q, n, f"`Q` {of}"),
            "R": checked_covariance(R, p, f"`R` {of}"),
            "B": _checked(np.zeros((n, m)) if B is None else B, (n, m), f"`B` {of}"),
            "D": _checked(np.zeros((p, m)) if D is None else D, (p, m), f"`D` {of}"),
            "f": _checked(np.zeros(n) if f is None else f, (n,), f"`f` {of}"),
            "g": _checked(np.zeros(p) if g is None else g, (p,), f"`g` {of}"),
            "output_index": tuple(range(p)) if output_index is None else tuple(output_index),
        }
        if len(values["output_index"]) != p or len(set(values["output_index"])) != p:
            raise UsageError(diagnostic("DH1104", f"`output_index` {of} does not place {p} different outputs"))
        for key, value in values.items():
            object.__setattr__(self, key, value)
        object.__setattr__(self, "noise", NoiseForm() if noise is None else _checked_form(noise, (p, n), of))


@dataclass(frozen=True, slots=True, eq=False, init=False)
class ModeTransition:
    """Markov chain over modes: µ(k) = probability_to_from @ µ(k-1); columns sum to one.

    Raises `UsageError` (DH1102), with a hint about transposition where the rows sum to one and the columns do not.  A
    matrix whose rows and columns both sum to one cannot be told from its transpose: `from_rows` names the other order.
    Source: Hwang et al. (2006), equation (2).

    >>> ModeTransition(("a", "b"), [[0.9, 0.2], [0.1, 0.8]]).probability_to_from[1, 0]
    np.float64(0.1)
    """

    modes: tuple[str, ...]
    probability_to_from: FloatArray  # (M, M)

    def __init__(self, modes: Sequence[str], probability_to_from: ArrayLike) -> None:
        names = tuple(modes)
        matrix = _checked(probability_to_from, (len(names), len(names)), "`probability_to_from`")
        if matrix.min(initial=0.0) < 0.0:
            raise UsageError(diagnostic("DH1102", "`probability_to_from` holds a negative number"))
        sums = matrix.sum(axis=0)
        wrong = np.flatnonzero(np.abs(sums - 1.0) > _ROUNDING)
        if wrong.size:
            rows_fit = bool((np.abs(matrix.sum(axis=1) - 1.0) <= _ROUNDING).all())
            text = f"the column of mode `{names[wrong[0]]}` sums to {sums[wrong[0]]:.12g}, not to 1"
            hint = "the rows sum to 1: transpose the matrix, or call `ModeTransition.from_rows`"
            usual = "probability_to_from[j, i] is the probability of mode j after mode i"
            raise UsageError(diagnostic("DH1102", text, helps=(hint if rows_fit else usual,)))
        object.__setattr__(self, "modes", names)
        object.__setattr__(self, "probability_to_from", matrix)

    @classmethod
    def from_rows(cls, modes: Sequence[str], probability_from_to: ArrayLike) -> "ModeTransition":
        """Return the chain of a matrix whose rows sum to one: [i, j] is the probability of mode j after mode i.

        >>> ModeTransition.from_rows(("a", "b"), [[0.9, 0.1], [0.2, 0.8]]).probability_to_from[1, 0]
        np.float64(0.1)
        """
        return cls(modes, np.asarray(probability_from_to, dtype=np.float64).T)


@dataclass(frozen=True, slots=True, eq=False)
class Bank:
    """All modes as stacked arrays over all p outputs of the system; M modes.

    F, Q (M, n, n), H (M, p, n), R (M, p, p), B (M, n, m), D (M, p, m), f (M, n), g (M, p); `measured` (M, p) is true
    where a mode measures an output, and where it does not the rows of H are zero.  Of the noise's form, each None where
    no mode has it: `process_by_state` (M, n, n), `measurement_by_state` (M, p, n), share and factor of `tails` (M, 2).
    `whole`: whether every mode measures every output.
    """

    F: FloatArray
    H: FloatArray
    Q: FloatArray
    R: FloatArray
    B: FloatArray
    D: FloatArray
    f: FloatArray
    g: FloatArray
    measured: np.ndarray[tuple[int, ...], np.dtype[np.bool_]]
    whole: bool
    process_by_state: FloatArray | None = None
    measurement_by_state: FloatArray | None = None
    tails: FloatArray | None = None


@dataclass(frozen=True, eq=False, init=False)
class StochasticSystem:
    """Modes, their Markov chain, and the prior x (n,), P (n, n), mu (M,) one step before the first measurement.

    Raises `UsageError` (DH1104) where the parts do not fit together.

    >>> calm = Mode("calm", F=[[1.0]], H=[[1.0]], Q=[[0.1]], R=[[1.0]])
    >>> wild = Mode("wild", F=[[1.0]], H=[[1.0]], Q=[[9.0]], R=[[1.0]])
    >>> chain = ModeTransition(("calm", "wild"), [[0.9, 0.2], [0.1, 0.8]])
    >>> StochasticSystem((calm, wild), chain, x=[0.0], P=[[1.0]], mu=[0.5, 0.5]).bank.F.shape
    (2, 1, 1)
    """

    modes: tuple[Mode, ...]
    chain: ModeTransition
    x: FloatArray
    P: FloatArray
    mu: FloatArray

    def __init__(
        self, modes: Sequence[Mode], chain: ModeTransition, *, x: ArrayLike, P: ArrayLike, mu: ArrayLike
    ) -> None:
        _check_modes(tuple(modes), chain)
        n = len(modes[0].f)
        prior = _checked(mu, (len(modes),), "the prior's `mu`")
        if prior.min() < 0.0 or abs(prior.sum() - 1.0) > _ROUNDING:
            text = f"the prior's `mu` sums to {prior.sum():.12g} with a smallest entry of {prior.min():g}"
            raise UsageError(diagnostic("DH1102", text, helps=("probabilities are not negative and sum to 1",)))
        object.__setattr__(self, "modes", tuple(modes))
        object.__setattr__(self, "chain", chain)
        object.__setattr__(self, "x", _checked(x, (n,), "the prior's `x`"))
        object.__setattr__(self, "P", checked_covariance(P, n, "the prior's `P`"))
        object.__setattr__(self, "mu", prior)

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the modes."""
        return self.chain.modes

    @cached_property
    def log_probability_to_from(self) -> FloatArray:
        """Logarithm of the chain's matrix (M, M), -inf for 0."""
        with np.errstate(divide="ignore"):
            logarithm: FloatArray = np.log(self.chain.probability_to_from)
        logarithm.flags.writeable = False
        return logarithm

    @cached_property
    def bank(self) -> Bank:
        """The modes as stacked arrays."""
        outputs = 1 + max((place for mode in self.modes for place in mode.output_index), default=-1)
        padded = [_padded(mode, outputs) for mode in self.modes]
        H, R, D, g, measured = (np.stack(parts) for parts in zip(*padded, strict=True))
        F, Q, B, f = (np.stack([getattr(mode, key) for mode in self.modes]) for key in "FQBf")
        for array in (F, H, Q, R, B, D, f, g, measured):
            array.flags.writeable = False
        return Bank(F, H, Q, R, B, D, f, g, measured, bool(measured.all()), *_forms(self.modes, outputs))

    @cached_property
    def comparable_bank(self) -> Bank:
        """`bank`, where all modes measure the same outputs; else raises `UsageError` (DH1103)."""
        differing = np.flatnonzero((self.bank.measured != self.bank.measured[0]).any(axis=1))
        if differing.size:
            text = f"modes `{self.names[0]}` and `{self.names[differing[0]]}` measure different outputs"
            note = "densities over different outputs have different units, so that none is the larger"
            helps = ("measure the same outputs in every mode, or use `skf`, where the mode is known",)
            raise UsageError(diagnostic("DH1103", text, notes=(note,), helps=helps))
        return self.bank


def _check_modes(modes: tuple[Mode, ...], chain: ModeTransition) -> None:
    names = tuple(mode.name for mode in modes)
    if not names or names != chain.modes:
        raise UsageError(diagnostic("DH1104", f"the chain is over the modes {chain.modes}, the system has {names}"))
    first = modes[0]
    for mode in modes:
        if mode.B.shape != first.B.shape:
            text = f"mode `{mode.name}` has {mode.B.shape[0]} states and {mode.B.shape[1]} inputs"
            notes = (f"mode `{first.name}` has {first.B.shape[0]} and {first.B.shape[1]}",)
            raise UsageError(diagnostic("DH1104", text, notes=notes))


def _padded(mode: Mode, outputs: int) -> tuple[np.ndarray[tuple[int, ...], np.dtype[np.generic]], ...]:
    """H, R, D, g over all outputs, and which of them the mode measures."""
    places = list(mode.output_index)
    H, D, g = np.zeros((outputs, len(mode.f))), np.zeros((outputs, mode.D.shape[1])), np.zeros(outputs)
    R, measured = np.zeros((outputs, outputs)), np.zeros(outputs, dtype=np.bool_)
    H[places], D[places], g[places], measured[places] = mode.H, mode.D, mode.g, True
    R[np.ix_(places, places)] = mode.R
    return H, R, D, g, measured


def _forms(modes: tuple[Mode, ...], outputs: int) -> tuple[FloatArray | None, FloatArray | None, FloatArray | None]:
    """What the noise's form is in each mode, zeros where one has none; None where no mode has any."""
    n, keys = len(modes[0].f), {key for mode in modes for key in mode.noise.keys}
    process, measurement = np.zeros((len(modes), n, n)), np.zeros((len(modes), outputs, n))
    for number, mode in enumerate(modes):
        if mode.noise.process_by_state is not None:
            process[number] = mode.noise.process_by_state
        if mode.noise.measurement_by_state is not None:
            measurement[number, list(mode.output_index)] = mode.noise.measurement_by_state
    tails = np.array([[mode.noise.share, mode.noise.factor] for mode in modes])
    for array in (process, measurement, tails):
        array.flags.writeable = False
    return (
        process if "process_by_state" in keys else None,
        measurement if "measurement_by_state" in keys else None,
        tails if "tails" in keys else None,
    )


__all__ = ["Bank", "Mode", "ModeTransition", "StochasticSystem", "checked_covariance"]
