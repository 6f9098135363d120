"""The mistakes found in one stage, gathered so that they are reported together, in the order of the file.

In: diagnostics, one by one.  Out: one `ModelError` with all of them.  One cause gives one message: a mistake in
`defaults` that every location inherits is reported once.
"""

from collections.abc import Iterable
from dataclasses import dataclass, field, replace

from deshybrid.diagnostics import Diagnostic, InputError, ModelError

MOST_MESSAGES = 50
_MOST_COMPARED = 500


@dataclass(slots=True)
class Problems:
    """A growing list of diagnostics; the only value of this package that changes, and it never leaves a stage.

    >>> from deshybrid.diagnostics import diagnostic
    >>> problems = Problems()
    >>> problems.add(diagnostic("DH0111", "unknown key `stat`"))
    >>> len(problems.found)
    1
    """

    found: list[Diagnostic] = field(default_factory=list)
    _seen: set[tuple[str, object]] = field(default_factory=set)

    def add(self, diagnostic: Diagnostic) -> None:
        """Keep a diagnostic, unless the same code was already reported at the same place."""
        cause = (diagnostic.code, diagnostic.span or diagnostic.message)
        if cause not in self._seen:
            self._seen.add(cause)
            self.found.append(diagnostic)

    def raise_all(self, error: type[InputError] = ModelError) -> None:
        """Raise `error` with all diagnostics by place, the first 50 if there are more; return if there is none."""
        if not self.found:
            return
        ordered = sorted(self.found, key=lambda d: (d.span.line, d.span.column) if d.span else (0, 0))
        kept = ordered[:MOST_MESSAGES]
        if len(ordered) > len(kept):
            more = f"{len(ordered) - len(kept)} more mistakes were found and are not listed"
            kept[-1] = replace(kept[-1], notes=(*kept[-1].notes, more))
        raise error(*kept)


def did_you_mean(word: str, known: Iterable[str]) -> tuple[str, ...]:
    """Return the help for an unknown word: the nearest known one, or all of them where they are few.

    >>> did_you_mean("stat", ["state", "input"])
    ('did you mean `state`?',)
    >>> did_you_mean("xyz", ["state", "input"])
    ('known: `state`, `input`',)
    """
    names = list(known)
    near = nearest(word, names)
    if near:
        return (f"did you mean `{near}`?",)
    return ("known: " + ", ".join(f"`{name}`" for name in names),) if 0 < len(names) <= 12 else ()


def nearest(word: str, known: Iterable[str]) -> str:
    """Return the known word most like `word`, or nothing if none is like it.

    >>> nearest("form", ["to", "from"]), nearest("xyz", ["to", "from"])
    ('from', '')
    """
    from difflib import get_close_matches  # only a mistake pays for it

    near = get_close_matches(word[:100], list(known)[:_MOST_COMPARED], n=1)
    return near[0] if near else ""


__all__ = ["MOST_MESSAGES", "Problems", "did_you_mean", "nearest"]
