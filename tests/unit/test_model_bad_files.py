"""Every file of `bad_models` is refused with the code and at the line that `expected.txt` names.

Several of the files would create a folder `PWNED` if anything of them were executed.
"""

import os
from pathlib import Path

import pytest

from deshybrid.diagnostics import ModelError, catalogue, render_all
from deshybrid.model.load import load

FOLDER = Path(__file__).parent / "bad_models"
ROWS = [row.split() for row in (FOLDER / "expected.txt").read_text().splitlines() if not row.startswith("#")]


@pytest.mark.parametrize(("file", "code", "line"), ROWS, ids=[row[0] for row in ROWS])
def test_bad_model_file_is_refused_with_its_code_at_its_line(
    file: str, code: str, line: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(ModelError) as caught:
        load(FOLDER / file)
    first = caught.value.diagnostics[0]
    assert first.span is not None
    assert (first.code, first.span.line) == (code, int(line)), render_all(caught.value.diagnostics)
    assert all(found.span is not None and found.code in catalogue() for found in caught.value.diagnostics)
    assert os.listdir(tmp_path) == []


def test_every_bad_file_has_a_row_and_there_are_at_least_fifty() -> None:
    files = {path.name for path in FOLDER.iterdir()} - {"expected.txt", "arrays.npz", "broken.npz"}
    assert files == {row[0] for row in ROWS}
    assert len(files) >= 50


def test_every_code_of_the_model_language_is_provoked_by_some_bad_file() -> None:
    """DH0104 (no such file) needs no file; what the catalogue explains in ranges 01 and 02 is otherwise seen here."""
    explained = {code for code in catalogue() if code[:4] in ("DH01", "DH02")}
    assert explained - {row[1] for row in ROWS} == {"DH0104"}
