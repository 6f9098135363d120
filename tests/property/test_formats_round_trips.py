"""What is written is what is read again, with names that try to break out of every format's quotes."""

from collections.abc import Iterable
from dataclasses import replace

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from deshybrid.des.automaton import DES
from deshybrid.diagnostics import Diagnostic, FormatError, InputError, SourceText
from deshybrid.formats.document import Document
from deshybrid.formats.table import FORMATS, format_of, write_text
from tests.strategies import damaged, documents, living

WRITTEN = [entry.name for entry in FORMATS if entry.write is not None]


def again(document: Document, name: str) -> Document:
    """The document after writing and reading."""
    return format_of(None, name).read(SourceText("<text>", write_text(document, name).text))


def without_events(document: Document) -> Document:
    return replace(document, events=())


def unordered(document: Document) -> tuple[object, ...]:
    """What a format keeps that lists states and transitions in an order of its own."""
    des = document.des
    rows = {(t.source, t.event, t.target, frozenset(t.outputs)) for t in des.transitions}
    return set(des.locations), rows, des.initial, set(document.marked), set(document.events)


@given(documents())
def test_our_json_keeps_everything(document: Document) -> None:
    assert again(document, "json") == document


@given(documents())
def test_signatures_and_parallel_transitions_survive_our_json(document: Document) -> None:
    doubled = replace(document.des, transitions=document.des.transitions * 2)
    signed = replace(document, des=doubled.with_signatures({0: "s_1"}))
    assert again(signed, "json") == signed


@given(documents())
def test_graphml_keeps_all_but_the_alphabet(document: Document) -> None:
    assert again(document, "graphml") == without_events(document)


@given(documents(without="\\"))
def test_plain_dot_keeps_all_but_the_alphabet(document: Document) -> None:
    assert again(document, "dot") == without_events(document)


@given(documents(without="/\\"))
def test_mealy_dot_keeps_all_but_the_alphabet(document: Document) -> None:
    assert again(document, "mealy") == without_events(document)


@given(documents(without="|"))
def test_model_files_keep_the_system(document: Document) -> None:
    des = living(document.des)
    assert again(Document(des), "yaml").des == des


@given(documents(outputs=False))
def test_libfaudes_files_keep_everything(document: Document) -> None:
    assert again(document, "gen") == document


@given(documents(outputs=False, one_initial=True, without=" "))
def test_umdes_files_keep_everything_but_the_order(document: Document) -> None:
    assert unordered(again(document, "fsm")) == unordered(document)


@given(documents(one_initial=True, without=" 0"))
def test_att_text_keeps_all_but_the_alphabet_and_the_order(document: Document) -> None:
    everywhere = replace(document, marked=document.des.locations, events=())
    assert unordered(again(everywhere, "att")) == unordered(everywhere)


@pytest.mark.parametrize("name", WRITTEN)
@given(document=documents())
@settings(max_examples=60)
def test_any_document_is_written_as_it_is_or_refused_with_a_code(name: str, document: Document) -> None:
    """What an observer can see is kept: locations, initial locations, outputs between them."""
    refused: set[str] = set()
    try:
        assert seen(again(document, name).des) == seen(document.des)
    except FormatError as error:
        refused = codes(error.diagnostics)
    assert refused <= {"DH1012", "DH1013"}


def seen(des: DES) -> tuple[set[str], set[str], set[tuple[str, str | None, str]]]:
    rows = {(t.source, output, t.target) for t in des.transitions for output in t.outputs}
    return set(des.locations), set(des.initial), rows


@pytest.mark.parametrize("name", WRITTEN)
@given(data=st.data())
@settings(max_examples=60)
def test_a_damaged_file_is_read_or_refused_never_a_traceback(name: str, data: st.DataObject) -> None:
    document = data.draw(documents(outputs=False, one_initial=True, without=' |/\\0"'))
    whole = replace(document, des=living(document.des), marked=document.des.locations)
    text = data.draw(damaged(write_text(whole, name).text))
    problems: tuple[Diagnostic, ...] = ()
    try:
        assert format_of(None, name).read(SourceText("<text>", text)).des.initial
    except InputError as error:
        problems = error.diagnostics
    assert all(found.span is not None for found in problems)


@pytest.mark.parametrize("name", WRITTEN)
@pytest.mark.parametrize("bad", ["", " a", "a ", "a\nb", "a\0b", "\ud800", "a\x85b", "x" * 1001])
def test_a_name_that_no_format_holds_is_refused_by_all(name: str, bad: str) -> None:
    with pytest.raises(FormatError) as caught:
        write_text(Document(DES((bad,), (), (bad,))), name)
    assert codes(caught.value.diagnostics) == {"DH1012"}


def codes(diagnostics: Iterable[Diagnostic]) -> set[str]:
    return {found.code for found in diagnostics}
