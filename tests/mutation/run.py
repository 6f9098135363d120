"""Runs the tests of `deshybrid.des` on mutants of it, each in a child process of its own, and says which survive.

In: a module and some of its mutants.  Out: each with `killed`, `timeout` (killed too) or `survived`.
Idea: the parent loads everything but `deshybrid.des`; a child loads the mutant in place of the module and runs the
module's tests until one fails.  A child has a bound on its processor time and its memory: a mutant that needs more than
the tests ever need is killed by it.
"""

import gc
import importlib.abc
import importlib.machinery
import importlib.util
import os
import random
import resource
import sys
import types
from collections.abc import Iterator, Sequence
from pathlib import Path

import networkx  # noqa: F401  (loaded once here, not in every child; so are the next ones)
import numpy as np  # noqa: F401
import pytest
import scipy.optimize  # noqa: F401
from hypothesis import Phase, settings
from ruamel import yaml  # noqa: F401

from tests.mutation.mutants import Mutant, mutants, mutated
from tests.mutation.selection import LEFT_OUT, stages_of

ROOT = Path(__file__).parents[2]
SOURCES = ROOT / "deshybrid" / "des"
_OUTCOMES = {
    pytest.ExitCode.OK: "survived",
    pytest.ExitCode.TESTS_FAILED: "killed",
    pytest.ExitCode.INTERRUPTED: "killed",
}
SECONDS, BYTES = 300, 2 << 30  # what the tests may need at most, in every process
_SECONDS_OF: dict[tuple[str, ...], float] = {}


class _InPlaceOf(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Loads other source text in place of one module."""

    def __init__(self, module: str, text: str) -> None:
        self.name, self.text = f"deshybrid.des.{module}", text
        self.path = str(SOURCES / f"{module}.py")

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: types.ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if name != self.name:
            return None
        return importlib.util.spec_from_file_location(name, self.path, loader=self)

    def exec_module(self, module: types.ModuleType) -> None:
        exec(compile(self.text, self.path, "exec"), module.__dict__)


class _FirstBatch:
    """Of the systems that come in batches, only those of the first are asked about: nearly as good, and quicker."""

    def pytest_collection_modifyitems(self, items: list[pytest.Item]) -> None:
        items[:] = [item for item in items if not getattr(item, "callspec", None) or not _is_later_batch(item)]


def _is_later_batch(item: pytest.Item) -> bool:
    return bool(item.callspec.params.get("first"))  # type: ignore[attr-defined]


def mutants_of(module: str) -> list[Mutant]:
    """All mutants of a module."""
    return mutants(module, (SOURCES / f"{module}.py").read_text(encoding="utf-8"))


def chosen(every: list[Mutant], sample: int | None, seed: int = 0) -> list[Mutant]:
    """All of them, or a sample, in a seeded order: the first so many are a sample too, where a run is stopped."""
    count = len(every) if sample is None else min(sample, len(every))
    return random.Random(f"{seed} {every[0].module}").sample(every, count)


def verdicts(module: str, selected: list[Mutant]) -> Iterator[tuple[Mutant, str]]:
    """Yield each mutant with `killed`, `timeout` or `survived`; what passes the quick tests must pass the thorough."""
    source = (SOURCES / f"{module}.py").read_text(encoding="utf-8")
    for mutant in selected:
        outcome = "survived"
        for tests in stages_of(module):
            if outcome == "survived":
                seconds = int(1.5 * _needed(module, source, tests)) + 3
                outcome = fate(module, mutated(source, mutant), tests, seconds=seconds)[0]
        yield mutant, outcome


def _needed(module: str, source: str, tests: tuple[str, ...]) -> float:
    """The processor time of tests without a mutant; modules that share thorough tests share that."""
    if tests not in _SECONDS_OF:
        outcome, _SECONDS_OF[tests] = fate(module, source, tests)
        if outcome != "survived":
            raise SystemExit(f"the tests of {module} fail without a mutant: {outcome}")
    return _SECONDS_OF[tests]


def fate(module: str, text: str, tests: tuple[str, ...], *, seconds: int = SECONDS) -> tuple[str, float]:
    """Run tests with another text in place of a module; return what became of it, and the processor time."""
    gc.freeze()  # what is loaded here never becomes garbage in a child
    child = os.fork()
    if child == 0:
        try:
            os._exit(_run_tests(module, text, tests, seconds))
        except BaseException:
            os._exit(70)
    _, status, used = os.wait4(child, 0)
    if os.WIFSIGNALED(status):
        return "timeout", used.ru_utime
    outcome = _OUTCOMES.get(os.WEXITSTATUS(status))
    if outcome is None:
        raise SystemExit(f"the tests of {module} could not be run: exit status {os.WEXITSTATUS(status)}")
    return outcome, used.ru_utime


def _run_tests(module: str, text: str, tests: tuple[str, ...], seconds: int) -> int:
    nowhere = os.open(os.devnull, os.O_WRONLY)
    os.dup2(nowhere, 1)
    os.dup2(nowhere, 2)
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds))
    resource.setrlimit(resource.RLIMIT_AS, (BYTES, BYTES))
    sys.meta_path.insert(0, _InPlaceOf(module, text))
    settings.register_profile("mutation", derandomize=True, deadline=None, phases=[Phase.explicit, Phase.generate])
    pytest_options = [
        "-x",
        "-q",
        "--tb=no",
        "--assert=plain",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:unraisableexception",
        "--hypothesis-profile=mutation",
    ]
    skipped = [f"--deselect={name}" for name in LEFT_OUT]
    return int(pytest.main([*pytest_options, *skipped, *tests], plugins=[_FirstBatch()]))


__all__ = ["chosen", "fate", "mutants_of", "verdicts"]
