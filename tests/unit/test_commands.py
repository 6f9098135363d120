"""Known commands from end to end: the model, its automaton, traces, runs of the plant, the observer."""

import re
from pathlib import Path

import numpy as np
import pytest

import deshybrid as dh
from deshybrid import bundle
from deshybrid.des.composition import parallel
from deshybrid.diagnostics import FormatError, TraceError, UsageError
from deshybrid.emit.picture import des_picture, dprime_picture, observer_picture
from deshybrid.formats.document import Document
from deshybrid.formats.dot import write_dot
from deshybrid.formats.own import write_json, write_yaml
from deshybrid.formats.reading import read_system
from deshybrid.model.abstraction import abstract, discrete_model
from deshybrid.model.load import loads
from deshybrid.model.system import HybridSystem
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.replay import replay
from deshybrid.simulate.trace import Trace, parse_trace, write_trace

GEARS = """
format: deshybrid/1
name: gears
commands: {lever: [1, 2, 3, N], clutch: [pressed, released]}
locations: [open, first, second]
transitions:
  - {from: open, to: first, event: close, emits: click, when: {lever: 1, clutch: released}}
  - {from: open, to: second, event: close, emits: click, when: {lever: [2, 3], clutch: released}}
  - {from: first, to: open, event: press, emits: clack, when: {clutch: pressed}}
  - {from: second, to: open, event: press, emits: clack, when: {clutch: pressed}}
"""


@pytest.fixture
def gears() -> HybridSystem:
    return loads(GEARS)


def test_values_of_several_commands_that_no_transition_tells_apart_are_one(gears: HybridSystem) -> None:
    assert abstract(gears).transitions[1].commands == ("lever=2|3,clutch=released",)
    assert abstract(gears).transitions[2].commands == tuple(
        f"lever={lever},clutch=pressed" for lever in ("1", "2|3", "N")
    )


def test_commands_on_which_nothing_depends_leave_the_automaton_as_it_was(gears: HybridSystem) -> None:
    plain = loads(GEARS.replace(", when:", "}  # "))
    assert plain.command_names == ("lever", "clutch")
    assert {transition.commands for transition in abstract(plain).transitions} == {()}


def test_an_automaton_with_commands_keeps_them_through_files_and_as_a_model(
    gears: HybridSystem, tmp_path: Path
) -> None:
    des = abstract(gears)
    assert abstract(discrete_model(des)).transitions == des.transitions
    for name, written in (("gears.json", write_json(Document(des))), ("gears.yaml", write_yaml(Document(des)))):
        (tmp_path / name).write_text(written.text, encoding="utf-8")
        read, _ = read_system(tmp_path / name)
        again = read if isinstance(read, dh.DES) else abstract(read)
        assert again.transitions == des.transitions
    assert dh.DES.from_networkx(des.to_networkx()).transitions == des.transitions
    assert des.to_table()["commands"][0] == "lever=1,clutch=released"
    with pytest.raises(FormatError, match="DH1013"):
        write_dot(Document(des))


def test_systems_with_commands_are_not_composed(gears: HybridSystem) -> None:
    with pytest.raises(UsageError, match="DH0424"):
        parallel(abstract(gears), abstract(gears))


def test_the_lever_makes_gears_observable_that_show_the_same(gears: HybridSystem) -> None:
    assert dh.check(gears).current_location_observable
    without = dh.check(loads(GEARS.replace("lever: 1, ", "").replace("lever: [2, 3], ", "")))
    assert [failure.location for failure in without.c2_failures] == ["first", "second"]


def test_a_negation_has_to_deny_only_what_the_same_command_permits() -> None:
    """With the lever known, "not open" names the gear: one generator in place of one for each gear."""
    text = """
        {format: deshybrid/1, commands: {lever: [1, 2, 3]}, locations: [N, q1, q2, q3], transitions: [
         {from: N, to: q1, event: a, when: {lever: 1}}, {from: N, to: q2, event: b, when: {lever: 2}},
         {from: N, to: q3, event: c, when: {lever: 3}},
         {from: q1, to: N, event: d}, {from: q2, to: N, event: d}, {from: q3, to: N, event: d}]}"""
    known, unknown = (dh.recover(loads(model)).plan for model in (text, re.sub(", when: {.*?}", "", text)))
    assert known.generators == ("N",)
    assert len(unknown.generators) == 3


def test_a_trace_has_a_column_for_each_command_and_reads_back(gears: HybridSystem) -> None:
    trace = simulate(gears, seed=3, duration=40).trace
    text = write_trace(trace)
    assert text.splitlines()[0] == "time,lever,clutch,event,true_location"
    assert parse_trace(text, gears).commands == trace.commands
    assert list(trace.to_table())[:3] == ["time", "lever", "clutch"]


