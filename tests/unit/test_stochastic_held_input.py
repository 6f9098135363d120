"""Known inputs in `analyse`: held at numbers, told in the answer, the same as a filter that is given them in rows."""

import json
from functools import cache

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.analysis.whole import Question, analyse
from deshybrid.diagnostics import UsageError
from deshybrid.model.load import loads
from deshybrid.stochastic.held_input import hold_input
from deshybrid.stochastic.record import estimate
from deshybrid.stochastic.telling_apart import Window
from tests.strategies import random_stochastic_system
from tests.unit.test_stochastic_analysis import run

PUSHED = """
format: deshybrid/1
name: pushed
time: {step: 1}
state: [x]
input: [u, v]
output: [y]
bounds: {input: 1}
defaults: {A: [[0.5]], C: [[1]]}
locations: {ahead: {B: [[1, 0]]}, back: {B: [[-1, 0]]}}
transition_probability: {ahead: {ahead: 0.95, back: 0.05}, back: {ahead: 0.05, back: 0.95}}
noise: {process: [[0.01]], measurement: [[0.1]]}
prior: {mean: [0], covariance: [[1]]}
"""


@cache
def asked(**inputs):
    return analyse(loads(PUSHED), Question(Window(40), inputs=tuple(inputs.items())))


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=15, deadline=None)
def test_a_filter_of_held_inputs_is_the_filter_that_is_given_them_in_every_row(seed):
    rng = np.random.default_rng(seed)
    system = random_stochastic_system(rng)
    held = rng.standard_normal(system.bank.B.shape[2])
    z = rng.standard_normal((10, system.bank.H.shape[1]))
    ours, theirs = estimate(hold_input(system, held), z), estimate(system, z, np.tile(held, (10, 1)))
    for name in ("x", "P", "mu", "log_likelihood"):
        wanted = getattr(theirs, name)
        np.testing.assert_allclose(getattr(ours, name), wanted, rtol=0, atol=1e-9 * max(1.0, np.abs(wanted).max()))


def test_modes_that_differ_in_the_effect_of_an_input_are_told_apart_where_it_acts():
    still, pushed = asked(), asked(u=1.0)
    assert [d.code for d in still.observability.diagnostics] == ["DH1202", "DH1203", "DH1203"]
    assert pushed.observability.diagnostics == ()
    assert not any(found.told for found in still.detection.residuals)
    assert all(found.told for found in pushed.detection.residuals)


def test_delays_are_predicted_and_drawn_under_the_held_input():
    """Means 2 apart on either side, with a deviation of a third: the new mode is named within three rows."""
    for pair in asked(u=1.0).detection.switches:
        for found in pair:
            assert found.foreseen is not None
            assert found.foreseen <= 3
            assert found.median <= 3


def test_inputs_as_held_are_told_and_none_where_the_model_has_none():
    assert asked(v=2.0).record()["inputs"] == {"u": 0.0, "v": 2.0}
    told = "inputs held at u = 0, v = 2 where modes are told apart and delays predicted"
    assert str(asked(v=2.0)).splitlines()[0] == told
    still = PUSHED.replace("input: [u, v]\n", "").replace("B: [[1, 0]]", "").replace("B: [[-1, 0]]", "f: [1]")
    made = analyse(loads(still.replace("bounds: {input: 1}\n", "")), Question(Window(10)))
    assert made.record()["inputs"] == {}
    assert "inputs" not in str(made)


def test_the_command_holds_inputs_by_name(tmp_path):
    (tmp_path / "pushed.yaml").write_text(PUSHED)
    words = ("analyse", tmp_path / "pushed.yaml", "--window", "40", "--json")
    done = run(*words, "--input", "u=1", "--input", "v=-2.5")
    assert json.loads(done.stdout)["inputs"] == {"u": 1.0, "v": -2.5}
    assert "DH1202" not in done.stderr


@pytest.mark.parametrize("word", ["w=1", "u", "u=", "u=nan", "=1", "u=1_0"])
def test_an_input_that_is_not_there_or_has_no_number_is_refused(tmp_path, word):
    (tmp_path / "pushed.yaml").write_text(PUSHED)
    done = run("analyse", tmp_path / "pushed.yaml", "--input", word)
    assert (done.returncode, "error[DH1209]" in done.stderr, done.stdout) == (2, True, "")


def test_an_input_of_another_length_is_refused():
    with pytest.raises(UsageError) as caught:
        hold_input(random_stochastic_system(np.random.default_rng(0), plain=True), [1.0])
    assert caught.value.diagnostics[0].code == "DH1107"
