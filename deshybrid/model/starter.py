"""A small model to start from: `deshybrid new` writes it."""

import re

from deshybrid.diagnostics import UsageError, diagnostic

_STARTER = """\
format: deshybrid/1
name: {name}
summary: A tank that fills until its alarm rings, and drains.
parameters: {{k: 2.0, tau: 0.5}}
time: continuous
state:  {{h1: m, h2: m}}
input:  [u]
output: [y]
disturbance: [w]
bounds: {{state: 10, input: 1, disturbance: 0.05, measurement: 0.01}}
defaults: {{B: [[1], [0]], C: [[0, 1]], E: [[1], [0]]}}
locations:
  fill:  {{A: [[-1, 0], [k, -k/tau]], dwell: {{min: 2}}}}
  drain: {{A: [[-2, 0], [k, -k/tau]], dwell: {{min: 2}}}}
transitions:
  - {{from: fill, to: drain, event: open, emits: alarm}}
  - {{from: drain, to: fill, event: close, emits: null}}      # null: nothing is seen
observer: {{rate: 0.5, step: 0.01}}
"""


def starter_model(name: str) -> str:
    """Return the text of a small model file of that name, which every stage accepts.

    Raises `UsageError` (DH0305) for a name that is not a plain word.

    >>> starter_model("tank").splitlines()[1]
    'name: tank'
    """
    if not re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,63}", name):
        helps = ("a letter, then letters, digits, `_` or `-`",)
        raise UsageError(diagnostic("DH0305", f"`{name}` is no name for a model", helps=helps))
    return _STARTER.format(name=name)
