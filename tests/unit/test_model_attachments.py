"""Arrays beside the model: read from inside its folder, refused from anywhere else."""

import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from deshybrid.diagnostics import ModelError
from deshybrid.model import attachments
from deshybrid.model.load import load, loads

MODEL = """\
format: deshybrid/1
state: [x, y]
locations:
  on: {A: {file: FILE, key: A}}
transitions: [{from: on, to: on, event: a}]
"""


def write(folder: Path, file: str = "a.npz") -> Path:
    path = folder / "m.yaml"
    path.write_text(MODEL.replace("FILE", file))
    return path


def code_of(path: Path) -> str:
    with pytest.raises(ModelError) as caught:
        load(path)
    assert len(caught.value.diagnostics) == 1
    return caught.value.diagnostics[0].code


@pytest.mark.parametrize("compressed", [False, True])
@pytest.mark.parametrize("kind", ["float64", "float32", "int8", "uint64", ">f8"])
def test_array_of_real_numbers_is_read(tmp_path: Path, kind: str, compressed: bool) -> None:
    save = np.savez_compressed if compressed else np.savez
    save(tmp_path / "a.npz", A=np.array([[1, 2], [3, 4]], dtype=kind))
    dynamics = load(write(tmp_path)).locations[0].dynamics
    assert dynamics is not None
    assert dynamics.A.tolist() == [[1, 2], [3, 4]]
    assert dynamics.A.dtype == np.float64


def test_array_in_fortran_order_is_read_by_rows(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", A=np.asfortranarray([[1.0, 2.0], [3.0, 4.0]]))
    dynamics = load(write(tmp_path)).locations[0].dynamics
    assert dynamics is not None
    assert dynamics.A.tolist() == [[1, 2], [3, 4]]
    assert dynamics.A.flags.c_contiguous


def test_array_in_a_folder_below_the_model_is_read(tmp_path: Path) -> None:
    (tmp_path / "arrays").mkdir()
    np.savez(tmp_path / "arrays" / "a.npz", A=np.eye(2))
    assert load(write(tmp_path, "arrays/a.npz")).locations[0].dynamics is not None


def test_link_that_leads_out_of_the_folder_is_refused(tmp_path: Path) -> None:
    inside = tmp_path / "inside"
    inside.mkdir()
    np.savez(tmp_path / "secret.npz", A=np.eye(2))
    os.symlink(tmp_path / "secret.npz", inside / "a.npz")
    assert code_of(write(inside)) == "DH0114"


def test_link_that_stays_in_the_folder_is_followed(tmp_path: Path) -> None:
    np.savez(tmp_path / "real.npz", A=np.eye(2))
    os.symlink(tmp_path / "real.npz", tmp_path / "a.npz")
    assert load(write(tmp_path)).locations[0].dynamics is not None


@pytest.mark.parametrize(
    "file", ["../a.npz", "sub/../../a.npz", "/a.npz", "C:\\\\a.npz", "..\\\\a.npz", ".", "a.npz/b.npz", "fifo.npz"]
)
def test_path_that_is_no_file_of_the_folder_is_refused(tmp_path: Path, file: str) -> None:
    np.savez(tmp_path / "a.npz", A=np.eye(2))
    os.mkfifo(tmp_path / "fifo.npz")
    (tmp_path / "sub").mkdir()
    path = tmp_path / "sub" / "m.yaml"
    path.write_text(MODEL.replace("FILE", f'"{file}"'))
    if file == "fifo.npz":
        path = write(tmp_path, file)
    assert code_of(path) == "DH0114"


def test_text_without_a_folder_refers_to_no_files() -> None:
    with pytest.raises(ModelError) as caught:
        loads(MODEL.replace("FILE", "a.npz"))
    assert caught.value.diagnostics[0].code == "DH0114"


def test_array_larger_than_the_limit_is_refused_by_its_stated_size(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(attachments, "MOST_BYTES", 100)
    np.savez_compressed(tmp_path / "a.npz", A=np.zeros((100, 100)))
    assert code_of(write(tmp_path)) == "DH0115"


@pytest.mark.parametrize("cut", [10, 60, 200, -30])
def test_truncated_file_is_refused(tmp_path: Path, cut: int) -> None:
    np.savez(tmp_path / "a.npz", A=np.eye(2))
    data = (tmp_path / "a.npz").read_bytes()
    (tmp_path / "a.npz").write_bytes(data[:cut])
    assert code_of(write(tmp_path)) == "DH0115"


@pytest.mark.parametrize("position", range(0, 520, 13))
def test_damaged_file_is_read_or_refused_but_never_breaks_the_reader(tmp_path: Path, position: int) -> None:
    np.savez_compressed(tmp_path / "a.npz", A=np.arange(4.0).reshape(2, 2))
    data = bytearray((tmp_path / "a.npz").read_bytes())
    data[position % len(data)] ^= 0xFF
    (tmp_path / "a.npz").write_bytes(bytes(data))
    path = write(tmp_path)
    assert outcome(path) in ("read", "DH0115", "DH0203")


def outcome(path: Path) -> str:
    try:
        load(path)
    except ModelError as error:
        return error.diagnostics[0].code
    return "read"


def test_member_that_is_no_array_is_refused(tmp_path: Path) -> None:
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("A.npy", b"not an array")
    assert code_of(write(tmp_path)) == "DH0115"


def test_array_with_a_number_of_a_size_that_no_plant_has_is_refused(tmp_path: Path) -> None:
    np.savez(tmp_path / "a.npz", A=np.array([[1.0, 2.0], [3.0, 1e200]]))
    assert code_of(write(tmp_path)) == "DH0124"
