"""Processes of this computer that compute beside this one.

A new process of Python's "spawn" kind imports the script that started it. A script without ``if
__name__ == "__main__":`` would then begin anew in every worker, which Python ends. The workers here
need no more than this package, so they are started without the script. Their linear algebra has one
thread (``core.processes`` says why), Ctrl-C is the parent's to handle, and they end with it.
"""

import ipaddress
import multiprocessing
import os
import signal
import socket
import sys
import threading
import time
from collections.abc import Callable, Hashable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager
from contextvars import ContextVar
from dataclasses import dataclass, field
from functools import cache, wraps
from multiprocessing.context import SpawnContext, SpawnProcess
from threading import Lock
from types import ModuleType
from typing import Any, TypeVar

from ambrose.core.checks import InvalidInput, check_positive


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


# One thread for linear algebra: the matrices here have some hundred rows, where a second thread
# costs more processor time than it saves.
#
# OpenBLAS, BLIS and MKL start as many threads as there are processors. ``one_thread`` holds them to
# one while it is entered, by threadpoolctl, and gives the caller's number back at the end. Where
# several Python threads are inside at once, the first one in sets the limit and lifts it at its own
# end; what the others compute after that takes the caller's number, which costs time and nothing
# else. Whoever sets a number in the environment (``OPENBLAS_NUM_THREADS`` and the like) keeps it.


Function = TypeVar("Function", bound=Callable[..., Any])
VARIABLES = (
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "BLIS_NUM_THREADS",
    "OMP_NUM_THREADS",
)

_limited = Lock()  # held by the one who set the limit, whatever is called within it


@contextmanager
def one_thread() -> Iterator[None]:
    """Linear algebra with one thread, unless one of ``VARIABLES`` is set."""
    if any(os.environ.get(name) for name in VARIABLES) or not _limited.acquire(blocking=False):
        yield
        return
    try:
        with _libraries().limit(limits=1, user_api="blas"):
            yield
    finally:
        _limited.release()


def in_one_thread(function: Function) -> Function:
    """Decorator: the function's linear algebra runs in one thread."""

    @wraps(function)
    def limited(*args: Any, **keywords: Any) -> Any:
        with one_thread():
            return function(*args, **keywords)

    return limited  # type: ignore[return-value]


@cache
def _libraries() -> Any:
    """The libraries for linear algebra in this process: that of numpy and that of scipy, which
    may be two, so both are loaded first."""
    import scipy.linalg  # noqa: F401
    from threadpoolctl import ThreadpoolController

    return ThreadpoolController()


# What was computed before within one run, and need not be computed again.
#
#     with remembering():
#         one = recalled("plant", (machine, point), lambda: assemble(machine, point))
#         same = recalled("plant", (machine, point), lambda: assemble(machine, point))
#
# Outside of ``remembering`` nothing is kept. What is kept is shared by all who ask for it: results
# that nobody changes (rule 2 of docs/research/design.md).


Result = TypeVar("Result")
_kept: ContextVar[dict[tuple[str, Hashable], Any] | None] = ContextVar("kept", default=None)


@contextmanager
def remembering() -> Iterator[None]:
    """Results of ``recalled`` are kept until the outermost of these ends."""
    if _kept.get() is not None:
        yield
        return
    before = _kept.set({})
    try:
        yield
    finally:
        _kept.reset(before)


def recalled(kind: str, key: Hashable, make: Callable[[], Result]) -> Result:
    """What ``make`` gave for this kind of result and this key before, else what it gives now.

    key: all that the result depends on.
    """
    kept = _kept.get()
    if kept is None:
        return make()
    if (kind, key) not in kept:
        kept[kind, key] = make()
    result: Result = kept[kind, key]
    return result


# The time limit of a synthesis, in computing time, so that a busy machine does not change its
# result.


_PATIENCE = 5.0  # times the limit: the guard by the clock on the wall


# the methods of ``design`` and the command line have a limit of their own, and no option for it
REMEDY = "take fewer states, modes or points (in Python a function's time_limit gives it more)"


def _computing() -> float:
    return time.thread_time()


def _wall() -> float:
    return time.monotonic()


@dataclass(frozen=True, slots=True)
class TimeLimit:
    """``seconds`` of computing by the thread that made this object, and five times as many on the
    wall as an outer guard.

    The thread's own time: other programs, other threads of the process and the threads of a linear
    algebra library do not count. Raises InvalidInput unless the limit is positive.
    """

    seconds: float
    _computed: float = field(default_factory=_computing)
    _begun: float = field(default_factory=_wall)

    def __post_init__(self) -> None:
        check_positive(self.seconds, "time_limit", "give seconds")

    @property
    def elapsed(self) -> float:
        """Seconds on the wall since the start."""
        return _wall() - self._begun

    @property
    def left(self) -> float:
        """Seconds that remain, of computing or on the wall, whichever ends first; not positive when
        the limit is reached.
        """
        return min(
            self.seconds - (_computing() - self._computed),
            _PATIENCE * self.seconds - self.elapsed,
        )

    @property
    def reached(self) -> str:
        """What to say when nothing is left."""
        if _computing() - self._computed < self.seconds:
            return (
                f"{_PATIENCE:g} times the time limit of {self.seconds:g} s passed, on a busy "
                f"machine; {REMEDY}"
            )
        return f"the time limit of {self.seconds:g} s was reached; {REMEDY}"


# A socket of a server on this computer, and the names by which it is known.


def listening(address: str, port: int) -> socket.socket:
    """A socket that listens at an address of this computer. Raises InvalidInput."""
    try:
        place = ipaddress.ip_address(address)
    except ValueError:
        raise InvalidInput(
            f"--listen is {address!r}, but must be an IP address of this computer, such as "
            "192.168.0.10; look it up in its network settings"
        ) from None
    if place.is_unspecified:
        raise InvalidInput(
            f"--listen {address} means every network at once; give the address of the one that "
            "may see the workbench"
        )
    family = socket.AF_INET6 if place.version == 6 else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        listener.bind((address, port))
        listener.listen(128)
    except OSError as error:
        listener.close()
        raise InvalidInput(
            f"cannot listen at {address}, port {port}: {error.strerror or error}; give another"
        ) from error
    return listener


def names_of(listener: socket.socket) -> list[str]:
    """ "address:port" by which a server at this socket is known; its own address first."""
    address, port = listener.getsockname()[:2]
    place = ipaddress.ip_address(address)
    own = f"[{address}]:{port}" if place.version == 6 else f"{address}:{port}"
    return [own, f"localhost:{port}"] if place.is_loopback else [own]
