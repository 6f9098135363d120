"""What each code means; `deshybrid explain CODE` prints it.

Ranges: 01 file and syntax, 02 model, 03 traces and calls, 04 current-location observability and signatures,
05 gains and certificates, 06 observer and detector, 07 simulation, 08 emission, 09 limits, 10 files of other tools.
The sections live in `explanations/`, one text a range, so that a part of the project owns its own codes.
"""

from dataclasses import dataclass
from functools import cache
from importlib import resources
from types import MappingProxyType


@dataclass(frozen=True, slots=True)
class Explanation:
    """A code with its title (one line) and its text (what is wrong, an example, what to do)."""

    code: str
    title: str
    text: str


def _parse(text: str) -> list[Explanation]:
    """Sections begin with `## DHnnnn: title`; what follows up to the next section is the explanation."""
    sections = []
    for block in ("\n" + text).split("\n## ")[1:]:
        head, _, body = block.partition("\n")
        code, _, title = head.partition(": ")
        sections.append(Explanation(code.strip(), title.strip(), body.strip()))
    return sections


@cache
def catalogue() -> MappingProxyType[str, Explanation]:
    """Return all explanations by code, in order of the codes.

    >>> catalogue()["DH0101"].code
    'DH0101'
    """
    folder = resources.files("deshybrid.diagnostics") / "explanations"
    texts = sorted((entry.name, entry.read_text(encoding="utf-8")) for entry in folder.iterdir())
    found = [section for _, text in texts for section in _parse(text)]
    return MappingProxyType({section.code: section for section in sorted(found, key=lambda section: section.code)})
