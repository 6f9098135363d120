"""Where the jobs of a campaign run, on a cluster: an executor of Dask's.

In: `local`, or the address of a Dask scheduler.  Out: an `Executor` for `run_campaign`, and how many jobs it runs at
once.  The workers need the same version of deshybrid and nothing of the model: the observer travels with the job.
Needs `distributed` (extra `dask`), which is loaded when it is asked for.

Source: the documentation of Dask.distributed.
"""

from collections.abc import Callable, Iterator
from concurrent.futures import BrokenExecutor, Executor, Future
from contextlib import ExitStack, contextmanager
from typing import Any, ParamSpec, TypeVar

from deshybrid.diagnostics import UsageError, diagnostic

P = ParamSpec("P")
T = TypeVar("T")

LOCAL = "local"
PATIENCE = 10  # s, in which a scheduler has to answer and a worker to be there


@contextmanager
def dask_executor(address: str, *, workers: int | None = None) -> Iterator[tuple[Executor, int]]:
    """Return an executor on a Dask cluster, and how many jobs it runs at once; the connection ends with the context.

    `local` starts a cluster of processes on this machine, one a core where `workers` does not say; anything else is the
    address of a scheduler that runs.  Raises `UsageError`: DH0723 where `distributed` is not installed, DH0724 where no
    scheduler answers or it has no workers.
    """
    require_dask()
    with ExitStack() as open_until_then:
        client = open_until_then.enter_context(_client(address, workers, open_until_then))
        yield _Cluster(client), sum(client.ncores().values())


def _client(address: str, workers: int | None, cluster: ExitStack) -> Any:
    """Connect to a cluster that has workers; one that is started here is kept by `cluster`."""
    from distributed import Client, LocalCluster

    try:
        if address == LOCAL:
            quiet = {"dashboard_address": None, "silence_logs": "error"}  # it would tell of jobs that are not needed
            made = LocalCluster(n_workers=workers, threads_per_worker=1, **quiet)
            address = cluster.enter_context(made).scheduler_address
        client = Client(address, timeout=PATIENCE)
        client.wait_for_workers(1, timeout=PATIENCE)
    except (OSError, TimeoutError, ValueError) as error:
        text = f"no Dask cluster with workers answers at `{address}`"
        helps = ("start one with `dask scheduler` and `dask worker ADDRESS`, or write `--dask local`",)
        raise UsageError(diagnostic("DH0724", text, notes=(str(error),), helps=helps)) from error
    return client


def require_dask() -> None:
    """Raise `UsageError` (DH0723) where `distributed` is not installed."""
    try:
        import distributed  # noqa: F401
    except ImportError as error:
        helps = ("install it with `pip install deshybrid[dask]`",)
        text = "a Dask cluster needs `distributed`, which is not installed"
        raise UsageError(diagnostic("DH0723", text, helps=helps)) from error


class _Cluster(Executor):
    """Submits jobs to a cluster; a worker that is lost ends a job as a lost process would."""

    def __init__(self, client: Any) -> None:
        self._client = client

    def submit(self, fn: Callable[P, T], /, *args: P.args, **kwargs: P.kwargs) -> Future[T]:
        """Run a job on some worker."""
        return _Job(self._client.submit(fn, *args, pure=False, **kwargs))


class _Job(Future[T]):
    """The future of a job, as the standard library knows futures."""

    def __init__(self, remote: Any) -> None:
        super().__init__()
        self._remote = remote
        remote.add_done_callback(self._take)

    def cancel(self) -> bool:
        """Ask the cluster not to run the job."""
        self._remote.cancel()
        return super().cancel()

    def _take(self, remote: Any) -> None:
        if not self.set_running_or_notify_cancel():
            return
        error = remote.exception() if remote.status == "error" else None
        if remote.status == "finished":
            self.set_result(remote.result())
        elif error is None or type(error).__name__ == "KilledWorker":
            self.set_exception(BrokenExecutor("a worker of the cluster was lost"))
        else:
            self.set_exception(error)
