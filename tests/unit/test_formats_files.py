"""Files as other tools write them, what is warned about, and the command `convert`."""

import sys
from pathlib import Path

import pytest

from deshybrid import cli
from deshybrid.des.automaton import DES
from deshybrid.diagnostics import FormatError, SourceText, UsageError
from deshybrid.formats.document import Document, Event
from deshybrid.formats.table import format_of, read_file, write_text

UMDES = "2\r\n\r\nI\t1\t1\r\nstart\tW\tc\to\r\n\r\nW\t0\t2\r\nstop\tI\r\njam\tW\tuc\tuo"
FAUDES = """% a machine
<Generator name="simple machine">
<!-- after the reference of libFAUDES -->
<Alphabet> alpha +C+ beta mue 0x0 lambda +Co+ </Alphabet>
<States> idle busy down </States>
<TransRel> idle alpha busy  busy beta idle  busy mue down  down lambda idle </TransRel>
<InitStates> idle </InitStates> <MarkedStates> idle </MarkedStates>
</Generator>
"""
LEARNED = """digraph g {
  __start0 [label="" shape="none" width="0" height="0"];
  s0 [shape="circle" label="0"];
  s1 [shape="circle" label="1"];
  s0 -> s1 [label="coin / ok"];
  s1 -> s0 [label="get / quiet\\ncoin / full/back"]
  __start0 -> s0;
}
"""
KERNEL = """digraph state_automaton {
	center = true;
	size = "7,11";
	{node [shape = circle] "non_preemptive"};
	{node [shape = plaintext, style=invis, label=""] "__init_preemptive"};
	{node [shape = doublecircle] "preemptive"};
	{node [shape = circle] "preemptive"};
	"__init_preemptive" -> "preemptive";
	"non_preemptive" [label = "non_preemptive"];
	"non_preemptive" -> "non_preemptive" [ label = "sched_waking\\nsched_need_resched" ];
	"non_preemptive" -> "preemptive" [ label = "preempt_enable" ];
	"preemptive" [label = "preemptive", color = green3];
	"preemptive" -> "non_preemptive" [ label = "preempt_disable" ];
	{ rank = min ;
		"__init_preemptive";
		"preemptive";
	}
}
"""
SUPREMICA = """<?xml version="1.0" encoding="UTF-8" standalone="yes"?>
<Module Name="m" xmlns="http://waters.sourceforge.net/xsd/module" xmlns:ns2="http://waters.sourceforge.net/xsd/base">
 <EventDeclList>
  <EventDecl Kind="PROPOSITION" Name=":accepting"/>
  <EventDecl Kind="CONTROLLABLE" Name="a"/>
  <EventDecl Kind="UNCONTROLLABLE" Name="b" Observable="false"/>
 </EventDeclList>
 <ComponentList>
  <SimpleComponent Kind="PLANT" Name="P">
   <Graph>
    <NodeList>
     <SimpleNode Initial="true" Name="S0">
      <PointGeometry><Point X="1" Y="2"/></PointGeometry>
      <EventList><SimpleIdentifier Name=":accepting"/></EventList>
     </SimpleNode>
     <SimpleNode Name="S1"/>
    </NodeList>
    <EdgeList>
     <Edge Source="S0" Target="S1">
      <LabelBlock><SimpleIdentifier Name="a"/><SimpleIdentifier Name="b"/></LabelBlock>
     </Edge>
    </EdgeList>
   </Graph>
  </SimpleComponent>
 </ComponentList>
</Module>
"""
TCT = """# CTCT ADS Template

M1

State size (State set will be (0,1....,size-1)):
# <-- Enter state size, in range 0 to 2000000, on line below.
2

Marker states:
# <-- Enter marker states, one per line.
*

Vocal states:
# <-- If no vocal states, leave line blank.

Transitions:
# <-- Enter transition triple, one per line.
0     11    1
1     10    0
"""


def read(name: str, text: str) -> Document:
    return format_of(None, name).read(SourceText("<text>", text))


def rows(document: Document) -> list[str]:
    return [str(transition) for transition in document.des.transitions]


