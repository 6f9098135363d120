"""Prove contraction over a box of stays in exact arithmetic, without the code that claims it.

In: the plant of a design and an entry of its certificates with theorem `B03-box` or `B03-box-sampled`: γ, P_i, the
stays of each location and the ends of cells that cover them.  Out: one check per inequality of

    E_ij(τ)ᵀ P_j E_ij(τ) <= γ² P_i  for every reset and every stay τ of the box,  E_ij(τ) = R¹_ij e^{F_i τ}.

The idea, in a cell [a, a + w], X = e^{F a}, ‖·‖ in P: by Taylor's formula with the rest of second order,

    ‖E‖ <= ‖R (X + w/2 F X)‖ + w/2 ‖R F X‖ + ‖R‖ w²/2 ‖F² X‖ e^{β w},   Fᵀ P_i + P_i F <= 2 β P_i.

In sampled time N = (M - I)/h stands for F and powers of M for X; the discrete Taylor formula has the same bound, with
MᵀP_i M <= g² P_i and g^{w/h} for e^{β w}; a cell of one step has its two ends only.  X is enclosed: fixed-point Taylor
series and squaring, every rounding counted.  Floating point proposes norms, exact elimination decides.  A few ms a cell
and reset for n = 4.

Source: Taylor; error dynamics (24) of Balluchi et al. (2003); LDLᵀ over the rationals.
"""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from itertools import pairwise
from math import isfinite

import numpy as np

from deshybrid.linear.exact import (
    Rational,
    combined,
    diagonal,
    exponential_below,
    is_positive_semidefinite,
    product,
    scaled,
    transposed,
)
from deshybrid.linear.exact_flow import flow_enclosure, power_enclosure
from deshybrid.linear.exact_sampling import is_difference, is_sampled_form
from deshybrid.verify.design_file import Contraction, Plant

ROUND_UP = Fraction(1 + 2**-30)
LARGEST = 200
"""No norm or exponent beyond e^200 is proposed."""


def contraction_checks(plant: Plant, claim: Contraction) -> Iterator[tuple[str, str, bool]]:
    """Yield (place, inequality, proved) for everything that the claim says."""
    everywhere = "every location"
    yield everywhere, "0 <= γ < 1", 0 <= claim.gamma < 1
    longest = max((stay[1] for stay in claim.stays.values()), default=Fraction())
    enough = claim.rate >= 0 and claim.gamma <= exponential_below(-claim.rate * longest)
    yield everywhere, "γ <= e^{-rate · longest stay}", enough
    shortest = min((stay[0] for stay in claim.stays.values()), default=Fraction())
    yield everywhere, "`dwell` is the shortest stay", claim.dwell == shortest
    yield everywhere, "stays are positive and bounded", all(0 <= low <= high for low, high in claim.stays.values())
    yield everywhere, "the delay is not negative", claim.delay >= 0
    if claim.step is not None:
        for name in plant.locations:
            said = "M is the sampled form of A - G C, to one part in 10⁶"
            yield f"location `{name}`", said, _is_made_from_gains(plant, claim, name, claim.step)
    roots = {name: _root(P) for name, P in claim.P.items()}
    for name in plant.locations:
        place = f"location `{name}`"
        yield place, "P is symmetric and positive definite", _is_symmetric(claim.P[name]) and _least(claim.P[name]) > 0
        yield place, "the cells cover the stays", _covers(claim, name)
        proved = _Bound(plant, claim, name, roots).holds()
        yield place, "EᵀPE <= γ² P for every reset that leaves it and every stay", proved


def _is_made_from_gains(plant: Plant, claim: Contraction, name: str, step: Fraction) -> bool:
    (A, C), gain, M = plant.locations[name], plant.gains[name], claim.matrices[name]
    if plant.time_step is None:
        return is_sampled_form(M, A, C, gain, step)
    return plant.time_step == step and is_difference(M, A, product(gain, C) if C else scaled(A, 0))


def _is_symmetric(matrix: Rational) -> bool:
    return transposed(matrix) == matrix


def _least(P: Rational) -> Fraction:
    """A proved lower bound of the eigenvalues of P, zero where none is found."""
    proposal = Fraction(float(np.linalg.eigvalsh(_floats(P)).min())) / 2
    proved = proposal > 0 and is_positive_semidefinite(combined(P, diagonal([proposal] * len(P)), -1))
    return proposal if proved else Fraction()


def _covers(claim: Contraction, name: str) -> bool:
    ends, stay = claim.cells[name], claim.stays[name]
    inside = all(a <= b for a, b in pairwise(ends))
    whole = claim.step is None or all(_is_whole(end, claim.step) for end in ends)
    return bool(ends) and ends[0] <= stay[0] and ends[-1] >= stay[1] and inside and whole


def _is_whole(duration: Fraction, step: Fraction) -> bool:
    return abs(duration / step - round(duration / step)) < Fraction(1, 10**6)


def _root(P: Rational) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]] | None":
    """An upper factor of P in floating point, for proposals only."""
    try:
        return np.asarray(np.linalg.cholesky(_floats(P)).T)
    except np.linalg.LinAlgError:
        return None


def _floats(matrix: Rational) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
    return np.array([[float(value) for value in row] for row in matrix], dtype=np.float64)


