"""Campaigns: the same for any executor, resumable to the byte, and scored as a naive count of the traces says."""

import json
import subprocess
import sys
from concurrent.futures import Executor, Future, ThreadPoolExecutor
from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
import pytest

import deshybrid as dh
from deshybrid.campaigns import JOURNAL, Wishes, carry_out, files, prepare
from deshybrid.diagnostics import UsageError
from deshybrid.model.system import RatioComparison, Variation
from deshybrid.simulate.campaign import Campaign, run_campaign
from deshybrid.simulate.campaign_drives import drive_seed, vary
from deshybrid.simulate.campaign_executor import Here, local_executor
from deshybrid.simulate.campaign_jobs import Task, named_by, wrong_names
from deshybrid.simulate.campaign_summary import Summary
from deshybrid.simulate.replay import replay

TANK = "models/two_tank.yaml"
WISHES = Wishes(engagements=12, seed=4, duration=3.0)


@lru_cache(maxsize=1)
def tank() -> tuple[Task, Campaign]:
    task = prepare(TANK, WISHES).task
    assert task is not None
    return task, run_campaign(task, Here(), engagements=WISHES.engagements)


def in_folder(folder: Path, wishes: Wishes = WISHES) -> dict[str, bytes]:
    """The files of a campaign that keeps its journal in a folder, which is read back as one of them."""
    prepared = prepare(TANK, wishes)
    assert prepared.task is not None
    done = carry_out(prepared, prepared.task, Here(), folder=folder)
    return files(done) | {JOURNAL: (folder / JOURNAL).read_bytes()}


def test_a_campaign_takes_several_drives_and_is_complete() -> None:
    campaign = tank()[1]
    assert len(campaign.drives) > 2
    assert campaign.complete
    assert len(campaign.engagements) == 12


@pytest.mark.parametrize(
    "executor", [ThreadPoolExecutor(2), ThreadPoolExecutor(3), local_executor(2)], ids=["2", "3", "processes"]
)
def test_the_result_is_the_same_for_any_executor_and_number_of_workers(executor: Executor) -> None:
    task, alone = tank()
    with executor:
        together = run_campaign(task, executor, engagements=12, ahead=5)
    assert together.drives == alone.drives
    assert files(together) == files(alone)


class Backwards(Executor):
    """Runs jobs only when a result is asked for, and then the latest first."""

    def __init__(self) -> None:
        self.open: list[tuple[Future, object, tuple]] = []

    def submit(self, fn, /, *args):
        backwards = self

        class Late(Future):
            def result(self, timeout=None):
                while backwards.open:
                    future, work, given = backwards.open.pop()
                    future.set_result(work(*given))
                return super().result(timeout)

        future = Late()
        self.open.append((future, fn, args))
        return future


def test_the_order_in_which_jobs_are_run_does_not_matter() -> None:
    task, alone = tank()
    assert run_campaign(task, Backwards(), engagements=12, ahead=4).drives == alone.drives


def test_a_campaign_that_was_cut_ends_with_the_same_bytes(tmp_path: Path) -> None:
    whole = in_folder(tmp_path / "whole")
    short = in_folder(tmp_path / "cut", replace(WISHES, engagements=3))
    assert whole[JOURNAL].startswith(short[JOURNAL])
    assert short[JOURNAL] != whole[JOURNAL]
    assert in_folder(tmp_path / "cut") == whole


def test_a_torn_last_line_is_run_again(tmp_path: Path) -> None:
    whole = in_folder(tmp_path)
    for lost in (1, 40, len(whole[JOURNAL]) - 5):  # of the last line, and of the header
        (tmp_path / JOURNAL).write_bytes(whole[JOURNAL][:-lost])
        assert in_folder(tmp_path) == whole


def test_a_finished_campaign_runs_no_drive_again(tmp_path: Path) -> None:
    whole = in_folder(tmp_path)
    prepared = prepare(TANK, WISHES)
    assert prepared.task is not None
    assert files(carry_out(prepared, prepared.task, Idle(), folder=tmp_path))["summary.json"] == whole["summary.json"]


class Idle(Executor):
    def submit(self, fn, /, *args):
        raise AssertionError("a job was run")