def test_umdes_file_with_windows_line_ends_and_no_last_one_is_read(tmp_path: Path) -> None:
    path = tmp_path / "press.fsm"
    path.write_bytes(UMDES.encode())
    document = read_file(path)
    assert rows(document) == ["I -start/start-> W", "W -stop/stop-> I", "W -jam/ε-> W"]
    assert (document.des.name, document.des.initial, document.marked) == ("press", ("I",), ("I",))
    assert document.events == (Event("start"), Event("stop"), Event("jam", False, False))


def test_umdes_events_on_no_transition_stand_in_the_trailer() -> None:
    text = "1\n\nA 1 1\na A c o\n\nEVENTS\na c o\nb uc uo\n"
    assert read("fsm", text).events == (Event("a"), Event("b", False, False))
    assert write_text(read("fsm", text), "fsm").text == text


def test_libfaudes_file_with_its_options_in_letters_and_bits_is_read() -> None:
    document = read("gen", FAUDES)
    assert document.des.name == "simple machine"
    assert rows(document)[2:] == ["busy -mue/ε-> down", "down -lambda/ε-> idle"]
    flags = [(event.controllable, event.observable) for event in document.events]
    assert flags == [(True, True), (False, True), (False, False), (True, False)]


def test_libfaudes_forcible_events_are_read_with_a_warning() -> None:
    document = read(
        "gen", "<Generator> <A> a +CF+ </A> <S> <Consecutive> 1 3 </Consecutive> </S> <I> 2 </I> </Generator>"
    )
    assert document.des.locations == ("1", "2", "3")
    assert [(found.code, found.severity) for found in document.warnings] == [("DH1016", "warning")]


def test_learned_mealy_machine_is_read_by_node_names_and_split_at_the_first_slash() -> None:
    assert rows(read("mealy", LEARNED)) == [
        "s0 -coin/ok-> s1",
        "s1 -get/quiet-> s0",
        "s1 -coin/full/back-> s0",
    ]


def test_kernel_automaton_is_read_with_parallel_events_and_its_double_circle() -> None:
    document = read("rv", KERNEL)
    assert document.des.locations == ("non_preemptive", "preemptive")
    assert (document.des.initial, document.marked) == (("preemptive",), ("preemptive",))
    assert rows(document)[:2] == [
        "non_preemptive -sched_waking/sched_waking-> non_preemptive",
        "non_preemptive -sched_need_resched/sched_need_resched-> non_preemptive",
    ]


def test_supremica_module_is_read_with_marking_control_and_observability() -> None:
    document = read("wmod", SUPREMICA)
    assert rows(document) == ["S0 -a/a-> S1", "S0 -b/ε-> S1"]
    assert (document.des.name, document.marked) == ("P", ("S0",))
    assert document.events == (Event("a"), Event("b", False, False))


def test_tct_file_is_read_with_odd_events_controllable() -> None:
    document = read("ads", TCT)
    assert rows(document) == ["0 -11/11-> 1", "1 -10/10-> 0"]
    assert (document.des.name, document.des.initial, document.marked) == ("M1", ("0",), ("0", "1"))
    assert document.events == (Event("11"), Event("10", controllable=False))


def test_att_acceptor_with_a_symbol_table_is_read(tmp_path: Path) -> None:
    (tmp_path / "a.att").write_text("0 1 1\n1 0 0\n1 0\n")
    (tmp_path / "a.syms").write_text("<eps> 0\nalpha 1\n")
    document = read_file(tmp_path / "a.att", symbols=tmp_path / "a.syms")
    assert rows(document) == ["0 -alpha/alpha-> 1", "1 -ε/ε-> 0"]
    assert document.marked == ("1",)


def test_a_number_that_the_symbol_table_lacks_is_refused_where_it_stands(tmp_path: Path) -> None:
    (tmp_path / "a.att").write_text("0 1 7\n")
    (tmp_path / "a.syms").write_text("alpha 1\n")
    with pytest.raises(FormatError) as caught:
        read_file(tmp_path / "a.att", symbols=tmp_path / "a.syms")
    assert (caught.value.diagnostics[0].code, str(caught.value.diagnostics[0].span)[-6:]) == ("DH1003", "tt:1:5")
    with pytest.raises(UsageError):
        read_file(tmp_path / "a.att", "gen", symbols=tmp_path / "a.syms")


