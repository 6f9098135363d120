"""Sphinx configuration: Markdown pages, the Python interface from the docstrings."""

import re
from importlib.metadata import version as installed_version
from itertools import pairwise
from typing import Any

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
exclude_patterns = ["_build"]
html_theme = "furo"
html_title = "deshybrid"

_ITEM = re.compile(r"(- |\d+\. )")
_CODE = re.compile(r"`([^`]+)`")


def plain_to_rst(text: str) -> str:
    r"""Return a docstring, which is plain text with `code` in backticks, as the markup that Sphinx reads.

    Docstrings are written for people who read the source: |x| is a norm there, not a substitution.

    >>> print(plain_to_rst("|x| of `x` is:\n- small\n- large"))
    \|x\| of ``x`` is:
    <BLANKLINE>
    - small
    - large
    """
    blocks = re.split(r"\n\s*\n", text.strip("\n"))
    return "\n\n".join(_block(block) for block in blocks)


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
    return re.sub(r"([\\|*`]|_(?!\w))", r"\\\1", text)


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


def _rewrite(_app: Any, _what: str, _name: str, _object: Any, _options: Any, lines: list[str]) -> None:
    lines[:] = [*plain_to_rst("\n".join(lines)).split("\n"), ""]


def setup(app: Any) -> None:
    """Rewrite docstrings before napoleon reads their sections."""
    app.connect("autodoc-process-docstring", _rewrite, priority=100)
