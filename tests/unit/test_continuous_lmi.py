"""Dwell-time certificates by matrix inequalities: what they prove, how near the truth, and who checks them."""

import copy
import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.continuous import conic
from deshybrid.continuous.certified import is_certified
from deshybrid.continuous.document import design_document
from deshybrid.continuous.dwell import certify_dwell, certify_sampled
from deshybrid.continuous.error import ErrorDynamics, ErrorReset
from deshybrid.continuous.form_proof import is_proved
from deshybrid.continuous.gains import design_gains
from deshybrid.continuous.lmi import InequalityCertificate
from deshybrid.diagnostics import UsageError
from deshybrid.linear.lifting import monomials
from deshybrid.verify import verify_design
from tests.certificates import Tree, certified, certified_forms, changed
from tests.switched import twin

BOTH = ("p", "q")


def random_loop(rng: np.random.Generator, n: int = 2, *, step: float | None = None) -> ErrorDynamics:
    """Two stable locations that follow each other, with resets that stretch."""
    matrices = {}
    for name in BOTH:
        F = rng.normal(size=(n, n)) * 2
        matrices[name] = F - (np.linalg.eigvals(F).real.max() + 1) * np.eye(n)
        if step is not None:
            matrices[name] = expm(matrices[name] * step)
    resets = (("p", "q"), ("q", "p"))
    return ErrorDynamics(
        BOTH, matrices, tuple(ErrorReset(*arc, rng.normal(size=(n, n)), np.zeros(n)) for arc in resets), step
    )


def sum_of_log(dynamics: ErrorDynamics, certificate: InequalityCertificate, rng: np.random.Generator) -> float:
    """The largest growth, times e^{μ t}, of any form over random switching with stays of at least the required one."""
    worst = -np.inf
    error, name = rng.normal(size=len(next(iter(dynamics.matrices.values())))), "p"
    power = certificate.degree // 2
    for _ in range(60):
        reset = dynamics.exits(name)[0]
        stay = certificate.required_dwell * (1 + rng.exponential(0.3) * rng.integers(2))
        moved = reset.matrix @ expm(dynamics.matrices[name] * stay) @ error * np.exp(certificate.rate * stay)
        values = [_form(certificate, place, vector, power) for place, vector in ((name, error), (reset.target, moved))]
        worst = max(worst, np.log(values[1] / values[0]))
        error, name = moved / np.linalg.norm(moved), reset.target
    return worst


def _form(certificate: InequalityCertificate, name: str, vector: np.ndarray, power: int) -> float:
    assert certificate.forms is not None
    lifted = np.array([np.prod(vector[list(m)]) for m in monomials(len(vector), power)])
    return float(lifted @ certificate.forms.P[name] @ lifted)


def test_the_forms_decrease_over_every_stay_of_at_least_the_required_dwell_time() -> None:
    """By the exponential and random switching, independently of the inequalities."""
    for seed in (0, 3, 4):
        rng = np.random.default_rng(seed)
        dynamics = random_loop(rng)
        found = certified(dynamics, rate=0.3)
        assert found.required_dwell > 0
        assert sum_of_log(dynamics, found, rng) <= 1e-9


def test_the_required_dwell_time_lies_above_the_worst_cycle_and_near_it() -> None:
    for seed in (0, 3, 4):
        found = certified(random_loop(np.random.default_rng(seed)), rate=0.3)
        assert found.limit.value <= found.required_dwell
        assert found.gap < 0.1


def test_a_scalar_location_needs_the_dwell_time_of_the_closed_form_in_continuous_and_sampled_time() -> None:
    one = np.eye(1)
    loop = (ErrorReset("p", "p", 4 * one, np.zeros(1)),)
    border = np.log(4) / 0.5
    plain = certified(ErrorDynamics(("p",), {"p": -one}, loop), rate=0.5)
    assert border <= plain.required_dwell < 1.003 * border
    sampled = ErrorDynamics(("p",), {"p": np.exp(-0.1) * one}, loop, 0.1)
    ticks = certified(sampled, rate=0.5, sampled=True)
    assert int(np.ceil(ticks.required_dwell / 0.1 - 1e-6)) == int(np.ceil(border / 0.1))


