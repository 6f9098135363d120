"""Contraction over a box of stays, and condition (16), against brute force from the definitions."""

import json
from itertools import pairwise, product

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from strategies import switched_errors, written_cycles

from deshybrid.continuous.determinability_contraction import Box, ContractionCertificate, certify_box, worst_round
from deshybrid.continuous.determinability_coordinates import hidden_dimensions, hidden_projection, written
from deshybrid.continuous.error import ErrorDynamics
from deshybrid.linear.observability import observability_matrix
from deshybrid.verify import verify_design

Case = tuple[ErrorDynamics, dict[str, tuple[float, float]]]


def naive_flow(dynamics: ErrorDynamics, name: str, stay: float) -> np.ndarray:
    """e^{F τ}, or the power of M for the whole steps in τ."""
    matrix = dynamics.matrices[name]
    if dynamics.step is None:
        return expm(matrix * stay)
    flow = np.eye(len(matrix))
    for _ in range(round(stay / dynamics.step)):
        flow = matrix @ flow
    return flow


def naive_stays(dynamics: ErrorDynamics, stay: tuple[float, float], count: int) -> list[float]:
    """A fine grid of stays, whole steps in sampled time."""
    if dynamics.step is None:
        return list(np.linspace(*stay, count))
    return [k * dynamics.step for k in range(round(stay[0] / dynamics.step), round(stay[1] / dynamics.step) + 1)]


@given(switched_errors())
@settings(max_examples=60)
def test_certified_contraction_holds_at_every_stay_of_a_fine_grid(case: Case) -> None:
    dynamics, stays = case
    n = len(next(iter(dynamics.matrices.values())))
    claim = certify_box(dynamics, stays, np.ones(n))
    if not claim.holds:
        return
    for reset in dynamics.resets:
        for stay in naive_stays(dynamics, stays[reset.source], 101):
            E = reset.matrix @ naive_flow(dynamics, reset.source, stay)
            gap = claim.gamma**2 * claim.P[reset.source] - E.T @ claim.P[reset.target] @ E
            assert np.linalg.eigvalsh(gap).min() >= -1e-9 * np.abs(claim.P[reset.source]).max()


@given(switched_errors())
@settings(max_examples=40)
def test_no_round_of_a_certified_box_grows(case: Case) -> None:
    """Brute force: products over all rounds of up to three switches, every combination of seven stays each."""
    dynamics, stays = case
    n = len(next(iter(dynamics.matrices.values())))
    claim = certify_box(dynamics, stays, np.ones(n))
    flows = {q: [naive_flow(dynamics, q, t) for t in naive_stays(dynamics, stays[q], 7)] for q in dynamics.locations}
    largest = 0.0
    for length in (1, 2, 3):
        for walk in product(dynamics.resets, repeat=length):
            if any(a.target != b.source for a, b in zip(walk, (*walk[1:], walk[0]), strict=True)):
                continue
            for choice in product(*(flows[reset.source] for reset in walk)):
                whole = np.eye(n)
                for reset, flow in zip(walk, choice, strict=True):
                    whole = reset.matrix @ flow @ whole
                radius = float(np.abs(np.linalg.eigvals(whole)).max()) ** (1 / length)
                largest = max(largest, radius)
    if claim.holds:
        assert largest <= claim.gamma * (1 + 1e-9)
    if largest >= 1.0:
        assert not claim.holds


def document(dynamics: ErrorDynamics, claim: ContractionCertificate) -> dict[str, object]:
    """A design whose error dynamics are exactly these: A is F (or M), and every gain is zero."""
    n = len(next(iter(dynamics.matrices.values())))
    places = {name: {"A": matrix.tolist(), "C": [[0.0] * n]} for name, matrix in dynamics.matrices.items()}
    jumps = [{"from": r.source, "to": r.target, "matrix": r.matrix.tolist()} for r in dynamics.resets]
    tree = {
        "rate": claim.rate,
        "required_dwell": None,
        "gains": {name: [[0.0]] * n for name in dynamics.locations},
        "certificates": [claim.record()],
        "system": {"time_step": dynamics.step, "locations": places, "resets": jumps},
    }
    return json.loads(json.dumps(tree))


@given(switched_errors(), st.sampled_from(["gamma", "stays", "reset"]))
@settings(max_examples=25)
def test_verifier_proves_every_certified_box_and_refuses_a_perturbed_one(case: Case, part: str) -> None:
    dynamics, stays = case
    claim = certify_box(dynamics, stays, np.ones(len(next(iter(dynamics.matrices.values())))))
    assume(claim.holds)
    assume(claim.gamma > 1e-6)
    tree = document(dynamics, claim)
    assert verify_design(tree).holds
    if part == "gamma":  # the grid showed 1/1.02 of what is claimed
        tree["certificates"][0]["gamma"] /= 1.05
    elif part == "stays":
        tree["certificates"][0]["stays"]["q0"][1] += 0.25
    else:
        tree["system"]["resets"][0]["matrix"] = (np.eye(len(claim.P["q0"])) * 1e4).tolist()
    assert not verify_design(tree).holds


@given(switched_errors())
@settings(max_examples=40)
def test_worst_round_grows_as_it_says(case: Case) -> None:
    dynamics, stays = case
    worst = worst_round(Box(dynamics, stays))
    whole = np.eye(len(next(iter(dynamics.matrices.values()))))
    for place, stay in zip(worst.locations, worst.stays, strict=True):
        assert stays[place][0] <= stay <= stays[place][1]
        whole = naive_flow(dynamics, place, stay) @ whole
    exits = [(reset.source, reset.target) for reset in dynamics.resets]
    assert all(pair in exits for pair in zip(worst.locations, (*worst.locations[1:], worst.locations[0]), strict=True))
    if len(worst.locations) == 1:
        reset = next(r for r in dynamics.resets if (r.source, r.target) == (worst.locations[0], worst.locations[0]))
        assert worst.growth == pytest.approx(np.abs(np.linalg.eigvals(reset.matrix @ whole)).max(), rel=1e-6)


def naive_projection(A: np.ndarray, C: np.ndarray) -> np.ndarray:
    """The orthogonal projection onto the null space of the observability matrix, by its singular vectors."""
    _, values, rows = np.linalg.svd(observability_matrix(A, C))
    kernel = rows[int((values > 1e-9 * max(values.max(initial=0.0), 1e-300)).sum()) :]
    return kernel.T @ kernel


@given(written_cycles())
def test_condition_16_holds_exactly_where_the_product_of_hidden_parts_vanishes(
    cycle: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> None:
    whole = np.eye(len(cycle[0][0]))
    for A, C, reset in cycle:
        whole = reset @ naive_projection(A, C) @ whole
    exact = [hidden_projection(A, C) for A, C, _ in cycle]
    left = hidden_dimensions(exact, [written(reset) for _, _, reset in cycle])
    assert (left[-1] == 0) == (np.abs(whole).max() < 1e-9)
    assert all(a >= b for a, b in pairwise(left))


@given(written_cycles())
def test_hidden_projection_is_the_one_that_singular_vectors_give(
    cycle: list[tuple[np.ndarray, np.ndarray, np.ndarray]],
) -> None:
    for A, C, _ in cycle:
        exact = np.array([[float(value) for value in row] for row in hidden_projection(A, C)])
        assert np.allclose(exact, naive_projection(A, C), atol=1e-9)
