"""From a path or a text to a hybrid system in one call: `read_source`, then `elaborate`."""

from pathlib import Path

from deshybrid.model.elaborate import elaborate
from deshybrid.model.source import parse_source, read_source
from deshybrid.model.system import HybridSystem


def load(path: str | Path) -> HybridSystem:
    """Return the system of a model file (YAML or JSON); "-" reads standard input.

    Raises `ModelError` with coded, positioned messages where the file is malformed or contradicts itself.

    >>> load("models/balluchi2012/fig2.yaml").transitions[3].output_span.column
    39
    """
    return elaborate(read_source(path))


def loads(text: str, name: str = "<text>", folder: Path | None = None) -> HybridSystem:
    """Return the system of a model given as text; `folder` is where its attached arrays lie.

    Raises `ModelError` as `load` does.

    >>> loads("{format: deshybrid/1, locations: [1], transitions: [{from: 1, to: 1, event: a}]}").locations[0].name
    '1'
    """
    return elaborate(parse_source(text, name, folder))


__all__ = ["load", "loads"]
