"""Stage 0, the source model: a file's text, its tree, and the folder its attachments may come from.

In: a path, standard input, or a text.  Out: `SourceModel`.  The text is checked before it is parsed: size, UTF-8,
control characters; line ends become "\\n".  Nothing of the file is ever evaluated or turned into Python objects.

A file that `extends` another one of its folder has everything of that file that it does not write itself: mappings are
joined key by key, all else replaces what was there.  Every node keeps its place, be it in the one file or in the other.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from types import MappingProxyType

from deshybrid.diagnostics import ModelError, SourceText, Span, diagnostic
from deshybrid.model.attachments import path_inside
from deshybrid.model.reader import FORBIDDEN, read_tree
from deshybrid.model.tree import Entry, MappingNode, Node, ScalarNode, form_of

MOST_BYTES = 8 * 2**20
MOST_EXTENDED = 8
_SUFFIXES = (".yaml", ".yml", ".json")


@dataclass(frozen=True, slots=True, eq=False)
class SourceModel:
    """A model file as read: `text` with its name, `tree` with a place at every node, `folder` for attached arrays.

    `folder` is None where the text came from standard input or from Python; attached arrays are then refused.
    `data` are the bytes as they were read, those of extended files behind them; `sha256` tells two models apart.
    """

    text: SourceText
    tree: MappingNode
    folder: Path | None = None
    data: bytes = field(default=b"", repr=False)

    @property
    def sha256(self) -> str:
        """Return the SHA-256 of the file's bytes, in hexadecimal.

        >>> parse_source("format: deshybrid/1").sha256[:8]
        '849cd5be'
        """
        from hashlib import sha256

        return sha256(self.data).hexdigest()

    def place(self, *keys: str) -> Span | None:
        """Return where the value under these keys is written, or None where it is not.

        >>> parse_source("{format: deshybrid/1, observer: {step: 0.1}}").place("observer", "step").column
        40
        """
        node: Node | None = self.tree
        for key in keys:
            node = node.get(key) if isinstance(node, MappingNode) else None
        return None if node is None else node.span


def read_source(path: str | Path) -> SourceModel:
    """Read a model file; "-" is standard input.

    Raises `ModelError`: DH0104 (no such file, not readable), DH0105 (larger than 8 MiB), DH0114 (a file that it extends
    is not there), and all of `parse_source`.
    """
    data, name = read_bytes(path)
    return _parse(checked_text(data, name), data, None if str(path) == "-" else Path(name).parent)


def read_bytes(path: str | Path) -> tuple[bytes, str]:
    """Return a file's bytes, at most one more than may be, and the name to report it by; "-" is standard input.

    Raises `ModelError` (DH0104) where there is no such file or it cannot be read.
    """
    name = str(path)
    if name == "-":
        return sys.stdin.buffer.read(MOST_BYTES + 1), "<stdin>"
    try:
        with open(name, "rb") as file:
            return file.read(MOST_BYTES + 1), name
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise ModelError(diagnostic("DH0104", f"cannot read `{name}`: {reason.lower()}")) from None
    except ValueError:
        raise ModelError(diagnostic("DH0104", f"cannot read `{name}`: not a path")) from None


def parse_source(text: str, name: str = "<text>", folder: Path | None = None) -> SourceModel:
    """Return the source model of a text.

    Raises `ModelError`: DH0103 (control character), DH0105 (too large), DH0113 (not a mapping), and what the reader of
    the tree raises (DH0101, DH0106 to DH0110).

    >>> parse_source("locations: [on, 012]").tree.get("locations").items[1].text
    '012'
    """
    data = text.encode("utf-8", "surrogatepass")
    _check_size(data, name)
    return _parse(_clean(text, name), data, folder)


def checked_text(data: bytes, name: str) -> SourceText:
    r"""Return bytes as text with line ends "\n", of any file that a stranger wrote, before anyone parses it.

    Raises `ModelError`: DH0102 (not UTF-8), DH0103 (control character), DH0105 (larger than 8 MiB).

    >>> checked_text(b"a\r\nb", "x").line(2)
    'b'
    """
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError as error:
        readable = data.decode("utf-8", "replace")
        before = data[: error.start].decode("utf-8")
        place = Span(SourceText(name, readable), before.count("\n") + 1, len(before) - (before.rfind("\n") + 1) + 1)
        label = f"byte 0x{data[error.start]:02x}"
        raise ModelError(
            diagnostic("DH0102", "the file is not UTF-8 text", place, label, helps=("save the file as UTF-8",))
        ) from None
    _check_size(data, name)
    return _clean(text, name)


def _check_size(data: bytes, name: str) -> None:
    if len(data) > MOST_BYTES:
        limit = f"`{name}` is larger than {MOST_BYTES // 2**20} MiB"
        raise ModelError(diagnostic("DH0105", limit, helps=("keep big matrices in a .npz file",)))


def _clean(text: str, name: str) -> SourceText:
    clean = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    source = SourceText(name, clean)
    bad = FORBIDDEN.search(clean)
    if bad is not None:
        line = clean.count("\n", 0, bad.start()) + 1
        place = Span(source, line, bad.start() - (clean.rfind("\n", 0, bad.start()) + 1) + 1)
        label = f"U+{ord(bad.group()):04X}"
        raise ModelError(diagnostic("DH0103", "the file holds a control character", place, label))
    return source


def _parse(source: SourceText, data: bytes, folder: Path | None, *, extended: int = 0) -> SourceModel:
    tree = read_tree(source)
    if not isinstance(tree, MappingNode):
        helps = ("begin with `format: deshybrid/1`",)
        raise ModelError(
            diagnostic(
                "DH0113", "a model file is a mapping of keys", tree.span, f"{form_of(tree)} is here", helps=helps
            )
        )
    named = tree.get("extends")
    if not isinstance(named, ScalarNode) or named.is_null:
        return SourceModel(source, tree, folder, data)
    if extended == MOST_EXTENDED:
        text = f"more than {MOST_EXTENDED} files extend each other"
        raise ModelError(diagnostic("DH0114", text, named.span, helps=("a file must not extend itself",)))
    path = path_inside(folder, named.text, named.span, _SUFFIXES)
    if Path(named.text).name != named.text:
        raise ModelError(diagnostic("DH0114", f"`{named.text}` is not in the folder of the model itself", named.span))
    below, _ = read_bytes(path)
    base = _parse(checked_text(below, str(path)), below, folder, extended=extended + 1)
    return SourceModel(source, _over(tree, base.tree), folder, data + base.data)


def _over(tree: MappingNode, base: MappingNode) -> MappingNode:
    """The entries of a tree, and those of its base that it does not write; in the order of the base, new ones last."""
    entries = dict(base.entries)
    for key, entry in tree.entries.items():
        below = base.get(key)
        if isinstance(below, MappingNode) and isinstance(entry.value, MappingNode):
            entries[key] = Entry(entry.key, _over(entry.value, below))
        else:
            entries[key] = entry
    return MappingNode(MappingProxyType(entries), tree.span)


__all__ = ["MOST_BYTES", "SourceModel", "checked_text", "parse_source", "read_bytes", "read_source"]
