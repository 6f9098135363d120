"""The freeway: its model file, and what filter and interpolation reach on a made day and on a measured one.

The measured day is not part of the project; where it is missing, the test that needs it is skipped.
"""

import sys
from pathlib import Path

import numpy as np
import pytest

from deshybrid.model.load import load
from deshybrid.stochastic.from_model import stochastic_system
from deshybrid.stochastic.sample import sample

ROOT = Path(__file__).parents[2]
PAGE = ROOT / "docs" / "measured-traffic.md"
MEASURED = ROOT.parent / "shared" / "data" / "freeway" / "a9south_1998-10-29_1min.csv"
sys.path.insert(0, str(ROOT / "models" / "measured"))
from freeway_day import (  # noqa: E402
    MEMORY,
    METHODS,
    Day,
    Numbers,
    Trials,
    Tuned,
    draw_cars,
    failed_loop,
    filtered,
    freeway_system,
    interpolated,
    main,
    read_day,
    tables,
    trials_of,
    tune,
    withheld_stations,
)

NUMBERS = Numbers(wave=15.0, forward=6.0, reach=5.0, strength=3.0, relaxation=100.0, memory=7.0)


@pytest.fixture(scope="module")
def made():
    """A day that the system itself drew: eight stations a kilometre apart, two hours."""
    position = np.arange(8.0)
    system = freeway_system(position, np.ones((1, 8), dtype=bool), NUMBERS)
    return Day(position, sample(system, 120, seed=1, modes=[0] * 120).z)


def test_the_model_file_states_the_system_of_the_measured_day_for_four_stations():
    stated = stochastic_system(load(ROOT / "models" / "boker" / "freeway.yaml"))
    reporting = np.array([[1, 0, 0, 1], [1, 1, 0, 1], [1, 0, 1, 1]], dtype=bool)
    built = freeway_system(np.arange(4.0), reporting, NUMBERS)
    for one, other in zip(stated.modes, built.modes, strict=True):
        assert one.output_index == other.output_index
        for name in "FHQRf":
            np.testing.assert_allclose(getattr(one, name), getattr(other, name), rtol=1e-14, atol=1e-14)
    np.testing.assert_allclose(stated.x, built.x)
    np.testing.assert_allclose(stated.P, built.P, rtol=1e-14)


def test_a_day_is_read_with_its_stations_in_order_and_refused_with_a_hole(tmp_path):
    file = tmp_path / "day.csv"
    file.write_text("pos_km,t_min,speed_kmh\n2,0,80\n2,1,81\n1.5,1,71\n1.5,0,70\n")
    day = read_day(file)
    assert day.position.tolist() == [1.5, 2.0]
    assert day.speed.tolist() == [[70.0, 80.0], [71.0, 81.0]]
    file.write_text("pos_km,t_min,speed_kmh\n2,0,80\n2,1,81\n1.5,1,71\n")
    with pytest.raises(ValueError, match="every minute"):
        read_day(file)
    file.write_text("pos_km,t_min\n2,0\n")
    with pytest.raises(ValueError, match="no column speed_kmh"):
        read_day(file)


def test_interpolation_along_the_wave_is_exact_where_a_wave_runs_and_the_loops_are_near():
    """A front of 40 km/h that runs 0.25 km upstream a minute, past loops at 0 and 2 km and a gap of 1 km between."""
    position, minute = np.array([0.0, 1.0, 2.0]), np.arange(20.0)[:, None]
    day = Day(position, np.where(position + 0.25 * minute > 3.0, 60.0, 100.0))
    seen = np.broadcast_to([True, False, True], (1, 20, 3))
    assert np.abs(interpolated(day, seen, wave=15.0, oldest=4) - day.speed).max() == 0.0
    straight = interpolated(day, seen)[0, :, 1]
    assert straight.tolist() == [np.interp(1.0, [0.0, 2.0], row[[0, 2]]) for row in day.speed]
    assert np.abs(straight - day.speed[:, 1]).max() == 20.0


def test_cars_come_at_their_places_only_and_as_often_as_said():
    places = np.array([False, True, False, True])
    cars = draw_cars(20_000, places, 4.0, seed=1)
    assert not cars[:, ~places].any()
    assert cars.sum() / 20_000 == pytest.approx(2 * (1 - np.exp(-1 / 8)), rel=0.03)


