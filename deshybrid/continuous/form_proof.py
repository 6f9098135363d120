"""Whether forms that a solver proposed prove a rate, in exact arithmetic, as `deshybrid.verify` decides it again.

In: error dynamics, forms, the shortest and longest stays they are for, the rate.  Out: yes or no.  The inequalities are
those of `deshybrid.linear.exact_inequalities`.  Some milliseconds each for n = 6.
"""

from collections.abc import Mapping
from fractions import Fraction
from itertools import pairwise
from math import inf
from types import MappingProxyType

from deshybrid.continuous.dwell import most_steps
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.continuous.form_graph import Forms, StayForms
from deshybrid.linear.exact import Rational, rational
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_inequalities import (
    Motion,
    flow_decreases,
    jump_decreases,
    span_decreases,
    stay_decreases,
)


def is_proved(
    dynamics: ErrorDynamics,
    forms: Forms,
    stays: Mapping[str, float],
    rate: float,
    most: Mapping[str, float] = MappingProxyType({}),
) -> bool:
    """Return whether these forms prove the rate (1/s) for all stays (s) from `stays` on, up to `most` where stated."""
    proof = _Proof(dynamics, forms, stays, rate)
    covered = all(proof.covers(name, most.get(node.location, inf)) for name, node in forms.nodes.items())
    positive = all(is_positive_definite(P) for P in proof.P.values())
    return covered and positive and all(proof.holds(span) for span in forms.stays)


class _Proof:
    """One attempt: everything as rational numbers."""

    def __init__(self, dynamics: ErrorDynamics, forms: Forms, stays: Mapping[str, float], rate: float) -> None:
        self.forms, self.degree, self.rate = forms, forms.degree, Fraction(rate)
        self.step = None if dynamics.step is None else Fraction(dynamics.step)
        self.motions = {name: Motion(rational(F.tolist()), self.step) for name, F in dynamics.matrices.items()}
        self.resets = [rational(reset.matrix.tolist()) for reset in dynamics.resets]
        self.P: dict[str, Rational] = {name: rational(form.tolist()) for name, form in forms.P.items()}
        self.shortest = {name: self._whole(Fraction(stay)) for name, stay in stays.items()}

    def covers(self, node: str, longest: float) -> bool:
        """Whether the spans of a node follow each other from its shortest stay to its longest one."""
        spans = [span for span in self.forms.stays if span.node == node]
        follow = spans[0].start == 0 and all(a.end == b.start for a, b in pairwise(spans))
        if spans[-1].end == inf or longest == inf:
            return follow and spans[-1].end == inf
        last = self.shortest[self.forms.nodes[node].location] + self._whole(Fraction(spans[-1].end))
        if self.step is None:
            return follow and last >= Fraction(longest)
        return follow and last >= most_steps(longest, float(self.step)) * self.step

    def holds(self, span: StayForms) -> bool:
        """Whether the stay, flow and jump inequalities of one span are proved."""
        node = self.forms.nodes[span.node]
        motion, ends = self.motions[node.location], [rational(form.tolist()) for form in span.Q]
        if not all(is_positive_definite(Q) for Q in ends):
            return False
        if span.end == inf:
            flows = flow_decreases(motion, ends[0], self.degree, self.rate)
        else:
            width = self._whole(Fraction(span.end)) - self._whole(Fraction(span.start))
            flows = span_decreases(motion, width, ends[0], ends[1], degree=self.degree, rate=self.rate)
        stay = self.shortest[node.location] + self._whole(Fraction(span.start))
        return (
            flows
            and stay_decreases(motion, stay, self.P[span.node], ends[0], degree=self.degree, rate=self.rate)
            and all(
                jump_decreases(self.resets[number], self.P[target], Q, self.degree)
                for number, target in node.exits.items()
                for Q in ends
            )
        )

    def _whole(self, stay: Fraction) -> Fraction:
        return stay if self.step is None else round(stay / self.step) * self.step


__all__ = ["is_proved"]
