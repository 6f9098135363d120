"""What notebooks show of a value: a picture, and above it what the value says of itself.

A class says here *that* it has a picture; how it is drawn is registered from above, by `deshybrid.emit.notebook`, since
this layer and the automata on it know nothing of drawing.  Jupyter, VS Code and others ask for `_repr_mimebundle_`.
"""

from functools import singledispatch

_MOST_LINES, _MOST_COLUMNS = 40, 400


@singledispatch
def notebook_picture(_value: object) -> str | None:
    """Return the picture of a value as SVG; None where there is none, and the notebook shows text alone.

    >>> notebook_picture(1)
    """
    return None


class Pictured:
    """A value that notebooks show as its picture."""

    __slots__ = ()

    def _drawn(self) -> object:
        """The value whose picture is shown: itself, or one that it holds."""
        return self

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        """Return what is shown, by media type; `include` and `exclude` are left to the notebook, which picks."""
        picture = notebook_picture(self._drawn())
        return {} if picture is None else {"image/svg+xml": picture}


class Explained(Pictured):
    """A value that notebooks show as its text, above its picture."""

    __slots__ = ()

    def _repr_mimebundle_(self, include: object = None, exclude: object = None) -> dict[str, str]:
        """Return what is shown, by media type."""
        from html import escape

        shown = super()._repr_mimebundle_()
        text = escape(_beginning(str(self)))
        return shown | {"text/html": f"<pre>{text}</pre>\n{shown.get('image/svg+xml', '')}"}


def _beginning(text: str) -> str:
    """What fits a page; of a large system thousands of names may fail."""
    lines = text.splitlines()
    kept = [line if len(line) <= _MOST_COLUMNS else f"{line[:_MOST_COLUMNS]} …" for line in lines[:_MOST_LINES]]
    left_out = len(lines) - len(kept)
    return "\n".join(kept) + (f"\n… {left_out} more lines: print() shows them" if left_out else "")


__all__ = ["Explained", "Pictured", "notebook_picture"]
