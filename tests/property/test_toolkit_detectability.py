"""The four forms of detectability against their definitions on the observer, and their words against the estimates."""

import random
from collections import Counter

import pytest

from deshybrid.des.automaton import DES
from deshybrid.des.detectability import (
    DetectabilityReport,
    strong_detectability,
    strong_periodic_detectability,
    weak_detectability,
    weak_periodic_detectability,
)
from tests import naive_toolkit as naive
from tests.strategies import random_des

BATCH = 500
QUESTIONS = (strong_detectability, weak_detectability, strong_periodic_detectability, weak_periodic_detectability)


def assert_word_proves_the_answer(des: DES, report: DetectabilityReport) -> None:
    word = report.word
    assert word is not None
    assert word.around
    for *during, final in naive.estimates_on_lasso(des, list(word.before), list(word.around), list(word.after)):
        if report.kind == "strong":
            assert len(final) > 1
        elif report.kind == "weak":
            assert {len(estimate) for estimate in during} == {1}
        elif report.kind == "strong periodic":
            assert min(len(estimate) for estimate in during) > 1
        else:
            assert len(during[-1]) == 1


@pytest.mark.parametrize("first", range(0, 2000, BATCH))
def test_detectability_agrees_with_the_definitions_and_every_word_proves_its_answer(first: int) -> None:
    kinds: Counter[tuple[str, bool]] = Counter()
    for seed in range(first, first + BATCH):
        des = random_des(random.Random(seed))
        expected = naive.detectable(des)
        for ask in QUESTIONS:
            report = ask(des)
            assert report.holds == expected[report.kind], (seed, report)
            if report.holds == report.kind.startswith("weak"):
                assert_word_proves_the_answer(des, report)
            else:
                assert report.word is None
            if report.runs is not None:
                assert naive.twin_faults(des, report.runs) == []
                assert report.runs.runs[0][-1].location != report.runs.runs[1][-1].location
            kinds[report.kind, report.holds] += 1
    assert len(kinds) == 8
    assert min(kinds.values()) >= 25, kinds