def test_every_transition_of_a_run_is_permitted_by_the_commands_of_its_row(gears: HybridSystem) -> None:
    run = simulate(gears, seed=1, duration=100)
    assert len(run.switches) > 10
    taken = {(t.source, t.target): t.when for t in gears.transitions}
    for switch, values in zip(run.switches, run.trace.commands[1:], strict=True):
        when = taken[switch.source, switch.target]
        assert all(dict(zip(gears.command_names, values, strict=True))[name] in needed for name, needed in when.items())


def test_commands_follow_the_requests_unless_they_are_written() -> None:
    asked = "simulation: {location: open, requests: [[2, close], [4, press], [6, close]]"
    run = simulate(loads(GEARS + asked + "}"), duration=9)
    assert run.trace.commands == (
        ("1", "pressed"),
        ("1", "released"),
        ("1", "pressed"),
        ("1", "released"),
    )
    run = simulate(loads(GEARS + asked + ", commands: {lever: [[0, N], [2.5, 2], [5, 1]]}}"), duration=9)
    assert [(switch.time, switch.target) for switch in run.switches] == [(2.5, "second"), (4, "open"), (6, "first")]
    assert run.pending == ()


def test_unknown_value_in_a_trace_is_refused_at_its_place(gears: HybridSystem) -> None:
    with pytest.raises(TraceError) as caught:
        parse_trace("time,lever,clutch,event\n0,1,released,\n1,4,pressd,click\n", gears)
    first, second = caught.value.diagnostics
    assert (first.code, first.span and first.span.line, first.span and first.span.column) == ("DH0325", 3, 3)
    assert second.helps[0] == "did you mean `pressed`?"
    with pytest.raises(TraceError, match="DH0316"):
        parse_trace("time,lever,event\n0,1,\n", gears)


def test_a_command_that_is_not_known_excludes_nothing(gears: HybridSystem) -> None:
    observer = dh.compile(gears).observer
    assert observer is not None
    rows = {"known": ("2", "released"), "unknown": (None, "released"), "foreign": ("7", "released")}
    found = {}
    for name, values in rows.items():
        _, estimate = observer.step(observer.start(), (), (), "click", values)
        found[name] = estimate.entry_estimate
    assert found == {"known": ("second",), "unknown": ("first", "second"), "foreign": ("first", "second")}
    with pytest.raises(UsageError, match="DH0607"):
        observer.step(observer.start(), (), (), "click", ("2",))


def test_an_output_that_no_command_permits_is_inconsistent(gears: HybridSystem) -> None:
    observer = dh.compile(gears).observer
    assert observer is not None
    trace = Trace(
        gears,
        np.array([0.0, 1.0, 2.0, 3.0]),
        np.zeros((4, 0)),
        np.zeros((4, 0)),
        (None, "click", "clack", "click"),
        commands=(("1", "released"), ("1", "released"), ("1", "pressed"), ("N", "released")),
    )
    estimates = replay(observer, trace)
    assert estimates.status == ("searching", "identified", "identified", "inconsistent")


def test_a_drawing_tells_the_commands_where_not_every_one_will_do(gears: HybridSystem) -> None:
    report = dh.check(gears)
    assert report.observer is not None
    drawn = des_picture(report, title="gears")
    assert [arc.lines for arc in drawn.arcs] == [
        ("close / click@lever=1,clutch=released",),
        ("close / click@lever=2|3,clutch=released",),
        ("press / clack@lever=1,clutch=pressed|lever=2|…",),
        ("press / clack@lever=1,clutch=pressed|lever=2|…",),
    ]
    lever = dh.check(loads(GEARS.replace("clutch: pressed", "").replace(", clutch: released", "")))
    assert [arc.lines for arc in des_picture(lever, title="lever").arcs][2] == ("press / clack",)
    assert ("click@lever=1",) in [arc.lines for arc in observer_picture(lever, title="lever").arcs]
    assert ("click@lever=2|3",) in [arc.lines for arc in dprime_picture(lever, title="lever").arcs]


def test_report_and_header_say_which_commands_the_observer_is_told(gears: HybridSystem) -> None:
    texts = bundle.files(dh.compile(gears))
    page = re.sub("<[^>]+>", "", texts["report.html"].decode())
    assert re.search(r"the command lever with the values\s+1, 2, 3,\s+N,", page)
    assert "the value of the command clutch" in page
    header = texts["c/gears.h"].decode()
    assert "int32_t command[GEARS_N_COMMANDS]; /* GEARS_COMMAND_...: lever, clutch */" in header
    assert "GEARS_COMMAND_CLUTCH_RELEASED = 2" in header


def test_a_run_ends_where_a_stay_has_to_and_no_command_permits_it() -> None:
    text = GEARS.replace("[open, first, second]", "{open: {dwell: {max: 3}}, first: null, second: null}")
    run = simulate(loads(text + "simulation: {location: open, commands: {lever: N}}"), duration=9)
    assert run.stop is not None
    assert (run.stop.kind, run.stop.time, run.switches) == ("blocked", 3.0, ())
    assert "the commands permit no transition" in run.stop.message
