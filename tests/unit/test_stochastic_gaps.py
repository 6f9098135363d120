"""Traces from which whole rows are missing: what `estimate` makes of them, and which gaps it refuses."""

import json

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.diagnostics import TraceError
from deshybrid.estimation import estimate_trace
from deshybrid.model.load import loads
from deshybrid.simulate.spacing import MOST_MISSING, mean_step, misplaced, places
from tests.unit.test_stochastic_command import FLIGHT, TURN, WALK, codes, run, trace

METHODS = ("mmae", "imm", "rmimm", "skf")
GONE = (20, 46, 47, 48, 80)  # rows of the flight that are taken out


def without_rows(tmp_path, gone=GONE):
    """The flight without some rows, and with those rows there, but nothing measured in them."""
    lines = FLIGHT.read_text().splitlines()
    cut = [line for k, line in enumerate(lines) if k - 1 not in gone]
    blank = [",".join([cells[0], "", "", *cells[3:]]) for cells in (line.split(",") for line in lines)]
    holed = [blank[k] if k - 1 in gone else line for k, line in enumerate(lines)]
    for name, kept in (("cut.csv", cut), ("holed.csv", holed)):
        (tmp_path / name).write_text("\n".join(kept) + "\n")
    return tmp_path / "cut.csv", tmp_path / "holed.csv"


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("lag", [0, 3])
def test_a_missing_row_is_a_row_in_which_nothing_was_measured(tmp_path, method, lag):
    if lag and method != "imm":
        return
    cut, holed = (estimate_trace(TURN, path, method=method, lag=lag) for path in without_rows(tmp_path, (20, 50, 51)))
    kept = np.setdiff1d(np.arange(100), (20, 50, 51))
    for name in ("x", "P", "mu", "log_likelihood", "nis", "channels"):
        np.testing.assert_array_equal(getattr(cut.estimates, name), getattr(holed.estimates, name)[kept], err_msg=name)
    assert cut.log_likelihood == pytest.approx(holed.log_likelihood, abs=1e-9)
    assert cut.consistency.freedom == holed.consistency.freedom == 2 * 97
    assert cut.consistency.total == pytest.approx(holed.consistency.total, rel=1e-12)


def test_missing_rows_are_told_and_the_rows_of_the_estimates_are_those_of_the_trace(tmp_path):
    cut, _ = without_rows(tmp_path)
    done = run("estimate", TURN, "--trace", cut, "-o", tmp_path / "out.csv")
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.splitlines()[1] == "missing: 5 rows in 3 gaps, predicted only"
    times = [[line.split(",")[0] for line in path.read_text().splitlines()] for path in (cut, tmp_path / "out.csv")]
    assert times[0][0] == times[1][0] == "time"
    assert [float(time) for time in times[0][1:]] == [float(time) for time in times[1][1:]]
    record = json.loads(run("estimate", TURN, "--trace", cut, "--json").stderr)
    assert (record["rows"], record["missing_rows"]) == (95, 5)
    assert record["score"]["right"] > 0.9


def test_a_whole_trace_has_no_missing_rows(tmp_path):
    made = estimate_trace(TURN, FLIGHT)
    assert made.record()["missing_rows"] == 0
    assert "missing" not in str(made)


def test_the_input_and_the_known_location_before_a_gap_are_held_over_it(tmp_path):
    text = WALK.replace("output: [y]", "output: [y]\ninput: [u]").replace("C: [[1]]", "C: [[1]], B: [[1]]")
    made = estimate_trace(
        loads(text), trace(tmp_path, "time,y,u,true_location\n0,1,2,wild\n1,1,2,wild\n4,,0,calm\n"), method="skf"
    )
    before, after = made.estimates.x[1, 0], made.estimates.x[2, 0]
    assert after == pytest.approx(before + 3 * 2.0)
    assert made.estimates.P[2, 0, 0] == pytest.approx(made.estimates.P[1, 0, 0] + 2 * 9.0 + 0.1)


def test_a_model_in_continuous_time_is_sampled_at_the_step_of_the_rows_that_follow_each_other(tmp_path):
    text = WALK.replace("time: {step: 1}\n", "").replace("A: [[1]]", "A: [[0]]")
    halved = WALK.replace("[[9]]", "[[4.5]]").replace("[[0.1]]", "[[0.05]]").replace("step: 1", "step: 0.5")
    rows = "time,y\n0,1\n0.5,2\n1.0,2\n3.0,4\n3.5,4\n"
    continuous, sampled = (estimate_trace(loads(model), trace(tmp_path, rows)) for model in (text, halved))
    np.testing.assert_allclose(continuous.estimates.x, sampled.estimates.x, rtol=1e-12)
    assert continuous.gaps == sampled.gaps == (3,)


@pytest.mark.parametrize(
    "rows",
    [
        "0,1\n1,1\n2,1\n3.5,1\n4.5,1\n6.5,1\n",  # half a step late
        "0,1\n1,1\n2,1\n2.1,1\n5,1\n",  # two rows at once
        "0,1\n2,1\n4,1\n6,1\n",  # another step
        "0,1\n1000,1\n2000,1\n",  # milliseconds
        f"0,1\n1,1\n2,1\n{MOST_MISSING + 4},1\n",
    ],
)
def test_gaps_that_are_no_whole_rows_are_refused_with_their_place(tmp_path, rows):
    with pytest.raises(TraceError) as caught:
        estimate_trace(loads(WALK), trace(tmp_path, "time,y\n" + rows))
    assert codes(caught) == ["DH0322"]
    assert caught.value.diagnostics[0].span is not None


def test_a_gap_of_ten_thousand_missing_rows_is_the_longest_of_a_short_trace():
    time = np.array([0.0, 1.0, 2.0, MOST_MISSING + 3.0])
    assert misplaced(time, 1.0, missing_rows=True) is None
    assert misplaced(time + np.array([0.0, 0.0, 0.0, 1.0]), 1.0, missing_rows=True).row == 3


def naive_places(time, step):
    """Each row at the whole number of steps that is nearest to its time, counted from the first."""
    return [round((t - time[0]) / step) for t in time]


@given(seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_rows_of_a_jittering_clock_from_which_some_are_missing_keep_their_places(seed):
    rng = np.random.default_rng(seed)
    step, count = float(10.0 ** rng.uniform(-3, 1)), int(rng.integers(4, 40))
    kept = np.sort(rng.permutation(count)[: count - rng.integers(0, count // 4 + 1)])
    exact = kept - kept[0]
    time = step * (exact + rng.uniform(-0.1, 0.1, len(kept)))
    if 2 * (np.diff(kept) == 1).sum() < len(kept) - 1:
        return
    assert mean_step(time) == pytest.approx(step, rel=0.2 / exact[-1])
    assert misplaced(time, step, missing_rows=True) is None
    assert places(time, step).tolist() == exact.tolist() == naive_places(step * exact, step)
