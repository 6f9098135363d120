"""The measured car: its model, how its logs are read, and what detector and ratio comparison reach on the two drives.

The drives are not part of the project; where they are missing, the tests that need them are skipped.
"""

import sys
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from deshybrid.compiler import compile
from deshybrid.simulate.replay import replay
from deshybrid.simulate.trace import parse_trace

ROOT = Path(__file__).parents[2]
MODEL = ROOT / "models" / "measured" / "ralliart.yaml"
sys.path.insert(0, str(MODEL.parent))
from identify import IN_MODEL, PARAMETERS, Fit, fit, main, model_value, report, stretches, with_values  # noqa: E402
from ralliart_log import Drive, ratio_names, read_log, score_gears, trace_text  # noqa: E402

DATA = ROOT.parent / "shared" / "data" / "ralliart"
LOGS = {"run2": DATA / "run2_wot_manual_shift.csv", "run3": DATA / "run3_wot_auto_shift.csv"}
needs_data = pytest.mark.skipif(
    not all(log.exists() for log in LOGS.values()), reason="the measured drives are not here"
)


@pytest.fixture(scope="module")
def compilation():
    return compile(MODEL)


@pytest.fixture(scope="module")
def drives():
    return {name: read_log(log) for name, log in LOGS.items()}


@pytest.fixture(scope="module")
def scores(compilation, drives):
    found = {}
    for name, drive in drives.items():
        estimates = replay(compilation.observer, parse_trace(trace_text(drive), compilation.design.system))
        found[name] = score_gears(drive, estimates.location)
    return found


def _drive(gears, ratio, *, shaft=200.0):
    n = len(gears)
    wheel = np.full(n, shaft / 4.062)
    return Drive("made", 0.01 * np.arange(n), np.zeros(n), np.array(ratio) * shaft, wheel, np.array(gears))


def test_the_car_needs_a_signature_for_every_gear_and_a_negation_for_the_rest(compilation):
    recovery = compilation.design.recovery
    assert len(recovery.check.c1_failures) == 14
    assert recovery.plan.generators == ("q1", "q2", "q3", "q4", "q5", "q6", "qR")
    assert [s.location for s in recovery.plan.signatures if s.by == "negation"] == ["qN"]


def test_stays_of_a_sixth_of_a_second_are_certified_without_a_delay_and_not_with_one(compilation):
    holds = {certificate.theorem: certificate.holds for certificate in compilation.design.certificates}
    assert holds["B12-6"]
    assert not holds["B12-7"]


def test_a_log_is_read_at_the_previous_value_of_a_regular_grid(tmp_path):
    header = "t_s,engine_torque_nm,engine_rpm,output_shaft_rpm,gear_actual,clutch_closed,lever"
    rows = ["5.0,10,600,100,2,1,5", "5.0109,20,1200,200,2,0,5", "5.0199,30,1800,300,1,1,7"]
    log = tmp_path / "log.csv"
    log.write_text("\n".join([header, *rows]), encoding="utf-8")
    drive = read_log(log)
    assert drive.time.tolist() == [0.0, 0.01]
    assert drive.torque.tolist() == [10.0, 10.0]
    assert drive.crank[0] == pytest.approx(20.0 * np.pi)
    assert drive.wheel[0] * 4.062 == pytest.approx(100.0 * 2.0 * np.pi / 60.0)
    assert drive.location == ["q2", "q2"]
    assert read_log(log, step=0.005).location == ["q2", "q2", "q2", "qN"]


