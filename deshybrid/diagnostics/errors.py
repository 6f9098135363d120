"""The exception tree.  Every error the user can cause carries coded diagnostics; nothing else is raised on input.

`InputError` ends a command with exit code 2, `LimitReached` with 3.  A negative verdict is a value, not an exception.
"""

from collections.abc import Iterable

from deshybrid.diagnostics.messages import Diagnostic


class DeshybridError(Exception):
    """An error with one or more coded, positioned diagnostics."""

    def __init__(self, *diagnostics: Diagnostic) -> None:
        self.diagnostics = diagnostics
        super().__init__("; ".join(f"{d.code}: {d.message}" for d in diagnostics))


class InputError(DeshybridError):
    """The input or the call is wrong (exit code 2)."""


class ModelError(InputError):
    """A model file is malformed or contradicts itself."""


class TraceError(InputError):
    """A trace file is malformed or does not fit its model."""


class FormatError(InputError):
    """A file of another tool's format is malformed or uses something this reader does not know."""


class UsageError(InputError):
    """A command or function was called with arguments that do not fit together."""


class GainError(DeshybridError):
    """No observer gain does what was asked; says for which location and why."""


class LimitReached(DeshybridError):
    """A stated limit (states, time, memory) was reached, so the question stays undecided (exit code 3)."""


def raise_all(diagnostics: Iterable[Diagnostic], error: type[DeshybridError]) -> None:
    """Raise `error` with all errors among `diagnostics`, or return if there is none.

    >>> raise_all([], ModelError)
    """
    errors = tuple(d for d in diagnostics if d.severity == "error")
    if errors:
        raise error(*errors)
