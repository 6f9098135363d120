"""The journal of a campaign: a file that grows by one whole line a finished job, so that a campaign can go on.

In: a path and the header that the campaign has.  Out: the results that are there already, and a place for more.
The first line is the header, the line of job k comes k lines after it, in JSON.  A last line without its end was cut
off; it is dropped, and its job is run again.  Lines are written in the order of the jobs, so that the file has the same
bytes however often the campaign was interrupted, and with any number of workers.

Cost: one line a job.
"""

import json
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

from deshybrid.diagnostics import Diagnostic, UsageError, diagnostic
from deshybrid.simulate.campaign_jobs import DriveResult

FORMAT = "deshybrid-campaign-jobs/2"


class Journal:
    """An open journal: `finished` holds what was there, `append` adds a line.  To be used in a `with` block.

    Raises `UsageError`: DH0721 where the file is of another campaign, DH0722 where a line cannot be read, DH0805 where
    the file cannot be written.
    """

    def __init__(self, path: Path, header: Mapping[str, object]) -> None:
        first = {"format": FORMAT, **header}
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            self._file = path.open("a+b")
            self._file.seek(0)
            content = self._file.read()
        except OSError as error:
            raise UsageError(diagnostic("DH0805", f"cannot write `{path}`: {error.strerror}")) from error
        whole = content[: content.rfind(b"\n") + 1]
        lines = whole.splitlines()
        try:
            self.finished = _read(path, lines, first)
        except UsageError:
            self._file.close()
            raise
        self._file.truncate(len(whole))
        self._file.seek(0, os.SEEK_END)
        if not lines:
            self._add(first)

    def append(self, result: DriveResult) -> None:
        """Write the line of one job; jobs come in their order."""
        self._add(result.record())

    def _add(self, record: Mapping[str, object]) -> None:
        self._file.write(json.dumps(record, ensure_ascii=False, allow_nan=False).encode() + b"\n")
        self._file.flush()

    def __enter__(self) -> "Journal":
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()


def _read(path: Path, lines: Sequence[bytes], header: Mapping[str, object]) -> tuple[DriveResult, ...]:
    if not lines:
        return ()
    found = _tree(lines[0])
    if found != json.loads(json.dumps(header)):
        raise UsageError(_other_campaign(path, found, header))
    results = []
    for job, line in enumerate(lines[1:]):
        result = _result(line)
        if result is None or result.job != job:
            text = f"line {job + 2} of `{path}` is not the result of job {job}"
            helps = ("remove the file, or that line and all behind it; those jobs are then run again",)
            raise UsageError(diagnostic("DH0722", text, helps=helps))
        results.append(result)
    return tuple(results)


def _tree(line: bytes) -> object:
    try:
        return json.loads(line)
    except ValueError:
        return None


def _result(line: bytes) -> DriveResult | None:
    tree = _tree(line)
    try:
        return DriveResult.from_record(tree) if isinstance(tree, dict) else None
    except (KeyError, TypeError, ValueError):
        return None


def _other_campaign(path: Path, found: object, header: Mapping[str, object]) -> Diagnostic:
    there = found if isinstance(found, dict) else {}
    notes = tuple(
        f"`{key}` is {there[key]!r} there and {value!r} here"
        for key, value in header.items()
        if key in there and there[key] != value
    )
    helps = ("choose another folder, or remove the file",)
    return diagnostic("DH0721", f"`{path}` is not the journal of this campaign", notes=notes, helps=helps)