def test_a_closed_clutch_with_the_lever_at_reverse_is_reverse(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text(
        "t_s,engine_torque_nm,engine_rpm,output_shaft_rpm,gear_actual,clutch_closed,lever\n0,0,0,0,1,1,7", "utf-8"
    )
    assert read_log(log).location == ["qR"]


def test_a_log_without_a_needed_column_is_refused(tmp_path):
    log = tmp_path / "log.csv"
    log.write_text("t_s,engine_rpm\n0,1\n", encoding="utf-8")
    with pytest.raises(ValueError, match="no column clutch_closed"):
        read_log(log)


def test_the_ratio_comparison_names_a_gear_after_eighty_milliseconds_in_its_band():
    named = ratio_names(_drive([0] * 30, [3.0] * 5 + [2.39] * 15 + [3.0] * 10))
    assert named == ("qN",) * 13 + ("q2",) * 15 + ("qN",) * 2


def test_a_name_before_a_closing_is_early_and_not_false():
    drive = _drive([0] * 100 + [2] * 50, [3.0] * 150)
    named = ["q3"] * 20 + ["qN"] * 60 + ["q2"] * 70
    found = score_gears(drive, named)
    assert found.closings == ((1.0, "q2", 0.5, -0.2),)
    assert found.false == pytest.approx(0.20)
    assert found.right == 1.0
    assert found.wrong == 0.0


def test_a_gear_never_named_has_no_delay_and_another_name_is_wrong():
    found = score_gears(_drive([0] * 10 + [2] * 40, [3.0] * 50), ["qN"] * 30 + ["q1"] * 20)
    assert found.delays() == [None]
    assert found.wrong == pytest.approx(0.5)
    assert found.false == 0.0


@needs_data
def test_the_drives_never_go_from_gear_to_gear_without_the_slipping_clutch(drives):
    for drive in drives.values():
        gears = [gear for _, _, gear in drive.stays()]
        assert all(0 in pair for pair in pairwise(gears))


@needs_data
@pytest.mark.parametrize("run", LOGS)
def test_every_closing_of_the_measured_car_is_named_within_a_quarter_of_a_second(scores, run):
    delays = scores[run].delays(0.3)
    assert len(delays) == {"run2": 5, "run3": 3}[run]
    assert all(delay is not None and delay <= 0.25 for delay in delays)


@needs_data
@pytest.mark.parametrize("run", LOGS)
def test_the_wrong_gear_is_named_in_less_than_one_percent_of_closed_samples(scores, run):
    assert scores[run].wrong < 0.01


@needs_data
@pytest.mark.parametrize("run", LOGS)
def test_the_detector_is_right_more_often_and_false_less_often_than_the_ratio_comparison(scores, drives, run):
    bar = score_gears(drives[run], ratio_names(drives[run]))
    assert scores[run].right > bar.right
    assert scores[run].false < bar.false


@needs_data
def test_the_figures_written_down_for_the_measured_car_are_those_of_this_detector(scores, drives):
    text = (ROOT / "docs" / "decisions" / "0002-driveline-numbers.md").read_text(encoding="utf-8")
    rows = {}
    for run, drive in drives.items():
        rows[f"{run}, ratio comparison"] = score_gears(drive, ratio_names(drive))
        rows[f"{run}, this detector"] = scores[run]
    for name, found in rows.items():
        delays = ", ".join(f"{delay:+.2f}".replace("-", "−") for delay in found.delays())
        assert f"| {name} | {100 * found.right:.2f} % | 0 | {100 * found.false:.1f} % | {delays} |" in text


@needs_data
def test_the_score_command_of_the_script_prints_the_figures_of_the_ratio_comparison(capsys):
    assert main(["score", str(LOGS["run2"])]) == 0
    assert "right 98.13 %, wrong gear 0.00 % of closed samples" in capsys.readouterr().out


def test_fitted_numbers_and_their_errors_are_put_where_the_model_states_them():
    text = MODEL.read_text(encoding="utf-8")
    values = {p.name: 2.0 for p in PARAMETERS} | {"k_shaft": 1234.567}
    result = Fit(values, dict.fromkeys(values, 0.125), 0.0)
    changed = with_values(text, result)
    assert "\n  k_shaft: 1234.6         # ± 0.12, N m/rad at the wheels\n" in changed
    assert [before for before, after in zip(text.split("\n"), changed.split("\n"), strict=True) if before != after] == [
        line for line in text.split("\n") if " # ± " in line
    ]
    assert with_values(changed, result) == changed
    assert "k_shaft" in report(result, text)


@needs_data
@pytest.mark.campaign
def test_the_numbers_of_the_model_are_what_the_identification_finds(drives):
    text = MODEL.read_text(encoding="utf-8")
    result = fit(stretches(list(drives.values())))
    written = [name for name in IN_MODEL if model_value(text, name) is not None]
    assert len(written) == 10
    for name in written:
        assert abs(model_value(text, name) - result.values[name]) < 0.05 * result.errors[name]
