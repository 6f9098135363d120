"""The generated Python module as its user sees it; its equality with the reference is in `tests/lockstep`."""

import math
from types import ModuleType

import numpy as np
import pytest

from deshybrid.diagnostics import UsageError
from deshybrid.emit.provenance import Provenance
from deshybrid.emit.python import emit_python
from deshybrid.observer.tables import FlowTables, GeneratorTables, StepTables, TrackerState, plain_tables

ORIGIN = Provenance("gate", "models/gate.yaml", "3f9c" * 16, "0.1.0", ('Certificate: """ # \n\\',))
LOCATIONS = ("shut '\"\\", "open\n\u2028ω")


def gate() -> StepTables:
    """Two locations told apart by their events; one state, one input, one output."""
    generators = [np.zeros((0,) * axes) for axes in [3, 3, 3, 2, 3, 2, 3, 3, 3, 2, 2, 1]]
    flow = FlowTables(
        *(np.array([[[0.1]], [[0.7]]]), np.ones((2, 1, 1)) / 3, np.ones((2, 1, 1)), np.zeros((2, 1)), np.array([-0.0])),
        (True, True),
    )
    both = TrackerState((0, 1), -1, False, (0, 1), ())
    return StepTables(
        *("gate", 0.1, LOCATIONS, ("x",), ("u",), ("y",), ("close", "o'pen"), ()),
        flow,
        GeneratorTables((), *generators, (), ()),
        (TrackerState((0,), 0, False, (-1, 1), ()), TrackerState((1,), 1, False, (0, -1), ()), both),
        *(2, 2, (0, 1), 1, ((-1, -1), (-1, -1))),
        np.zeros((0, 1, 1)),
        np.zeros((0, 1)),
    )


@pytest.fixture
def module(tmp_path, monkeypatch) -> ModuleType:
    (tmp_path / "gate.py").write_text(
        emit_python(gate(), prefix="gate", provenance=ORIGIN)["gate.py"], encoding="utf-8"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.delitem(__import__("sys").modules, "gate", raising=False)
    return __import__("gate")


def test_names_and_constants_read_back_as_they_were(module):
    assert module.LOCATIONS == LOCATIONS
    assert module.EVENTS == ("close", "o'pen")
    assert repr(module.TABLES) == repr(plain_tables(gate()))
    assert math.copysign(1.0, module.TABLES["start"][0]) == -1.0


def test_observer_takes_event_names_and_returns_names(module):
    observer = module.Observer()
    first = observer.step([0.0], [0.0])
    assert (first.location, first.identified, first.entry_estimate, first.status) == (
        None,
        False,
        LOCATIONS,
        "searching",
    )
    second = observer.step([1.0], [2.0], "o'pen")
    assert (second.location, second.identified, second.entry_estimate) == (LOCATIONS[1], True, (LOCATIONS[1],))
    third = observer.step([0.0], [0.0])
    assert third.x == (0.7 * second.x[0] + 1.0 * (1 / 3) + 2.0 * 1.0 + 0.0,)
    observer.reset()
    assert observer.step([0.0], [0.0]) == first


def test_unknown_event_and_broken_sample_are_reported_in_the_status(module):
    observer = module.Observer()
    observer.step([0.0], [0.0], "close")
    assert observer.step([0.0], [math.nan]).status == "invalid"
    assert observer.step([0.0], [0.0], "close").status == "inconsistent"
    assert observer.step([0.0], [0.0], "no such event").status == "inconsistent"


def test_a_sample_of_the_wrong_size_is_an_error_of_the_caller(module):
    with pytest.raises(ValueError, match="2 inputs and 1 outputs, expected 1 and 1"):
        module.Observer().step([0.0, 0.0], [0.0])


def test_two_observers_do_not_share_their_state(module):
    first, second = module.Observer(), module.Observer()
    first.step([0.0], [0.0], "close")
    assert second.step([0.0], [0.0]).location is None


def test_self_test_passes_and_notices_a_changed_constant(module, capsys, monkeypatch):
    assert module.selftest() is True
    monkeypatch.setitem(module.TABLES, "start", (0.0,))
    assert module.selftest() is False
    assert capsys.readouterr().out.splitlines()[0] == "gate: ok, 400 samples equal the reference bit for bit"


@pytest.mark.parametrize("prefix", ["numpy-like", "class", "math", ""])
def test_a_prefix_that_is_no_module_name_is_refused(prefix):
    with pytest.raises(UsageError):
        emit_python(gate(), prefix=prefix, provenance=ORIGIN)
