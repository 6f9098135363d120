"""A model that extends another: what is joined and replaced, where mistakes are shown, and the driveline's lever."""

from pathlib import Path

import numpy as np
import pytest

import deshybrid as dh
from deshybrid.diagnostics import ModelError
from deshybrid.model.load import load, loads
from deshybrid.model.parameters import parameter_text, with_parameters
from deshybrid.model.source import MOST_EXTENDED, read_source
from deshybrid.simulate.campaign_drives import run_drive
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import replay

BASE = """\
format: deshybrid/1
name: base
summary: The one below.
parameters: {k: 2, m: k + 1}
state: [h]
output: [y]
defaults: {C: [[1]]}
locations: {on: {A: [[-k]], dwell: {min: 1, max: 4}}, off: {A: [[-m]]}}
transitions: [{from: on, to: off, event: a}, {from: off, to: on, event: b}]
"""


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    (tmp_path / "base.yaml").write_text(BASE, encoding="utf-8")
    return tmp_path


def write(folder: Path, text: str, name: str = "above.yaml") -> Path:
    (folder / name).write_text("format: deshybrid/1\n" + text, encoding="utf-8")
    return folder / name


def test_mappings_are_joined_and_all_else_is_replaced(folder: Path) -> None:
    system = load(
        write(
            folder,
            "extends: base.yaml\nname: above\nparameters: {k: 5}\n"
            "locations: {on: {dwell: {min: 2}}, idle: {A: [[0]]}}\n"
            "transitions: [{from: on, to: idle, event: a}, {from: idle, to: off, event: b},"
            " {from: off, to: on, event: c}]",
        )
    )
    assert (system.name, system.summary) == ("above", "The one below.")
    assert [location.name for location in system.locations] == ["on", "off", "idle"]
    assert [location.dynamics.A.item() for location in system.locations if location.dynamics] == [-5, -6, 0]
    assert (system.locations[0].dwell.min, system.locations[0].dwell.max) == (2, 4)
    assert [transition.target for transition in system.transitions] == ["idle", "off", "on"]


def test_extended_files_may_extend_others_and_the_nearest_one_counts(folder: Path) -> None:
    write(folder, "extends: base.yaml\nparameters: {k: 7}", "middle.yaml")
    system = load(write(folder, "extends: middle.yaml\nname: top"))
    assert system.name == "top"
    assert system.locations[0].dynamics is not None
    assert system.locations[0].dynamics.A.item() == -7


def test_a_mistake_is_shown_in_the_file_in_which_it_stands(folder: Path) -> None:
    with pytest.raises(ModelError) as caught:
        load(write(folder, "extends: base.yaml\nparameters: {k: x}"))
    assert [(d.code, d.span and Path(d.span.source.name).name) for d in caught.value.diagnostics] == [
        ("DH0122", "above.yaml")
    ]
    (folder / "base.yaml").write_text(BASE.replace("to: off", "to: of"), encoding="utf-8")
    with pytest.raises(ModelError) as caught:
        load(write(folder, "extends: base.yaml"))
    first = caught.value.diagnostics[0]
    assert (first.code, first.span and Path(first.span.source.name).name, first.span and first.span.line) == (
        "DH0201",
        "base.yaml",
        9,
    )


@pytest.mark.parametrize("name", ["missing.yaml", "../base.yaml", "/etc/passwd", "sub/base.yaml", "plant.npz"])
def test_only_a_model_of_the_same_folder_is_extended(folder: Path, name: str) -> None:
    (folder / "sub").mkdir()
    (folder / "sub" / "base.yaml").write_text(BASE, encoding="utf-8")
    (folder / "plant.npz").write_bytes(b"")
    with pytest.raises(ModelError, match="DH0114"):
        load(write(folder, f"extends: {name}"))


def test_a_text_without_a_folder_extends_nothing(folder: Path) -> None:
    with pytest.raises(ModelError, match="DH0114"):
        loads("{format: deshybrid/1, extends: base.yaml}")


def test_a_file_that_extends_itself_is_refused(folder: Path) -> None:
    with pytest.raises(ModelError, match=f"more than {MOST_EXTENDED} files"):
        load(write(folder, "extends: above.yaml"))


def test_a_model_has_another_hash_where_the_extended_one_has_changed(folder: Path) -> None:
    path = write(folder, "extends: base.yaml")
    before = read_source(path).sha256
    (folder / "base.yaml").write_text(BASE + "# changed\n", encoding="utf-8")
    assert read_source(path).sha256 != before


def test_a_parameter_of_the_extended_file_can_be_varied(folder: Path) -> None:
    source = read_source(write(folder, "extends: base.yaml\nparameters: {k: 5}"))
    assert with_parameters(source, {"m": 1.0}).tree.get("parameters") is not None
    assert parameter_text(source, {"m": "6"}).endswith("\nparameters: {m: 6, k: 5}")


def test_the_driveline_is_driven_alike_with_and_without_the_lever_known() -> None:
    plain, known = (load(f"models/balluchi2012/driveline{end}.yaml") for end in ("", "_lever"))
    drives = [run_drive(system, seed=3, job=2, duration=9, step=0.012) for system in (plain, known)]
    assert drives[0].switches == drives[1].switches
    assert np.array_equal(drives[0].trace.outputs, drives[1].trace.outputs)
    assert set(drives[1].trace.commands) == {("1",), ("2",)}


def test_with_the_lever_known_no_gear_is_named_for_which_the_lever_is_not_there() -> None:
    observer = dh.compile("models/balluchi2012/driveline_lever.yaml").observer
    assert observer is not None
    trace = simulate(observer.system, seed=1, duration=15, step=0.012).trace
    named = replay(observer, trace).location
    window = observer.tables.window_ticks
    entered = [k for k in range(1, len(trace)) if named[k] not in (named[k - 1], None, "qN")]
    assert len(entered) > 2
    for k in entered:
        assert named[k] in {f"q{values[0]}" for values in trace.commands[max(k - window, 0) : k + 1]}


@pytest.mark.campaign
def test_the_lever_leaves_no_time_to_foreign_gears_in_a_campaign() -> None:
    """Ten drives: the longest foreign name lasts over 1 s without the lever and at most 0.1 s with it."""
    from deshybrid.campaigns import Wishes, prepare
    from deshybrid.simulate.campaign import run_campaign
    from deshybrid.simulate.campaign_executor import Here

    foreign = []
    for end in ("", "_lever"):
        task = prepare(f"models/balluchi2012/driveline{end}.yaml", Wishes(seed=1)).task
        assert task is not None
        drives = run_campaign(task, Here(), engagements=250).drives
        foreign.append(max(w.seconds for drive in drives for w in drive.observer.wrong if w.kind == "foreign"))
    assert foreign[0] > 1.0
    assert foreign[1] < 0.1
