"""Sphinx configuration: Markdown pages, the Python interface from the docstrings."""

import re
from collections.abc import Iterator
from importlib.metadata import version as installed_version
from itertools import pairwise
from typing import Any, TypeAlias

project = "deshybrid"
author = "the deshybrid developers"
copyright = "2026, the deshybrid developers"
version = release = installed_version("deshybrid")
extensions = ["myst_parser", "sphinx.ext.autodoc", "sphinx.ext.napoleon", "sphinx.ext.viewcode"]
myst_enable_extensions = ["colon_fence", "deflist"]
myst_heading_anchors = 3
autodoc_default_options = {"members": True, "ignore-module-all": True}
autodoc_member_order = "bysource"
autodoc_typehints = "signature"
napoleon_google_docstring = False
python_maximum_signature_line_length = 110
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "deshybrid"
html_static_path = ["_static"]
html_css_files = ["deshybrid.css"]

_WRITTEN: dict[str, list[str]] = {}
Text: TypeAlias = str | None
_HEADING = re.compile(r"\w+\n---+\n")
_ARRAY = re.compile(r"~?(?:numpy\.)?ndarray\[.*?dtype\[~?(?:numpy\.)?(float|complex)\w*\]\]")
_ITEM = re.compile(r"(- |\d+\. )")
_CODE = re.compile(r"`([^`]+)`")
_EMPHASIS = re.compile(r"\\\*(\w[\w -]*)\\\*(?!\w)")


def plain_to_rst(text: str) -> str:
    r"""Return a docstring, which is plain text with `code` in backticks, as the markup that Sphinx reads.

    Docstrings are written for people who read the source: |x| is a norm there, not a substitution.

    >>> print(plain_to_rst("|x| of `x` is:\n- small\n- large"))
    \|x\| of ``x`` is:
    <BLANKLINE>
    - small
    - large
    """
    blocks = [_block(block) for block in re.split(r"\n\s*\n", text.strip("\n"))]
    return "\n\n".join(_headed(blocks))


def _headed(blocks: list[str]) -> Iterator[str]:
    """What follows a section such as `Raises` without a heading of its own gets one, so that it does not join it."""
    inside = False
    for block in blocks:
        heading = ""
        if _HEADING.match(block):
            inside = True
        elif inside:
            inside = False
            heading = "Examples\n--------\n" if block.startswith(">>>") else "Notes\n-----\n"
        yield heading + block


def _block(block: str) -> str:
    lines = block.split("\n")
    if lines[0].lstrip().startswith(">>>"):
        return block
    if all(line.startswith("    ") for line in lines):  # a formula or an example
        return "::\n\n" + block
    return _separated(_escaped(block).split("\n"))


def _escaped(text: str) -> str:
    """Code in literal quotes, and nothing else that means something; code may run over the end of a line."""
    parts = _CODE.split(text.replace("``", "`"))
    marked = (f"\\ ``{part}``\\ " if number % 2 else _plain(part) for number, part in enumerate(parts))
    return re.sub(r"(?m)^(\s*)\\ |(?<=\s)\\ |\\ (?=\s|$)", r"\1", "".join(marked))


def _plain(text: str) -> str:
    return _EMPHASIS.sub(r"*\1*", re.sub(r"([\\|*`]|_(?!\w))", r"\\\1", text))


def _separated(lines: list[str]) -> str:
    """An empty line before and after every list that stands in the middle of a paragraph."""
    result = lines[:1]
    for before, line in pairwise(lines):
        starts, inside = bool(_ITEM.match(line)), bool(_ITEM.match(before)) or before.startswith("  ")
        ends = inside and not starts and not line.startswith(" ") and any(_ITEM.match(done) for done in lines)
        if (starts and not inside) or ends:
            result.append("")
        result.append(line)
    return "\n".join(result)


def _rewrite(_app: Any, _what: str, name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = [*plain_to_rst("\n".join(lines)).split("\n"), ""]
    _WRITTEN[name] = lines.copy()


def _restore(_app: Any, what: str, name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    """Napoleon takes what stands before the first colon of a property for its type."""
    if what in ("property", "attribute", "data"):
        lines[:] = _WRITTEN.pop(name, lines)


def _short(_app: Any, _what: str, _name: str, _object: Any, _options: Any, signature: Text, returns: Text) -> Any:
    """Signatures with the names of array types that the source has."""

    def shorten(text: Text) -> Text:
        return text and _ARRAY.sub(lambda found: f"{found[1].title()}Array", text)

    return shorten(signature), shorten(returns)


def _is_silent(_app: Any, _what: str, _name: str, value: Any, skip: bool, _options: Any) -> bool | None:
    """Fields of named tuples have a docstring that says nothing."""
    return True if str(getattr(value, "__doc__", "")).startswith("Alias for field number") else None


def setup(app: Any) -> None:
    """Rewrite docstrings before napoleon reads their sections, and mend afterwards what it should not have read."""
    app.connect("autodoc-process-docstring", _rewrite, priority=100)
    app.connect("autodoc-process-docstring", _restore, priority=900)
    app.connect("autodoc-process-signature", _short)
    app.connect("autodoc-skip-member", _is_silent)
