"""Every file of `bad_files` is refused with the code and at the line that `expected.txt` names."""

from pathlib import Path

import pytest

from deshybrid.diagnostics import InputError, ModelError, UsageError, catalogue, render_all
from deshybrid.formats.table import FORMATS, read_file

FOLDER = Path(__file__).parent / "bad_files"
ROWS = [row.split() for row in (FOLDER / "expected.txt").read_text().splitlines() if not row.startswith("#")]
NAMES = {entry.name for entry in FORMATS}


@pytest.mark.parametrize(("file", "code", "line"), ROWS, ids=[row[0] for row in ROWS])
def test_bad_file_is_refused_with_its_code_at_its_line(file: str, code: str, line: str) -> None:
    with pytest.raises(InputError) as caught:
        read_file(FOLDER / file, Path(file).suffix[1:])
    first = caught.value.diagnostics[0]
    assert first.span is not None
    assert (first.code, first.span.line) == (code, int(line)), render_all(caught.value.diagnostics)
    assert all(found.span is not None and found.code in catalogue() for found in caught.value.diagnostics)
    assert f"{FOLDER / file}:{line}:" in render_all(caught.value.diagnostics)


def test_every_bad_file_has_a_row_and_every_format_has_some() -> None:
    files = {path.name for path in FOLDER.iterdir()} - {"expected.txt"}
    assert files == {row[0] for row in ROWS}
    assert len(files) >= 30
    assert {Path(name).suffix[1:] for name in files} == NAMES - {"yaml"}


def test_every_code_of_reading_is_provoked_by_some_bad_file() -> None:
    """DH1001 needs no file, DH1012 to DH1014 are of writing, and DH1016 is a warning."""
    explained = {code for code in catalogue() if code.startswith("DH10")}
    assert explained - {row[1] for row in ROWS} == {"DH1001", "DH1012", "DH1013", "DH1014", "DH1016"}


@pytest.mark.parametrize("name", sorted(NAMES))
def test_a_file_larger_than_the_limit_is_refused_before_it_is_parsed(name: str, tmp_path: Path) -> None:
    path = tmp_path / "large"
    path.write_bytes(b" " * (8 * 2**20 + 1))
    with pytest.raises(ModelError) as caught:
        read_file(path, name)
    assert caught.value.diagnostics[0].code == "DH0105"


@pytest.mark.parametrize("name", sorted(NAMES - {"att", "yaml"}))  # one takes nearly any word, one has its own tests
@pytest.mark.parametrize("text", ["", "\n", "<", '"', "{", "[", "digraph {", "<a>", "\\", "1", "0 0 0", "<!--", "/*"])
def test_rubbish_ends_in_a_message(name: str, text: str, tmp_path: Path) -> None:
    path = tmp_path / "rubbish"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        read_file(path, name)
    assert render_all(caught.value.diagnostics)


@pytest.mark.parametrize(
    ("name", "piece"),
    [("gen", "<!--"), ("gen", '<"'), ("dot", "/*"), ("dot", '"'), ("mealy", "{"), ("fsm", "a "), ("graphml", "<a>")],
)
def test_a_hostile_repetition_is_refused_in_time_that_grows_with_its_length(
    name: str, piece: str, tmp_path: Path
) -> None:
    path = tmp_path / "long"
    path.write_text(piece * (200_000 // len(piece)))
    with pytest.raises(InputError):
        read_file(path, name)


def test_unknown_formats_are_named_with_the_known_ones() -> None:
    for path, name in (("a.xyz", None), ("-", None), ("a.fsm", "umdes")):
        with pytest.raises(UsageError) as caught:
            read_file(path, name)
        assert caught.value.diagnostics[0].code == "DH1001"
        assert "`gen`" in caught.value.diagnostics[0].helps[0]


def test_thousands_of_mistakes_are_refused_with_the_first_fifty(tmp_path: Path) -> None:
    count = 3_000
    path = tmp_path / "wrong.fsm"
    path.write_text(f"{count}\n" + "".join(f"\ns{number} 0 1\na t{number}\n" for number in range(count)))
    with pytest.raises(InputError) as caught:
        read_file(path)
    assert [found.code for found in caught.value.diagnostics] == ["DH1005"] * 50
    assert caught.value.diagnostics[-1].notes == (f"{count - 50} more mistakes were found and are not listed",)
