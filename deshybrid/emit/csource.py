"""What all generated C has in common: its files and templates, names beside identifiers, numbers of samples.

In: names and numbers of a model.  Out: a template environment in which nothing is escaped unseen, and C text.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from math import isinf, isnan
from typing import TYPE_CHECKING

from deshybrid.emit.ctables import Real
from deshybrid.emit.identifiers import c_comment, c_real, c_string, markdown_code, unique_identifiers

if TYPE_CHECKING:
    from jinja2 import Environment

C_FILES = {
    "{}.h": "header.h.j2",
    "{}.c": "source.c.j2",
    "{}_selftest.c": "selftest.c.j2",
    "Makefile": "Makefile.j2",
    "CMakeLists.txt": "CMakeLists.txt.j2",
    "README.md": "README.md.j2",
}
"""The template of each file, whose name holds the prefix."""


@dataclass(frozen=True, slots=True)
class Named:
    """A name of the model with the identifier that stands for it."""

    name: str
    identifier: str


def named(names: Sequence[str], reserved: str) -> list[Named]:
    """Return each name with an identifier of its own, none of them `reserved`.

    >>> named(["a b", "a-b"], "UNKNOWN")[1]
    Named(name='a-b', identifier='a_b_2')
    """
    return [
        Named(name, identifier) for name, identifier in zip(names, unique_identifiers(names, [reserved]), strict=True)
    ]


def template_environment(*folders: str) -> "Environment":
    """Return the templates of the folders below `templates`, the first that has one wins.

    Every name of the model passes a filter at its place; an unknown name of a template is an error.

    >>> template_environment("c").get_template("Makefile.j2").name
    'Makefile.j2'
    """
    from jinja2 import ChoiceLoader, Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=ChoiceLoader([PackageLoader("deshybrid.emit", f"templates/{folder}") for folder in folders]),
        undefined=StrictUndefined,
        autoescape=False,
        keep_trailing_newline=True,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.filters.update(comment=c_comment, string=c_string, code=markdown_code)
    return environment


def braced(values: Sequence[float], real: Real) -> str:
    """Return the initialiser of an array of sample numbers; an empty one gets a filler.

    >>> braced([0.5, float("nan")], "float")
    '{0.5f, (float)NAN}'
    """
    return "{" + ", ".join(sampled(value, real) for value in values or (0.0,)) + "}"


def sampled(value: float, real: Real) -> str:
    """Return a number of a sample, which unlike a constant may be NaN or infinite.

    >>> sampled(float("-inf"), "double")
    '(double)-INFINITY'
    """
    if isnan(value):
        return f"({real})NAN"
    if isinf(value):
        return f"({real}){'-' if value < 0 else ''}INFINITY"
    return c_real(value, real)


__all__ = ["C_FILES", "Named", "braced", "named", "sampled", "template_environment"]
