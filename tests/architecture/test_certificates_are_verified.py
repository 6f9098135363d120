"""Every certificate that a test makes goes through the verifier."""

import ast
from pathlib import Path

TESTS = Path(__file__).parents[1]
MAKERS = {"certify_by_inequalities", "certify_forms"}


def test_tests_make_certificates_by_forms_through_the_helper_that_verifies_them() -> None:
    found = []
    for path in sorted(TESTS.rglob("*.py")):
        tree = ast.parse(path.read_text(encoding="utf-8"))
        names = {alias.name for node in ast.walk(tree) if isinstance(node, ast.ImportFrom) for alias in node.names}
        if names & MAKERS:
            found.append(str(path.relative_to(TESTS)))
    assert found == ["certificates.py"]