def test_a_faster_rate_or_a_longer_delay_asks_for_longer_stays() -> None:
    dynamics = random_loop(np.random.default_rng(5))
    slow, fast, late = (
        certified(dynamics, rate=rate, delay=delay).required_dwell
        for rate, delay in ((0.2, 0.0), (0.6, 0.0), (0.2, 0.25))
    )
    assert slow < fast
    assert late == pytest.approx(slow + 0.25, rel=5e-3)


def test_the_shortest_stays_of_the_model_lower_the_common_dwell_time() -> None:
    dynamics = random_loop(np.random.default_rng(4))
    alone = certified(dynamics, rate=0.3)
    helped = certified(dynamics, rate=0.3, least={"p": 4 * alone.required_dwell})
    assert helped.required_dwell < alone.required_dwell


def test_forms_that_hold_for_a_stay_hold_for_longer_ones_and_not_for_much_shorter_ones() -> None:
    dynamics = random_loop(np.random.default_rng(3))
    found = certified(dynamics, rate=0.3)
    assert found.forms is not None
    proved = [
        is_proved(dynamics, found.forms, dict.fromkeys(BOTH, share * found.required_dwell), 0.3)
        for share in (1.0, 1.5, 10, 0.5)
    ]
    assert proved == [True, True, True, False]


def test_equal_input_gives_equal_certificates() -> None:
    first, second = (certified(random_loop(np.random.default_rng(1)), rate=0.3) for _ in range(2))
    assert first.required_dwell == second.required_dwell
    assert all(np.array_equal(first.forms.P[name], second.forms.P[name]) for name in BOTH)


def test_a_rate_that_a_location_does_not_reach_has_no_certificate() -> None:
    found = certified(random_loop(np.random.default_rng(1)), rate=50.0)
    assert not found.holds
    assert found.required_dwell == np.inf
    assert found.forms is None


def test_without_the_solver_the_message_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(conic, "has_solver", lambda: False)
    with pytest.raises(UsageError) as raised:
        certified(random_loop(np.random.default_rng(1)), rate=0.3)
    assert raised.value.diagnostics[0].code == "DH0518"
    assert "deshybrid[lmi]" in raised.value.diagnostics[0].helps[0]


@pytest.fixture(scope="module")
def design() -> Tree:
    system = twin()
    gains = design_gains(system, BOTH, rate=1.0, dwell=3.0)
    papers = (certify_dwell(system, gains), certify_sampled(system, gains, step=0.01, delay=0.02))
    forms = certified_forms(system, gains, papers)
    assert is_certified((*papers, *forms))
    tree: Tree = json.loads(json.dumps(design_document(system, gains, [*papers, *forms], lower_limit=forms[0].limit)))
    return tree


def test_a_design_with_forms_is_accepted_by_the_verifier(design: Tree) -> None:
    report = verify_design(design)
    assert report.holds, str(report)
    assert [entry["theorem"] for entry in design["certificates"]] == ["B12-6", "B12-7-sampled", "LMI", "LMI-sampled"]
    assert design["certificates"][2]["required_dwell"] == design["required_dwell"]


PLAIN, SAMPLED = ("certificates", 2), ("certificates", 3)
TAMPERED: list[tuple[str, tuple[str | int, ...], Callable[[Any], Any], str]] = [
    ("P is no longer symmetric", (*PLAIN, "P", "p", 0, 1), lambda v: v + 1e-3, "P is symmetric"),
    ("P is negative", (*PLAIN, "P", "p", 0, 0), lambda v: -v, "P is symmetric and positive definite"),
    ("P is larger", (*PLAIN, "P", "q"), lambda P: [[1.5 * v for v in row] for row in P], "jump inequality"),
    ("P is smaller", (*PLAIN, "P", "q"), lambda P: [[0.5 * v for v in row] for row in P], "stay inequality"),
    ("Q is larger", (*PLAIN, "stays", 0, "Q", 0), lambda Q: [[3 * v for v in row] for row in Q], "stay inequality"),
    ("Q is a multiple of the identity", (*PLAIN, "stays", 0, "Q", 0), lambda Q: [[9.0, 0.0], [0.0, 9.0]], "inequality"),
    ("the rate is faster", (*PLAIN, "rate"), lambda v: 3 * v, "flow inequality"),
    ("the required dwell time is shorter", (*PLAIN, "required_dwell"), lambda v: 0.5 * v, "stay inequality"),
    ("the dwell time is shorter than required", (*PLAIN, "dwell"), lambda v: 1e-3, "required dwell <= dwell"),
    ("the delay is longer", (*SAMPLED, "delay"), lambda v: v + 0.3, "stay inequality"),
    ("the delay is negative", (*PLAIN, "delay"), lambda v: -0.1, "0 <= delay < dwell"),
    ("a gain", ("gains", "p", 0, 0), lambda v: v - 5.0, "inequality"),
    ("a reset", ("system", "resets", 0, "matrix", 1, 1), lambda v: 4 * v, "jump inequality"),
    ("a sampled matrix", (*SAMPLED, "matrices", "p", 0, 0), lambda v: v + 1e-3, "M is e^{A h} minus"),
    ("a step in continuous time", (*PLAIN, "step"), lambda v: 0.01, "a step is stated in sampled time only"),
    ("the limit", ("dwell_lower_limit",), lambda v: v * 1.5, "no stay is shorter than the lower limit"),
    ("the stays of the witness", ("witness_cycle", "stays", 0), lambda v: v + 3.0, "does not contract"),
    ("the places of the witness", ("witness_cycle", "locations"), lambda v: v[::-1] + v, "its locations are those"),
    ("no witness", ("witness_cycle",), lambda v: None, "a lower limit above zero has a witness"),
]