@pytest.mark.parametrize("change", [{"seed": 5}, {"duration": 9.0}, {"rate": 0.25}], ids=str)
def test_the_journal_of_another_campaign_is_refused(tmp_path: Path, change: dict[str, float]) -> None:
    before = in_folder(tmp_path)[JOURNAL]
    with pytest.raises(UsageError, match="DH0721"):
        in_folder(tmp_path, replace(WISHES, **change))
    assert (tmp_path / JOURNAL).read_bytes() == before


def test_a_journal_with_a_line_that_is_no_result_is_refused(tmp_path: Path) -> None:
    lines = in_folder(tmp_path)[JOURNAL].splitlines(keepends=True)
    for wrong in (b"{}\n", b"nonsense\n", b"[]\n", lines[2]):
        (tmp_path / JOURNAL).write_bytes(lines[0] + wrong + b"".join(lines[2:]))
        with pytest.raises(UsageError, match="DH0722"):
            in_folder(tmp_path)


def test_the_seeds_of_jobs_are_those_that_numpy_spawns_and_all_differ() -> None:
    children = np.random.SeedSequence(9).spawn(200)
    spawned = [int(child.spawn(2)[1].generate_state(1, np.uint64)[0]) >> 11 for child in children]
    assert [drive_seed(9, job) for job in range(200)] == spawned
    assert len({drive_seed(seed, job) for seed in range(20) for job in range(200)}) == 4000


def test_drives_of_different_jobs_differ_from_the_first_rows_on() -> None:
    task = tank()[0]
    outputs = [task.execution(job).trace.outputs[:20].tobytes() for job in range(6)]
    assert len(set(outputs)) == 6


def test_a_variation_stays_within_its_width_and_keeps_the_order_of_requests() -> None:
    system = dh.load("models/balluchi2012/driveline.yaml")
    width = Variation(requests=3.0, input=0.1, disturbance=0.2, state=0.3)
    wide = replace(system, simulation=replace(system.simulation, variation=width))
    for seed in range(20):
        varied, given = vary(wide, np.random.default_rng(seed)).simulation, system.simulation
        times = [time for time, _ in varied.requests]
        assert times == sorted(times)
        assert times[0] >= 0.0
        assert [event for _, event in varied.requests] == [event for _, event in given.requests]
        factors = np.array([value for _, value in varied.input["T_e"].points]) / [
            value for _, value in given.input["T_e"].points
        ]
        assert np.ptp(factors) < 1e-12
        assert 0.9 <= factors[0] <= 1.1
        assert given.state is not None
        assert varied.state is not None
        assert np.all(np.abs(varied.state - given.state) <= 0.3 * np.abs(given.state))


def test_the_summary_is_what_a_naive_count_of_the_traces_gives() -> None:
    """Written from the definition alone: rows and entries are counted one by one, on the traces of the drives."""
    task, campaign = tank()
    summary = json.loads(files(campaign)["summary.json"])
    pairs: dict[tuple[str, str | None], int] = {}
    delays: list[float | None] = []
    for drive in campaign.drives:
        trace = task.execution(drive.job).trace
        named, truth = replay(task.observer, trace).location, trace.true_location
        assert truth is not None
        for pair in zip(truth, named, strict=True):
            pairs[pair] = pairs.get(pair, 0) + 1
        delays += naive_delays(trace.time.tolist(), truth, named)
    names = [*task.names]
    assert summary["confusion"]["samples"] == [[pairs.get((t, n), 0) for n in [*names, None]] for t in names]
    counted = delays[:12]
    found = sorted(delay for delay in counted if delay is not None)
    assert (summary["engagements"], summary["found"], summary["missed"]) == (12, len(found), 12 - len(found))
    assert summary["within_limit"] == sum(delay <= 0.25 + 1e-9 for delay in found) / 12
    assert summary["delays"]["50"] == (found[5] if len(found) > 5 else None)
    assert summary["delays"]["90"] == (found[10] if len(found) > 10 else None)
    assert summary["delays"]["max"] == (found[11] if len(found) == 12 else None)


