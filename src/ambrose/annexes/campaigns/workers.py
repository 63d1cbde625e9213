"""Where the cases of a campaign are computed: processes of this computer, or a Dask cluster."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterator
from concurrent.futures import Executor
from contextlib import contextmanager

from ambrose.core.checks import InvalidInput
from ambrose.core.processes import one_thread_in_workers, pool, without_script

PROCESSES, DASK = "processes", "dask"
MakeExecutor = Callable[[], Executor]


@contextmanager
def executors(engine: str, workers: int) -> Iterator[tuple[MakeExecutor, int]]:
    """How to make executors, and their number of workers.

    engine: "processes" on this computer; "dask", a cluster of processes on this computer; or the
    address of a running scheduler ("tcp://host:8786", or its scheduler file *.json), which must be
    trusted: what it sends is run. workers: 1 or more. Raises InvalidInput.
    """
    if getattr(multiprocessing.current_process(), "_inheriting", False):
        raise InvalidInput(
            "a campaign cannot start while a worker process imports the script that it stands in;"
            ' put the call below `if __name__ == "__main__":`'
        )
    if not isinstance(workers, int) or isinstance(workers, bool) or workers < 1:
        raise InvalidInput(
            f"workers is {workers!r}, but must be a whole number, 1 or more; leave it out"
        )
    if not isinstance(engine, str):
        raise InvalidInput(f"engine is {engine!r}, but must be a text; take processes or dask")
    with one_thread_in_workers():
        yield from _executors(engine, workers)


def _executors(engine: str, workers: int) -> Iterator[tuple[MakeExecutor, int]]:
    if engine == PROCESSES:
        yield lambda: pool(workers), workers
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        remedy = "pip install 'ambrose[campaign]'"
        raise InvalidInput(
            f"engine {engine} needs Dask, which is not installed; {remedy}"
        ) from None
    if engine == DASK:
        with without_script():
            cluster = LocalCluster(n_workers=workers, threads_per_worker=1, dashboard_address=None)
        with cluster, Client(cluster) as client:
            yield client.get_executor, workers
        return
    if "://" not in engine and not engine.endswith(".json"):
        raise InvalidInput(
            f'engine "{engine}" is unknown; take processes, dask, or the address of a scheduler '
            "(tcp://...)"
        )
    try:
        known = engine.endswith(".json")
        dask = Client(scheduler_file=engine) if known else Client(engine, timeout=20)
    except (OSError, TimeoutError, ValueError) as error:
        raise InvalidInput(
            f"no scheduler answers at {engine}: {error}; start one with `dask scheduler`"
        ) from error
    with dask as client:
        yield client.get_executor, max(1, sum(client.nthreads().values()), workers)
