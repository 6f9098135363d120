"""The command: exit codes, keys of the JSON, messages on standard error, files whole or not at all."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from benchmarks.families import observable_from_the_end
from deshybrid.cli import main
from deshybrid.console import working
from deshybrid.diagnostics import OutOfResources

MODELS = Path("models")
FIG2, FIG3 = MODELS / "balluchi2012/fig2.yaml", MODELS / "balluchi2012/fig3.yaml"
DRIVELINE = MODELS / "balluchi2012/driveline.yaml"
BAD_MODELS, BAD_TRACES = Path("tests/unit/bad_models"), Path("tests/unit/bad_traces")


def deshybrid(*arguments: object, stdin: str = "") -> subprocess.CompletedProcess[str]:
    words = [sys.executable, "-m", "deshybrid.cli", *map(str, arguments)]
    return subprocess.run(words, capture_output=True, text=True, input=stdin, check=False)


def within(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    """Run the command in this process, where an exception that it lets through fails the test."""
    before, sys.argv = sys.argv, ["deshybrid", *map(str, arguments)]
    try:
        with pytest.raises(SystemExit) as stop:
            main()
    finally:
        sys.argv = before
    said = capsys.readouterr()
    return int(stop.value.code or 0), said.out, said.err


def rows(path: Path) -> list[list[str]]:
    lines = (line.split("#")[0].split() for line in path.read_text(encoding="utf-8").splitlines())
    return [line for line in lines if line]


def test_check_says_no_with_exit_code_1_and_the_keys_of_the_contract() -> None:
    done = deshybrid("check", FIG2, "--json")
    record = json.loads(done.stdout)
    assert done.returncode == 1
    assert list(record) == [
        "format",
        "name",
        "locations",
        "transitions",
        "alive",
        "persistent",
        "current_location_observable",
        "transient_bound",
        "c1_failures",
        "c2_failures",
        "witness",
        "method",
        "observer",
    ]
    assert record["format"] == "deshybrid-check/1"
    assert record["persistent"] == ["0", "2", "5"]
    assert record["c1_failures"] == [{"from": "2", "to": "5", "event": "d"}]
    assert record["observer"]["states"] == [["0", "1", "2", "3", "4", "5"], ["0", "2"], ["0"], ["5"], ["2"]]
    assert "error[DH0401]" in done.stderr


def test_check_says_yes_with_exit_code_0_to_a_model_on_standard_input() -> None:
    text = "format: deshybrid/1\nname: m\nlocations: [a, b]\ntransitions:\n"
    text += "  - {from: a, to: b, event: on, emits: on}\n  - {from: b, to: a, event: off, emits: off}\n"
    done = deshybrid("check", "-", stdin=text)
    assert (done.returncode, done.stderr) == (0, "")
    assert "m: current-location observable" in done.stdout


def test_check_by_pairs_gives_the_same_verdict_without_an_observer() -> None:
    record = json.loads(deshybrid("check", FIG3, "--json", "--method", "pairs").stdout)
    assert (record["method"], record["observer"], record["current_location_observable"]) == ("pairs", None, False)


OBSERVABLE = "format: deshybrid/1\nname: m\nlocations: [a, b, c]\ntransitions:\n" + "".join(
    f"  - {{from: {source}, to: {target}, event: {target}, emits: {target}}}\n" for source, target in ("ab", "bc", "ca")
)


def test_a_limit_ends_in_exit_code_3_and_what_is_known_so_far() -> None:
    done = deshybrid("check", "-", "--json", "--method", "observer", "--max-states", 2, stdin=OBSERVABLE)
    assert done.returncode == 3
    assert "error[DH0901]" in done.stderr
    assert "C1 holds, C2 is not decided" in done.stderr
    record = json.loads(done.stdout)
    assert record["current_location_observable"] is None
    assert (record["c1_failures"], record["c2_failures"], record["witness"]) == ([], [], None)
    assert record["persistent"] == ["a", "b", "c"]
    assert set(record["undecided"]) == {"reason", "pairs_seen"}


@pytest.mark.parametrize(("model", "code"), [(FIG2, "DH0401"), (FIG3, "DH0402")])
def test_a_limit_that_comes_after_the_answer_no_does_not_undo_it(model: Path, code: str) -> None:
    done = deshybrid("check", model, "--method", "observer", "--max-states", 2, "--json")
    assert done.returncode == 1
    assert f"error[{code}]" in done.stderr
    record = json.loads(done.stdout)
    assert record["current_location_observable"] is False
    assert record["witness"] is not None
    assert record["undecided"]["reason"] == "there are more than 2 observer states"


def test_less_memory_than_the_command_itself_takes_ends_in_exit_code_3() -> None:
    done = deshybrid("check", "-", "--max-memory", "1M", stdin=OBSERVABLE)
    assert (done.returncode, "error[DH0904]" in done.stderr, done.stdout) == (3, True, "")


def test_a_memory_that_is_no_size_is_a_wrong_call() -> None:
    assert deshybrid("check", FIG2, "--max-memory", "much").returncode == 2


@pytest.fixture
def usual_ctrl_c() -> Iterator[None]:
    """A test run that was started in the background may have been told to ignore it."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


