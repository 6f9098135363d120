"""The report of a generated filter: its numbers are those of the filter, its names those of the model, and no more."""

import re
from html import unescape
from pathlib import Path

import numpy as np
import pytest

from deshybrid.bundle import Wishes
from deshybrid.emit.filter_report import FilterReport, emit_filter_report
from deshybrid.emit.filters import FilterModel, filter_facts
from deshybrid.emit.provenance import Provenance
from deshybrid.emit.report_numbers import number
from deshybrid.filter_bundle import files
from deshybrid.model.load import load
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.record import estimate_known
from deshybrid.stochastic.system import Mode, ModeTransition, StochasticSystem

ROOT = Path(__file__).parents[2]
ORIGIN = Provenance("small", "small.yaml", "3f9c", "0.1.0")


def page(system, kind="imm", gate=None, **more) -> str:
    n, p = len(system.x), system.bank.H.shape[1]
    model = FilterModel(system, kind, tuple(f"x{i}" for i in range(n)), (), tuple(f"y{i}" for i in range(p)), gate)
    return emit_filter_report(FilterReport(model, ORIGIN, tuple(filter_facts(model, "double", ORIGIN)), **more))


def words(text: str) -> str:
    """What a reader sees, in one line."""
    body = text[text.index("<body>") :]
    return " ".join(unescape(re.sub(r"<[^>]+>", " ", body)).split())


def one_mode(F=0.9, Q=0.5, name="still") -> StochasticSystem:
    mode = Mode(name, F=[[F]], H=[[1.0]], Q=[[Q]], R=[[2.0]])
    return StochasticSystem([mode], ModeTransition([name], [[1.0]]), x=[0.0], P=[[3.0]], mu=[1.0])


def test_deviations_are_those_of_a_long_stay_in_each_location():
    """Beside the steady-state equation: the filter itself, run for 400 rows in one location."""
    system = stochastic_system(load(ROOT / "models/hwang2006/turn.yaml"))
    shown = words(page(system))
    for mode in range(2):
        made = estimate_known(system, np.zeros((400, 2)), np.full(400, mode))
        deviations = np.sqrt(np.diagonal(made.P[-1]))
        told = " ".join(number(float(value)) for value in deviations)
        assert told in shown


def test_a_location_without_a_steady_filter_says_why():
    shown = words(page(one_mode(F=1.0, Q=0.0)))
    assert "none: no process noise reaches its eigenvalue 1 on the unit circle" in shown


def test_a_location_that_is_never_left_is_stayed_in_for_ever():
    assert "still 1 ∞ 1" in words(page(one_mode()))


@pytest.mark.parametrize("kind", ["imm", "mmae", "skf"])
@pytest.mark.parametrize("gate", [None, 0.99])
def test_statuses_and_calls_are_those_of_the_filter_that_was_generated(kind, gate):
    shown = words(page(one_mode(), kind, gate, files=("c/small.h", "python/small.py"), prefix="small"))
    assert ("outlier" in shown) is ("readmitted" in shown) is (gate is not None)
    assert ("There is no gate" in shown) is (gate is None)
    assert ("invalid" in shown) is ("running.step(u, y, location)" in shown) is (kind == "skf")
    assert "small_step(&state, &input, &output);" in shown


def test_names_of_a_hostile_model_are_text_and_nothing_else():
    text = page(one_mode(name="<script>alert(1)</script>"), summary="a < b & c")
    assert "<script" not in text
    assert "<script>alert(1)</script>" in words(text)
    assert "a < b & c" in words(text)


def test_the_bundle_holds_the_page_with_its_options_and_the_same_model_gives_the_same_bytes():
    path = str(ROOT / "models/hwang2006/turn.yaml")
    first, second = (files(path, "skf", Wishes(("c",)), gate=0.999)["report.html"] for _ in range(2))
    assert first == second
    shown = words(first.decode())
    for part in ("switching Kalman filter", "option gate 0.999", "option targets c", "Gate of 0.999:", "every 1 s"):
        assert part in shown, part
    assert "running.step" not in shown
