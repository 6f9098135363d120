"""The keys of `noise` beside covariances: how a model states them, and how `estimate` and others take them."""

import numpy as np
import pytest

from deshybrid.analysis_command import analyse
from deshybrid.bundle import Wishes
from deshybrid.diagnostics import DeshybridError, ModelError, UsageError
from deshybrid.estimation import estimate_trace
from deshybrid.filter_bundle import files
from deshybrid.model.load import loads
from deshybrid.simulate.chance import Chance
from deshybrid.stochastic.from_model import stochastic_system

MODEL = """
format: deshybrid/1
name: late
parameters: {late: 0.2}
time: {step: 1}
state: [p, v]
output: [seen, speed]
defaults: {A: [[1, 1], [0, 1]], C: [[1, 0], [0, 1]]}
locations:
  calm: {}
  odd: {noise: {tails: {share: 0.5, factor: 4}, process_by_state: [[0, 0], [0, 0.1]]}}
  blind: {output: [speed], C: [[0, 1]]}
transition_probability: {calm: {odd: 1}, odd: {blind: 1}, blind: {calm: 1}}
noise:
  process: [[0.1, 0], [0, 0.1]]
  measurement: [[1, 0], [0, 2]]
  measurement_by_state: [[0, late], [0, 0]]
  tails: {share: 0.05, factor: 100}
prior: {mean: [0, 1], covariance: [[1, 0], [0, 1]]}
"""


def changed(old: str, new: str) -> str:
    assert old in MODEL
    return MODEL.replace(old, new)


def test_a_location_writes_its_own_form_of_the_noise_and_takes_the_rest_from_the_head():
    calm, odd, blind = stochastic_system(loads(MODEL)).modes
    assert (calm.noise.share, calm.noise.factor, calm.noise.process_by_state) == (0.05, 100.0, None)
    assert (odd.noise.share, odd.noise.factor) == (0.5, 4.0)
    assert odd.noise.process_by_state.tolist() == [[0.0, 0.0], [0.0, 0.1]]
    for mode, late in ((calm, [[0.0, 0.2], [0.0, 0.0]]), (odd, [[0.0, 0.2], [0.0, 0.0]]), (blind, [[0.0, 0.0]])):
        assert mode.noise.measurement_by_state.tolist() == late


def test_the_bank_has_zeros_where_a_mode_has_no_such_noise():
    bank = stochastic_system(loads(MODEL)).bank
    assert bank.tails.tolist() == [[0.05, 100.0], [0.5, 4.0], [0.05, 100.0]]
    assert bank.process_by_state[:, 1, 1].tolist() == [0.0, 0.1, 0.0]
    assert bank.measurement_by_state.shape == (3, 2, 2)


@pytest.mark.parametrize(
    ("old", "new", "code", "line"),
    [
        ("tails: {share: 0.05, factor: 100}", "tails: {share: 1.5, factor: 100}", "DH0124", 18),
        ("tails: {share: 0.05, factor: 100}", "tails: {share: 0.05, factor: 0.5}", "DH0124", 18),
        ("tails: {share: 0.05, factor: 100}", "tails: {share: 0.05}", "DH0112", 18),
        ("[[0, late], [0, 0]]", "[[0, late]]", "DH0203", 17),
        ("process_by_state: [[0, 0], [0, 0.1]]", "process_by_state: [[0, 0, 1]]", "DH0203", 11),
    ],
)
def test_a_form_of_the_noise_that_is_none_is_refused_at_its_line(old, new, code, line):
    with pytest.raises(ModelError) as caught:
        loads(changed(old, new))
    (found,) = caught.value.diagnostics
    assert (found.code, found.span.line) == (code, line)


def test_estimate_takes_the_noise_of_the_model(tmp_path):
    """One row, the location known: a residual of variance 1 + 1 + 0.1 + 1 + 0.04 (v² + its variance), with tails."""
    trace = tmp_path / "trace.csv"
    trace.write_text("time,seen,speed,true_location\n0,50,,calm\n", encoding="utf-8")
    done = estimate_trace(loads(MODEL), trace, method="skf").estimates
    grown = 0.04 * (1.0 + 1.1)
    good, bad = 2.1 + 1.0 + grown, 2.1 + 100.0 * (1.0 + grown)
    densities = [w * np.exp(-0.5 * 49.0**2 / S) / np.sqrt(2 * np.pi * S) for w, S in ((0.95, good), (0.05, bad))]
    assert done.log_likelihood[0] == pytest.approx(np.log(sum(densities)), abs=1e-9)
    weight = densities[1] / sum(densities)
    assert done.x[0, 0] == pytest.approx(1.0 + 2.1 * 49.0 * ((1 - weight) / good + weight / bad), rel=1e-9)


@pytest.mark.parametrize(
    "call",
    [
        analyse,
        lambda path: files(str(path), "skf", Wishes()),
        lambda path: Chance(loads(path.read_text()), 1, 1.0),
    ],
)
def test_what_cannot_take_it_refuses_it(call, tmp_path):
    path = tmp_path / "late.yaml"
    path.write_text(changed("  blind: {output: [speed], C: [[0, 1]]}\n", "  blind: {}\n"), encoding="utf-8")
    with pytest.raises(DeshybridError) as caught:
        call(path)
    assert {found.code for found in caught.value.diagnostics} == {"DH1120"}


def test_process_noise_by_the_state_is_refused_in_continuous_time_and_the_rest_is_not():
    text = changed("time: {step: 1}\n", "")
    with pytest.raises(UsageError) as caught:
        stochastic_system(loads(text), step=1.0)
    assert caught.value.diagnostics[0].code == "DH1120"
    kept = text.replace(", process_by_state: [[0, 0], [0, 0.1]]", "")
    assert stochastic_system(loads(kept), step=1.0).modes[0].noise.share == 0.05