@pytest.mark.usefixtures("usual_ctrl_c")
def test_ctrl_c_ends_work_with_a_message_and_the_second_time_at_once() -> None:
    with pytest.raises(OutOfResources, match="DH0905: interrupted"), working("waiting"):
        signal.raise_signal(signal.SIGINT)
    with working("waiting"):
        with suppress(OutOfResources):
            signal.raise_signal(signal.SIGINT)
        assert signal.getsignal(signal.SIGINT) == signal.SIG_DFL
    assert signal.getsignal(signal.SIGINT) == signal.default_int_handler


@pytest.mark.skipif(not Path("/proc/self/statm").exists(), reason="the fence stands on Linux only")
def test_an_allocation_beyond_all_limits_is_a_message_and_no_end_of_the_process() -> None:
    with pytest.raises(OutOfResources, match="DH0904: the memory limit was reached"), working("filling", None, 2**20):
        bytearray(2**40)
    with pytest.raises(OutOfResources, match="DH0904: the memory limit was reached"), working("filling", None, 2**20):
        bytearray(2**30)  # there would be enough, but it is not allowed


def test_recover_finds_the_signature_of_figure_2() -> None:
    done = deshybrid("recover", FIG2, "--json")
    record = json.loads(done.stdout)
    assert done.returncode == 0
    assert record["signatures"] == [
        {
            "name": "s_5",
            "location": "5",
            "transitions": [["2", "d", "5"]],
            "by": "residual",
            "feasibility": "unknown",
        }
    ]
    assert (record["recoverable"], record["already_observable"], record["optimal"]) == (True, False, True)
    assert (record["generators"], record["cost"], record["lower_bound"]) == (1, 1, 1)
    assert record["check"]["current_location_observable"] is True


def test_recover_says_no_with_the_confusion_that_remains() -> None:
    text = "format: deshybrid/1\nname: m\nlocations: [a, b]\nsignatures: {candidates: {}, forbid: []}\ntransitions:\n"
    text += "  - {from: a, to: b, event: on, emits: null}\n  - {from: b, to: a, event: off, emits: off}\n"
    done = deshybrid("recover", "-", "--json", stdin=text)
    assert done.returncode == 1
    assert json.loads(done.stdout)["recoverable"] is False
    assert "error[DH0403]" in done.stderr


def test_design_tells_the_keys_of_the_contract() -> None:
    done = deshybrid("design", DRIVELINE, "--json")
    record = json.loads(done.stdout)
    assert done.returncode == 0
    assert list(record)[:10] == [
        "gains",
        "eigenvalues",
        "condition",
        "certificates",
        "required_dwell",
        "dwell_lower_limit",
        "witness_cycle",
        "ultimate_bound",
        "detection_delay",
        "determinability",
    ]
    assert all(certificate["holds"] for certificate in record["certificates"])
    assert record["dwell_lower_limit"] <= record["required_dwell"]


@pytest.mark.parametrize("method", ["place", "lqe", "lmi"])
def test_design_says_by_which_method_gains_were_found(method: str) -> None:
    done = deshybrid("design", "models/two_tank.yaml", "--method", method, "--json")
    record = json.loads(done.stdout)
    assert (done.returncode, record["method"]) == (0, method)
    assert record["gain_sources"]["drain"] == ("lqe" if method == "lqe" else "search")
    assert ("DH0519" in done.stderr) == (method == "lmi")
    assert record["average_dwell"]["rate"] == record["rate"]


