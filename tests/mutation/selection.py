"""Which tests a mutant of a module must pass: the doctests of the module, then the quick tests, then the thorough."""

from pathlib import Path

_VALUES = "unit/test_des_values.py"
_QUICK = (_VALUES, "unit/test_des_texts.py", "unit/test_des_cases.py", "unit/test_des_figures.py")
_OBSERVABILITY = (*_QUICK, "property/test_des_definitions.py", "property/test_des_engines.py")
_RECOVERY = (
    *_QUICK,
    "unit/test_des_recovery_cases.py",
    "property/test_verify_plans.py",
    "property/test_des_recovery.py",
)
_OPERATIONS = (_VALUES, "unit/test_toolkit_operations.py", "unit/test_toolkit_python.py")
_LANGUAGES = (*_OPERATIONS, "property/test_toolkit_languages.py")
_CASES = (_VALUES, "unit/test_toolkit_verdicts.py", "unit/test_toolkit_on_the_fly.py")
_DETECTABILITY = (*_CASES, "property/test_toolkit_detectability.py")
_SECRETS = (*_CASES, "property/test_toolkit_secrets_and_faults.py")
_VERDICTS = (*_DETECTABILITY, *_SECRETS)
_GRAPHS = (_VALUES, "property/test_des_graphs.py")
_ALL = (*_QUICK, *_LANGUAGES, *_VERDICTS, *_OBSERVABILITY)

TESTS = {
    "automaton": (*_OPERATIONS, *_QUICK, *_CASES, "property/test_des_messages.py"),
    "batches": (*_QUICK, "property/test_des_batches.py", "property/test_des_definitions.py"),
    "bitsets": (*_LANGUAGES, *_DETECTABILITY),
    "candidates": _RECOVERY,
    "composed": (*_QUICK, "unit/test_toolkit_on_the_fly.py", "property/test_toolkit_composed.py"),
    "composition": (*_LANGUAGES, *_SECRETS),
    "confusions": _RECOVERY,
    "cycles": (*_GRAPHS, *_QUICK),
    "detectability": _DETECTABILITY,
    "faults": _SECRETS,
    "epsilon": (*_QUICK, "property/test_des_definitions.py"),
    "estimates": (*_LANGUAGES, *_DETECTABILITY),
    "hitting": _RECOVERY,
    "languages": _LANGUAGES,
    "lassos": (*_GRAPHS, *_VERDICTS),
    "minimum": _RECOVERY,
    "moves": _OBSERVABILITY,
    "observability": _OBSERVABILITY,
    "observer": _OBSERVABILITY,
    "opacity": _SECRETS,
    "operations": _LANGUAGES,
    "pairs": _OBSERVABILITY,
    "persistence": (*_QUICK, "property/test_des_definitions.py"),
    "plan": (*_QUICK, "unit/test_des_recovery_cases.py", "property/test_verify_plans.py"),
    "program": _RECOVERY,
    "replay": (*_QUICK, "property/test_des_witnesses.py"),
    "report": (*_QUICK, "property/test_des_messages.py"),
    "runs": (*_LANGUAGES, *_VERDICTS),
    "search": (*_GRAPHS, *_OPERATIONS, *_CASES),
    "separation": _RECOVERY,
    "signatures": _RECOVERY,
    "subsets": _OBSERVABILITY,
    "twins": _VERDICTS,
    "verdicts": (*_QUICK, "property/test_des_messages.py", "property/test_des_definitions.py"),
    "witness": (*_QUICK, "property/test_des_witnesses.py", "property/test_des_definitions.py"),
    "worklist": (*_GRAPHS, *_QUICK, *_OPERATIONS, *_CASES),
}
# These start another process, which loads the module as it is.
LEFT_OUT = (
    "tests/unit/test_des_cases.py::test_the_same_system_gives_the_same_text_under_any_hash_seed",
    "tests/unit/test_toolkit_python.py::test_networkx_is_not_loaded_before_it_is_asked_for",
)


def stages_of(module: str) -> list[tuple[str, ...]]:
    """The paths that pytest is given for a module, first the quick, then the thorough; without what is not there."""
    files = dict.fromkeys([f"deshybrid/des/{module}.py", *(f"tests/{name}" for name in TESTS.get(module, _ALL))])
    there = [name for name in files if Path(name).exists()]
    thorough = tuple(name for name in there if name.startswith("tests/property/"))
    quick = tuple(name for name in there if name not in thorough)
    return [tests for tests in (quick, thorough) if tests]


__all__ = ["LEFT_OUT", "TESTS", "stages_of"]
