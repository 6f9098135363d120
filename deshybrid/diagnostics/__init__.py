"""Spans, coded messages, their rendering and explanations, and the exception tree."""

from deshybrid.diagnostics.catalogue import Explanation, catalogue
from deshybrid.diagnostics.errors import (
    DeshybridError,
    FormatError,
    GainError,
    InputError,
    LimitReached,
    ModelError,
    TraceError,
    UsageError,
    raise_all,
)
from deshybrid.diagnostics.limits import OutOfResources, check_limits, check_stated_limits, within
from deshybrid.diagnostics.messages import Diagnostic, Label, diagnostic
from deshybrid.diagnostics.render import render, render_all
from deshybrid.diagnostics.spans import SourceText, Span

__all__ = [
    "DeshybridError",
    "Diagnostic",
    "Explanation",
    "FormatError",
    "GainError",
    "InputError",
    "Label",
    "LimitReached",
    "ModelError",
    "OutOfResources",
    "SourceText",
    "Span",
    "TraceError",
    "UsageError",
    "catalogue",
    "check_limits",
    "check_stated_limits",
    "diagnostic",
    "raise_all",
    "render",
    "render_all",
    "within",
]
