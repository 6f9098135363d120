"""Check an average dwell time: forms that decrease in every location and grow at most ρ-fold at a transition.

In: the plant of a design and its key `average_dwell`: dwell τ (s), rate μ and decay λ (1/s), jump ρ, forms P by
location.  Out: one check per inequality, F_iᵀ P_i + P_i F_i < -2 λ P_i (sampled: M_iᵀ P_i M_i < e^{-2 λ h} P_i),
R_ijᵀ P_j R_ij < ρ P_i, and ρ <= e^{2 (λ - μ) τ}.  Source: Hespanha and Morse (1999), Theorem 2.
"""

from collections.abc import Iterator, Mapping
from fractions import Fraction

from deshybrid.linear.exact import exponential_below, scaled, transposed
from deshybrid.linear.exact_definite import is_positive_definite
from deshybrid.linear.exact_inequalities import Motion, flow_decreases, jump_decreases
from deshybrid.verify.design_file import Plant, same_names
from deshybrid.verify.forms import Said
from deshybrid.verify.values import as_mapping, mapping_at, matrix_at, number_at, require

KEY = "average_dwell"


def average_checks(document: Mapping[str, object], plant: Plant, stated: Fraction) -> Iterator[Said]:
    """Yield what has to hold of the average dwell time, for the stated rate; nothing where the design has none."""
    if document.get(KEY) is None:
        return
    claim = as_mapping(document[KEY], KEY)
    dwell, rate, decay, jump = (number_at(claim.get(key), f"{KEY}.{key}") for key in ("dwell", "rate", "decay", "jump"))
    given, P = mapping_at(claim, "P", KEY), {}
    same_names(given, f"{KEY}.P", plant)
    for name, (A, _) in plant.locations.items():
        P[name] = matrix_at(given[name], f"{KEY}.P.{name}", columns=len(A), rows=len(A))
        require(P[name] == transposed(P[name]), f"{KEY}.P.{name}", "a symmetric matrix")
    sane = dwell >= 0 and 0 < rate < decay and jump > 0
    yield "every location", "the rate of `average_dwell` is that of the design", rate == stated
    yield "every location", "0 < μ < λ, and τ is not negative", sane
    for name in plant.locations:
        motion = Motion(plant.error_matrix(name), plant.time_step)
        yield f"location `{name}`", "P > 0", is_positive_definite(P[name])
        yield f"location `{name}`", "P decreases at the rate λ", sane and flow_decreases(motion, P[name], 1, decay)
    for k, reset in enumerate(plant.resets):
        proved = jump_decreases(reset.matrix, P[reset.target], scaled(P[reset.source], jump), 1)
        yield f"reset {k + 1} from `{reset.source}` to `{reset.target}`", "Rᵀ P R < ρ P", proved
    yield "every location", "ρ <= e^{2 (λ - μ) τ}", sane and jump <= exponential_below(2 * (decay - rate) * dwell)


__all__ = ["average_checks"]
