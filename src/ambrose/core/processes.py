"""Processes of this computer that compute beside this one.

A new process of Python's "spawn" kind imports the script that started it. A script without
``if __name__ == "__main__":`` would then begin anew in every worker, which Python ends. The workers
here need no more than this package, so they are started without the script. Their linear algebra
has one thread (``core.threads`` says why), Ctrl-C is the parent's to handle, and they end with it.
"""

from __future__ import annotations

import multiprocessing
import os
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from multiprocessing.context import SpawnContext, SpawnProcess
from types import ModuleType
from typing import Any


class _Worker(SpawnProcess):
    """A process that does not import the script of the one that starts it."""

    @staticmethod
    def _Popen(process_obj: Any) -> Any:
        with without_script():
            return SpawnProcess._Popen(process_obj)


class _Workers(SpawnContext):
    Process = _Worker


def processors() -> int:
    """How many this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def can_start_processes() -> bool:
    """Whether this process may start others: not where it is a worker of somebody's pool itself, or
    imports the script of the one that started it.
    """
    here = multiprocessing.current_process()
    return not (here.daemon or getattr(here, "_inheriting", False))


def pool(
    workers: int, told: Callable[..., None] | None = None, *told_by: Any
) -> ProcessPoolExecutor:
    """An executor of so many processes of this computer, started as they are needed.

    told: called with told_by at the beginning of every one of them.
    """
    return ProcessPoolExecutor(workers, context(), _begin, (told, told_by))


def context() -> SpawnContext:
    """What the processes, and the queues that they are given, are made of."""
    return _Workers()


@contextmanager
def one_thread_in_workers() -> Iterator[None]:
    """Processes that are started meanwhile have one thread for linear algebra, unless the user set
    a number.
    """
    name = "OPENBLAS_NUM_THREADS"
    if name in os.environ:
        yield
        return
    os.environ[name] = "1"
    try:
        yield
    finally:
        del os.environ[name]


@contextmanager
def without_script() -> Iterator[None]:
    """Meanwhile this process has no script, which a new process would import."""
    script = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = script


def _begin(told: Callable[..., None] | None, told_by: tuple[Any, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    threading.Thread(target=_end_with_the_parent, daemon=True).start()
    if told is not None:
        told(*told_by)


def _end_with_the_parent() -> None:
    """Ends this process when the one that started it has ended, however that happened.

    A worker of an executor holds both ends of the queue that it reads: without this it would wait
    without end for a parent that was killed.
    """
    parent = multiprocessing.parent_process()
    if parent is not None:
        parent.join()
        os._exit(1)