def test_a_station_is_not_scored_in_a_minute_that_reveals_it(made):
    withheld = withheld_stations(8)
    trials = trials_of(made, ~withheld, withheld, withheld, 2.0)
    assert not (trials.seen & trials.scored).any()
    assert not trials.scored[:, :10].any()
    assert not trials.scored[..., ~withheld].any()
    assert (trials.seen | trials.scored)[:, 10:].all()


def test_the_failed_loop_is_the_nearest_and_its_place_is_seen_from_cars_alone(made):
    withheld = withheld_stations(8)
    without = failed_loop(made, withheld, None, fails=True)
    gone = (~without.seen).all(axis=1)
    assert [np.flatnonzero(row).tolist() for row in gone] == [[0, 1, 4], [1, 3, 4]]
    now_and_then = failed_loop(made, withheld, 1.0, fails=True)
    assert 0.5 < now_and_then.seen[:3, :, 0].mean() < 0.75
    assert not now_and_then.seen[..., withheld].any()
    assert [
        np.flatnonzero(row.any(axis=0)).tolist() for row in failed_loop(made, withheld, None, fails=False).scored
    ] == [[1], [4]]


def test_on_a_day_of_its_own_the_filter_beats_interpolation_and_gains_from_cars(made):
    withheld = withheld_stations(8)
    tuned = Tuned({"own": NUMBERS}, 15.0, 2)
    alone = tuned.errors(made, trials_of(made, ~withheld, withheld, withheld, None))
    helped = tuned.errors(made, trials_of(made, ~withheld, withheld, withheld, 0.5))
    assert alone[0] < min(alone[1:])
    assert helped[0] < min(*helped[1:], 0.95 * alone[0])


def test_the_filter_at_a_station_that_always_reports_follows_it(made):
    everywhere = np.ones((1, *made.speed.shape), dtype=bool)
    trials = Trials(everywhere, everywhere)
    assert trials.rms(made, filtered(made, everywhere, NUMBERS)) < NUMBERS.noise


def test_tuning_finds_better_numbers_than_it_began_with(made):
    withheld = withheld_stations(8)
    short = made.rows(0, 24)
    trials = trials_of(short, ~withheld, withheld, withheld, None)
    few, more = (tune(short, withheld, evaluations=count).errors(short, trials)[0] for count in (1, 4))
    assert more < few


def test_the_tables_have_a_line_for_every_rate_and_three_more(made):
    text = tables(made.rows(0, 28), evaluations=1)
    assert text.count("\n| and a car every") == 4
    assert text.count("\n| one failed, a car there every") == 4
    assert "nan" not in text


def _printed(beginning: str) -> list[list[str]]:
    """Cells of the lines of the page that begin so."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in lines if line.startswith(beginning)]


def _printed_numbers(half: str) -> Tuned:
    """What the page says was tuned on a half, to four digits."""
    *filters, (_, _, wave, _, _, _, _, oldest) = _printed(f"| {half} half |")
    assert [row[1] for row in filters] == list(METHODS[: len(MEMORY)])
    numbers = {
        kind: Numbers(*map(float, row[2:7]), memory=memory)
        for row, (kind, memory) in zip(filters, MEMORY.items(), strict=True)
    }
    return Tuned(numbers, float(wave), int(oldest))


@pytest.mark.skipif(not MEASURED.exists(), reason="the measured day is not here")
@pytest.mark.parametrize(("row", "every"), [("| loops only |", None), ("| and a car every 2 min |", 2.0)])
def test_the_page_prints_the_errors_that_its_numbers_reach_on_the_other_half_of_the_measured_morning(row, every):
    day = read_day(MEASURED)
    withheld, middle = withheld_stations(len(day.position)), len(day.speed) // 2
    (printed,) = _printed(row)
    for place, (half, other) in enumerate(((day.rows(0, middle), "second"), (day.rows(middle, 10_000), "first"))):
        errors = _printed_numbers(other).errors(half, trials_of(half, ~withheld, withheld, withheld, every))
        told = [float(cell.split(",")[place]) for cell in printed[1:]]
        np.testing.assert_allclose(errors, told, atol=0.0075)


def test_without_a_file_the_script_says_how_it_is_called(capsys):
    assert main([]) == 2
    assert capsys.readouterr().err == "usage: freeway_day.py DAY.csv\n"
