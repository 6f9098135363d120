"""Scores on runs small enough to count by hand."""

import json

import numpy as np
import pytest

from deshybrid.linear.dynamics import LinearDynamics
from deshybrid.model.system import HybridSystem, Location
from deshybrid.simulate.replay import EstimateTrace
from deshybrid.simulate.score import _norms, score, score_locations
from deshybrid.simulate.trace import Trace

TIME = [0.1 * i for i in range(20)]


def _names(text: str) -> list[str | None]:
    """One letter per sample; a point is `not known`."""
    return [None if char == "." else char for char in text]


def _score(truth: str, said: str, **options):
    return score_locations(TIME[: len(truth)], _names(truth), _names(said), **options)


def test_naming_after_the_entry_is_a_positive_delay():
    result = _score("aaaaabbbbb", "aaaaaaabbb")
    assert result.delays == pytest.approx((0.2,))
    assert (result.total.right, result.total.wrong, result.total.unnamed) == (8, 2, 0)
    assert result.total.wrong_among_named == pytest.approx(0.2)


def test_naming_before_the_entry_is_a_negative_delay():
    assert _score("aaaaabbbbb", "aaabbbbbbb").delays == pytest.approx((-0.2,))


def test_early_naming_counts_only_where_it_holds_until_the_entry():
    assert _score("aaaaabbbbb", "aabb.bbbbb").delays == pytest.approx((0.0,))
    assert _score("aaaaabbbbb", "aabba.bbbb").delays == pytest.approx((0.1,))


def test_early_naming_is_looked_for_within_the_lead_only():
    assert _score("aaaaaaaabbbb", "abbbbbbbbbbb", lead=0.3).delays == pytest.approx((-0.3,))


def test_early_naming_never_reaches_into_the_previous_stay_in_the_same_location():
    result = _score("aaaaabbaaaa", "aaaaaaaaaaa")
    assert [e.location for e in result.engagements] == ["a"]
    assert result.delays == pytest.approx((-0.2,))


def test_location_never_named_during_its_stay_is_missed():
    result = _score("aaabbbbaaaa", "aaa....aaaa")
    assert [(e.location, e.delay) for e in result.engagements] == [("b", None), ("a", pytest.approx(0.0))]
    assert (result.total.missed, result.total.late) == (1, 0)
    assert result.quantile(0.5) == pytest.approx(0.0)
    assert result.quantile(0.9) is None
    assert result.worst[0].location == "b"


def test_delay_beyond_the_limit_is_late_and_one_at_the_limit_is_not():
    assert _score("aaaaabbbbbbb", "aaaaa...bbbb", limit=0.25).total.late == 1
    assert _score("aaaaabbbbbbb", "aaaaa...bbbb", limit=0.3).total.late == 0


def test_short_stays_and_the_first_stay_are_no_engagements():
    result = _score("aaaaabbccccc", "aaaaabbccccc", minimum_stay=0.3)
    assert [e.location for e in result.engagements] == ["c"]


def test_entry_from_unknown_truth_is_no_engagement_and_unknown_truth_is_not_scored():
    result = _score("aa...bbbbbcccc", "aaaaabbbbbcccc")
    assert [e.location for e in result.engagements] == ["c"]
    assert result.total.samples == 11


def test_only_restricts_samples_and_engagements_to_the_named_locations():
    result = _score("nnnn1111nnnn2222", "nnnn.111nnnn1112", only=("1", "2"))
    assert [t.name for t in result.tallies] == ["1", "2"]
    assert (result.total.samples, result.total.right, result.total.wrong, result.total.unnamed) == (8, 4, 3, 1)
    assert result.delays == pytest.approx((0.1, 0.3))


def test_tallies_add_up_to_the_total():
    result = _score("aaaaabbbbbcccc", "aa.aabbb.bacca")
    for part in ("samples", "right", "wrong", "unnamed", "engagements", "missed"):
        assert sum(getattr(t, part) for t in result.tallies) == getattr(result.total, part)
    assert all(t.right + t.wrong + t.unnamed == t.samples for t in result.tallies)


def test_sequences_of_unequal_length_are_refused():
    with pytest.raises(ValueError, match="2 times"):
        score_locations([0.0, 1.0], ["a"], ["a", "a"])


def _system() -> HybridSystem:
    dynamics = LinearDynamics(*(np.zeros(s) for s in ((2, 2), (2, 0), (0, 2), (0, 0), (2, 2), (2,), (0,))))
    return HybridSystem("toy", (Location("a", dynamics), Location("b", dynamics)), (), ("a",), state_names=("x", "v"))


def _estimates(trace: Trace, location, identified, state) -> EstimateTrace:
    rows = len(trace)
    return EstimateTrace(trace, location, (("a",),) * rows, identified, (None,) * rows, ("ok",) * rows, state)


def test_state_errors_are_root_mean_squares_over_all_and_over_identified_samples():
    truth = np.array([[0.0, 1.0], [0.0, np.nan], [0.0, 1.0], [0.0, 1.0]])
    trace = Trace(_system(), TIME[:4], np.zeros((4, 0)), np.zeros((4, 0)), (), tuple("aabb"), truth)
    state = np.array([[3.0, 1.0], [-4.0, 9.0], [0.0, 1.0], [1.0, 1.5]])
    x, v = score(trace, _estimates(trace, tuple("aabb"), (False, False, True, True), state)).states
    assert (x.rms, x.largest) == pytest.approx((np.sqrt(26 / 4), 4.0))
    assert (x.rms_identified, x.largest_identified) == pytest.approx((np.sqrt(0.5), 1.0))
    assert (v.rms, v.largest) == pytest.approx((np.sqrt(0.25 / 3), 0.5))


def test_score_is_readable_and_goes_into_json():
    trace = Trace(_system(), TIME[:8], np.zeros((8, 0)), np.zeros((8, 0)), (), tuple("aaaabbbb"), np.zeros((8, 2)))
    location = ("a",) * 4 + (None,) * 3 + ("b",)
    result = score(trace, _estimates(trace, location, (False,) * 8, np.ones((8, 2))))
    assert "late: b entered at 0.400 s, named 0.300 s later" in str(result)
    assert "the location is never known" in str(result)
    record = json.loads(json.dumps(result.record()))
    assert record["locations"]["total"]["late"] == 1
    assert [row["state"] for row in record["states"]] == ["x", "v"]


def test_trace_without_truth_is_not_scored_and_says_so():
    trace = Trace(_system(), TIME[:2], np.zeros((2, 0)), np.zeros((2, 0)))
    result = score(trace, _estimates(trace, ("a", "a"), (True, True), np.zeros((2, 2))))
    assert result.locations is None
    assert str(result) == "the trace has no truth to score against"


def test_errors_whose_squares_overflow_are_scored_all_the_same():
    assert _norms(np.array([3e200, -4e200, 0.0, 0.0])) == (pytest.approx(2.5e200), 4e200)
    assert _norms(np.zeros(3)) == (0.0, 0.0)
