"""Other numbers for parameters in the text of a model file, be they its own or those of a file that it extends."""

from pathlib import Path

import pytest

from deshybrid.model.elaborate import elaborate
from deshybrid.model.parameters import parameter_text
from deshybrid.model.source import read_source

BASE = """{format: deshybrid/1, parameters: {k: 2, m: 2*k}, locations: {on: {A: [[-k]], f: [m]}}, state: [h],
output: [y], defaults: {C: [[1]]}, transitions: [{from: on, to: on, event: a}]}"""


@pytest.mark.parametrize(
    ("text", "changed"),
    [
        ("name: v\nextends: base.yaml\n", "name: v\nparameters: {k: 3.5, m: 8}\nextends: base.yaml\n"),
        ("extends: base.yaml\nparameters:  # 1\n  m: 7\n", "extends: base.yaml\nparameters:  # 1\n  k: 3.5\n  m: 8\n"),
        ("{extends: base.yaml}", "{parameters: {k: 3.5, m: 8}, extends: base.yaml}"),
        ("extends: base.yaml\nparameters: {m: 7}", "extends: base.yaml\nparameters: {k: 3.5, m: 8}"),
        ("extends: base.yaml\nparameters: { }", "extends: base.yaml\nparameters: {k: 3.5, m: 8 }"),
    ],
    ids=["no block", "block", "braces", "flow", "empty"],
)
def test_a_parameter_of_the_extended_file_is_written_into_the_file_that_extends_it(
    tmp_path: Path, text: str, changed: str
) -> None:
    (tmp_path / "base.yaml").write_text(BASE, encoding="utf-8")
    (tmp_path / "variant.yaml").write_text(text, encoding="utf-8")
    found = parameter_text(read_source(tmp_path / "variant.yaml"), {"k": "3.5", "m": "8"})
    assert found == changed
    (tmp_path / "variant.yaml").write_text(found, encoding="utf-8")
    again = read_source(tmp_path / "variant.yaml")
    dynamics = elaborate(again).locations[0].dynamics
    assert dynamics is not None
    assert (dynamics.A[0, 0], dynamics.f[0]) == (-3.5, 8.0)
    assert parameter_text(again, {"m": "8", "k": "3.5"}) == found
    assert (tmp_path / "base.yaml").read_text(encoding="utf-8") == BASE
