"""Check the claims of a design in exact arithmetic, without the code that made them.

In: the JSON tree of `design.json`.  Out: a report, one entry per inequality.  The idea: a certificate says
‖e^{F t}‖ <= κ e^{α t} in the norm ‖S⁻¹ ·‖₂, S = diag(scale), and shows a basis T for it.  With Q = Re(T Tᴴ), of which
nothing has to be assumed, this follows from matrix inequalities between doubles, read as the rational numbers they are
and checked by exact elimination, F = A - G C included:

    b I <= S⁻¹ Q S⁻¹ <= a I with a <= κ² b      and      Q Fᵀ + F Q <= 2 α Q   (sampled: M Q Mᵀ <= e^{2 α h} Q),
    R S² Rᵀ <= r² S²  for every reset R that leaves the location,

and then (20): α <= -μ, and r κ <= 1 or r κ <= e^{-(α + μ)(D - Δ)}.  A rational lower bound stands for the
exponential.  There is no tolerance: a claim that misses by one part in 10¹⁶ is refused (its maker rounds up to leave
room).  Only the sampled matrices M are compared with the gains they were made from, to one part in 10⁶.

Source: Balluchi et al. (2012), (20) and the appendix; LDLᵀ over the rationals.
"""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from math import ceil

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
from deshybrid.verify.average import average_checks
from deshybrid.verify.bound import bound_checks, read_bound
from deshybrid.verify.contraction import contraction_checks
from deshybrid.verify.design_file import (
    Claim,
    Plant,
    Summary,
    read_claims,
    read_contractions,
    read_plant,
    read_summary,
)
from deshybrid.verify.form_file import FormClaim, SilentForm, read_forms
from deshybrid.verify.forms import Said, form_checks, limit_checks
from deshybrid.verify.report import UNCHECKED, Check, VerifyReport
from deshybrid.verify.sampled import made_from_the_gains
from deshybrid.verify.watched import Watched, paths_in_words

PART_OF_A_STEP = Fraction(1, 10**6)
PROPOSED = Fraction(1, 10**10)
SPECTRUM = Fraction(1, 10**6)
"""Eigenvalues agree with A - G C if their sums of powers do to this share; no certificate rests on them."""
THEOREMS = ("B12-6", "B12-7", "B12-6-sampled", "B12-7-sampled")


def verify_design(document: Mapping[str, object]) -> VerifyReport:
    """Return which claims of a design are proved; `document` is the tree of `design.json`.

    Raises `UsageError` (DH0511) where the tree is not a design, `LimitReached` (DH0512) beyond 40 states.
    A claim that cannot be proved is refused in the report, not raised.

    >>> one = {"A": [[-3.0]], "C": [[0.0]]}
    >>> claim = {
    ...     "theorem": "B12-6", "rate": 1.0, "dwell": 0.5, "delay": 0.0, "holds": True, "required_dwell": 0.25,
    ...     "step": None, "scale": [1.0], "T": {"p": [[[1.0, 0.0]]]},
    ...     "terms": {"p": {"alpha": -3.0, "kappa": 1.1, "r": 1.0, "required": 0.0}},
    ... }
    >>> loop = {"from": "p", "to": "p", "matrix": [[1.0]]}
    >>> system = {"time_step": None, "locations": {"p": one}, "resets": [loop]}
    >>> design = {"rate": 1.0, "required_dwell": 0.25, "gains": {"p": [[0.0]]}, "system": system}
    >>> verify_design({**design, "certificates": [claim]}).holds
    True
    """
    document = Watched(document)
    plant = read_plant(document)
    claims, summary = read_claims(document, plant), read_summary(document, plant)
    checks = [check for claim in claims if claim.holds for check in _checks(plant, claim)]
    forms, boxes = read_forms(document, plant), read_contractions(document, plant)
    checks += [Check(c.name, *said) for c in forms if isinstance(c, FormClaim) for said in form_checks(plant, c)]
    checks += [Check(c.name, *said) for c in boxes if not isinstance(c, str) for said in contraction_checks(plant, c)]
    checks += [Check("average dwell time", *said) for said in average_checks(document, plant, summary.rate)]
    if checks:
        checks += [Check("design", *said) for said in _summary_checks(plant, claims, forms, summary)]
        checks += [Check("design", *said) for said in limit_checks(document, plant, summary.rate)]
        if not any(claim.holds for claim in claims) and not any(isinstance(claim, FormClaim) for claim in forms):
            slow = all(summary.rate <= box.rate for box in boxes if not isinstance(box, str))
            checks.append(Check("design", "every location", "`rate` is not above those of the certificates", slow))
    bound = read_bound(document, plant)
    proved = [claim for claim in claims if claim.holds] + [claim for claim in forms if isinstance(claim, FormClaim)]
    found = bound_checks(plant, bound, tuple(proved)) if bound is not None else None
    checks += [Check("ultimate bound", *said) for said in found or ()]
    silent = [claim.name for claim in claims if not claim.holds]
    silent += [claim.name for claim in forms if isinstance(claim, SilentForm)]
    silent += [claim for claim in boxes if isinstance(claim, str)]
    large = ("`ultimate_bound` (too large)",) if bound is not None and found is None else ()
    return VerifyReport(tuple(checks), tuple(silent), (*UNCHECKED, *_unread(document, plant), *large))