class _Bound:
    """The bound of ‖E‖ over the cells of one location."""

    def __init__(self, plant: Plant, claim: Contraction, name: str, roots: Mapping[str, object]) -> None:
        self.claim, self.name, self.P, self.roots = claim, name, claim.P[name], roots
        self.jumps = plant.exits(name)
        self.M = claim.matrices[name]
        one = diagonal([1] * len(self.M))
        self.spread = Fraction(1)
        self.N = self.M if claim.step is None else scaled(combined(self.M, one, -1), 1 / claim.step)

    def holds(self) -> bool:
        """Whether the bound of every cell and reset is proved to be at most γ."""
        try:
            growth, self.spread = self._growth(), self._spread()
            resets = {jump.target: self._norm(jump.matrix, jump.target) for jump in self.jumps}
            ends = self.claim.cells[self.name]
            pairs = list(pairwise(ends)) or [(end, end) for end in ends]
            return all(self._cell(a, b, growth, resets) for a, b in pairs)
        except (ValueError, OverflowError):
            return False

    def _cell(self, a: Fraction, b: Fraction, growth: Fraction, resets: Mapping[str, Fraction]) -> bool:
        w = b - a
        if self.claim.step is not None and round(w / self.claim.step) == 1:
            return all(self._cell(end, end, growth, resets) for end in (a, b))
        flow, radius = self._flow(a)
        slope = product(self.N, flow)
        bent = product(self.N, slope)
        rest = w * w / 2 * self._norm(bent, self.name) * self._power(growth, w) if w else Fraction()
        middle = combined(flow, slope, w / 2)
        for jump in self.jumps:
            bound = self._norm(product(jump.matrix, middle), jump.target) + self._loss(jump.matrix, radius, w, growth)
            if w:
                bound += w / 2 * self._norm(product(jump.matrix, slope), jump.target) + resets[jump.target] * rest
            if bound > self.claim.gamma:
                return False
        return True

    def _flow(self, a: Fraction) -> tuple[Rational, Fraction]:
        """X and a bound of the size of each entry of its error."""
        if self.claim.step is None:
            return flow_enclosure(self.M, a)
        return power_enclosure(self.M, round(a / self.claim.step))

    def _loss(self, reset: Rational, radius: Fraction, w: Fraction, growth: Fraction) -> Fraction:
        """What an error of X in every entry adds to the bound, generously: everything is measured by row sums."""
        n = len(reset)
        size = max(sum(abs(value) for value in row) for row in self.N) * w + 1
        reach = max(sum(abs(value) for value in row) for row in reset)
        return 4 * radius * n**3 * size * size * (1 + reach) * (1 + self._power(growth, w)) * self.spread

    def _spread(self) -> Fraction:
        """A bound of the condition of all P together: largest trace over least eigenvalue, the latter proved."""
        largest = max(sum((P[i][i] for i in range(len(P))), Fraction()) for P in self.claim.P.values())
        least = min(_least(P) for P in self.claim.P.values())
        if least <= 0:
            raise ValueError("P is nearly singular")
        return largest / least

    def _growth(self) -> Fraction:
        """β >= 0 with FᵀP + PF <= 2βP, or g >= 1 with MᵀPM <= g²P, proved."""
        if self.claim.step is not None:
            return max(Fraction(1), self._norm(self.M, self.name))
        root = self._root_of(self.name)
        inside = root @ _floats(self.M) @ np.linalg.inv(root)
        proposal = float(np.linalg.eigvalsh((inside + inside.T) / 2).max())
        beta = max(Fraction(), Fraction(proposal)) + Fraction(float(np.linalg.norm(inside, 2))) / 2**30
        drift = product(self.P, self.M)
        if not is_positive_semidefinite(combined(scaled(self.P, 2 * beta), combined(drift, transposed(drift)), -1)):
            raise ValueError("β is not proved")
        return beta

    def _power(self, growth: Fraction, w: Fraction) -> Fraction:
        """An upper bound of e^{β w}, or of g^{w/h}."""
        if self.claim.step is None:
            if growth * w > LARGEST:
                raise ValueError("the cell is too wide")
            return 1 / exponential_below(-growth * w)
        return growth ** round(w / self.claim.step)

    def _norm(self, matrix: Rational, target: str) -> Fraction:
        """c with XᵀP_jX <= c²P_i: floating point proposes, exact elimination decides."""
        here, there = self._root_of(self.name), self._root_of(target)
        proposal = float(np.linalg.norm(there @ _floats(matrix) @ np.linalg.inv(here), 2))
        if not isfinite(proposal):
            raise ValueError("a norm is not finite")
        image = product(product(transposed(matrix), self.claim.P[target]), matrix)
        bound = Fraction(proposal) * ROUND_UP + Fraction(1, 2**80)
        for _ in range(8):
            if is_positive_semidefinite(combined(scaled(self.P, bound * bound), image, -1)):
                return bound
            bound = bound * (1 + Fraction(1, 2**16)) + Fraction(1, 2**40)
        raise ValueError("a norm is not proved")

    def _root_of(self, name: str) -> "np.ndarray[tuple[int, int], np.dtype[np.float64]]":
        root = self.roots[name]
        if not isinstance(root, np.ndarray):
            raise ValueError("P is not positive definite")
        return root


__all__ = ["contraction_checks"]
