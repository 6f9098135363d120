"""Files that were damaged byte by byte, as transfers, editors and attackers do: read or refused, never a traceback."""

import random
from pathlib import Path

import pytest

from deshybrid.des.automaton import DES
from deshybrid.diagnostics import Diagnostic, InputError, catalogue, render_all
from deshybrid.formats.document import Document
from deshybrid.formats.reading import read_system
from deshybrid.formats.table import FORMATS, write_text
from deshybrid.model.abstraction import abstract
from tests.unit.test_formats_files import FAUDES, KERNEL, LEARNED, SUPREMICA, TCT, UMDES

SAMPLE = Document(
    DES.from_transitions(
        [("1", "a", "2", "a"), ("2", "b", "1", None), ("2", "a", "2", "a"), ("1", "c", "1", "c")], initial=["1"]
    ),
    marked=("1", "2"),
)
OTHERS = {"fsm": UMDES, "gen": FAUDES, "mealy": LEARNED, "rv": KERNEL, "wmod": SUPREMICA, "ads": TCT}
PIECES = [
    *(
        b"\0",
        b"\xff",
        b"\xef\xbb\xbf",
        b"\r",
        b"\n",
        b"\r\n",
        b"\t",
        b" ",
        b"\xc2\x85",
        b"\xe2\x80\xa8",
        b"\xe2\x80\xae",
    ),
    *(b'"', b"'", b"\\", b"\\N", b"<", b">", b"&", b"&amp;", b"<!--", b"-->", b"<![CDATA[", b"<?x?>", b"<!DOCTYPE a>"),
    *(b"{", b"}", b"[", b"]", b"->", b";", b"%", b"#", b"/*", b"/", b"*", b":", b"&a *a", b"!!python/object:os.system"),
    *(
        b"99999999999999999999",
        b"-1",
        b"1e9",
        b"0x0",
        b"+o+",
        b"uo",
        b"null",
        b"\xed\xa0\x80",
        "１".encode(),
        "²".encode(),
    ),
]


def samples(name: str) -> list[bytes]:
    entry = next(entry for entry in FORMATS if entry.name == name)
    written = [] if entry.write is None else [write_text(SAMPLE, name).text]
    return [text.encode() for text in [*written, *([OTHERS[name]] if name in OTHERS else [])]]


def mutated(rng: random.Random, data: bytes) -> bytes:
    """The file with one to eight changes: a byte, a cut, a piece of syntax, a repetition, a line."""
    for _ in range(rng.choice([1, 1, 1, 2, 3, 8])):
        start = rng.randrange(len(data) + 1)
        end = min(len(data), start + rng.choice([1, 1, 2, 5, 30]))
        lines = data.split(b"\n")
        lines.insert(rng.randrange(len(lines) + 1), rng.choice(lines))
        data = rng.choice(
            [
                data[:start] + bytes([rng.randrange(256)]) + data[start + 1 :],
                data[:start] + data[end:],
                data[:start] + rng.choice(PIECES) + data[start:],
                data[:start] + data[start:end] * rng.choice([2, 50]) + data[end:],
                b"\n".join(lines),
                data[:start],
            ]
        )
    return data


def assert_read_or_refused(path: Path, name: str) -> bool:
    """A system whose names are usable everywhere, or coded messages that point into the file."""
    problems: tuple[Diagnostic, ...] = ()
    try:
        system, _ = read_system(path, name)
        des = system if isinstance(system, DES) else abstract(system)
        assert des.initial
        assert all(text.isprintable() and text for text in (des.name, *des.locations, *des.events))
    except InputError as error:
        problems = error.diagnostics
        assert render_all(problems)
    assert all(found.code in catalogue() for found in problems)
    assert all(found.span is not None and found.span.line >= 1 for found in problems)
    return not problems


@pytest.mark.parametrize("name", [entry.name for entry in FORMATS])
@pytest.mark.parametrize("count", [150, pytest.param(5_000, marks=pytest.mark.campaign)])
def test_a_file_damaged_byte_by_byte_is_read_or_refused_with_a_place(name: str, count: int, tmp_path: Path) -> None:
    path, rng, originals = tmp_path / "damaged", random.Random(name), samples(name)
    answers = []
    for _ in range(count):
        path.write_bytes(mutated(rng, rng.choice(originals)))
        answers.append(assert_read_or_refused(path, name))
    assert 0 < sum(answers) < count  # both happen: the damage is neither hopeless nor harmless


@pytest.mark.parametrize("name", [entry.name for entry in FORMATS])
@pytest.mark.parametrize("form", ["windows", "byte order mark", "no last line end", "blank lines"])
def test_what_editors_do_to_a_file_changes_nothing(name: str, form: str, tmp_path: Path) -> None:
    for number, data in enumerate(samples(name)):
        plain, edited = tmp_path / f"plain{number}", tmp_path / "other" / f"plain{number}"
        edited.parent.mkdir(exist_ok=True)
        plain.write_bytes(data)
        edited.write_bytes(
            {
                "windows": data.replace(b"\r\n", b"\n").replace(b"\n", b"\r\n"),
                "byte order mark": b"\xef\xbb\xbf" + data,
                "no last line end": data.rstrip(b"\n"),
                "blank lines": data + b"\n\n",
            }[form]
        )
        before, after = (read_system(path, name)[0] for path in (plain, edited))
        assert isinstance(before, DES) == isinstance(after, DES)
        same = [system if isinstance(system, DES) else abstract(system) for system in (before, after)]
        assert same[0] == same[1]
