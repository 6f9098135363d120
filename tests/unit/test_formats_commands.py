"""A plain automaton, in a file of another tool, through every command; no model file is needed."""

import json
import random
import sys
from pathlib import Path

import pytest

import deshybrid as dh
from deshybrid import cli
from deshybrid.des.automaton import DES
from deshybrid.diagnostics import UsageError
from deshybrid.formats.document import Document
from deshybrid.formats.reading import read_system
from deshybrid.formats.table import FORMATS, write_text
from deshybrid.model.abstraction import abstract, discrete_model
from tests.strategies import living, random_des

# the silent jam is an exit of a persistent location
PRESS = DES.from_transitions(
    [("idle", "start", "busy", "start"), ("busy", "stop", "idle", "stop"), ("busy", "jam", "idle", None)],
    initial=["idle"],
    name="press",
)
SUFFIXES = {"yaml": ".yaml", "json": ".json", "fsm": ".fsm", "gen": ".gen", "att": ".att", "dot": ".dot"}
SUFFIXES |= {"graphml": ".graphml", "mealy": ".mealy.txt"}
KERNEL = """digraph state_automaton {
\t{node [shape = plaintext, style=invis, label=""] "__init_preemptive"};
\t{node [shape = doublecircle] "preemptive"};
\t"__init_preemptive" -> "preemptive";
\t"preemptive" -> "non_preemptive" [ label = "preempt_disable" ];
\t"non_preemptive" -> "non_preemptive" [ label = "sched_waking" ];
\t"non_preemptive" -> "preemptive" [ label = "preempt_enable" ];
}
"""


def call(*words: str | Path, monkeypatch: pytest.MonkeyPatch) -> int:
    monkeypatch.setattr(sys, "argv", ["deshybrid", *map(str, words)])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0)


@pytest.fixture
def press(tmp_path: Path) -> Path:
    path = tmp_path / "press.fsm"
    path.write_text(write_text(Document(PRESS), "fsm").text)
    return path


@pytest.mark.parametrize("name", [entry.name for entry in FORMATS if entry.write is not None])
def test_check_gives_the_same_answer_from_every_format(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / f"press{SUFFIXES[name]}"
    path.write_text(write_text(Document(PRESS), name).text)
    words = ("--from", "mealy") if name == "mealy" else ()
    assert call("check", path, "--json", *words, monkeypatch=monkeypatch) == 1
    said = capsys.readouterr()
    record = json.loads(said.out)
    assert (record["persistent"], record["current_location_observable"]) == (["idle", "busy"], False)
    assert [failure["event"] for failure in record["c1_failures"]] == ["jam"]
    assert f"{path}:" in said.err


def test_a_no_points_at_the_line_of_the_foreign_file(
    press: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert call("check", press, monkeypatch=monkeypatch) == 1
    line = 1 + press.read_text().split("\n").index("jam idle c uo")
    assert f"{press}:{line}:1" in capsys.readouterr().err


def test_recover_draw_compile_simulate_and_run_take_a_plain_automaton(
    press: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = press.parent
    assert call("recover", press, "-o", folder / "recovery", monkeypatch=monkeypatch) == 0
    assert "signatures {s_idle}" in (folder / "recovery").read_text()
    assert call("draw", press, "--what", "observer", "-o", folder / "press.mmd", monkeypatch=monkeypatch) == 0
    assert "idle" in (folder / "press.mmd").read_text()
    assert call("compile", press, "-o", folder / "made", "--target", "python", monkeypatch=monkeypatch) == 0
    assert "from press.fsm" in (folder / "made" / "python" / "press.py").read_text()
    assert call("simulate", press, "-o", folder / "trace.csv", monkeypatch=monkeypatch) == 0
    trace = (folder / "trace.csv").read_text().splitlines()
    assert trace[0] == "time,event,true_location"
    (folder / "seen.csv").write_text("time,event\n0,\n1,start\n2,s_idle\n")
    assert call("run", press, "--trace", folder / "seen.csv", "-o", folder / "out.csv", monkeypatch=monkeypatch) == 0
    assert [row.split(",")[1] for row in (folder / "out.csv").read_text().splitlines()[1:]] == ["idle", "busy", "idle"]
    capsys.readouterr()
    assert call("design", press, monkeypatch=monkeypatch) == 2
    assert "error[DH0306]" in capsys.readouterr().err


def test_a_format_is_named_where_the_suffix_says_too_little(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "wip.dot"
    path.write_text(KERNEL)
    assert call("check", path, monkeypatch=monkeypatch) == 2
    assert "read it with `--from rv`" in capsys.readouterr().err
    assert call("check", path, "--from", "rv", monkeypatch=monkeypatch) == 0
    assert call("check", path, "--from", "kernel", monkeypatch=monkeypatch) == 2
    assert "error[DH1001]" in capsys.readouterr().err


def test_what_a_reader_passes_over_is_said_by_check_too(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "forced.gen"
    path.write_text("<Generator> <A> a +CF+ </A> <S> 1 </S> <T> 1 a 1 </T> <I> 1 </I> </Generator>")
    assert call("check", path, monkeypatch=monkeypatch) == 0
    assert "warning[DH1016]" in capsys.readouterr().err


def test_our_automata_and_models_are_told_apart_by_their_format_not_their_suffix(tmp_path: Path) -> None:
    model = Path("models/two_tank.yaml")
    (tmp_path / "tank.json").write_text(model.read_text())  # YAML is wider than JSON; the reader takes both
    for name in ("press.json", "press.yaml"):
        (tmp_path / name).write_text(write_text(Document(PRESS), "json").text)
    tank, _ = read_system(tmp_path / "tank.json")
    assert isinstance(tank, dh.HybridSystem)
    assert tank.state_names == ("h1", "h2")
    assert dh.check(tmp_path / "press.yaml").des == dh.check(tmp_path / "press.json").des == PRESS


def test_a_path_is_as_good_as_the_system_in_python(press: Path) -> None:
    assert dh.check(press).c1_failures == dh.check(PRESS).c1_failures
    assert dh.to_des(press).locations == PRESS.locations
    assert dh.recover(press).plan.names == "{s_idle}"


def test_an_observer_is_compiled_from_a_plain_automaton() -> None:
    made = dh.compile(PRESS)
    assert made.observer is not None
    _, estimate = made.observer.step(made.observer.start(), (), (), "start")
    assert estimate.entry_estimate == ("busy",)


def test_a_plain_automaton_and_its_model_are_the_same_system() -> None:
    for seed in range(300):
        des = living(random_des(random.Random(seed)))
        assert abstract(discrete_model(des)) == des


def test_a_system_that_has_signatures_is_no_model() -> None:
    with pytest.raises(UsageError, match="DH0308"):
        dh.compile(PRESS.with_signatures({2: "s_idle"}))
