"""Arrays kept beside the model file: `{file: a.npz, key: A}`.

In: the name of a .npz file inside the model's folder and the name of an array in it.  Out: a float array.  A name that
leads out of the folder, a pickle, an array of anything but real numbers, and anything large are refused before a
number is read.  Source: the .npy format, version 1.0 to 3.0, as described by NumPy (`numpy.lib.format`).
"""

from pathlib import Path
from typing import IO, TYPE_CHECKING

from deshybrid.diagnostics import Diagnostic, ModelError, Span, diagnostic
from deshybrid.linear.arrays import FloatArray

if TYPE_CHECKING:
    from zipfile import ZipFile

    import numpy as np

MOST_BYTES = 64 * 2**20


def read_array(folder: Path | None, file: str, key: str, file_span: Span, key_span: Span) -> FloatArray:
    """Return array `key` of a .npz file in `folder`.

    Raises `ModelError`: DH0114 (the reference leads nowhere or out of the folder), DH0115 (what it leads to is no
    array of finite real numbers, or larger than 64 MiB).
    """
    import struct
    import zipfile
    import zlib

    path = path_inside(folder, file, file_span, (".npz",))
    try:
        with zipfile.ZipFile(path) as archive:
            return _array(archive, key, key_span)
    except (OSError, ValueError, EOFError, RuntimeError, zipfile.BadZipFile, zlib.error, struct.error) as error:
        text = f"`{file}` cannot be read as a .npz file"
        raise ModelError(diagnostic("DH0115", text, file_span, " ".join(str(error).split())[:100])) from None


def path_inside(folder: Path | None, file: str, span: Span, suffixes: tuple[str, ...]) -> Path:
    """Return the path of a file of the model's folder; raises `ModelError` (DH0114) where there is none such."""
    if folder is None:
        text = "a file can be referred to only from a model file, whose folder it lies in"
        raise ModelError(diagnostic("DH0114", text, span, helps=("write all into the model",)))
    if "\\" in file or ":" in file or Path(file).is_absolute() or ".." in Path(file).parts:
        raise ModelError(_outside(file, span))
    try:
        path = (folder / file).resolve(strict=True)
        inside = path.is_relative_to(folder.resolve())
    except (OSError, RuntimeError, ValueError):
        raise ModelError(diagnostic("DH0114", f"there is no file `{file}` in the model's folder", span)) from None
    if not inside:
        raise ModelError(_outside(file, span))
    if not path.is_file() or path.suffix not in suffixes:
        raise ModelError(diagnostic("DH0114", f"`{file}` is not a {' or '.join(suffixes)} file", span))
    return path


def _outside(file: str, span: Span) -> Diagnostic:
    helps = ("write a relative path without `..`, and put the file itself there",)
    return diagnostic("DH0114", f"`{file}` is not inside the model's folder", span, helps=helps)


def _array(archive: "ZipFile", key: str, span: Span) -> FloatArray:
    import numpy as np

    names = [name.removesuffix(".npy") for name in archive.namelist()]
    if key not in names:
        listed = ", ".join(f"`{name}`" for name in names[:12])
        raise ModelError(diagnostic("DH0115", f"the file has no array `{key}`", span, helps=(f"it has {listed}",)))
    info = archive.infolist()[names.index(key)]
    if info.file_size > MOST_BYTES:
        raise ModelError(diagnostic("DH0115", f"array `{key}` is larger than {MOST_BYTES // 2**20} MiB", span))
    with archive.open(info) as file:
        shape, dtype = _header(file)
        if dtype.kind not in "fiu" or dtype.itemsize > 8 or not 1 <= len(shape) <= 2:
            text = f"array `{key}` is no vector or matrix of real numbers"
            raise ModelError(diagnostic("DH0115", text, span, f"shape {shape}, type {dtype}"))
        if np.prod([float(size) for size in shape]) * dtype.itemsize > info.file_size:
            raise ValueError("the array is larger than its file")
    with archive.open(info) as file:
        array = np.lib.format.read_array(file, allow_pickle=False).astype(np.float64)
    if not np.isfinite(array).all():
        raise ModelError(diagnostic("DH0115", f"array `{key}` holds a number that is not finite", span))
    return array


def _header(file: IO[bytes]) -> "tuple[tuple[int, ...], np.dtype[np.generic]]":
    import numpy as np

    version = np.lib.format.read_magic(file)
    reader = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
    shape, _, dtype = reader(file)
    return shape, dtype


__all__ = ["MOST_BYTES", "read_array"]
