"""What all values of the toolkit have in common, and the limits of its searches."""

import dataclasses
import importlib
import inspect
import pkgutil
from collections.abc import Iterator
from functools import cached_property

import pytest

from deshybrid import des
from deshybrid.des.composition import Composition

MODULES = [importlib.import_module(f"deshybrid.des.{module.name}") for module in pkgutil.iter_modules(des.__path__)]
WORK = {"Search"}  # no value: what the search for a cheapest set of signatures has so far
VALUES = sorted(
    {
        value
        for module in MODULES
        for name, value in vars(module).items()
        if dataclasses.is_dataclass(value) and not name.startswith("_") and name not in WORK
    },
    key=lambda value: value.__qualname__,
)
LIMITS = {
    "all_minimum_sets": {"max_states": 100_000},
    "build_location_observer": {"max_states": 100_000},
    "check_composition": {"max_pairs": 200_000, "max_memory": None},
    "check_observability": {"max_states": 100_000, "max_memory": None},
    "current_state_opacity": {"max_states": 100_000},
    "determinise": {"max_states": 100_000},
    "diagnosability": {"max_pairs": 2_000_000},
    "equivalent": {"max_states": 1_000_000},
    "included": {"max_states": 1_000_000},
    "initial_state_opacity": {"max_states": 100_000},
    "parallel": {"max_states": 100_000},
    "predictability": {"max_pairs": 2_000_000},
    "product": {"max_states": 100_000},
    "recover_observability": {"max_states": 100_000, "max_rounds": 10_000},
    "strong_detectability": {"max_pairs": 2_000_000},
    "strong_periodic_detectability": {"max_pairs": 2_000_000},
    "weak_detectability": {"max_states": 100_000},
    "weak_periodic_detectability": {"max_states": 100_000},
}


@pytest.mark.parametrize("value", VALUES, ids=lambda value: value.__qualname__)
def test_a_value_is_frozen_and_takes_no_further_attributes(value: type) -> None:
    """Except for what a value computes when it is first asked for."""
    assert value.__dataclass_params__.frozen  # type: ignore[attr-defined]
    assert "__slots__" in vars(value) or any(isinstance(part, cached_property) for part in vars(value).values())


def limits() -> Iterator[tuple[str, str, object]]:
    for module in MODULES:
        for name, function in inspect.getmembers(module, inspect.isfunction):
            if function.__module__ == module.__name__ and not name.startswith("_"):
                for parameter in inspect.signature(function).parameters.values():
                    if parameter.name.startswith("max_"):
                        yield name, parameter.name, parameter.default


def test_a_search_gives_up_where_its_documentation_says() -> None:
    found: dict[str, dict[str, object]] = {}
    for function, parameter, default in limits():
        found.setdefault(function, {})[parameter] = default
    assert {function: found[function] for function in LIMITS} == LIMITS
    searches = [inspect.signature(search).parameters for search in (Composition.find, Composition.build)]
    assert [parameters["max_states"].default for parameters in searches] == [1_000_000, 100_000]
