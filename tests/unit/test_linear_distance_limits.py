"""The distance of locations whose responses outgrow all numbers."""

import numpy as np
import pytest

from deshybrid.linear.distance import Units, distance
from deshybrid.linear.dynamics import LinearDynamics


def rising(rate: float) -> LinearDynamics:
    return LinearDynamics(
        np.array([[rate]]),
        np.zeros((1, 0)),
        np.ones((1, 1)),
        np.zeros((1, 0)),
        np.zeros((1, 0)),
        np.zeros(1),
        np.zeros(1),
    )


@pytest.mark.parametrize("rate", [200.0, 5_000.0, 30_000.0])
def test_an_unstable_location_ends_the_window_before_numbers_overflow(rate: float) -> None:
    found = distance(
        rising(rate),
        rising(-1.0),
        samples=100,
        step=0.02,
        units=Units(np.ones(1), np.zeros(0), np.ones(1)),
        inputs=((), ()),
        outputs=((0,), (0,)),
    )
    assert 0.0 <= found.worst < np.inf
