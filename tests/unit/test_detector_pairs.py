"""Pairs of locations that a detector has to tell apart: which, how fast, and where they may be confused."""

import numpy as np
import pytest

from deshybrid import compiler
from deshybrid.des.automaton import DES
from deshybrid.des.candidates import Candidate
from deshybrid.des.signatures import recover_observability
from deshybrid.detector.pairs import PairSeparation, compared_pairs, confusion_warnings, separations
from deshybrid.diagnostics import UsageError
from deshybrid.model.abstraction import abstract
from deshybrid.model.load import load, loads
from deshybrid.plans import answer

BOILER = """\
format: deshybrid/1
name: boiler
state: [water, wall]
input: [draw]
output: [water]
bounds: {state: 100, input: 1, measurement: 0.5}
defaults:
  C: [[1, 0]]
  B: [[-0.1], [0]]
  A: [[-0.1, 0.08], [0.0002, -0.0002]]
locations: {off: {f: [0, 0]}, low: {f: [0.2, 0]}, high: {f: [0.4, 0]}}
transitions:
  - {from: off, to: low, event: a}
  - {from: off, to: high, event: b}
  - {from: low, to: off, event: c}
  - {from: high, to: off, event: d}
observer: {step: 1, dwell: 60}
"""


def pairs_of(text: str) -> dict[tuple[str, str], PairSeparation]:
    system = loads(text)
    return {(pair.first, pair.second): pair for pair in separations(system, abstract(system))}


def test_pairs_are_those_of_a_target_and_what_may_happen_instead() -> None:
    assert list(pairs_of(BOILER)) == [("off", "low"), ("off", "high"), ("low", "high")]


def test_an_output_that_tells_two_targets_apart_needs_no_residual() -> None:
    des = DES.from_transitions([("1", "a", "2", "α"), ("1", "b", "3", "β")])
    assert compared_pairs(des) == (("1", "2"), ("1", "3"))


def test_a_slow_wall_that_nothing_measures_hides_the_firing_level_of_the_boiler() -> None:
    """Always distinguishable in theory; within a minute a colder wall looks like a weaker fire, to half a degree."""
    pairs = pairs_of(BOILER)
    for pair in pairs.values():
        assert pair.verdict == "always"
        assert pair.may_be_confused
        assert (pair.absorbed_by, pair.seconds) == ("wall", None)
    assert pairs["off", "high"].typical == pytest.approx(2 * pairs["off", "low"].typical)


def test_a_measured_wall_tells_the_firing_levels_apart_and_quickly() -> None:
    seen = BOILER.replace("output: [water]", "output: [water, wall]").replace("C: [[1, 0]]", "C: [[1, 0], [0, 1]]")
    pairs = pairs_of(seen.replace("measurement: 0.5", "measurement: 0.05"))
    assert not any(pair.may_be_confused for pair in pairs.values())
    assert all(pair.seconds is not None and pair.seconds <= 32.0 for pair in pairs.values())


def test_the_boiler_is_warned_about_by_recover_and_the_hardest_pair_comes_first() -> None:
    found = compiler.recover(loads(BOILER))
    (warning,) = found.diagnostics
    assert (warning.code, warning.severity) == ("DH0611", "warning")
    assert "3 pairs" in warning.message
    assert "`wall`" in warning.notes[0]
    typical = [pair.typical for pair in sorted(found.pairs, key=lambda pair: pair.typical)]
    assert [f"{value:.3g}" in note for value, note in zip(typical, warning.notes, strict=True)] == [True] * 3


def test_without_a_measurement_bound_only_the_verdict_counts() -> None:
    pairs = pairs_of(BOILER.replace(", measurement: 0.5", ""))
    assert not any(pair.noise or pair.may_be_confused for pair in pairs.values())


def test_a_model_in_discrete_time_has_the_distances_of_its_own_steps() -> None:
    text = BOILER.replace("name: boiler", "name: boiler\ntime: {step: 1}").replace(
        "[[-0.1, 0.08], [0.0002, -0.0002]]", "[[0.9, 0.08], [0.0002, 0.9998]]"
    )
    there, here = pairs_of(text)["off", "low"], pairs_of(BOILER)["off", "low"]
    assert there.typical == pytest.approx(here.typical, rel=0.1)


def test_more_time_tells_more() -> None:
    short, long = (pairs_of(BOILER.replace("dwell: 60", f"dwell: {d}"))["off", "low"].typical for d in (60, 600))
    assert long > 3 * short


def test_recover_lists_every_pair_in_its_json_and_the_hardest_in_its_text() -> None:
    found = answer("models/balluchi2012/driveline.yaml", max_states=1000)
    pairs = found.record()["pairs"]
    assert isinstance(pairs, list)
    assert len(pairs) == 21
    hardest = min(pairs, key=lambda pair: pair["typical"])
    assert hardest["locations"] == ["q4", "q5"]
    assert "hardest to tell apart within 0.9 s: q4 and q5" in str(found)


def test_a_discrete_model_has_no_pairs_and_no_line_about_them() -> None:
    found = compiler.recover("models/balluchi2012/fig2.yaml")
    assert found.pairs == ()
    assert "hardest" not in str(found)