def _unread(document: Watched, plant: Plant) -> tuple[str, ...]:
    """The keys that nothing was made of; those of certificates that do not claim to hold are named by these."""
    entries = document.get("certificates")
    claimed = [entry.get("holds") is True for entry in entries] if isinstance(entries, list) else []
    paths = (p for p in document.unread() if p[0] != "certificates" or (isinstance(p[1], int) and claimed[p[1]]))
    return paths_in_words(paths, frozenset(plant.locations))


def _summary_checks(
    plant: Plant, claims: tuple[Claim, ...], forms: tuple[FormClaim | SilentForm, ...], summary: Summary
) -> Iterator[Said]:
    """What the design states outside of its certificates."""
    everywhere = "every location"
    rates = [claim.rate for claim in claims if claim.holds] + [c.rate for c in forms if isinstance(c, FormClaim)]
    yield everywhere, "`rate` is that of the certificates", all(rate == summary.rate for rate in rates)
    both = (*claims, *forms)
    plain = [claim for claim in both if not claim.theorem.endswith("-sampled")] or both
    stated = [(claim.delay, claim.required) for claim in plain]
    longest = max((delay for delay, _ in stated), default=None)
    needs = [required for delay, required in stated if delay == longest and required is not None]
    said = "`required_dwell` is the least of the certificates in continuous time with the longest delay"
    yield everywhere, said, summary.required == min(needs, default=None)
    for name, values in summary.eigenvalues.items():
        said = "the eigenvalues have the sum and the sum of squares that A - G C has"
        yield f"location `{name}`", said, _is_spectrum(plant.error_matrix(name), values)


def _is_spectrum(error: Rational, values: tuple[tuple[Fraction, Fraction], ...]) -> bool:
    squared = product(error, error)
    trace, second = (sum((M[i][i] for i in range(len(M))), Fraction()) for M in (error, squared))
    none = Fraction()
    size = max((abs(re) + abs(im) for re, im in values), default=none)
    sums = (
        (sum((re for re, _ in values), none) - trace, size),
        (sum((im for _, im in values), none), size),
        (sum((re * re - im * im for re, im in values), none) - second, size * size),
        (sum((re * im for re, im in values), none), size * size),
    )
    return all(abs(difference) <= SPECTRUM * unit for difference, unit in sums)


def _checks(plant: Plant, claim: Claim) -> Iterator[Check]:
    for inequality, proved in _statement(plant, claim):
        yield Check(claim.name, "every location", inequality, proved)
    for name in plant.locations:
        for inequality, proved in _location_checks(plant, claim, name):
            yield Check(claim.name, f"location `{name}`", inequality, proved)


