"""The three-location example of Balluchi et al. (2003), section IV: printed facts, and what the tool makes of them."""

import json
import subprocess
import sys
from fractions import Fraction

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid import compiler
from deshybrid.continuous.determinability import Determinability
from deshybrid.continuous.determinability_coordinates import hidden_projection, kalman_coordinates
from deshybrid.model.load import load
from deshybrid.model.system import HybridSystem
from deshybrid.verify import verify_design

MODEL = "models/balluchi2003/three_locations.yaml"
PLACES = ("q1", "q2", "q3")
PRINTED = {
    "q1": ((-2, -4), (1 / 100, -1 / 250), ((-1 / 250, 0), (0, 0)), (2, -2)),
    "q2": ((-2 / 5,), (0, 1 / 100, -1 / 100), ((-1 / 500,), (0,), (0,)), (-1,)),
    "q3": ((-5, -2), (1 / 200, -1 / 100), ((0, 1 / 250), (-1 / 250, 0)), (1, 1)),
}
"""A^O and A^N (diagonals), A^P, C^O of section IV."""


@pytest.fixture(scope="module")
def system() -> HybridSystem:
    return load(MODEL)


@pytest.fixture(scope="module")
def made() -> compiler.Design:
    return compiler.design(MODEL)


@pytest.fixture(scope="module")
def theorem(made: compiler.Design) -> Determinability:
    assert made.determined is not None
    assert made.determined.theorem is not None
    return made.determined.theorem


@pytest.mark.parametrize("name", PLACES)
def test_printed_coordinates_give_the_printed_parts_of_each_location(system: HybridSystem, name: str) -> None:
    seen, hidden, coupling, output = PRINTED[name]
    dynamics = system.location(name).dynamics
    assert dynamics is not None
    split = kalman_coordinates(dynamics.A, dynamics.C, system.observer.coordinates[name])
    assert np.allclose(split.A_o, np.diag(seen), atol=1e-14)
    assert np.allclose(split.A_u, np.diag(hidden), atol=1e-14)
    assert np.allclose(split.coupling, coupling, atol=1e-14)
    assert np.allclose(split.C_o, [output], atol=1e-14)


@pytest.mark.parametrize("name", PLACES)
def test_printed_and_chosen_coordinates_hide_the_same_projection(system: HybridSystem, name: str) -> None:
    dynamics = system.location(name).dynamics
    assert dynamics is not None
    exact = np.array([[float(value) for value in row] for row in hidden_projection(dynamics.A, dynamics.C)])
    for stated in (system.observer.coordinates[name], None):
        split = kalman_coordinates(dynamics.A, dynamics.C, stated)
        k = split.observable_dimension
        assert np.allclose(split.transform[:, k:] @ split.inverse[k:], exact, atol=1e-13)


def test_printed_matrices_are_read_as_the_fractions_they_are(system: HybridSystem) -> None:
    dynamics = system.location("q1").dynamics
    assert dynamics is not None
    projection = hidden_projection(dynamics.A, dynamics.C)
    assert all(value.denominator <= 10_000 for row in projection for value in row)
    assert sum(projection[i][i] for i in range(4)) == Fraction(2)


def test_printed_bound_r_n_and_its_longest_stays_are_reproduced(theorem: Determinability) -> None:
    found = {start.location: start for start in theorem.starts}
    assert [round(found[name].R_N, 4) for name in PLACES] == [4.3554, 4.7302, 3.6492]
    assert [round(found[name].max_sojourn, 4) for name in ("q1", "q3")] == [7.0616, 8.3241]
    assert round(theorem.nu_A, 7) == 0.0101005
    assert round(theorem.alpha_A, 12) == 0.01
    rounded = ((1 + 1 / found["q1"].R_N) ** (1 / 3) - 1) / 0.01
    assert round(rounded, 4) == 7.1325


def test_condition_16_holds_from_the_printed_start_but_not_from_the_second_location(theorem: Determinability) -> None:
    assert {start.location: start.condition_16 for start in theorem.starts} == {"q1": True, "q2": False, "q3": True}
    assert theorem.start.location == "q3"


def test_printed_longest_stay_is_refuted_by_its_own_bound_and_the_proven_one_is_shorter(
    theorem: Determinability,
) -> None:
    """(28) bounds e^{A^N t} - I by ν_A t, with ν_A of (19): false for e^{t/100} - 1 beyond one second."""
    first = theorem.starts[0]
    drift = np.expm1(0.01 * first.max_sojourn)
    assert drift > theorem.nu_A * first.max_sojourn
    assert first.R_N * ((1 + drift) ** 3 - 1) > 1.0
    proven = np.expm1(0.01 * first.max_sojourn_proven)
    assert first.R_N * ((1 + proven) ** 3 - 1) == pytest.approx(1.0)


def test_printed_speed_condition_does_not_hold_with_the_printed_numbers() -> None:
    """Section IV says that (18) is verified with D_m = 1.5, D_M = 7, α_F = -10, ν_P = 0.004, R_X = 1825, ε = 0.98."""
    a, f = 0.01, -10.0
    left = np.exp(2 * a * 7) * (np.exp(f * 1.5) + 0.004 * (np.exp(a * 7) - np.exp(f * 7)) / (a - f))
    right = (1 - 0.98) / (4 * 1825)
    assert left == pytest.approx(4.9e-4, rel=0.02)
    assert right < 3e-6


def test_speed_condition_does_not_hold_but_the_error_contracts_over_the_whole_box(made: compiler.Design) -> None:
    record = made.document()["determinability"]
    assert isinstance(record, dict)
    assert record["condition_16"] is True
    assert record["condition_18"] is False
    assert record["condition_18_printed"] is False
    assert record["contracts"] is True
    assert record["unobservable_dimension"] == {"q1": 2, "q2": 3, "q3": 2}
    assert made.certified


def test_cycle_map_from_the_first_location_stays_far_below_one_over_the_box(made: compiler.Design) -> None:
    assert made.gains is not None
    flows = {name: [expm(made.gains.closed_loop[name] * t) for t in np.linspace(1.5, 7, 9)] for name in PLACES}
    norms = [np.linalg.norm(c @ b @ a, 2) for a in flows["q1"] for b in flows["q2"] for c in flows["q3"]]
    assert max(norms) < 0.0615


def test_error_contracts_by_the_certified_factor_at_every_switch(made: compiler.Design) -> None:
    assert made.gains is not None
    assert made.determined is not None
    claim = made.determined.certificates[0]
    rng = np.random.default_rng(7)
    error, place = rng.standard_normal(4), 0
    for _ in range(60):
        name, after = PLACES[place], PLACES[(place + 1) % 3]
        before = error @ claim.P[name] @ error
        error = expm(made.gains.closed_loop[name] * rng.uniform(1.5, 7)) @ error
        assert error @ claim.P[after] @ error <= claim.gamma**2 * before
        error, place = error / np.linalg.norm(error), (place + 1) % 3


def test_design_command_certifies_the_example_and_verify_proves_it() -> None:
    command = [sys.executable, "-m", "deshybrid.cli", "design", MODEL, "--json"]
    answer = subprocess.run(command, capture_output=True, check=False)
    assert answer.returncode == 0
    tree = json.loads(answer.stdout)
    assert verify_design(tree).holds
    tree["certificates"][0]["gamma"] *= 0.9
    report = verify_design(tree)
    assert not report.holds
    assert {check.inequality for check in report.refused} == {
        "EᵀPE <= γ² P for every reset that leaves it and every stay"
    }