FORK = [("1", "a", "2", "α"), ("1", "a", "3", "α"), ("2", "b", "1", "β"), ("3", "b", "1", "β")]


@pytest.mark.parametrize(("confusions", "chosen"), [((0.2, 0.1), "s_3"), ((0.1, 0.2), "s_2"), ((0.0, 0.0), "s_2")])
def test_among_plans_of_one_cost_the_one_that_is_confused_least_is_taken(
    confusions: tuple[float, float], chosen: str
) -> None:
    both = (
        Candidate("s_2", "2", (0,), negation=False, confusion=confusions[:1]),
        Candidate("s_3", "3", (1,), negation=False, confusion=confusions[1:]),
    )
    plan = recover_observability(DES.from_transitions(FORK), both)
    assert [signature.name for signature in plan.signatures] == [chosen]
    assert plan.optimal
    assert plan.fewest


def test_confusion_never_outweighs_the_cost_of_a_generator() -> None:
    both = (
        Candidate("s_2", "2", (0,), cost=1.0, negation=False, confusion=(1.0,)),
        Candidate("s_3", "3", (1,), cost=1.1, negation=False, confusion=(0.0,)),
    )
    assert recover_observability(DES.from_transitions(FORK), both).generators == ("2",)


def test_confusions_that_do_not_fit_the_transitions_are_refused() -> None:
    with pytest.raises(UsageError, match="DH0406"):
        recover_observability(DES.from_transitions(FORK), (Candidate("s_2", "2", (0,), confusion=(0.1, 0.2)),))


def test_recover_prefers_the_location_that_is_further_from_its_rivals() -> None:
    """`near` differs from `here` by a tenth of what `far` does; either signature would do, at one cost."""
    text = """\
format: deshybrid/1
name: fork
state: [x]
output: [y]
bounds: {state: 1, measurement: 0.1}
defaults: {C: [[1]]}
locations: {here: {A: [[-1]]}, near: {A: [[-1.1]]}, far: {A: [[-2]]}}
transitions:
  - {from: here, to: near, event: a, emits: go}
  - {from: here, to: far, event: a, emits: go}
  - {from: near, to: here, event: b, emits: back}
  - {from: far, to: here, event: b, emits: back}
signatures: {candidates: {near: {by: residual}, far: {by: residual}}}
"""
    assert [s.name for s in compiler.recover(loads(text)).plan.signatures] == ["s_far"]


def test_pairs_are_confused_where_the_noise_hides_them_and_told_by_their_typical_distance() -> None:
    tank = load("models/two_tank.yaml")
    (pair,) = separations(tank, abstract(tank))
    assert pair.may_be_confused  # x = 0 in one of the two states shows nothing
    assert np.isfinite(pair.typical)
    assert confusion_warnings(()) == ()


LAGS = """\
format: deshybrid/1
name: lags
state: [x]
input: [u]
output: [y]
bounds: {state: 10, input: 2, measurement: 0.1}
defaults: {B: [[1]], C: [[5]]}
locations: {slow: {A: [[-0.5]]}, fast: {A: [[-2]]}}
transitions: [{from: slow, to: fast, event: a, emits: null}, {from: fast, to: slow, event: b, emits: null}]
"""


def test_the_gap_of_two_lags_is_that_of_their_shares_of_full_scale() -> None:
    """2 * 5/50 / (s + a): the chordal distance at ω = 0 of the gains 0.4 and 0.1, the largest."""
    (pair,) = pairs_of(LAGS).values()
    chordal = 0.3 / np.sqrt(1 + 0.4**2) / np.sqrt(1 + 0.1**2)
    assert pair.nu_gap == pytest.approx(chordal, rel=1e-5)
    assert pair.record()["nu_gap"] == pair.nu_gap
    millimetres = LAGS.replace("C: [[5]]", "C: [[5000]]").replace("measurement: 0.1", "measurement: 100")
    (again,) = pairs_of(millimetres).values()
    assert again.nu_gap == pytest.approx(pair.nu_gap, rel=1e-6)


def test_locations_that_differ_in_constants_only_have_no_gap_and_without_inputs_there_is_none_to_speak_of() -> None:
    assert all(pair.nu_gap == 0.0 for pair in pairs_of(BOILER).values())
    (silent,) = pairs_of(LAGS.replace("input: [u]\n", "").replace(", input: 2", "").replace("B: [[1]], ", "")).values()
    assert silent.nu_gap is None


def test_the_gap_of_sampled_locations_is_taken_on_the_unit_circle() -> None:
    """1/(z - a): the largest chordal distance at z = 1, where the gains are 2 * 5/50/(1 - a)."""
    text = LAGS.replace("state: [x]", "time: {step: 0.1}\nstate: [x]").replace("-0.5", "0.5").replace("-2", "0")
    (pair,) = pairs_of(text).values()
    assert pair.nu_gap == pytest.approx(0.2 / np.sqrt(1 + 0.4**2) / np.sqrt(1 + 0.2**2), rel=1e-5)
