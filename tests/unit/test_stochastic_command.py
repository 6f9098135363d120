"""The command `estimate`, from the file of a model to the columns of its estimates; and what it refuses."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from deshybrid.diagnostics import DeshybridError, ModelError, TraceError, UsageError
from deshybrid.estimation import estimate_trace
from deshybrid.model.load import load, loads
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.record import estimate, estimate_known
from deshybrid.stochastic.sample import sample

ROOT = Path(__file__).parents[2]
TURN, FLIGHT = ROOT / "models/hwang2006/turn.yaml", ROOT / "models/hwang2006/turn.csv"
HEADER = "time,location,p_CV,p_CT,x1_hat,v1_hat,x2_hat,v2_hat"
WALK = """
format: deshybrid/1
name: walk
time: {step: 1}
state: [x]
output: [y]
defaults: {A: [[1]], C: [[1]]}
locations: {calm: {}, wild: {noise: {process: [[9]]}}}
transition_probability: {calm: {calm: 0.9, wild: 0.1}, wild: {calm: 0.2, wild: 0.8}}
noise: {process: [[0.1]], measurement: [[1]]}
prior: {mean: [0], covariance: [[1]]}
"""


def run(*words: str | Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [sys.executable, "-m", "deshybrid.cli", *map(str, words)], capture_output=True, text=True, check=False
    )


def codes(caught) -> list[str]:
    return [d.code for d in caught.value.diagnostics]


def trace(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "trace.csv"
    path.write_text(text)
    return path


def test_estimate_writes_the_columns_of_the_contract_and_prints_the_log_likelihood(tmp_path):
    done = run("estimate", TURN, "--trace", FLIGHT, "--method", "imm", "-o", tmp_path / "out.csv")
    assert (done.returncode, done.stderr) == (0, "")
    lines = (tmp_path / "out.csv").read_text().splitlines()
    assert lines[0] == HEADER
    assert len(lines) == 1 + 100
    first = done.stdout.splitlines()[0]
    made = estimate_trace(TURN, FLIGHT)
    assert first == f"log-likelihood: {made.log_likelihood:.6f} over 100 rows (imm)"


def test_the_most_probable_location_of_a_row_is_that_of_its_largest_probability():
    rows = [line.split(",") for line in estimate_trace(TURN, FLIGHT).csv().splitlines()[1:]]
    for _, location, straight, turning, *_ in rows:
        assert location == ("CV" if float(straight) >= float(turning) else "CT")
        assert float(straight) + float(turning) == pytest.approx(1.0, abs=1e-12)


def test_json_goes_to_standard_error_where_the_estimates_go_to_standard_output():
    done = run("estimate", TURN, "--trace", FLIGHT, "--json")
    assert done.stdout.startswith(HEADER)
    record = json.loads(done.stderr)
    assert record["log_likelihood"] == estimate_trace(TURN, FLIGHT).log_likelihood
    assert [switch["row"] for switch in record["score"]["switches"]] == [45, 56]


def test_the_flight_of_the_page_is_the_one_its_script_draws():
    namespace = {"__file__": str(TURN.parent / "turn_trace.py"), "__name__": "script"}
    exec(compile((TURN.parent / "turn_trace.py").read_text(), "turn_trace.py", "exec"), namespace)
    drawn = namespace["flight"](seed=2006)
    kept = estimate_trace(TURN, FLIGHT).trace
    np.testing.assert_allclose(drawn.outputs, kept.outputs, rtol=1e-12)
    assert drawn.true_location == kept.true_location


def test_interacting_filters_see_the_switches_of_the_example_before_independent_ones_do():
    """Section 4.3 of the paper reports 1 and 2 rows for IMM, 6 and 10 for MMAE; over 200 flights, median of each."""
    system = stochastic_system(load(TURN))
    modes = np.array([int(45 <= k < 56) for k in range(100)])
    z = sample(system, 100, seed=7, trials=(200,), modes=modes).z
    medians = {}
    for method in ("imm", "mmae"):
        named = estimate(system, z, method=method).most_probable
        delays = [[1 + int(np.argmax(row[a:b] == m)) for a, b, m in ((45, 56, 1), (56, 100, 0))] for row in named]
        medians[method] = np.median(delays, axis=0)
    assert (medians["imm"] <= 2).all()
    assert (medians["mmae"] >= 5).all()


def test_knowing_the_location_is_worth_more_than_guessing_it():
    system = stochastic_system(load(TURN))
    runs = sample(system, 60, seed=8, trials=(100,))
    known, guessed = estimate_known(system, runs.z, runs.modes), estimate(system, runs.z)
    errors = [float(((made.x - runs.x) ** 2).mean()) for made in (known, guessed)]
    assert errors[0] < errors[1]


def test_the_truth_moves_no_estimate_but_that_of_skf(tmp_path):
    lines = FLIGHT.read_text().splitlines()
    width = 4  # time, y1, y2, event
    bare = trace(tmp_path, "\n".join(",".join(line.split(",")[:width]) for line in lines) + "\n")
    for method in ("imm", "mmae"):
        assert estimate_trace(TURN, bare, method=method).csv() == estimate_trace(TURN, FLIGHT, method=method).csv()
    with pytest.raises(TraceError) as caught:
        estimate_trace(TURN, bare, method="skf")
    assert codes(caught) == ["DH1106"]


def test_an_empty_output_is_predicted_only(tmp_path):
    full = estimate_trace(loads(WALK), trace(tmp_path, "time,y\n0,1\n1,2\n2,3\n"))
    holed = estimate_trace(loads(WALK), trace(tmp_path, "time,y\n0,1\n1,\n2,3\n"))
    assert holed.estimates.x[1, 0] == pytest.approx(full.estimates.x[0, 0])
    assert holed.estimates.log_likelihood[1] == pytest.approx(0.0, abs=1e-12)
    assert holed.consistency.freedom == 2


def test_a_trace_without_any_measurement_is_pure_prediction(tmp_path):
    made = estimate_trace(loads(WALK), trace(tmp_path, "time,y\n0,\n1,\n"))
    assert (made.log_likelihood, made.consistency.freedom) == (pytest.approx(0.0, abs=1e-12), 0)
    assert "NIS" not in str(made)
    assert made.record()["nis"] is None


@pytest.mark.parametrize(
    ("old", "new", "lacking"),
    [
        ("transition_probability: {calm: {calm: 0.9, wild: 0.1}, wild: {calm: 0.2, wild: 0.8}}",
         "transitions: [{from: calm, to: wild, event: a}, {from: wild, to: calm, event: b}]", "transition_probability"),
        ("noise: {process: [[0.1]], measurement: [[1]]}\n", "noise: {process: [[0.1]]}\n", "measurement"),
        ("prior: {mean: [0], covariance: [[1]]}", "prior: {mean: [0]}", "prior: covariance"),
    ],
)  # fmt: skip
def test_a_model_that_lacks_a_part_is_refused_by_the_name_of_the_part(tmp_path, old, new, lacking):
    assert old in WALK
    with pytest.raises(ModelError) as caught:
        estimate_trace(loads(WALK.replace(old, new)), trace(tmp_path, "time,y\n0,1\n"))
    assert set(codes(caught)) == {"DH1101"}
    assert lacking in str(caught.value)


@pytest.mark.parametrize(
    ("text", "code"),
    [
        ("time,y\n0,1\n1,x\n", "DH0318"),
        ("time,z\n0,1\n", "DH0314"),
        ("time,y\n0,1\n2,1\n", "DH0322"),
        ("time,y,true_location\n0,1,calm\n1,2,\n", "DH1106"),
    ],
)
def test_a_bad_trace_ends_in_a_coded_message_and_exit_code_2(tmp_path, text, code):
    (tmp_path / "walk.yaml").write_text(WALK)
    done = run("estimate", tmp_path / "walk.yaml", "--trace", trace(tmp_path, text), "--method", "skf")
    assert done.returncode == 2
    assert f"error[{code}]" in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""


def test_a_discrete_model_has_nothing_to_filter(tmp_path):
    with pytest.raises(UsageError) as caught:
        estimate_trace(ROOT / "models/balluchi2012/fig2.yaml", trace(tmp_path, "time,event\n0,\n"))
    assert codes(caught) == ["DH0306"]


def test_modes_that_measure_different_outputs_are_refused_by_imm_and_taken_by_skf(tmp_path):
    text = WALK.replace("output: [y]", "output: [y, z]").replace("C: [[1]]", "C: [[1], [1]]")
    text = text.replace("measurement: [[1]]", "measurement: [[1, 0], [0, 1]]")
    text = text.replace("calm: {}", "calm: {output: [y], C: [[1]], noise: {measurement: [[1]]}}")
    rows = "time,y,z,true_location\n0,1,2,wild\n1,2,,calm\n"
    for method in ("imm", "mmae"):
        with pytest.raises(DeshybridError) as caught:
            estimate_trace(loads(text), trace(tmp_path, rows), method=method)
        assert codes(caught) == ["DH1103"]
    made = estimate_trace(loads(text), trace(tmp_path, rows), method="skf")
    assert made.estimates.channels.tolist() == [2.0, 1.0]


def test_measurements_without_any_noise_are_refused(tmp_path):
    text = WALK.replace("measurement: [[1]]", "measurement: [[0]]").replace("C: [[1]]", "C: [[0]]")
    with pytest.raises(UsageError) as caught:
        estimate_trace(loads(text), trace(tmp_path, "time,y\n0,1\n"))
    assert codes(caught) == ["DH1105"]


def test_a_model_in_continuous_time_is_that_of_its_sampled_numbers(tmp_path):
    """An integrator of white noise: over h its variance grows by the intensity times h."""
    text = WALK.replace("time: {step: 1}\n", "").replace("A: [[1]]", "A: [[0]]")
    rows = "time,y\n0,1\n0.5,2\n1.0,2\n"
    halved = WALK.replace("[[9]]", "[[4.5]]").replace("[[0.1]]", "[[0.05]]").replace("step: 1", "step: 0.5")
    continuous, sampled = (estimate_trace(loads(model), trace(tmp_path, rows)) for model in (text, halved))
    np.testing.assert_allclose(continuous.estimates.x, sampled.estimates.x, rtol=1e-12)
    np.testing.assert_allclose(continuous.estimates.P, sampled.estimates.P, rtol=1e-12)


def test_rows_that_are_not_equally_spaced_are_refused_in_continuous_time(tmp_path):
    text = WALK.replace("time: {step: 1}\n", "").replace("A: [[1]]", "A: [[0]]")
    with pytest.raises(TraceError) as caught:
        estimate_trace(loads(text), trace(tmp_path, "time,y\n0,1\n0.5,2\n1,2\n9.25,2\n"))
    assert codes(caught) == ["DH0322"]
    assert "8.25 s after the row before, expected 0.5 s" in str(caught.value)


def test_the_six_state_example_has_the_matrices_of_section_5():
    """F of both modes and Q = Γ Γᵀ times a variance, as printed; T = 1."""
    straight, turning = stochastic_system(load(ROOT / "models/hwang2006/maneuver.yaml")).modes
    blocks = [np.array([[1, 1, 0], [0, 1, 0], [0, 0, 0]]), np.array([[1, 1, 0.5], [0, 1, 1], [0, 0, 1]])]
    inputs = [np.array([0.5, 1, 0]), np.array([0.5, 1, 1])]
    for mode, block, gamma, deviation in zip((straight, turning), blocks, inputs, (0.5, 5.0), strict=True):
        np.testing.assert_array_equal(mode.F, np.kron(np.eye(2), block))
        np.testing.assert_allclose(mode.Q, deviation**2 * np.kron(np.eye(2), np.outer(gamma, gamma)), rtol=1e-15)


def test_estimate_takes_every_method_of_the_contract():
    for method in ("mmae", "imm", "rmimm", "skf"):
        done = run("estimate", TURN, "--trace", FLIGHT, "--method", method)
        assert done.returncode == 0
        assert done.stdout.startswith(HEADER)
        assert f"({method})" in done.stderr
    assert run("estimate", TURN, "--trace", FLIGHT, "--method", "best").returncode == 2


def test_an_engine_gives_the_estimates_of_numpy_and_is_named_in_the_record(tmp_path):
    pytest.importorskip("numba")
    expected = estimate_trace(TURN, FLIGHT)
    for engine in ("numba", "roots"):
        done = run("estimate", TURN, "--trace", FLIGHT, "--engine", engine, "--json", "-o", tmp_path / "out.csv")
        record = json.loads(done.stdout)
        assert record["engine"] == engine
        assert record["log_likelihood"] == pytest.approx(expected.log_likelihood, rel=1e-12)
        made = [line.split(",")[4:] for line in (tmp_path / "out.csv").read_text().splitlines()[1:]]
        np.testing.assert_allclose(np.array(made, dtype=float), expected.estimates.x, rtol=0, atol=1e-7)


@pytest.mark.parametrize(
    ("engine", "words"),
    [
        ("numba", ("--method", "skf")),
        ("roots", ("--lag", "3")),
        ("roots", ("--method", "mmae")),
        ("numba", ("--method", "rmimm")),
    ],
)
def test_what_an_engine_does_not_run_is_refused(engine, words):
    done = run("estimate", TURN, "--trace", FLIGHT, "--engine", engine, *words)
    assert (done.returncode, "error[DH1109]" in done.stderr, done.stdout) == (2, True, "")


@pytest.mark.parametrize("method", ["mmae", "imm", "rmimm", "skf"])
@pytest.mark.parametrize(
    "rows", ["0,1e250,calm\n1,1,calm\n", "0,,calm\n" + "".join(f"{k},,calm\n" for k in range(1, 9))]
)
def test_numbers_that_overflow_end_in_a_coded_message_and_no_warning(tmp_path, method, rows):
    text = WALK.replace("A: [[1]]", "A: [[1e20]]") if rows.startswith("0,,") else WALK
    with pytest.raises(UsageError) as caught:
        estimate_trace(loads(text), trace(tmp_path, "time,y,true_location\n" + rows), method=method)
    assert codes(caught) == ["DH1108"]


@pytest.mark.parametrize("method", ["mmae", "imm", "rmimm", "skf"])
def test_an_outlier_beyond_the_gate_counts_as_missing_and_is_told(tmp_path, method):
    rows = [f"{k},{0.1 * (-1) ** k},calm" for k in range(12)]
    hit, holed = (
        "\n".join(["time,y,true_location", *rows[:6], f"6,{cell},calm", *rows[7:], ""]) for cell in ("1000", "")
    )
    expected = estimate_trace(loads(WALK), trace(tmp_path, holed), method=method)
    made = estimate_trace(loads(WALK), trace(tmp_path, hit), method=method, gate=0.9999)
    np.testing.assert_array_equal(made.estimates.x, expected.estimates.x)
    np.testing.assert_array_equal(made.estimates.mu, expected.estimates.mu)
    assert made.record()["outliers"] == [7]
    assert made.consistency == expected.consistency
    assert "outliers: 1 rows beyond the gate of 0.9999" in str(made)


def test_a_row_that_one_mode_explains_is_no_outlier(tmp_path):
    """5 is 4.5 standard deviations from what `calm` expects, 1.5 from what `wild` expects."""
    made = estimate_trace(loads(WALK), trace(tmp_path, "time,y\n0,0\n1,5\n"), gate=0.999)
    assert not made.estimates.gated.any()


@pytest.mark.parametrize("gate", ["0", "1", "1.5", "nan"])
def test_a_gate_that_is_no_probability_is_refused(gate):
    done = run("estimate", TURN, "--trace", FLIGHT, "--gate", gate)
    assert (done.returncode, "DH1111" in done.stderr) == (2, True)


def test_events_that_no_filter_reads_are_told(tmp_path):
    (tmp_path / "walk.yaml").write_text(WALK)
    done = run("estimate", tmp_path / "walk.yaml", "--trace", trace(tmp_path, "time,y,event\n0,1,\n1,2,press\n2,1,x\n"))
    assert done.returncode == 0
    assert "warning[DH1110]: no filter reads the events of the trace; there are 2, the first in row 2" in done.stderr


@pytest.mark.parametrize("method", ["mmae", "imm", "rmimm", "skf"])
def test_the_row_in_which_a_filter_fails_is_named(tmp_path, method):
    text = "time,y,true_location\n0,1,calm\n1,2,calm\n2,1e250,calm\n3,1,calm\n"
    with pytest.raises(UsageError) as caught:
        estimate_trace(loads(WALK), trace(tmp_path, text), method=method)
    assert caught.value.diagnostics[0].message.startswith("row 3: ")


def test_hindsight_dates_the_switches_of_the_flight_better(tmp_path):
    late, dated = (estimate_trace(TURN, FLIGHT, lag=lag).truth for lag in (0, 3))
    assert [switch.delay for switch in late.switches] == [2, 2]
    assert [switch.delay for switch in dated.switches] == [2, 1]
    assert all(after[1] < 0.75 * before[1] for before, after in zip(late.rms, dated.rms, strict=True))
    done = run("estimate", TURN, "--trace", FLIGHT, "--lag", "3", "--method", "mmae")
    assert (done.returncode, "DH1112" in done.stderr) == (2, True)


def test_nees_says_how_many_rows_lie_in_the_band_of_one_row():
    score = estimate_trace(TURN, FLIGHT).record()["score"]
    assert 0.9 < score["nees_within_95"] <= 1.0


def test_the_plot_shows_probabilities_residuals_and_states_and_is_the_same_for_the_same_trace(tmp_path):
    pytest.importorskip("matplotlib")
    for name in ("a.svg", "b.svg"):
        done = run(
            "estimate", TURN, "--trace", FLIGHT, "--gate", "0.99", "--plot", tmp_path / name, "-o", tmp_path / "out"
        )
        assert (done.returncode, done.stderr) == (0, "")
    first = (tmp_path / "a.svg").read_text()
    assert first == (tmp_path / "b.svg").read_text()
    for text in ("probability", "NIS, 1 expected", "turn: imm", "CV", "CT", "x1", "v2", "estimate", "true"):
        assert f">{text}<" in first, text


def test_what_the_model_lacks_is_told_before_the_trace_is_read(tmp_path):
    done = run("estimate", ROOT / "models/balluchi2012/driveline.yaml", "--trace", tmp_path / "none.csv")
    assert done.returncode == 2
    assert "DH1101" in done.stderr
    assert "DH0310" not in done.stderr


def test_one_row_in_continuous_time_has_no_step_and_is_refused(tmp_path):
    text = WALK.replace("time: {step: 1}\n", "").replace("A: [[1]]", "A: [[0]]")
    with pytest.raises(UsageError) as caught:
        estimate_trace(loads(text), trace(tmp_path, "time,y\n0,1\n"))
    assert codes(caught) == ["DH0601"]


@pytest.mark.parametrize("rows", [1, 20], ids=["one row", "many rows"])
def test_a_flight_without_any_switch_is_scored(tmp_path, rows):
    straight = trace(tmp_path, "\n".join(FLIGHT.read_text().splitlines()[: 1 + rows]) + "\n")
    done = run("estimate", TURN, "--trace", straight, "-o", tmp_path / "out.csv")
    assert (done.returncode, done.stderr) == (0, "")
    assert estimate_trace(TURN, straight).truth.switches == ()


def test_a_true_state_of_absurd_size_is_scored_without_overflow(tmp_path):
    lines = FLIGHT.read_text().splitlines()
    cells = lines[5].split(",")
    lines[5] = ",".join([*cells[:5], "1e308", *cells[6:]])
    done = run("estimate", TURN, "--trace", trace(tmp_path, "\n".join(lines) + "\n"), "--json")
    assert done.returncode == 0
    score = json.loads(done.stderr)["score"]
    assert score["rms"]["x1"] == pytest.approx(1e308 / np.sqrt(100), rel=1e-12)
    assert score["nees"] is None


def test_normal_scores_are_told_for_mixtures_alone(tmp_path):
    made = estimate_trace(TURN, FLIGHT)
    told = made.record()["normal_scores"]
    assert told == {"sum": made.calibration.total, "freedom": 200, "band_95": list(made.calibration.band)}
    assert f"normal scores: {made.calibration}" in str(made)
    holed = trace(tmp_path, "time,y\n0,1\n1,\n2,3\n")
    assert estimate_trace(loads(WALK), holed).calibration.freedom == 2
    for method, gate in (("skf", None), ("rmimm", None), ("imm", 0.99)):
        other = estimate_trace(TURN, FLIGHT, method=method, gate=gate)
        assert other.record()["normal_scores"] is None
        assert "normal scores" not in str(other)
