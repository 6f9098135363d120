"""Measured flights: how their tracks are read, how turns are told from them, and what the tuned filter reaches.

The tracks are not part of the project; where they are missing, the tests that need them are skipped.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "models" / "measured"))
from aircraft_flights import Flight, read_flight, score, stays, system_with, tune, turns  # noqa: E402

DATA = ROOT.parent / "shared" / "data" / "aircraft"
TRACKS = [DATA / "belevingsvlucht_1hz.csv", DATA / "zero_gravity_1hz.csv"]
needs_data = pytest.mark.skipif(not all(t.exists() for t in TRACKS), reason="the measured flights are not here")


def _flown(rows: int, begin: int, end: int, *, rate: float, noise: float, seed: int) -> Flight:
    """150 m/s to the north, then a turn of `rate` deg/s to the left between two rows."""
    turn = np.zeros(rows, dtype=np.int64)
    turn[begin:end] = 1
    heading = np.pi / 2 + np.deg2rad(rate) * np.cumsum(turn)
    track = np.cumsum(150.0 * np.column_stack((np.cos(heading), np.sin(heading))), axis=0)
    return Flight("made", track + np.random.default_rng(seed).normal(0.0, noise, track.shape), turn)


def test_a_repeated_position_and_a_missing_second_are_missing_measurements(tmp_path):
    track = tmp_path / "track.csv"
    track.write_text("t_s,x_east_m,y_north_m,turn_rate_dps\n5,0,1,0\n6,0,1,1\n8,3,4,1\n", encoding="utf-8")
    flight = read_flight(track)
    assert np.array_equal(flight.z, [[0, 1], [np.nan, np.nan], [np.nan, np.nan], [3, 4]], equal_nan=True)
    assert flight.turn.tolist() == [0, -1, -1, -1]


def test_a_track_without_a_column_is_refused(tmp_path):
    track = tmp_path / "track.csv"
    track.write_text("t_s,x_east_m,y_north_m\n0,0,0\n", encoding="utf-8")
    with pytest.raises(ValueError, match="turn_rate_dps"):
        read_flight(track)


def test_a_turn_goes_over_into_one_to_the_other_side_without_straight_flight():
    assert turns(np.array([0.7, -0.7, -0.3, -0.2])).tolist() == [-1, 1, 1, 0]
    assert stays(turns(np.array([0.7, -0.7]))) == [(0, 1, -1), (1, 2, 1)]


def test_a_clear_turn_is_named_soon_and_predicted_better_than_by_one_filter():
    flight = _flown(200, 80, 140, rate=1.5, noise=5.0, seed=3)
    numbers = {"w": 0.3, "w_turn": 0.5, "v": 5.0}
    several, single = score(flight, system_with(numbers)), score(flight, system_with(numbers, single=True))
    assert several.false == 0.0
    assert several.delays[0] is not None
    assert several.delays[0] <= 6
    assert several.prediction_in_turns < single.prediction_in_turns
    assert single.delays == (None,)


def test_tuning_finds_a_filter_as_good_as_the_one_with_the_noise_that_was_drawn():
    flight = _flown(120, 120, 120, rate=0.0, noise=8.0, seed=5)
    start = {"w": 2.0, "v": 8.0}
    found = tune(flight, "straight", start)
    begun, best, true = (
        score(flight, system_with(numbers, single=True)).prediction for numbers in (start, found, {"w": 1e-3, "v": 8.0})
    )
    assert best < 0.9 * begun
    assert best < 1.01 * true


@needs_data
@pytest.mark.parametrize(("track", "turns_flown"), [(TRACKS[0], 55), (TRACKS[1], 37)])
def test_the_measured_flights_hold_the_turns_that_their_description_counts(track, turns_flown):
    assert len(stays(read_flight(track).turn)) == turns_flown
