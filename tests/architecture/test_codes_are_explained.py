"""Every code that a message may carry has exactly one explanation, and every explanation is of a code in use."""

import pathlib
import re
from collections import Counter

import deshybrid
from deshybrid.diagnostics import catalogue

ROOT = pathlib.Path(deshybrid.__file__).parent
CODE = re.compile(r'"(DH\d{4})"')


def codes_in_use() -> set[str]:
    return {code for path in ROOT.rglob("*.py") for code in CODE.findall(path.read_text(encoding="utf-8"))}


def test_every_code_in_use_is_explained() -> None:
    assert codes_in_use() - set(catalogue()) == set()


def test_every_explained_code_is_in_use() -> None:
    assert set(catalogue()) - codes_in_use() == set()


def test_no_code_is_explained_twice() -> None:
    texts = (ROOT / "diagnostics" / "explanations").glob("*.md")
    found = Counter(code for text in texts for code in re.findall(r"^## (DH\d{4}):", text.read_text(), re.MULTILINE))
    assert [code for code, count in found.items() if count > 1] == []
