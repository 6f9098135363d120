"""Replays: what residual generators are judged by is what decided, and the pictures show it, whatever the names are."""

import io
import subprocess
import sys
import xml.etree.ElementTree as ET
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import deshybrid as dh
from deshybrid import replays
from deshybrid.detector.held_back import realised
from deshybrid.diagnostics import UsageError
from deshybrid.emit.plotting import band, new_figure, plain_style
from deshybrid.emit.replay_plots import Course, Panel, Timeline, courses_plot, timeline_plot
from deshybrid.observer.hybrid import HybridObserver
from deshybrid.simulate.execution import simulate
from deshybrid.simulate.judged import replay_judged
from deshybrid.simulate.replay import replay
from deshybrid.simulate.trace import Trace, parse_trace, write_trace

TANK = "models/two_tank.yaml"
KINDS = ("relay", "exclusion", "sprt", "glr", "imm")


@lru_cache(maxsize=5)
def observer(kind: str) -> HybridObserver:
    """That of the driveline with some decision; exclusion needs the tank, where it can be had."""
    system = dh.load(TANK if kind == "exclusion" else "models/balluchi2012/driveline.yaml")
    detector = replace(system.observer.detector, decision=kind)
    made = dh.compile(replace(system, observer=replace(system.observer, detector=detector))).observer
    assert made is not None
    assert made.detector is not None
    assert made.detector.decision.kind == kind
    return made


@lru_cache(maxsize=5)
def drive(kind: str) -> Trace:
    made = observer(kind)
    return simulate(made.system, duration=8.0, step=made.step_seconds, seed=3).trace


def residuals(made: HybridObserver, place: int, trace: Trace) -> np.ndarray:
    """The residual (N, q) of one generator, straight from its filter."""
    assert made.detector is not None
    generator = realised(made.detector.generators[place])
    location = generator.location
    u, y = trace.inputs[:, list(location.input_index)], trace.outputs[:, list(location.output_index)]
    z, found = generator.start @ y[0] + generator.start_offset, []
    for row_input, row_output in zip(u, y, strict=True):
        r = generator.H @ z + generator.through @ row_input + generator.J @ row_output + generator.residual_offset
        found.append(r)
        z = generator.F @ z + generator.input @ row_input + generator.gain @ row_output + generator.offset
    return np.array(found)


@pytest.mark.parametrize("kind", ["relay", "exclusion"])
def test_a_relay_is_judged_by_each_residual_over_its_threshold(kind: str) -> None:
    made, trace = observer(kind), drive(kind)
    assert made.detector is not None
    for place, judged in enumerate(replay_judged(made, trace)[1]):
        shares = np.abs(residuals(made, place, trace)) / made.detector.thresholds[place].level
        np.testing.assert_allclose(judged.values, shares, rtol=1e-6, atol=1e-9)
        assert judged.scale.levels == (1.0, made.detector.release)


@pytest.mark.parametrize("kind", ["relay", "exclusion"])
def test_a_relay_is_on_as_the_numbers_against_the_levels_say(kind: str) -> None:
    made, trace = observer(kind), drive(kind)
    assert made.detector is not None
    for place, judged in enumerate(replay_judged(made, trace)[1]):
        low, high = judged.scale.levels
        on, differing, active = False, 0, False
        for values, shown in zip(judged.values, judged.active, strict=True):
            on = bool((values <= (high if on else low)).all())
            differing = differing + 1 if on != active else 0
            if differing >= (made.detector.on_ticks if on else made.detector.off_ticks)[place]:
                active, differing = on, 0
            assert shown == active


def test_the_likelihood_ratio_is_the_largest_of_a_shift_some_samples_ago() -> None:
    made, trace = observer("glr"), drive("glr")
    assert made.detector is not None
    design = made.detector.decision
    assert design.limits is not None
    for place, judged in enumerate(replay_judged(made, trace)[1]):
        white = residuals(made, place, trace) @ design.whitening[place].T
        for row in range(0, len(white), 17):
            sums = [white[max(0, row + 1 - n) : row + 1].sum(axis=0) for n in range(1, len(design.limits) + 1)]
            largest = max(float(s @ s) / (2 * n) for n, s in enumerate(sums, start=1))
            assert judged.values[row, 0] == pytest.approx(largest, rel=1e-6, abs=1e-9)
        on = judged.values[:, 0] <= judged.scale.levels[0]
        assert (on == np.array(judged.active)).all()  # debounce of one sample


