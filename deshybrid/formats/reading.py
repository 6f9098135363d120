"""One door for every file that describes a system: models, and automata of other tools.

In: a path, and perhaps the name of a format.  Out: a `HybridSystem` or a `DES`, with warnings.  The readers of other
tools' formats are loaded only for their suffixes, so that a model file is read as fast as ever.
"""

from pathlib import Path

from deshybrid.des.automaton import DES
from deshybrid.diagnostics import Diagnostic
from deshybrid.model.elaborate import elaborate
from deshybrid.model.source import read_source
from deshybrid.model.system import HybridSystem
from deshybrid.model.tree import MappingNode, ScalarNode

AUTOMATON = "deshybrid-des/1"
_OURS = ("", ".yaml", ".yml", ".json")


def read_system(path: str | Path, format_name: str | None = None) -> tuple[HybridSystem | DES, tuple[Diagnostic, ...]]:
    """Return the model or the automaton of a file, and warnings (DH1016) about what its reader passed over.

    The format is the suffix, or is named; a suffix that means nothing is that of a model.  "-" is standard input.
    Raises what `load` and `deshybrid.formats.table.read_file` raise.

    >>> read_system("models/balluchi2012/fig2.yaml")[0].name
    'fig2'
    """
    if not _is_ours(path, format_name):
        from deshybrid.formats.table import read_file

        document = read_file(path, format_name)
        return document.des, document.warnings
    source = read_source(path)
    if not is_automaton(source.tree):
        return elaborate(source), ()
    from deshybrid.formats.own import read_automaton

    return read_automaton(source.tree).des, ()


def _is_ours(path: str | Path, format_name: str | None) -> bool:
    """Model files and our JSON, by suffix or name; a suffix that means nothing is that of a model."""
    suffix = Path(path).suffix.lower()
    if format_name is not None or suffix in _OURS:
        return format_name in (None, "yaml", "json")
    from deshybrid.formats.table import FORMATS

    return not any(suffix in entry.suffixes for entry in FORMATS)


def is_automaton(tree: MappingNode) -> bool:
    """Return whether a file of ours says that it holds an automaton in the JSON form; else it is a model file.

    >>> from deshybrid.model.source import parse_source
    >>> is_automaton(parse_source("format: deshybrid/1").tree)
    False
    """
    given = tree.get("format")
    return isinstance(given, ScalarNode) and given.text.startswith(AUTOMATON.rstrip("1"))


__all__ = ["AUTOMATON", "is_automaton", "read_system"]
