"""Campaigns on a Dask cluster, which runs in this process here; skipped where `distributed` is not installed."""

import sys
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future
from pathlib import Path

import pytest

from deshybrid import cli
from deshybrid.campaigns import Wishes, files, prepare
from deshybrid.diagnostics import UsageError
from deshybrid.simulate import campaign_dask
from deshybrid.simulate.campaign import Campaign, run_campaign
from deshybrid.simulate.campaign_dask import dask_executor
from deshybrid.simulate.campaign_executor import Here

distributed = pytest.importorskip("distributed", reason="Dask is not installed (extra `dask`)")
pytestmark = pytest.mark.filterwarnings("default")  # what Dask's own threads warn of is theirs
TANK = "models/two_tank.yaml"


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with distributed.LocalCluster(
        processes=False, n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        yield cluster.scheduler_address


@pytest.fixture(scope="module")
def alone() -> Campaign:
    """In this process, without a cluster."""
    task = prepare(TANK, Wishes(seed=4, duration=3.0)).task
    assert task is not None
    return run_campaign(task, Here(), engagements=6)


def test_the_result_on_a_cluster_is_that_of_one_process(address: str, alone: Campaign) -> None:
    with dask_executor(address) as (executor, count):
        assert count == 2
        together = run_campaign(alone.task, executor, engagements=6, ahead=2 * count)
    assert files(together) == files(alone)


def command(monkeypatch: pytest.MonkeyPatch, *words: object) -> object:
    """The exit code of a command line, run in this process, in which the cluster is."""
    monkeypatch.setattr(sys, "argv", ["deshybrid", *map(str, words)])
    with pytest.raises(SystemExit) as ended:
        cli.main()
    return ended.value.code or 0


def test_the_command_runs_drives_where_it_is_told(
    address: str, alone: Campaign, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["campaign", TANK, "--engagements", 6, "--seed", 4, "--duration", 3, "--dask", address]
    assert command(monkeypatch, *words, "-o", tmp_path) == 0
    assert (tmp_path / "summary.json").read_bytes() == files(alone)["summary.json"]


def test_an_error_in_a_job_is_raised_where_its_result_is_asked_for(address: str) -> None:
    with dask_executor(address) as (executor, _), pytest.raises(ZeroDivisionError):
        executor.submit(divmod, 1, 0).result()


def test_where_no_scheduler_answers_the_command_says_how_to_start_one(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(campaign_dask, "PATIENCE", 0.2)
    assert command(monkeypatch, "campaign", TANK, "--dask", "tcp://127.0.0.1:1") == 2
    assert "DH0724" in capsys.readouterr().err


def test_without_distributed_the_command_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(UsageError, match="DH0723"), dask_executor("local"):
        pass


class KilledWorker(Exception):
    pass


class Lost:
    """A job of Dask's whose worker went away."""

    def __init__(self, status: str) -> None:
        self.status = status

    def add_done_callback(self, function) -> None:
        function(self)

    def exception(self) -> Exception:
        return KilledWorker()


@pytest.mark.parametrize("status", ["error", "cancelled", "lost"])
def test_a_lost_worker_of_a_cluster_counts_as_a_lost_process(status: str) -> None:
    job: Future[int] = campaign_dask._Job(Lost(status))
    with pytest.raises(BrokenExecutor):
        job.result()