def test_the_probability_ratio_adds_up_until_it_decides() -> None:
    made, trace = observer("sprt"), drive("sprt")
    assert made.detector is not None
    for place, judged in enumerate(replay_judged(made, trace)[1]):
        white = residuals(made, place, trace) @ made.detector.decision.whitening[place].T
        slope, offset, lower, upper = made.detector.decision.test[place]
        assert judged.scale.levels == (lower, upper)
        total = 0.0
        for row, shown in zip(white, judged.values[:, 0], strict=True):
            total += slope * float(row @ row) - offset
            assert shown == pytest.approx(total, rel=1e-6, abs=1e-6)
            if not lower < total < upper:
                total = 0.0


def test_the_probabilities_of_all_locations_sum_to_one_and_accept_from_the_confidence_on() -> None:
    made, trace = observer("imm"), drive("imm")
    found = replay_judged(made, trace)[1]
    assert {judged.location for judged in found} == {location.name for location in made.system.locations}
    np.testing.assert_allclose(sum(judged.values[:, 0] for judged in found), 1.0, rtol=1e-9)
    for judged in found:
        doubt, confidence = judged.scale.levels
        accepted = False
        for value, shown in zip(judged.values[:, 0], judged.active, strict=True):
            accepted = bool(value >= (doubt if accepted else confidence))
            assert shown == accepted  # without a debounce


@pytest.mark.parametrize("kind", KINDS)
def test_looking_on_does_not_change_the_estimates(kind: str) -> None:
    made, trace = observer(kind), drive(kind)
    seen, alone = replay_judged(made, trace)[0], replay(made, trace)
    assert seen.location == alone.location
    assert seen.status == alone.status
    assert (seen.state == alone.state).all()


def test_rows_without_a_measurement_are_not_judged() -> None:
    made, trace = observer("relay"), drive("relay")
    outputs = trace.outputs.copy()
    outputs[[0, 40], 1] = np.nan
    for judged in replay_judged(made, replace(trace, outputs=outputs))[1]:
        assert np.flatnonzero(np.isnan(judged.values).any(axis=1)).tolist() == [0, 40]


def test_outputs_are_explained_by_the_named_location_and_the_estimated_state() -> None:
    made, trace = observer("relay"), drive("relay")
    estimates = replay(made, trace)
    explained = replays.explained_outputs(made.system, estimates)
    for row in range(0, len(trace), 23):
        name = estimates.location[row]
        if name is None:
            assert np.isnan(explained[row]).all()
        else:
            dynamics = made.system.location(name).dynamics
            assert dynamics is not None
            y = dynamics.C @ estimates.state[row] + dynamics.D @ trace.inputs[row] + dynamics.g
            np.testing.assert_allclose(explained[row], y)


def test_a_band_covers_its_rows_up_to_the_next_one() -> None:
    with plain_style():
        axes = new_figure(2.0, 1.0).add_subplot()
        band(axes, np.array([0.0, 1.0, 2.0, 5.0, 6.0]), np.array([False, True, False, True, True]), "red")
        spans = [(path.vertices[:, 0].min(), path.vertices[:, 0].max()) for path in axes.collections[0].get_paths()]
    assert spans == [(1.0, 2.0), (5.0, 6.0)]


NAMES = ("$q_1$", "_b", "<&'\">", "\x01日")


def nasty_plots() -> tuple[bytes, bytes]:
    time = np.arange(4.0)
    line = Timeline("a < b & $c$", NAMES, time, [*NAMES[:3], None], [None, *NAMES[1:]], [(1.0, "_b")], [2.0], "entry")
    panels = [Panel(name, f"s_{name}", [name], [1.0, 1.1], time[:, None], [True] * 4) for name in NAMES]
    return timeline_plot(line, panels), courses_plot("$t$", time, [Course(NAMES[2], time, time, "measured")])


def test_names_are_shown_as_they_are_and_nothing_is_taken_for_a_formula(recwarn: pytest.WarningsRecorder) -> None:
    for picture in nasty_plots():
        texts = [element.text for element in ET.parse(io.BytesIO(picture)).iter() if element.tag.endswith("text")]
        assert NAMES[2] in texts
    line = nasty_plots()[0].decode()
    assert "$q_1$" in line
    assert ">_b</text>" in line
    assert "\x01" not in line
    assert not recwarn.list


def test_the_same_values_give_the_same_bytes_whatever_the_user_has_set() -> None:
    import matplotlib as mpl

    once = nasty_plots()
    with mpl.rc_context({"font.size": 20, "svg.fonttype": "path", "axes.facecolor": "red", "svg.hashsalt": None}):
        again = nasty_plots()
    assert once == again
    assert not any(b"date" in picture for picture in once)


