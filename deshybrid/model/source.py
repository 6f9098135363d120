"""Stage 0, the source model: a file's text, its tree, and the folder its attachments may come from.

In: a path, standard input, or a text.  Out: `SourceModel`.  The text is checked before it is parsed: size, UTF-8,
control characters; line ends become "\\n".  Nothing of the file is ever evaluated or turned into Python objects.
"""

import sys
from dataclasses import dataclass, field
from pathlib import Path

from deshybrid.diagnostics import ModelError, SourceText, Span, diagnostic
from deshybrid.model.reader import FORBIDDEN, read_tree
from deshybrid.model.tree import MappingNode, form_of

MOST_BYTES = 8 * 2**20


@dataclass(frozen=True, slots=True, eq=False)
class SourceModel:
    """A model file as read: `text` with its name, `tree` with a place at every node, `folder` for attached arrays.

    `folder` is None where the text came from standard input or from Python; attached arrays are then refused.
    `data` are the bytes as they were read; `sha256` tells two files apart.
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


def read_source(path: str | Path) -> SourceModel:
    """Read a model file; "-" is standard input.

    Raises `ModelError`: DH0104 (no such file, not readable), DH0105 (larger than 8 MiB), and all of `parse_source`.
    """
    name = str(path)
    if name == "-":
        return _decode(sys.stdin.buffer.read(MOST_BYTES + 1), "<stdin>", None)
    try:
        with open(name, "rb") as file:
            data = file.read(MOST_BYTES + 1)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise ModelError(diagnostic("DH0104", f"cannot read `{name}`: {reason.lower()}")) from None
    except ValueError:
        raise ModelError(diagnostic("DH0104", f"cannot read `{name}`: not a path")) from None
    return _decode(data, name, Path(name).parent)


def parse_source(text: str, name: str = "<text>", folder: Path | None = None) -> SourceModel:
    """Return the source model of a text.

    Raises `ModelError`: DH0103 (control character), DH0105 (too large), DH0113 (not a mapping), and what the reader of
    the tree raises (DH0101, DH0106 to DH0110).

    >>> parse_source("locations: [on, 012]").tree.get("locations").items[1].text
    '012'
    """
    return _parse(text, name, folder, text.encode("utf-8", "surrogatepass"))


def _decode(data: bytes, name: str, folder: Path | None) -> SourceModel:
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
    return _parse(text, name, folder, data)


def _parse(text: str, name: str, folder: Path | None, data: bytes) -> SourceModel:
    if len(data) > MOST_BYTES:
        limit = f"`{name}` is larger than {MOST_BYTES // 2**20} MiB"
        raise ModelError(diagnostic("DH0105", limit, helps=("keep big matrices in a .npz file",)))
    clean = text.removeprefix("\ufeff").replace("\r\n", "\n").replace("\r", "\n")
    source = SourceText(name, clean)
    bad = FORBIDDEN.search(clean)
    if bad is not None:
        line = clean.count("\n", 0, bad.start()) + 1
        place = Span(source, line, bad.start() - (clean.rfind("\n", 0, bad.start()) + 1) + 1)
        label = f"U+{ord(bad.group()):04X}"
        raise ModelError(diagnostic("DH0103", "the file holds a control character", place, label))
    tree = read_tree(source)
    if not isinstance(tree, MappingNode):
        helps = ("begin with `format: deshybrid/1`",)
        raise ModelError(
            diagnostic(
                "DH0113", "a model file is a mapping of keys", tree.span, f"{form_of(tree)} is here", helps=helps
            )
        )
    return SourceModel(source, tree, folder, data)


__all__ = ["MOST_BYTES", "SourceModel", "parse_source", "read_source"]
