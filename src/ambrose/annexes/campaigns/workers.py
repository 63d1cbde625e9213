"""Where the cases of a campaign are computed: processes of this computer, or a Dask cluster.

A new process of Python's "spawn" kind imports the script that started it. A script without
``if __name__ == "__main__":`` would then start its campaign anew in every worker, which Python
ends. The workers here need no more than this package, so they are started without the script.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any

from ambrose.core.checks import InvalidInput

PROCESSES, DASK = "processes", "dask"
MakeExecutor = Callable[[], Executor]


class _Worker(SpawnProcess):
    """A process that does not import the script of the one that starts it."""

    @staticmethod
    def _Popen(process_obj: Any) -> Any:
        with _without_script():
            return SpawnProcess._Popen(process_obj)


class _Workers(SpawnContext):
    Process = _Worker


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
    with _told_to_workers("OPENBLAS_NUM_THREADS", "1"):
        yield from _executors(engine, workers)


def processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _executors(engine: str, workers: int) -> Iterator[tuple[MakeExecutor, int]]:
    if engine == PROCESSES:
        context = _Workers()
        yield lambda: ProcessPoolExecutor(workers, context, _quiet_worker), workers
        return
    try:
        from distributed import Client, LocalCluster
    except ImportError:
        remedy = "pip install 'ambrose[campaign]'"
        raise InvalidInput(
            f"engine {engine} needs Dask, which is not installed; {remedy}"
        ) from None
    if engine == DASK:
        with _without_script():
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


@contextmanager
def _without_script() -> Iterator[None]:
    """Meanwhile this process has no script, which a new process would import."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


@contextmanager
def _told_to_workers(name: str, value: str) -> Iterator[None]:
    """A variable in the environment that processes started meanwhile inherit, unless it is set."""
    if name in os.environ:
        yield
        return
    os.environ[name] = value
    try:
        yield
    finally:
        del os.environ[name]


def _quiet_worker() -> None:
    """Ctrl-C is the parent's to handle."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