def _statement(plant: Plant, claim: Claim) -> Iterator[tuple[str, bool]]:
    """What has to hold of the claim's own words."""
    yield f"`{claim.theorem}` is a theorem this verifier knows", claim.theorem in THEOREMS
    yield "the rate is positive", claim.rate > 0
    yield "0 <= delay < dwell", 0 <= claim.delay < claim.dwell
    yield "Theorem 6 is used without delay only", claim.delay == 0 or "B12-6" not in claim.theorem
    enough = claim.required is not None and _stay(claim, claim.required) <= _stay(claim, claim.dwell)
    yield "required dwell <= dwell", enough
    expected = plant.time_step is not None or claim.theorem.endswith("-sampled")
    yield "a step is stated in sampled time only", (claim.step is not None) == expected
    yield "the scale of the norm is positive", all(value > 0 for value in claim.scale)
    if plant.time_step is not None:
        yield "the step is that of the system", claim.step == plant.time_step


def _location_checks(plant: Plant, claim: Claim, name: str) -> Iterator[tuple[str, bool]]:
    error, term, basis = plant.error_matrix(name), claim.terms[name], claim.bases[name]
    if claim.theorem.endswith("-sampled") and claim.step is not None:
        error = claim.matrices[name]
        yield made_from_the_gains(plant, claim.matrices[name], name, claim.step)
    Q = combined(product(basis[0], transposed(basis[0])), product(basis[1], transposed(basis[1])))
    if claim.step is None:
        drift = product(error, Q)
        yield (
            "Q Fᵀ + F Q <= 2 α Q with F = A - G C, Q = Re(T Tᴴ)",
            is_positive_semidefinite(combined(scaled(Q, 2 * term.alpha), combined(drift, transposed(drift)), -1)),
        )
    else:
        factor = exponential_below(2 * term.alpha * claim.step)
        image = product(product(error, Q), transposed(error))
        yield (
            "M Q Mᵀ <= e^{2 α h} Q with Q = Re(T Tᴴ)",
            is_positive_semidefinite(combined(scaled(Q, factor), image, -1)),
        )
    yield "κ² bounds the condition of S⁻¹ Q S⁻¹", _condition_holds(Q, claim.scale, term.kappa)
    squares = diagonal([value * value for value in claim.scale])
    for reset in plant.exits(name):
        image = product(product(reset.matrix, squares), transposed(reset.matrix))
        proved = term.r >= 0 and is_positive_semidefinite(combined(scaled(squares, term.r**2), image, -1))
        yield f"‖R‖ <= r for the reset to `{reset.target}`", proved
    cost = term.r * term.kappa
    for what, dwell in (("dwell", claim.dwell), ("required dwell", claim.required)):
        yield f"(20) with the {what}: α + max(0, log(r κ))/(D - Δ) <= -μ", _twenty(claim, cost, term.alpha, dwell)


def _twenty(claim: Claim, cost: Fraction, alpha: Fraction, dwell: Fraction | None) -> bool:
    if dwell is None or dwell < claim.delay or alpha > -claim.rate:
        return False
    return cost <= 1 or cost <= exponential_below(-(alpha + claim.rate) * _stay(claim, dwell))


def _stay(claim: Claim, dwell: Fraction) -> Fraction:
    """D - Δ, in sampled time the least whole number of steps that long."""
    if claim.step is None:
        return dwell - claim.delay
    return ceil((dwell - claim.delay) / claim.step - PART_OF_A_STEP) * claim.step


def _condition_holds(Q: Rational, scale: tuple[Fraction, ...], kappa: Fraction) -> bool:
    """Some a has a I - Q̃ >= 0 and κ² Q̃ - a I >= 0, Q̃ = S⁻¹ Q S⁻¹; floating point proposes a, exact numbers decide."""
    import numpy as np

    if any(value <= 0 for value in scale):
        return False
    inverse = diagonal([1 / value for value in scale])
    shaped = product(product(inverse, Q), inverse)
    size = max(abs(value) for row in shaped for value in row)
    if kappa < 1 or size == 0:
        return False
    shaped = scaled(shaped, 1 / size)
    largest = np.linalg.eigvalsh(np.array([[float(value) for value in row] for row in shaped])).max()
    unit = diagonal([Fraction(float(largest)) * (1 + PROPOSED)] * len(scale))
    return is_positive_semidefinite(combined(unit, shaped, -1)) and is_positive_semidefinite(
        combined(scaled(shaped, kappa**2), unit, -1)
    )


__all__ = ["verify_design"]