def test_compile_and_run_find_gains_by_the_method_that_design_does(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    tank, trace = "models/two_tank.yaml", tmp_path / "trace.csv"
    assert within(capsys, "compile", tank, "--method", "lqe", "-o", tmp_path / "out")[0] == 0
    made = json.loads((tmp_path / "out/design.json").read_text(encoding="utf-8"))
    assert made["gains"] == json.loads(within(capsys, "design", tank, "--method", "lqe", "--json")[1])["gains"]
    manifest = json.loads((tmp_path / "out/MANIFEST.json").read_text(encoding="utf-8"))
    assert manifest["options"]["method"] == "lqe"
    within(capsys, "simulate", tank, "--duration", 3, "-o", trace)
    estimates = [within(capsys, "run", tank, "--trace", trace, "--method", way)[1] for way in ("place", "lqe")]
    assert estimates[0] != estimates[1]
    assert estimates[0].splitlines()[0] == estimates[1].splitlines()[0]


def test_design_of_a_discrete_model_is_a_wrong_call() -> None:
    done = deshybrid("design", FIG2)
    assert done.returncode == 2
    assert "error[DH0306]" in done.stderr


def test_compile_writes_a_folder_whose_code_and_design_check_themselves(tmp_path: Path) -> None:
    done = deshybrid("compile", DRIVELINE, "-o", tmp_path / "out", "--prefix", "gear")
    assert done.returncode == 0, done.stderr
    made = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    manifest = json.loads((tmp_path / "out/MANIFEST.json").read_text(encoding="utf-8"))
    assert made == set(manifest["files"])
    wanted = {"report.html", "report.json", "des.svg", "des.dot", "observer.svg", "observer.dot", "design.json"}
    assert wanted | {"c/gear.c", "c/gear.h", "c/gear_selftest.c", "python/gear.py"} <= made
    tested = subprocess.run([sys.executable, tmp_path / "out/python/gear.py"], capture_output=True, check=False)
    assert tested.returncode == 0
    assert deshybrid("verify", tmp_path / "out").returncode == 0


def test_compile_of_a_plant_without_observer_writes_the_report_only(tmp_path: Path) -> None:
    text = "format: deshybrid/1\nname: m\nlocations: [a, b]\nsignatures: {candidates: {}}\ntransitions:\n"
    text += "  - {from: a, to: b, event: on, emits: null}\n  - {from: b, to: a, event: off, emits: off}\n"
    done = deshybrid("compile", "-", "-o", tmp_path, stdin=text)
    made = {path.name for path in tmp_path.rglob("*")}
    assert done.returncode == 1
    assert {"report.html", "report.json", "des.svg"} <= made
    assert not {"c", "python", "design.json"} & made


def remembering(folder: Path) -> Path:
    """A model of 92 locations whose observer has more than 2^12 states."""
    des = observable_from_the_end(12)
    arcs = [{"from": t.source, "event": t.event, "to": t.target, "emits": t.outputs[0]} for t in des.transitions]
    tree = {"format": "deshybrid/1", "name": "memory", "locations": list(des.locations), "initial": list(des.initial)}
    (folder / "memory.json").write_text(json.dumps({**tree, "transitions": arcs}))
    return folder / "memory.json"


def test_a_model_whose_observer_is_too_large_for_a_table_compiles_and_the_report_says_how_it_runs(
    tmp_path: Path,
) -> None:
    done = deshybrid("compile", remembering(tmp_path), "-o", tmp_path / "out", "--json")
    assert (done.returncode, done.stderr) == (0, "")
    observer = json.loads(done.stdout)["observer"]
    assert (observer["tracker"], observer["states"], observer["certified"]) == ("online", None, True)
    assert observer["tracker_reason"] == "on line, a set of up to 92 pairs; a table would have more than 2000 states"
    assert observer["cost"]["memberships"] > 0
    assert json.loads((tmp_path / "out/report.json").read_text()) == json.loads(done.stdout)
    manifest = json.loads((tmp_path / "out/MANIFEST.json").read_text())
    written = {str(path.relative_to(tmp_path / "out")) for path in (tmp_path / "out").rglob("*") if path.is_file()}
    assert set(manifest["files"]) == written
    assert not [name for name in written if "observer" in name]
    assert manifest["options"]["max_states"] == 2000
    page = (tmp_path / "out/report.html").read_text()
    assert "The location observer <b>runs on line</b>" in page
    assert f"{observer['cost']['memberships']:,}</td>" in page
    ran = subprocess.run(
        [sys.executable, tmp_path / "out/python/memory.py"], capture_output=True, text=True, check=False
    )
    assert ran.stdout == "memory: ok, 400 samples equal the reference bit for bit\n"


def test_compile_says_in_words_whether_the_observer_is_a_table(tmp_path: Path) -> None:
    table = deshybrid("compile", FIG3, "-o", tmp_path / "table").stdout
    assert "location observer: a table of 6 states, the limit is 2000" in table
    on_line = deshybrid("compile", FIG3, "-o", tmp_path / "on_line", "--max-states", 1).stdout
    assert "location observer: on line, a set of up to 5 pairs; a table would have more than 1 state" in on_line


def test_run_gives_the_same_estimates_on_line_and_by_a_table(tmp_path: Path) -> None:
    model = remembering(tmp_path)
    events = "".join(f"{tick},{event}\n" for tick, event in enumerate("0110100110012222"))
    (tmp_path / "trace.csv").write_text("time,event\n" + events)
    on_line = deshybrid("run", model, "--trace", tmp_path / "trace.csv")
    table = deshybrid("run", model, "--trace", tmp_path / "trace.csv", "--max-states", 100_000)
    assert (on_line.returncode, on_line.stderr) == (0, "")
    assert on_line.stdout == table.stdout
    assert on_line.stdout.splitlines()[-1] == "15.0,end,end,1,,identified"


def test_the_drawing_of_an_observer_that_is_too_large_still_ends_in_exit_code_3(tmp_path: Path) -> None:
    done = deshybrid("draw", remembering(tmp_path), "--what", "observer", "--max-states", 2000)
    assert done.returncode == 3
    assert "DH0901" in done.stderr


def test_figure_9_runs_from_the_command_line(tmp_path: Path) -> None:
    events = ["", "", "α", "α", "s_5", "α", "β", "δ"]
    trace = tmp_path / "fig9.csv"
    trace.write_text("time,event\n" + "".join(f"{k},{event}\n" for k, event in enumerate(events)), encoding="utf-8")
    done = deshybrid("run", FIG2, "--trace", trace)
    estimates = [line.split(",")[2] for line in done.stdout.splitlines()[1:]]
    assert done.returncode == 0
    assert estimates == ["0|1|2|3|4|5"] * 2 + ["0|2", "2", "5", "2", "0", "5"]


def test_simulate_repeats_itself_for_a_seed_and_only_for_that() -> None:
    first, again, other = (deshybrid("simulate", MODELS / "two_tank.yaml", "--seed", n).stdout for n in (3, 3, 4))
    assert first == again != other
    assert first.splitlines()[0].startswith("time,")


@pytest.mark.parametrize("kind", ["svg", "png", "pdf", "dot", "mmd", "graphml"])
def test_draw_writes_every_format_by_its_suffix(kind: str, tmp_path: Path) -> None:
    target = tmp_path / f"picture.{kind}"
    assert deshybrid("draw", FIG2, "--what", "observer", "-o", target).returncode == 0
    assert target.stat().st_size > 100


def test_a_suffix_that_is_no_drawing_is_refused_and_nothing_is_written(tmp_path: Path) -> None:
    done = deshybrid("draw", FIG2, "-o", tmp_path / "picture.doc")
    assert (done.returncode, list(tmp_path.iterdir())) == (2, [])


def test_explain_tells_of_a_code_and_proposes_the_nearest_for_a_wrong_one() -> None:
    assert "DH0401" in deshybrid("explain", "dh0401").stdout
    done = deshybrid("explain", "DH0409")
    assert (done.returncode, "did you mean" in done.stderr) == (2, True)


def test_schema_is_a_json_schema_and_new_a_model_that_compiles(tmp_path: Path) -> None:
    assert "$schema" in json.loads(deshybrid("schema").stdout)
    assert deshybrid("new", "tank", "-o", tmp_path / "tank.yaml").returncode == 0
    assert deshybrid("compile", tmp_path / "tank.yaml", "-o", tmp_path / "out").returncode == 0


@pytest.mark.parametrize(("file", "code", "line"), [row[:3] for row in rows(BAD_MODELS / "expected.txt")])
def test_a_bad_model_ends_in_exit_code_2_with_a_coded_place(
    file: str, code: str, line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    exit_code, out, err = within(capsys, "check", BAD_MODELS / file, "-o", tmp_path / "out")
    assert (exit_code, out, list(tmp_path.iterdir())) == (2, "", [])
    assert err.startswith(f"error[{code}]")
    assert f"{file}:{line}:" in err


@pytest.mark.parametrize(("name", "code", "line"), [row[:3] for row in rows(BAD_TRACES / "expected.txt")])
def test_a_bad_trace_ends_in_exit_code_2_with_a_coded_place(
    name: str, code: str, line: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    trace = BAD_TRACES / f"{name}.csv"
    exit_code, out, err = within(capsys, "run", BAD_TRACES / "model.yaml", "--trace", trace, "-o", tmp_path / "out")
    assert (exit_code, out, list(tmp_path.iterdir())) == (2, "", [])
    assert err.startswith(f"error[{code}]")
    assert f"{name}.csv:{line}:" in err


def test_a_missing_file_and_an_unknown_command_are_wrong_calls() -> None:
    assert deshybrid("check", "no_such_model.yaml").returncode == 2
    assert deshybrid("estimate", FIG2).returncode == 2
    assert deshybrid("check").returncode == 2


def test_a_link_stays_a_link_and_a_pipe_a_pipe(tmp_path: Path) -> None:
    (tmp_path / "real.json").write_text("old", encoding="utf-8")
    (tmp_path / "link.json").symlink_to(tmp_path / "real.json")
    assert deshybrid("schema", "-o", tmp_path / "link.json").returncode == 0
    assert (tmp_path / "link.json").is_symlink()
    assert "$schema" in (tmp_path / "real.json").read_text(encoding="utf-8")
    assert deshybrid("schema", "-o", "/dev/null").returncode == 0
    assert not Path("/dev/null").is_file()


@pytest.mark.parametrize("words", [["schema"], ["check", FIG2], ["explain", "DH0401"]])
def test_a_full_device_is_a_coded_message_and_a_reader_that_left_is_none(words: list[object]) -> None:
    command = " ".join([sys.executable, "-m", "deshybrid.cli", *map(str, words)])
    full = subprocess.run(["sh", "-c", f"{command} > /dev/full"], capture_output=True, text=True, check=False)
    assert (full.returncode, "error[DH0805]" in full.stderr, "Traceback" in full.stderr) == (2, True, False)
    left = subprocess.run(["sh", "-c", f"{command} | head -n 0"], capture_output=True, text=True, check=False)
    assert "Traceback" not in left.stderr
    closed = subprocess.run(["sh", "-c", f"{command} >&- <&-"], capture_output=True, text=True, check=False)
    assert "Traceback" not in closed.stderr


def test_a_folder_without_a_name_and_a_limit_without_end_are_wrong_calls(tmp_path: Path) -> None:
    assert deshybrid("compile", FIG2, "-o", "").returncode == 2
    assert deshybrid("check", FIG2, "--timeout", "inf").returncode == 2
    assert deshybrid("check", FIG2, "-o", tmp_path).returncode == 2
    assert deshybrid("check", FIG2, "-o", tmp_path / "missing" / "out").returncode == 2
    assert list(tmp_path.iterdir()) == []


def test_a_time_limit_ends_in_exit_code_3() -> None:
    done = deshybrid("recover", DRIVELINE, "--timeout", "0.001")
    assert (done.returncode, "error[DH0903]" in done.stderr) == (3, True)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("dwell: {min: 0.6, max: 5}", "dwell: {min: 1.0e+50}"),
        (
            "state: 4, input: 2, disturbance: 0.02, measurement: 0.001",
            "state: 0, input: 0, disturbance: 0, measurement: 0",
        ),
    ],
    ids=["a stay for ever", "bounds of zero"],
)
def test_extreme_numbers_that_a_model_may_state_are_designed_for(
    old: str, new: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (MODELS / "two_tank.yaml").read_text(encoding="utf-8")
    assert old in text
    (tmp_path / "model.yaml").write_text(text.replace(old, new), encoding="utf-8")
    code, out, _ = within(capsys, "design", tmp_path / "model.yaml")
    assert code == 0
    assert "ultimate bound: " in out


def test_an_observer_beyond_the_limit_is_not_drawn_although_the_answer_is_known() -> None:
    limited = ("--max-states", 1)
    assert deshybrid("check", MODELS / "two_tank.yaml", *limited).returncode == 1
    done = deshybrid("draw", MODELS / "two_tank.yaml", "--what", "observer", *limited)
    assert (done.returncode, "error[DH0901]" in done.stderr, done.stdout) == (3, True, "")