def test_of_a_purely_discrete_model_there_is_the_timeline_only() -> None:
    made = dh.compile("models/balluchi2012/fig2.yaml").observer
    assert made is not None
    trace = parse_trace("time,event\n0,\n1,α\n2,α\n3,s_5\n4,α\n", made.system)
    assert list(replays.plots(replays.replayed(made, trace))) == ["timeline.svg"]


def test_without_truth_nothing_is_called_true_or_wrong() -> None:
    made, trace = observer("relay"), drive("relay")
    pictures = replays.plots(replays.replayed(made, replace(trace, true_location=None, true_state=None)))
    assert list(pictures) == ["timeline.svg", "states.svg"]
    assert not any(word in picture for word in (b">true<", b">wrong name<") for picture in pictures.values())
    assert all(word in pictures["states.svg"] for word in (b">alpha (rad)<", b">measured<", b">observer<"))


def test_late_engagements_get_a_close_up_each_and_only_within_the_times_asked_for() -> None:
    made = observer("relay")
    replay = replays.replayed(made, simulate(made.system, duration=26.0, step=made.step_seconds).trace)
    assert len(replay.late) > 1
    worst = replay.late[0]
    assert {f"worst-{rank}.svg" for rank in range(1, 1 + min(3, len(replay.late)))} <= set(replays.plots(replay))
    around = replays.plots(replay, (worst.enter - 0.1, worst.enter + 0.1))
    assert [name for name in around if name != "foreign.svg"] == ["timeline.svg", "states.svg", "worst-1.svg"]
    assert f"{worst.location}, driveline at {worst.enter:.3f} s".encode() in around["worst-1.svg"]


def test_the_longest_foreign_name_gets_a_close_up() -> None:
    made = observer("relay")
    trace = simulate(made.system, duration=8.0, step=made.step_seconds, seed=1).trace
    truth = ("qN",) * len(trace)  # as if the clutch had never locked
    replay = replays.replayed(made, replace(trace, true_location=truth))
    wrong = replay.foreign
    assert wrong is not None
    named = [name == wrong.named for name in replay.estimates.location]
    first = trace.time.tolist().index(wrong.begin)
    last = trace.time.tolist().index(wrong.begin + wrong.seconds)
    assert all(named[first:last])
    assert not named[first - 1]
    assert last == len(trace) - 1 or not named[last]
    title = f"{wrong.named} for {wrong.seconds:.3f} s while qN is true".encode()
    assert title in replays.plots(replay)["foreign.svg"]


def test_a_plot_without_rows_is_refused() -> None:
    replay = replays.replayed(observer("relay"), drive("relay"))
    with pytest.raises(UsageError, match="DH0728"):
        replays.plots(replay, (100.0, 200.0))
    with pytest.raises(UsageError, match="DH0728"):
        replays.plots(replay, (3.0, 2.0))


def deshybrid(*words: object, first: str = "") -> subprocess.CompletedProcess[str]:
    code = f"import sys\n{first}\nfrom deshybrid.cli import main\nmain()"
    return subprocess.run([sys.executable, "-c", code, *map(str, words)], capture_output=True, text=True, check=False)


def test_the_command_writes_estimates_score_and_plots(tmp_path: Path) -> None:
    made = observer("exclusion")
    trace = tmp_path / "trace.csv"
    trace.write_text(write_trace(drive("exclusion")), encoding="utf-8")
    call = ("run", TANK, "--trace", trace, "-o", tmp_path / "estimates.csv")
    done = deshybrid(*call, "--plots", tmp_path / "plots", "--between", 2, 5)
    assert (done.returncode, done.stderr) == (0, "")
    assert "engagements of at least" in done.stdout
    assert {"timeline.svg", "states.svg"} <= {path.name for path in (tmp_path / "plots").iterdir()}
    replay = replays.replayed(made, drive("exclusion"))
    assert (tmp_path / "plots" / "timeline.svg").read_bytes() == replays.plots(replay, (2.0, 5.0))["timeline.svg"]


def test_plots_without_matplotlib_are_refused_before_the_work(tmp_path: Path) -> None:
    missing = deshybrid(
        "run", TANK, "--trace", "nowhere.csv", "--plots", tmp_path, first="sys.modules['matplotlib'] = None"
    )
    assert missing.returncode == 2
    assert "DH0806" in missing.stderr
