"""Whether a sampled error matrix in a certificate is the one that the gains of the design give.

In: the plant of a design, M (n, n) of one location, the step.  Out: the claim in words, and whether it was proved.
"""

from fractions import Fraction

from deshybrid.linear.exact import Rational, product, scaled
from deshybrid.linear.exact_sampling import is_difference, is_sampled_form
from deshybrid.verify.design_file import Plant


def made_from_the_gains(plant: Plant, M: Rational, name: str, step: Fraction) -> tuple[str, bool]:
    """Return what is said of M of a location, and whether it was proved; step in seconds."""
    (A, C), gain = plant.locations[name], plant.gains[name]
    if plant.time_step is not None:
        made = product(gain, C) if C else scaled(A, 0)
        return "M is A - G C, to one part in 10⁶", is_difference(M, A, made)
    said = "M is e^{A h} minus the sampled gain times C, to one part in 10⁶"
    return said, is_sampled_form(M, A, C, gain, step)


__all__ = ["made_from_the_gains"]
