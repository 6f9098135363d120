"""Measured flights: how their tracks are read, how turns are told from them, and what the tuned filter reaches.

The tracks are not part of the project; where they are missing, the tests that need them are skipped.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "models" / "measured"))
from aircraft_flights import (  # noqa: E402
    BEFORE,
    DOUBLED,
    FALSE,
    SURE,
    Flight,
    Track,
    followed,
    named_turns,
    pieces,
    read_flight,
    score,
    single_filter,
    stays,
    system_with,
    tune,
    tune_single,
    tune_sure,
    turns,
)

DATA = ROOT.parent / "shared" / "data" / "aircraft"
TRACKS = [DATA / "belevingsvlucht_1hz.csv", DATA / "zero_gravity_1hz.csv"]
needs_data = pytest.mark.skipif(not all(t.exists() for t in TRACKS), reason="the measured flights are not here")


def _printed_numbers() -> list[tuple[dict[str, float], float, float]]:
    """What the page says was tuned on each flight: numbers of the model, w of the single filter, `sure`."""
    lines = (ROOT / "docs" / "measured-flights.md").read_text(encoding="utf-8").splitlines()
    rows = [
        line.strip("| ").split(" | ")
        for line in lines
        if line.startswith(("| belevingsvlucht | 1", "| zero_gravity | 1"))
    ]
    assert len(rows) == 2
    found = [list(map(float, row[1:])) for row in rows]
    return [(dict(zip(BEFORE, row[:5], strict=True)), row[5], row[6]) for row in found]


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
    several = score(flight, followed(system_with(BEFORE), flight.z), 0.7)
    single = score(flight, followed(single_filter(2.0), flight.z), 0.7)
    assert several.false == 0.0
    assert several.delays[0] is not None
    assert several.delays[0] <= 7
    assert several.prediction_in_turns < single.prediction_in_turns
    assert single.delays == (None,)


def test_positions_that_come_late_do_not_throw_the_filter_off_as_they_do_a_single_one():
    """One position in twenty is two seconds late; the distance from where the aircraft really was tells."""
    flight = _flown(300, 300, 300, rate=0.0, noise=5.0, seed=4)
    late = flight.z.copy()
    late[30::20] = flight.z[28:-2:20]
    errors = [
        np.linalg.norm(followed(system, late).expected - flight.z, axis=1)[40:]
        for system in (system_with(BEFORE), single_filter(2.0))
    ]
    assert np.quantile(errors[0], 0.95) < 0.3 * np.quantile(errors[1], 0.95)


def test_the_single_filter_is_tuned_to_the_smallest_prediction_error():
    flight = _flown(400, 100, 300, rate=1.5, noise=30.0, seed=5)
    w, error = tune_single(flight)
    z = pieces(flight.z)
    assert 0.2 < w < 50.0
    for other in (0.8 * w, 1.25 * w):
        missed = np.linalg.norm(followed(single_filter(other), z).expected - z, axis=-1)[:, 40:]
        assert error <= np.sqrt(np.mean(missed**2)) + 1e-9


def test_tuning_improves_what_it_says_it_does_and_stays_near_what_was_expected():
    flight = _flown(380, 100, 160, rate=1.5, noise=20.0, seed=6)
    z, turn = pieces(flight.z), pieces(flight.turn.astype(float)).astype(int)

    def told(values):
        track = followed(system_with(values), z)
        missed = np.linalg.norm(track.expected - z, axis=-1)[:, 40:]
        really = [[track.side[i, k, turn[i, k] % 3] for k in range(40, 190)] for i in range(len(z))]
        far = sum(np.log2(values[name] / BEFORE[name]) ** 2 for name in BEFORE)
        return np.sqrt(np.mean(missed**2)) / 30.0 - np.log(really).mean() + DOUBLED * far

    found = tune(flight, 30.0, evaluations=9)
    assert told(found) < told(BEFORE)


def test_the_threshold_is_the_smallest_that_names_few_false_turns():
    side = np.tile([1.0, 0.0, 0.0], (3600, 1))
    for k, chance in zip(range(100, 600, 100), (0.65, 0.65, 0.65, 0.75, 0.85), strict=True):
        side[k] = [1.0 - chance, chance, 0.0]
    flight = Flight("still", np.zeros((3600, 2)), np.zeros(3600, dtype=np.int64))
    track = Track(np.zeros((3600, 2)), side)
    assert [score(flight, track, sure).false for sure in SURE] == [5.0, 5.0, 2.0, 1.0, 0.0]
    assert FALSE == 2.0
    assert tune_sure(flight, track) == 0.7


def test_a_turn_stays_named_until_it_is_less_likely_than_not():
    right = np.array([0.2, 0.75, 0.6, 0.51, 0.49, 0.6])
    side = np.column_stack((1.0 - right, np.zeros(6), right))
    assert named_turns(side, 0.7).tolist() == [0, -1, -1, -1, 0, 0]


def test_pieces_cover_a_flight_from_the_first_row_after_the_warm_ones_on_and_none_twice():
    rows = np.arange(1000.0)
    counted = pieces(rows)[:, 40:].ravel()
    assert counted.tolist() == list(range(40, 40 + 150 * 6))


@needs_data
@pytest.mark.parametrize(("track", "turns_flown"), [(TRACKS[0], 55), (TRACKS[1], 37)])
def test_the_measured_flights_hold_the_turns_that_their_description_counts(track, turns_flown):
    assert len(stays(read_flight(track).turn)) == turns_flown


@needs_data
@pytest.mark.parametrize(("tuned_on", "track"), [(0, 1), (1, 0)])
def test_on_the_other_flight_the_page_prints_what_its_numbers_reach_from_the_tenth_minute_to_the_thirtieth(
    tuned_on, track
):
    """A part of each flight, for the sake of time: fewer than five false turns an hour, and better than one filter."""
    values, w, sure = _printed_numbers()[tuned_on]
    flight = read_flight(TRACKS[track])
    part = Flight(flight.name, flight.z[600:1800], flight.turn[600:1800])
    several = score(part, followed(system_with(values), part.z), sure)
    single = score(part, followed(single_filter(w), part.z), sure)
    assert several.prediction < single.prediction
    assert several.false <= 6.0
    assert all(delay is not None for delay, lasts in zip(several.delays, several.lasting, strict=True) if lasts)
