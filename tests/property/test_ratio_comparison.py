"""The ratio comparison against its definition, read off sample by sample."""

import math

from hypothesis import given
from hypothesis import strategies as st

from deshybrid.model.system import RatioComparison
from deshybrid.simulate.comparison import compare_ratios

RULE = RatioComparison("above", "below", {"a": 4.0, "b": 3.8, "c": -2.0}, "none", band=0.04, debounce=0.3, slowest=1.0)
SAMPLES = st.lists(
    st.tuples(st.sampled_from([7.4, 7.6, 7.8, 8.0, -4.0, 5.0, math.nan]), st.sampled_from([2.0, 1.0, -2.0, math.nan])),
    min_size=1,
    max_size=30,
)


def fits(above: float, below: float) -> str:
    if math.isnan(above) or math.isnan(below) or abs(below) <= RULE.slowest:
        return "none"
    distance = {name: abs(above / (ratio * below) - 1.0) for name, ratio in RULE.ratio.items()}
    near = [name for name in distance if distance[name] <= RULE.band]
    return min(near, key=distance.__getitem__) if near else "none"


def naive(time: list[float], answers: list[str], row: int) -> str:
    """The answer of the latest stretch of equal answers that lasted for the debounce up to a row that has come."""
    for end in range(row, -1, -1):
        first = end
        while first > 0 and answers[first - 1] == answers[end]:
            first -= 1
        if time[end] - time[first] >= RULE.debounce - 1e-9:
            return answers[end]
    return "none"


@given(SAMPLES)
def test_a_location_is_named_once_its_ratio_has_been_the_nearest_in_the_band_for_the_debounce(samples):
    time = [0.1 * row for row in range(len(samples))]
    answers = [fits(above, below) for above, below in samples]
    named = compare_ratios(RULE, time, [above for above, _ in samples], [below for _, below in samples])
    assert list(named) == [naive(time, answers, row) for row in range(len(samples))]
