"""All formats of files, and reading and writing by name or suffix.

In: a path or a text.  Out: a `Document`, or the text of a file with warnings about what the format cannot hold.
Files are checked before they are parsed, as model files are: size, UTF-8, control characters.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass
from pathlib import Path

from deshybrid.diagnostics import SourceText, UsageError, diagnostic
from deshybrid.formats.ads import read_ads
from deshybrid.formats.att import read_att, write_att
from deshybrid.formats.document import Document, Written
from deshybrid.formats.dot import read_dot, read_mealy, write_dot, write_mealy
from deshybrid.formats.fsm import read_fsm, write_fsm
from deshybrid.formats.gen import read_gen, write_gen
from deshybrid.formats.graphml import read_graphml, write_graphml
from deshybrid.formats.own import read_own, write_json, write_yaml
from deshybrid.formats.rv import read_rv
from deshybrid.formats.wmod import read_wmod
from deshybrid.model.source import checked_text, read_bytes


@dataclass(frozen=True, slots=True)
class Format:
    """A format: its name, the suffixes that mean it, whose it is, its reader, and its writer where there is one."""

    name: str
    suffixes: tuple[str, ...]
    title: str
    read: Callable[[SourceText], Document]
    write: Callable[[Document], Written] | None = None


FORMATS = (
    Format("yaml", (".yaml", ".yml"), "the model language", read_own, write_yaml),
    Format("json", (".json",), "deshybrid's automata", read_own, write_json),
    Format("fsm", (".fsm",), "UMDES, DESUMA", read_fsm, write_fsm),
    Format("gen", (".gen",), "libFAUDES", read_gen, write_gen),
    Format("att", (".att", ".txt"), "AT&T text: OpenFst, foma, HFST", read_att, write_att),
    Format("dot", (".dot", ".gv"), "plain DOT", read_dot, write_dot),
    Format("mealy", (), "Mealy machines in DOT: LearnLib", read_mealy, write_mealy),
    Format("graphml", (".graphml",), "GraphML: networkx, yEd, Gephi", read_graphml, write_graphml),
    Format("rv", (), "Linux runtime verification", read_rv),
    Format("wmod", (".wmod",), "Supremica", read_wmod),
    Format("ads", (".ads",), "TCT", read_ads),
)


def format_of(path: str | Path | None, name: str | None = None, *, option: str = "--from") -> Format:
    """Return the format called `name`, or else the one that the path's suffix means.

    Raises `UsageError` (DH1001) where there is no such format; `option` is what the message advises to write.

    >>> format_of("plants/press.FSM").title
    'UMDES, DESUMA'
    """
    known = ", ".join(f"`{entry.name}`" for entry in FORMATS)
    if name is not None:
        chosen = next((entry for entry in FORMATS if entry.name == name), None)
        message = f"there is no format `{name[:40]}`"
    else:
        suffix = Path(str(path)).suffix.lower()
        chosen = next((entry for entry in FORMATS if suffix in entry.suffixes), None)
        message = f"no format has the suffix of `{path}`"
    if chosen is None:
        raise UsageError(diagnostic("DH1001", message, helps=(f"write `{option}` and one of {known}",)))
    return chosen


def read_file(
    path: str | Path,
    format_name: str | None = None,
    *,
    silent: Iterable[str] = (),
    symbols: str | Path | None = None,
) -> Document:
    """Return the document of a file; "-" is standard input, `silent` names outputs that mean ε.

    `symbols` is the symbol table of an AT&T text.  Raises `UsageError` (DH1001), `FormatError` (DH1002 to DH1011,
    DH1015), and for unreadable files `ModelError` (DH0102 to DH0105).

    >>> read_file("models/balluchi2012/fig2.yaml").des.locations
    ('0', '1', '2', '3', '4', '5')
    """
    chosen = format_of(path, format_name)
    if symbols is not None and chosen.name != "att":
        raise UsageError(diagnostic("DH1001", f"a symbol table belongs to `att`, and the format is `{chosen.name}`"))
    source = checked_text(*read_bytes(path))
    if symbols is not None:
        return read_att(source, checked_text(*read_bytes(symbols))).with_silent(silent)
    return chosen.read(source).with_silent(silent)


def write_text(document: Document, format_name: str) -> Written:
    """Return the text of a file in that format.

    Raises `UsageError` (DH1001) for a format that is only read, `FormatError` (DH1012, DH1013) where it cannot hold
    the document.

    >>> from deshybrid.des.automaton import DES
    >>> print(write_text(Document(DES.from_transitions([("1", "a", "1", "x")])), "att").text, end="")
    1   1   a   x
    """
    chosen = format_of(None, format_name, option="--to")
    if chosen.write is None:
        known = ", ".join(f"`{entry.name}`" for entry in FORMATS if entry.write is not None)
        message = f"`{chosen.name}` is read, not written"
        raise UsageError(diagnostic("DH1001", message, helps=(f"write one of {known}",)))
    return chosen.write(document)


def convert_file(
    source: str | Path,
    target: str | Path | None,
    read_as: str | None = None,
    write_as: str | None = None,
    *,
    silent: Iterable[str] = (),
    symbols: str | Path | None = None,
) -> Written:
    """Return the text that `target` is to hold, with all warnings of reading and writing; nothing is written here.

    Raises what `read_file` and `write_text` raise.

    >>> convert_file("models/balluchi2012/fig2.yaml", "fig2.dot").text.splitlines()[0]
    'digraph "fig2" {'
    """
    chosen = format_of("-" if target is None else target, write_as, option="--to").name
    document = read_file(source, read_as, silent=silent, symbols=symbols)
    written = write_text(document, chosen)
    return Written(written.text, (*document.warnings, *written.warnings))


__all__ = ["FORMATS", "Format", "convert_file", "format_of", "read_file", "write_text"]
