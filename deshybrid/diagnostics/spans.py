"""Places in a source text: what a message points at."""

from dataclasses import dataclass, field


@dataclass(frozen=True, slots=True, eq=False)
class SourceText:
    """A text under the name it is reported by, for example a model file's path as the user wrote it."""

    name: str
    text: str
    _lines: tuple[str, ...] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_lines", tuple(self.text.split("\n")))

    def line(self, number: int) -> str:
        """Return line `number`, counted from 1, without its end; empty beyond the text.

        >>> SourceText("a.yaml", "x: 1\\ny: 2").line(2)
        'y: 2'
        """
        return self._lines[number - 1].rstrip("\r") if 1 <= number <= len(self._lines) else ""


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of one line of a source: line and column count from 1, `length` counts characters."""

    source: SourceText
    line: int
    column: int
    length: int = 1

    def __str__(self) -> str:
        return f"{self.source.name}:{self.line}:{self.column}"
