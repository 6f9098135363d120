"""The engine numba beside numpy: the same estimates for any system, holes, inputs and number of trials."""

import numpy as np
import pytest

from deshybrid.diagnostics import UsageError
from deshybrid.stochastic.examples import calm_and_wild
from deshybrid.stochastic.record import estimate
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem
from tests.strategies import drawn_record, random_stochastic_system

pytest.importorskip("numba", reason="numba is not installed")
COLUMNS = ("x", "P", "mu", "log_likelihood", "nis", "channels")


@pytest.mark.parametrize("method", ["imm", "mmae"])
def test_numba_agrees_with_numpy_to_nine_digits_on_40_random_systems(method):
    for seed in range(40):
        rng = np.random.default_rng(seed)
        system = random_stochastic_system(rng)
        trials = [(), (5,), (2, 9), (0,)][seed % 4]
        z, u = drawn_record(rng, system, trials)
        ours, theirs = (estimate(system, z, u, method=method, engine=engine) for engine in ("numba", "numpy"))
        for name in COLUMNS:
            expected = getattr(theirs, name)
            scale = max(1.0, np.abs(expected).max(initial=0.0))
            np.testing.assert_allclose(getattr(ours, name), expected, rtol=0, atol=1e-9 * scale, err_msg=name)


def test_numba_knows_modes_that_cannot_be_entered_and_measurements_far_out():
    system = calm_and_wild()
    chain = ModeTransition(system.names, [[1.0, 1.0], [0.0, 0.0]])
    locked = StochasticSystem(system.modes, chain, x=system.x, P=system.P, mu=[1.0, 0.0])
    z = np.array([[0.1], [1e4], [np.nan], [0.3]])
    for one in (system, locked):
        ours, theirs = (estimate(one, z, engine=engine) for engine in ("numba", "numpy"))
        for name in COLUMNS:
            np.testing.assert_allclose(getattr(ours, name), getattr(theirs, name), rtol=1e-9, atol=1e-9)


def test_what_numba_cannot_filter_is_refused_in_the_words_of_numpy():
    with pytest.raises(UsageError) as caught:
        estimate(calm_and_wild(), [[1e250], [1.0]], method="mmae", engine="numba")
    assert caught.value.diagnostics[0].code == "DH1108"
    blind = Mode("blind", F=[[1.0]], H=[[0.0]], Q=[[1.0]], R=[[0.0]])
    system = StochasticSystem([blind], ModeTransition(["blind"], [[1.0]]), x=[0.0], P=[[1.0]], mu=[1.0])
    with pytest.raises(UsageError) as caught:
        estimate(system, [[1.0]], engine="numba")
    assert caught.value.diagnostics[0].code == "DH1105"


def test_the_residual_mean_filter_has_no_compiled_form():
    with pytest.raises(UsageError) as caught:
        estimate(calm_and_wild(), [[1.0]], method="rmimm", engine="numba")
    assert caught.value.diagnostics[0].code == "DH1109"
