"""Average dwell time: what it proves, against naive simulation, and who checks it."""

import copy
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from scipy.linalg import expm

from deshybrid.continuous import average
from deshybrid.continuous.average import AverageDwell, average_dwell, is_proved_average
from deshybrid.continuous.certified import paper_certificates
from deshybrid.continuous.document import design_document
from deshybrid.continuous.error import ErrorDynamics, ErrorReset
from deshybrid.continuous.gains import design_gains
from deshybrid.verify import verify_design
from tests.certificates import certified
from tests.switched import twin

Tree = dict[str, Any]
BOTH = ("p", "q")


def random_pair(seed: int, *, n: int = 2, step: float | None = None) -> ErrorDynamics:
    """Two stable locations that follow each other, with resets that stretch."""
    rng, matrices = np.random.default_rng(seed), {}
    for name in BOTH:
        F = rng.normal(size=(n, n)) * 2
        F = F - (np.linalg.eigvals(F).real.max() + 1) * np.eye(n)
        matrices[name] = F if step is None else expm(F * step)
    arcs = (BOTH, BOTH[::-1])
    return ErrorDynamics(
        BOTH, matrices, tuple(ErrorReset(*arc, rng.normal(size=(n, n)), np.zeros(n)) for arc in arcs), step
    )


def size_after(dynamics: ErrorDynamics, stays: list[float], rate: float) -> float:
    """The largest ‖error map, times e^{μ t}‖₂ at the end of one of these stays; written out."""
    whole, name, largest = np.eye(len(dynamics.matrices["p"])), "p", 0.0
    for stay in stays:
        reset, F = dynamics.exits(name)[0], dynamics.matrices[name]
        flow = expm(F * stay) if dynamics.step is None else np.linalg.matrix_power(F, round(stay / dynamics.step))
        whole = reset.matrix @ flow @ whole * np.exp(rate * stay)
        largest, name = max(largest, float(np.linalg.norm(whole, 2))), reset.target
    return largest


@pytest.mark.parametrize("step", [None, 0.05])
@pytest.mark.parametrize("seed", range(4))
def test_bursts_of_short_stays_made_up_for_by_long_ones_contract(seed: int, step: float | None) -> None:
    """N0 + t/τ transitions in every interval of length t: bursts of four, then a stay of four times τ."""
    dynamics = random_pair(seed, step=step)
    claim = average_dwell(dynamics, rate=0.3)
    assert claim is not None
    assert claim.dwell > 0
    rng, stays = np.random.default_rng(seed), []
    for _ in range(40):
        burst = [float(stay) for stay in rng.uniform(0, 0.05 * claim.dwell, 3)]
        stays += [*burst, 4 * claim.dwell]
    if step is not None:
        stays = [float(np.ceil(stay / step) * step) for stay in stays]
    ends = [np.linalg.eigvalsh(P)[[0, -1]] for P in claim.P.values()]
    spread = max(high for _, high in ends) / min(low for low, _ in ends)
    assert size_after(dynamics, stays, claim.rate) <= np.sqrt(claim.jump**4 * spread)


def test_the_same_bursts_without_long_stays_grow_where_the_dwell_time_forbids_them() -> None:
    """So the average counts: some of these systems do not contract under the short stays alone."""
    grown = 0
    for seed in range(4):
        dynamics = random_pair(seed)
        claim = average_dwell(dynamics, rate=0.3)
        assert claim is not None
        grown += size_after(dynamics, [0.02 * claim.dwell] * 40, claim.rate) > 1e3
    assert grown > 0


@pytest.mark.parametrize("seed", range(4))
def test_the_average_dwell_time_is_not_below_the_worst_cycle(seed: int) -> None:
    """Stays that are all alike have their own average: no cycle may fail above it."""
    dynamics = random_pair(seed)
    claim = average_dwell(dynamics, rate=0.3)
    assert claim is not None
    assert claim.dwell >= certified(dynamics, rate=0.3).limit.value


def test_a_scalar_location_needs_the_logarithm_of_the_jump_over_what_the_rate_leaves() -> None:
    one = np.eye(1)
    kicked = ErrorDynamics(("p",), {"p": -one}, (ErrorReset("p", "p", 4 * one, np.zeros(1)),))
    claim = average_dwell(kicked, rate=0.5)
    assert claim is not None
    assert claim.dwell == pytest.approx(np.log(4) / (claim.decay - 0.5), rel=1e-4)
    assert claim.jump == pytest.approx(16, rel=1e-4)


def test_common_forms_ask_for_no_average_dwell_time() -> None:
    one = np.eye(2)
    calm = ErrorDynamics(("p",), {"p": -one}, (ErrorReset("p", "p", 0.5 * one, np.zeros(2)),))
    claim = average_dwell(calm, rate=0.5)
    assert claim is not None
    assert claim.dwell == 0
    assert "any switching" in str(claim)


def test_a_location_no_faster_than_the_rate_has_no_average_dwell_time() -> None:
    assert average_dwell(random_pair(0), rate=1.5) is None


def test_the_solver_finds_smaller_jumps_than_the_equation_of_lyapunov(monkeypatch: pytest.MonkeyPatch) -> None:
    dynamics = random_pair(1)
    with_solver = average_dwell(dynamics, rate=0.3)
    monkeypatch.setattr(average, "has_solver", lambda: False)
    without = average_dwell(dynamics, rate=0.3)
    assert with_solver is not None
    assert without is not None
    assert with_solver.dwell < without.dwell
    assert is_proved_average(dynamics, without)


def _design() -> Tree:
    gains = design_gains(twin(), BOTH, rate=0.5, dwell=3.0)
    papers = paper_certificates(twin(), gains, step=0.01, delay=0.0)
    tree = design_document(twin(), gains, papers, average=average.average_dwell_of(twin(), gains))
    assert tree["average_dwell"] is not None
    return copy.deepcopy(tree)


def _claim(tree: Tree) -> Tree:
    claim = tree["average_dwell"]
    assert isinstance(claim, dict)
    return claim


def test_verify_proves_the_average_dwell_time() -> None:
    report = verify_design(_design())
    assert report.holds
    assert any(check.certificate == "average dwell time" for check in report.checks)


@pytest.mark.parametrize(
    "damage",
    [
        lambda claim: claim.update(dwell=0.99 * claim["dwell"]),
        lambda claim: claim.update(jump=0.8 * claim["jump"]),
        lambda claim: claim.update(rate=0.4),
        lambda claim: claim.update(decay=3 * claim["decay"]),
        lambda claim: claim["P"]["p"][0].__setitem__(0, -1.0),
        lambda claim: claim["P"].update(p=[[2 * x for x in row] for row in claim["P"]["p"]]),
    ],
)
def test_verify_refuses_a_changed_average_dwell_time(damage: Callable[[Tree], None]) -> None:
    tree = _design()
    damage(_claim(tree))
    report = verify_design(tree)
    assert not report.holds
    assert {check.certificate for check in report.checks if not check.proved} == {"average dwell time"}


def test_a_claim_that_nothing_proves_is_not_made(monkeypatch: pytest.MonkeyPatch) -> None:
    def not_proved(dynamics: ErrorDynamics, claim: AverageDwell) -> bool:
        return False

    monkeypatch.setattr(average, "is_proved_average", not_proved)
    assert average_dwell(random_pair(0), rate=0.3) is None