def test_graphml_without_outputs_shows_every_event() -> None:
    import networkx

    graph = networkx.MultiDiGraph()
    graph.add_node("a b", initial=True)
    graph.add_edge("a b", "a b", event="x<y")
    text = "\n".join(networkx.generate_graphml(graph))
    assert rows(read("graphml", text)) == ["a b -x<y/x<y-> a b"]


def test_what_a_format_cannot_hold_is_said_in_warnings() -> None:
    des = DES.from_transitions([("1", "a", "1", "α"), ("1", "b", "1", None)], initial=["1"])
    document = Document(des, ("1",), (Event("a", controllable=False), Event("b"), Event("c")))
    lost = {
        name: [found.message.split("hold ")[1] for found in write_text(document, name).warnings]
        for name in ("json", "fsm", "dot", "yaml")
    }
    assert lost["json"] == []
    assert lost["fsm"] == ["the events of 1 transition that show another name; their outputs are written"]
    assert lost["dot"] == ["which events are uncontrollable", "events that are on no transition"]
    assert lost["yaml"] == ["marked locations", *lost["dot"]]


@pytest.mark.parametrize("name", ["fsm", "gen"])
def test_a_label_that_would_be_visible_and_silent_is_refused(name: str) -> None:
    des = DES.from_transitions([("1", "a", "1", "b"), ("1", "b", "1", None)], initial=["1"])
    with pytest.raises(FormatError, match="DH1013: the silent event `b`"):
        write_text(Document(des), name)


@pytest.mark.parametrize("name", ["fsm", "att"])
def test_several_initial_locations_are_refused_where_one_fits(name: str) -> None:
    with pytest.raises(FormatError, match="holds one initial location, and 2 are possible"):
        write_text(Document(DES.from_transitions([("1", "a", "2", "a")])), name)


def test_signatures_are_refused_by_all_but_our_json() -> None:
    des = DES.from_transitions([("1", "a", "1", None)]).with_signatures({0: "s"})
    for name in ("yaml", "fsm", "gen", "att", "dot", "mealy", "graphml"):
        with pytest.raises(FormatError, match="DH1013"):
            write_text(Document(des), name)


@pytest.mark.parametrize("name", ["rv", "wmod", "ads"])
def test_formats_that_are_only_read_are_not_written(name: str) -> None:
    with pytest.raises(UsageError, match="is read, not written"):
        write_text(Document(DES(("1",), ())), name)


def convert(*words: str, monkeypatch: pytest.MonkeyPatch, folder: Path) -> int:
    monkeypatch.chdir(folder)
    monkeypatch.setattr(sys, "argv", ["deshybrid", "convert", *words])
    with pytest.raises(SystemExit) as end:
        cli.main()
    return int(end.value.code or 0)


def test_convert_goes_by_suffix_and_says_what_is_lost(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "press.fsm").write_bytes(UMDES.encode())
    assert convert("press.fsm", "press.yaml", monkeypatch=monkeypatch, folder=tmp_path) == 0
    assert rows(read_file(tmp_path / "press.yaml")) == rows(read("fsm", UMDES))
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("warning[DH1014]") == 2


def test_convert_takes_the_outputs_that_mean_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "learned.dot").write_text(LEARNED)
    words = ("learned.dot", "--from", "mealy", "--silent", "quiet", "--silent", "ok", "-o", "learned.json")
    assert convert(*words, monkeypatch=monkeypatch, folder=tmp_path) == 0
    assert rows(read_file(tmp_path / "learned.json"))[:2] == ["s0 -coin/ε-> s1", "s1 -get/ε-> s0"]


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (("press.fsm",), "DH1001"),
        (("press.fsm", "--to", "pdf"), "DH1001"),
        (("press.fsm", "no/such/folder.json"), "DH0805"),
        (("press.fsm", "a.json", "-o", "b.json"), "DH0805"),
        (("press.fsm", "a.json", "--silent", "no_such"), "DH1005"),
        (("missing.fsm", "a.json"), "DH0104"),
        (("press.fsm", "a.wmod"), "DH1001"),
    ],
)
def test_convert_refuses_a_wrong_call_with_a_code(
    words: tuple[str, ...],
    code: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    (tmp_path / "press.fsm").write_text(UMDES)
    assert convert(*words, monkeypatch=monkeypatch, folder=tmp_path) == 2
    assert f"error[{code}]" in capsys.readouterr().err
    assert [path.name for path in tmp_path.iterdir()] == ["press.fsm"]
