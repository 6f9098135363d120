"""What the documentation says of the growth of verdicts is what the measured points say."""

import numpy as np
import pytest

from benchmarks.growth import PICTURE, fit, points


def test_the_exponent_is_that_of_the_least_squares() -> None:
    for rows in points().values():
        sizes, seconds, _ = np.array(rows).T
        slope, intercept = np.polyfit(np.log(sizes), np.log(seconds), 1)
        assert fit(rows) == pytest.approx((np.exp(intercept), slope))


def test_the_points_reach_from_1000_to_100000_locations() -> None:
    for rows in points().values():
        assert [rows[0][0], rows[-1][0]] == [1_000, 100_000]


def test_the_picture_shows_the_exponents_of_the_points() -> None:
    drawn = PICTURE.read_text(encoding="utf-8")
    for name, rows in points().items():
        assert f"{name}: exponent {fit(rows)[1]:.2f}" in drawn