def naive_delays(time: list[float], truth: tuple[str | None, ...], named: tuple[str | None, ...]) -> list[float | None]:
    delays: list[float | None] = []
    for row in range(1, len(time)):
        if truth[row] == truth[row - 1]:
            continue
        end = next((i for i in range(row, len(time)) if truth[i] != truth[row]), len(time))
        if time[min(end, len(time) - 1)] - time[row] < 0.3 - 1e-9:
            continue
        if named[row] == truth[row]:
            first = row
            while (
                first > 0
                and named[first - 1] == truth[row]
                and truth[first - 1] != truth[row]
                and time[first - 1] >= time[row] - 0.5 - 1e-9
            ):
                first -= 1
            delays.append(time[first] - time[row])
        else:
            delays.append(next((time[i] - time[row] for i in range(row, end) if named[i] == truth[row]), None))
    return delays


def test_too_few_engagements_end_incomplete_with_what_is_there() -> None:
    task = tank()[0]
    campaign = run_campaign(task, Here(), engagements=1000, max_drives=2)
    assert [d.code for d in campaign.stopped] == ["DH0910"]
    assert len(campaign.drives) == 2
    assert Summary(campaign).record()["complete"] is False


def test_the_command_tells_writes_plots_and_refuses_the_journal_of_another_seed(tmp_path: Path) -> None:
    def deshybrid(*words: object) -> subprocess.CompletedProcess[str]:
        call = [sys.executable, "-m", "deshybrid.cli", "campaign", TANK, "--engagements", "4", "--duration", "8"]
        return subprocess.run([*call, *map(str, words)], capture_output=True, text=True, check=False)

    done = deshybrid("--workers", 1, "--json", "--plots", "-o", tmp_path)
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout)["format"] == "deshybrid-campaign/1"
    assert {"delays.svg", "confusion.svg", "worst-1.svg", JOURNAL} <= {path.name for path in tmp_path.iterdir()}
    other = deshybrid("--workers", 1, "--seed", 1, "-o", tmp_path)
    assert other.returncode == 2
    assert "DH0721" in other.stderr
    unknown = deshybrid("--only", "fil")
    assert unknown.returncode == 2
    assert "`fill`" in unknown.stderr


@lru_cache(maxsize=1)
def compared() -> Campaign:
    """A short campaign of the tank beside a comparison that takes its outflow over its level for the location."""
    system = dh.load(TANK)
    name = system.output_names[0]
    rule = RatioComparison(name, name, {"fill": 1.0}, None, band=0.1, debounce=0.02, slowest=0.8)
    prepared = prepare(replace(system, simulation=replace(system.simulation, comparison=rule)), WISHES)
    assert prepared.task is not None
    return carry_out(prepared, prepared.task, Here())


def test_every_detector_is_scored_on_the_same_engagements() -> None:
    campaign = compared()
    stays = [[(e.location, e.enter, e.leave) for _, e in campaign.engagements_of(place)] for place in (0, 1)]
    assert stays[0] == stays[1]
    assert [e.delay for _, e in campaign.engagements_of(0)] != [e.delay for _, e in campaign.engagements_of(1)]


def test_the_table_is_what_a_naive_count_of_the_traces_gives() -> None:
    campaign = compared()
    rows = Summary(campaign).table
    assert [(row.detector, row.into) for row in rows] == [
        (name, into) for into in (("fill",), ("drain",)) for name in ("observer", "ratio")
    ]
    traces = [campaign.task.execution(drive.job).trace for drive in campaign.drives]
    detectors = dict(campaign.task.detectors)
    for row in rows:
        named = [named_by(detectors[row.detector], trace) for trace in traces]
        pairs = [p for n, t in zip(named, traces, strict=True) for p in zip(t.true_location, n, strict=True)]
        assert row.samples == sum(true in row.into for true, _ in pairs)
        assert row.right == sum(true in row.into and said == true for true, said in pairs)
        assert row.wrong == sum(true in row.into and said not in (true, None) for true, said in pairs)
        runs = [wrong for n, t in zip(named, traces, strict=True) for wrong in wrong_names(t.time, t.true_location, n)]
        for kind, longest in row.record()["longest_wrong"].items():
            assert longest == max((w.seconds for w in runs if w.kind == kind and w.named in row.into), default=0.0)
    assert sum(row.engagements for row in rows if row.detector == "ratio") == WISHES.engagements