@pytest.mark.parametrize(("what", "path", "change", "broken"), TAMPERED, ids=[entry[0] for entry in TAMPERED])
def test_a_changed_certificate_is_refused_and_the_inequality_named(
    design: Tree, what: str, path: tuple[str | int, ...], change: Callable[[Any], Any], broken: str
) -> None:
    report = verify_design(changed(design, path, change))
    assert not report.holds
    assert any(broken in check.inequality for check in report.refused), str(report)


def test_a_hundred_perturbed_forms_that_are_false_in_floating_point_are_refused(design: Tree) -> None:
    """Each is false by far more than rounding: some inequality has a clearly negative eigenvalue."""
    rng, refused = np.random.default_rng(7), 0
    for _ in range(300):
        tree = copy.deepcopy(design)
        entry = tree["certificates"][2]
        for forms, key in [(entry["P"], name) for name in BOTH] + [(span["Q"], 0) for span in entry["stays"]]:
            noise, form = rng.normal(size=(2, 2)) * rng.choice([0.02, 0.2, 1.0]), np.array(forms[key])
            forms[key] = (form + np.sqrt(np.outer(np.diag(form), np.diag(form))) * (noise + noise.T)).tolist()
        if _least_eigenvalue(tree) > -1e-6:
            continue
        refused += 1
        assert not verify_design(tree).holds
        if refused == 100:
            break
    assert refused == 100


def _least_eigenvalue(tree: Tree) -> float:
    """The least eigenvalue of all inequalities of the first form certificate, written out from their definition."""
    entry, rate = tree["certificates"][2], tree["rate"]
    P, Q = entry["P"], {span["node"]: np.array(span["Q"][0]) for span in entry["stays"]}
    assert len(entry["stays"]) == len(P)  # plain forms, one for each location
    P = {name: np.array(form) for name, form in P.items()}
    found = []
    for name, place in tree["system"]["locations"].items():
        F = np.array(place["A"]) - np.array(tree["gains"][name]) @ np.array(place["C"]) + rate * np.eye(2)
        E = expm(F * entry["required_dwell"])
        found += [P[name], Q[name], -(F.T @ Q[name] + Q[name] @ F), P[name] - E.T @ Q[name] @ E]
    for jump in tree["system"]["resets"]:
        R = np.array(jump["matrix"])
        found.append(Q[jump["from"]] - R.T @ P[jump["to"]] @ R)
    return min(float(np.linalg.eigvalsh(matrix).min()) for matrix in found)


def test_where_the_papers_condition_fails_and_forms_hold_the_observer_is_certified() -> None:
    system = twin()
    gains = design_gains(system, BOTH, rate=1.0, dwell=3.0)
    plain = certify_dwell(system, gains)
    needed = certified_forms(system, gains, (plain,))[0].required_dwell
    gains = replace(gains, dwell=(needed + plain.required_dwell) / 2)
    papers = (certify_dwell(system, gains), certify_sampled(system, gains, step=1e-3))
    forms = certified_forms(system, gains, papers)
    assert [entry.holds for entry in (*papers, *forms)] == [False, False, True, True]
    assert is_certified((*papers, *forms))
    assert not is_certified(papers)
