"""The gate beside a naive one, and the way back of a filter that a gate has locked out."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.stats import chi2

from deshybrid.estimation import estimate_trace
from deshybrid.model.load import loads
from deshybrid.stochastic.belief import Belief
from deshybrid.stochastic.gating import PATIENCE, Gate
from deshybrid.stochastic.multiple import predict_imm, update
from deshybrid.stochastic.record import estimate, estimate_known
from deshybrid.stochastic.sample import sample
from tests.naive_filters import skipping_imm
from tests.property.test_stochastic_filters import tracking
from tests.strategies import drawn_record, random_stochastic_system
from tests.unit.test_stochastic_command import WALK, trace

seeds = st.integers(0, 2**32 - 1)


def run(system, z, method, gate):
    """Every filter of a record by its name."""
    if method == "skf":
        return estimate_known(system, z, np.zeros(z.shape[:-1], dtype=int), gate=gate)
    if method == "roots":
        return estimate(system, z, gate=gate, engine="roots")
    return estimate(system, z, method=method, gate=gate)


METHODS = ("imm", "mmae", "rmimm", "roots", "skf")


@pytest.mark.parametrize("method", ["imm", "mmae"])
def test_numba_leaves_out_and_takes_the_rows_of_numpy_on_30_random_systems(method):
    pytest.importorskip("numba", reason="numba is not installed")
    for seed in range(30):
        rng = np.random.default_rng(seed)
        system = random_stochastic_system(rng)
        z, u = drawn_record(rng, system, (3, 7), rows=20)
        z[:, :, 8:] += rng.choice([0.0, 30.0], (3, 7, 1, 1))
        z[0, 0, 4:6] = np.nan
        gate = float(rng.choice([0.5, 0.99]))
        ours, theirs = (
            estimate(system, z, u, method=method, gate=gate, engine=engine) for engine in ("numba", "numpy")
        )
        for name in ("gated", "readmitted", "channels"):
            np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name), err_msg=name)
        for name in ("x", "P", "mu", "log_likelihood", "nis"):
            wanted = getattr(theirs, name)
            scale = max(1.0, np.abs(wanted).max())
            np.testing.assert_allclose(getattr(ours, name), wanted, rtol=0, atol=1e-9 * scale, err_msg=name)


@given(seed=seeds, probability=st.sampled_from([0.3, 0.9, 0.999]))
@settings(max_examples=15, deadline=None)
def test_the_gated_filter_is_the_naive_one_that_skips_rows_and_gives_in_after_some(seed, probability):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    p = system.bank.H.shape[1]
    z = rng.choice([1.0, 8.0], (3, 16, 1)) * rng.standard_normal((3, 16, p))
    z[:, rng.integers(0, 16)] = np.nan
    u = rng.standard_normal((3, 16, system.bank.B.shape[2]))
    made = estimate(system, z, u, gate=probability)
    for trial in range(3):
        rows = [None if np.isnan(row).any() else row for row in z[trial]]
        limit = chi2.ppf(probability, p)
        x, P, mu, log_likelihood, fate = skipping_imm(system, rows, u[trial], limit=limit, patience=PATIENCE)
        np.testing.assert_array_equal(made.gated[trial] + 2 * made.readmitted[trial], fate)
        for name, wanted in (("x", x), ("P", P), ("mu", mu), ("log_likelihood", log_likelihood)):
            scale = max(1.0, np.abs(wanted).max())
            np.testing.assert_allclose(getattr(made, name)[trial], wanted, rtol=0, atol=1e-8 * scale, err_msg=name)


@given(seed=seeds, method=st.sampled_from(METHODS), jump=st.sampled_from([5.0, 1e2, 1e4]))
@settings(max_examples=25, deadline=None)
def test_after_a_jump_no_gate_locks_a_filter_out(seed, method, jump):
    """Whatever jumps and however low the gate: no six rows in a row are left out."""
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng, plain=True)
    z = rng.standard_normal((2, 40, system.bank.H.shape[1]))
    z[:, 15:] += jump
    made = run(system, z, method, float(rng.choice([0.05, 0.9, 0.9999])))
    out = np.pad(made.gated.astype(int), ((0, 0), (1, 1)))
    for row in out:
        edges = np.flatnonzero(np.diff(row))
        assert (edges[1::2] - edges[::2] <= PATIENCE).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("jump", [1e2, 1e3, 1e5])
def test_after_a_jump_the_gated_filter_ends_where_the_one_without_a_gate_does(method, jump):
    system = tracking()
    z = sample(system, 120, seed=3, modes=[0] * 120).z.copy()
    z[60:] += jump
    gated, free = run(system, z, method, 0.999), run(system, z, method, None)
    assert gated.gated[60 : 60 + PATIENCE].all()
    assert gated.readmitted[60 + PATIENCE]
    assert not gated.gated[-10:].any()
    np.testing.assert_allclose(gated.x[-1], free.x[-1], atol=4.0 * np.sqrt(np.diagonal(free.P[-1]).max()))


def test_single_outliers_are_left_out_as_before_and_none_is_readmitted():
    system = tracking()
    z = sample(system, 60, seed=4, modes=[0] * 60).z.copy()
    z[10::10] += 30.0
    made = estimate(system, z, gate=0.9999)
    assert np.flatnonzero(made.gated).tolist() == list(range(10, 60, 10))
    assert not made.readmitted.any()


def test_one_measurement_at_a_time_with_a_gate_gives_the_record():
    system = tracking()
    z = sample(system, 60, seed=5).z.copy()
    z[30:] += 50.0
    made, belief, gate = estimate(system, z, gate=0.99), Belief.prior(system), Gate.of(1, 0.99)
    for k, row in enumerate(z):
        posterior = update(system, predict_imm(system, belief), row, gate=gate)
        belief, gate = posterior.belief, posterior.judgement.gate
        assert bool(posterior.judgement.gated) == made.gated[k]
        assert bool(posterior.judgement.readmitted) == made.readmitted[k]
    np.testing.assert_allclose(belief.mean, made.x[-1], rtol=1e-12)
    assert made.readmitted.any()


def test_a_missing_row_neither_closes_the_gate_nor_opens_it():
    gate, far, nothing = Gate.of(1, 0.9), np.array([1.0]), np.array([np.nan])
    for z in (far, nothing, far, nothing, nothing, far):
        gate = gate.judge(np.array([100.0 if z is far else 0.0]), np.zeros(1), z).gate
    assert int(gate.count) == 3


def test_rows_that_were_taken_beyond_the_gate_are_told(tmp_path):
    rows = [f"{k},{0.1 * (-1) ** k + 1000 * (k >= 6)}" for k in range(20)]
    made = estimate_trace(loads(WALK), trace(tmp_path, "\n".join(["time,y", *rows, ""])), gate=0.9999)
    record = made.record()
    assert record["outliers"] == [7, 8, 9, 10, 11]
    assert record["readmitted"][0] == 12
    taken = len(record["readmitted"])
    told = f"outliers: 5 rows beyond the gate of 0.9999, left out; {taken} more taken, as 5 in a row had been left out"
    assert told in str(made)
    assert abs(made.estimates.x[-1, 0] - 1000.0) < 1.0
