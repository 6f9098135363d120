"""Results on disk: every file is written whole or not at all."""

import os
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path

from deshybrid.diagnostics import UsageError, diagnostic


def write_whole(target: Path, content: bytes) -> None:
    """Write `content` to `target` by way of a temporary file beside it, so that no reader ever sees a part.

    Raises `UsageError` (DH0805) where the file cannot be written, for example because its folder does not exist.

    >>> import tempfile
    >>> folder = Path(tempfile.mkdtemp())
    >>> write_whole(folder / "a.txt", b"whole")
    >>> [entry.name for entry in folder.iterdir()]
    ['a.txt']
    """
    place = Path(os.path.realpath(target))  # a link stays a link; what it points to is written
    try:
        if place.exists() and not place.is_file() and not place.is_dir():
            place.write_bytes(content)  # a device or a pipe has no whole to replace
        else:
            _replace(place, content)
    except OSError as error:
        raise UsageError(diagnostic("DH0805", f"cannot write `{target}`: {error.strerror}")) from error


def _replace(place: Path, content: bytes) -> None:
    handle, temporary = tempfile.mkstemp(dir=place.parent, prefix=f".{place.name}.")
    try:
        with os.fdopen(handle, "wb") as stream:
            stream.write(content)
        os.chmod(temporary, 0o666 & ~_umask())
        os.replace(temporary, place)
    except OSError:
        Path(temporary).unlink(missing_ok=True)
        raise


def write_result(output: Path | None, content: bytes) -> None:
    """Write a command's result to `output`, or to standard output where it is None or `-`.

    A reader of standard output that has gone away (`| head`) is no mistake.  Raises `UsageError` (DH0805) where the
    result cannot be written.
    """
    if output is not None and str(output) != "-":
        write_whole(output, content)
        return
    try:
        sys.stdout.flush()
        sys.stdout.buffer.write(content)
        sys.stdout.buffer.flush()
    except OSError as error:
        _abandon_standard_output()
        if not isinstance(error, BrokenPipeError):
            raise UsageError(diagnostic("DH0805", f"cannot write standard output: {error.strerror}")) from error


def _abandon_standard_output() -> None:
    """What is left in the buffer must not fail once more when the process ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def write_tree(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write all files below `folder`, which is made where it is missing; names are relative, with `/`.

    Raises `UsageError` (DH0805) where a folder or file cannot be written.
    """
    for name, content in files.items():
        target = folder / name
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise UsageError(
                diagnostic("DH0805", f"cannot make the folder `{target.parent}`: {error.strerror}")
            ) from error
        write_whole(target, content)


def _umask() -> int:
    mask = os.umask(0)
    os.umask(mask)
    return mask
